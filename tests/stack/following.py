"""A recording that is being written, followed: each byte is read once, and taken apart when a test asks for it."""

import struct
from bisect import bisect_left
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk
from mcap.stream_reader import get_chunk_data_stream

from services.recorder.layout import MAGIC, RECORD_HEAD

# of a message: number of its channel, seq, log and publish time; of an index: number of a channel, bytes of its entries
_MESSAGE_HEAD, _INDEX_HEAD, _INDEX_ENTRY = struct.Struct("<HIQQ"), struct.Struct("<HI"), struct.Struct("<QQ")


class Heard(NamedTuple):
    """A message: when it was recorded and when it was sent [ns], by whom, its number, and its bytes."""

    log_ns: int
    publish_ns: int
    src: str
    seq: int
    payload: bytes

    def fields(self) -> dict[str, Any]:
        found: dict[str, Any] = msgpack.unpackb(self.payload, use_list=False)
        return found


class _Chunk:
    """A chunk, decompressed when something in it is wanted."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._content: bytes | None = None

    @property
    def content(self) -> bytes:
        if self._content is None:
            stream, size = get_chunk_data_stream(Chunk.read(ReadDataStream(BytesIO(self._body))))
            self._content, self._body = stream.read(size), b""
        return self._content


class Following:
    """The messages of a file by channel, as far as `follow` has read it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read = len(MAGIC)
        self._channels: dict[int, Channel] = {}
        self._chunk: _Chunk | None = None
        # by number of the channel: chunks and the places of its messages in them that nobody has asked for yet
        self._waiting: dict[int, list[tuple[_Chunk, bytes]]] = {}
        self._heard: dict[str, list[Heard]] = {}

    def follow(self) -> "Following":
        """Read what has been added since the last call, up to the last whole record."""
        with self.path.open("rb") as file:
            file.seek(self._read)
            added = file.read()
        at = 0
        while at + RECORD_HEAD.size <= len(added):
            opcode, length = RECORD_HEAD.unpack_from(added, at)
            start, end = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            # what follows the data is an index that says all once more
            if end > len(added) or opcode == Opcode.DATA_END:
                break
            if opcode == Opcode.CHUNK:
                self._chunk = _Chunk(added[start:end])
            elif opcode == Opcode.MESSAGE_INDEX:
                self._enter_index(added[start:end])
            at = end
        self._read += at
        return self

    def messages(self, channel_topic: str, since_ns: int = 0) -> list[Heard]:
        """Give what was recorded of a channel from a time of reception on [ns]."""
        heard = self._heard.setdefault(channel_topic, [])
        fresh: list[Heard] = []
        for number in [number for number, channel in self._channels.items() if channel.topic == channel_topic]:
            src = self._channels[number].metadata.get("src", "")
            for chunk, index in self._waiting.pop(number, []):
                fresh += [_message(chunk.content, offset, src) for _, offset in _INDEX_ENTRY.iter_unpack(index)]
        heard += sorted(fresh)
        return heard[bisect_left(heard, since_ns, key=lambda message: message.log_ns) :]

    def _enter_index(self, body: bytes) -> None:
        assert self._chunk is not None
        number, size = _INDEX_HEAD.unpack_from(body)
        if number not in self._channels:
            self._learn_channels(self._chunk.content)
        index = body[_INDEX_HEAD.size : _INDEX_HEAD.size + size]
        self._waiting.setdefault(number, []).append((self._chunk, index))

    def _learn_channels(self, content: bytes) -> None:
        at = 0
        while at < len(content):
            opcode, length = RECORD_HEAD.unpack_from(content, at)
            start, at = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            if opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(content[start:at])))
                self._channels[channel.id] = channel


def _message(content: bytes, offset: int, src: str) -> Heard:
    _, length = RECORD_HEAD.unpack_from(content, offset)
    start = offset + RECORD_HEAD.size
    _, seq, log_ns, publish_ns = _MESSAGE_HEAD.unpack_from(content, start)
    return Heard(log_ns, publish_ns, src, seq, content[start + _MESSAGE_HEAD.size : start + length])
