"""What keeps the messages of a recording away from a device."""

from proto.messages import NodeHealth, SessionControl
from services.runtime.bus import Received
from services.runtime.node import NodeContext


class ReplayGuard:
    """Refuses what publishers say whose `node/health` is marked `replay`, unless that was allowed.

    A player says so before its first message. An emergency stop is obeyed whoever sends it.
    """

    def __init__(self, context: NodeContext, *, allow: bool) -> None:
        self._context = context
        self._allow = allow
        self._replayed: set[str] = set()
        self._told: set[str] = set()

    def admits(self, received: Received) -> bool:
        """Say whether a message may be acted on; the first one of a source that may not is told as an event."""
        message = received.message
        if isinstance(message, NodeHealth):
            self._enter(message)
            return True
        if self._allow or message.src not in self._replayed:
            return True
        if isinstance(message, SessionControl) and message.command == "estop":
            return True
        self._tell(message.src)
        return False

    def _enter(self, health: NodeHealth) -> None:
        if health.replay:
            self._replayed.add(health.src)
        else:
            # the live node is back
            self._replayed.discard(health.src)
            self._told.discard(health.src)

    def _tell(self, source: str) -> None:
        if source not in self._told:
            self._told.add(source)
            text = f"commands of {source} come from a recording and are refused (allow_replay is false)"
            self._context.event("fault", "warning", text, source=source)
