"""A law by the line: what is measured, and that a decision keeps its distance, its limits and the hand's rest."""

import random
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from telenano_laws import by_line_command
from telenano_laws.by_line import (
    CANDIDATES,
    DWELL_S,
    HAND,
    MASTER,
    SLAVE,
    STALL_S,
    STOOD_M,
    TIP,
    Decision,
    Line,
    LineWindow,
    Policy,
)
from telenano_laws.by_line_command import carry_out, policy_of

from telenano.runtime import Command
from telenano.sections import ControllerConfig
from telenano.wire import ConfigError, TelenanoError

EVEN = Line(0.02, 0.02, 0.021, 0.021, 0.001, 0.0, 10.0)
UNEVEN = EVEN._replace(lost=0.01)
STATUS_S = 0.1


def status(law: str, age_s: float = 0.02, silence_s: float = 0.0, **other: Any) -> Any:
    said = {"switching": False, "heard": True, "round_trip_valid": True, **other}
    return SimpleNamespace(law=law, round_trip_s=age_s, silence_s=silence_s, **said)


def hand(speed_m_per_s: float) -> Any:
    return SimpleNamespace(velocity_m_per_s=(0.0, 0.0, speed_m_per_s))


def health(topic: str, received: int, lost: int) -> Any:
    return SimpleNamespace(inputs=[SimpleNamespace(topic=topic, received=received, lost=lost)], device_latency_s=None)


def policy(stiffness_n_per_m: float = 20.0, latency_s: float = 0.0) -> Policy:
    made = Policy(ControllerConfig(), stiffness_n_per_m)
    made.take("haptic/state", HAND, 0.0, hand(0.0))
    made.take("node/health", TIP, 0.0, SimpleNamespace(inputs=[], device_latency_s=latency_s))
    return made


def watched(made: Policy, law: str, begin_s: float, end_s: float, age_s: float = 0.02) -> list[tuple[float, Decision]]:
    """Return the decisions over a time in which the law stays in force, whatever is decided."""
    found = []
    for n in range(round((end_s - begin_s) / STATUS_S)):
        time_s = begin_s + n * STATUS_S
        decision = made.take("law/status", MASTER, time_s, status(law, age_s))
        if decision is not None:
            found.append((time_s, decision))
    return found


def test_a_line_is_its_floor_its_spread_its_longest_stall_and_what_both_ways_lost() -> None:
    window = LineWindow(10.0)
    for n in range(1001):
        window.add_age(0.01 * n, 0.1 if n % 8 == 0 else 0.03, 0.07 if n == 500 else 0.001)
    for half, topic in ((MASTER, "teleop/backward"), (SLAVE, "teleop/forward")):
        window.add_counts(half, 0.0, health(topic, 1000, 50).inputs)
        window.add_counts(half, 10.0, health(topic, 1900, 150 if half == MASTER else 50).inputs)
    line = window.line()
    assert line is not None
    assert line == pytest.approx((0.03, 0.03, 0.1, 0.1, 0.07, 100.0 / 1900.0, 10.0, 0))
    assert str(line) == "floor 30 ms, spread 70 ms, longest silence 70 ms, 0 stalls in a minute, 5.3 % lost"


def test_stalls_are_counted_once_each_for_a_minute_also_over_a_change_of_law() -> None:
    window = LineWindow(10.0)
    for n in range(900):
        # silent for 0.3 s each at 20 s and at 50 s
        silence_s = max(0.1 * n % 30.0 - 20.0, 0.0) + 0.05
        window.add_age(0.1 * n, 0.02, silence_s if silence_s <= 0.3 else 0.001)
        line = window.line()
        if n == 400:
            window.forget()
        assert line is not None
        assert line.stalls == sum(begin < 0.1 * n + 1e-9 < begin + 60.0 for begin in (20.1, 50.1, 80.1))


def test_the_window_forgets_what_is_older_than_it() -> None:
    window = LineWindow(2.0)
    window.add_age(0.0, 0.5, 0.09)
    window.add_counts(MASTER, 0.0, health("teleop/backward", 10, 10).inputs)
    for n in range(1, 6):
        window.add_age(float(n), 0.02, 0.0)
        window.add_counts(MASTER, float(n), health("teleop/backward", 10 + 100 * n, 10).inputs)
    line = window.line()
    assert line is not None and line.is_even(1e-3)


@pytest.mark.parametrize(
    ("line", "stiffness_n_per_m", "latency_s", "law"),
    [
        (EVEN, 20.0, 0.0, "bounded_model"),
        (EVEN, 390.0, 0.0, "bounded_model"),
        (UNEVEN, 170.0, 0.0, "bounded_model"),
        (UNEVEN, 180.0, 0.0, "passivity"),
        (EVEN._replace(late_s=0.025), 180.0, 0.0, "passivity"),
        (EVEN, 390.0, 1e-3, "passivity"),
        (EVEN._replace(median_s=0.8, slow_s=0.9, late_s=1.0), 20.0, 0.0, "passivity"),
        # What follows a stall says nothing of the line otherwise.
        (EVEN._replace(late_s=1.0), 20.0, 0.0, "bounded_model"),
        (EVEN._replace(slow_s=0.4, late_s=1.0, stalls=1), 20.0, 0.0, "model_mediated"),
        (EVEN._replace(slow_s=0.06, late_s=0.09), 20.0, 0.0, "model_mediated"),
        (EVEN._replace(slow_s=0.06, late_s=0.09), 180.0, 0.0, "passivity"),
        (EVEN._replace(slow_s=0.035), 20.0, 0.0, "bounded_model"),
        (EVEN._replace(median_s=0.21, slow_s=0.25), 20.0, 0.0, "bounded_model"),
        (EVEN._replace(floor_s=0.001, slow_s=0.06), 20.0, 0.0, "bounded_model"),
        # One stall in a minute may be an outage, two are the line's own.
        (EVEN._replace(floor_s=0.001, stalls=1), 20.0, 0.0, "bounded_model"),
        (EVEN._replace(floor_s=0.001, stalls=2), 20.0, 0.0, "model_mediated"),
        (EVEN._replace(median_s=0.21, stalls=2), 20.0, 0.0, "bounded_model"),
    ],
)
def test_the_first_law_that_bears_sample_instrument_and_line_is_chosen(
    line: Line, stiffness_n_per_m: float, latency_s: float, law: str
) -> None:
    made = policy(stiffness_n_per_m, latency_s)
    made.take("law/status", MASTER, 0.0, status("virtual_impedance"))
    decision = made.decided(line)
    assert decision is not None and decision.law == law
    made.take("law/status", MASTER, 0.0, status(law))
    assert made.decided(line) is None


def test_where_no_law_bears_the_sample_the_one_in_force_stays() -> None:
    made = policy(900.0)
    made.take("law/status", MASTER, 0.0, status("virtual_impedance"))
    assert made.decided(UNEVEN) is None


def test_a_decision_waits_for_a_line_that_was_looked_at_and_for_a_hand_that_rests() -> None:
    made = policy()
    found = watched(made, "passivity", 0.0, 9.5)
    made.take("haptic/state", HAND, 9.5, hand(1.1 * STOOD_M / 0.04))
    assert found == watched(made, "passivity", 9.5, 15.0) == []
    made.take("haptic/state", HAND, 15.0, hand(0.9 * STOOD_M / 0.04))
    ((time_s, decision), (again_s, _)) = watched(made, "passivity", 15.0, 26.0)
    # It is asked for once more where nothing has come of it.
    assert (decision.law, time_s) == ("bounded_model", pytest.approx(15.0))
    assert again_s - time_s == pytest.approx(DWELL_S, abs=0.2)


def test_nothing_is_decided_while_the_line_stands_still() -> None:
    made = policy()
    for n in range(400):
        assert made.take("law/status", MASTER, 0.05 * n, status("passivity", silence_s=1.1 * STALL_S)) is None


# age of the answers [s], silence [s], speed of the hand [m/s], signals lost a report, how long [s], law set by a person
step = st.tuples(
    st.floats(0.001, 1.5),
    st.floats(0.0, 0.06),
    st.floats(0.0, 1e-3),
    st.integers(0, 1),
    st.floats(5.0, 25.0),
    st.sampled_from([*(one.law for one in CANDIDATES), "wave", ""]),
)


@settings(deadline=None, max_examples=20)
@given(
    stiffness_n_per_m=st.floats(1.0, 1000.0),
    latency_s=st.sampled_from([0.0, 1e-3, 4e-3]),
    steps=st.lists(step, min_size=1, max_size=3),
)
def test_changes_are_far_apart_at_rest_and_within_every_limit(
    stiffness_n_per_m: float, latency_s: float, steps: list[tuple[float, float, float, int, float, str]]
) -> None:
    """Over any course of the line, of the hand, and of laws that a person sets in between."""
    made, law, time_s, changed_s = policy(stiffness_n_per_m, latency_s), "wave", 0.0, -DWELL_S
    received = lost = 0
    for age_s, silence_s, speed, lost_each, lasts_s, by_person in steps:
        made.take("haptic/state", HAND, time_s, hand(speed))
        if by_person not in ("", law):
            changed_s, law = time_s, by_person
        for _ in range(round(lasts_s / STATUS_S)):
            time_s += STATUS_S
            received, lost = received + 100, lost + lost_each
            made.take("node/health", SLAVE, time_s, health("teleop/forward", received, lost))
            decision = made.take("law/status", MASTER, time_s, status(law, age_s, silence_s))
            if decision is None:
                continue
            line = made.line
            assert line is not None and time_s - changed_s >= DWELL_S - STATUS_S - 1e-6
            assert decision.law != law and silence_s <= STALL_S and speed * age_s <= STOOD_M
            even = line.is_even(1e-3)
            limit = ControllerConfig(law=decision.law).stiffness_limit_n_per_m(round(1e3 * latency_s), even=even)
            assert limit is not None and stiffness_n_per_m <= limit
            changed_s, law = time_s, decision.law


def test_a_decision_is_a_command_of_the_session_and_a_mark_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    sent: list[Command] = []
    made = policy()
    assert carry_out(made, Decision("passivity", "because"), lambda command: sent.append(command) or "")
    assert [(one.name, one.target, dict(one.parameters)) for one in sent] == [
        ("set", "controller", {"law": "passivity"}),
        ("mark", "recorder", {"law_by_line": "passivity", "reason": "because"}),
    ]
    assert capsys.readouterr().out == "law passivity: because\n"


def test_a_law_that_a_node_refuses_is_not_asked_for_again() -> None:
    made = policy()
    assert not carry_out(made, Decision("bounded_model", "because"), lambda command: "too slow for it")
    made.take("law/status", MASTER, 0.0, status("model_mediated"))
    decision = made.decided(EVEN)
    assert decision is not None and decision.law == "passivity" and "too slow for it" in decision.reason


def test_scenario_and_options_say_what_may_be_chosen() -> None:
    made = policy_of(Path("fig12"), "passivity,bounded_model", None)
    assert [one.law for one in made.candidates] == ["passivity", "bounded_model"]
    with pytest.raises(ConfigError, match="--law: wave: law by-line chooses among model_mediated, bounded_model"):
        policy_of(Path("fig12"), "wave", None)


def test_a_command_that_no_rig_takes_is_an_error_with_the_reason() -> None:
    with pytest.raises(TelenanoError, match="no rig"):
        by_line_command._sent(Command("set", "controller"), by_line_command.DEFAULT_SITE_FILE)


def test_a_refusal_that_is_no_fault_of_the_law_is_asked_again() -> None:
    made = policy()

    def busy(command: Command) -> str:
        raise TelenanoError("Paul holds control: ask for it")

    assert not carry_out(made, Decision("bounded_model", "because"), busy)
    assert not made.doubts(CANDIDATES[1], EVEN)
    assert carry_out(
        made, Decision("bounded_model", "because"), lambda command: "" if command.name == "set" else busy(command)
    )


@pytest.mark.parametrize("seed", range(2))
def test_no_order_of_messages_makes_it_fail_ask_too_often_or_stand_still_for_ever(seed: int) -> None:
    draw, made = random.Random(seed), policy()
    arrived_s, clock_s, law, speed = 0.0, 0.0, "passivity", 0.0
    asked_s: list[float] = []

    def told(topic: str, src: str, time_s: float, message: Any) -> None:
        nonlocal law
        decision = made.take(topic, src, time_s, message)
        if decision is None:
            return
        # by the time at which messages arrive, whatever they say of themselves
        assert not asked_s or arrived_s - asked_s[-1] >= 0.9 * DWELL_S
        assert speed * 0.02 <= STOOD_M
        asked_s.append(arrived_s)
        law = decision.law if draw.random() < 0.7 else law

    def turn(*, is_hostile: bool) -> None:
        nonlocal arrived_s, clock_s, speed
        arrived_s += STATUS_S
        clock_s += STATUS_S
        if is_hostile and draw.random() < 0.02:
            # a clock that is set, by a second or by thirty years
            clock_s += draw.choice((-1e9, -3600.0, -1.0, 1.0, 3600.0, 1e9))
        if is_hostile and draw.random() < 0.3:
            src = draw.choice((MASTER, SLAVE, HAND, TIP, "console@master"))
            speed = draw.choice((0.0, 1e-9, 0.3, 1e3)) if src == HAND else speed
            told("haptic/state", src, clock_s, hand(speed))
            counts = (draw.choice((0, 7, 1 << 63)), draw.choice((0, 7, 1 << 63)))
            told("node/health", draw.choice((MASTER, SLAVE)), clock_s, health("teleop/backward", *counts))
        other = {"switching": draw.random() < 0.02, "heard": draw.random() < 0.9} if is_hostile else {}
        age_s = draw.choice((0.0, 1e-9, 0.02, 5.0, 1e300)) if is_hostile and draw.random() < 0.2 else 0.02
        silence_s = draw.choice((0.0, 0.2, 1e300)) if is_hostile and draw.random() < 0.2 else 0.0
        named = draw.choice(("wave", law)) if is_hostile and draw.random() < 0.02 else law
        told("law/status", MASTER, clock_s, status(named, age_s, silence_s, **other))

    for _ in range(2000):
        turn(is_hostile=True)
        assert len(made._window._ages) < 200 and all(len(counts) < 300 for counts in made._window._counts.values())
    # it goes on by itself once the attack is over
    law, before = "wave", len(asked_s)
    made.take("haptic/state", HAND, clock_s, hand(0.0))
    speed = 0.0
    for _ in range(round(100.0 / STATUS_S)):
        turn(is_hostile=False)
    assert len(asked_s) > before
