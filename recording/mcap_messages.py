"""mcap's writer for a rig, which records ten thousand messages a second, and six chunks a second for hours."""

import struct
from typing import Any

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import ChunkIndex, MessageIndex
from mcap.writer import Writer

# opcode, length of what follows, channel, sequence, log time, publish time
_MESSAGE = struct.Struct("<BQHIQQ")
_FIXED_BYTES = _MESSAGE.size - 9


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


class MessageWriter(Writer):
    """A `Writer` that packs a message at once: the library's own packs each field by itself, four times as long.

    What it keeps of each chunk for the end of the file is packed as well. The bytes of the file are the same. What it
    uses of the library's inside is looked for when it is made, and where it is not as expected, messages go the
    library's way.
    """

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        inside = vars(self)
        self._chunk: Any = inside.get("_Writer__chunk_builder")
        self._counts: Any = inside.get("_Writer__statistics")
        self._end_chunk_if_full: Any = getattr(self, "_Writer__maybe_finalize_chunk", None)
        if inside.get("_Writer__chunk_indices") == []:
            vars(self)["_Writer__chunk_indices"] = _ChunkIndices()
        parts = ("message_indices", "num_messages", "message_start_time", "message_end_time", "record_writer")
        counts = ("message_count", "message_start_time", "message_end_time", "channel_message_counts")
        self.is_quick = (
            self._end_chunk_if_full is not None
            and all(hasattr(self._chunk, name) for name in parts)
            and all(hasattr(self._counts, name) for name in counts)
        )

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Add a message to the chunk in hand."""
        if not self.is_quick:
            super().add_message(channel_id, log_time, data, publish_time, sequence)
            return
        chunk, counts = self._chunk, self._counts
        for times, count in ((counts, counts.message_count), (chunk, chunk.num_messages)):
            if count == 0 or log_time < times.message_start_time:
                times.message_start_time = log_time
            if log_time > times.message_end_time:
                times.message_end_time = log_time
        counts.message_count += 1
        counts.channel_message_counts[channel_id] += 1
        chunk.num_messages += 1
        index = chunk.message_indices.get(channel_id)
        if index is None:
            index = chunk.message_indices[channel_id] = MessageIndex(channel_id=channel_id, records=[])
        records = chunk.record_writer
        index.records.append((log_time, records.count))
        head = _MESSAGE.pack(Opcode.MESSAGE, _FIXED_BYTES + len(data), channel_id, sequence, log_time, publish_time)
        records.write(head + data)
        self._end_chunk_if_full()
