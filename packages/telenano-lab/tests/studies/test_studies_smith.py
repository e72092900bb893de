"""Why the Smith predictor cycles on a wall, and swings behind the clamp: docs/laws.md says it."""

import dataclasses
from typing import Any

import pytest
from telenano_lab.studies.loops.cells import Cell, CellResult, judged, rig_of, run_cell, settle_ticks
from telenano_lab.studies.loops.links import symmetric_link

from telenano.lockstep import Schedule

# the model is there as soon as the tip touches
AT_ONCE = ("smith.stiffness_rate_n_per_m_s", 1e5)
GREATER = ("smith.environment_stiffness_max_n_per_m", 100.0)
CLAMPED = ("clamp.enabled", True)


def cell_of(environment: Any, stiffness: float, round_trip_ms: float, *settings: Any, hand: Any = "force") -> Cell:
    return Cell(
        law="smith",
        environment=environment,
        hand=hand,
        round_trip_ms=round_trip_ms,
        stiffness_n_per_m=stiffness,
        settings=settings,
    )


def with_ideal_device(cell: Cell) -> CellResult:
    """Run a cell with a device that has no friction, and a servo ten times as fast."""
    rig = rig_of(cell, cell.hand_points())
    plant = rig.haptic.plant
    motor = plant.motor._replace(
        friction_torque_n_m=0.0,
        servo_gain_v_per_m=10.0 * plant.motor.servo_gain_v_per_m,
        time_constant_s=0.1 * plant.motor.time_constant_s,
        voltage_limit_v=1e3,
        torque_limit_n_m=10.0,
    )
    rig = dataclasses.replace(rig, haptic=rig.haptic._replace(plant=plant._replace(motor=motor)))
    settle = settle_ticks(cell, rig.period_s)
    ticks = settle + round(cell.hold_s()[1] / rig.period_s)
    link = Schedule.of(symmetric_link(1e-3 * cell.round_trip_ms, 0.0, 0.0, 0), ticks, rig.period_s)
    return judged(cell, rig.run(link, settle))


@pytest.mark.check("long sessions until a slow cycle shows")
@pytest.mark.drawn(0.0, "packages/telenano-lab/telenano_lab/studies/", "telenano/laws/", "packages/telenano-laws/")
@pytest.mark.parametrize(("round_trip_ms", "peak_n"), [(50.0, 6.9), (120.0, 15.2)])
def test_smith_cycles_on_a_wall_because_its_model_comes_back_slowly(round_trip_ms: float, peak_n: float) -> None:
    wall = cell_of("wall", 80.0, round_trip_ms)
    found = run_cell(wall)
    assert found.verdict == "limit_cycle"
    # it leaves the wall in each cycle, so that the force goes from 0 to its peak
    assert found.peak_n == pytest.approx(peak_n, rel=0.02)
    assert found.peak_to_peak_n == pytest.approx(peak_n, rel=0.1)
    assert found.out_of_contact_share > 0.5
    assert run_cell(cell_of("wall", 60.0, round_trip_ms)).verdict == "limit_cycle"
    at_once = cell_of("wall", 80.0, round_trip_ms, AT_ONCE, GREATER)
    for at_rest in (at_once, cell_of("spring", 80.0, round_trip_ms), cell_of("wall", 38.0, round_trip_ms)):
        # it comes to rest, after the tip met the sample at the speed of free motion
        met = run_cell(at_rest)
        assert met.verdict == "stable"
        assert "struck" in met.facts
    # the greatest estimate is not what limits it, and the device has no part in it
    greater = cell_of("wall", 80.0, round_trip_ms, GREATER)
    assert run_cell(greater) == dataclasses.replace(found, cell=greater)
    ideal = with_ideal_device(wall)
    assert ideal.verdict == "limit_cycle"
    assert ideal.peak_n == pytest.approx(peak_n, rel=0.02)
    assert ideal.peak_to_peak_n == pytest.approx(found.peak_to_peak_n, rel=0.01)


def test_behind_the_clamp_the_predictor_adds_what_the_tip_has_not_done() -> None:
    arm = run_cell(cell_of("wall", 80.0, 50.0, CLAMPED, hand="ordinary"))
    force = run_cell(cell_of("wall", 80.0, 50.0, CLAMPED))
    at_once = run_cell(cell_of("wall", 80.0, 50.0, CLAMPED, AT_ONCE))
    for found in (arm, force, at_once):
        assert found.verdict in ("diverged", "limit_cycle")
        assert found.peak_to_peak_n == pytest.approx(0.4, abs=0.1)
