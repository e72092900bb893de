"""A person without a device: the force of `operator/force` on the simulated hand, and when there is none."""

from typing import Any

import pytest
from test_operator_by_command import Bench

from telenano.sections.operator_section import InteractiveConfig
from telenano.wire.node_state import pack, restore


class Hand(Bench):
    def __init__(self, bench: Any, operator: dict[str, Any]) -> None:
        super().__init__(bench, operator)
        self.control("start")

    def push(self, force_n: float) -> None:
        self.node.on_message(self.bench.received("operator/force", "view@master", force_n=(0.0, 0.0, -force_n)))


@pytest.fixture
def hand(bench_of: Any) -> Hand:
    return Hand(bench_of("haptic_node@master"), {"kind": "interactive"})


def test_the_hand_presses_with_the_newest_force_until_it_is_too_old(hand: Hand) -> None:
    assert set(hand.forces(3)) == {0.0}
    hand.push(1.5)
    assert set(hand.forces(20)) == {1.5}
    hand.push(-0.5)
    forces = hand.forces(120)
    # the deadline is 100 ms: the page may be gone
    assert forces[:99] == [-0.5] * 99
    assert forces[-15:] == [0.0] * 15
    hand.push(2.0)
    assert hand.forces(1) == [2.0]


def test_the_force_is_that_of_a_hand(bench_of: Any) -> None:
    strong = Hand(bench_of("haptic_node@master"), {"kind": "interactive", "max_force_n": 3.0})
    strong.push(500.0)
    assert strong.forces(1) == [3.0]


def test_there_is_no_force_while_no_session_runs(hand: Hand) -> None:
    fields = {"id": "b", "command": "stop", "target": "haptic_node", "parameters": {}}
    hand.node.on_control(hand.bench.make("session/control", "console@master", **fields))
    hand.push(1.0)
    assert set(hand.forces(2)) == {0.0}


def test_after_a_stall_the_hand_does_not_press_with_what_was_meant_before(hand: Hand) -> None:
    hand.forces(1)
    hand.push(1.0)
    hand.bench.advance_ms(70.0)
    assert set(hand.forces(5)) == {0.0}


def test_another_operator_is_not_overruled_and_that_is_said_once(bench_of: Any) -> None:
    profile = Hand(bench_of("haptic_node@master"), {"kind": "force_profile"})
    for _ in range(3):
        profile.push(5.0)
    assert set(profile.forces(5)) == {0.0}
    events = [event for event in profile.bench.take("session/event") if "ignored" in event.text]
    assert [event.data["source"] for event in events] == ["view@master"]
    assert "haptic_node.operator.kind must be interactive" in events[0].text


def test_a_re_run_begins_with_the_force_that_was_held(bench_of: Any) -> None:
    first = Hand(bench_of("haptic_node@master"), {"kind": "interactive"})
    first.push(1.25)
    first.forces(5)
    state = pack(first.node)
    again = Hand(first.bench, {"kind": "interactive"})
    restore(again.node, state)
    assert again.forces(10) == first.forces(10) == [1.25] * 10


def test_the_deadline_has_a_range() -> None:
    assert InteractiveConfig(kind="interactive").force_deadline_s == 0.1
