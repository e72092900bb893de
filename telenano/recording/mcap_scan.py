"""Scan of the outer structure of an MCAP file that may be unfinished, cut off anywhere or damaged."""

import importlib
import mmap
import struct
import zlib
from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass, field
from io import BytesIO
from itertools import chain
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from telenano.wire.errors import RecordingError

Bytes = bytes | mmap.mmap

MAGIC: bytes = MCAP0_MAGIC
# The format of a recording is in its metadata record `recording`; the first recordings lack the entry.
FORMAT = "1"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
# Message index of a channel behind a chunk: opcode, length, channel number, size of its entries.
INDEX_HEAD = struct.Struct("<BQHI")
# Footer: opcode, length, start of the summary and of its offsets, checksum.
_FOOTER = struct.Struct("<BQQQI")
# Chunk index in the summary: first and last time, offset, length, size of the map of message index offsets.
_CHUNK_INDEX = struct.Struct("<QQQQI")
# Entry of that map: channel number, then the offset of its index, which is skipped.
_NUMBER = struct.Struct("<H8x")
_CHUNK_HEAD = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_CRC = struct.Struct("<I")
_LONGEST_COMPRESSION_NAME = 8
# An unpacked chunk is in memory as a whole [bytes]. Ours have at most 64 MiB and one message of 16 MiB.
_LARGEST_CHUNK = 80 << 20
# The ratio applies only to chunks beyond the ordinary size (the default and one message), because zeros compress well.
_GREATEST_RATIO = 1000
_ORDINARY_CHUNK = 17 << 20
# Most different schemas and channels: a rig has some hundred, and each takes memory.
MOST_DEFINITIONS = 4096
_CONTENT = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_FIRST_PRIVATE_OPCODE = 0x80
_END_OF_TIME = 2**64
# Bytes of a mapped file that are in memory at once.
MOST_MAPPED = 16 << 20
# Errors that reading a damaged record can raise.
UNREADABLE = (McapError, struct.error, UnicodeDecodeError, MemoryError, OverflowError)


@dataclass(frozen=True, slots=True)
class Damage:
    """Range of unusable bytes in a file, and the reason."""

    offset: int
    size_bytes: int
    reason: str

    def __str__(self) -> str:
        return f"byte {self.offset}, {self.size_bytes} bytes: {self.reason}"


class Block(NamedTuple):
    """A chunk, or a single schema, channel or message outside of any chunk.

    `data_start` equals `offset` for a record outside of any chunk. `whole` is False for a chunk that is cut off.
    `first_ns` and `last_ns` bound the log times of its messages, so that a search can skip it.
    """

    offset: int
    data_start: int
    data_end: int
    compression: str = ""
    size_bytes: int = 0
    crc: int = 0
    whole: bool = True
    first_ns: int = 0
    last_ns: int = _END_OF_TIME


@dataclass
class Layout:
    """Structure of a file; `finished` is True if it was closed properly, with footer and end mark."""

    blocks: list[Block] = field(default_factory=list)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    summary_channels: dict[int, Channel] = field(default_factory=dict)
    summary_schemas: dict[int, Schema] = field(default_factory=dict)
    path: str = ""
    damage: list[Damage] = field(default_factory=list)
    finished: bool = False
    # Channel numbers of each chunk according to the summary, by the chunk's offset.
    indexed: dict[int, frozenset[int]] = field(default_factory=dict)
    channel_sets: dict[frozenset[int], frozenset[int]] = field(default_factory=dict)
    # Number of chunk indexes in the summary that name a chunk for a second time.
    repeated: int = 0
    # Whether the checksum of the summary is right and no damage precedes it.
    is_index_sound: bool = False

    def may_have(self, block: Block, selected: Iterable[int], known: Set[int]) -> bool:
        """Return whether a block may have messages of the selected channels or introduce a channel not yet known."""
        numbers = self.indexed.get(block.offset) if self.is_index_sound else None
        # No numbers: the writer made no message indexes for this chunk.
        return not numbers or not numbers.isdisjoint(selected) or not numbers <= known


def describe_damage(damage: Iterable[Damage]) -> tuple[str, ...]:
    """Return one line of text for each unusable part."""
    return tuple(map(str, damage))


class DamagedBlockError(Exception):
    """The content of a chunk cannot be read; the text is the reason."""


def too_many_definitions(path: str) -> RecordingError:
    """Return the error for a file with more than `MOST_DEFINITIONS` channels and schemas."""
    return RecordingError(f"{path}: has more than {MOST_DEFINITIONS} channels and schemas, which no recording has")


def scan(data: Bytes, path: str = "") -> Layout:
    """Scan the outer records of a file that starts with the magic bytes.

    After bytes that are not a record the scan continues with the next intact chunk.

    Raises:
        RecordingError: There are more than `MOST_DEFINITIONS` channels and schemas, or the format is a later one; the
            message names the path. Nothing else is raised.
    """
    layout, size = Layout(path=path), len(data)
    position = trusted = released = len(MAGIC)
    in_summary = False
    while position < size and not layout.finished:
        if position - released > MOST_MAPPED:
            release(data)
            released = position
        position = _behind_indexes(data, position)
        if position >= size:
            break
        opcode, end = _record_at(data, position)
        if end is None:
            position = trusted = _skip_damage(data, position, trusted, opcode, layout)
            continue
        if opcode != Opcode.CHUNK and chunk_at(data, position, end) is not None:
            layout.damage.append(Damage(position, 1, "the kind of a record is wrong: by its lengths it is a chunk"))
            opcode = Opcode.CHUNK
        if opcode == Opcode.FOOTER:
            layout.finished = data[end : end + len(MAGIC)] == MAGIC
            layout.is_index_sound = layout.finished and not layout.damage and _is_summary_sound(data, position)
            end += len(MAGIC) * layout.finished
        elif opcode == Opcode.DATA_END:
            in_summary = True
        elif opcode == Opcode.CHUNK or (opcode in _CONTENT and not in_summary):
            trusted = _add_block(data, position, end, opcode, layout)
        else:
            add_other(data, position, end, opcode, layout)
        position = end
    if position < size:
        layout.damage.append(Damage(position, size - position, "bytes after the end of the recording"))
    return layout


def _behind_indexes(data: Bytes, position: int) -> int:
    """Return the end of the message indexes that begin at a position, or the position itself if there are none."""
    size = len(data)
    while position + INDEX_HEAD.size <= size:
        opcode, length, _, entries_bytes = INDEX_HEAD.unpack_from(data, position)
        end: int = position + RECORD_HEAD.size + length
        # The size of the entries tells an index from a chunk whose opcode is damaged.
        if opcode != Opcode.MESSAGE_INDEX or position + INDEX_HEAD.size + entries_bytes != end or end > size:
            break
        position = end
    return position


def _is_summary_sound(data: Bytes, footer: int) -> bool:
    """Return whether there is a summary with a correct checksum; `footer` is the offset of the footer record."""
    if footer + _FOOTER.size > len(data):
        return False
    _, _, start, _, crc = _FOOTER.unpack_from(data, footer)
    return 0 < start < footer and bool(crc == zlib.crc32(data[start : footer + _FOOTER.size - _CRC.size]))


def release(data: Bytes) -> None:
    """Release the memory pages of a mapped file; later reads load them from the file again."""
    if isinstance(data, mmap.mmap) and hasattr(data, "madvise"):
        data.madvise(mmap.MADV_DONTNEED)


def unpack(data: Bytes, block: Block) -> bytes:
    """Return the uncompressed records of a block; for a chunk that is cut off, the bytes that can be decompressed.

    Raises:
        DamagedBlockError: The block is damaged; the message says what is wrong.
    """
    if block.data_start == block.offset:
        # The record is outside of any chunk.
        return data[block.data_start : block.data_end]
    _check_sizes(block)
    stored = data[block.data_start : block.data_end]
    try:
        content = _decompress(stored, block)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise DamagedBlockError(f"the chunk cannot be decompressed: {error}") from error
    # A checksum of 0 means that the writer made none.
    if block.whole and block.crc and zlib.crc32(content) != block.crc:
        raise DamagedBlockError("the checksum of the chunk is wrong")
    return content


def _check_sizes(block: Block) -> None:
    """Raise DamagedBlockError if the stated size of a chunk would fill the memory or is implausible."""
    stored = block.data_end - block.data_start
    if block.size_bytes > _LARGEST_CHUNK:
        text = f"it unpacks to {block.size_bytes} bytes, at most {_LARGEST_CHUNK} are read"
        raise DamagedBlockError(f"the chunk cannot be decompressed: {text}")
    if block.whole and block.size_bytes > max(_GREATEST_RATIO * stored, _ORDINARY_CHUNK):
        text = f"{stored} bytes unpack to {block.size_bytes}, at most {_GREATEST_RATIO} times as many are read"
        raise DamagedBlockError(f"the chunk cannot be decompressed: {text}")


def records_of(content: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of the body of each record in a chunk, up to bytes that are not a whole record."""
    position, size = 0, len(content) - RECORD_HEAD.size
    while position <= size:
        opcode, length = RECORD_HEAD.unpack_from(content, position)
        start = position + RECORD_HEAD.size
        position = start + length
        # 0 is no opcode, and a chunk of zeros has millions of them.
        if opcode == 0 or position > len(content) or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size):
            return
        yield opcode, start, position


def _record_at(data: Bytes, position: int) -> tuple[int, int | None]:
    """Return opcode and end of the record at `position`; the end is None if the bytes cannot be a whole record."""
    opcode = data[position]
    if position + RECORD_HEAD.size > len(data):
        return opcode, None
    end = position + RECORD_HEAD.size + _LENGTH.unpack_from(data, position + 1)[0]
    is_opcode = Opcode.HEADER <= opcode <= Opcode.DATA_END or opcode >= _FIRST_PRIVATE_OPCODE
    if not is_opcode or end > len(data) or (opcode == Opcode.CHUNK and chunk_at(data, position, end) is None):
        return opcode, None
    return opcode, end


def chunk_at(data: Bytes, position: int, end: int | None) -> Block | None:
    """Return the chunk at `position`, None if its lengths disagree; `end` is None if the file ends within it."""
    body = position + RECORD_HEAD.size
    if body + _CHUNK_HEAD.size > len(data):
        return None
    first_ns, last_ns, size, crc, name_length = _CHUNK_HEAD.unpack_from(data, body)
    data_start = body + _CHUNK_HEAD.size + name_length + _LENGTH.size
    if name_length > _LONGEST_COMPRESSION_NAME or data_start > len(data):
        return None
    name = data[body + _CHUNK_HEAD.size : data_start - _LENGTH.size].decode("ascii", "replace")
    stored_end = data_start + _LENGTH.unpack_from(data, data_start - _LENGTH.size)[0]
    if end is None:
        return Block(position, data_start, len(data), name, size, crc, whole=False) if stored_end > len(data) else None
    if stored_end != end:
        return None
    return Block(position, data_start, stored_end, name, size, crc, first_ns=first_ns, last_ns=last_ns)


def _add_block(data: Bytes, position: int, end: int, opcode: int, layout: Layout) -> int:
    """Add a chunk, or a record outside of any chunk, as a block; return its end."""
    if opcode == Opcode.CHUNK:
        block = chunk_at(data, position, end)
        if block is not None:
            layout.blocks.append(block)
    else:
        layout.blocks.append(Block(position, position, end))
    return end


def add_other(data: Bytes, position: int, end: int, opcode: int, layout: Layout) -> None:
    """Add a record other than a block to the layout, and any damage of it.

    Raises:
        RecordingError: There are more than `MOST_DEFINITIONS` channels and schemas, or the format is a later one.
    """
    body = data[position + RECORD_HEAD.size : end]
    try:
        if opcode == Opcode.ATTACHMENT and not _attachment_intact(body):
            name = Attachment.read(ReadDataStream(BytesIO(body))).name
            text = f"the checksum of the attachment {name} is wrong"
            layout.damage.append(Damage(position, end - position, text))
        add_record(opcode, body, layout)
    except UNREADABLE as error:
        layout.damage.append(Damage(position, end - position, f"a damaged record: {type(error).__name__}"))


def add_record(opcode: int, body: bytes, layout: Layout) -> None:
    """Add an attachment, metadata, channel, schema or chunk index to the layout; ignore other records.

    Raises:
        RecordingError: There are more than `MOST_DEFINITIONS` channels and schemas, or the format is a later one.
    """
    stream = ReadDataStream(BytesIO(body))
    if opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        layout.attachments[attachment.name] = attachment
    elif opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        layout.metadata[metadata.name] = metadata.metadata
        if metadata.name == "recording" and (format_read := metadata.metadata.get("format", FORMAT)) != FORMAT:
            text = f"is a recording of format {format_read[:20]}, and format {FORMAT} is known here: update telenano"
            raise RecordingError(f"{layout.path}: {text}")
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        layout.summary_channels[channel.id] = channel
    elif opcode == Opcode.SCHEMA:
        schema = Schema.read(stream)
        layout.summary_schemas[schema.id] = schema
    elif opcode == Opcode.CHUNK_INDEX:
        _, _, place, _, size = _CHUNK_INDEX.unpack_from(body)
        layout.repeated += place in layout.indexed
        indexes = body[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size]
        numbers = (
            frozenset(chain.from_iterable(_NUMBER.iter_unpack(indexes)))
            if len(indexes) == size and size % _NUMBER.size == 0
            else frozenset[int]()
        )
        # Most chunks have the same channels, so equal sets are shared.
        layout.indexed[place] = layout.channel_sets.setdefault(numbers, numbers)
    if len(layout.summary_channels) + len(layout.summary_schemas) > MOST_DEFINITIONS:
        raise too_many_definitions(layout.path)


def _attachment_intact(body: bytes) -> bool:
    """Return whether an attachment agrees with the checksum at its end; 0 means that the writer made none."""
    (crc,) = _CRC.unpack_from(body, len(body) - _CRC.size)
    return crc in (0, zlib.crc32(body[: -_CRC.size]))


def _skip_damage(data: Bytes, position: int, trusted: int, opcode: int, layout: Layout) -> int:
    """Record the damage at `position` and return the position where the scan continues."""
    # A wrong length may have skipped intact chunks, so the search begins after the last intact one.
    chunk = _next_chunk(data, trusted, position)
    if chunk is not None:
        start = position if chunk > position else trusted
        layout.damage.append(Damage(start, chunk - start, "bytes that are not a record"))
        return chunk
    block = chunk_at(data, position, None) if opcode == Opcode.CHUNK else None
    if block is not None:
        layout.blocks.append(block)
    reason = "the file ends within a chunk, whose beginning was read" if block else "the file ends within a record"
    layout.damage.append(Damage(position, len(data) - position, reason))
    return len(data)


def _next_chunk(data: Bytes, start: int, damaged: int) -> int | None:
    for candidate in _chunk_candidates(data, start):
        end = candidate + RECORD_HEAD.size + _LENGTH.unpack_from(data, candidate + 1)[0]
        block = chunk_at(data, candidate, end) if end <= len(data) and candidate != damaged else None
        if block is not None and block.crc:
            try:
                unpack(data, block)
            except DamagedBlockError:
                continue
            return candidate
    return None


def _chunk_candidates(data: Bytes, start: int) -> Iterator[int]:
    mark = bytes([Opcode.CHUNK])
    candidate = data.find(mark, start)
    while 0 <= candidate <= len(data) - RECORD_HEAD.size:
        yield candidate
        candidate = data.find(mark, candidate + 1)


def _decompress(stored: bytes, block: Block) -> bytes:
    """Return the content of a chunk, of exactly the stated size; for a chunk that is cut off, the part in the file."""
    content = _unpacked(stored, block)
    if block.whole and len(content) != block.size_bytes:
        raise DamagedBlockError("the sizes in the chunk are inconsistent")
    return content[: block.size_bytes]


def _unpacked(stored: bytes, block: Block) -> bytes:
    # At most one byte more than stated is unpacked, which suffices to detect a surplus.
    most = block.size_bytes + 1
    if block.compression == "":
        return stored
    if block.compression == "zstd":
        if not block.whole:
            return zstandard.ZstdDecompressor().stream_reader(stored).read(most)
        if zstandard.frame_content_size(stored) not in (-1, block.size_bytes):
            raise DamagedBlockError("the sizes in the chunk are inconsistent")
        return zstandard.ZstdDecompressor().decompress(stored, max_output_size=most)
    if block.compression == "lz4":
        # Imported by name because the package has no types.
        lz4 = importlib.import_module("lz4.frame")
        content: bytes = lz4.LZ4FrameDecompressor().decompress(stored, max_length=most)
        return content
    raise DamagedBlockError(f"unknown compression {block.compression!r}; supported are zstd and lz4")
