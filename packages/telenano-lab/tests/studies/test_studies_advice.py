"""Arms, tuning for a delay, and the trials of a law on a line."""

import math
from typing import Any

import pytest
from answered_sweep import Answered
from telenano_lab.studies.loops.advice import TRIED_LAWS, Question, cells_of, try_all
from telenano_lab.studies.loops.cells import WRONG_RESTS, Cell, CellResult, run_cell, trajectory_of
from telenano_lab.studies.loops.theory import critical_delay_s, loop_model
from telenano_lab.studies.loops.tuning import tuned
from telenano_lab.studies.option_values import COMPARED_LAWS

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


@pytest.mark.parametrize(
    ("more", "seeds", "disturbed"),
    [({"instrument": "ideal"}, 1, False), ({}, 3, True), ({"loss": 0.1, "instrument": "ideal"}, 3, False)],
)
def test_one_seed_is_enough_without_chance_and_the_instrument_is_disturbed(
    more: dict[str, Any], seeds: int, disturbed: bool
) -> None:
    cells = cells_of(Question(round_trip_ms=50.0, stiffness_n_per_m=20.0, **more), "wave", None)
    assert len(cells) == 4 * seeds
    assert all((("drift.enabled", True) in one.disturbances) is disturbed for one in cells)
    assert {one.settings for one in cells} == {()}


def test_what_is_tried_is_each_law_as_it_comes_and_each_form_that_is_another_one() -> None:
    """A law whose clamp is on by itself is not tried a second time with the clamp on."""
    asked = Answered(lambda cell: {"verdict": "stable"})
    tried = try_all(Question(round_trip_ms=120.0, stiffness_n_per_m=80.0, instrument="ideal"), asked)
    assert [one.law for one in tried if one.clamp is None] == list(TRIED_LAWS)
    for one in tried:
        own = one.results[0].cell.model_copy(update={"settings": ()}).controller()
        changed = one.results[0].cell.controller()
        assert ((own.params(), own.clamp_params()) == (changed.params(), changed.clamp_params())) == (one.clamp is None)
    # the two laws that are damped for the delay are other ones with the clamp as it was
    assert [one.clamp for one in tried if one.law == "position_force"] == [None, False, True]
    with pytest.raises(ConfigError, match="unknown instrument 'reel'"):
        try_all(Question(round_trip_ms=50.0, instrument="reel"), asked)


def test_a_network_stands_in_the_place_of_delay_jitter_and_loss() -> None:
    question = Question(network="Starlink_driving", stiffness_n_per_m=20.0)
    cells = cells_of(question, "model_mediated", None)
    assert {(one.network, one.round_trip_ms) for one in cells} == {("starlink_driving", question.round_trip_ms)}
    assert len({one.seed for one in cells}) == 3
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
