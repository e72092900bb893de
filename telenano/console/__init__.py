"""Commands to a running rig from outside it: by a console, or as an emergency stop."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.console.page_hand import RigHand as RigHand
else:
    __getattr__, __dir__ = face(__name__)
