"""The driver of an AFM controller of one's own: ticks over TCP that never wait, calibration, and what it can do."""

from pathlib import Path
from typing import TypeVar

from proto.errors import TelenanoError
from services.afm_node.devices import modbus_line
from services.afm_node.devices.capabilities import Capabilities as AfmCapabilities
from services.afm_node.devices.capabilities import refusal
from services.afm_node.devices.converter_calibration import CantileverCalibration, Readings
from services.afm_node.devices.modbus_line import Connect, Line
from services.afm_node.devices.tcp_driver import STALE_CYCLES, TcpDriver
from services.afm_node.driver import DeviceError, OwnImage, OwnLine
from services.afm_node.felt import ChannelName
from services.afm_node.section_config import AfmControllerConfig as ControllerSettings
from services.runtime.settings.config import Settings, read_yaml, validate

__all__ = [
    "STALE_CYCLES",
    "AfmCapabilities",
    "CantileverCalibration",
    "ChannelName",
    "Connect",
    "ControllerSettings",
    "DeviceError",
    "Line",
    "OwnImage",
    "OwnLine",
    "Readings",
    "TcpDriver",
    "TelenanoError",
    "modbus_line",
    "read_controller",
    "refusal",
]

C = TypeVar("C", bound=Settings)


def read_controller(path: Path, model: type[C]) -> C:
    """Read the calibration file of a controller; ConfigError names file and key, and a file of another controller."""
    return validate(model, read_yaml(path), str(path))
