"""Where the messages of a page come from: a running rig or a recording, with the same interface."""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from services.viz_node.feed import SeenMessage
from telenano.serving.panels import installed_panels
from telenano.wire.errors import RefusedError

# what only curves are made of: most of the traffic of a rig, and of no use while no page is open
LOOP_TOPICS = ("haptic/state", "haptic/command", "afm/state", "law/status")
TOPICS_SHOWN = (
    *LOOP_TOPICS,
    "afm/scanline",
    "afm/program",
    "link/status",
    "link/network",
    "node/health",
    "session/event",
)


# of which the age of the loop is told by its parts
AGE_TOPICS = ("haptic/state", "haptic/command", "afm/state", "link/delay")


def is_shown(topic: str) -> bool:
    """Return whether pages are told of a topic, of their own or of a panel of a package."""
    return topic in TOPICS_SHOWN or topic in installed_panels().topics


class Source(Protocol):
    """Messages to show."""

    def poll(self, *, watched: bool) -> Iterable[SeenMessage]:
        """Return what has come since the last call, without waiting; unwatched, what curves are made of may be left."""

    def take_restart(self) -> bool:
        """Return, once, whether what comes now does not continue what came before, as after a seek."""

    def about(self) -> Mapping[str, Any]:
        """Return what the page says of the source: `kind` live or recording, and its place in time."""

    def transport(self, action: str, value: float) -> str:
        """Carry out an action of the transport and return a sentence; RefusedError says why not."""

    def close(self) -> None:
        """Let go of connections and files."""


class NoTransport:
    """What a source without a transport answers."""

    def transport(self, action: str, value: float) -> str:
        raise RefusedError(f"{action}: a running rig has no transport, only a recording can be played and sought in")

    def take_restart(self) -> bool:
        return False
