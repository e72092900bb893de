"""Reading a long recording by its index: it opens at once, and what is not asked for is not read.

A closed file ends with the places of its chunks and of the messages of each channel in them. A reader that goes by them
opens hours as fast as seconds, and finds the few events of an hour without unpacking the rest. What it gives up is told
by `Recording`, which reads the whole file: damage between the chunks, and overtaken messages, which stay where they are
unless they are asked for in order.
"""

import mmap
import struct
from collections.abc import Container, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from operator import itemgetter
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode

from recording.info import RecordingInfo
from recording.mcap_scan import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    Block,
    DamagedBlockError,
    Layout,
    chunk_at,
    records_of,
    unpack,
)
from recording.multi_file import MultiFileRecording, RecordingSource
from recording.overtaken import BlockOrder
from recording.reader import Recording
from recording.summary import INDEX_HEAD, ChannelIndexes, channels_in, layout_by_index, quick_info


class IndexedRecording(Recording):
    """A recording that is read by its index where it has a sound one, and like any other where it has not."""

    def __init__(self, path: str | Path, *, in_order: bool = False) -> None:
        """Read the index; `in_order` puts overtaken messages where they belong, for which the whole file is read."""
        self._indexes: ChannelIndexes = {}
        self._in_order = in_order
        super().__init__(path)

    def info(self) -> RecordingInfo:
        """Return the summary by the index, or by reading the whole file where the index does not tell all."""
        return quick_info(self.path) or super().info()

    @cached_property
    def _order(self) -> dict[int, BlockOrder]:
        return self._found_order() if self._in_order else {}

    def _read_layout(self, data: mmap.mmap) -> Layout:
        found = layout_by_index(data, str(self.path))
        if found is None:
            return super()._read_layout(data)
        layout, self._indexes = found
        return layout

    def _may_have(self, block: Block, selected: Container[int]) -> bool:
        indexes = self._indexes.get(block.offset)
        return indexes is None or any(number in selected for number in channels_in(indexes))

    def _content(self, data: mmap.mmap, block: Block) -> bytes:
        if block.offset not in self._indexes:
            return super()._content(data, block)
        found = chunk_at(data, block.offset, block.data_end)
        if found is None or replace(found, crc=0) != block:
            raise DamagedBlockError("the chunk is not what the index says")
        return unpack(data, found)

    def _records(
        self, data: mmap.mmap, block: Block, content: bytes, selected: Container[int]
    ) -> Iterable[tuple[int, int, int]]:
        indexes = self._indexes.get(block.offset)
        try:
            return records_of(content) if indexes is None else _messages_of(data, content, indexes, selected)
        except (struct.error, ValueError, OverflowError):
            # The checksum of the chunk was right, and that of its index is not known.
            return records_of(content)


def _messages_of(
    data: mmap.mmap, content: bytes, indexes: bytes, selected: Container[int]
) -> list[tuple[int, int, int]]:
    """Return opcode, start and end of each message of the selected channels; ValueError where the index is wrong."""
    found = []
    for number, place in channels_in(indexes).items():
        if number not in selected:
            continue
        for at in message_places(data, number, place).tolist():
            opcode, length = RECORD_HEAD.unpack_from(content, at)
            start = at + RECORD_HEAD.size
            if opcode != Opcode.MESSAGE or MESSAGE_HEAD.unpack_from(content, start)[0] != number:
                raise ValueError(f"there is no message of channel {number} at {at}")
            if not MESSAGE_HEAD.size <= length <= len(content) - start:
                raise ValueError(f"the message at {at} is not whole")
            found.append((opcode, start, start + length))
    found.sort(key=_start_of)
    return found


_start_of = itemgetter(1)


def message_places(data: mmap.mmap, number: int, start: int) -> npt.NDArray[np.uint64]:
    """Return the places in their chunk of the messages of a channel, shape (n,); ValueError where there is no index."""
    opcode, length = RECORD_HEAD.unpack_from(data, start)
    body = data[start + RECORD_HEAD.size : start + RECORD_HEAD.size + length]
    channel, size = INDEX_HEAD.unpack_from(body)
    if (opcode, channel, size) != (Opcode.MESSAGE_INDEX, number, len(body) - INDEX_HEAD.size):
        raise ValueError(f"byte {start} is no message index of channel {number}")
    return np.frombuffer(body, dtype="<u8", offset=INDEX_HEAD.size)[1::2]


def open_indexed(paths: Sequence[str | Path], *, in_order: bool = False) -> RecordingSource:
    """Open a recording, or several files of one, by the index; RecordingError names the file that cannot be read."""
    recordings = [IndexedRecording(path, in_order=in_order) for path in paths]
    return recordings[0] if len(recordings) == 1 else MultiFileRecording(recordings)
