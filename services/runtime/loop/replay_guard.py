"""Rejects commands that come from a recording at devices."""

from proto.messages import NodeHealth, SessionControl
from services.runtime.bus.bus import Received
from services.runtime.loop.node import NodeContext


class ReplayGuard:
    """Rejects messages of publishers whose `node/health` is marked `replay`, unless that was allowed.

    A player publishes that mark before its first message. An emergency stop is obeyed whoever sends it.
    """

    def __init__(self, context: NodeContext, *, allow: bool) -> None:
        self._context = context
        self._allow = allow
        self._replayed: set[str] = set()
        self._reported: set[str] = set()

    def admits(self, received: Received) -> bool:
        """Return whether a message may be acted on; the first rejection of a source is reported as an event."""
        message = received.message
        if type(message) is NodeHealth:
            self._record(message)
            return True
        if self._allow or message.src not in self._replayed:
            return True
        if type(message) is SessionControl and message.command == "estop":
            return True
        self._report(message.src)
        return False

    def _record(self, health: NodeHealth) -> None:
        if health.replay:
            self._replayed.add(health.src)
        else:
            # the live node is back
            self._replayed.discard(health.src)
            self._reported.discard(health.src)

    def _report(self, source: str) -> None:
        if source not in self._reported:
            self._reported.add(source)
            text = f"commands of {source} come from a recording and are rejected (allow_replay is false)"
            self._context.event("fault", "warning", text, source=source)
