"""A fast MCAP writer: a rig records ten thousand messages a second, and six chunks a second for hours."""

import importlib
import struct
import zlib
from collections.abc import Callable
from typing import IO, Any, Literal

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from telenano.recording.mcap_scan import INDEX_HEAD

Compression = Literal["zstd", "lz4", "none"]
_COMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "zstd": zstandard.compress,
    "lz4": lambda data: importlib.import_module("lz4.frame").compress(data),
    "none": bytes,
}
# opcode, length of what follows, channel, sequence, log time, publish time
_MESSAGE = struct.Struct("<BQHIQQ")
_pack_message = _MESSAGE.pack
# The same head as the type of an array of messages.
HEADS = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("seq", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
# An int is packed faster than a member of an enumeration.
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
# The sequence field of MCAP has 32 bits; the payload keeps the whole number.
_SEQUENCE_MASK = 0xFFFF_FFFF
# opcode and length
_HEAD_BYTES = 9
_FIXED_BYTES = _MESSAGE.size - _HEAD_BYTES
_RECORD_BYTES = _MESSAGE.size
# time of reception and place of a message in an index
_ENTRY_BYTES = 16
# opcode, length of what follows, start of the summary and of its offsets
_FOOTER_HEAD = struct.Struct("<BQQQ")


class MessageWriter:
    """Writer that collects heads and payloads in a list and joins them once, at the end of each chunk.

    The file equals that of `mcap.writer.Writer` byte for byte, with all indexes and checksums. That writer packs each
    field of a message separately and copies it into a stream, which takes six times as long. Records for the end of the
    file are kept packed, in less than half of the memory. Every method passes on the OSError of its stream.
    """

    def __init__(self, stream: IO[bytes], chunk_size: int = 1 << 20, compression: Compression = "zstd") -> None:
        """Write to a stream at its start; a chunk ends above `chunk_size` [bytes]."""
        self._stream = stream
        self._chunk_size = chunk_size
        self._compression = compression
        self._place = self._crc = 0
        self._schemas: list[bytes] = []
        self._channels: list[bytes] = []
        self._chunk_indexes: list[bytes] = []
        self._attachment_indexes: list[bytes] = []
        self._metadata_indexes: list[bytes] = []
        self._counts: dict[int, int] = {}
        self._joined_count = 0
        # Least and greatest reception time [ns], of the file and of the current chunk.
        self._span_ns: tuple[int, int] | None = None
        self._chunk_span_ns: tuple[int, int] | None = None
        # The current chunk, and the index of its messages by channel.
        self._chunk = bytearray()
        self._entries: dict[int, bytearray] = {}
        # Head and payload of each message that is not joined to the chunk yet.
        self._parts: list[bytes] = []
        self._append = self._parts.append
        # Size of the chunk, including the messages not joined yet [bytes].
        self._size = 0

    def start(self, profile: str = "") -> None:
        """Write the head of the file."""
        self._write(MCAP0_MAGIC + _packed(records.Header(profile, "telenano")))

    def add_message(self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int = 0) -> None:
        """Add a message to the current chunk, with the lower 32 bits of its sequence number; times are in ns."""
        size = len(data)
        sequence &= _SEQUENCE_MASK
        self._append(_pack_message(_MESSAGE_OPCODE, _FIXED_BYTES + size, channel_id, sequence, log_time, publish_time))
        self._append(data)
        self._size = size = self._size + _RECORD_BYTES + size
        if size > self._chunk_size:
            self._end_chunk()

    @property
    def message_count(self) -> int:
        """Messages added so far."""
        return self._joined_count + len(self._parts) // 2

    def register_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Add a schema to the current chunk, behind its messages, and return its number."""
        number = len(self._schemas) + 1
        self._register(self._schemas, records.Schema(id=number, name=name, encoding=encoding, data=data))
        return number

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] | None = None
    ) -> int:
        """Add a channel to the current chunk, behind its messages, and return its number."""
        number = len(self._channels) + 1
        self._register(self._channels, records.Channel(number, topic, message_encoding, metadata or {}, schema_id))
        return number

    def add_attachment(self, create_time: int, log_time: int, name: str, media_type: str, data: bytes) -> None:
        """Write an attachment to the stream, before the current chunk; times are in ns."""
        record = _packed(records.Attachment(create_time, log_time, name, media_type, data))
        index = records.AttachmentIndex(
            self._place, len(record), log_time, create_time, data_size=len(data), name=name, media_type=media_type
        )
        self._attachment_indexes.append(_packed(index))
        self._write(record)

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Write a metadata record to the stream, before the current chunk."""
        record = _packed(records.Metadata(name=name, metadata=data))
        self._metadata_indexes.append(_packed(records.MetadataIndex(offset=self._place, length=len(record), name=name)))
        self._write(record)

    def flush(self) -> None:
        """Write the current chunk and flush the stream."""
        self._end_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the current chunk, the summary with indexes and statistics, and the footer."""
        self._end_chunk()
        self._write(_packed(records.DataEnd(self._crc)))
        first_ns, last_ns = self._span_ns or (0, 0)
        statistics = records.Statistics(
            schema_count=len(self._schemas), channel_count=len(self._channels), chunk_count=len(self._chunk_indexes),
            attachment_count=len(self._attachment_indexes), metadata_count=len(self._metadata_indexes),
            message_count=self._joined_count, channel_message_counts=self._counts,
            message_start_time=first_ns, message_end_time=last_ns,
        )  # fmt: skip
        groups = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [_packed(statistics)],
            Opcode.CHUNK_INDEX: self._chunk_indexes,
            Opcode.ATTACHMENT_INDEX: self._attachment_indexes,
            Opcode.METADATA_INDEX: self._metadata_indexes,
        }
        start = self._place
        summary, offsets = bytearray(), bytearray()
        for opcode, packed in groups.items():
            group = b"".join(packed)
            offsets += _packed(records.SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offsets_start = start + len(summary)
        head = _FOOTER_HEAD.pack(Opcode.FOOTER, 20, start, offsets_start)
        crc = zlib.crc32(head, zlib.crc32(offsets, zlib.crc32(summary)))
        self._write(summary + offsets + _packed(records.Footer(start, offsets_start, crc)) + MCAP0_MAGIC)

    def _register(self, registered: list[bytes], record: records.McapRecord) -> None:
        registered.append(_packed(record))
        self._join()
        self._chunk += registered[-1]
        self._size = len(self._chunk)
        if self._size > self._chunk_size:
            self._end_chunk()

    def _end_chunk(self) -> None:
        """Write the current chunk with its indexes; a chunk without a message is kept until it has one."""
        self._join()
        if self._chunk_span_ns is None:
            return
        data = bytes(self._chunk)
        compression = "" if self._compression == "none" else self._compression
        compressed = _COMPRESS[self._compression](data)
        first_ns, last_ns = self._chunk_span_ns
        record = _packed(
            records.Chunk(compression, compressed, last_ns, first_ns, zlib.crc32(data), uncompressed_size=len(data))
        )
        start = self._place
        self._write(record)
        indexes, index_start, places = bytearray(), self._place, {}
        for channel, entries in self._entries.items():
            places[channel] = index_start + len(indexes)
            size = len(entries)
            indexes += INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, INDEX_HEAD.size - _HEAD_BYTES + size, channel, size)
            indexes += entries
        index = records.ChunkIndex(
            chunk_start_offset=start, chunk_length=len(record), compression=compression,
            compressed_size=len(compressed), uncompressed_size=len(data),
            message_index_offsets=places, message_index_length=len(indexes),
            message_start_time=first_ns, message_end_time=last_ns,
        )  # fmt: skip
        self._write(indexes)
        self._chunk_indexes.append(_packed(index))
        self._chunk.clear()
        self._entries.clear()
        self._chunk_span_ns = None
        self._size = 0

    def _join(self) -> None:
        """Join the collected messages to the current chunk and update index, counts and time spans."""
        if not self._parts:
            return
        heads = np.frombuffer(b"".join(self._parts[::2]), dtype=HEADS)
        ends = len(self._chunk) + np.cumsum(heads["length"] + np.uint64(_HEAD_BYTES))
        entries = np.column_stack((heads["log_ns"], ends - heads["length"] - np.uint64(_HEAD_BYTES))).astype("<u8")
        self._chunk += b"".join(self._parts)
        self._parts.clear()
        by_channel = np.argsort(heads["channel"], kind="stable")
        channels, packed = heads["channel"][by_channel], entries[by_channel].tobytes()
        starts = np.flatnonzero(np.diff(channels, prepend=-1))
        ends_of = np.append(starts[1:], len(channels))
        # In the order in which the channels first occur, as `mcap.writer.Writer` does.
        for which in np.argsort(by_channel[starts]).tolist():
            channel, start, end = int(channels[starts[which]]), int(starts[which]), int(ends_of[which])
            self._entries.setdefault(channel, bytearray()).extend(packed[start * _ENTRY_BYTES : end * _ENTRY_BYTES])
            self._counts[channel] = self._counts.get(channel, 0) + end - start
        first_ns, last_ns = int(heads["log_ns"].min()), int(heads["log_ns"].max())
        self._span_ns, self._chunk_span_ns = (
            (first_ns, last_ns) if span is None else (min(span[0], first_ns), max(span[1], last_ns))
            for span in (self._span_ns, self._chunk_span_ns)
        )
        self._joined_count += len(heads)

    def _write(self, data: bytes | bytearray) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._stream.write(data)
        self._place += len(data)


def _packed(record: records.McapRecord) -> bytes:
    # The `mcap` package declares no types for it.
    builder: Any = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())
