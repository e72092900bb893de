"""Batches: what was sent comes back as it was, and no bytes do harm."""

import tracemalloc

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from proto import WireError
from proto.batch import MOST_COPIES, Batch, SentCopy, pack_batch, read_batch

TIMES = st.integers(min_value=0, max_value=2**63 - 1)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(TIMES, st.binary(max_size=40), st.binary(max_size=300)), max_size=20), st.booleans())
def test_what_was_sent_comes_back(sent: list[tuple[int, bytes, bytes]], last: bool) -> None:
    copies = [SentCopy(*each) for each in sent]
    assert read_batch(pack_batch(copies, last=last)) == Batch(1, copies, last)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"v": 2, "sent": [], "last": False}, "newer_version"),
        ({"v": 1, "sent": []}, "malformed"),
        ({"v": 1, "sent": [], "last": False, "more": 1}, "malformed"),
        ({"v": 1, "sent": [[-1, b"", b""]], "last": False}, "malformed"),
        ({"v": 1, "sent": [[2**63, b"", b""]], "last": False}, "malformed"),
        ({"v": 1, "sent": [[0, "text", b""]], "last": False}, "malformed"),
        ({"v": 1, "sent": [[0, b""]], "last": False}, "malformed"),
        ([1, [], False], "malformed"),
    ],
)
def test_another_form_is_refused_by_reason(fields: object, reason: str) -> None:
    with pytest.raises(WireError, match="node/batch") as refusal:
        read_batch(msgpack.packb(fields))
    assert refusal.value.reason == reason


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.integers(min_value=0, max_value=60), st.integers(min_value=0, max_value=255))
def test_any_bytes_are_a_batch_or_refused(noise: bytes, place: int, value: int) -> None:
    broken = bytearray(pack_batch([SentCopy(5, b"haptic/state", b"payload")] * 2))
    broken[place % len(broken)] = value
    for payload in (noise, bytes(broken), b"\x91" * 5000):
        try:
            assert read_batch(payload).v == 1
        except WireError as error:
            assert error.reason in ("malformed", "newer_version")


def test_a_key_given_twice_is_refused() -> None:
    once = [("v", 1), ("sent", []), ("last", False)]
    for pairs in ([*once, ("v", 1)], [("last", True), *once], [*once, ("sent", [[0, b"", b""]])]):
        with pytest.raises(WireError, match="4 keys, a key twice or one that is not known") as refusal:
            read_batch(msgpack.Packer().pack_map_pairs(pairs))
        assert refusal.value.reason == "malformed"
    # the same map, with its length written in another way that msgpack allows
    packed = pack_batch([])
    for head in (b"\xde\x00\x03", b"\xdf\x00\x00\x00\x03"):
        assert read_batch(head + packed[1:]) == Batch(1, [], False)


def test_a_frame_full_of_empty_copies_is_refused_before_they_are_made() -> None:
    most = pack_batch([SentCopy(0, b"", b"")] * MOST_COPIES)
    assert len(read_batch(most).sent) == MOST_COPIES
    tracemalloc.start()
    try:
        with pytest.raises(WireError, match="length <= 4096"):
            read_batch(pack_batch([]).replace(b"\x90", b"\xdd\x00\x28\x00\x00" + b"\x93\x00\xc4\x00\xc4\x00" * 100_000))
        # what the bytes took that were given, and not what was announced in them
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
