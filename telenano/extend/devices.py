"""A driver of one's own, for a handle (`haptic_node`) or for an instrument (`afm_node`); the guard stays in front."""

from services.afm_node.driver import AfmDriver as AfmDriver
from services.afm_node.driver import DeviceReport as _AfmReport
from services.afm_node.driver import LateralStage as LateralStage
from services.afm_node.driver import VibratingCantilever as VibratingCantilever
from services.afm_node.physics.part import AfmSample as AfmSample
from services.afm_node.physics.part import Oscillation as Oscillation
from services.afm_node.safety import SafetyParams
from services.haptic_node.driver import Capabilities as Capabilities
from services.haptic_node.driver import DeviceError as DeviceError
from services.haptic_node.driver import DeviceReading as DeviceReading
from services.haptic_node.driver import DeviceReport as _HapticReport
from services.haptic_node.driver import DriveCommand as DriveCommand
from services.haptic_node.driver import HapticDevice as HapticDevice
from services.haptic_node.safety import MODE_FORCE as MODE_FORCE
from services.haptic_node.safety import MODE_OFF as MODE_OFF
from services.haptic_node.safety import MODE_POSITION as MODE_POSITION
from services.runtime.settings.config import Settings as Settings
from services.runtime.settings.device_drivers import DeviceDriver as DeviceDriver

AfmLimits = SafetyParams
AfmReport = _AfmReport
HapticReport = _HapticReport
