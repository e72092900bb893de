"""The guard's view of a Gwyscope: which requests drive the tip, and which one retracts it."""

import math

from telenano_devices.controllers.request_answer import WireError
from telenano_devices.gwyscope import gwyscope_wire
from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration
from telenano_devices.gwyscope.gwyscope_driver import GUARD_QUESTION

# Requests that only ask or set up, and do not move the tip.
_STILL = ("read", "get", "stop", "set_scan", "set_standby_storage", "get_scan_ndata", "get_scan_data", "get_out")


class GuardedGwyscope:
    """A Gwyscope behind a guard; see `retract_guard.GuardedController`.

    Args:
        calibration: The calibration of this particular controller.
    """

    def __init__(self, calibration: GwyscopeCalibration) -> None:
        self._calibration = calibration
        self.heartbeat_s = calibration.heartbeat_s

    def cut(self, stream: bytes) -> int:
        return gwyscope_wire.cut(stream)

    def answer(self, request: bytes, trips: int) -> bytes | None:
        """Return the answer to the question for a guard, with its number of retractions; None for other requests."""
        message = gwyscope_wire.decode(request)
        if message.get("todo") != GUARD_QUESTION:
            return None
        return gwyscope_wire.encode({"todo": GUARD_QUESTION, "heartbeat_s": self.heartbeat_s, "trips": trips})

    def drives(self, request: bytes) -> bool | None:
        """Return whether the tip is driven after a request; an unknown request counts as driving it."""
        message = gwyscope_wire.decode(request)
        if message.get("todo") in _STILL:
            return None
        if message.get("todo") == "move_to":
            # A motion also has a target for z, which the driver sets to that of the request before.
            return True if self._calibration.drives(float(message.get("zreq", math.nan))) else None
        if message.get("todo") == "set_feedback" and not message.get("feedback") and "zpiezo" in message:
            return self._calibration.drives(float(message["zpiezo"]))
        return True

    def retraction(self) -> bytes:
        return gwyscope_wire.encode(
            {"todo": "set_feedback", "feedback": False, "zpiezo": self._calibration.z.retract_m}
        )

    def is_retracted(self, answer: bytes) -> bool:
        try:
            message = gwyscope_wire.decode(answer)
        except WireError:
            return False
        z_m = message.get("zpiezo", math.nan)
        return (
            not message.get("feedback") and abs(z_m - self._calibration.z.retract_m) <= self._calibration.z.tolerance_m
        )
