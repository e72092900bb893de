"""Answers that come late, from before, or in another law are none: a hand that they reach moves no tip.

`tests/simulation` cuts the network, in one direction or in both, for any time, over each delay and under each law.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from telenano.virtual import LINK_ENDPOINT, LINK_NODE, VirtualRig, constant_timing
from telenano.wire import Message

HAND, TIP, MASTER_HALF = "haptic_node@master", "afm_node@slave", "controller@master"
NS_PER_S = 1_000_000_000
TIP_S, HAND_S = 0.5, 0.1
# from the decision of a device to its state, and what the link rounds of the delay that it reports
GRAIN_S = 0.002
# nothing late and nothing random, and the link a node of its own
TIMING = constant_timing(None, 100_000)
# A hand that is moved over a sample, which no law makes unstable over a long way.
WAY = [{"time_s": 0.0, "position_m": 0.0}, {"time_s": 0.2, "position_m": 1e-3}]


class Session(VirtualRig):
    """A hand that moves the tip over a link whose ways can be blocked, or become longer without a report of it [s]."""

    def __init__(self, link_s: float) -> None:
        scenario = {
            "name": "virtual",
            "description": "A hand moves the tip, and answers stay away",
            "duration_s": 60.0,
            "haptic_node": {"operator": {"kind": "impedance", "path": WAY}},
            "afm_node": {"rest_distance_m": 50e-9},
            "delay_node": {way: {"delay_s": link_s} for way in ("forward", "backward")},
        }
        self.blocked: set[str] = set()
        self.late_s: dict[str, float] = {}
        super().__init__(None, 1, (), TIMING, scenario)
        self.link_s, self.time_s = link_s, 0.0
        self.run(0.15 + 2.0 * link_s)
        self.command("arm", "*", place="hand")
        self.run(0.15 + 2.0 * link_s)
        self.command("start", HAND)
        self.run(0.6 + 4.0 * link_s)

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Lose what leaves the link where the way is blocked, and bring it later where the way has become longer."""
        if endpoint not in self.blocked:
            super().forward(endpoint, topic, payload)

    def _deliver(
        self, sender: str, key: str, topic: str, payload: bytes, sent_ns: int, message: Message | None
    ) -> None:
        late_ns = round(1e9 * self.late_s.get(sender, 0.0))
        super()._deliver(sender, key, topic, payload, sent_ns + late_ns, message)

    def run(self, duration_s: float) -> None:
        self.time_s += duration_s
        self.run_until(self.time_s)

    def states(self, topic: str, src: str, since_ns: int) -> list[Any]:
        return [state for state in self.received(topic, src) if state.t_ns >= since_ns]

    def unanswered_s(self, since_ns: int, is_meant: Callable[[Any], bool], topic: str, src: str) -> float:
        """Give the longest time from the newest answer that the hand had to a state of a device that is meant [s]."""
        hands = self.received("haptic/state", HAND)
        answered = [now.t_ns for old, now in pairwise(hands) if now.answered_t_ns > old.answered_t_ns]
        meant = [state.t_ns for state in self.states(topic, src, since_ns) if is_meant(state)]
        return max((t_ns - max(at_ns for at_ns in answered if at_ns <= t_ns) for t_ns in meant), default=0) / NS_PER_S


def follows(state: Any) -> bool:
    return bool(state.mode == "follow")


def is_driven(state: Any) -> bool:
    return bool(state.mode != "off")


def test_a_short_silence_of_the_other_site_withdraws_nothing() -> None:
    rig = Session(0.02)
    try:
        since_ns = rig.clock.now_ns()
        rig.blocked.add(LINK_NODE)
        rig.run(0.25)
        rig.blocked.clear()
        rig.run(0.5)
        assert {state.mode for state in rig.states("afm/state", TIP, since_ns)} == {"follow"}
        assert "off" in {state.mode for state in rig.states("haptic/state", HAND, since_ns)}
        assert rig.received("haptic/state", HAND)[-1].mode != "off"
    finally:
        rig.close()


@pytest.mark.grid(way="backward")
@pytest.mark.parametrize("way", ["forward", "backward"])
def test_answers_that_come_too_late_for_the_hand_are_none(way: str) -> None:
    """Let a way become longer by more than a reader learns by itself, and nobody report it: the hand stays off."""
    rig = Session(0.02)
    try:
        since_ns = rig.clock.now_ns()
        rig.late_s[LINK_ENDPOINT if way == "forward" else LINK_NODE] = 0.4
        rig.run(1.5)
        assert rig.states("haptic/state", HAND, since_ns)[-1].mode == "off"
        assert rig.states("afm/state", TIP, since_ns)[-1].mode == "retracted"
        driven = [state.t_ns for state in rig.states("haptic/state", HAND, since_ns) if is_driven(state)]
        moved = [state.t_ns for state in rig.states("afm/state", TIP, since_ns) if follows(state)]
        assert max(moved) - max(driven) <= (TIP_S + rig.link_s) * NS_PER_S
    finally:
        rig.close()


@pytest.mark.check("takes 2 s")
def test_a_restarted_half_takes_no_answer_of_before_for_a_fresh_one() -> None:
    """Build a new master half while nothing comes back: the hand has had an answer, and long ago."""
    rig = Session(0.02)
    try:
        rig.blocked.add(LINK_NODE)
        rig.run(2.0)
        rig.restart(MASTER_HALF)
        since_ns = rig.clock.now_ns()
        rig.run(0.5)
        sent = rig.states("teleop/forward", MASTER_HALF, since_ns)
        assert len(sent) > 100
        assert not any(message.hand_armed for message in sent)
    finally:
        rig.close()


@pytest.mark.check("takes 2 s")
def test_answers_in_another_law_are_none() -> None:
    """Change the law of the instrument's half alone: the hand feels nothing, and moves no tip."""
    rig = Session(0.02)
    try:
        since_ns = rig.clock.now_ns()
        rig.command("set", "controller@slave", law="wave")
        rig.run(1.0)
        assert rig.states("haptic/state", HAND, since_ns)[-1].mode == "off"
        assert rig.states("afm/state", TIP, since_ns)[-1].mode == "retracted"
        assert rig.unanswered_s(since_ns, is_driven, "haptic/state", HAND) <= HAND_S + GRAIN_S
        assert rig.unanswered_s(since_ns, follows, "afm/state", TIP) <= TIP_S + rig.link_s + GRAIN_S
    finally:
        rig.close()
