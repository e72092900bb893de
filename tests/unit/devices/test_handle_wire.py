"""Frames of handle protocol 1: golden bytes, in Python and in the firmware, and whatever a line can do to them."""

import binascii
import shutil
from itertools import pairwise

import pytest
from handle_answers import pack_configured, pack_fault, pack_hello, pack_state
from hypothesis import given, settings
from hypothesis import strategies as st

from telenano.devices.hand import wire

COMMAND = "0410010703efbe010440420f0101010103133600"
ASK = "02010101020103341201010103aba900"
LIMITS = wire.Limits(20, -450_000, 1_470_480, 3_600_000, 48_000, 125_633, 0)
HELLO = wire.HandleHello(
    69, 1, 1, 0, 0x1234, 0x0102030405060708, 0xBEEF, 1000, 0.5, 0.25, 0.125, 0x0100, 2, "telenano posix"
)
STATE = wire.HandleState(5, 65535, 7, 1, 0, 4_294_967_295, -20480, 30_000, 8388, -2, 4800, 1, 3, 0xBEEF)
# payload and what stands on the line
GOLDEN = {
    "ask": (bytes.fromhex("010000000100341200000000"), ASK),
    "command": (bytes.fromhex("10010700efbe000040420f0000000000"), COMMAND),
    "stop": (bytes.fromhex("1f000800efbe"), "021f0208"),
}
payloads = st.binary(min_size=1, max_size=wire.MAX_PAYLOAD)


def test_crc_has_its_check_value() -> None:
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_frames_have_their_golden_bytes() -> None:
    assert wire.encode_command(7, 0xBEEF, 1, 0, 1_000_000, 0).hex() == COMMAND
    assert wire.encode_ask(0, 0x1234).hex() == ASK
    assert wire.encode_stop(8, 0xBEEF).hex().startswith(GOLDEN["stop"][1])


@pytest.mark.parametrize(
    ("payload", "answer", "size"),
    [
        (pack_hello(HELLO), HELLO, 52),
        (pack_state(STATE), STATE, 36),
        (pack_configured(wire.ConfigAnswer(3, 0xBEEF, LIMITS)), wire.ConfigAnswer(3, 0xBEEF, LIMITS), 32),
        (pack_fault(wire.DeviceFault(4, 9, 2, "hot")), wire.DeviceFault(4, 9, 2, "hot"), 38),
    ],
)
def test_answers_come_back_and_may_grow_but_not_shrink(payload: bytes, answer: wire.Answer, size: int) -> None:
    assert len(payload) == size
    assert len(wire.encode_frame(payload)) == size + 4
    assert wire.parse_answer(payload) == answer
    assert wire.parse_answer(payload + b"\x07\x00") == answer
    with pytest.raises(wire.MalformedFrameError, match="are needed"):
        wire.parse_answer(payload[:-1])


@given(payload=payloads, garbage=st.binary(max_size=200))
@settings(max_examples=60, deadline=None)
def test_any_frame_survives_any_garbage_before_it(payload: bytes, garbage: bytes) -> None:
    reader = wire.FrameReader()
    assert list(reader.payloads(garbage + b"\0" + wire.encode_frame(payload)))[-1] == payload


@given(stream=st.binary(max_size=400), cuts=st.lists(st.integers(0, 400), max_size=8))
@settings(max_examples=60, deadline=None)
def test_any_bytes_in_any_pieces_give_the_same_and_raise_nothing(stream: bytes, cuts: list[int]) -> None:
    whole, pieces = wire.FrameReader(), wire.FrameReader()
    at_once = list(whole.answers(stream))
    places = [0, *sorted(cuts), len(stream)]
    found = [a for low, high in pairwise(places) for a in pieces.answers(stream[low:high])]
    assert found == at_once
    assert pieces.errors == whole.errors


@given(payload=payloads, bit=st.integers(0, 64 * 8 - 1))
@settings(max_examples=100, deadline=None)
def test_one_flipped_bit_never_passes(payload: bytes, bit: int) -> None:
    frame = bytearray(wire.encode_frame(payload))
    place = bit % (8 * len(frame))
    frame[place // 8] ^= 1 << (place % 8)
    assert payload not in list(wire.FrameReader().payloads(bytes(frame)))


def test_faults_are_counted_by_kind_and_the_next_zero_begins_anew() -> None:
    reader = wire.FrameReader()
    good = wire.encode_frame(pack_state(STATE))
    broken = bytearray(good)
    broken[9] ^= 0x10
    stream = bytes(broken) + b"\xff\x01\0" + b"x" * 300 + b"\0" + wire.encode_frame(b"\x55abcd") + b"\0\0" + good
    assert list(reader.answers(stream)) == [STATE]
    assert reader.errors == {"cobs": 1, "crc": 1, "length": 1, "type": 1}


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler: apt install gcc libc6-dev")
def test_firmware_writes_the_same_bytes() -> None:
    from telenano_devices.handle.firmware import BoardIdentity, FirmwareCore

    core = FirmwareCore(BoardIdentity(HELLO.device_id, 0xBEEF, HELLO.flags, 2, 0.5, 0.25, 0.125, HELLO.model))
    for payload, _ in GOLDEN.values():
        assert core.encode(payload) == wire.encode_frame(payload)
    for size in range(1, wire.MAX_PAYLOAD + 1):
        payload = bytes((7 * i * i + size) % 5 * (i % 3) for i in range(size))
        assert core.encode(payload) == wire.encode_frame(payload)
    core.receive(bytes.fromhex(ASK))
    assert list(wire.FrameReader().answers(core.sent())) == [HELLO._replace(seq=0)]
