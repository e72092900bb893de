"""A session whose hand feels far from what is there is warned of while it runs, and what cannot be known is said."""

import math
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest

import telenano
from telenano.analysis.felt_stiffness import NO_MOTION, SCALE_CHANGED, TOO_FAST, Felt, NotKnown, SampleFacts
from telenano.extend.advice import Advice
from telenano.launcher.felt_adviser import FeltAdviser
from telenano.sections.controller_section import ControllerConfig
from telenano.testing.filled_messages import examples
from telenano.wire.errors import RigError
from telenano.wire.topics import TOPICS

HAND, TIP, LAW, EVENT = (
    next(iter(examples(TOPICS[name]).values())) for name in ("haptic/state", "afm/state", "law/status", "session/event")
)
TICK_S = 0.05
STIFFNESS_N_PER_M = 20.0
SPRING = SampleFacts(STIFFNESS_N_PER_M, has_piezo=False)
HAND_PER_TIP = 150.0
REPLACED = msgspec.structs.replace


class Watched:
    """A session whose hand feels a share of the stiffness that is there, as the launcher gets its messages."""

    def __init__(self, facts: SampleFacts = SPRING, tell: Any = None) -> None:
        self.now_s = 5.0
        controller = ControllerConfig(law="wave")
        scales = controller.law_config()
        assert scales.force_scale * scales.position_scale == pytest.approx(HAND_PER_TIP, rel=1e-12, abs=0.0)
        self.position_scale, self.force_scale = scales.position_scale, scales.force_scale
        self.adviser = FeltAdviser(lambda: round(1e9 * self.now_s), controller, facts, tell)

    def run(
        self, seconds: float, share: float, hz: float = 0.7, amplitude_n: float = 0.3, runs: bool = True, **tip: Any
    ) -> list[Advice]:
        """Let time pass with a hand that swings and feels a share of a spring, and return the warnings of it."""
        found = []
        for _ in range(round(seconds / TICK_S)):
            self.now_s += TICK_S
            swing_n = amplitude_n * math.sin(2.0 * math.pi * hz * self.now_s)
            at: dict[str, Any] = {"t_ns": round(1e9 * self.now_s)}
            way_m = (1.0 + swing_n) / (share * HAND_PER_TIP * STIFFNESS_N_PER_M)
            base_m = self.position_scale * way_m
            hand = REPLACED(
                HAND, **at, mode="position", position_m=(0.0, 0.0, -way_m), operator_force_n=(0.0, 0.0, -1.0 - swing_n)
            )
            met = {
                "base_position_m": (0.0, 0.0, -base_m),
                "tip_force_n": (0.0, 0.0, STIFFNESS_N_PER_M * base_m),
                "in_contact": True,
                "mode": "follow",
                "felt_channel": None,
            }
            law = REPLACED(LAW, **at, law="wave", round_trip_valid=True)
            advice = self.adviser.look([hand, REPLACED(TIP, **{**at, **met, **tip}), law], runs=runs)
            found += [advice] if advice is not None else []
        return found


@pytest.mark.parametrize(("share", "kind"), [(2.2, "hard"), (0.4, "soft")])
def test_far_from_what_is_there_is_warned_of_once_and_again_after_it_was_right(share: float, kind: str) -> None:
    session = Watched()
    (advice,) = session.run(30.0, share)
    assert (advice.facts["felt"], advice.facts["law"]) == (kind, "wave")
    assert advice.facts["felt_ratio"] == pytest.approx(share, rel=0.02)
    assert f"The hand feels {share:.2f} (" in advice.text
    assert session.run(40.0, 1.0) == []
    assert len(session.run(30.0, share)) == 1


@pytest.mark.parametrize("share", [0.65, 1.0, 1.4])
def test_near_to_what_is_there_is_not_warned_of(share: float) -> None:
    session = Watched()
    assert session.run(30.0, share) == []
    assert isinstance(session.adviser.found, Felt)
    assert session.adviser.found.ratio == pytest.approx(share, rel=0.02)


def test_what_cannot_be_known_says_why() -> None:
    session = Watched()
    assert session.run(2.0, 0.3, runs=False) == []
    assert session.adviser.found == NotKnown("no session runs")
    session.run(20.0, 0.3, amplitude_n=0.0)
    assert session.adviser.found == NO_MOTION
    session.run(20.0, 0.3, in_contact=False)
    assert "did not touch" in str(session.adviser.found)
    session.run(20.0, 0.3, hz=4.0)
    assert session.adviser.found == TOO_FAST
    session.run(20.0, 0.3)
    assert isinstance(session.adviser.found, Felt)
    set_scale = REPLACED(EVENT, src="controller@master", kind="ack", text="set wave.force_scale = 2e8")
    session.adviser.look([set_scale], runs=True)
    session.run(1.0, 0.3)
    assert session.adviser.found == SCALE_CHANGED
    other = Watched(SampleFacts(no_force="what is felt is a table of current, and no force on the tip"))
    assert other.run(20.0, 0.3) == []
    assert "a table of current" in str(other.adviser.found)


def test_a_stated_stiffness_that_the_tip_contradicts_does_not_count() -> None:
    session = Watched(SampleFacts(5.0, has_piezo=False))
    assert session.run(30.0, 1.0) == []
    assert isinstance(session.adviser.found, Felt)
    assert session.adviser.found.ratio == pytest.approx(1.0, rel=0.02)


def test_of_a_sample_that_nobody_stated_it_is_less_sure_on_a_piezo() -> None:
    session = Watched(SampleFacts())
    assert session.run(30.0, 1.8) == []
    assert isinstance(session.adviser.found, Felt) and session.adviser.found.kind == "open"
    assert len(session.run(30.0, 3.0)) == 1


def test_what_is_known_is_told_and_a_file_that_cannot_be_written_ends_nothing() -> None:
    told: list[str] = []

    def tell(felt: str) -> None:
        told.append(felt)
        if len(told) > 3:
            raise RigError("no space")

    assert len(Watched(tell=tell).run(30.0, 0.4)) == 1
    assert told[0].startswith("not known") and told[-1].startswith("0.40 (")
    assert len(told) < 20


def messages_of(session: Any) -> Iterator[list[Any]]:
    """Yield what a launcher would have read of a session in simulated time, at each of its ticks."""
    times = session["time_s"]
    for place in np.searchsorted(times, np.arange(0.0, float(times[-1]), TICK_S)).tolist():
        at: dict[str, Any] = {"t_ns": round(1e9 * (10.0 + float(times[place])))}
        column = {name: float(session[name][place]) for name in session}
        hand = REPLACED(
            HAND,
            **at,
            mode="position" if column["hand_following"] else "off",
            position_m=(0.0, 0.0, -column["hand_position_m"]),
            operator_force_n=(0.0, 0.0, -column["operator_force_n"]),
        )
        tip = REPLACED(
            TIP,
            **at,
            base_position_m=(0.0, 0.0, -column["base_position_m"]),
            tip_force_n=(0.0, 0.0, column["tip_force_n"]),
            in_contact=bool(column["in_contact"]),
            mode="follow",
            felt_channel=None,
        )
        yield [hand, tip, REPLACED(LAW, **at, law=session.conditions.law, round_trip_valid=True)]


@pytest.mark.check("simulates three sessions of 14 s")
@pytest.mark.parametrize(("law", "said"), [("virtual_impedance", []), ("passivity", ["soft"]), ("wave", [])])
def test_it_says_while_the_session_runs_what_its_summary_says(law: str, said: list[str]) -> None:
    points = [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.5, "force_n": 1.0}]
    points += [
        {"time_s": 2.0 + t, "force_n": 1.0 + 0.3 * math.sin(math.pi * t)} for t in np.arange(0.0, 12.0, 0.02).tolist()
    ]
    spring = {"afm_node.spring.stiffness_n_per_m": STIFFNESS_N_PER_M, "afm_node.safety.retract_position_m": 0.0}
    session = telenano.simulate(
        "fig12",
        law=law,
        environment="spring",
        operator={"kind": "force_profile", "points": points},
        duration_s=14.0,
        settings=spring,
    )
    now = [0.0]
    adviser = FeltAdviser(lambda: round(1e9 * now[0]), ControllerConfig(law=law), SPRING)
    found = []
    for messages in messages_of(session):
        now[0] += TICK_S
        found += [advice] if (advice := adviser.look(messages, runs=True)) is not None else []
    assert [advice.facts["felt"] for advice in found] == said
    assert [one.felt.kind for one in session.felt_stiffness.outside] == said
    assert isinstance(adviser.found, Felt) and session.felt_stiffness.felt is not None
    assert adviser.found.ratio == pytest.approx(session.felt_stiffness.felt.ratio, rel=0.05)
