"""Drivers of real devices and what they share: lines, processes of their own, calibrations, capabilities."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.devices.afm.capabilities import AfmCapabilities as AfmCapabilities
    from telenano.devices.afm.capabilities import capabilities_of as capabilities_of
    from telenano.devices.afm.guarded import Step as Step
    from telenano.devices.afm.guarded import line_fields as line_fields
    from telenano.devices.afm.instrument import calibration_of_file as calibration_of_file
    from telenano.devices.afm.instrument import driver_of as driver_of
    from telenano.devices.afm.instrument import driver_of_file as driver_of_file
    from telenano.devices.hand.calibration import HandleCalibration as HandleCalibration
    from telenano.devices.hand.calibration import read_handle_calibration as read_handle_calibration
    from telenano.devices.hand.serial_driver import SerialHandle as SerialHandle
    from telenano.devices.hand.wire import HandleAbility as HandleAbility
    from telenano.devices.hand.wire import HandleFlag as HandleFlag
    from telenano.devices.hand.wire import HandleHello as HandleHello
    from telenano.devices.afm.virtual_instrument import VirtualInstrument as VirtualInstrument
else:
    __getattr__, __dir__ = face(__name__)
