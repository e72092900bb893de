"""The dynamic cantilever in tapping contact: real-time factor, and time against `scipy.integrate.solve_ivp`.

    python benchmarks/cantilever.py

Both integrate Eq. 4 for Table 2 from the same state with the same compiled force, without the meniscus, because its
memory is no function of h. The accuracy is that of amplitude and phase over the last periods, relative to 1536 steps a
period. For solve_ivp the benchmark takes the loosest tolerance that is at least as accurate. Times are processor times
of this process.
"""

import argparse
import json
import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from telenano.afm.contact.force_grid import grid_force
from telenano.afm.dynamic import NO_NOISE, advance, free_amplitude_m, steady_state
from telenano.numerics.compiler import always_compiled
from telenano.sections.afm_section import AfmConfig

PERIODS = 150
MEASURED = 20
GAP_M = 15e-9
AMPLITUDE_M = 20e-9
METHODS = ("DOP853", "RK45", "LSODA")


@always_compiled
def derivative(t, z, v, k, m, c, w, drive, rest, base, onset, start, cells, attraction, cubics):
    """Return zeta' and zeta'' by Eq. 4; x_d = drive cos(w t)."""
    h = rest + z - base - drive * math.cos(w * t)
    force = grid_force(cubics, start, cells, attraction, h, 2 if h < onset else 0)
    return v, (force - k * z - c * v) / m - drive * w * w * math.cos(w * t)


def ours(config, steps):
    """Return amplitude and phase as a complex number [m], and the processor time for a period [s]."""
    plant = config.to_dynamic(steps_per_period=steps)
    drive = AMPLITUDE_M / free_amplitude_m(plant, 1.0)
    base = config.rest_distance_m - GAP_M
    state = steady_state(plant, base, drive)
    advance(plant, state, base, 0.0, drive, steps, NO_NOISE)
    begun = time.process_time()
    state, _ = advance(plant, state, base, 0.0, drive, (PERIODS - MEASURED) * steps, NO_NOISE)
    _, reading = advance(plant, state, base, 0.0, drive, MEASURED * steps, NO_NOISE)
    return complex(reading.in_phase_m, reading.quadrature_m), (time.process_time() - begun) / PERIODS


def scipys(config, method, tolerance):
    """Return the same two values of solve_ivp."""
    plant = config.to_dynamic()
    drive = AMPLITUDE_M / free_amplitude_m(plant, 1.0)
    base = config.rest_distance_m - GAP_M
    state = steady_state(plant, base, drive)
    w, grid = 2.0 * math.pi * plant.drive_hz, plant.grid
    numbers = (
        plant.stiffness_n_per_m, plant.mass_kg, plant.damping_kg_per_s, w, drive, plant.rest_distance_m, base,
        plant.passages.onset_m, grid.start_m, grid.cells_per_m, grid.attraction_n_m2, grid.cubics,
    )  # fmt: skip
    period = 1.0 / plant.drive_hz
    times = np.linspace((PERIODS - MEASURED) * period, PERIODS * period, MEASURED * 96 + 1)[1:]
    # The absolute tolerances are in the scale of zeta and zeta'.
    scales = np.array([AMPLITUDE_M, AMPLITUDE_M * w])
    begun = time.process_time()
    found = solve_ivp(
        lambda t, y: derivative(t, y[0], y[1], *numbers), (0.0, times[-1]),
        [state.deflection_m, state.velocity_m_per_s],
        method=method, t_eval=times, rtol=tolerance, atol=tolerance * scales, max_step=period / 8.0,
    )  # fmt: skip
    spent = (time.process_time() - begun) / PERIODS
    return 2.0 * np.mean(found.y[0] * np.exp(1j * w * times)), spent


def convergence(config: AfmConfig, steps_a_period: Sequence[int], finest: int) -> list[dict[str, float]]:
    """Return the real-time factor and the errors of amplitude and phase against the finest, by steps a period."""
    reference, rows = ours(config, finest)[0], []
    for steps in steps_a_period:
        found, spent = ours(config, steps)
        row = {"steps": steps, "x_real_time": 1.0 / 150e3 / spent, "amplitude": abs(found) / abs(reference) - 1.0}
        rows.append(row | {"phase_degrees": math.degrees(np.angle(found / reference))})
    return rows


def against_scipy(config: AfmConfig) -> dict[str, float | None]:
    """Return by method the time of `solve_ivp` as a ratio to ours at equal accuracy; None if it is never reached."""
    reference = ours(config, 1536)[0]
    found, spent = ours(config, 96)
    error = abs(found / reference - 1.0)
    derivative(0.0, 0.0, 0.0, *([1.0] * 11), np.zeros((4, 1, 4)))
    ratios: dict[str, float | None] = {}
    for method in METHODS:
        runs = (scipys(config, method, 10.0**-digits) for digits in range(3, 9))
        as_good = (seconds / spent for other, seconds in runs if abs(other / reference - 1.0) <= error)
        ratios[method] = next(as_good, None)
    return ratios


def main() -> None:
    """Print all results."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    dry = AfmConfig(meniscus=False)
    steps, finest = ((64, 96), 192) if given.smoke else ((64, 96, 192, 384), 1536)
    kinds = {"without": dry} if given.smoke else {"with meniscus": AfmConfig(), "without": dry}
    found: dict[str, Any] = {name: convergence(config, steps, finest) for name, config in kinds.items()}
    ratios = {} if given.smoke else against_scipy(dry)
    if given.json:
        print(json.dumps({"convergence": found, "solve_ivp": ratios}))
        return
    for name, rows in found.items():
        for row in rows:
            print(
                f"{name:14} {row['steps']:5d} steps a period: {row['x_real_time']:6.2f} x real time,"
                f" amplitude {row['amplitude']:+.1e}, phase {row['phase_degrees']:+.3f} degrees"
            )
    for method, ratio in ratios.items():
        what = "not as accurate at any tolerance" if ratio is None else f"{ratio:.0f} x the time at equal accuracy"
        print(f"solve_ivp {method}: {what}")


if __name__ == "__main__":
    main()
