"""Lockstep against the bus: the scenario that a cell becomes, and what counts as agreement."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops import validate as study
from telenano_lab.studies.loops.cells import Cell, trajectory_of
from telenano_lab.studies.loops.links import symmetric_link
from telenano_lab.studies.loops.sample import drawn_cells
from telenano_lab.studies.loops.validate import (
    Agreement,
    Bus,
    StudyError,
    bus_edges,
    compare,
    draws_of,
    scenario_of,
)

from telenano.lockstep import Trajectory
from telenano.sections import AfmConfig, ControllerConfig, HapticConfig
from telenano.settings import LinkSettings, Scenario, validate
from telenano.wire import ConfigError, RecordingError, RigError


def cell(**changes: Any) -> Cell:
    values: dict[str, Any] = {
        "law": "virtual_impedance",
        "environment": "tip_sample",
        "round_trip_ms": 40.0,
        "stiffness_n_per_m": 40.0,
        "session_s": 6.0,
    }
    return Cell(**{**values, **changes})


def test_scenario_says_what_the_cell_says() -> None:
    example = cell(jitter_ms=3.0, loss=0.1, seed=4, gain=10.0)
    scenario = validate(Scenario, scenario_of(example), "test")
    controller = validate(ControllerConfig, scenario.controller, "test", "controller")
    assert controller == example.controller()
    assert LinkSettings.of(scenario.delay_node).model_dump() == symmetric_link(0.04, 3e-3, 0.1, 4).model_dump()
    assert validate(AfmConfig, scenario.afm_node, "test").cantilever.stiffness_n_per_m == 40.0
    operator = validate(HapticConfig, scenario.haptic_node, "test").operator
    assert tuple((p.time_s, p.force_n) for p in operator.points) == example.hand_points()
    assert scenario.duration_s == 6.0
    in_bursts = validate(Scenario, scenario_of(cell(loss=0.1, seed=4, burst=30.0)), "test").delay_node
    assert LinkSettings.of(in_bursts).model_dump() == symmetric_link(0.04, 0.0, 0.1, 4, 30.0).model_dump()


def test_the_same_course_agrees() -> None:
    course = trajectory_of(cell())
    found = compare(cell(), [course], course)
    assert found.agree
    assert found.difference_share == 0.0
    assert found.lockstep == found.bus == "stable"


@pytest.mark.parametrize(("offset_share", "agrees"), [(0.049, True), (0.051, False)])
def test_courses_agree_up_to_the_tolerance(offset_share: float, agrees: bool) -> None:
    course = trajectory_of(cell())
    # 2 N is the hand's greatest force
    moved = dataclasses.replace(course, tip_force_n=course.tip_force_n + offset_share * 2.0 / 1e8)
    found = compare(cell(), [course], moved)
    assert found.difference_share == pytest.approx(offset_share, rel=1e-6, abs=0.0)
    assert found.agree is agrees


def test_other_verdict_is_no_agreement_and_another_way_of_failing_is_one() -> None:
    stable, cycling = trajectory_of(cell()), trajectory_of(cell(round_trip_ms=70.0))
    assert not compare(cell(), [stable], cycling).agree
    found = compare(cell(round_trip_ms=70.0), [cycling], cycling)
    assert found.agree
    assert found.difference_share is None


@pytest.mark.parametrize("law_fails", [False, True])
def test_a_hold_without_data_agrees_with_nothing(law_fails: bool) -> None:
    course = trajectory_of(cell(round_trip_ms=60.0 if law_fails else 40.0))
    found = compare(cell(), [course], course, lacking="afm/state: nothing from 3.000 s to 5.000 s of the session")
    assert (found.lockstep == "stable") is not law_fails
    assert found.bus == "no_data"
    assert found.reason.startswith("afm/state: nothing from 3.000 s")
    assert not found.agree


def test_bus_that_starts_within_a_tick_is_compared_in_time() -> None:
    course = trajectory_of(cell())
    late = dataclasses.replace(course, time_s=course.time_s + 4e-4)
    found = compare(cell(), [course], late)
    assert found.difference_share is not None
    assert 0.0 < found.difference_share < 0.02


def moved_by(course: Trajectory, share: float) -> Trajectory:
    """Return a course with a force at the tip that differs by a share of the hand's 2 N."""
    return dataclasses.replace(course, tip_force_n=course.tip_force_n + share * 2.0 / 1e8)


@pytest.mark.parametrize(("share", "agrees"), [(0.0, True), (0.115, True), (0.125, False)])
def test_over_a_random_link_the_bus_has_to_be_as_near_as_the_draws_are(share: float, agrees: bool) -> None:
    course = trajectory_of(cell())
    draws = [moved_by(course, offset) for offset in (0.0, 0.02, 0.06)]
    found = compare(cell(loss=0.1), draws, moved_by(course, share))
    assert found.tolerance_share == pytest.approx(0.06, rel=1e-6, abs=0.0)
    assert found.agree is agrees


def test_draws_that_differ_leave_the_verdict_undecided() -> None:
    stable, cycling = trajectory_of(cell()), trajectory_of(cell(round_trip_ms=70.0))
    for bus in (stable, cycling):
        found = compare(cell(loss=0.1), [stable, stable, cycling], bus)
        assert found.undecided
        assert found.agree
    far = compare(cell(loss=0.1), [stable, stable, cycling], moved_by(stable, 20.0))
    assert not far.agree


def test_the_bus_is_held_against_the_link_that_was_recorded() -> None:
    stable, cycling = trajectory_of(cell()), trajectory_of(cell(round_trip_ms=70.0))
    # what the draws say does not decide
    for draws in ([stable, stable], [stable, cycling], [cycling, cycling]):
        same = compare(cell(loss=0.1), draws, moved_by(stable, 0.07), moved_by(stable, 0.03))
        assert (same.agree, same.undecided, same.lockstep) == (True, False, "stable")
        assert same.difference_share == pytest.approx(0.04, rel=1e-6, abs=0.0)
        assert not compare(cell(loss=0.1), draws, moved_by(stable, 0.09), moved_by(stable, 0.03)).agree
        assert not compare(cell(loss=0.1), draws, stable, cycling).agree
        assert not compare(cell(loss=0.1), draws, cycling, stable).agree
        assert compare(cell(loss=0.1), draws, cycling, cycling).agree
    assert compare(cell(loss=0.1), [stable, cycling], stable, stable).draws == "1 stable, 1 limit cycle"
    assert compare(cell(), [stable], stable).draws == ""


def test_where_draws_differ_one_course_may_have_two_verdicts() -> None:
    stable, cycling = trajectory_of(cell()), trajectory_of(cell(round_trip_ms=70.0))

    def swinging(share: float) -> Trajectory:
        """Give the stable course with a swing of 5 Hz of so many shares of the hand's 2 N from peak to peak."""
        swing = 0.5 * share * np.sin(2.0 * np.pi * 5.0 * stable.time_s)
        return dataclasses.replace(stable, tip_force_n=stable.tip_force_n + swing * 2.0 / 1e8)

    quiet, loud = swinging(0.045), swinging(0.065)
    for recorded, bus, verdicts in (
        (quiet, loud, ("stable", "limit_cycle")),
        (loud, quiet, ("limit_cycle", "stable")),
    ):
        found = compare(cell(loss=0.1), [stable, cycling], bus, recorded)
        assert (found.lockstep, found.bus) == verdicts
        assert (found.agree, found.near_an_edge) == (True, True)
        assert found.difference_share == pytest.approx(0.01 / np.sqrt(2.0), rel=0.1, abs=0.0)
        # draws that are of one mind leave no such room, and neither does another course
        assert not compare(cell(loss=0.1), [stable, stable], bus, recorded).agree
        assert not compare(cell(loss=0.1), [cycling, cycling], bus, recorded).agree
    assert not compare(cell(loss=0.1), [stable, cycling], swinging(0.3), quiet).agree
    assert not compare(cell(loss=0.1), [stable, cycling], loud, loud).near_an_edge


def test_constant_link_has_one_draw_and_a_random_one_several(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study, "SEEDS", 3)
    assert len(draws_of(cell(session_s=5.0))) == 1
    draws = draws_of(cell(session_s=5.0, loss=0.2))
    assert len(draws) == study.SEEDS
    assert len({float(course.tip_force_n.sum()) for course in draws}) == study.SEEDS


def test_drawn_sample_is_that_of_its_seed_and_can_run_on_the_bus() -> None:
    cells = drawn_cells(20, 1)
    assert cells == drawn_cells(20, 1)
    assert cells != drawn_cells(20, 2)
    assert len(set(cells)) == 20
    assert len({c.law for c in cells}) >= 4
    # on every machine and in every version that has the same laws
    assert [(c.law, c.environment, c.round_trip_ms) for c in cells[5:8]] == [
        ("smith", "wall", 0.0), ("wave", "tip_sample", 60.0), ("passivity", "wall", 150.0),
    ]  # fmt: skip
    for drawn in cells[:5]:
        assert validate(Scenario, scenario_of(drawn), "test").duration_s == drawn.hold_s()[1]


def test_body_cannot_run_on_the_bus() -> None:
    with pytest.raises(ConfigError, match="cannot simulate a body"):
        scenario_of(cell(environment="body"))


def test_spring_needs_an_instrument_that_can_be_one(monkeypatch: pytest.MonkeyPatch) -> None:
    fields = {name: field for name, field in AfmConfig.model_fields.items() if name != "environment"}
    monkeypatch.setattr(study, "AfmConfig", type("AfmConfig", (), {"model_fields": fields}))
    with pytest.raises(ConfigError, match="cannot simulate a spring; give tip_sample"):
        scenario_of(cell(environment="spring"))


@pytest.mark.parametrize("leaves_a_part", [False, True])
def test_why_a_rig_did_not_start_is_said_whatever_an_earlier_study_or_the_rig_has_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, leaves_a_part: bool
) -> None:
    bus = Bus(tmp_path / "site.yaml", tmp_path)
    recording = bus.recording_of(cell())
    recording.parent.mkdir()
    recording.write_bytes(b"of an earlier study")
    done: list[list[str]] = []

    def run(command: list[str], longest_s: float) -> dict[str, Any]:
        done.append(command)
        assert not recording.exists()
        if leaves_a_part:
            recording.write_bytes(b"no recording that can be read")
        raise RigError("port 7400 is in use")

    monkeypatch.setattr(study, "run_session", run)
    monkeypatch.setattr(study, "draws_of", lambda one: [])
    with pytest.raises(StudyError, match="port 7400 is in use"):
        study.validate_cells([cell()], bus)
    (words,) = done
    assert words[words.index("--site-file") + 1] == str(bus.site_file)
    assert "virtual_impedance" in Path(words[words.index("--scenario") + 1]).read_text()


@pytest.mark.parametrize(("late_runs", "runs", "agrees"), [(0, 1, False), (1, 2, True), (5, 3, False)])
def test_a_cell_that_the_machine_held_up_is_run_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late_runs: int, runs: int, agrees: bool
) -> None:
    # A cell that disagrees without a stall is not run again; with stalls it is, until it agrees, at most three times.
    right, wrong = trajectory_of(cell()), trajectory_of(cell(round_trip_ms=60.0))
    bus = Bus(None, tmp_path)
    bus.recording_of(cell()).parent.mkdir()
    bus.recording_of(cell()).touch()
    done: list[int] = []

    def run(one: Cell, given: Bus) -> Trajectory:
        done.append(1)
        return right if 0 < late_runs < len(done) else wrong

    monkeypatch.setattr(study, "run_on_bus", run)
    monkeypatch.setattr(study, "lacking_of", lambda one, path: "")
    monkeypatch.setattr(study, "longest_stall_s", lambda path: 0.052 if len(done) <= late_runs else 0.0)
    said: list[str] = []
    (found,) = study.validate_cells([cell()], bus, said.append)
    assert (found.runs, found.agree, len(done)) == (runs, agrees, runs)
    assert found.stalled_s == (0.052 if runs == 3 else 0.0)
    assert sum("held up for 52 ms by the machine" in text for text in said) == runs - 1


def test_a_recording_that_lacks_what_crossed_the_link_agrees_with_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lacks(one: Cell, path: Path) -> Trajectory:
        raise RecordingError("session.mcap: lacks messages of teleop/forward that crossed the link")

    random = cell(loss=0.01)
    course = trajectory_of(random)
    monkeypatch.setattr(study, "run_on_bus", lambda one, bus: course)
    monkeypatch.setattr(study, "lacking_of", lambda one, path: "")
    monkeypatch.setattr(study, "over_recorded_link", lacks)
    (found,) = study.validate_cells([random], Bus(None, tmp_path))
    assert (found.bus, found.agree, found.recorded) == ("no_data", False, False)
    assert "lacks messages of teleop/forward" in found.reason


def test_lockstep_course_has_the_hands_grid() -> None:
    course = trajectory_of(cell())
    np.testing.assert_allclose(np.diff(course.time_s), 1e-3, rtol=1e-9, atol=0.0)
    assert course.time_s[0] == 0.0


def agreement(round_trip_ms: float, growth: float | None, stiffness: float = 38.0) -> Agreement:
    return Agreement(
        "virtual_impedance", "spring", stiffness, round_trip_ms, "stable", "stable", None, growth, None, 0.05, True
    )


def test_edge_on_the_bus_is_the_zero_of_the_growth_rate() -> None:
    line = [agreement(24.0, 2.0), agreement(15.0, None), agreement(20.0, -2.0), agreement(30.0, 5.0)]
    (edge,) = bus_edges(line, 1e-3)
    assert edge.bus_critical_delay_ms == pytest.approx(22.5, rel=1e-12, abs=0.0)
    assert (edge.law, edge.stiffness_n_per_m) == ("virtual_impedance", 38.0)


def test_no_edge_without_a_cell_on_each_side() -> None:
    assert bus_edges([agreement(20.0, -2.0), agreement(24.0, -1.0), agreement(30.0, None)], 1e-3) == []
    assert bus_edges([agreement(20.0, -2.0), agreement(24.0, 1.0, stiffness=20.0)], 1e-3) == []
