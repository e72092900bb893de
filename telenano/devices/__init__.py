"""Drivers of real devices and what they share: lines, processes of their own, calibrations, capabilities."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.devices.afm.guarded import Step as Step
    from telenano.devices.afm.guarded import line_fields as line_fields
else:
    __getattr__, __dir__ = face(__name__)
