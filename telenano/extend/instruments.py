"""The driver of an AFM controller of one's own: a conversation over TCP, its calibration, and what it can do.

`TcpDriver` has the ticks that never wait; `RequestDriver` the conversation of a controller that answers one request
after the other, and its z piezo, stage and guard. `telenano.extend.controllers` has what stands in the place of one.
"""

from services.afm_node.devices import modbus_line
from services.afm_node.devices.capabilities import Capabilities as AfmCapabilities
from services.afm_node.devices.capabilities import refusal
from services.afm_node.devices.modbus_line import Connect, Line
from services.afm_node.devices.piezo_calibration import ControllerCalibration, read_controller
from services.afm_node.devices.request_answer import LARGEST_BYTES, Cut, Incoming, Talk, WireError
from services.afm_node.devices.request_driver import RequestDriver
from services.afm_node.devices.tcp_driver import TcpDriver
from services.afm_node.driver import DeviceError, OwnImage, OwnLine
from services.afm_node.section_config import AfmControllerConfig as ControllerSettings

__all__ = [
    "LARGEST_BYTES",
    "AfmCapabilities",
    "Connect",
    "ControllerCalibration",
    "ControllerSettings",
    "Cut",
    "DeviceError",
    "Incoming",
    "Line",
    "OwnImage",
    "OwnLine",
    "RequestDriver",
    "Talk",
    "TcpDriver",
    "WireError",
    "modbus_line",
    "read_controller",
    "refusal",
]
