"""The emergency stops of one run of a node, and the quotation by which a later command may begin a motion."""

from collections.abc import Callable, Mapping
from pathlib import Path

from telenano.runtime.loop import kept_stop
from telenano.runtime.loop.machine import OWN_MACHINE
from telenano.wire.messages import Scalar


def begins_motion(command: str, parameters: Mapping[str, Scalar]) -> bool:
    """Return whether a command lets a device move: `arm`, or a `set` that begins or continues a program."""
    return command == "arm" or (
        command == "set" and "program" in parameters and parameters["program"] not in ("abort", "pause")
    )


class EstopLatch:
    """Counts the emergency stops of one run of a node, and keeps the newest in a file until the node is armed.

    After a stop, a command that begins a motion has to quote `quotation`: the run and the count of stops (ADR 0059).
    The count alone would not suffice, because it begins again with each run.
    """

    def __init__(self, path: Path | None = None, token: Callable[[int], str] = OWN_MACHINE.token) -> None:
        """Begin a run without a stop.

        Args:
            path: The file that keeps the newest stop; None to keep none.
            token: Returns a random number of this many bytes, as hexadecimal text, unique to this run.
        """
        self.path = path
        self.count = 0
        # The id of the newest recorded stop; repeated copies of one stop have the same id.
        self.newest_id = ""
        self._run = token(6)
        self._newest_ns = 0

    @property
    def quotation(self) -> str:
        return f"{self._run}-{self.count}"

    def record(self, identifier: str, payload: bytes, now_ns: int) -> str:
        """Record a stop that the node has executed; return the reason if the file cannot be written, else "".

        Args:
            identifier: The id of the stop.
            payload: The encoded message.
            now_ns: The time at which the node executed it [ns].
        """
        self.count += 1
        self._newest_ns = now_ns
        fault = ""
        if self.path is not None and identifier != self.newest_id:
            fault = kept_stop.keep(self.path, payload)
        self.newest_id = identifier
        return fault

    def release(self) -> None:
        """Remove the kept stop, because the node was armed."""
        self.newest_id = ""
        if self.path is not None:
            kept_stop.forget(self.path)

    def kept(self) -> bytes | None:
        """Return the kept stop, None if there is none; raise the errors of `kept_stop.kept`."""
        return None if self.path is None else kept_stop.kept(self.path)

    def reason_against(self, quoted: str | None, now_ns: int) -> str:
        """Return the reason why a command may not begin a motion now, empty if it may.

        Args:
            quoted: The quotation in the command; None without one.
            now_ns: The present time [ns].
        """
        if quoted == self.quotation or (quoted is None and not self.count):
            return ""
        if quoted is not None and not quoted.startswith(f"{self._run}-"):
            return "it refers to an earlier run of this device"
        age_s = (now_ns - self._newest_ns) * 1e-9
        return f"it does not refer to the newest emergency stop, which came {age_s:.1f} s ago"

    def facts(self, now_ns: int) -> dict[str, Scalar]:
        """Return the data of a refusal: the quotation for the sender, and the age of the newest stop [s]."""
        age = {"estop_age_s": (now_ns - self._newest_ns) * 1e-9} if self.count else {}
        return {"latch": self.quotation, **age}
