"""The driver of an AFM controller of one's own: ticks over TCP that never wait, calibration, and what it can do."""

from pathlib import Path
from typing import TypeVar

from services.afm_node.devices import modbus_line as modbus_line
from services.afm_node.devices.capabilities import Capabilities
from services.afm_node.devices.capabilities import refusal as refusal
from services.afm_node.devices.converter_calibration import CantileverCalibration as CantileverCalibration
from services.afm_node.devices.converter_calibration import Readings as Readings
from services.afm_node.devices.modbus_line import Connect as Connect
from services.afm_node.devices.modbus_line import Line as Line
from services.afm_node.devices.tcp_driver import STALE_CYCLES as STALE_CYCLES
from services.afm_node.devices.tcp_driver import TcpDriver as TcpDriver
from services.afm_node.driver import DeviceError as DeviceError
from services.afm_node.driver import OwnImage as OwnImage
from services.afm_node.driver import OwnLine as OwnLine
from services.afm_node.felt import ChannelName as ChannelName
from services.afm_node.section_config import AfmControllerConfig
from services.runtime.settings.config import Settings, read_yaml, validate
from telenano.wire.errors import TelenanoError as TelenanoError

AfmCapabilities = Capabilities
ControllerSettings = AfmControllerConfig
_C = TypeVar("_C", bound=Settings)


def read_controller(path: Path, model: type[_C]) -> _C:
    """Read the calibration file of a controller; ConfigError names file and key, and a file of another controller."""
    return validate(model, read_yaml(path), str(path))
