"""Check of the parts of a file on which other readers rely: header, footer, summary and checksums.

They are read with the reader of the `mcap` package, as other programs do. The statements of the summary are compared
with the content of the file; the checksums, if the writer made some, cover the rest, such as the message indexes.
"""

import mmap
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any

from mcap.opcode import Opcode
from mcap.reader import SeekingReader

from telenano.recording.mcap_scan import MAGIC, RECORD_HEAD, UNREADABLE, Bytes, Layout
from telenano.wire.errors import described

_FOOTER_BYTES = RECORD_HEAD.size + 20
_CRC_BYTES = 4
_CRC_STEP = 1 << 20


def index_faults(data: Bytes, layout: Layout, messages: int) -> list[str]:
    """Return sentences on the faults in the indexes of a closed file whose records are intact.

    Args:
        data: The file.
        layout: Its records, from `scan`.
        messages: The number of messages that were read from the file.
    """
    try:
        return list(_faults(data, layout, messages))
    except (*UNREADABLE, ValueError, KeyError) as error:
        return [f"header or summary cannot be read: {described(error)}"]


def _faults(data: Bytes, layout: Layout, messages: int) -> Iterator[str]:
    # The type is Any because a mapped file serves as a stream, and the package has no types.
    stream: Any = data if isinstance(data, mmap.mmap) else BytesIO(data)
    reader: Any = SeekingReader(stream, validate_crcs=True)
    reader.get_header()
    summary = reader.get_summary()
    footer = len(data) - len(MAGIC) - _FOOTER_BYTES
    start = int.from_bytes(data[footer + RECORD_HEAD.size :][:8], "little")
    yield from _checksum_faults(data, start or footer, footer)
    if summary is None:
        return
    statistics = summary.statistics
    if statistics is not None:
        if statistics.message_count != messages:
            yield f"the summary states {statistics.message_count} messages, but the file has {messages}"
        if sum(statistics.channel_message_counts.values()) != statistics.message_count:
            yield "the numbers of messages by channel in the summary do not add up to the total that it states"
    stated = {(c.chunk_start_offset, c.message_start_time, c.message_end_time) for c in summary.chunk_indexes}
    chunks = (block for block in layout.blocks if block.data_start != block.offset)
    actual = {(block.offset, block.first_ns, block.last_ns) for block in chunks}
    if stated and stated != actual:
        first = min(stated ^ actual)[0]
        yield f"the chunk indexes of the summary differ from the chunks in the file, first at byte {first}"


def _checksum_faults(data: Bytes, summary_start: int, footer: int) -> Iterator[str]:
    """Yield a sentence for each wrong checksum; 0 means that the writer made none."""
    data_end = summary_start - RECORD_HEAD.size - _CRC_BYTES
    if not 0 < data_end < footer or data[data_end] != Opcode.DATA_END:
        yield "the end of the data section is not where the footer says"
        return
    stored = data[summary_start - _CRC_BYTES : summary_start]
    if any(stored) and int.from_bytes(stored, "little") != _crc(data, 0, data_end):
        yield "the checksum of the data section is wrong"
    end = footer + _FOOTER_BYTES - _CRC_BYTES
    stored = data[end : end + _CRC_BYTES]
    if any(stored) and int.from_bytes(stored, "little") != _crc(data, summary_start, end):
        yield "the checksum of the summary is wrong"


def _crc(data: Bytes, start: int, end: int) -> int:
    crc = 0
    for position in range(start, end, _CRC_STEP):
        crc = zlib.crc32(data[position : min(position + _CRC_STEP, end)], crc)
    return crc
