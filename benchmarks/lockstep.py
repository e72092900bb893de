"""How many seconds the lockstep loop simulates in a second on one core, and what takes the time.

    python benchmarks/lockstep.py [--laws all] [--round-trip-ms 20] [--session-s 20] [--repeats 5] [--json]

The parts are the compiled steps of the haptic site and of the instrument, run alone over the course of the whole loop;
the rest is the law, the link and the bookkeeping. The best of several repeats counts, because another process on the
core can only make it slower.
"""

import argparse
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.cells import DEFAULT_STIFFNESS, ENVIRONMENTS, Cell, rig_of
from telenano_lab.studies.loops.links import symmetric_link

from telenano.afm.step import AfmInputs
from telenano.afm.step import step as instrument_step
from telenano.hand.step import HapticInputs
from telenano.hand.step import step as haptic_step
from telenano.lockstep.link import Schedule
from telenano.lockstep.lockstep import Rig
from telenano.lockstep.trajectory import Trajectory
from telenano.numerics.compiler import always_compiled

AIM = 2000.0
_SETTLE_TICKS = 300


@always_compiled
def haptic_alone(params: Any, state: Any, references_m: np.ndarray, times_s: np.ndarray, dt: float) -> float:
    """Run the haptic site alone with the references of a course."""
    total = 0.0
    for n in range(len(times_s)):
        asked = HapticInputs(1, references_m[n], 0.0, 0.0, times_s[n], False, False)
        state, outputs = haptic_step(params, state, asked, dt)
        total += outputs.reading.position_m
    return total


@always_compiled
def instrument_alone(params: Any, state: Any, bases_m: np.ndarray, dt: float) -> float:
    """Run the instrument alone over the base positions of a course."""
    total, arm = 0.0, True
    for base_m in bases_m:
        state, outputs = instrument_step(params, state, AfmInputs(base_m, 0.0, 0, arm, False, 0.0, 0.0, False), dt)
        arm = False
        total += outputs.sample.force_n
    return total


def best_s(run: Callable[[], object], repeats: int) -> float:
    """Return the shortest processor time [s] of several runs, after one that does not count."""
    run()
    times = []
    for _ in range(repeats):
        begin = time.thread_time()
        run()
        times.append(time.thread_time() - begin)
    return min(times)


def measure(cell: Cell, session_s: float, repeats: int) -> dict[str, Any]:
    """Return the real-time factor of the whole loop, and the time a tick of it and of its parts [ns]."""
    rig = rig_of(cell, cell.hand_points())
    ticks = _SETTLE_TICKS + round(session_s / rig.period_s)
    link = symmetric_link(cell.round_trip_ms * 1e-3, 0.0, 0.0, 0)

    def whole() -> Trajectory:
        return rig.run(Schedule.of(link, ticks, rig.period_s), _SETTLE_TICKS)

    course = whole()
    simulated_s = ticks * rig.period_s
    whole_s = best_s(whole, repeats)
    haptic_s, instrument_s = parts_s(rig, course, repeats)
    share = ticks / len(course.time_s)
    return {
        "law": cell.law,
        "environment": cell.environment,
        "ratio": simulated_s / whole_s,
        "ns_per_tick": 1e9 * whole_s / ticks,
        "haptic_ns": 1e9 * haptic_s * share / ticks,
        "instrument_ns": 1e9 * instrument_s * share / ticks,
    }


def parts_s(rig: Rig, course: Trajectory, repeats: int) -> tuple[float, float]:
    """Return the processor times [s] of the haptic site and of the instrument for a course."""
    times_s, references_m, bases_m = course.time_s, course.reference_m, course.base_position_m
    return (
        best_s(lambda: haptic_alone(rig.haptic, rig.haptic_start, references_m, times_s, rig.period_s), repeats),
        best_s(lambda: instrument_alone(rig.instrument, rig.instrument_start, bases_m, rig.period_s), repeats),
    )


def main() -> None:
    """Measure every law in both environments."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--laws", default="all")
    parser.add_argument("--round-trip-ms", type=float, default=20.0)
    parser.add_argument("--session-s", type=float, default=20.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    if given.smoke:
        given.laws, given.session_s, given.repeats = "virtual_impedance", 0.2, 1
    rows = [
        measure(
            Cell(
                law=law,
                environment=environment,
                round_trip_ms=given.round_trip_ms,
                stiffness_n_per_m=DEFAULT_STIFFNESS[environment][0],
            ),
            given.session_s,
            given.repeats,
        )
        for environment in ENVIRONMENTS
        for law in option_values.laws(given.laws)
    ]
    if given.json:
        print(json.dumps({"aim": AIM, "rows": rows}))
        return
    print(f"{'environment':12} {'law':18} {'x real time':>12} {'ns/tick':>9} {'haptic':>8} {'instrument':>11}")
    for row in rows:
        print(
            f"{row['environment']:12} {row['law']:18} {row['ratio']:12.0f} {row['ns_per_tick']:9.0f}"
            f" {row['haptic_ns']:8.0f} {row['instrument_ns']:11.0f}"
        )


if __name__ == "__main__":
    main()
