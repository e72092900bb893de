"""Fast reading of the message heads of a chunk through the message indexes behind it, after checking them.

Walking the records of a chunk takes about a microsecond each. The writer puts an index of each channel's messages
behind the chunk, from which all heads are read in a tenth of that time. An index may be wrong, so it is verified: its
entries must be messages of its channel that do not overlap, with only schemas and channels between them. If that does
not hold, the caller walks the records.
"""

import mmap
from collections.abc import Container
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode

from telenano.recording.mcap_messages import HEADS
from telenano.recording.mcap_scan import INDEX_HEAD, MESSAGE_HEAD, RECORD_HEAD, records_of

_ENTRY_BYTES = 16
# A chunk with more definitions between its messages is walked instead.
_MOST_DEFINITIONS = 256

Column = npt.NDArray[np.int64]


class Definition(NamedTuple):
    """A schema or channel in a chunk: index of the message that it precedes, opcode, start and end of its body."""

    before: int
    opcode: int
    start: int
    end: int


class ChunkMessages(NamedTuple):
    """Messages in the order of the chunk: heads of type `HEADS`, start and end of each payload, and the definitions."""

    heads: npt.NDArray[np.void]
    starts: Column
    ends: Column
    definitions: tuple[Definition, ...]


def messages_in(
    data: mmap.mmap, place: int, content: bytes, wanted: Container[int] | None = None
) -> ChunkMessages | None:
    """Return the messages in a chunk; None if the indexes do not agree with its content.

    Args:
        data: The file.
        place: Offset of the end of the chunk, where its indexes begin.
        content: The uncompressed records of the chunk.
        wanted: Numbers of the channels to return; only for a chunk that was verified as a whole before. None for all.
    """
    entries = _entries(data, place, len(content) // HEADS.itemsize, wanted)
    if entries is None:
        return None
    numbers, places = entries
    last = len(content) - HEADS.itemsize
    if places.size and not 0 <= places.min() <= places.max() <= last:
        return None
    # A head may begin at any byte, so this array has one (overlapping) head for each byte.
    heads = np.ndarray((max(0, last + 1),), HEADS, content, strides=(1,))[places]
    begins = places + RECORD_HEAD.size
    if np.any(heads["opcode"] != Opcode.MESSAGE) or np.any(heads["channel"] != numbers):
        return None
    lengths = heads["length"]
    if np.any(lengths < MESSAGE_HEAD.size) or np.any(lengths > (len(content) - begins).astype(np.uint64)):
        return None
    ends = begins + lengths.astype(np.int64)
    if np.any(places[1:] < ends[:-1]):
        return None
    definitions = _definitions(content, places, ends) if wanted is None else ()
    return None if definitions is None else ChunkMessages(heads, begins + MESSAGE_HEAD.size, ends, definitions)


def _entries(
    data: mmap.mmap, place: int, most: int, wanted: Container[int] | None
) -> tuple[npt.NDArray[np.int64], Column] | None:
    """Return channel number and offset of each message in the indexes behind a chunk, in order of the offsets.

    None if they have more entries than the chunk has room for messages, or an incomplete entry.
    """
    numbers: list[int] = []
    parts: list[bytes] = []
    size = len(data)
    while place + INDEX_HEAD.size <= size:
        opcode, length, number, entries_bytes = INDEX_HEAD.unpack_from(data, place)
        end = place + RECORD_HEAD.size + length
        if opcode != Opcode.MESSAGE_INDEX or place + INDEX_HEAD.size + entries_bytes != end or end > size:
            break
        most -= entries_bytes // _ENTRY_BYTES
        if most < 0 or entries_bytes % _ENTRY_BYTES:
            return None
        if wanted is None or number in wanted:
            numbers.append(number)
            parts.append(data[place + INDEX_HEAD.size : end])
        place = end
    places = np.frombuffer(b"".join(parts), dtype="<i8")[1::2]
    order = np.argsort(places, kind="stable")
    channels = np.repeat(np.array(numbers, dtype=np.int64), [len(part) // _ENTRY_BYTES for part in parts])
    return channels[order], places[order]


def _definitions(content: bytes, places: Column, ends: Column) -> tuple[Definition, ...] | None:
    """Return the definitions between the messages; None if anything else is there, or more than the limit."""
    begins = np.concatenate(([0], ends))
    parts = np.flatnonzero(begins != np.concatenate((places, [len(content)]))).tolist()
    if len(parts) > _MOST_DEFINITIONS:
        return None
    found: list[Definition] = []
    for before in parts:
        first = int(begins[before])
        after = int(places[before]) if before < len(places) else len(content)
        end = 0
        for opcode, start, end in records_of(content[first:after]):
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL) or len(found) >= _MOST_DEFINITIONS:
                return None
            found.append(Definition(before, opcode, first + start, first + end))
        if end != after - first:
            return None
    return tuple(found)
