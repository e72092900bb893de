"""Simulated participants have the psychometric function and the effects that they state."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from experiment_bench import task_named
from telenano_lab.experiments.asked import NASA_TLX
from telenano_lab.experiments.extend import TrialData
from telenano_lab.experiments.operators import SLOPE_OF_WAVE, SimulatedParticipant, round_trip_s
from telenano_lab.experiments.plan import load_plan
from telenano_lab.experiments.tasks import TASKS
from telenano_lab.experiments.types import Trial

from telenano.sections import HapticConfig
from telenano.settings import nested, validate
from telenano.wire import ConfigError

SPRING = {
    "afm_node.environment": "spring",
    "afm_node.spring.stiffness_n_per_m": 20.0,
    "afm_node.spring.bilateral": False,
    "afm_node.spring.rest_position_m": 1e-8,
}


def trial(task: str, seed: int = 0, **settings: Any) -> Trial:
    return Trial("P01", 1, 1, seed, "main", task, {}, {}, settings, seed)


@pytest.mark.parametrize("name", TASKS)
def test_a_hand_is_an_operator_of_the_rig_and_short_enough_for_a_command(name: str) -> None:
    import json

    task, p = task_named(name, {})
    given = SimulatedParticipant({}, 1).settings(task, p, trial(name, 5))
    section = nested(given, "made")["haptic_node"]
    validate(HapticConfig, section, "made", "haptic_node").operator.to_params()
    assert len(json.dumps(section["operator"])) < 4096
    assert given == SimulatedParticipant({}, 1).settings(task, p, trial(name, 5))


@pytest.mark.parametrize("ratio", [1.05, 1.3])
def test_the_choices_of_an_observer_have_its_psychometric_function(ratio: float) -> None:
    who = SimulatedParticipant({"weber": 0.2, "lapse": 0.1}, 3)
    task, p = task_named("discriminate_stiffness", {"ratio": ratio})
    expected = 0.05 + 0.9 * 0.5 * math.erfc(-math.log(ratio) / 0.2 / math.sqrt(2.0))
    assert who.probability(ratio) == pytest.approx(expected, rel=1e-9)
    none: Any = TrialData(*([None] * 3))  # type: ignore[arg-type]
    right, number = 0, 1500
    for seed in range(number):
        (answer,) = who.answer(task, p, trial(task.name, seed), none)
        first, second = (each.settings["afm_node.spring.stiffness_n_per_m"] for each in task.intervals(p, seed))
        right += (answer["value"] == "first") == (first > second)
    # four standard errors
    assert right / number == pytest.approx(expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / number))


def test_the_answer_that_it_has_learnt_to_wait_for_is_that_of_the_link() -> None:
    task, p = task_named("touch_and_hold", {})
    ways = {"delay_node.forward.delay_s": 0.05, "delay_node.backward.delay_s": 0.07}
    assert round_trip_s(ways) == pytest.approx(0.12)
    given = SimulatedParticipant({}, 1).settings(task, p, trial(task.name, **ways))
    assert given["haptic_node.operator.answer_s"] == pytest.approx(0.12)
    assert SimulatedParticipant({}, 1).settings(task, p, trial(task.name))["haptic_node.operator.answer_s"] == 0.0
    with pytest.raises(ConfigError, match=r"participant: weber"):
        SimulatedParticipant({"weber": -1.0}, 1)


def test_ratings_are_on_the_scale() -> None:
    import random

    who, draw = SimulatedParticipant({"rating": 70.0}, 1), random.Random(1)
    values = {question.name: who.rate(0.0, 100.0, 5.0, draw) for question in NASA_TLX}
    assert all(0.0 <= value <= 100.0 and value % 5.0 == 0.0 for value in values.values())
    assert sum(values.values()) / len(values) == pytest.approx(70.0, abs=15.0)


def simulated(task_name: str, parameters: dict[str, Any], law: str, delay_ms: float, **settings: Any) -> dict[str, Any]:
    """Run a trial in lockstep with a participant without scatter, and judge it."""
    from telenano import simulate

    task, p = task_named(task_name, parameters)
    who = SimulatedParticipant({"noise": 0.0}, 1)
    ways = {f"delay_node.{way}.delay_s": 1e-3 * delay_ms for way in ("forward", "backward")}
    planned = trial(task_name, 2, **ways)
    operator = nested(who.settings(task, p, planned), "made")["haptic_node"]["operator"]
    found = simulate("touch", law=law, operator=operator, duration_s=task.duration_s(p), settings={**ways, **settings})
    data = TrialData(found.table("afm/state"), found.table("haptic/state"), found.table("haptic/state"))
    data = data._replace(answers=who.answer(task, p, planned, data))
    return task.judge(data, p, planned.seed)


@pytest.mark.endurance
def test_completion_time_grows_with_the_round_trip_by_the_stated_slope() -> None:
    delays_ms = [0.0, 25.0, 50.0, 100.0, 150.0]
    judged = [simulated("touch_and_hold", {}, "wave", each, **SPRING) for each in delays_ms]
    times_s = np.array([each["completion_time_s"] for each in judged])
    trips_s = 2e-3 * np.array(delays_ms)
    slope = np.polyfit(trips_s, times_s, 1)
    assert slope[0] == pytest.approx(SLOPE_OF_WAVE, rel=0.03)
    assert np.abs(times_s - np.polyval(slope, trips_s)).max() < 0.02
    assert all(each["success"] for each in judged)


@pytest.mark.endurance
def test_contact_is_felt_later_by_the_delay_back_and_a_target_is_followed_later_by_that_there() -> None:
    for name, parameters, measure in (
        ("detect_contact", {}, "detection_time_s"),
        ("track", {"centre": 10e-9, "amplitude": 4e-9}, "lag_s"),
    ):
        found = [simulated(name, parameters, "wave", each, **SPRING)[measure] for each in (0.0, 50.0, 100.0)]
        grows = np.diff(found) / 0.05
        assert (grows > 0.8).all()


@pytest.mark.endurance
def test_a_hand_that_keeps_its_force_follows_the_heights_of_a_grating() -> None:
    instrument = {"afm_node.cantilever.stiffness_n_per_m": 1.0, "afm_node.meniscus": False}
    task, p = task_named("follow_profile", {})
    found = simulated("follow_profile", {}, "virtual_impedance", 0.0, **instrument, **nested_flat(task.settings(p, 2)))
    assert found["height_range_m"] == pytest.approx(p.height_m, rel=0.1, abs=0.0)  # type: ignore[attr-defined]
    # the stylus lags its path by b v / k, 8.4 nm of 800
    assert found["way_m"] == pytest.approx(p.way_m, rel=0.012, abs=0.0)  # type: ignore[attr-defined]
    assert found["success"] is True


PUSH = {
    "name": "push",
    "scenario": "fig12",
    "apparatus": "lockstep",
    "seed": 4,
    "participants": 1,
    "tasks": [{"name": "push_particle", "parameters": {"limit_s": 30.0}}],
    "factors": {"round_trip_ms": [0, 200]},
    "repetitions": 4,
}


@pytest.mark.endurance
@pytest.mark.timeout(3000)
def test_a_hand_that_steers_pushes_the_particle_into_the_circle_and_takes_longer_over_a_delay(tmp_path: Path) -> None:
    from telenano_lab.experiments.apparatus.lockstep import Lockstep
    from telenano_lab.experiments.desk import Desk

    path = tmp_path / "push.yaml"
    path.write_text(yaml.safe_dump(PUSH))
    plan = load_plan(path)
    apparatus = Lockstep(plan, Desk(plan))
    times_s: dict[Any, list[float]] = {0: [], 200: []}
    for planned in plan.trials("P01"):
        measures = apparatus.run(planned, 0).measures
        assert measures["success"], measures
        assert 10e-9 < measures["peak_lateral_force_n"] < 200e-9  # type: ignore[operator]
        times_s[planned.condition["round_trip_ms"]].append(measures["completion_time_s"])  # type: ignore[arg-type]
    assert np.median(times_s[200]) > np.median(times_s[0]) + 0.2


def nested_flat(settings: Any) -> dict[str, Any]:
    """Return settings whose sections are maps as dotted keys."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        flat |= {f"{key}.{name}": each for name, each in value.items()} if isinstance(value, dict) else {key: value}
    return flat
