"""A recording that is read from its file once, however often it is asked for: most of a re-run's time is reading."""

from collections.abc import Iterator, Mapping
from copy import copy
from pathlib import Path
from typing import Any

import msgpack

from telenano.recording.messages import ChannelFilter, RecordedMessage
from telenano.recording.reader import DamageCallback, Recording


class InMemory(Recording):
    """Keeps the messages of a recording, those of its first `end_s` [s] only where that is given."""

    def __init__(self, path: Path, end_s: float | None = None) -> None:
        super().__init__(path)
        end_ns = None if end_s is None else self.span_ns[0] + round(end_s * 1e9)
        self._messages = tuple(super().select(end_ns=end_ns))
        self._attached: dict[str, bytes] = {}

    def edited(self, topic: str, fields: Mapping[str, Any]) -> "InMemory":
        """Return a copy in which every message on a topic has these fields besides its own, or in their place."""
        copied = copy(self)
        copied._messages = tuple(
            found._replace(payload=msgpack.packb({**found.fields(), **fields})) if found.topic == topic else found
            for found in self._messages
        )
        return copied

    def without(self, topic: str, begin_s: float, end_s: float) -> "InMemory":
        """Return a copy that lacks the messages of a topic from `begin_s` until before `end_s` of the recording [s]."""
        begin_ns, end_ns = (self.span_ns[0] + round(at_s * 1e9) for at_s in (begin_s, end_s))
        copied = copy(self)
        copied._messages = tuple(
            found for found in self._messages if found.topic != topic or not begin_ns <= found.log_ns < end_ns
        )
        return copied

    def attaching(self, name: str, data: bytes) -> "InMemory":
        """Return a copy that has these data attached under a name."""
        copied = copy(self)
        copied._attached = {**self._attached, name: data}
        return copied

    @property
    def attachments(self) -> dict[str, bytes]:
        return {**super().attachments, **self._attached}

    def select(
        self,
        wanted: ChannelFilter | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        report: DamageCallback | None = None,
        blocks: object = None,
    ) -> Iterator[RecordedMessage]:
        chosen = {channel for channel in self.channels if wanted is None or wanted(channel)}
        first, after = start_ns or 0, 2**64 if end_ns is None else end_ns
        return (found for found in self._messages if found.channel in chosen and first <= found.log_ns < after)
