"""The guard's view of a Nanonis controller: which requests drive the tip, and which one withdraws it."""

import math

from telenano_devices.controllers.request_answer import WireError
from telenano_devices.nanonis import nanonis_wire
from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration
from telenano_devices.nanonis.nanonis_driver import GUARD_COMMAND

# Beginnings of commands that only set up, and do not move the tip in z.
_STILL = ("SafeTip.", "FolMe.", "Util.", "TCPLog.", "ZCtrl.Limits", "ZCtrl.TipLift", "ZCtrl.SwitchOff", "Scan.Speed")


class GuardedNanonis:
    """A Nanonis controller behind a guard; see `retract_guard.GuardedController`.

    Args:
        calibration: The calibration of this particular controller.
    """

    def __init__(self, calibration: NanonisCalibration) -> None:
        self._calibration = calibration
        self.heartbeat_s = calibration.heartbeat_s

    def cut(self, stream: bytes) -> int:
        return nanonis_wire.cut(stream)

    def answer(self, request: bytes, trips: int) -> bytes | None:
        """Return the answer to the question for a guard, with its number of retractions; None for other requests."""
        is_question = nanonis_wire.parse_request(request).command == GUARD_COMMAND
        return nanonis_wire.answer(GUARD_COMMAND, nanonis_wire.pack("I", [trips])) if is_question else None

    def drives(self, request: bytes) -> bool | None:
        """Return whether the tip is driven after a request; an unknown request counts as driving it."""
        asked = nanonis_wire.parse_request(request)
        command = nanonis_wire.known(asked.command) or asked.command
        if command.endswith("Get") or command.endswith("Grab") or command.startswith(_STILL):
            return None
        if command == "ZCtrl.ZPosSet":
            try:
                return self._calibration.drives(nanonis_wire.unpack("f", asked.body)[0][0])
            except WireError:
                return self._calibration.drives(math.nan)
        return command != "ZCtrl.Withdraw"

    def retraction(self) -> bytes:
        return nanonis_wire.request("ZCtrl.Withdraw", 0, -1)

    def is_retracted(self, answer: bytes) -> bool:
        """Return whether the controller has accepted the withdrawal, which it carries out at its withdraw rate."""
        try:
            nanonis_wire.returned("ZCtrl.Withdraw", answer)
        except (WireError, nanonis_wire.NanonisRefusalError):
            return False
        return True
