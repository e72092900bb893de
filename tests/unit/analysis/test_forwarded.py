"""What a re-run of the link sent on against what was recorded of it."""

from collections.abc import Sequence

import msgspec
import pytest

from telenano.analysis.forwarded import ForwardedMessage, compare_forwarded
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.topics import TOPICS

TOPIC = "teleop/forward"
BASE = examples(TOPICS[TOPIC])["ordinary"]


def message(seq: int, topic: str = TOPIC, **changed: object) -> ForwardedMessage:
    return ForwardedMessage(topic, encode(msgspec.structs.replace(BASE, seq=seq, **changed)), 1000 + seq)


def unknown(seq: int) -> ForwardedMessage:
    return message(seq)._replace(payload=bytes(len(message(seq).payload)))


def run(*seqs: int) -> list[ForwardedMessage]:
    return [message(seq) for seq in seqs]


ALL = run(*range(40))


@pytest.mark.parametrize(
    ("sent", "recorded", "compared", "first"),
    [
        (ALL, ALL, 40, 0),
        (ALL[10:], ALL, 30, 10),
        (ALL, ALL[10:], 30, 10),
        (ALL[:30], ALL[10:], 20, 10),
        # the copy of a duplicate that was sent before the re-run begins
        (run(3, 4, *range(5, 20)), run(1, 2, 3, 3, 4, *range(5, 20)), 17, 3),
        # the recorder alone has missed some
        (ALL, [*ALL[:12], *ALL[14:]], 38, 0),
        # what was in flight at the beginning and is not recorded as an input is not compared
        ([unknown(0), ALL[1], unknown(2), *ALL[3:]], ALL, 38, 1),
        ([unknown(0), ALL[1], unknown(2), *ALL[3:]], ALL[1:], 38, 1),
        (run(38, 39), ALL, 2, 38),
        (ALL, run(0), 1, 0),
    ],
)
def test_what_is_the_same(
    sent: Sequence[ForwardedMessage], recorded: Sequence[ForwardedMessage], compared: int, first: int
) -> None:
    result = compare_forwarded(sent, recorded)
    assert result.difference == ""
    assert result.compared == {TOPIC: compared}
    assert result.first_seq == {TOPIC: first}


@pytest.mark.parametrize("place", [0, 1, 3, 20, 39])
def test_a_difference_is_found_at_its_place(place: int) -> None:
    other = [*ALL[:place], message(place, hand_seq=77), *ALL[place + 1 :]]
    result = compare_forwarded(other, ALL)
    assert (result.field, result.place) == ("hand_seq", place)
    assert "re-run hand_seq: 77 against" in result.difference
    cut = compare_forwarded([message(0, topic="law/status"), *other], ALL)
    # also where the re-run has topics that were not recorded
    assert (cut.field, cut.place) == ("hand_seq", place + 1)


def test_another_order_and_a_message_too_few_are_found() -> None:
    swapped = [*ALL[:20], ALL[21], ALL[20], *ALL[22:]]
    result = compare_forwarded(swapped, ALL)
    assert result.place == 20
    assert f"re-run {TOPIC}, seq 21 of " in result.difference
    assert f"against {TOPIC}, seq 20 of " in result.difference
    assert compare_forwarded([*ALL[:20], *ALL[21:]], ALL).place == 20


def test_flipped_bits_are_compared_as_well() -> None:
    broken = [found._replace(payload=b"\xc1" + found.payload[1:]) for found in ALL[:3]]
    assert compare_forwarded([*broken, *ALL], [*broken, *ALL]).compared == {TOPIC: 43}
    others = [found._replace(payload=found.payload[:-1] + b"\xc1") for found in broken]
    result = compare_forwarded([*others, *ALL], [*broken, *ALL])
    assert (result.place, result.difference) == (0, f"1 bytes of a damaged {TOPIC} differ from those recorded")


def test_nothing_in_common_is_a_difference_and_nothing_recorded_is_none() -> None:
    assert "which is not recorded with what follows it" in compare_forwarded(ALL, run(*range(100, 140))).difference
    assert compare_forwarded(ALL, []) == compare_forwarded([], ALL)
    assert compare_forwarded(ALL, []).compared == {}
