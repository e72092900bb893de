"""Simulated force curves and maps of known contacts, with noise, tilt, drift, adhesion and thin layers.

    made = drawn_curve("jkr", seed=3)
    made.approach_m, made.approach_n, made.truth.modulus_pa

The code is independent of the fit: the branches of each contact are computed from the equations on a fine grid of their
own, and the force at a place of the base is interpolated. The base moves to the sample and back; the sample drifts at a
constant speed, and the zero of the force tilts and wanders in time.

    python -m telenano_lab.doubles.made_curves MAP.h5 [MODEL [SIDE]]

writes a map of curves, which `telenano curve fit` reads.
"""

import math
import sys
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

NOISES = ("white", "wander", "flicker", "walk")
_GRID = 40_000


class Truth(NamedTuple):
    """True height of the base at the touch [m], Young's modulus [Pa], greatest pull [N], thickness [m] (0 if thick)."""

    contact_m: float
    modulus_pa: float
    adhesion_n: float
    thickness_m: float


class MadeCurve(NamedTuple):
    """A curve: heights of the base, ascending [m], forces [N], constants, kind of noise, and the true values."""

    model: str
    approach_m: Array
    approach_n: Array
    retract_m: Array
    retract_n: Array
    stiffness_n_per_m: float
    radius_m: float
    half_angle_rad: float
    poisson: float
    noise: str
    truth: Truth


def branch(
    model: str,
    reduced_pa: float,
    radius_m: float,
    angle_rad: float,
    pull_n: float,
    thickness_m: float,
    deepest_m: float,
) -> tuple[Array, Array]:
    """Return indentations [m] and forces [N] of a contact, from its possible end to beyond deepest_m."""
    if model == "jkr":
        # JKR: force and indentation as functions of the contact radius a.
        work = pull_n / (1.5 * math.pi * radius_m)
        largest = math.sqrt(radius_m * deepest_m) * 2.0 + (pull_n * radius_m / reduced_pa) ** (1 / 3) * 3.0
        a = np.linspace(0.0, 1.0, _GRID)[1:] ** 2 * largest
        force = 4.0 * reduced_pa * a**3 / (3.0 * radius_m) - np.sqrt(8.0 * math.pi * work * reduced_pa * a**3)
        return a**2 / radius_m - np.sqrt(2.0 * math.pi * work * a / reduced_pa), force
    depth = np.linspace(0.0, 1.0, _GRID) ** 2 * 1.5 * deepest_m
    if model == "sneddon":
        return depth, 2.0 / math.pi * reduced_pa * math.tan(angle_rad) * depth**2
    force = 4.0 / 3.0 * reduced_pa * math.sqrt(radius_m) * depth**1.5
    if thickness_m:
        c = np.sqrt(radius_m * depth) / thickness_m
        force = force * (1.0 + 1.133 * c + 1.283 * c**2 + 0.769 * c**3 + 0.0975 * c**4)
    return depth, force - (pull_n if model == "dmt" else 0.0)


def way_back(depth: Array, force: Array, k: float, x: Array) -> Array:
    """Return the force [N] at base positions x from the touch [m], on the branch that is left last."""
    base = depth + force / k
    first = int(np.argmin(base))
    return np.where(x < base[first], 0.0, np.interp(x, base[first:], force[first:]))


def way_there(depth: Array, force: Array, k: float, x: Array) -> Array:
    """Return the force [N] at base positions x from the touch [m], for a tip that meets the surface at 0."""
    return np.where(x < 0.0, 0.0, way_back(depth, force, k, x))


def noise_of(kind: str, count: int, random: np.random.Generator) -> Array:
    """Return white noise of deviation 1 plus, for the other kinds, correlated noise of the same deviation."""
    white = random.standard_normal(count)
    if kind == "white":
        return white
    if kind == "wander":
        kept, slow = math.exp(-20.0 / count), np.empty(count)
        steps = random.standard_normal(count)
        slow[0] = steps[0]
        for i in range(1, count):
            slow[i] = kept * slow[i - 1] + math.sqrt(1.0 - kept**2) * steps[i]
        return white + slow
    frequency = np.fft.rfftfreq(16 * count)
    size = np.zeros(len(frequency))
    size[1:] = frequency[1:] ** (-0.5 if kind == "flicker" else -1.0)
    normal = random.standard_normal((2, len(frequency)))
    slow = np.fft.irfft(size * (normal[0] + 1j * normal[1]))[:count]
    return np.asarray(white + (slow - slow.mean()) / slow.std())


class Conditions(NamedTuple):
    """The conditions of a map: everything that does not vary from curve to curve."""

    model: str
    points: int
    load_n: float
    stiffness_n_per_m: float
    radius_m: float
    half_angle_rad: float
    poisson: float
    free_share: float
    noise: str
    noise_share: float
    tilt_share: float
    drift_share: float


def drawn_conditions(model: str, random: np.random.Generator, *, is_layer: bool = False, noise: str = "") -> Conditions:
    """Draw conditions as in laboratories: levers, loads, noise, tilt and drift over some decades."""
    return Conditions(
        model,
        int(math.exp(random.uniform(math.log(250), math.log(3000)))),
        10.0 ** random.uniform(-9.5, -7.5),
        10.0 ** random.uniform(-2.0, 1.0),
        10.0 ** random.uniform(-7.7, -5.3),
        math.radians(random.uniform(15.0, 45.0)),
        0.5 if is_layer else random.uniform(0.2, 0.5),
        random.uniform(0.35, 0.7),
        noise or str(random.choice(NOISES)),
        10.0 ** random.uniform(-2.7, -1.5),
        random.uniform(-0.1, 0.1),
        random.uniform(-1e-4, 1e-4),
    )


def curve_under(c: Conditions, random: np.random.Generator, *, is_layer: bool, height_m: float = 0.0) -> MadeCurve:
    """Return a curve under conditions; modulus, pull and thickness are drawn for it."""
    # Indentation of the sample, relative to the deflection of the lever.
    bent_m = c.load_n / c.stiffness_n_per_m
    indented_m = bent_m * 10.0 ** random.uniform(-0.5, 0.8)
    is_round = c.model != "sneddon"
    # The paraboloid approximates a sphere only for indentations well below its radius.
    indented_m = min(indented_m, 0.3 * c.radius_m) if is_round else indented_m
    has_pull = c.model in ("dmt", "jkr") or bool(random.random() < 0.5)
    pull_n = c.load_n * random.uniform(0.1, 0.6) if has_pull else 0.0
    thickness_m = math.sqrt(c.radius_m * indented_m) / random.uniform(0.2, 1.5) if is_layer else 0.0
    # Find the modulus at which this depth carries the load, by bisection.
    low, high = 1e-3, 1e15
    for _ in range(200):
        reduced = math.sqrt(low * high)
        depth, force = branch(c.model, reduced, c.radius_m, c.half_angle_rad, pull_n, thickness_m, indented_m)
        first = int(np.argmin(depth))
        reached_n = float(np.interp(indented_m, depth[first:], force[first:]))
        low, high = (reduced, high) if reached_n < c.load_n else (low, reduced)
        if high / low < 1.0 + 1e-12:
            break
    depth, force = branch(c.model, reduced, c.radius_m, c.half_angle_rad, pull_n, thickness_m, indented_m)
    # Hertz and Sneddon have no pull: the adhesion acts on the way back only.
    back = (depth, force) if c.model in ("dmt", "jkr") else (depth, force - pull_n)
    pushed_m = indented_m + bent_m
    way_m = pushed_m / (1.0 - c.free_share)
    ends = pushed_m - way_m
    # An adhering tip detaches far behind the touch: the way back needs room for its zero line as well.
    ends = min(ends, -2.5 * pull_n / c.stiffness_n_per_m - (0.5 * indented_m if c.model == "jkr" else 0.0))
    x = np.linspace(ends, pushed_m, c.points)
    # The sample drifts: the touch moves on the way there, and on the way back, which is reversed in time.
    speed = c.drift_share
    there = way_there(depth, force, c.stiffness_n_per_m, x - speed * (x - ends))
    turned = x[::-1]
    moved = speed * ((pushed_m - ends) + (pushed_m - turned))
    held = way_back(*back, c.stiffness_n_per_m, turned - moved)
    time = np.linspace(0.0, 2.0, 2 * c.points)
    zero = c.load_n * (c.noise_share * noise_of(c.noise, 2 * c.points, random) + random.uniform(-0.3, 0.3))
    bases = np.concatenate([x, turned])
    tilted = c.load_n * c.tilt_share * (bases - ends) / (pushed_m - ends)
    value = np.concatenate([there, held]) + zero + tilted + 0.02 * c.load_n * random.standard_normal() * time
    # Place of the touch on the fitted way.
    if c.model in ("dmt", "jkr"):
        touch = speed * (2.0 * pushed_m - ends) / (1.0 + speed)
    else:
        touch = -speed * ends / (1.0 - speed)
    modulus = reduced * (1.0 - c.poisson**2)
    truth = Truth(height_m - touch, modulus, pull_n, thickness_m)
    count = c.points
    return MadeCurve(
        c.model, height_m - x[::-1], value[:count][::-1], height_m - turned, value[count:], c.stiffness_n_per_m,
        c.radius_m, c.half_angle_rad, c.poisson, c.noise, truth,
    )  # fmt: skip


def drawn_curve(model: str, seed: int, *, is_layer: bool = False, noise: str = "") -> MadeCurve:
    """Return a curve of a contact under randomly drawn conditions."""
    random = np.random.default_rng([seed, is_layer, sorted(("hertz", "sneddon", "dmt", "jkr")).index(model)])
    return curve_under(drawn_conditions(model, random, is_layer=is_layer, noise=noise), random, is_layer=is_layer)


def made_map(model: str, side: int, seed: int) -> list[list[MadeCurve]]:
    """Return a map of curves, [x][y], over a hill, with a modulus and a pull that differ from place to place."""
    random = np.random.default_rng([seed, side])
    conditions = Conditions(
        model, 400, 3e-9, 0.05, 1e-6, math.radians(20.0), 0.5, 0.5, "wander", 0.01, 0.05, 1e-4
    )  # fmt: skip
    return [
        [
            curve_under(conditions, random, is_layer=False, height_m=1e-7 * math.sin(6.0 * i / side) * j / side)
            for j in range(side)
        ]
        for i in range(side)
    ]


def write_map(path: Path, curves: list[list[MadeCurve]], side_m: float = 1e-6) -> None:
    """Write a map of curves in the layout of afmformats: a group per curve, with its place in the grid."""
    with h5py.File(path, "w") as file:
        file.attrs["software"], file.attrs["software version"] = "made_curves", "1"
        for number, (i, j) in enumerate((i, j) for i in range(len(curves)) for j in range(len(curves[0]))):
            each, group = curves[i][j], file.create_group(str(number))
            count = len(each.approach_m)
            group["force"] = np.concatenate([each.approach_n[::-1], each.retract_n])
            group["height (measured)"] = np.concatenate([each.approach_m[::-1], each.retract_m])
            group["segment"] = np.repeat(np.array([0, 1], dtype=np.uint8), count)
            group["time"] = np.arange(2 * count) * 1e-3
            for name, unit in (("force", "N"), ("height (measured)", "m"), ("segment", ""), ("time", "s")):
                group[name].attrs["unit"] = unit
            group.attrs.update({
                "enum": number, "imaging mode": "force-distance", "point count": 2 * count,
                "spring constant": each.stiffness_n_per_m, "speed approach": 1e-6, "speed retract": 1e-6,
                "duration": 2e-3 * count, "grid index x": i, "grid index y": j, "grid shape x": len(curves),
                "grid shape y": len(curves[0]), "grid size x": side_m, "grid size y": side_m,
                "grid center x": 0.5 * side_m, "grid center y": 0.5 * side_m,
            })  # fmt: skip


if __name__ == "__main__":
    chosen = sys.argv[2] if len(sys.argv) > 2 else "hertz"
    made = made_map(chosen, int(sys.argv[3]) if len(sys.argv) > 3 else 16, 1)
    write_map(Path(sys.argv[1]), made)
    facts = made[0][0]
    sys.stdout.write(
        f"radius_nm {1e9 * facts.radius_m:.6g} half_angle_deg {math.degrees(facts.half_angle_rad):.6g}"
        f" poisson {facts.poisson:.6g}\n"
    )
