"""A recording that is being written, followed: each byte is read once, and taken apart when a test asks for it."""

import struct
from bisect import bisect_left
from functools import lru_cache
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream

from telenano.recording.mcap_scan import MAGIC, RECORD_HEAD
from telenano.recording.messages import RecordedChannel, RecordedMessage, recorded_channel

# of a message: number of its channel, seq, log and publish time; of an index: number of a channel, bytes of its entries
_MESSAGE_HEAD, _INDEX_HEAD, _INDEX_ENTRY = struct.Struct("<HIQQ"), struct.Struct("<HI"), struct.Struct("<QQ")


class Following:
    """The messages of a file by channel, as far as `follow` has read it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read = len(MAGIC)
        self._channels: dict[int, RecordedChannel] = {}
        self._chunk = b""
        # by number of the channel: chunks and the places of its messages in them that nobody has asked for yet
        self._waiting: dict[int, list[tuple[bytes, bytes]]] = {}
        self._received: dict[str, list[RecordedMessage]] = {}

    def follow(self) -> "Following":
        """Read what has been added since the last call, up to the last whole record."""
        with self.path.open("rb") as file:
            file.seek(self._read)
            added = file.read()
        at = 0
        while at + RECORD_HEAD.size <= len(added):
            opcode, length = RECORD_HEAD.unpack_from(added, at)
            start, end = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            # what follows the data is an index that repeats everything
            if end > len(added) or opcode == Opcode.DATA_END:
                break
            if opcode == Opcode.CHUNK:
                self._chunk = added[start:end]
            elif opcode == Opcode.MESSAGE_INDEX:
                self._enter_index(added[start:end])
            at = end
        self._read += at
        return self

    def messages(self, channel_topic: str, since_ns: int = 0) -> list[RecordedMessage]:
        """Give what was recorded of all that was sent on a channel from a time on [ns], however late it came."""
        received = self._received.setdefault(channel_topic, [])
        for number, channel in self._channels.items():
            if channel.channel_topic == channel_topic:
                waiting = self._waiting.pop(number, [])
                # what is older than anybody wants waits on
                self._waiting[number] = [row for row in waiting if _last_ns(row[1]) < since_ns]
                received += [
                    _message(_content(chunk), offset, channel)
                    for chunk, index in waiting
                    if _last_ns(index) >= since_ns
                    for _, offset in _INDEX_ENTRY.iter_unpack(index)
                ]
        received.sort(key=lambda message: message.log_ns)
        later = received[bisect_left(received, since_ns, key=lambda message: message.log_ns) :]
        return [message for message in later if message.publish_ns >= since_ns]

    def newest(self, channel_topic: str) -> RecordedMessage | None:
        """Give the newest message of a channel, and leave those before it: a rig that has run for long has many."""
        found = self._received.get(channel_topic, [])[-1:]
        for number, channel in self._channels.items():
            if channel.channel_topic == channel_topic:
                for chunk, index in self._waiting.get(number, [])[-1:]:
                    _, offset = _INDEX_ENTRY.unpack_from(index, len(index) - _INDEX_ENTRY.size)
                    found.append(_message(_content(chunk), offset, channel))
        return max(found, key=lambda message: message.log_ns, default=None)

    def _enter_index(self, body: bytes) -> None:
        number, size = _INDEX_HEAD.unpack_from(body)
        if number not in self._channels:
            found = [record for record in breakup_chunk(_chunk(self._chunk)) if isinstance(record, Channel)]
            self._channels |= {channel.id: recorded_channel(channel) for channel in found}
        index = body[_INDEX_HEAD.size : _INDEX_HEAD.size + size]
        self._waiting.setdefault(number, []).append((self._chunk, index))


class Recorded:
    """What the recorder of one rig writes, whatever file it has in hand."""

    def __init__(self) -> None:
        # A removed file and one that came after it have one name.
        self._followed: dict[tuple[Path, int], Following] = {}

    def newest(self, folder: Path) -> Following:
        """Give the newest recording of a folder, as far as it is written now."""
        path = max(folder.glob("session*.mcap"), key=lambda path: path.stat().st_mtime)
        return self._followed.setdefault((path, path.stat().st_ino), Following(path)).follow()


# the channels of a chunk are asked for one after the other, those of older ones hardly ever
@lru_cache(maxsize=32)
def _content(body: bytes) -> bytes:
    stream, size = get_chunk_data_stream(_chunk(body))
    return stream.read(size)


def _chunk(body: bytes) -> Chunk:
    return Chunk.read(ReadDataStream(BytesIO(body)))


def _last_ns(index: bytes) -> int:
    last_ns: int = _INDEX_ENTRY.unpack_from(index, len(index) - _INDEX_ENTRY.size)[0]
    return last_ns


def _message(content: bytes, offset: int, channel: RecordedChannel) -> RecordedMessage:
    _, length = RECORD_HEAD.unpack_from(content, offset)
    start = offset + RECORD_HEAD.size
    _, seq, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content, start)
    return RecordedMessage(channel, log_ns, publish_ns, seq, content[start + _MESSAGE_HEAD.size : start + length])
