"""Commands to a running rig from outside it: by a console, or as an emergency stop."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.console.live_program import run_program as run_program
else:
    __getattr__, __dir__ = face(__name__)
