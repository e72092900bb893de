"""Tasks judge courses whose measures are known, and say what they need; those of packages have their form."""

import math
from typing import Any

import numpy as np
import pytest
from experiment_bench import task_named
from telenano_lab.experiments.apparatus.base import joined
from telenano_lab.experiments.extend import Plain, Series, TrialData, held_from
from telenano_lab.experiments.tasks import TASKS, checked
from telenano_lab.experiments.tasks.discriminate_stiffness import ANSWER, comparison_is_first
from telenano_lab.experiments.tasks.push_particle import PLACE_M, goal_of
from telenano_lab.experiments.tasks.track import lag_s, sum_of_sines
from telenano_lab.experiments.types import particle_table

from telenano.recording import ColumnTable
from telenano.sections import AfmConfig, ControllerConfig, HapticConfig
from telenano.settings import LoadedScenario, Scenario, find_scenario, merge, nested, read_yaml, validate

SEEDS = range(2)


def table(**columns: Series) -> ColumnTable:
    named = {name.replace("__", "."): column for name, column in columns.items()}
    return ColumnTable("made", named, dict.fromkeys(named, ""), dict.fromkeys(named, ""))


def data(time_s: Series, force_n: Series, base_m: Series | None = None, answers: Any = (), **hand: Series) -> TrialData:
    """Return a trial of which the force on the tip and the base are given, in the frame of the bus."""
    still = np.zeros_like(time_s)
    afm = {"tip_force_n__2": force_n, "base_position_m__2": still if base_m is None else -base_m}
    haptic = {"position_m__2": -hand.get("place_m", still), "operator_force_n__2": -hand.get("push_n", still)}
    status = table(time_s=time_s)
    return TrialData(table(time_s=time_s, **afm), table(time_s=time_s, **haptic), status, tuple(answers))


def clock(end_s: float, period_s: float = 1e-3) -> Series:
    return np.arange(round(end_s / period_s) + 1) * period_s


@pytest.mark.parametrize("name", TASKS)
def test_a_task_declares_just_what_it_judges_whatever_the_data(name: str) -> None:
    task, p = task_named(name, {})
    time_s = clock(task.duration_s(p), 0.01)
    for made in (data(time_s, np.zeros_like(time_s)), data(np.empty(0), np.empty(0))):
        judged = task.judge(made, p, 3)
        assert list(judged) == [measure.name for measure in task.measures]
        assert not [value for value in judged.values() if isinstance(value, np.generic)]
        assert not [value for value in judged.values() if isinstance(value, float) and not math.isfinite(value)]
    assert len({measure.name for measure in task.measures}) == len(task.measures)
    for measure in task.measures:
        unit = {"_n": "N", "_m": "m", "_s": "s", "_j": "J"}.get(measure.name[-2:], "")
        assert measure.unit == ("N s" if measure.name == "effort_n_s" else unit)


@pytest.mark.parametrize("name", TASKS)
def test_a_target_is_a_function_of_the_seed_and_ends_with_the_trial(name: str) -> None:
    task, p = task_named(name, {})
    for seed in SEEDS:
        course = task.target(p, seed)
        if course is None:
            continue
        again = task.target(p, seed)
        assert again is not None
        assert np.array_equal(course.values, again.values)
        assert course.times_s[-1] == pytest.approx(task.duration_s(p))
        assert course.unit == ("N" if course.quantity == "force" else "m")
    assert sum(interval.duration_s for interval in task.intervals(p, 1)) == pytest.approx(task.duration_s(p))


@pytest.mark.parametrize("name", TASKS)
def test_what_a_task_sets_is_a_scenario(name: str) -> None:
    task, p = task_named(name, {})
    touch = read_yaml(find_scenario("touch"))
    for interval in task.intervals(p, 1):
        document = merge(touch, nested({**task.settings(p, 1), **interval.settings}, "made"))
        loaded = LoadedScenario(validate(Scenario, document, "made"), "made", dict(document))
        for section, model in (
            ("afm_node", AfmConfig),
            ("controller", ControllerConfig),
            ("haptic_node", HapticConfig),
        ):
            loaded.section(section, model)


def test_a_force_that_settles_is_measured() -> None:
    # touches at 1 s, overshoots to 14 nN, is at 10.5 nN from 3 s on
    time_s = clock(12.0)
    force_n = np.where(time_s < 1.0, 0.0, np.where(time_s < 3.0, 14e-9, 10.5e-9))
    push_n = np.full_like(time_s, 2.0)
    made = data(time_s, force_n, base_m=time_s * 1e-9, place_m=time_s * 1e-3, push_n=push_n)
    task, p = task_named("touch_and_hold", {"force_n": 10e-9, "band": 0.1})
    found = task.judge(made, p, 0)
    assert found["contact_time_s"] == pytest.approx(1.0)
    assert found["completion_time_s"] == pytest.approx(3.0)
    assert found["settling_time_s"] == pytest.approx(2.0)
    assert found["peak_force_n"] == pytest.approx(14e-9, rel=1e-12, abs=0.0)
    assert found["overshoot_n"] == pytest.approx(4e-9, rel=1e-9, abs=0.0)
    assert found["mean_force_n"] == pytest.approx(10.5e-9, rel=1e-9, abs=0.0)
    assert found["force_error_n"] == pytest.approx(0.5e-9, rel=1e-9, abs=0.0)
    # 2 N over 12 mm, and 2 N for 12 s
    assert found["hand_energy_j"] == pytest.approx(24e-3)
    assert found["effort_n_s"] == pytest.approx(24.0)
    assert found["hand_path_m"] == pytest.approx(12e-3)
    assert found["success"] is True


def test_a_force_that_leaves_the_band_too_soon_is_no_success() -> None:
    time_s = clock(12.0)
    inside = (time_s % 1.0) < 0.9
    task, p = task_named("touch_and_hold", {"hold_s": 0.95})
    found = task.judge(data(time_s, np.where(inside, 10e-9, 5e-9)), p, 0)
    assert (found["success"], found["completion_time_s"], found["mean_force_n"]) == (False, None, None)
    assert held_from(time_s, inside, 0.85) == 0.0
    assert held_from(time_s, time_s >= 11.5, 0.5) == pytest.approx(11.5)
    assert held_from(time_s, time_s >= 11.5, 0.6) is None


@pytest.mark.parametrize(
    ("answered_s", "found"),
    [
        (2.4, {"detection_time_s": 0.4, "false_alarm": False, "success": True}),
        (4.5, {"detection_time_s": 2.5, "false_alarm": False, "success": False}),
        (1.0, {"detection_time_s": None, "false_alarm": True, "success": False}),
        (None, {"detection_time_s": None, "false_alarm": False, "success": False}),
    ],
)
def test_contact_is_detected_between_touch_and_answer(answered_s: float | None, found: dict[str, Any]) -> None:
    time_s = clock(10.0)
    answers = [] if answered_s is None else [{"name": "contact", "value": True, "time_s": answered_s}]
    task, p = task_named("detect_contact", {})
    judged = task.judge(data(time_s, np.where(time_s < 2.0, 0.0, -2e-9), answers=answers), p, 0)
    assert {key: judged[key] for key in found} == pytest.approx(found)
    assert judged["contact_time_s"] == pytest.approx(2.0)


def test_the_stiffer_of_two_intervals_is_the_right_answer() -> None:
    task, p = task_named("discriminate_stiffness", {"ratio": 1.5, "interval_s": 2.0})
    firsts = set()
    for seed in range(20):
        first, second = (each.settings["afm_node.spring.stiffness_n_per_m"] for each in task.intervals(p, seed))
        assert {first, second} == {20.0, 30.0}
        firsts.add(first)
        assert comparison_is_first(seed) is (first > second)
        time_s = clock(2.0, 0.01)
        parts = [data(time_s, np.full_like(time_s, stiff * 1e-9)) for stiff in (first, second)]
        both = joined(parts, [2.0, 2.0])
        assert both.afm["time_s"][-1] == pytest.approx(4.0)
        answer = {"name": ANSWER, "value": "first" if first > second else "second", "time_s": 4.5}
        right = task.judge(both._replace(answers=(answer,)), p, seed)
        assert right["correct"] is True
        assert right["first_peak_force_n"] == pytest.approx(first * 1e-9, abs=0.0)
        assert right["second_peak_force_n"] == pytest.approx(second * 1e-9, abs=0.0)
        assert task.judge(both, p, seed)["correct"] is None
    assert firsts == {20.0, 30.0}


@pytest.mark.parametrize("late_s", [0.0, 0.15, 0.62, 1.4])
@pytest.mark.parametrize("quantity", ["force", "position"])
def test_the_lag_behind_a_moving_target_is_found(late_s: float, quantity: str) -> None:
    task, p = task_named("track", {"quantity": quantity, "duration_s": 30.0})
    for seed in SEEDS:
        course = task.target(p, seed)
        assert course is not None
        assert np.ptp(course.values) <= 2.0 * p.amplitude  # type: ignore[attr-defined]
        time_s = clock(30.0, 0.005)
        followed = course.at(time_s - late_s)
        made = data(time_s, followed) if quantity == "force" else data(time_s, np.zeros_like(time_s), followed)
        found = task.judge(made, p, seed)
        assert found["lag_s"] == pytest.approx(late_s, abs=0.01)
        assert (found["rms_force_error_n"] is None) is (quantity == "position")
        if late_s == 0.0:
            assert found["relative_error"] == pytest.approx(0.0, abs=1e-3)
            assert found["on_target"] == 1.0


def test_a_course_that_does_not_move_has_no_lag() -> None:
    p = TASKS["track"].parameters()
    target = sum_of_sines(p, 1).values  # type: ignore[arg-type]
    assert lag_s(target, np.zeros_like(target), 0.05) is None


def test_a_particle_that_comes_to_rest_at_its_target_is_placed() -> None:
    task, p = task_named("push_particle", {})
    goal = goal_of(p, 7)  # type: ignore[arg-type]
    assert math.dist(goal, PLACE_M) == pytest.approx(500e-9)
    time_s = clock(40.0, 0.1)
    share = np.clip(time_s / 20.0, 0.0, 1.0)
    ways = [start + (end - start) * share for start, end in zip(PLACE_M, goal, strict=True)]
    made = data(time_s, np.zeros_like(time_s))
    found = task.judge(made._replace(particles=particle_table(time_s, *ways)), p, 7)
    assert found["success"] is True
    assert found["placing_error_m"] == pytest.approx(0.0, abs=1e-15)
    # within 100 nm of 500 nm after four fifths of the way
    assert found["completion_time_s"] == pytest.approx(16.0, abs=0.11)


def test_a_profile_is_followed_as_long_as_there_is_contact() -> None:
    task, p = task_named("follow_profile", {})
    time_s = clock(24.0, 0.01)
    base_m = 5e-9 * (np.sin(time_s) > 0.0)
    found = task.judge(data(time_s, np.where(time_s < 14.0, 12e-9, 0.0), base_m), p, 0)
    assert found["lost_contact"] == pytest.approx(0.5, abs=0.01)
    assert found["in_band"] == pytest.approx(0.5, abs=0.01)
    assert found["height_range_m"] == pytest.approx(5e-9, abs=0.0)
    assert found["success"] is False


def test_an_entry_of_a_package_has_to_be_a_task() -> None:
    good = TASKS["touch_and_hold"]
    assert checked("touch_and_hold", good) is good
    with pytest.raises(ValueError, match="is registered under another name than its own, touch_and_hold"):
        checked("mine", good)
    with pytest.raises(TypeError, match="judge"):
        checked("mine", Plain())
