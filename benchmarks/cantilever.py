"""The dynamic cantilever in tapping contact: real-time factor, and time against `scipy.integrate.solve_ivp`.

    python benchmarks/cantilever.py

Both integrate Eq. 4 for Table 2 without a meniscus (whose memory no function of h has) from the same state, with the
same compiled force. Accuracy is that of amplitude and phase of the last periods, against 1536 steps a period. Of
solve_ivp the loosest tolerance is taken that is no less accurate. Times are processor times of this process.
"""

import argparse
import math
import time

import numpy as np
from scipy.integrate import solve_ivp

from services.afm_node.config import AfmConfig
from services.afm_node.physics.contact.force_grid import grid_force
from services.afm_node.physics.dynamic import NO_NOISE, advance, free_amplitude_m, steady_state
from services.numerics.compiled import always_compiled

PERIODS = 150
MEASURED = 20
GAP_M = 15e-9
AMPLITUDE_M = 20e-9
METHODS = ("DOP853", "RK45", "LSODA")


@always_compiled
def derivative(t, z, v, k, m, c, w, drive, rest, base, onset, start, cells, attraction, cubics):
    """Eq. 4 as zeta', zeta''; x_d = drive cos(w t)."""
    h = rest + z - base - drive * math.cos(w * t)
    force = grid_force(cubics, start, cells, attraction, h, 2 if h < onset else 0)
    return v, (force - k * z - c * v) / m - drive * w * w * math.cos(w * t)


def ours(config, steps):
    """Amplitude and phase, and seconds of processor time a period."""
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
    """Return the same of solve_ivp."""
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
    # absolute tolerances in the scale of zeta and zeta'
    scales = np.array([AMPLITUDE_M, AMPLITUDE_M * w])
    begun = time.process_time()
    found = solve_ivp(
        lambda t, y: derivative(t, y[0], y[1], *numbers), (0.0, times[-1]),
        [state.deflection_m, state.velocity_m_per_s],
        method=method, t_eval=times, rtol=tolerance, atol=tolerance * scales, max_step=period / 8.0,
    )  # fmt: skip
    spent = (time.process_time() - begun) / PERIODS
    return 2.0 * np.mean(found.y[0] * np.exp(1j * w * times)), spent


def main() -> None:
    """Print all figures."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    config = AfmConfig()
    dry = AfmConfig(meniscus=False)
    for name, chosen in (("with meniscus", config), ("without", dry)):
        reference = ours(chosen, 1536)[0]
        for steps in (64, 96, 192, 384):
            found, spent = ours(chosen, steps)
            amplitude = abs(found) / abs(reference) - 1.0
            phase = math.degrees(np.angle(found / reference))
            print(
                f"{name:14} {steps:5d} steps a period: {1.0 / 150e3 / spent:6.2f} x real time,"
                f" amplitude {amplitude:+.1e}, phase {phase:+.3f} degrees"
            )
    reference = ours(dry, 1536)[0]
    found, spent = ours(dry, 96)
    error = abs(found / reference - 1.0)
    derivative(0.0, 0.0, 0.0, *([1.0] * 11), np.zeros((4, 1, 4)))
    for method in METHODS:
        for tolerance in (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
            other, seconds = scipys(dry, method, tolerance)
            if abs(other / reference - 1.0) <= error:
                print(
                    f"solve_ivp {method}, tolerance {tolerance:g}: {seconds / spent:.0f} x the time at equal accuracy"
                )
                break
        else:
            print(f"solve_ivp {method}: not as accurate ({error:.1e}) at any tolerance down to 1e-8")


if __name__ == "__main__":
    main()
