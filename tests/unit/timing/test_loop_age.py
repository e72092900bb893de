"""The age of the loop by its parts, from stamps of messages of which the true parts are known."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from telenano.timing.loop_age import (
    STAGES,
    TOGETHER,
    WITH_JITTER,
    Delay,
    LoopAge,
    Part,
    in_words,
    parts_of,
    split,
    took_from,
)

MS = 1_000_000
T_NS = 10**18
# what each stage takes besides the link [ns], the two ways of the link, and the way to the device
OWN = dict(zip(STAGES, (200_000, 300_000, 900_000, 150_000, 250_000), strict=True))
DEVICE_S, QUEUE_NS, AHEAD_NS = 5e-4, 100_000, 37_000 * MS


def loop(
    age: LoopAge, *, there_ms: int, back_ms: int, line_ns: int = 0, topics: tuple[str, ...] = tuple(STAGES)
) -> None:
    """Let 400 samples of the hand be answered over a link that is stated, by a slave whose clock is ahead."""
    for way, delay in (("forward", there_ms), ("backward", back_ms)):
        facts = {"direction": way, "hand_t_ns": T_NS, "delay_ns": delay * MS, "transit_ns": line_ns}
        age.take("link/delay", "delay_node@master", T_NS, {**facts, "clock_ahead_ns": AHEAD_NS})
    for number in range(400):
        begun = at = T_NS + number * MS
        state: dict[str, Any] = {"sample_age_s": DEVICE_S, "answered_t_ns": 0, "answered_at_ns": 0}
        age.take("haptic/state", "haptic_node@master", begun, state)
        for topic, own in OWN.items():
            at += own
            at += there_ms * MS + line_ns if topic == "afm/command" else 0
            at += back_ms * MS + line_ns if topic == "haptic/command" else 0
            is_slave = topic in ("afm/command", "afm/state", "teleop/backward")
            src, ahead = ("afm_node@slave", AHEAD_NS) if is_slave else ("controller@master", 0)
            if topic in topics:
                age.take(topic, src, at + ahead, {"hand_t_ns": begun})
        answered = {"answered_t_ns": begun, "answered_at_ns": at + QUEUE_NS}
        age.take("haptic/state", "haptic_node@master", at + MS, {**state, "sample_age_s": None, **answered})


def test_each_part_is_what_it_was() -> None:
    age = LoopAge()
    loop(age, there_ms=20, back_ms=10, line_ns=4 * MS)
    found = {part.name: part.p50_s for part in age.parts()}
    whole = found.pop("whole")
    assert found == pytest.approx(
        {
            "device of the hand": 5e-4,
            "law of the master": 4.5e-4,
            "link there, on purpose": 20e-3,
            "line there": 4e-3,
            "law of the slave": 4.5e-4,
            "instrument": 9e-4,
            "link back, on purpose": 10e-3,
            "line back": 4e-3,
            "queue at the device": 1e-4,
        },
        rel=1e-9,
    )
    assert whole == pytest.approx(sum(found.values()), rel=1e-9)
    # each sample is told once
    assert age.parts() == []


def test_of_whom_nothing_is_known_the_parts_are_told_together() -> None:
    age = LoopAge()
    loop(age, there_ms=20, back_ms=10, topics=("afm/state", "haptic/command"))
    found = {part.name: part.p50_s for part in age.parts()}
    assert found[TOGETHER] == pytest.approx(1e-9 * sum(OWN.values()), rel=1e-9)
    assert found["link there, on purpose"] == pytest.approx(20e-3, rel=1e-9)
    # between two machines the rest has what the line takes beyond its least
    loop(age, there_ms=20, back_ms=10, line_ns=MS, topics=("afm/state", "haptic/command"))
    assert {part.name for part in age.parts()} >= {WITH_JITTER, "line there"}


@pytest.mark.parametrize("clocks_open_ns", [-150_000, 0, 150_000])
def test_the_line_of_a_sample_is_that_of_the_datagram_that_carried_it(clocks_open_ns: int) -> None:
    """Also where datagrams overtake one another, and the clocks are known to 0.15 ms."""
    random = np.random.default_rng(1)
    due_ns = T_NS + MS * np.arange(2000)
    left_ns = due_ns + random.integers(60_000, 250_000, due_ns.size) + clocks_open_ns
    took_ns = random.integers(10 * MS, 30 * MS, due_ns.size)
    lost = random.random(due_ns.size) < 0.05
    found = took_from(due_ns[~lost], left_ns[~lost], took_ns[~lost])
    assert (found == took_ns[~lost]).all()
    # A sample whose datagram was lost came with the next one.
    assert (took_from(due_ns, left_ns[~lost], took_ns[~lost])[lost] >= 10 * MS).all()


def test_too_few_samples_have_no_parts_and_a_loop_that_is_never_answered_takes_no_memory() -> None:
    age = LoopAge()
    assert age.parts() == []
    for number in range(20_000):
        age.take("afm/state", "afm_node@slave", T_NS + number, {"hand_t_ns": T_NS + number})
        if number % 5000 == 0:
            age.parts()
    age.parts()
    assert len(age._sent["afm/state"]) <= 4000


TIMES = st.lists(st.integers(0, 50 * MS), min_size=7, max_size=7)


@pytest.mark.check("takes 2.1 s")
@given(st.lists(TIMES, min_size=20, max_size=60), st.integers(0, 40 * MS), st.integers(0, 20 * MS))
def test_the_parts_add_up_to_the_whole_whatever_the_link_says(steps: list[list[int]], there: int, line: int) -> None:
    passed = T_NS + np.cumsum(np.array(steps, np.int64), axis=1)
    count = np.ones(len(passed), np.int64)
    delays = {way: (there * count, line * count) for way in ("forward", "backward")}

    found = split(passed, tuple(STAGES), {way: Delay(*both) for way, both in delays.items()}, np.zeros(len(passed)))
    assert all((values >= 0.0).all() for values in found.values())
    whole_s = 1e-9 * (passed[:, -1] - passed[:, 0])
    np.testing.assert_allclose(np.sum(list(found.values()), axis=0), whole_s, rtol=1e-9, atol=1e-15)


def test_the_median_and_the_slow_sample_have_parts_that_add_up_within_5_percent() -> None:
    rng = np.random.default_rng(49)
    steps = rng.exponential([0.2e6, 20e6, 1e6, 0.3e6, 20e6, 0.1e6], (4000, 6)).astype(np.int64)
    passed = np.concatenate([np.full((4000, 1), T_NS), T_NS + np.cumsum(steps, axis=1)], axis=1)

    *parts, whole = parts_of(split(passed, tuple(STAGES), {}, np.zeros(4000)))
    assert sum(part.p50_s for part in parts) == pytest.approx(whole.p50_s, rel=0.05)
    assert sum(part.p99_s for part in parts) == pytest.approx(whole.p99_s, rel=0.05)
    # the sum of the 99 % of the parts is something else
    assert sum(np.percentile(steps, 99, axis=0)) * 1e-9 > 1.2 * whole.p99_s


def test_the_parts_of_the_slow_sample_add_up_where_the_slowest_are_much_slower() -> None:
    # as of a machine that is held up now and again: 1 % of the samples is late by a wide distribution
    rng = np.random.default_rng(7)
    steps = rng.exponential(0.4e6, (40_000, 6))
    steps[:, 2] += np.where(rng.random(40_000) < 0.01, rng.exponential(10e6, 40_000), 0.0)
    passed = np.concatenate([np.full((40_000, 1), T_NS), T_NS + np.cumsum(steps, axis=1).astype(np.int64)], axis=1)

    *parts, whole = parts_of(split(passed, tuple(STAGES), {}, np.zeros(40_000)))
    assert sum(part.p99_s for part in parts) == pytest.approx(whole.p99_s, rel=0.05)


def test_the_largest_part_is_said_in_words() -> None:
    parts = [Part("a", 0.002, 0.02), Part("link there, on purpose", 0.02, 0.02), Part("whole", 0.0425, 0.05)]
    assert in_words(parts) == "link there, on purpose: 20 of 42.5 ms"
    assert in_words([]) == ""
