"""The interface of the sources of a page's messages: a running rig or a recording."""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

from services.viz_node.feed import SeenMessage
from telenano.serving.panels import installed_panels
from telenano.wire.errors import RefusedError

# Topics that are only drawn as curves: most of the traffic of a rig, and useless while no page is open.
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


# Topics from which the parts of the loop's age are computed.
AGE_TOPICS = ("haptic/state", "haptic/command", "afm/state", "link/delay")


def is_shown(topic: str) -> bool:
    """Return whether pages show a topic, themselves or in a panel of a package."""
    return topic in TOPICS_SHOWN or topic in installed_panels().topics


class Source(Protocol):
    """Messages to show."""

    def poll(self, *, watched: bool) -> Iterable[SeenMessage]:
        """Return the new messages without waiting; while no page watches, those for curves may be left out."""

    def take_restart(self) -> bool:
        """Return whether the next messages do not continue the previous ones, as after a seek; True only once."""

    def about(self) -> Mapping[str, Any]:
        """Return the facts on the source for pages: `kind` live or recording, and its position in time."""

    def transport(self, action: str, value: float) -> str:
        """Carry out an action of the transport and return a sentence; raise RefusedError if it is impossible."""

    def close(self) -> None:
        """Close connections and files."""


class NoTransport:
    """Base class of sources without a transport."""

    def transport(self, action: str, value: float) -> str:
        raise RefusedError(f"{action}: only a recording can be played or searched, and this is a running rig")

    def take_restart(self) -> bool:
        return False
