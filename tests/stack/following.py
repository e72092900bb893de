"""A recording that is being written, followed: each byte of it is read once, however often a test asks."""

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

_MESSAGE_HEAD_BYTES = 22


class Heard(NamedTuple):
    """A message: when it was sent, when it was recorded [ns], by whom, its number, and its bytes."""

    publish_ns: int
    log_ns: int
    src: str
    seq: int
    payload: bytes

    def fields(self) -> dict[str, Any]:
        found: dict[str, Any] = msgpack.unpackb(self.payload, use_list=False)
        return found


class Following:
    """All messages of a file by channel, as far as `follow` has read it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read = len(MAGIC)
        self._channels: dict[int, Channel] = {}
        self._heard: dict[str, list[Heard]] = {}

    def follow(self) -> "Following":
        """Read what has been added since the last call, up to the last whole record."""
        with self.path.open("rb") as file:
            file.seek(self._read)
            added = file.read()
        at = 0
        while at + RECORD_HEAD.size <= len(added):
            opcode, length = RECORD_HEAD.unpack_from(added, at)
            end = at + RECORD_HEAD.size + length
            # what follows the data is an index that says all once more
            if end > len(added) or opcode == Opcode.DATA_END:
                break
            if opcode == Opcode.CHUNK:
                body = ReadDataStream(BytesIO(added[at + RECORD_HEAD.size : end]))
                stream, _ = get_chunk_data_stream(Chunk.read(body))
                self._take(stream.read(10**9))
            at = end
        self._read += at
        return self

    def messages(self, channel_topic: str, since_ns: int = 0) -> list[Heard]:
        """Give what was recorded of a channel from a time of reception on [ns]."""
        heard = self._heard.get(channel_topic, [])
        return heard[bisect_left(heard, since_ns, key=lambda message: message.log_ns) :]

    def _take(self, content: bytes) -> None:
        at = 0
        while at < len(content):
            opcode, length = RECORD_HEAD.unpack_from(content, at)
            start, at = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
            if opcode == Opcode.CHANNEL:
                channel = Channel.read(ReadDataStream(BytesIO(content[start:at])))
                self._channels[channel.id] = channel
            elif opcode == Opcode.MESSAGE:
                number, seq = int.from_bytes(content[start : start + 2], "little"), content[start + 2 : start + 6]
                log, publish = content[start + 6 : start + 14], content[start + 14 : start + 22]
                found = self._channels[number]
                heard = Heard(
                    int.from_bytes(publish, "little"),
                    int.from_bytes(log, "little"),
                    found.metadata.get("src", ""),
                    int.from_bytes(seq, "little"),
                    content[start + _MESSAGE_HEAD_BYTES : at],
                )
                self._heard.setdefault(found.topic, []).append(heard)
