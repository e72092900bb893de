"""Transparency: how much of the environment reaches the hand, law by law, over the delay.

The hand presses on a spring with a constant force and a small sine on top, once on the spring of the study, once on
nothing. After the transient the fundamental of each signal is taken over whole periods, so that with X, F complex:

- tracking error: RMS of x_s / alpha_p - x_m without their means, over the RMS of x_m, [%]
- rendered stiffness: Re(F_m / X_m), what the hand feels of a spring [N/m], against the true alpha_f alpha_p K
- perceived delay: the time by which the force that the law renders lags behind the hand's motion,
  arg(X_m / F_r) / omega
- contrast: |F_m / V_m| on the spring over that on nothing, in dB. It is no Z-width: that is the range of impedances
  that a device can render passively (Colgate and Brown 1994), and a hand that is stuck has the greatest contrast

What is unstable has no such numbers: they are None.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from studies.cells import Cell, course_of, run_cell, scales_of
from studies.lockstep import Trajectory

FREQUENCY_HZ = 0.5
_MEAN_N, _AMPLITUDE_N = 1.0, 0.3
_RAMP_S = 0.5
# corners of the sine: straight lines between 200 points a period differ from it by 1e-4 of its amplitude
_POINTS_PER_PERIOD = 200
_SETTLE_PERIODS, _MEASURED_PERIODS = 3, 3
# a spring that nobody feels: its force over the motion of a run stays below a piconewton
_NOTHING_N_PER_M = 1e-6


@dataclass(frozen=True)
class Transparency:
    """The numbers of one law at one delay; see the module's text. `verdict` is that of the hold on the spring."""

    law: str
    round_trip_ms: float
    stiffness_n_per_m: float
    verdict: str
    tracking_error_percent: float | None
    true_stiffness_n_per_m: float
    rendered_stiffness_n_per_m: float | None
    perceived_delay_ms: float | None
    free_impedance_n_s_per_m: float | None
    contrast_db: float | None


class _Tones(NamedTuple):
    """Complex amplitudes of the fundamental: F_m, rendered force [N], x_m [m]; RMS of x_s/alpha_p - x_m and of x_m."""

    hand_n: complex
    rendered_n: complex
    hand_m: complex
    error_rms_m: float
    motion_rms_m: float


def measure(cell: Cell) -> Transparency:
    """Measure the law of a cell against its spring. Raises ConfigError for a cell that cannot be run."""
    scales = scales_of(cell.controller())
    verdict = run_cell(cell).verdict
    pressed = _tones(cell, _MEAN_N, scales.position_scale) if verdict == "stable" else None
    free = _tones(cell.model_copy(update={"stiffness_n_per_m": _NOTHING_N_PER_M}), 0.0, scales.position_scale)
    omega = 2.0 * math.pi * FREQUENCY_HZ
    free_impedance = abs(free.hand_n / (1j * omega * free.hand_m)) if free is not None else None
    width, stiffness, delay, error = None, None, None, None
    if pressed is not None:
        impedance = abs(pressed.hand_n / (1j * omega * pressed.hand_m))
        width = 20.0 * math.log10(impedance / free_impedance) if free_impedance else None
        stiffness = (pressed.hand_n / pressed.hand_m).real
        # within half a period either way; a law that leads has a negative delay
        delay = 1e3 * float(np.angle(pressed.hand_m / pressed.rendered_n)) / omega if pressed.rendered_n else None
        error = 100.0 * pressed.error_rms_m / pressed.motion_rms_m
    return Transparency(
        cell.law,
        cell.round_trip_ms,
        cell.stiffness_n_per_m,
        verdict,
        error,
        scales.force_scale * scales.position_scale * cell.stiffness_n_per_m,
        stiffness,
        delay,
        free_impedance,
        width,
    )


def hand_programme(mean_n: float, settle_s: float) -> tuple[list[tuple[float, float]], float]:
    """Return the corners (time [s], force [N]) of a ramp and a sine on top, and when the measurement begins [s]."""
    begin = _RAMP_S + settle_s
    periods = _SETTLE_PERIODS + _MEASURED_PERIODS
    points = [(0.0, 0.0), (_RAMP_S, mean_n)]
    for n in range(periods * _POINTS_PER_PERIOD + 1):
        time = n / (_POINTS_PER_PERIOD * FREQUENCY_HZ)
        points.append((begin + time, mean_n + _AMPLITUDE_N * math.sin(2.0 * math.pi * FREQUENCY_HZ * time)))
    return points, begin + _SETTLE_PERIODS / FREQUENCY_HZ


def _tones(cell: Cell, mean_n: float, position_scale: float) -> _Tones | None:
    """Run and demodulate; None when the instrument's guard ended it."""
    points, begin_s = hand_programme(mean_n, 0.5 + 20.0 * cell.round_trip_s)
    course = course_of(cell, points, begin_s + _MEASURED_PERIODS / FREQUENCY_HZ)
    if (course.instrument_mode != course.instrument_mode[0]).any():
        return None
    return _demodulated(course, begin_s, position_scale)


def _demodulated(course: Trajectory, begin_s: float, position_scale: float) -> _Tones:
    part = slice(int(np.searchsorted(course.time_s, begin_s - 1e-9)), None)
    carrier = np.exp(-2j * math.pi * FREQUENCY_HZ * course.time_s[part])
    hand_m = course.hand_position_m[part]
    error = course.base_position_m[part] / position_scale - hand_m
    tones = [2.0 * np.mean(signal[part] * carrier) for signal in (course.hand_force_n, course.rendered_force_n)]
    motion = complex(2.0 * np.mean((hand_m - hand_m.mean()) * carrier))
    return _Tones(complex(tones[0]), complex(tones[1]), motion, float(error.std()), float(hand_m.std()))
