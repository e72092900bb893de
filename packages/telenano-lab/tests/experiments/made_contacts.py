"""Sessions whose truth is known: lines, and contacts at an instrument with noise, drift, creep and hysteresis."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

RATE_HZ = 20.0
Series = npt.NDArray[np.float64]


class MadeLine(NamedTuple):
    """A line: mean age and unevenness over ten minutes [ms], and the ages of its first seconds [s]."""

    round_trip_ms: float
    unevenness_ms: float
    ages_s: Series


class MadeContact(NamedTuple):
    """A contact: stiffness [N/m], drift [pm/s], and samples: time [s], base [m], force [N]."""

    stiffness_n_per_m: float
    drift_pm_per_s: float
    samples: Series


def made_line(seed: int, length_s: float = 12.0) -> MadeLine:
    """Draw a line: constant, with independent delays, or with a memory of 0.1 to 2 s; a rig adds up to 4 ms."""
    rng = np.random.default_rng(seed)
    count = round(600 * RATE_HZ)
    least_ms, spread_ms = (
        float(np.exp(rng.uniform(0.0, math.log(300.0)))),
        float(np.exp(rng.uniform(-1.0, math.log(60.0)))),
    )
    kind = rng.choice(("constant", "independent", "memory"))
    normal = rng.standard_normal(count)
    if kind == "memory":
        keep = math.exp(-1.0 / (RATE_HZ * rng.uniform(0.1, 2.0)))
        for place in range(1, count):
            normal[place] = keep * normal[place - 1] + math.sqrt(1.0 - keep * keep) * normal[place]
    extra = np.zeros(count) if kind == "constant" else spread_ms * np.exp(0.7 * normal)
    ages_ms = least_ms + extra
    own_ms = np.round(rng.uniform(0.0, 4.0) + rng.uniform(0.0, 1.0, count))
    uneven_ms = float(np.quantile(ages_ms, 0.95) - np.median(ages_ms))
    seen = np.round(ages_ms + own_ms)[: round(length_s * RATE_HZ)]
    return MadeLine(float(ages_ms.mean()), uneven_ms, 1e-3 * seen)


def made_contact(seed: int, stiffness: float, drift_pm_per_s: float, length_s: float = 40.0) -> MadeContact:
    """Draw a contact that is pressed with 100 nN and held, by a hand that trembles, swings or stands, or by its base.

    The instrument has white and 1/f noise, an open-loop piezo's creep of up to 2 % of a step in a decade, and
    hysteresis of up to 5 % of its motion.
    """
    rng = np.random.default_rng(seed)
    count, step_s = round(length_s * RATE_HZ), 1.0 / RATE_HZ
    times = np.arange(count) * step_s
    swings = rng.random() < 0.5
    begins_s = rng.uniform(3.0, 10.0)
    wanted = 100.0 * np.minimum(times / rng.uniform(0.5, 2.0), 1.0) + rng.uniform(0.0, 4.0) * _flicker(rng, count)
    if swings:
        wanted += np.where(times > begins_s, 30.0 * np.sin(math.pi * (times - begins_s)), 0.0)
    noise = 40.0 * (
        rng.uniform(0.002, 0.02) * rng.standard_normal(count) + rng.uniform(0.0, 0.02) * _flicker(rng, count)
    )
    creep, hysteresis = rng.uniform(0.0, 0.02), rng.uniform(0.0, 0.05)
    base_is_held_s = rng.uniform(8.0, 20.0) if rng.random() < 0.3 else math.inf
    drift = 1e-3 * drift_pm_per_s * rng.choice((-1.0, 1.0))
    base, force, steps, play = np.zeros(count), np.zeros(count), np.zeros(count), 0.0
    for now in range(1, count):
        follows = times[now] < base_is_held_s
        error = wanted[now] - force[now - 1]
        steps[now] = 0.5 * error / stiffness if follows else 0.0
        base[now] = base[now - 1] + steps[now]
        crept = creep * float(steps[:now] @ np.log10(1.0 + (times[now] - times[:now]) / 0.1))
        # a play of a nanometre either way of what the motion has of it
        play = min(max(play, base[now] - 1.0), base[now] + 1.0)
        moved = base[now] - hysteresis * (base[now] - play) + crept
        force[now] = stiffness * (moved - drift * times[now]) + noise[now]
    return MadeContact(stiffness, drift_pm_per_s, np.stack([times, 1e-9 * base, 1e-9 * force]))


def samples_of(contact: MadeContact) -> Iterator[tuple[float, float, float]]:
    """Yield time [s], base [m] and force [N] of each sample."""
    yield from zip(*(row.tolist() for row in contact.samples), strict=True)


def _flicker(rng: np.random.Generator, count: int) -> Series:
    """Draw noise with a spectrum of 1/f, of variance 1."""
    spectrum = np.fft.rfft(rng.standard_normal(count))
    spectrum[1:] /= np.sqrt(np.arange(1, spectrum.size))
    spectrum[0] = 0.0
    found = np.fft.irfft(spectrum, count)
    return np.asarray(found / found.std(), dtype=np.float64)
