"""Commands to a running rig from outside, by a console or as an emergency stop, and live reading of its messages."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.console.answers import UnansweredError as UnansweredError
    from telenano.console.bridges import hand_on as hand_on
    from telenano.console.bridges import live_rig as live_rig
    from telenano.console.coupling import recouple as recouple
    from telenano.console.going_back import go_back as go_back
    from telenano.console.lease_register import holding as holding
    from telenano.console.live_recording import LiveRecording as LiveRecording
    from telenano.console.page_hand import RigHand as RigHand
    from telenano.console.send_commands import send_control as send_control
else:
    __getattr__, __dir__ = face(__name__)
