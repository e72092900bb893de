"""One direction of the link in the time of a test, and the fates of a stream of messages."""

from pathlib import Path
from typing import Any

from telenano.link.direction import DirectionEngine
from telenano.link.fate import Fate, Release
from telenano.settings.link_settings import LinkSettings

MS = 1_000_000
START = 1_700_000_000_000_000_000
TOPIC = "teleop/forward"


def engine(folder: Path | None = None, seed: int = 0, **forward: Any) -> DirectionEngine:
    """Return the engine of the forward direction; `folder` contains the files that its settings name."""
    settings = LinkSettings.of({"seed": seed, "forward": forward})
    return DirectionEngine("forward", settings, START, folder=folder or Path())


def finish(link: DirectionEngine) -> list[Release]:
    """Return all pending messages of the link, in the order of their release."""
    released: list[Release] = []
    while (next_ns := link.next_release_ns()) is not None:
        released += link.due(next_ns)
    return released


def stream(
    count: int, folder: Path | None = None, *, seed: int = 0, topic: str = TOPIC, period_ns: int = MS, size: int = 100,
    **forward: Any,
) -> list[Fate]:  # fmt: skip
    """Return the fates of messages of a size [bytes], of which one comes in each period [ns]."""
    settings = LinkSettings.of({"seed": seed, "forward": forward})
    arrivals = range(START, START + count * period_ns, period_ns)
    return DirectionEngine.fates(settings, "forward", topic, arrivals, size, folder=folder or Path())
