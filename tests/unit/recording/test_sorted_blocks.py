"""Blocks whose records were found once: every further reading gives what the first one gave."""

import struct
from collections.abc import Callable
from pathlib import Path

from telenano.recording.mcap_scan import MESSAGE_HEAD, RECORD_HEAD, Damage
from telenano.recording.reader import Recording, SortedBlock

CHANNEL, MESSAGE = 4, 5


def record(opcode: int, body: bytes) -> bytes:
    return RECORD_HEAD.pack(opcode, len(body)) + body


def message(number: int, log_ns: int) -> bytes:
    return record(MESSAGE, MESSAGE_HEAD.pack(number, 1, log_ns, log_ns - 1) + b"payload")


def channel(number: int, name: bytes) -> bytes:
    return record(CHANNEL, struct.pack("<H", number) + name)


def test_each_reading_of_a_recording_gives_the_same_messages(recording_of: Callable[[str], Path]) -> None:
    recording = Recording(recording_of("wave"))
    alone = list(recording.messages())
    first_ns, last_ns = recording.span_ns
    some = (first_ns + (last_ns - first_ns) // 3, first_ns + (last_ns - first_ns) // 2)
    for _ in range(3):
        damage: list[Damage] = []
        assert list(recording.select(report=damage.append)) == alone
        assert damage == []
        for topics in (["afm/state"], ["haptic/state", "law/status"], ["node/health"]):
            wanted = [each for each in alone if each.channel_topic in topics]
            assert list(recording.messages(topics)) == wanted
            within = [each for each in wanted if some[0] <= each.log_ns < some[1]]
            assert list(recording.messages(topics, *some)) == within
        assert [(each.log_ns, each.payload) for each in recording.raw()] == [
            (each.log_ns, each.payload) for each in alone
        ]


def test_the_records_of_a_block_are_kept_only_where_their_order_cannot_matter() -> None:
    usual = channel(1, b"a") + message(1, 10) + channel(2, b"b") + message(2, 11) + message(1, 12)
    found = SortedBlock.of(usual)
    assert found is not None
    assert [row[:2] for row in found.rows] == [(1, 10), (2, 11), (1, 12)]
    assert SortedBlock.of(usual + channel(1, b"a")) is not None
    for odd in (
        message(1, 10) + channel(1, b"a"),
        usual + channel(1, b"other"),
        usual + b"\x05\x00",
        usual + bytes(9),
    ):
        assert SortedBlock.of(odd) is None
