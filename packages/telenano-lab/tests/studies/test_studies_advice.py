"""Arms, tuning for a delay, and the advice that is made of them."""

import math
from typing import Any

import pytest
from answered_sweep import Answered
from telenano_lab.studies.loops.advice import CANDIDATES, Question, advise, in_words
from telenano_lab.studies.loops.cells import WRONG_RESTS, Cell, CellResult, run_cell, trajectory_of
from telenano_lab.studies.loops.theory import critical_delay_s, loop_model
from telenano_lab.studies.loops.tuning import tuned
from telenano_lab.studies.option_values import COMPARED_LAWS, Jitter

from telenano.analysis import Fact
from telenano.lockstep import Trajectory
from telenano.sections import ARMS, LAWS
from telenano.wire import ConfigError


def cell(hand: Any = "ordinary", **changes: Any) -> Cell:
    values: dict[str, Any] = {
        "law": "position_force",
        "environment": "spring",
        "round_trip_ms": 0.0,
        "stiffness_n_per_m": 20.0,
        "session_s": 3.0,
        "hand": hand,
    }
    return Cell(**{**values, **changes})


@pytest.mark.parametrize("hand", ARMS)
@pytest.mark.usefixtures("plain_loop")
def test_arm_presses_with_the_force_of_the_programme_if_hand_and_sample_are_one(hand: str) -> None:
    course = trajectory_of(cell(hand))
    assert 1e8 * course.tip_force_n[-1] == pytest.approx(1.0, rel=0.01, abs=0.0)
    assert course.hand_force_n[-1] == pytest.approx(1e8 * course.tip_force_n[-1], rel=1e-3, abs=0.0)


@pytest.mark.usefixtures("plain_loop")
def test_wall_only_pushes_and_is_met_on_the_way() -> None:
    course = trajectory_of(cell(environment="wall"))
    assert course.tip_force_n.min() == 0.0
    assert course.base_position_m[course.in_contact].min() > 3e-9
    assert 1e8 * course.tip_force_n[-1] == pytest.approx(1.0, rel=0.02, abs=0.0)


@pytest.mark.usefixtures("plain_loop")
def test_result_tells_force_peak_and_what_hand_and_tip_are_apart() -> None:
    result = run_cell(cell("force", law="passivity", round_trip_ms=20.0))
    assert result.verdict == "stable"
    assert result.tip_n == pytest.approx(1.0, rel=1e-3, abs=0.0)
    assert result.hand_n == pytest.approx(1.0, rel=1e-3, abs=0.0)
    # the spring K_c of the coupling is in series: F / K_c
    assert result.apart_m == pytest.approx(1.0 / 1500.0, rel=0.05, abs=0.0)
    assert CellResult.from_dict(result.as_dict()) == result


@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", COMPARED_LAWS)
@pytest.mark.parametrize("delay_s", [0.0, 0.2])
def test_tuned_loop_bears_twice_the_delay(law: str, delay_s: float) -> None:
    settings = dict(tuned(law, 38.0, delay_s))
    if delay_s == 0.0 or law not in ("virtual_impedance", "position_force"):
        assert settings == {}
        return
    config: Any = LAWS[law].config
    model = loop_model(law, config(damping_n_s_per_m=settings[f"{law}.damping_n_s_per_m"]), 38.0)
    assert model is not None
    assert critical_delay_s(model) == pytest.approx(2.0 * delay_s, rel=1e-3, abs=0.0)
    # where inertia does not matter B_v = 4 G T / pi
    assert model.damping_n_s_per_m == pytest.approx(4.0 * model.gain_n_per_m * delay_s / math.pi, rel=0.01, abs=0.0)


def laws(**held: tuple[str, float, float]) -> Answered:
    """Return a sweep in which the laws end with a verdict, a force at the tip and a greatest force; others diverge."""

    def answer(asked: Cell) -> dict[str, Any]:
        verdict, tip_n, peak_n = held.get(asked.law, ("diverged", 1.0, 9.0))
        reason = "it grows" if verdict != "stable" else ""
        return {"verdict": verdict, "reason": reason, "tip_n": tip_n, "peak_n": peak_n, "hand_n": 1.0}

    return Answered(answer)


@pytest.mark.usefixtures("plain_loop")
def test_a_hand_that_does_not_press_and_a_tip_that_does_not_touch_are_no_stable_hold(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Trajectory, "holds", lambda *course, **known: [])
    result = run_cell(cell("force", session_s=2.0))
    assert (result.verdict, result.outcome) == ("stable", "nothing_moved")
    assert result.reason == "the hand does not press, and the tip does not touch"


@pytest.mark.usefixtures("plain_loop")
@pytest.mark.parametrize("kind", WRONG_RESTS)
@pytest.mark.parametrize("verdict", ["stable", "diverged"])
def test_the_reason_of_a_run_is_that_of_its_outcome(verdict: Any, kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that rests wrongly is said to rest wrongly, and not to be at rest."""
    course = Trajectory.holds

    def found(self: Trajectory, *given: Any, **known: Any) -> list[Any]:
        facts = (Fact("parted", 2e-3, "of no outcome"), Fact(kind, 1.0, "of the rest"))
        return [
            one._replace(verdict=verdict, reason="of the verdict", facts=facts) for one in course(self, *given, **known)
        ]

    monkeypatch.setattr(Trajectory, "holds", found)
    result = run_cell(cell("force", session_s=2.0))
    assert (result.outcome, result.reason) == {
        "stable": (kind, "of the rest"),
        "diverged": ("diverged", "of the verdict"),
    }[verdict]


def test_advice_takes_the_law_that_costs_least_and_says_why_others_are_not_suited() -> None:
    question = Question(round_trip_ms=120.0, loss=0.03, stiffness_n_per_m=80.0)
    sweep = laws(wave=("stable", 0.6, 1.0), model_mediated=("stable", 0.97, 1.1))
    found = advise(question, sweep)
    assert [candidate.law for candidate in found[:3]] == ["model_mediated", "model_mediated", "wave"]
    assert [candidate.clamp for candidate in found[:2]] == [False, True]
    assert len(sweep.cells) == len(CANDIDATES) * 4 * 3
    words = in_words(question, found)
    assert words[0].startswith(
        "120 ms, 3 % loss, wall of 80 N/m, instrument real:"
        " take model_mediated with the clamp off; all of its 12 runs held"
    )
    assert words[1].startswith("Next come model_mediated with the clamp on, with 0.97 of the force in the worst hold")
    assert "smith with the clamp off (it grows)" in words[2]
    assert found[0].price() == pytest.approx(0.03 + 0.1, rel=1e-9, abs=0.0)


def test_a_law_is_suited_only_if_all_its_runs_are_stable() -> None:
    question = Question(round_trip_ms=300.0, jitter=Jitter(0.5, relative=True), stiffness_n_per_m=80.0)
    found = advise(question, laws())
    assert all(candidate.price() == math.inf for candidate in found)
    assert (
        in_words(question, found)[0]
        == "300 ms, jitter 50%, wall of 80 N/m, instrument real: no law held in all of its runs."
    )
    assert found[0].as_dict()["price"] is None


def test_without_chance_one_seed_is_enough() -> None:
    sweep = laws()
    advise(Question(round_trip_ms=50.0, stiffness_n_per_m=20.0, instrument="ideal"), sweep)
    assert len(sweep.cells) == len(CANDIDATES) * 4
    assert {one.disturbances for one in sweep.cells} == {()}


def test_advice_is_for_an_instrument_with_its_disturbances_and_a_seed_decides_them() -> None:
    sweep = laws()
    advise(Question(round_trip_ms=50.0, stiffness_n_per_m=20.0), sweep)
    assert len(sweep.cells) == len(CANDIDATES) * 4 * 3
    assert ("drift.enabled", True) in sweep.cells[0].disturbances
    with pytest.raises(ConfigError, match="unknown instrument 'reel'"):
        advise(Question(round_trip_ms=50.0, instrument="reel"), sweep)


def test_a_network_stands_in_the_place_of_delay_jitter_and_loss() -> None:
    sweep = laws(model_mediated=("stable", 0.97, 1.1))
    question = Question(network="Starlink_driving", stiffness_n_per_m=20.0)
    words = in_words(question, advise(question, sweep))
    assert words[0].startswith("starlink_driving, wall of 20 N/m, instrument real: take model_mediated")
    assert {(one.network, one.round_trip_ms) for one in sweep.cells} == {("starlink_driving", question.round_trip_ms)}
    assert len({one.seed for one in sweep.cells}) == 3
    assert 40.0 < question.round_trip_ms < 60.0
    with pytest.raises(ConfigError, match="--delay or --network is needed"):
        Question(stiffness_n_per_m=20.0)
    with pytest.raises(ConfigError, match="leave --delay, --jitter and --loss"):
        Question(network="lan", round_trip_ms=3.0)
    with pytest.raises(ConfigError, match="unknown profile 'mars'"):
        Question(network="mars")


@pytest.mark.usefixtures("plain_loop")
def test_a_cell_over_a_network_meets_what_its_link_does() -> None:
    shorter = run_cell(cell("force", network="lan", round_trip_ms=0.4, session_s=2.0))
    longer = run_cell(cell("force", network="transatlantic", round_trip_ms=78.0, session_s=2.0))
    assert shorter.verdict == "stable"
    assert longer.verdict not in ("stable", "no_data")
    assert cell("force", network="lan").has_random_link
