"""Messages written the short way: the same file as by the library, byte for byte."""

import tracemalloc
from io import BytesIO, RawIOBase
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer

from recording.mcap_messages import MessageWriter


def written(kind: type[Writer], compression: CompressionType, chunk_size: int) -> bytes:
    stream = BytesIO()
    writer = kind(stream, chunk_size=chunk_size, compression=compression, enable_data_crcs=True)
    writer.start("telenano")
    schema = writer.register_schema("Message", "jsonschema", b"{}")
    channels = [writer.register_channel(f"topic/{number}", "msgpack", schema, {}) for number in range(3)]
    # times of reception from several sockets are not in order, and may begin at 0
    for number in range(400):
        log_ns = (number * 7919) % 1009 * 1000
        writer.add_message(
            channels[number % len(channels)], log_ns, bytes([number % 251]) * (number % 97), log_ns + 5, number
        )
        if number == 20:
            # a schema and a channel in the middle of a chunk
            other = writer.register_schema("Other", "jsonschema", b"{}")
            channels.append(writer.register_channel("topic/other", "msgpack", other, {}))
        if number == 150:
            writer.flush()
            writer.register_channel("topic/late", "msgpack", schema, {})
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.NONE])
@pytest.mark.parametrize("chunk_size", [4096, 1 << 20])
def test_the_file_is_the_library_s(compression: CompressionType, chunk_size: int) -> None:
    assert written(MessageWriter, compression, chunk_size) == written(Writer, compression, chunk_size)


def test_the_library_is_as_the_short_way_expects_it() -> None:
    assert MessageWriter(BytesIO()).is_quick


def test_messages_are_counted_before_their_chunk_ends() -> None:
    writer = MessageWriter(BytesIO())
    writer.start()
    channel = writer.register_channel("topic", "msgpack", 0, {})
    for number in range(3):
        writer.add_message(channel, number, b"abc", number, 2**32 + number)
        assert writer.message_count == number + 1
    writer.flush()
    assert writer.message_count == 3


def test_another_inside_of_the_library_is_left_to_it() -> None:
    stream, expected = BytesIO(), BytesIO()
    writers = MessageWriter(stream, use_chunking=False), Writer(expected, use_chunking=False)
    assert not writers[0].is_quick
    for writer in writers:
        writer.start("telenano")
        channel = writer.register_channel("topic", "msgpack", 0, {})
        writer.add_message(channel, 3, b"abc", 4, 5)
        writer.finish()
    assert stream.getvalue() == expected.getvalue()


class Sink(RawIOBase):
    """A file of which nothing is kept."""

    def __init__(self) -> None:
        self.size = 0

    def writable(self) -> bool:
        return True

    def write(self, data: Any) -> int:
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        return self.size


def test_the_index_of_the_chunks_takes_a_fraction_of_the_memory() -> None:
    def grown(kind: type[Writer]) -> int:
        writer = kind(Sink(), compression=CompressionType.NONE)
        writer.start()
        channels = [writer.register_channel(f"topic{number}", "msgpack", 0) for number in range(40)]
        tracemalloc.start()
        for chunk in range(100):
            for channel in channels:
                writer.add_message(channel, chunk, b"", chunk, chunk)
            writer.flush()
        size = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        return size

    assert grown(MessageWriter) < 0.4 * grown(Writer)
