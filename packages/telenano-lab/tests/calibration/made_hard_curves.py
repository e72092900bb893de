"""Made curves on a hard sample, clean or with a defect, and how often `calibrate sensitivity` is right about them.

    python packages/telenano-lab/tests/calibration/made_hard_curves.py [COUNT] [--first SEED] [--kind NAME ...]

The base moves by a ramp, the lever of the drawn sensitivity follows it in contact, with or without adhesion, in both
signs of the way and of the voltage. A defect is put in with a size that is drawn. The reader sees a text file. For each
kind the table has: read, refused, wrong (more than 1 % and more than 3 of its own errors off) and the share within two
errors.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from telenano.testing import print_table

Array = np.ndarray


class Course(NamedTuple):
    """Ways of the base towards the sample [nm], the deflection that belongs to each [nm], and the truth [nm/V]."""

    way: Array
    deflection: Array
    nm_per_v: float
    noise_v: float = 0.0


class Lever(NamedTuple):
    """A lever and its curve: nm/V, where contact begins [nm], depth of contact [nm], adhesion [nm], noise [V]."""

    nm_per_v: float
    free: float
    deep: float
    adhesion: float
    snap: float
    noise_v: float
    rows: int


def lever_of(draw: np.random.Generator) -> Lever:
    nm_per_v = math.exp(draw.uniform(math.log(15.0), math.log(200.0)))
    deep = draw.uniform(30.0, 150.0)
    adhesion = draw.choice([0.0, draw.uniform(3.0, 60.0)])
    free = draw.uniform(80.0, 400.0) + 1.5 * adhesion
    snap = 0.2 * adhesion
    noise = deep / nm_per_v * math.exp(draw.uniform(math.log(5e-4), math.log(0.01)))
    return Lever(nm_per_v, free, deep, adhesion, snap, noise, int(draw.integers(300, 900)))


def there(lever: Lever) -> tuple[Array, Array]:
    """Return the way of an approach and its deflection: free, a snap, and the line of contact."""
    way = np.linspace(0.0, lever.free + lever.deep, lever.rows)
    return way, np.where(way > lever.free - lever.snap, way - lever.free, 0.0)


def back(lever: Lever) -> tuple[Array, Array]:
    """Return the same of a retraction, which lets go where the adhesion ends."""
    way = np.linspace(lever.free + lever.deep, 0.0, lever.rows)
    return way, np.where(way > lever.free - lever.adhesion, way - lever.free, 0.0)


def joined(lever: Lever, *parts: tuple[Array, Array]) -> Course:
    way, deflection = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Course(way, deflection, lever.nm_per_v, lever.noise_v)


def approach(draw: np.random.Generator) -> Course:
    """One way alone."""
    lever = lever_of(draw)
    return joined(lever, there(lever))


def both_ways(draw: np.random.Generator) -> Course:
    """Approach and retraction."""
    lever = lever_of(draw)
    return joined(lever, there(lever), back(lever))


def retract(draw: np.random.Generator) -> Course:
    """The retraction alone, with its adhesion."""
    lever = lever_of(draw)
    return joined(lever, back(lever))


def retract_first(draw: np.random.Generator) -> Course:
    """The retraction before the approach."""
    lever = lever_of(draw)
    return joined(lever, back(lever), there(lever))


def tilted(draw: np.random.Generator) -> Course:
    """A base line that is tilted, as by interference or a lever that bends by heat."""
    lever = lever_of(draw)
    course = joined(lever, there(lever), back(lever))
    # the slope of the base line is in the line of contact as well: a share of the sensitivity that no reader knows
    tilt = draw.uniform(-4e-3, 4e-3) * np.where(course.deflection == 0.0, course.way - lever.free, 0.0)
    return course._replace(deflection=course.deflection + tilt)


def hold(draw: np.random.Generator) -> Course:
    """The base is held at the turn while the read-out creeps, and the retraction begins where that ends."""
    lever = lever_of(draw)
    count = int(draw.uniform(0.1, 0.8) * lever.rows)
    creep = (
        draw.uniform(0.02, 0.4) * draw.choice([-1.0, 1.0]) * lever.deep * (1.0 - np.exp(-np.linspace(0.0, 3.0, count)))
    )
    held = (np.full(count, lever.free + lever.deep), lever.deep + creep)
    way, deflection = back(lever)
    contact = way > lever.free - lever.adhesion
    return joined(lever, there(lever), held, (way, deflection + np.where(contact, creep[-1], 0.0)))


def hold_at_the_end(draw: np.random.Generator) -> Course:
    """An approach alone that is held at its end while the read-out creeps."""
    lever = lever_of(draw)
    count = int(draw.uniform(0.2, 1.0) * lever.rows)
    creep = draw.uniform(0.02, 0.4) * draw.choice([-1.0, 1.0]) * lever.deep * np.linspace(0.0, 1.0, count) ** 0.5
    return joined(lever, there(lever), (np.full(count, lever.free + lever.deep), lever.deep + creep))


def pause(draw: np.random.Generator) -> Course:
    """A pause in free air before the approach, while the read-out drifts."""
    lever = lever_of(draw)
    count = int(draw.uniform(0.2, 0.8) * lever.rows)
    drift = draw.uniform(-0.3, 0.3) * lever.deep * np.linspace(1.0, 0.0, count)
    return joined(lever, (np.zeros(count), drift), there(lever), back(lever))


def second_curve(draw: np.random.Generator) -> Course:
    """Two curves in one file, the second one of another place, with another offset."""
    lever = lever_of(draw)
    way, deflection = there(lever._replace(free=lever.free + draw.uniform(-30.0, 30.0)))
    return joined(lever, there(lever), back(lever), (way, deflection + draw.uniform(-0.2, 0.2) * lever.deep))


def second_sensitivity(draw: np.random.Generator) -> Course:
    """Two curves in one file, the second one with the light moved: no one sensitivity belongs to both."""
    lever = lever_of(draw)
    way, deflection = there(lever)
    turned = deflection * draw.choice([draw.uniform(0.6, 0.93), draw.uniform(1.07, 1.6)])
    return joined(lever, there(lever), (way, turned))._replace(nm_per_v=math.nan)


def second_approach(draw: np.random.Generator) -> Course:
    """Trigger, a part of the way back, and another approach within contact, before the retraction."""
    lever = lever_of(draw)
    low, high = lever.free + lever.deep * draw.uniform(0.3, 0.7), lever.free + lever.deep
    ways = [np.linspace(high, low, lever.rows // 4), np.linspace(low, high, lever.rows // 4)]
    shift = draw.uniform(-0.1, 0.1) * lever.deep
    parts = [(way, way - lever.free + shift) for way in ways]
    return joined(lever, there(lever), *parts, back(lever))


def creep(draw: np.random.Generator) -> Course:
    """The piezo lags while it is in contact: the line of contact is bent, and the sensitivity is not known."""
    lever = lever_of(draw)
    way, deflection = there(lever)
    depth = np.clip(way - lever.free, 0.0, None)
    bent = deflection + draw.uniform(0.06, 0.3) * draw.choice([-1.0, 1.0]) * depth**2 / lever.deep
    return joined(lever, (way, bent))._replace(nm_per_v=math.nan)


def soft_sample(draw: np.random.Generator) -> Course:
    """A sample that gives way, as a sphere into an elastic half-space does."""
    lever = lever_of(draw)
    way = np.linspace(0.0, lever.free + lever.deep, lever.rows)
    depth = np.clip(way - lever.free, 0.0, None)
    # d = a (depth - d)^1.5, by steps of Newton
    a = draw.uniform(0.5, 4.0) / math.sqrt(lever.deep)
    d = 0.5 * depth
    for _ in range(60):
        rest = np.clip(depth - d, 1e-12, None)
        d = np.clip(d - (d - a * rest**1.5) / (1.0 + 1.5 * a * np.sqrt(rest)), 0.0, depth)
    return joined(lever, (way, d))._replace(nm_per_v=math.nan)


def slip(draw: np.random.Generator) -> Course:
    """The tip slips in contact: a step in the line, with the same slope on both sides."""
    lever = lever_of(draw)
    way, deflection = there(lever)
    place = lever.free + draw.uniform(0.45, 0.9) * lever.deep
    step = draw.uniform(0.03, 0.2) * lever.deep
    return joined(lever, (way, deflection - np.where(way > place, step, 0.0)))


def saturation(draw: np.random.Generator) -> Course:
    """The detector ends at a voltage while the base goes on."""
    lever = lever_of(draw)
    course = joined(lever, there(lever), back(lever))
    return course._replace(
        deflection=np.minimum(course.deflection, draw.uniform(0.45, 0.9) * lever.deep), noise_v=-lever.noise_v
    )


def soft_saturation(draw: np.random.Generator) -> Course:
    """The spot leaves the middle of the diode: the read-out is bent, and what belongs to its middle is not known."""
    lever = lever_of(draw)
    way, deflection = there(lever)
    end = lever.deep * draw.uniform(0.5, 0.9)
    return joined(lever, (way, end * np.tanh(deflection / end)))._replace(nm_per_v=math.nan)


def snap(draw: np.random.Generator) -> Course:
    """A large attraction: the lever snaps by a good part of what is pressed afterwards."""
    lever = lever_of(draw)
    lever = lever._replace(adhesion=1.2 * lever.deep, snap=draw.uniform(0.3, 0.9) * lever.deep)
    return joined(lever, there(lever), back(lever))


def modulation(draw: np.random.Generator) -> Course:
    """The base is modulated by a few nanometres over the whole way."""
    lever = lever_of(draw)
    way, _ = there(lever)
    way = way + draw.uniform(0.5, 4.0) * np.sin(2.0 * math.pi * draw.uniform(0.03, 0.2) * np.arange(lever.rows))
    return joined(lever, (way, np.where(way > lever.free, way - lever.free, 0.0)))


def measured_way(draw: np.random.Generator) -> Course:
    """A height that was measured by a sensor, with noise of its own."""
    lever = lever_of(draw)
    course = joined(lever, there(lever), back(lever))
    return course._replace(way=course.way + draw.uniform(0.05, 0.5) * draw.standard_normal(len(course.way)))


Kind = Callable[[np.random.Generator], Course]
KINDS: tuple[Kind, ...] = (
    approach, both_ways, retract, retract_first, tilted, hold, hold_at_the_end, pause, second_curve, second_sensitivity,
    second_approach, creep, soft_sample, slip, saturation, soft_saturation, snap, modulation, measured_way,
)  # fmt: skip
# kinds of which no sensitivity is known
UNKNOWN = (second_sensitivity, creep, soft_sample, soft_saturation)
WAYS = {"nm": 1.0, "um": 1e-3, "m": 1e-9, "Å": 10.0}


def written(kind: Kind, seed: int) -> tuple[str, float]:
    """Return the text of a curve and the sensitivity [nm/V], nan where none belongs to it."""
    draw = np.random.default_rng([KINDS.index(kind), seed])
    course = kind(draw)
    # The noise of the read-out is added to the volts; a detector at its end has none.
    clean = course.deflection / (course.nm_per_v if course.nm_per_v == course.nm_per_v else 50.0)
    noise_v = abs(course.noise_v) if course.nm_per_v == course.nm_per_v else 2e-3 * np.ptp(clean)
    volts = clean + noise_v * draw.standard_normal(len(clean))
    if course.noise_v < 0.0:
        volts = np.minimum(volts, clean.max())
    volts = draw.choice([-1.0, 1.0]) * volts + draw.uniform(-2.0, 2.0)
    unit = str(draw.choice(list(WAYS)))
    way = draw.choice([-1.0, 1.0]) * WAYS[unit] * (course.way + draw.uniform(-500.0, 500.0))
    head = draw.choice([f"z [{unit}]\tdeflection [V]", f"height ({unit})\tDefl (V)", f"Piezo / {unit}\tVertical / V"])
    rows = "".join(f"{a:.9e}\t{b:.9e}\n" for a, b in zip(way.tolist(), volts.tolist(), strict=True))
    return f"{head}\n{rows}", course.nm_per_v


def two_columns(way: str, first: str, second: str) -> str:
    """Return a clean curve of 50 nm/V with three columns: a way, a noisy course, and the deflection."""
    x = np.linspace(0.0, 400.0, 400)
    noise = np.random.default_rng(0).standard_normal((2, 400))
    other = 0.3 * np.sin(x / 40.0) + 0.1 * noise[0]
    deflection = np.maximum(x - 200.0, 0.0) / 50.0 + 0.005 * noise[1]
    rows = "".join(f"{a:.6f}\t{b:.6f}\t{c:.6f}\n" for a, b, c in zip(x, other, deflection, strict=True))
    return f"{way}\t{first}\t{second}\n{rows}"


class Outcome(NamedTuple):
    """Of one curve: error as a share and in its own errors; None where it was refused; whether it has a truth."""

    share: float | None
    errors: float | None
    known: bool
    reason: str = ""

    @property
    def is_wrong(self) -> bool:
        if self.share is None:
            return False
        return not self.known or (abs(self.share) > 0.01 and abs(self.errors or 0.0) > 3.0)


def outcome(kind: Kind, seed: int, folder: Path) -> Outcome:
    """Write a curve of a kind and return what the reader makes of it."""
    from telenano_lab.calibration.own_calibration import curve_of, sensitivity_of_curve

    from telenano.wire import ConfigError

    text, truth = written(kind, seed)
    path = folder / "curve.txt"
    path.write_text(text, encoding="utf-8")
    try:
        way_m, volts, *_ = curve_of(path)
        found = sensitivity_of_curve(way_m, volts)
    except ConfigError as error:
        return Outcome(None, None, truth == truth, str(error))
    off = 1e9 * found.m_per_v - truth
    error = 1e9 * found.standard_error_m_per_v
    return Outcome(off / truth, off / error, True) if truth == truth else Outcome(0.0, 0.0, False)


def main() -> None:
    """Print the table, and how many curves were read wrongly."""

    def read(found: list[Outcome]) -> list[Outcome]:
        return [one for one in found if one.errors is not None]

    def share_inside(found: list[Outcome]) -> str:
        known = [one for one in read(found) if one.known]
        return f"{sum(abs(one.errors or 0.0) < 2.0 for one in known) / len(known):.1%}" if known else "-"

    made = print_table(
        __doc__,
        KINDS,
        outcome,
        {
            "read": lambda found: len(read(found)),
            "refused": lambda found: len(found) - len(read(found)),
            "wrong": lambda found: sum(one.is_wrong for one in found),
            "within two errors": share_inside,
        },
        reason=lambda one: one.reason,
        fault=lambda one: f"{one.share:+.1%}, {one.errors:+.1f} errors" if one.is_wrong else "",
        note=lambda kind: " (not determined)" if kind in UNKNOWN else "",
    )
    found = [one for ones in made.values() for one in ones]
    sys.stdout.write(f"{sum(one.is_wrong for one in found)} of {len(found)} wrong\n")


if __name__ == "__main__":
    main()
