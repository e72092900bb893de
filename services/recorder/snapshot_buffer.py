"""Buffer of the last seconds, for a recording that has to contain what came before its trigger."""

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
        self._max_bytes = size_bytes
        self._entries: deque[Entry] = deque()
        self.size_bytes = 0

    def __len__(self) -> int:
        return len(self._entries)

    def add(self, entry: Entry) -> None:
        """Append an entry and drop the oldest beyond the limits of time and size."""
        self._entries.append(entry)
        self.size_bytes += len(entry.payload)
        oldest_ns = entry.log_ns - self._length_ns
        while self._entries and (self._entries[0].log_ns < oldest_ns or self.size_bytes > self._max_bytes):
            self.size_bytes -= len(self._entries.popleft().payload)

    def drain(self) -> list[Entry]:
        entries = list(self._entries)
        self._entries.clear()
        self.size_bytes = 0
        return entries


Fields = Mapping[str, Any]
# what a trigger can be on
TRIGGER_TOPICS = ("session/event", "afm/state")
Trigger = Callable[[str, Fields], bool]


def event_trigger(names: tuple[str, ...]) -> Trigger:
    """Return the predicate: whether a message is one of the events that trigger a snapshot.

    `mode`: a device changed mode; `fault`: a node reported a fault; `contact`: the tip snaps into contact.
    """
    in_contact: dict[str, bool] = {}

    def is_trigger(topic: str, fields: Fields) -> bool:
        if topic == "session/event":
            return fields.get("kind") in names
        if topic == "afm/state" and "contact" in names:
            source, now = str(fields.get("src")), fields.get("in_contact") is True
            # the first state received is where it starts, not a snap-in
            before = in_contact.get(source, now)
            in_contact[source] = now
            return now and not before
        return False

    return is_trigger
