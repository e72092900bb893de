"""The last seconds in memory, for a recording that is to hold what came before its trigger."""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from recording.records import GapRecord, RejectedRecord


class Entry(NamedTuple):
    """A message (`stream` and payload) or a record of the recorder's own, with the time of its reception [ns]."""

    log_ns: int
    publish_ns: int
    seq: int
    payload: bytes
    stream: Any
    record: GapRecord | RejectedRecord | None


class SnapshotBuffer:
    """Entries of the last `length_s` seconds, and no more than `size_bytes` of payload, whichever is less."""

    def __init__(self, length_s: float, size_bytes: int) -> None:
        self._length_ns = round(length_s * 1e9)
        self._largest = size_bytes
        self._entries: deque[Entry] = deque()
        self.size_bytes = 0

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, entry: Entry) -> None:
        """Keep an entry and forget what is too old or too much."""
        self._entries.append(entry)
        self.size_bytes += len(entry.payload)
        oldest_ns = entry.log_ns - self._length_ns
        while self._entries and (self._entries[0].log_ns < oldest_ns or self.size_bytes > self._largest):
            self.size_bytes -= len(self._entries.popleft().payload)

    def take(self) -> list[Entry]:
        """Give everything and keep nothing."""
        entries = list(self._entries)
        self._entries.clear()
        self.size_bytes = 0
        return entries


Fields = Mapping[str, Any]
Happened = Callable[[str, Fields], bool]


def trigger(names: tuple[str, ...]) -> Happened:
    """Give the test of whether a message is one of the events that a snapshot is taken on.

    `mode`: a device changed mode; `fault`: a node reported a fault; `contact`: the tip snaps into contact.
    """
    touching: dict[str, bool] = {}

    def happened(topic: str, fields: Fields) -> bool:
        if topic == "session/event":
            return fields.get("kind") in names
        if topic == "afm/state" and "contact" in names:
            source, now = str(fields.get("src")), fields.get("in_contact") is True
            # the first state heard is where it starts, not a snap
            before = touching.get(source, now)
            touching[source] = now
            return now and not before
        return False

    return happened
