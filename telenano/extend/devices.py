"""A driver of one's own, for a handle (`haptic_node`) or for an instrument (`afm_node`); the guard stays in front."""

from services.afm_node.driver import AfmDriver, LateralStage, VibratingCantilever
from services.afm_node.driver import DeviceReport as AfmReport
from services.afm_node.physics.part import AfmSample, Oscillation
from services.afm_node.safety import SafetyParams as AfmLimits
from services.haptic_node.driver import Capabilities, DeviceError, DeviceReading, DriveCommand, HapticDevice
from services.haptic_node.driver import DeviceReport as HapticReport
from services.haptic_node.safety import MODE_FORCE, MODE_OFF, MODE_POSITION
from services.runtime.settings.config import Settings
from services.runtime.settings.device_drivers import DeviceDriver

__all__ = [
    "MODE_FORCE",
    "MODE_OFF",
    "MODE_POSITION",
    "AfmDriver",
    "AfmLimits",
    "AfmReport",
    "AfmSample",
    "Capabilities",
    "DeviceDriver",
    "DeviceError",
    "DeviceReading",
    "DriveCommand",
    "HapticDevice",
    "HapticReport",
    "LateralStage",
    "Oscillation",
    "Settings",
    "VibratingCantilever",
]
