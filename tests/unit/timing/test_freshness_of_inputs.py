"""How old the inputs of a node are: commands at a device, samples and signals at a controller, and what is reported."""

import math
from typing import Any

import msgspec
import pytest

from telenano.link.declared_delay import DeclaredDelay
from telenano.link.fate import Release, delayed
from telenano.testing.filled_messages import examples
from telenano.timing.freshness import LOOP_DEADLINE_NS, Freshness
from telenano.wire import encode
from telenano.wire.codec import fields_of
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import LOOP_DEADLINE_S, TOPICS

MS = 1_000_000
START_NS = 1_750_000_000 * 10**9
NOW_NS = START_NS + 60 * 10**9


def message(topic: str, **changes: Any) -> Any:
    fields = fields_of(examples(TOPICS[topic])["ordinary"])
    return msgspec.convert({**fields, **changes}, TOPICS[topic].model)


def received(topic: str, age_ns: int, hand_age_ns: int = 0) -> Received:
    """Return a message that is received now."""
    stamps = {"t_ns": NOW_NS - age_ns}
    if topic.startswith("teleop/"):
        stamps["hand_t_ns"] = NOW_NS - hand_age_ns
    made = message(topic, **stamps)
    return Received(topic, made, encode(made), NOW_NS, Arrival.NEXT)


@pytest.fixture
def fresh() -> Freshness:
    return Freshness("controller@slave", START_NS)


def test_without_a_command_its_age_is_infinite(fresh: Freshness) -> None:
    assert fresh.command_age_s(None, NOW_NS, NOW_NS) == math.inf


@pytest.mark.parametrize(
    ("topic", "mode", "expected_s"),
    [
        ("afm/command", "position", 30e-3),
        ("afm/command", "hold", 30e-3),
        ("haptic/command", "position", 30e-3),
        # it moves nothing, and answers no sample
        ("haptic/command", "off", 10e-3),
    ],
)
def test_the_age_of_a_command_is_the_greater_of_its_own_and_that_of_the_sample_behind_it(
    fresh: Freshness, topic: str, mode: str, expected_s: float
) -> None:
    command = message(topic, mode=mode, t_ns=NOW_NS - 10 * MS, hand_t_ns=NOW_NS - 30 * MS)
    assert fresh.command_age_s(command, NOW_NS, NOW_NS) == pytest.approx(expected_s, rel=1e-9, abs=0.0)
    late = message(topic, mode=mode, t_ns=NOW_NS - 40 * MS, hand_t_ns=NOW_NS - 30 * MS)
    assert fresh.command_age_s(late, NOW_NS, NOW_NS) == pytest.approx(40e-3, rel=1e-9, abs=0.0)


def test_a_played_command_counts_from_its_reception_where_that_is_allowed(fresh: Freshness) -> None:
    played = message("afm/command", mode="position", t_ns=START_NS - 10**12, hand_t_ns=START_NS - 10**12)
    assert fresh.command_age_s(played, NOW_NS - 5 * MS, NOW_NS) == pytest.approx(5e-3, rel=1e-9, abs=0.0)
    fresh.allow_replay = False
    assert fresh.command_age_s(played, NOW_NS - 5 * MS, NOW_NS) > 1000.0


@pytest.mark.parametrize("topic", ["haptic/state", "afm/state"])
def test_a_sample_of_the_device_counts_from_its_own_stamp(fresh: Freshness, topic: str) -> None:
    assert fresh.rejection(received(topic, LOOP_DEADLINE_NS)) is None
    text = fresh.rejection(received(topic, LOOP_DEADLINE_NS + 1))
    src = message(topic).src
    assert text == f"{topic} of {src} is 50 ms off, of {LOOP_DEADLINE_S * 1e3:.0f} ms allowed: it is rejected"


@pytest.mark.parametrize("topic", ["teleop/forward", "teleop/backward"])
def test_a_signal_counts_from_the_sample_of_the_hand(fresh: Freshness, topic: str) -> None:
    # the clock of the sender is another one
    assert fresh.rejection(received(topic, 3600 * 10**9, LOOP_DEADLINE_NS)) is None
    assert fresh.rejection(received(topic, 0, 80 * MS)).startswith(f"{topic} of ")


def test_the_first_of_a_row_is_reported_and_each_topic_by_itself(fresh: Freshness) -> None:
    old, young = received("haptic/state", 80 * MS), received("haptic/state", MS)
    assert [bool(fresh.rejection(old)) for _ in range(3)] == [True, False, False]
    assert fresh.rejection(old) == ""
    assert fresh.rejection(received("teleop/backward", 0, 80 * MS))
    assert fresh.rejection(young) is None
    assert fresh.rejection(old)


def test_what_waited_during_a_stall_is_rejected_without_a_report(fresh: Freshness) -> None:
    old = received("haptic/state", 80 * MS)
    fresh.stalled_s(10**9)
    assert fresh.stalled_s(10**9 + LOOP_DEADLINE_NS) == 0.0
    assert fresh.rejection(old)
    assert fresh.rejection(received("haptic/state", MS)) is None
    assert fresh.stalled_s(2 * 10**9) > 0.0
    assert fresh.rejection(old) == ""


def test_what_has_no_deadline_is_never_too_old(fresh: Freshness) -> None:
    assert fresh.rejection(received("law/status", 3600 * 10**9)) is None
    assert fresh.rejection(received("session/control", 3600 * 10**9)) is None


@pytest.mark.parametrize(("delay_ns", "told_ns"), [(MS - 1, 0), (MS, MS), (2 * MS - 1, MS), (3 * MS, 3 * MS)])
def test_the_link_tells_its_delay_in_whole_milliseconds_so_that_an_age_is_too_great_by_less_than_one(
    delay_ns: int, told_ns: int
) -> None:
    topic = "teleop/forward"
    payload = encode(message(topic, hand_t_ns=NOW_NS - delay_ns))
    fate = delayed("forward", topic, 0, len(payload), NOW_NS - delay_ns, NOW_NS, delay_ns, False, "controller@master")
    declared, slave = DeclaredDelay(topic), Freshness("controller@slave", START_NS)
    if declared.changed_by(Release(topic, payload, fate)):
        told = message("link/delay", src="delay_node@master", direction="forward", **declared.current._asdict(),
                       transit_ns=0, clock_ahead_ns=0)  # fmt: skip
        slave.record(told)
    assert declared.current.delay_ns == told_ns
    assert slave.age_s(NOW_NS, NOW_NS - delay_ns) == pytest.approx((delay_ns - told_ns) * 1e-9, rel=1e-9, abs=0.0)
