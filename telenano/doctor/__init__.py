"""`telenano doctor`: whether this machine can run a rig, and what to do where it cannot."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.doctor.checks import Finding as Finding
else:
    __getattr__, __dir__ = face(__name__)
