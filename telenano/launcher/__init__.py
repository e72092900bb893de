"""The supervisor of a rig, or of one site of it."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.launcher.child_session import reason_of as reason_of
    from telenano.launcher.child_session import run_session as run_session
else:
    __getattr__, __dir__ = face(__name__)
