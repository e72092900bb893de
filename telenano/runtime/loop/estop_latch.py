"""What one run of a node knows of its emergency stops, and what a command has to quote to begin a motion after one."""

from collections.abc import Callable, Mapping
from pathlib import Path

from telenano.runtime.loop import kept_stop
from telenano.runtime.loop.machine import OWN_MACHINE
from telenano.wire.messages import Scalar


def begins_motion(command: str, parameters: Mapping[str, Scalar]) -> bool:
    """Return whether a command lets a device move: `arm`, and `set` where it begins or continues a program."""
    return command == "arm" or (
        command == "set" and "program" in parameters and parameters["program"] not in ("abort", "pause")
    )


class EstopLatch:
    """Counts the emergency stops of one run of a node, and keeps the newest in a file until the node is armed.

    A command that begins a motion quotes `quotation`, the run and the count, once there was a stop (ADR 0059). The
    count alone would not do, because it begins again with each run.
    """

    def __init__(self, path: Path | None = None, token: Callable[[int], str] = OWN_MACHINE.token) -> None:
        """Begin a run without a stop.

        Args:
            path: Where the newest stop is kept; None where it is not.
            token: Returns a number of so many bytes that no other run draws.
        """
        self.path = path
        self.count = 0
        # The id of the newest stop that was recorded; the copies of one stop share it.
        self.newest_id = ""
        self._run = token(6)
        self._newest_ns = 0

    @property
    def quotation(self) -> str:
        return f"{self._run}-{self.count}"

    def record(self, identifier: str, payload: bytes, now_ns: int) -> str:
        """Record a stop that the node has carried out; return why it cannot be kept, empty where it is.

        Args:
            identifier: The id of the stop.
            payload: The message as it was sent.
            now_ns: When the node carried it out [ns].
        """
        self.count += 1
        self._newest_ns = now_ns
        fault = ""
        if self.path is not None and identifier != self.newest_id:
            fault = kept_stop.keep(self.path, payload)
        self.newest_id = identifier
        return fault

    def release(self) -> None:
        """Keep no stop any longer: the node was armed."""
        self.newest_id = ""
        if self.path is not None:
            kept_stop.forget(self.path)

    def kept(self) -> bytes | None:
        """Return the stop that is kept, None where there is none; errors as those of `kept_stop.kept`."""
        return None if self.path is None else kept_stop.kept(self.path)

    def reason_against(self, quoted: str | None, now_ns: int) -> str:
        """Return why a command that quotes `quoted`, or nothing, may not begin a motion now; empty where it may."""
        if quoted == self.quotation or (quoted is None and not self.count):
            return ""
        if quoted is not None and not quoted.startswith(f"{self._run}-"):
            return "it refers to an earlier run of this device"
        age_s = (now_ns - self._newest_ns) * 1e-9
        return f"it does not refer to the newest emergency stop, which came {age_s:.1f} s ago"

    def facts(self, now_ns: int) -> dict[str, Scalar]:
        """Return what a refusal says of the latch for the sender to quote, and how old the newest stop is [s]."""
        age = {"estop_age_s": (now_ns - self._newest_ns) * 1e-9} if self.count else {}
        return {"latch": self.quotation, **age}
