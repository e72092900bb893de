"""mcap's writer for a rig, which records ten thousand messages a second, and six chunks a second for hours."""

import struct
from typing import Any

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.writer import Writer

# opcode, length of what follows, channel, sequence, log time, publish time
_MESSAGE = struct.Struct("<BQHIQQ")
_pack_message = _MESSAGE.pack
# the same of many messages
HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("seq", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
# a number is packed in less time than a member of an enumeration
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
# the payload keeps the whole number
_SEQUENCE_MASK = 0xFFFF_FFFF
# opcode and length
_HEAD_BYTES = 9
_FIXED_BYTES = _MESSAGE.size - _HEAD_BYTES
_RECORD_BYTES = _MESSAGE.size
# time of reception and place of a message in an index
_ENTRY_BYTES = 16
# opcode, length of what follows, channel, size of the index
_INDEX_HEAD = struct.Struct("<BQHI")


class _Packed:
    """A record as the bytes that it is in the file."""

    __slots__ = ("_record",)

    def __init__(self, index: ChunkIndex) -> None:
        # The library declares no types for it.
        builder: Any = RecordBuilder()
        index.write(builder)
        self._record = bytes(builder.end())

    def write(self, stream: RecordBuilder) -> None:
        stream.write(self._record)


class _ChunkIndices(list[_Packed]):
    """The index of the chunks for the end of the file, in less than half of the memory that the library takes."""

    def append(self, index: Any) -> None:
        super().append(_Packed(index))


class _ChannelIndex:
    """The index of one channel's messages in a chunk, packed: time of reception [ns] and place of each."""

    __slots__ = ("_channel", "_entries")

    def __init__(self, channel: int, entries: bytes) -> None:
        self._channel = channel
        self._entries = entries

    def extend(self, entries: bytes) -> None:
        self._entries += entries

    def write(self, stream: RecordBuilder) -> None:
        size = len(self._entries)
        head = _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, _INDEX_HEAD.size - _HEAD_BYTES + size, self._channel, size)
        stream.write(head + self._entries)


class MessageWriter(Writer):
    """A `Writer` that keeps heads and payloads of a chunk in a list and joins them once, when the chunk ends.

    The library's own packs each field of a message by itself and copies it into a stream, six times as long. What this
    one keeps of each chunk for the end of the file is packed as well. The bytes of the file are the same. What it uses
    of the library's inside is looked for when it is made, and where it is not as expected, messages go the library's
    way.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        inside = vars(self)
        self._chunk: Any = inside.get("_Writer__chunk_builder")
        self._counts: Any = inside.get("_Writer__statistics")
        self._end_chunk: Any = getattr(self, "_Writer__finalize_chunk", None)
        self._chunk_size: Any = inside.get("_Writer__chunk_size")
        if inside.get("_Writer__chunk_indices") == []:
            vars(self)["_Writer__chunk_indices"] = _ChunkIndices()
        parts = ("message_indices", "num_messages", "message_start_time", "message_end_time", "record_writer")
        counts = ("message_count", "message_start_time", "message_end_time", "channel_message_counts")
        self.is_quick = (
            self._end_chunk is not None
            and type(self._chunk_size) is int
            and all(hasattr(self._chunk, name) for name in parts)
            and all(hasattr(self._counts, name) for name in counts)
        )
        # head and payload of each message that the chunk builder does not have yet
        self._parts: list[bytes] = []
        self._append = self._parts.append
        # bytes in the chunk, those included
        self._size = 0

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Add a message to the chunk in hand; of its number the lower 32 bits, for which there is room."""
        sequence &= _SEQUENCE_MASK
        if not self.is_quick:
            super().add_message(channel_id, log_time, data, publish_time, sequence)
            return
        size = len(data)
        self._append(_pack_message(_MESSAGE_OPCODE, _FIXED_BYTES + size, channel_id, sequence, log_time, publish_time))
        self._append(data)
        self._size = size = self._size + _RECORD_BYTES + size
        if size > self._chunk_size:
            self._join()
            self._end_chunk()
            self._size = 0

    @property
    def message_count(self) -> int:
        """Messages added so far."""
        return int(self._counts.message_count) + len(self._parts) // 2

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema to the chunk in hand, behind its messages."""
        self._join()
        number: int = super().register_schema(name, encoding, data)
        self._measure()
        return number

    def register_channel(self, topic: str, message_encoding: str, schema_id: int, metadata: Any = None) -> int:
        """Add a channel to the chunk in hand, behind its messages."""
        self._join()
        number: int = super().register_channel(topic, message_encoding, schema_id, metadata or {})
        self._measure()
        return number

    def flush(self) -> None:
        """Write the chunk in hand and hand everything to the stream."""
        self._join()
        super().flush()  # type: ignore[no-untyped-call]
        self._measure()

    def finish(self) -> None:
        """Write the chunk in hand, indexes and statistics."""
        self._join()
        super().finish()  # type: ignore[no-untyped-call]

    def _join(self) -> None:
        """Give the chunk builder the messages that it does not have yet, with their index and counts."""
        if not self._parts:
            return
        chunk, counts = self._chunk, self._counts
        heads = np.frombuffer(b"".join(self._parts[::2]), dtype=HEADS)
        ends = chunk.record_writer.count + np.cumsum(heads["length"] + np.uint64(_HEAD_BYTES))
        entries = np.column_stack((heads["log_ns"], ends - heads["length"] - np.uint64(_HEAD_BYTES))).astype("<u8")
        chunk.record_writer.write(b"".join(self._parts))
        self._parts.clear()
        by_channel = np.argsort(heads["channel"], kind="stable")
        channels, packed = heads["channel"][by_channel], entries[by_channel].tobytes()
        starts = np.flatnonzero(np.diff(channels, prepend=-1))
        ends_of = np.append(starts[1:], len(channels))
        # in the order in which the channels come in the chunk
        for which in np.argsort(by_channel[starts]).tolist():
            channel, start, end = int(channels[starts[which]]), int(starts[which]), int(ends_of[which])
            own = packed[start * _ENTRY_BYTES : end * _ENTRY_BYTES]
            if channel in chunk.message_indices:
                chunk.message_indices[channel].extend(own)
            else:
                chunk.message_indices[channel] = _ChannelIndex(channel, own)
            counts.channel_message_counts[channel] += end - start
        first_ns, last_ns = int(heads["log_ns"].min()), int(heads["log_ns"].max())
        for bounds, count in ((counts, counts.message_count), (chunk, chunk.num_messages)):
            bounds.message_start_time = first_ns if count == 0 else min(bounds.message_start_time, first_ns)
            bounds.message_end_time = max(bounds.message_end_time, last_ns)
        counts.message_count += len(heads)
        chunk.num_messages += len(heads)

    def _measure(self) -> None:
        if self.is_quick:
            self._size = self._chunk.record_writer.count
