"""Made thermal spectra of levers that are drawn, with faults of many kinds, and how often the fit is right about them.

    python packages/telenano-lab/tests/calibration/made_spectra.py [COUNT] [KIND ...]

A spectrum is the power of a damped spring in white noise (its textbook form, not that of the fit), times
gamma-distributed noise of so many averages. Levers, sampling, averages and faults are drawn from a seed; the fit sees a
text file alone. For each kind it prints the share of 95 % intervals with the true stiffness in them among the accepted,
the share refused, and the wrong acceptances: more than 5 of their own standard errors and more than 5 % off. Beside it
stands what `scipy.optimize.curve_fit` makes of the same lines near their peak, by least squares and with its own error.
"""

import argparse
import math
import sys
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeWarning, curve_fit

K_B = 1.380649e-23


class Lever(NamedTuple):
    """Stiffness [N/m], resonance [Hz], Q, sensitivity [m/V], lines to a width at half its height, and averages."""

    k: float
    f0: float
    q: float
    m_per_v: float
    lines: float
    averages: int
    kelvin: float


KINDS = (
    "clean", "tone 1 %", "tone 5 %", "tone 10 %", "tone 20 %", "tone 50 %", "1/f", "second mode", "few lines", "kHz",
    "V/sqrtHz", "comma", "window", "overdamped", "liquid",
)  # fmt: skip


def lever_of(draw: np.random.Generator) -> Lever:
    """Draw a lever: soft ones are slow, and Q is that of air, sometimes of water."""
    f0 = math.exp(draw.uniform(math.log(8e3), math.log(4e5)))
    mass = math.exp(draw.uniform(math.log(2e-12), math.log(3e-11)))
    q = math.exp(draw.uniform(math.log(3.0), math.log(500.0)))
    averages = int(math.exp(draw.uniform(math.log(10), math.log(400))))
    return Lever(
        (2.0 * math.pi * f0) ** 2 * mass, f0, q, draw.uniform(20e-9, 150e-9), draw.uniform(5.0, 60.0), averages, 295.0
    )


def spring(frequency: np.ndarray, square: float, f0: float, q: float) -> np.ndarray:
    """Return the density of a spring in white noise with a mean square: 2 s^2 / pi f0 Q ((1 - x^2)^2 + x^2/Q^2)."""
    x = frequency / f0
    return 2.0 * square / (math.pi * f0 * q * ((1.0 - x**2) ** 2 + (x / q) ** 2))


def in_liquid(frequency: np.ndarray, square: float, lever: Lever, width_m: float, ratio: float) -> np.ndarray:
    """Return the density of a rectangular lever in water, by its susceptibility with the hydrodynamic function.

    ratio: mass of a cylinder of water of that width over the mass of the lever. The area is that of equipartition.
    """
    from telenano_lab.calibration.own_calibration import hydrodynamic

    grid = np.geomspace(1e-3 * lever.f0, 300.0 * lever.f0, 3000)
    gamma = np.array([hydrodynamic(min(998.0 * math.tau * f * width_m**2 / 4e-3, 9999.0)) for f in grid.tolist()])
    x2 = (grid / (lever.f0 * math.sqrt(1.0 + 1.5 * ratio))) ** 2
    shape = x2 * gamma.imag / grid / ((1.0 - x2 * (1.0 + ratio * gamma.real)) ** 2 + (x2 * ratio * gamma.imag) ** 2)
    area = float(np.sum(0.5 * (shape[1:] + shape[:-1]) * np.diff(grid)))
    return np.asarray(square / area * np.interp(frequency, grid, shape))


def spectrum_of(kind: str, seed: int) -> tuple[Lever, np.ndarray, np.ndarray]:
    """Return a lever, the lines [Hz] of its spectrum, and the density [V^2/Hz]."""
    draw = np.random.default_rng([KINDS.index(kind), seed])
    lever = lever_of(draw)
    few = kind == "few lines"
    if few:
        lever = lever._replace(lines=draw.uniform(0.8, 4.0))
    # the rate is far above the resonance, so that aliasing is of no account
    if kind in ("overdamped", "liquid"):
        q = draw.uniform(0.4, 3.0)
        lever = lever._replace(f0=0.1 * lever.f0, k=0.01 * lever.k, q=q, lines=draw.uniform(40.0, 400.0) / q)
    spacing = max(lever.f0 / lever.q / lever.lines, lever.f0 / 2_000.0)
    highest = draw.uniform(8.0, 14.0) * lever.f0
    frequency = spacing * np.arange(1, int(highest / spacing))
    # the way an angle reads an end-loaded lever: 0.971 / 1.09^2
    square = 0.971 / 1.09**2 * K_B * lever.kelvin / lever.k
    peak = 2.0 * square * lever.q / (math.pi * lever.f0)
    floor = peak * math.exp(draw.uniform(math.log(1e-5), math.log(1e-2)))
    if few:
        # what a rectangle of that length sees: the covariance of the motion times its own triangle
        count = 2 * (len(frequency) + 1)
        dt = 1.0 / (count * spacing)
        t = dt * np.arange(count)
        gamma = math.pi * lever.f0 / lever.q
        turn = 2.0 * math.pi * lever.f0 * math.sqrt(1.0 - 0.25 / lever.q**2)
        r = square * np.exp(-gamma * t) * (np.cos(turn * t) + gamma / turn * np.sin(turn * t))
        seen = 2.0 * dt * (2.0 * np.fft.rfft(r * (1.0 - np.arange(count) / count)).real - r[0])
        mean = seen[1 : len(frequency) + 1] + floor
    else:
        mean = spring(frequency, square, lever.f0, lever.q) + floor
    if kind == "liquid":
        water = math.exp(draw.uniform(math.log(2.0), math.log(60.0)))
        mean = in_liquid(frequency, square, lever, draw.uniform(20e-6, 50e-6), water) + floor
    if kind == "1/f":
        mean += peak * draw.uniform(1e-4, 3e-2) * (0.1 * lever.f0 / frequency) ** draw.uniform(0.8, 2.0)
    if kind == "second mode":
        place = draw.uniform(1.6, 6.5)
        mean += spring(frequency, square * draw.uniform(0.005, 0.1), place * lever.f0, lever.q * draw.uniform(0.5, 3.0))
    noise = draw.gamma(lever.averages, 1.0 / lever.averages, len(frequency))
    if kind == "window":
        # Hann's window joins neighbouring lines: periodograms of white numbers through it, scaled to the mean
        noise = np.zeros(len(frequency))
        for _ in range(lever.averages):
            z = draw.standard_normal((2, len(frequency) + 2))
            c = z[0] + 1j * z[1]
            noise += np.abs(0.5 * c[1:-1] - 0.25 * (c[:-2] + c[2:])) ** 2 / (2.0 * 0.375) / lever.averages
    density = mean * noise
    if kind.startswith("tone"):
        share = 0.01 * float(kind.split()[1])
        place = draw.uniform(0.2, 2.5) * lever.f0 if draw.random() < 0.7 else lever.f0 * draw.uniform(0.9, 1.1)
        density[int(np.argmin(np.abs(frequency - place)))] += share * square / spacing
    return lever, frequency, density / lever.m_per_v**2


def write(path: Path, kind: str, frequency: np.ndarray, density: np.ndarray) -> None:
    """Write a spectrum as programs do; the head has the units."""
    scale, unit = (1e-3, "kHz") if kind == "kHz" else (1.0, "Hz")
    values, of_values = (np.sqrt(density), "V/√Hz") if kind == "V/sqrtHz" else (density, "V^2/Hz")
    text = "".join(f"{scale * f:.9g};{v:.9e}\n" for f, v in zip(frequency.tolist(), values.tolist(), strict=True))
    if kind == "comma":
        text = text.replace(".", ",")
    path.write_text(f"frequency [{unit}];density [{of_values}]\n{text}", encoding="utf-8")


class Outcome(NamedTuple):
    """Of one spectrum: deviation as a share and in standard errors; None where it was refused, with the reason."""

    share: float | None
    errors: float | None
    reason: str = ""


def outcomes(kind: str, seeds: range, folder: Path) -> Iterator[tuple[Outcome, Outcome]]:
    """Yield what the fit makes of the spectra of a kind, and what SciPy makes of them."""
    from telenano_lab.calibration.own_calibration import Thermal, stiffness_of_spectrum
    from telenano_lab.calibration.own_calibration import spectrum_of as read

    from telenano.wire import ConfigError

    for seed in seeds:
        lever, frequency, density = spectrum_of(kind, seed)
        path = folder / "thermal.txt"
        write(path, kind, frequency, density)
        theirs = of_scipy(frequency, density, lever)
        try:
            one = read(path)
            # how many averages there were, a person says in half of the cases
            averages = float(lever.averages) if seed % 2 else None
            known = Thermal(lever.m_per_v, lever.kelvin, averages=averages)
            found = stiffness_of_spectrum(one.frequency_hz, one.density_per_hz, known)
        except ConfigError as error:
            yield Outcome(None, None, str(error)), theirs
            continue
        off = found.stiffness_n_per_m - lever.k
        yield Outcome(off / lever.k, off / found.standard_error_n_per_m), theirs


def of_scipy(frequency: np.ndarray, density: np.ndarray, lever: Lever) -> Outcome:
    """Return the answer of a plain fit by least squares, of a spring and a floor, from half to 1.5 of the peak."""
    values = density * lever.m_per_v**2
    top = frequency[int(np.argmax(np.where(frequency > 0.02 * frequency[-1], values, 0.0)))]
    chosen = np.abs(frequency / top - 1.0) < 0.5
    lines, unit = frequency[chosen] / top, float(values[chosen].max())

    def shape(x: np.ndarray, log_area: float, f0: float, log_q: float, floor: float) -> np.ndarray:
        return spring(x, math.exp(log_area), f0, math.exp(log_q)) + floor

    start = (math.log(0.5 * math.pi / 30.0), 1.0, math.log(30.0), 1e-3)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OptimizeWarning)
            found, covariance = curve_fit(shape, lines, values[chosen] / unit, start, maxfev=5000)
        square, share = math.exp(found[0]) * unit * top, math.sqrt(covariance[0, 0])
    except (RuntimeError, TypeError, ValueError, OverflowError) as error:
        return Outcome(None, None, str(error))
    if not 0.0 < share < 1.0:
        return Outcome(None, None, "no covariance")
    off = 0.971 / 1.09**2 * K_B * lever.kelvin / square / lever.k - 1.0
    return Outcome(off, off / (share * (1.0 + off)))


def row(kind: str, seeds: range, folder: Path) -> dict[str, Any]:
    """Return the share of intervals that cover, refused, and wrong acceptances of a kind."""
    found, theirs = zip(*outcomes(kind, seeds, folder), strict=True)
    reasons = [one.reason for one in found if one.reason]
    return {"kind": kind, **_shares(found), "reasons": reasons, "scipy": _shares(theirs)}


def _shares(found: Sequence[Outcome]) -> dict[str, Any]:
    taken = [one for one in found if one.errors is not None and one.share is not None]
    return {
        "covered": sum(abs(one.errors or 0.0) < 1.96 for one in taken) / max(len(taken), 1),
        "refused": 1.0 - len(taken) / len(found),
        "wrong": sum(abs(one.errors or 0.0) > 5.0 and abs(one.share or 0.0) > 0.05 for one in taken),
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=1000, metavar="COUNT", help="spectra of each kind")
    parser.add_argument("kinds", nargs="*", choices=[*KINDS, []], metavar="KIND", help="all without one")
    chosen = parser.parse_args()
    heads = ("kind", "95 % intervals that cover", "refused", "wrong acceptances", "SciPy: cover", "wrong acceptances")
    sys.stdout.write(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}\n")
    with tempfile.TemporaryDirectory() as folder:
        for kind in chosen.kinds or KINDS:
            one = row(kind, range(chosen.count), Path(folder))
            cells = (
                kind,
                f"{one['covered']:.1%}",
                f"{one['refused']:.1%}",
                one["wrong"],
                f"{one['scipy']['covered']:.1%}",
                one["scipy"]["wrong"],
            )
            sys.stdout.write(f"| {' | '.join(map(str, cells))} |\n")
            for reason in sorted(set(reason[:150] for reason in one["reasons"]))[:3]:
                sys.stderr.write(f"    {reason}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
