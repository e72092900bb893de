"""Commands to a running rig from outside it: by a console, or as an emergency stop."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.console.command_client import console_of as console_of
else:
    __getattr__, __dir__ = face(__name__)
