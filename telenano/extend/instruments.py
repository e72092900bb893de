"""The driver of an AFM controller of one's own: ticks over TCP that never wait, calibration, and what it can do."""

from pathlib import Path
from typing import TypeVar

from telenano.afm.driver import DeviceError as DeviceError
from telenano.afm.driver import OwnImage as OwnImage
from telenano.afm.driver import OwnLine as OwnLine
from telenano.afm.felt import ChannelName as ChannelName
from telenano.afm.section_config import AfmControllerConfig
from telenano.devices.afm import modbus_line as modbus_line
from telenano.devices.afm.capabilities import Capabilities
from telenano.devices.afm.capabilities import refusal as refusal
from telenano.devices.afm.converter_calibration import CantileverCalibration as CantileverCalibration
from telenano.devices.afm.converter_calibration import Readings as Readings
from telenano.devices.afm.modbus_line import Connect as Connect
from telenano.devices.afm.modbus_line import Line as Line
from telenano.devices.afm.tcp_driver import STALE_CYCLES as STALE_CYCLES
from telenano.devices.afm.tcp_driver import TcpDriver as TcpDriver
from telenano.settings.config import Settings, read_yaml, validate
from telenano.wire.errors import TelenanoError as TelenanoError

AfmCapabilities = Capabilities
ControllerSettings = AfmControllerConfig
_C = TypeVar("_C", bound=Settings)


def read_controller(path: Path, model: type[_C]) -> _C:
    """Read the calibration file of a controller; ConfigError names file and key, and a file of another controller."""
    return validate(model, read_yaml(path), str(path))
