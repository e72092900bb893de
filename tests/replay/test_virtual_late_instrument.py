"""Slave halves and an instrument that answers periods late, as over a serial line, with signals in bursts or without.

The instrument's states reach the controller later by a constant; the link holds the hand's signals back for a pause and
then lets them out one after another, again and again.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.cells import Cell, energies_of, scales_of
from telenano_lab.studies.loops.validate import read_course, scenario_of
from test_virtual_lockstep import PERIOD_NS, PERIOD_S, SETTLE_TICKS, ConstantRig

from telenano.lockstep.trajectory import Trajectory
from telenano.virtual import Range, constant_timing
from telenano.wire import Message

# The share of its longer tests that is in `make check` where the change touches none of these folders.
pytestmark = pytest.mark.drawn(0.4, "telenano/laws/", "telenano/afm/", "services/controller/")

SEED = 7
Points = tuple[tuple[float, float], ...]


class LateRig(ConstantRig):
    """A rig whose instrument answers late [ns], and whose link holds back for a pause [periods]; 0 for neither."""

    late_ns = 0
    pause, apart_ns = 0, 0

    def draw(self, low_high: Range, *names: str) -> int:
        """Return the delay of a message [ns]; in a burst the signals are apart_ns apart."""
        usual_ns = super().draw(low_high, *names)
        if not self.pause or (names[0], names[-1]) != ("link", "teleop/forward"):
            return usual_ns
        now_ns = self.clock.monotonic_ns()
        held_ns = self.pause * PERIOD_NS - now_ns % (self.pause * PERIOD_NS)
        return usual_ns + held_ns + now_ns // PERIOD_NS % self.pause * self.apart_ns

    def _deliver(
        self, sender: str, key: str, topic: str, payload: bytes, sent_ns: int, message: Message | None
    ) -> None:
        late_ns = self.late_ns if (topic, key) == ("afm/state", "controller@slave") else 0
        super()._deliver(sender, key, topic, payload, sent_ns + late_ns, message)


def course_of(folder: Path, cell: Cell, points: Points, end_s: float, **rig_is: int) -> Trajectory:
    """Run the nodes of a cell with a programme of the hand (time [s], force [N]), and read the recording."""
    scenario = scenario_of(cell)
    scenario["haptic_node"]["operator"]["points"] = [{"time_s": time, "force_n": force} for time, force in points]
    rig = LateRig(folder, SEED, (), constant_timing(round(0.5e6 * cell.round_trip_ms)), scenario)
    for name, value in rig_is.items():
        setattr(rig, name, value)
    begin_s = (SETTLE_TICKS + 2) * PERIOD_S
    rig.run_until(begin_s)
    rig.command("start", "haptic_node")
    rig.run_until(begin_s + end_s)
    return read_course(rig.finish())


def cell_of(law: str, stiffness: float, round_trip_ms: float = 20.0) -> Cell:
    return Cell(law=law, environment="spring", round_trip_ms=round_trip_ms, stiffness_n_per_m=stiffness, seed=SEED)


@pytest.mark.check("takes 1.6 s")
@pytest.mark.parametrize("law", ["wave", "passivity"])
@pytest.mark.parametrize("late_ms", [2, 4])
def test_a_late_instrument_does_not_slow_a_fast_hand(tmp_path: Path, law: str, late_ms: int) -> None:
    """A hand of 4 N on 0.5 N/m moves the tip by 50 pm a period; at 60 pm of lead it came 8 nm far and not 18."""
    cell, points = cell_of(law, 0.5, 4.0), ((0.02, 0.0), (0.05, 4.0))
    ways = []
    for late_ns in (0, late_ms * PERIOD_NS):
        course = course_of(tmp_path / str(late_ns), cell, points, 0.4, late_ns=late_ns)
        ways.append(float(course.base_position_m[-1]))
    assert ways[0] > 1e-8
    assert ways[1] == pytest.approx(ways[0], rel=0.03, abs=0.0)


@pytest.mark.check("takes 2.3 s")
@pytest.mark.drawn(0.5)
@pytest.mark.parametrize(
    ("law", "least_j", "most_n"), [("wave", -1e-6, 1.2), ("passivity", -1e-6, 1.02), ("model_mediated", -1e-4, 1.2)]
)
@pytest.mark.parametrize(("late_ms", "pause", "apart_us"), [(2, 60, 100), (4, 40, 20)])
def test_bursts_into_a_half_whose_instrument_is_late_make_no_energy(
    tmp_path: Path, law: str, least_j: float, most_n: float, late_ms: int, pause: int, apart_us: int
) -> None:
    """Each signal of a burst was a step against the same force: the wave's force swung by 0.58 N, here at 80 N/m."""
    cell = cell_of(law, 80.0)
    rig_is = {"late_ns": late_ms * PERIOD_NS, "pause": pause, "apart_ns": 1000 * apart_us}
    course = course_of(tmp_path, cell, ((0.02, 0.0), (0.2, 1.0)), 1.5, **rig_is)
    scales = scales_of(cell.controller())
    force: Any = scales.force_scale * course.tip_force_n
    assert energies_of(course, scales).stored_j.min() > least_j
    assert force.max() < most_n
    assert np.ptp(force[1100:]) < 0.06
    assert force[1100:].mean() == pytest.approx(1.0, abs=0.08)


def stated_j(law: str, late: int, tip_j: Any) -> float:
    """Return the most [J] that docs/passivity.md says a law makes: what was granted, and steps not accounted for.

    Those are one step and as many more as the instrument is periods late: the work that the tip did in any so many.
    """
    params = cell_of(law, 1.0).controller().params()
    granted_j = (2.0 if law == "passivity" else 1.0) * params.start_j
    return float(granted_j + (tip_j[late + 1 :] - tip_j[: -late - 1]).max())


@pytest.mark.check("takes 1.5 s")
@pytest.mark.parametrize("law", ["passivity", "model_mediated"])
def test_beyond_the_limit_of_a_late_instrument_energy_comes_out_and_below_it_none(tmp_path: Path, law: str) -> None:
    late, points = 4, ((0.02, 0.0), (0.2, 1.0))
    limit = cell_of(law, 1.0).controller().stiffness_limit_n_per_m(late)
    assert limit is not None
    lowest, stated = [], []
    for stiffness in (0.9 * limit, 200.0):
        cell = cell_of(law, stiffness)
        course = course_of(tmp_path / f"{stiffness:g}", cell, points, 1.5, late_ns=late * PERIOD_NS)
        energies = energies_of(course, scales_of(cell.controller()))
        lowest.append(float(energies.stored_j.min()))
        stated.append(stated_j(law, late, energies.tip_j))
        # the warning is about what happens, and only that
        assert (cell.controller().stiffness_doubts(stiffness, late * PERIOD_S) == "") is (stiffness < limit)
    assert lowest[0] > -1e-5
    assert -stated[1] < lowest[1] < -1e-5
