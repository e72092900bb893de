"""Drivers of real devices and what they share: lines, processes of their own, calibrations, capabilities."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.devices.afm.capabilities import AfmCapabilities as AfmCapabilities
    from telenano.devices.afm.capabilities import capabilities_of as capabilities_of
    from telenano.devices.afm.guarded import AfmMemory as AfmMemory
    from telenano.devices.afm.guarded import AfmPart as AfmPart
    from telenano.devices.afm.guarded import GuardedInstrument as GuardedInstrument
    from telenano.devices.afm.guarded import Stage as Stage
    from telenano.devices.afm.guarded import Step as Step
    from telenano.devices.afm.guarded import line_fields as line_fields
    from telenano.devices.afm.instrument import calibration_of_file as calibration_of_file
    from telenano.devices.afm.instrument import driver_of as driver_of
    from telenano.devices.afm.instrument import driver_of_file as driver_of_file
    from telenano.devices.afm.instrument import reach_of as reach_of
    from telenano.devices.afm.instrument import runner_of as runner_of
else:
    __getattr__, __dir__ = face(__name__)
