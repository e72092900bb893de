"""The hand that moves and waits: how many moves it makes, and what an answer costs it, are those of the closed form."""

import math
from typing import Any

import pytest

from telenano.extend.operators import OperatorInputs
from telenano.hand.reacting import ReactingState, at_rest, step
from telenano.sections.hand_section import HapticConfig
from telenano.settings.config import validate

DT = 1e-3


def hand(**given: Any) -> Any:
    section = {"operator": {"kind": "reacting", **given}}
    return validate(HapticConfig, section, "made", "haptic_node").operator.to_params()


def run(params: Any, duration_s: float, speed_m_per_s: float = 0.0) -> list[ReactingState]:
    """Let it press on an arm that stands, or that goes on at a speed."""
    state, states = at_rest(params, 0.0), []
    for n in range(round(duration_s / DT)):
        place = n * DT * speed_m_per_s
        state, _ = step(params, state, OperatorInputs((n + 1) * DT, place, place + DT * speed_m_per_s), DT)
        states.append(state)
    return states


def ends_s(states: list[ReactingState], moves: int) -> float:
    return DT * next(n for n, state in enumerate(states) if state.moves == moves and state.force_n == state.goal_n)


@pytest.mark.parametrize("gain", [0.3, 0.6, 0.8])
def test_it_makes_as_many_moves_as_the_closed_form_has(gain: float) -> None:
    states = run(hand(gain=gain, tolerance_n=0.05), 20.0)
    expected = math.ceil(math.log(0.05) / math.log(1.0 - gain))
    assert states[-1].moves == expected
    assert states[-1].force_n == pytest.approx(1.0 - (1.0 - gain) ** expected, rel=1e-9)


@pytest.mark.parametrize("answer_s", [0.1, 0.37, 1.0])
def test_each_move_but_the_first_costs_the_answer_once(answer_s: float) -> None:
    prompt, late = (run(hand(answer_s=each), 20.0) for each in (0.0, answer_s))
    for moves in range(1, prompt[-1].moves + 1):
        assert ends_s(late, moves) - ends_s(prompt, moves) == pytest.approx((moves - 1) * answer_s, abs=5 * DT)


def test_while_the_arm_moves_it_waits() -> None:
    assert run(hand(), 5.0, speed_m_per_s=2e-3)[-1].moves == 0
    assert run(hand(), 5.0, speed_m_per_s=0.5e-3)[-1].moves > 0


@pytest.mark.check("takes 0.9 s")
def test_the_scatter_is_that_of_the_seed_and_is_corrected() -> None:
    ends = {seed: run(hand(noise=0.5, seed=seed), 20.0)[-1] for seed in range(6)}
    assert all(abs(end.force_n - 1.0) <= 0.05 for end in ends.values())
    assert len({end.force_n for end in ends.values()}) == 6
    assert run(hand(noise=0.5, seed=3), 20.0)[-1] == ends[3]


def test_before_the_session_there_is_no_force_and_beyond_its_strength_it_says_so() -> None:
    params = hand(points=[{"time_s": 0.0, "force_n": 5.0}], max_force_n=2.0)
    state, out = step(params, ReactingState(1.0, 1.0, 9.0, 3), OperatorInputs(-1.0, 0.0, 0.0), DT)
    assert (state, out) == (at_rest(params, 0.0), (0.0, False))
    state, out = step(params, ReactingState(3.0, 3.0, 0.0, 3), OperatorInputs(1.0, 0.0, 0.0), DT)
    assert out == (2.0, True)
