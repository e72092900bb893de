"""Transparency: how much of the environment reaches the hand, for each law, over the delay and over frequency.

The hand presses on a spring with a constant force and a small sine on top, once on the spring of the study, once on
nothing. After the transient, the fundamental of each signal is fitted over whole periods together with a trend, so that
neither drift nor creep is counted as swing. With X, F complex:

- tracking error: RMS of x_s / alpha_p - x_m without their means, over the RMS of x_m, [%]
- rendered stiffness: Re(F_m / X_m), the stiffness that the hand feels of a spring [N/m], against the true alpha_f
  alpha_p K
- perceived delay: the time by which the force that the law renders lags behind the hand's motion, arg(X_m / F_r) /
  omega
- contrast: |F_m / V_m| on the spring over that on nothing, in dB. It is no Z-width: a hand that is stuck has the
  greatest contrast
- hybrid matrix (B. Hannaford, IEEE Trans. Robotics and Automation 5, 1989), (F_m, -V_s) = H (V_m, F_s) at the hand's
  scale: h11 and h21 from the run on nothing, h12 and h22 from the run on the spring. Ideal: h11 = h22 = 0, h12 = 1, h21
  = -1. For a law that is not linear it is the matrix for this amplitude and this spring
- Z-width (J. E. Colgate and J. M. Brown, Proc. IEEE Int. Conf. Robotics and Automation, 1994), the range of impedances
  that the device can render passively: from free motion to the stiffest spring, up to STIFFEST_N_PER_M, on which Re(F_m
  / V_m) >= 0 at every measured frequency. It covers only the band of the hand's motion, up to 10 Hz: from 26 Hz on the
  lag of the servo makes even free motion active, with every law

An unstable case has no such numbers: they are None.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.lockstep import Trajectory
from telenano.numerics import regression
from telenano_lab.studies.loops.cells import Cell, course_of, run_cell, scales_of

Series = npt.NDArray[np.float64]
FREQUENCY_HZ = 0.5
FREQUENCIES_HZ = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
STIFFEST_N_PER_M = 400.0
_SOFTEST_N_PER_M = 0.5
# Activity below this share of |Z| counts as passive, because the sums of a run leave an error of that size.
_PASSIVE_SHARE = 2e-3
_HALVINGS = 7
# The mean force of the hand, and the amplitude of its swing [N].
_MEAN_N = 1.0
_AMPLITUDE_N = 0.3
# The duration of the ramp to the mean force [s].
_RAMP_S = 0.5
# The corners of the sine in a period: straight lines between 200 points differ from it by 1e-4 of its amplitude.
_POINTS_PER_PERIOD = 200
# The periods before the measurement at FREQUENCY_HZ.
_SETTLE_PERIODS = 3
# The measured periods at FREQUENCY_HZ.
_MEASURED_PERIODS = 3
# The least time before the measurement at any other frequency [s].
_LEAST_SETTLE_S = 2.0
# The least duration of the measurement at any other frequency [s].
_LEAST_MEASURED_S = 2.0
# A spring that is not felt: over the motion of a run its force stays below a piconewton.
_NOTHING_N_PER_M = 1e-6


@dataclass(frozen=True)
class Transparency:
    """The figures of one law at one delay, as the module defines them; `verdict` is that of the hold on the spring."""

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


@dataclass(frozen=True)
class Spectrum:
    """The figures of a law at one delay over frequency; None at frequencies at which the law was not stable.

    hybrid: h11 [N s/m], h12, h21, h22 [m/(N s)]; rendered_n_per_m: Re(F_m / X_m) on the spring; free_n_s_per_m:
    Re(F_m / V_m) on nothing; passive_n_per_m: stiffest spring at the tip that is rendered passively, None if none is;
    z_width_db: |F_m / V_m| on that spring over that on nothing, at 1 Hz, or the frequency next to it.
    """

    law: str
    round_trip_ms: float
    stiffness_n_per_m: float
    frequencies_hz: tuple[float, ...]
    hybrid: tuple[tuple[complex, complex, complex, complex] | None, ...]
    rendered_n_per_m: tuple[float | None, ...]
    free_n_s_per_m: tuple[float | None, ...]
    passive_n_per_m: float | None
    z_width_db: float | None

    def rows(self) -> list[dict[str, float | str | None]]:
        """Return a flat row for each frequency."""
        table: list[dict[str, float | str | None]] = []
        for n, frequency in enumerate(self.frequencies_hz):
            row: dict[str, float | str | None] = {
                "law": self.law,
                "round_trip_ms": self.round_trip_ms,
                "stiffness_n_per_m": self.stiffness_n_per_m,
                "frequency_hz": frequency,
                "rendered_n_per_m": self.rendered_n_per_m[n],
                "free_n_s_per_m": self.free_n_s_per_m[n],
            }
            entries = self.hybrid[n]
            for k, name in enumerate(("h11", "h12", "h21", "h22")):
                row[f"{name}_re"] = None if entries is None else entries[k].real
                row[f"{name}_im"] = None if entries is None else entries[k].imag
            table.append(row)
        return table


class _Tones(NamedTuple):
    """Complex amplitudes of the fundamental, at the hand's scale; RMS of x_s/alpha_p - x_m and of x_m [m].

    hand_n: F_m; rendered_n: force that the law renders; hand_m: x_m; tip_n: alpha_f F_s; tip_m: x_s / alpha_p.
    """

    hand_n: complex
    rendered_n: complex
    hand_m: complex
    tip_n: complex
    tip_m: complex
    error_rms_m: float
    motion_rms_m: float


def measure(cell: Cell) -> Transparency:
    """Measure the transparency of a cell's law against its spring.

    Raises:
        ConfigError: The cell cannot be run.
    """
    scales = scales_of(cell.controller())
    verdict = run_cell(cell).verdict
    pressed = _tones(cell, _MEAN_N, FREQUENCY_HZ) if verdict == "stable" else None
    free = _tones(_on_nothing(cell), 0.0, FREQUENCY_HZ)
    omega = 2.0 * math.pi * FREQUENCY_HZ
    free_impedance = abs(free.hand_n / (1j * omega * free.hand_m)) if free is not None else None
    width, stiffness, delay, error = None, None, None, None
    if pressed is not None:
        impedance = abs(pressed.hand_n / (1j * omega * pressed.hand_m))
        width = 20.0 * math.log10(impedance / free_impedance) if free_impedance else None
        stiffness = (pressed.hand_n / pressed.hand_m).real
        # The delay is within half a period either way, and negative for a law that leads.
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


def spectrum(cell: Cell, frequencies_hz: tuple[float, ...] = FREQUENCIES_HZ) -> Spectrum:
    """Measure hybrid matrix, impedances and Z-width of a cell's law with its spring."""
    free = [_tones(_on_nothing(cell), 0.0, frequency) for frequency in frequencies_hz]
    stable = run_cell(cell).verdict == "stable"
    pressed = [_tones(cell, _MEAN_N, frequency) if stable else None for frequency in frequencies_hz]
    limit = passive_stiffness(cell, frequencies_hz)
    width = None
    middle = min(range(len(frequencies_hz)), key=lambda n: abs(math.log(frequencies_hz[n])))
    if limit is not None and (loose := free[middle]) is not None:
        stiffest = _tones(cell.model_copy(update={"stiffness_n_per_m": limit}), _MEAN_N, frequencies_hz[middle])
        if stiffest is not None:
            ratio = abs(stiffest.hand_n / stiffest.hand_m) / abs(loose.hand_n / loose.hand_m)
            width = 20.0 * math.log10(ratio)
    omegas = [2.0 * math.pi * frequency for frequency in frequencies_hz]
    return Spectrum(
        cell.law,
        cell.round_trip_ms,
        cell.stiffness_n_per_m,
        frequencies_hz,
        tuple(
            None if a is None or b is None else _hybrid(a, b, w) for a, b, w in zip(free, pressed, omegas, strict=True)
        ),
        tuple(None if tones is None else (tones.hand_n / tones.hand_m).real for tones in pressed),
        tuple(
            None if tones is None else (tones.hand_n / (1j * omega * tones.hand_m)).real
            for tones, omega in zip(free, omegas, strict=True)
        ),
        limit,
        width,
    )


def passive_stiffness(cell: Cell, frequencies_hz: tuple[float, ...]) -> float | None:
    """Return the stiffest spring [N/m] that a cell's law renders passively; None if it renders none so."""

    def passive(stiffness: float) -> bool:
        pressed = cell.model_copy(update={"stiffness_n_per_m": stiffness})
        found = (_tones(pressed, _MEAN_N, frequency) for frequency in frequencies_hz)
        return all(tones is not None and _damping_share(tones) >= -_PASSIVE_SHARE for tones in found)

    if passive(STIFFEST_N_PER_M):
        return STIFFEST_N_PER_M
    low, high = math.log(_SOFTEST_N_PER_M), math.log(STIFFEST_N_PER_M)
    if not passive(_SOFTEST_N_PER_M):
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passive(math.exp(middle)) else (low, middle)
    return math.exp(low)


def _damping_share(tones: _Tones) -> float:
    """Return Re Z / |Z| of the hand's port, Z = F_m / V_m."""
    impedance = tones.hand_n / (1j * tones.hand_m)
    return impedance.real / abs(impedance)


def _hybrid(free: _Tones, pressed: _Tones, omega: float) -> tuple[complex, complex, complex, complex]:
    h11, h21 = free.hand_n / (1j * omega * free.hand_m), -free.tip_m / free.hand_m
    speed = 1j * omega * pressed.hand_m
    h12 = (pressed.hand_n - h11 * speed) / pressed.tip_n
    h22 = (-1j * omega * pressed.tip_m - h21 * speed) / pressed.tip_n
    return h11, h12, h21, h22


def _on_nothing(cell: Cell) -> Cell:
    return cell.model_copy(update={"environment": "spring", "stiffness_n_per_m": _NOTHING_N_PER_M})


def hand_force_profile(
    mean_n: float,
    settle_s: float,
    frequency_hz: float = FREQUENCY_HZ,
    cycles: int = _MEASURED_PERIODS,
    amplitude_n: float = _AMPLITUDE_N,
) -> tuple[list[tuple[float, float]], float]:
    """Return the corners (time [s], force [N]) of a ramp followed by a sine, and the begin of the measurement [s].

    Args:
        mean_n: The force at the end of the ramp [N].
        settle_s: The time for the rig to settle after the ramp [s].
        frequency_hz: The frequency of the sine [Hz].
        cycles: The number of measured periods.
        amplitude_n: The amplitude of the sine [N].
    """
    begin = _RAMP_S + settle_s
    before = _settle_periods(frequency_hz)
    points = [(0.0, 0.0), (_RAMP_S, mean_n)]
    # Two corners are at least two ticks apart.
    each = min(_POINTS_PER_PERIOD, round(500.0 / frequency_hz))
    for n in range((before + cycles) * each + 1):
        time = n / (each * frequency_hz)
        points.append((begin + time, mean_n + amplitude_n * math.sin(2.0 * math.pi * frequency_hz * time)))
    return points, begin + before / frequency_hz


def _settle_periods(frequency_hz: float) -> int:
    if frequency_hz == FREQUENCY_HZ:
        return _SETTLE_PERIODS
    return max(1, math.ceil(_LEAST_SETTLE_S * frequency_hz))


def _tones(cell: Cell, mean_n: float, frequency_hz: float) -> _Tones | None:
    """Run a cell with a swing and demodulate it; None if the instrument's guard ended the run."""
    course, begin_s = swing(cell, mean_n, frequency_hz)
    return _demodulated(course, begin_s, cell, frequency_hz) if followed(course) else None


def swing(
    cell: Cell, mean_n: float, frequency_hz: float, amplitude_n: float = _AMPLITUDE_N
) -> tuple[Trajectory, float]:
    """Run a cell with a hand that swings about a mean force; return its course and the begin of the measurement [s].

    Raises:
        RigError: The tip was never placed.
    """
    cycles = max(2, math.ceil(_LEAST_MEASURED_S * frequency_hz))
    cycles = _MEASURED_PERIODS if frequency_hz == FREQUENCY_HZ else cycles
    settle_s = 0.5 + 20.0 * cell.round_trip_s
    points, begin_s = hand_force_profile(mean_n, settle_s, frequency_hz, cycles, amplitude_n)
    return course_of(cell, points, begin_s + cycles / frequency_hz), begin_s


def followed(course: Trajectory) -> bool:
    """Return whether the instrument followed throughout, except for short holds at pauses in the commands."""
    return bool((course.follows | course.held).all())


def tone(time_s: Series, values: Series, frequency_hz: float) -> tuple[complex, Series]:
    """Return the complex amplitude of a swing fitted with its mean and a trend, and the residuals, shape (n,).

    Args:
        time_s: The times of the values [s], shape (n,).
        values: The values, shape (n,).
        frequency_hz: The frequency of the swing [Hz].
    """
    omega, off = 2.0 * math.pi * frequency_hz, time_s - time_s.mean()
    found, left = regression((np.cos(omega * time_s), np.sin(omega * time_s), np.ones_like(off), off), values)
    return complex(found[0], -found[1]), left


def _demodulated(course: Trajectory, begin_s: float, cell: Cell, frequency_hz: float) -> _Tones:
    scales = scales_of(cell.controller())
    part = slice(int(np.searchsorted(course.time_s, begin_s - 1e-9)), None)

    def amplitude(values: Series) -> complex:
        return tone(course.time_s[part], values, frequency_hz)[0]

    hand_m = course.hand_position_m[part]
    tip_m = course.base_position_m[part] / scales.position_scale
    return _Tones(
        hand_n=amplitude(course.hand_force_n[part]),
        rendered_n=amplitude(course.rendered_force_n[part]),
        hand_m=amplitude(hand_m),
        tip_n=amplitude(scales.force_scale * course.tip_force_n[part]),
        tip_m=amplitude(tip_m),
        error_rms_m=float((tip_m - hand_m).std()),
        motion_rms_m=float(hand_m.std()),
    )
