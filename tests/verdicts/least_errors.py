"""How well the samples of short cycles can tell at all what their swing does: the bound of Cramér and Rao.

    python tests/verdicts/least_errors.py --seeds 90000:93000

For each steady swing in a stretch of less than a second: the least standard error that an estimate of its change over
the stretch can have, whatever the estimate, from the plan of the course alone. Unknown are the rest, a straight line,
size, phase, growth and frequency, and the modes beside it; known is the covariance of the noise. Prints, by cell, in
how many courses 0.3, which is what a swing that dies out changes by at least, is within 2.5 of these errors.
"""

import argparse
import math
import sys
from collections import defaultdict

import distribution as d
import numpy as np
from confusion import _range
from courses import _OCTAVES
from numpy.typing import NDArray
from plans import Plan, _verdict, plan, stretches

Floats = NDArray[np.float64]
SURE_ERRORS = 2.5


def _pink(time_s: Floats, shortest_s: float) -> Floats:
    """Return the covariance of the 1/f noise of `courses`, of unit variance."""
    found = np.zeros((len(time_s), len(time_s)))
    places = np.arange(len(time_s))
    for octave in range(_OCTAVES):
        step = time_s / (shortest_s * 2.0**octave)
        first = np.floor(step).astype(int)
        lines = np.zeros((len(time_s), first[-1] + 2))
        lines[places, first], lines[places, first + 1] = 1.0 - (step - first), step - first
        found += lines @ lines.T
    return found * 1.5 / _OCTAVES


def _covariance(drawn: Plan, time_s: Floats) -> Floats:
    """Return the covariance of what is random in a course, and a trace of rounding [N²]."""
    one, force_n = np.eye(len(time_s)), drawn.hand_force_n
    shape = {"pink": _pink(time_s, 2.0 / drawn.sample_rate_hz), "quantised": one / 12.0}.get(drawn.noise, one)
    found = 1e-8 * force_n**2 * one + drawn.noise_n**2 * shape
    apart_s = np.abs(time_s[:, None] - time_s[None])
    swing = np.exp(-apart_s) * np.cos(2.0 * math.pi * drawn.modes[0].frequency_hz * apart_s)
    return found + drawn.random_excitation_n**2 * swing


def least_error(drawn: Plan) -> float:
    """Return the least standard error of the change of a steady swing over the stretch that its truth is of [1]."""
    known = [
        (low, high) for low, high, run in stretches(drawn) if _verdict(drawn, low, high, drawn.runs[run])[2] is None
    ]
    low, high = max(known, key=lambda ends: ends[1] - ends[0])
    time_s = np.arange(0.0, high - low, 1.0 / drawn.sample_rate_hz)
    since, covariance = time_s / (high - low), _covariance(drawn, time_s)
    beside = []
    for mode in drawn.modes[1:]:
        size = mode.amplitude_n * np.exp(mode.rate_per_s * (time_s + low - drawn.landing_s))
        turn = 2.0 * math.pi * mode.frequency_hz * time_s
        beside += [size * np.cos(turn), size * np.sin(turn), since * size * np.cos(turn), since * size * np.sin(turn)]
    seen = [one for one in beside if np.abs(one).max() > 1e-3 * drawn.hand_force_n]
    errors = []
    for phase in (0.0, 0.8, 1.6, 2.4):
        turn = 2.0 * math.pi * drawn.modes[0].frequency_hz * time_s + phase
        swing, across = drawn.modes[0].amplitude_n * np.cos(turn), drawn.modes[0].amplitude_n * np.sin(turn)
        columns = np.array([since * swing, since * across, swing, across, np.ones_like(since), since, *seen]).T
        information = columns.T @ np.linalg.solve(covariance, columns)
        errors.append(math.sqrt(np.linalg.pinv(information)[0, 0]))
    return float(np.mean(errors))


def main() -> None:
    parser = argparse.ArgumentParser(description="How well the samples of short cycles tell what their swing does")
    parser.add_argument("--seeds", type=_range, default=range(d.COURSES), help="FIRST:END")
    found: dict[str, list[float]] = defaultdict(list)
    for drawn in map(plan, parser.parse_args().seeds):
        if drawn.motion == "sustained" and drawn.truth == "goes_on" and drawn.cell.endswith("short"):
            found[drawn.cell].append(least_error(drawn))
    for cell, errors in sorted(found.items()):
        hidden = sum(SURE_ERRORS * error > d.LEAST_RATE_TIMES_LENGTH for error in errors)
        sys.stdout.write(f"{cell}: {hidden} of {len(errors)} steady swings, median {np.median(errors):.3f}\n")


if __name__ == "__main__":
    main()
