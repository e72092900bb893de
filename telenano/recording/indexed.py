"""Reading a long recording by its index: it opens at once, and what is not asked for is not read.

A closed file ends with the places of its chunks and of the messages of each channel in them. A reader that goes by them
opens hours as fast as seconds, and finds the few events of an hour without unpacking the rest. What it gives up is told
by `Recording`, which reads the whole file: damage between the chunks.
"""

import mmap
import struct
from collections.abc import Container, Iterable, Iterator, Sequence
from itertools import repeat
from pathlib import Path

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode

from telenano.recording.info import RecordingInfo
from telenano.recording.mcap_messages import HEADS
from telenano.recording.mcap_scan import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    Block,
    DamagedBlockError,
    Layout,
    chunk_at,
    records_of,
    unpack,
)
from telenano.recording.messages import ChannelFilter, RecordedMessage
from telenano.recording.reader import END_OF_TIME, DamageCallback, Recording, SeeMessage, each_block
from telenano.recording.summary_section import INDEX_HEAD, ChannelIndexes, channels_in, layout_by_index, quick_info

# The checksum of a chunk was right, and that of its index is not known.
_UNSOUND = (struct.error, ValueError, OverflowError)


class IndexedRecording(Recording):
    """A recording that is read by its index where it has a sound one, and like any other where it has not."""

    def __init__(self, path: str | Path) -> None:
        """Read the index."""
        self._indexes: ChannelIndexes = {}
        super().__init__(path)

    def info(self, see: SeeMessage | None = None) -> RecordingInfo:
        """Return the summary by the index, or by reading the whole file where the index does not tell all."""
        quick = quick_info(self.path)
        if quick is not None and see is not None:
            for message in self.messages():
                see(message)
        return quick or super().info(see)

    def _read_layout(self, data: mmap.mmap) -> Layout:
        layout_read = layout_by_index(data, str(self.path))
        if layout_read is None:
            return super()._read_layout(data)
        layout, self._indexes = layout_read
        return layout

    def select(
        self,
        wanted: ChannelFilter | None = None,
        start_ns: int | None = None,
        end_ns: int | None = None,
        report: DamageCallback | None = None,
        blocks: Sequence[Block] | None = None,
    ) -> Iterator[RecordedMessage]:
        """Yield messages as those of any recording; with an index the heads of a chunk are read together."""
        if report is not None or not self._indexes:
            yield from super().select(wanted, start_ns, end_ns, report, blocks)
            return
        first = 0 if start_ns is None else start_ns
        after = END_OF_TIME if end_ns is None else end_ns
        selected = self._recorded_channels(wanted, self._channels_by_number).selected
        # The constructor of a named tuple is a function of Python.
        new = tuple.__new__
        with self._open() as data:
            for block in each_block(data, self._layout.blocks if blocks is None else blocks):
                if block.last_ns < first or block.first_ns >= after or not self._may_have(block, selected):
                    continue
                try:
                    content = self._content(data, block)
                    heads, starts, ends = _heads_of(data, content, self._indexes[block.offset], selected)
                except DamagedBlockError:
                    continue
                except _UNSOUND:
                    for message in self._walk(self._recorded_channels(wanted), RecordedMessage, blocks=(block,)):
                        if first <= message.log_ns < after:
                            yield message
                    continue
                inside = (heads["log_ns"] >= first) & (heads["log_ns"] < after)
                bodies = starts[inside] + MESSAGE_HEAD.size, ends[inside]
                columns = *(heads[name][inside] for name in ("channel", "log_ns", "publish_ns", "seq")), *bodies
                for number, log_ns, publish_ns, seq, start, end in zip(*(c.tolist() for c in columns), strict=True):
                    row = (selected[number], log_ns, publish_ns, seq, content[start:end])
                    yield new(RecordedMessage, row)

    def _may_have(self, block: Block, selected: Container[int]) -> bool:
        indexes = self._indexes.get(block.offset)
        return indexes is None or any(number in selected for number in channels_in(indexes))

    def _content(self, data: mmap.mmap, block: Block) -> bytes:
        if block.offset not in self._indexes:
            return super()._content(data, block)
        chunk = chunk_at(data, block.offset, block.data_end)
        if chunk is None or chunk._replace(crc=0) != block:
            raise DamagedBlockError("the chunk differs from its entry in the index")
        return unpack(data, chunk)

    def _records(
        self, data: mmap.mmap, block: Block, content: bytes, selected: Container[int]
    ) -> Iterable[tuple[int, int, int]]:
        indexes = self._indexes.get(block.offset)
        if indexes is None:
            return records_of(content)
        try:
            _, starts, ends = _heads_of(data, content, indexes, selected)
        except _UNSOUND:
            return records_of(content)
        return zip(repeat(Opcode.MESSAGE), starts.tolist(), ends.tolist())


def _heads_of(
    data: mmap.mmap, content: bytes, indexes: bytes, selected: Container[int]
) -> tuple[npt.NDArray[np.void], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return head (HEADS), start and end of each message of the selected channels, in the order of the chunk.

    Raises:
        ValueError: The index is wrong.
    """
    channels = {number: place for number, place in channels_in(indexes).items() if number in selected}
    most = len(content) // HEADS.itemsize
    each = [message_places(data, number, place, most).astype(np.int64) for number, place in channels.items()]
    places = np.concatenate([np.empty(0, dtype=np.int64), *each])
    order = np.argsort(places, kind="stable")
    numbers = np.repeat(np.array(list(channels), dtype=np.int64), [len(part) for part in each])[order]
    starts = places[order] + RECORD_HEAD.size
    last = len(content) - HEADS.itemsize
    if places.size and not 0 <= places.min() <= places.max() <= last:
        raise ValueError("the index has places beyond the chunk")
    # A head may begin at any byte, and so each lies over the one before.
    heads = np.ndarray((max(0, last + 1),), HEADS, content, strides=(1,))[places[order]]
    if np.any(heads["opcode"] != Opcode.MESSAGE) or np.any(heads["channel"] != numbers):
        raise ValueError("the index names what is no message of its channel")
    if np.any(heads["length"] < MESSAGE_HEAD.size) or np.any(
        heads["length"] > (len(content) - starts).astype(np.uint64)
    ):
        raise ValueError("a message is not whole")
    ends = starts + heads["length"].astype(np.int64)
    if np.any(starts[1:] - RECORD_HEAD.size < ends[:-1]):
        raise ValueError("the index names a message twice, or messages that lie over one another")
    return heads, starts, ends


def message_places(data: mmap.mmap, number: int, start: int, most: int) -> npt.NDArray[np.uint64]:
    """Return the places in their chunk of the messages of a channel, shape (n,).

    Raises:
        ValueError: There is no index, or it has more messages than the most that the chunk has room for.
    """
    opcode, length = RECORD_HEAD.unpack_from(data, start)
    if length > INDEX_HEAD.size + 16 * most:
        raise ValueError(f"the index at byte {start} has more messages than its chunk")
    body = data[start + RECORD_HEAD.size : start + RECORD_HEAD.size + length]
    channel, size = INDEX_HEAD.unpack_from(body)
    if (opcode, channel, size) != (Opcode.MESSAGE_INDEX, number, len(body) - INDEX_HEAD.size):
        raise ValueError(f"byte {start} is no message index of channel {number}")
    return np.frombuffer(body, dtype="<u8", offset=INDEX_HEAD.size)[1::2]
