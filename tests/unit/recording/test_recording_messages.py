"""The writer of MCAP: the same file as by the library, byte for byte."""

import random
import tracemalloc
from collections.abc import Callable
from io import BufferedWriter, BytesIO, RawIOBase
from typing import IO, Any

import pytest
from mcap.writer import CompressionType, Writer

from telenano.recording.mcap_messages import Compression, MessageWriter

LIBRARY_S = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


def own_writer(stream: IO[bytes], chunk_size: int, compression: Compression) -> MessageWriter:
    writer = MessageWriter(stream, chunk_size, compression)
    writer.start("telenano")
    return writer


def library_s_writer(stream: IO[bytes], chunk_size: int, compression: Compression) -> Any:
    writer = Writer(stream, chunk_size=chunk_size, compression=LIBRARY_S[compression], enable_data_crcs=True)
    writer.start("telenano", "telenano")
    return writer


def written(make: Callable[..., Any], compression: Compression, chunk_size: int, seed: int) -> bytes:
    """Return the file after a drawn order of calls."""
    draw = random.Random(seed)
    stream = BytesIO()
    writer = make(stream, chunk_size, compression)
    schemas = [writer.register_schema("Message", "jsonschema", b"{}")]
    channels = [writer.register_channel("topic/0", "msgpack", schemas[0], {"site": "local"})]
    for number in range(draw.choice((0, 1, 40, 1500))):
        call = draw.random()
        if call < 0.95:
            # times of reception from several sockets are not in order, and may begin at 0
            log_ns = max(0, number - draw.randrange(50)) * 1000
            payload = draw.randbytes(draw.choice((0, 3, 90, 5000 if number % 100 == 7 else 20)))
            writer.add_message(draw.choice(channels), log_ns, payload, log_ns + 5, number)
        elif call < 0.96:
            schemas.append(writer.register_schema(f"Message{number}", "jsonschema", bytes(draw.choice((2, 9000)))))
        elif call < 0.97:
            channels.append(writer.register_channel(f"topic/{number}", "msgpack", draw.choice(schemas), {}))
        elif call < 0.98:
            writer.add_attachment(0, number, f"{number}.txt", "text/plain", draw.randbytes(draw.randrange(300)))
        elif call < 0.99:
            writer.add_metadata(f"words {number}", {"état": "grün", "n": str(number)})
        else:
            writer.flush()
    writer.finish()
    return stream.getvalue()


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
@pytest.mark.parametrize("chunk_size", [4096, 1 << 20])
def test_the_file_is_the_library_s(compression: Compression, chunk_size: int) -> None:
    for seed in range(8):
        own, expected = (written(make, compression, chunk_size, seed) for make in (own_writer, library_s_writer))
        assert own == expected, f"seed {seed}"


def test_messages_are_counted_before_their_chunk_ends() -> None:
    writer = MessageWriter(BytesIO())
    writer.start()
    channel = writer.register_channel("topic", "msgpack", 0)
    for number in range(3):
        writer.add_message(channel, number, b"abc", number, 2**32 + number)
        assert writer.message_count == number + 1
    writer.flush()
    assert writer.message_count == 3


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
    def grown(make: Callable[..., Any]) -> int:
        writer = make(BufferedWriter(Sink()), 1 << 20, "none")
        channels = [writer.register_channel(f"topic{number}", "msgpack", 0) for number in range(40)]
        tracemalloc.start()
        for chunk in range(100):
            for channel in channels:
                writer.add_message(channel, chunk, b"", chunk, chunk)
            writer.flush()
        size = tracemalloc.get_traced_memory()[0]
        tracemalloc.stop()
        return size

    assert grown(own_writer) < 0.4 * grown(library_s_writer)
