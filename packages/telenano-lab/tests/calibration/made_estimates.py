"""How often an estimate is outside three of its stated errors, and refused though the measurement has an answer.

    python packages/telenano-lab/tests/calibration/made_estimates.py [COUNT] [ESTIMATE ...]

Each estimate is made of drawn truths by the generators of the tests. `empty` are measurements of the same kind without
an answer (a floor alone, a sensor that does not follow, counts within their noise): all of them should be refused, or
have an interval that says so.
"""

import argparse
import math
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from made_hard_curves import both_ways
from made_spectra import spectrum_of
from telenano_devices.line_fit import CalibrationError, fit_line
from telenano_lab.calibration.own_calibration import Thermal, sensitivity_of_curve, stiffness_of_spectrum
from telenano_lab.doubles.made_curves import curve_under, drawn_conditions
from telenano_lab.microscopy.curve_fit import ContactShape, MeasuredWays, fit_curve

from telenano.analysis import DEVIATIONS, mean_half_width, student
from telenano.wire import ConfigError


class Told(NamedTuple):
    """A measurement: whether it has an answer, and the distance of the estimate in its errors; None if refused."""

    has_answer: bool
    apart: float | None


def spectrum(kind: str, seed: int) -> Told:
    """The stiffness by a thermal spectrum; an empty one has the floor alone."""
    lever, frequency, density = spectrum_of(kind, seed)
    empty = seed % 4 == 3
    if empty:
        density = np.random.default_rng(seed).gamma(lever.averages, float(density.min()) / lever.averages, len(density))
    known = Thermal(lever.m_per_v, lever.kelvin, averages=float(lever.averages))
    try:
        found = stiffness_of_spectrum(frequency, density, known)
    except ConfigError:
        return Told(not empty, None)
    return Told(not empty, (found.stiffness_n_per_m - lever.k) / found.standard_error_n_per_m)


def sensitivity(seed: int) -> Told:
    """The sensitivity by a curve on a hard sample; in an empty one the voltage is noise."""
    draw = np.random.default_rng(seed)
    course, empty = both_ways(draw), seed % 4 == 3
    volts = (0.0 if empty else course.deflection / course.nm_per_v) + course.noise_v * draw.standard_normal(
        len(course.way)
    )
    try:
        found = sensitivity_of_curve(1e-9 * course.way, volts)
    except ConfigError:
        return Told(not empty, None)
    return Told(not empty, (1e9 * found.m_per_v - course.nm_per_v) / (1e9 * found.standard_error_m_per_v))


def contact(figure: str, seed: int) -> Told:
    """The modulus or the adhesion by Hertz on a zero line that tilts; an empty curve does not touch.

    The adhesion of half of them is zero, which has an interval as another value has.
    """
    draw = np.random.default_rng(seed)
    under = drawn_conditions("hertz", draw, noise="white")._replace(tilt_share=draw.uniform(-0.4, 0.4))
    made, empty = curve_under(under, draw, is_layer=False), seed % 4 == 3
    way = MeasuredWays(made.approach_m, made.approach_n, made.retract_m, made.retract_n, made.stiffness_n_per_m)
    if empty:
        nothing = made.truth.modulus_pa * 0.0 + 1e-12 * draw.standard_normal((2, len(made.approach_n)))
        way = way._replace(approach_n=nothing[0], retract_n=nothing[1])
    found = fit_curve(way, ContactShape("hertz", made.radius_m, 0.0, made.poisson))
    if found.refused:
        return Told(not empty, None)
    if figure == "adhesion":
        return Told(not empty, (found.adhesion_n - made.truth.adhesion_n) / found.adhesion_error_n)
    return Told(not empty, (found.modulus_pa - made.truth.modulus_pa) / found.modulus_error_pa)


def scale_of_hand(seed: int) -> Told:
    """The scale of a handle by counts at five places; the counts of an empty one do not follow."""
    draw = np.random.default_rng(seed)
    per_value, empty = math.exp(draw.uniform(0.0, 6.0)), seed % 4 == 3
    values, error = np.linspace(0.0, 1.0, 5), 0.003 * per_value
    counts = (0.0 if empty else per_value) * values + error * draw.standard_normal(5)
    try:
        found = fit_line("a hand", counts.tolist(), [error] * 5, values.tolist())
    except CalibrationError:
        return Told(not empty, None)
    return Told(not empty, (found.scale - 1.0 / per_value) / found.scale_error)


def mean(seed: int) -> Told:
    """The mean of a record of white or settled noise; that of an empty one, a random walk, is open."""
    draw = np.random.default_rng(seed)
    values, empty = draw.standard_normal(2048), seed % 4 == 3
    if empty:
        values = np.cumsum(values)
    half = mean_half_width(values)
    return Told(
        not empty, None if half is None else DEVIATIONS * (float(values.mean()) if half else 0.0) / (half or 1.0)
    )


def slope(seed: int) -> Told:
    """A slope over the people of an experiment, by Student's interval; it may be zero, so none is refused."""
    draw = np.random.default_rng(seed)
    slopes = 0.3 + draw.standard_normal(8)
    half = student(7, 0.9973) * float(slopes.std(ddof=1)) / math.sqrt(8)
    return Told(True, 3.0 * (float(slopes.mean()) - 0.3) / half)


ESTIMATES: dict[str, Callable[[int], Told]] = {
    "stiffness, air": lambda seed: spectrum("clean", seed),
    "stiffness, overdamped": lambda seed: spectrum("overdamped", seed),
    "stiffness, liquid": lambda seed: spectrum("liquid", seed),
    "sensitivity": sensitivity,
    "modulus": lambda seed: contact("modulus", seed),
    "adhesion": lambda seed: contact("adhesion", seed),
    "scale of a hand": scale_of_hand,
    "mean": mean,
    "slope": slope,
}


class Row(NamedTuple):
    """Of an estimate: how many have an answer, of these refused and outside three errors, and empty ones accepted."""

    answers: int
    refused: int
    outside: int
    empty: int
    accepted: int


def row(name: str, seeds: range) -> Row:
    """Count the outcomes of an estimate over seeds."""
    told = [ESTIMATES[name](seed) for seed in seeds]
    answers = [one.apart for one in told if one.has_answer]
    empty = [one.apart for one in told if not one.has_answer]
    outside = sum(apart is not None and abs(apart) > 3.0 for apart in answers)
    return Row(
        len(answers), answers.count(None), outside, len(empty), len(empty) - empty.count(None),
    )  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=400, metavar="COUNT", help="measurements of each")
    parser.add_argument("names", nargs="*", metavar="ESTIMATE", help="all without one")
    asked = parser.parse_args()
    sys.stdout.write(
        "| estimate | outside three errors | refused though answered | empty ones accepted |\n|---|---|---|---|\n"
    )
    for name in asked.names or ESTIMATES:
        one = row(name, range(asked.count))
        taken = max(one.answers - one.refused, 1)
        sys.stdout.write(
            f"| {name} | {one.outside} of {taken} | {one.refused} of {one.answers} | {one.accepted} of {one.empty} |\n"
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
