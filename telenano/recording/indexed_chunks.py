"""The heads of all messages of a chunk at once, where the indexes behind it are shown to name every record in it.

A walk over the records of a chunk takes a microsecond for each. The writer puts an index of each channel's messages
behind a chunk, by which all heads are read in a tenth of that. An index is a claim, and so it is used as a proposal
alone: what it names must be messages of its channel that lie one behind the other, and what is between them must be
definitions. Where that does not hold the records are walked.
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
# A chunk in which definitions part the messages more often is walked.
_MOST_DEFINITIONS = 256

Column = npt.NDArray[np.int64]


class Definition(NamedTuple):
    """A schema or a channel in a chunk, before the message of a number; `start` and `end` are those of its body."""

    before: int
    opcode: int
    start: int
    end: int


class ChunkMessages(NamedTuple):
    """Messages of a chunk in its order: heads as `HEADS`, start and end of each payload, and the definitions."""

    heads: npt.NDArray[np.void]
    starts: Column
    ends: Column
    definitions: tuple[Definition, ...]


def messages_in(
    data: mmap.mmap, place: int, content: bytes, wanted: Container[int] | None = None
) -> ChunkMessages | None:
    """Return the messages in the content of a chunk; None where the indexes do not agree with it.

    Args:
        data: The file.
        place: The end of the chunk, behind which its indexes stand.
        content: The records in the chunk.
        wanted: The channels whose messages are returned, where the whole chunk was shown to agree before; None for all.
    """
    entries = _entries(data, place, len(content) // HEADS.itemsize, wanted)
    if entries is None:
        return None
    numbers, places = entries
    last = len(content) - HEADS.itemsize
    if places.size and not 0 <= places.min() <= places.max() <= last:
        return None
    # A head may begin at any byte, and so each lies over the one before.
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
    """Return channel and place of each message that the indexes behind a chunk name, in the order of the places.

    None where they name more than the chunk has room for.
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
    """Return what is between the messages; None where a part of it is no definition, or there is too much."""
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
