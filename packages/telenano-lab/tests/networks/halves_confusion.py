"""How often the halves of a line that does not change are said to differ, and a change of a line is found.

    python packages/telenano-lab/tests/networks/halves_confusion.py --seeds 0:400

The lines are drawn by a program that shares nothing with the link or the fit: independent delays of four
distributions, correlated and bursty ones, periodic ones, with stalls and losses in runs, a minute to an hour long. A
change is a step of the delay by one median absolute deviation in the middle of the log.
"""

import argparse
import math
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import signal
from telenano_lab.networks.line_halves import compared_halves
from telenano_lab.networks.line_log import LineLog, Segment
from telenano_lab.networks.line_sources import Column

from telenano.analysis import wilson


class Line(NamedTuple):
    """A drawn line: its kind, its log, and how many correlation times (integrated) a half of it has."""

    kind: str
    log: LineLog
    times: float


def independent(draw: np.random.Generator, count: int, period_s: float) -> tuple[Column, float]:
    shape = draw.integers(4)
    scale_s = 10.0 ** draw.uniform(-3.5, -2.0)
    spread = (
        draw.lognormal(0.0, draw.uniform(0.1, 1.0), count),
        draw.gamma(draw.uniform(0.7, 4.0), size=count),
        np.where(draw.random(count) < draw.uniform(0.02, 0.5), 4.0, 0.0) + draw.random(count),
        np.abs(draw.standard_t(3.0, count)),
    )[shape]
    return scale_s * spread, period_s


def correlated(draw: np.random.Generator, count: int, period_s: float) -> tuple[Column, float]:
    time_s = period_s * 10.0 ** draw.uniform(0.3, math.log10(count / 2 / 60))
    rho = math.exp(-period_s / time_s)
    fresh = math.sqrt(1.0 - rho * rho) * draw.standard_normal(count)
    fresh[0] /= math.sqrt(1.0 - rho * rho)
    scores = signal.lfilter([1.0], [1.0, -rho], fresh)
    return 10.0 ** draw.uniform(-3.5, -2.0) * np.exp(draw.uniform(0.1, 0.8) * scores), 2.0 * time_s


def bursty(draw: np.random.Generator, count: int, period_s: float) -> tuple[Column, float]:
    lengths = period_s * 10.0 ** draw.uniform(0.5, math.log10(count / 2 / 100), 2)
    busy = np.zeros(count, dtype=bool)
    at, state = 0, bool(draw.integers(2))
    while at < count:
        end = at + max(1, int(draw.exponential(lengths[int(state)]) / period_s))
        busy[at:end] = state
        at, state = end, not state
    delays, _ = independent(draw, count, period_s)
    return delays * np.where(busy, draw.uniform(1.5, 5.0), 1.0), 2.0 / (1.0 / lengths).sum() + period_s


def periodic(draw: np.random.Generator, count: int, period_s: float) -> tuple[Column, float]:
    turns = draw.integers(8, 200)
    phase = (turns * np.arange(count) / count + draw.random()) % 1.0
    shape = (phase, np.sin(2 * math.pi * phase) + 1.0, (phase < 0.1).astype(float))[draw.integers(3)]
    delays, _ = independent(draw, count, period_s)
    return delays + float(np.median(delays)) * draw.uniform(0.2, 3.0) * shape, period_s


KINDS: tuple[Callable[[np.random.Generator, int, float], tuple[Column, float]], ...] = (
    independent,
    correlated,
    bursty,
    periodic,
)


def drawn(seed: int, kind: int, *, is_changed: bool, longest_s: float = 3600.0) -> Line:
    """Draw a line of a kind."""
    draw = np.random.default_rng((seed, kind))
    seconds = 60.0 * (longest_s / 60.0) ** draw.random()
    period_s = max(10.0 ** draw.uniform(-2.3, -1.0), seconds / 100_000)
    count = int(seconds / period_s)
    usual_s, time_s = KINDS[kind](draw, count, period_s)
    delay_s = 0.005 + usual_s
    sent_s = period_s * np.arange(count)
    if draw.random() < 0.3:
        for at_s in np.cumsum(draw.exponential(seconds / draw.uniform(20.0, 200.0), 400)):
            stalled = (sent_s >= at_s) & (sent_s < at_s + draw.uniform(0.1, 0.5))
            delay_s[stalled] += sent_s[stalled][-1] - sent_s[stalled] if stalled.any() else 0.0
    if draw.random() < 0.5:
        leave = draw.uniform(0.2, 1.0)
        share = 10.0 ** draw.uniform(-4.0, -1.3)
        is_lost = False
        for n, chance in enumerate(draw.random(count).tolist()):
            is_lost = chance < (1.0 - leave if is_lost else leave * share / (1.0 - share))
            if is_lost:
                delay_s[n] = np.nan
    if is_changed:
        median_s = np.nanmedian(delay_s)
        delay_s[count // 2 :] += float(np.nanmedian(np.abs(delay_s - median_s)))
    return Line(KINDS[kind].__name__, LineLog((Segment(sent_s, delay_s),), round_trip=False), 0.5 * seconds / time_s)


def is_said_to_differ(line: Line) -> bool:
    return any(halves.differ for halves in compared_halves(line.log).values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:100", help="first and last seed, one line of each kind a seed")
    parser.add_argument("--longest", type=float, default=3600.0, help="length of the longest log [s]")
    given = parser.parse_args()
    first, last = (int(part) for part in given.seeds.split(":"))
    for number, kind in enumerate(KINDS):
        for is_changed in (False, True):
            lines = (drawn(seed, number, is_changed=is_changed, longest_s=given.longest) for seed in range(first, last))
            said: dict[str, list[bool]] = {}
            for line in lines:
                answer = is_said_to_differ(line)
                times = "30 to 100" if line.times < 100.0 else "100 to 1000" if line.times < 1000.0 else "more"
                said.setdefault(times, []).append(answer)
                said.setdefault("all", []).append(answer)
            for key, answers in sorted(said.items()):
                low, high = wilson(sum(answers), len(answers))
                state = "changed" if is_changed else "stationary"
                sys.stdout.write(
                    f"{kind.__name__:12} {state:10} {key:>12} correlation times a half: said to differ"
                    f" {sum(answers)} of {len(answers)} ({low:.1%} to {high:.1%})\n"
                )


if __name__ == "__main__":
    main()
