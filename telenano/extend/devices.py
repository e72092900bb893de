"""A driver of one's own, for a handle (`haptic_node`) or for an instrument (`afm_node`); the guard stays in front."""

from telenano.afm.driver import AfmDriver as AfmDriver
from telenano.afm.driver import DeviceReport as _AfmReport
from telenano.afm.driver import LateralStage as LateralStage
from telenano.afm.driver import VibratingCantilever as VibratingCantilever
from telenano.afm.part import AfmSample as AfmSample
from telenano.afm.part import Oscillation as Oscillation
from telenano.afm.safety import SafetyParams
from telenano.hand.driver import Capabilities as Capabilities
from telenano.hand.driver import DeviceError as DeviceError
from telenano.hand.driver import DeviceReading as DeviceReading
from telenano.hand.driver import DeviceReport as _HapticReport
from telenano.hand.driver import DriveCommand as DriveCommand
from telenano.hand.driver import HapticDevice as HapticDevice
from telenano.hand.safety import MODE_FORCE as MODE_FORCE
from telenano.hand.safety import MODE_OFF as MODE_OFF
from telenano.hand.safety import MODE_POSITION as MODE_POSITION
from telenano.settings.device_drivers import DeviceDriver as DeviceDriver

AfmLimits = SafetyParams
AfmReport = _AfmReport
HapticReport = _HapticReport
