"""How the verdicts on holds depend on their thresholds: each is halved and doubled, over made holds of known kinds.

    python tests/unit/analysis/verdict_thresholds.py

A row a threshold of `analysis.verdict`: how many of the made holds get another verdict, and which becomes which. The
holds are swings of many sizes, rates of growth and frequencies, drifts, wrong forces, and blows before a rest, in 8 s
of a hand of 1 N, each without noise of the read-out and with 0.01, 0.06 and 0.12 N of it.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from itertools import product

import numpy as np

from analysis import verdict
from analysis.verdict import Circumstances, Series, judge, struck

TIME_S = np.arange(8000) * 1e-3
NOISES_N = (0.0, 0.01, 0.06, 0.12)
THRESHOLDS = (
    "SMALL_SHARE",
    "FORCE_ERROR_SHARE",
    "MOST_NOISE_SHARE",
    "STRUCK_FORCES",
    "_SUSTAINED_CHANGE",
    "_NOISY_CHANGE",
    "_SURE_ERRORS",
    "_CLEAR_TREND",
    "_LATE_ONSET",
    "_DRIFT_CYCLES",
)


class Made:
    """A made hold: its force [N], the greatest before it [N], and what else is known of it."""

    def __init__(self, force_n: Series, peak_n: float = 1.0, known: Circumstances | None = None) -> None:
        self.force_n, self.peak_n, self.known = force_n, peak_n, known or Circumstances()

    def kind(self) -> str:
        """Return its verdict with the thresholds as they are now."""
        return struck(judge(TIME_S, self.force_n, 1.0, self.known), self.peak_n, 1.0).kind


def made_holds() -> Iterator[Made]:
    """Return the holds, in one order and the same each time."""
    rng = np.random.default_rng(8)
    end_s = TIME_S[-1]
    for sigma_n in NOISES_N:
        noise = sigma_n * rng.standard_normal(len(TIME_S))
        pressed = Circumstances(touching=1.0, touching_at_end=1.0, expected_n=1.0)
        for size_n, growth, frequency_hz in product(
            (0.002, 0.02, 0.04, 0.2), (-0.5, -0.02, 0.0, 0.02, 0.2), (0.05, 5.0)
        ):
            swing = size_n * np.exp(growth * (TIME_S - end_s)) * np.sin(2.0 * np.pi * frequency_hz * TIME_S)
            for random in (False, True):
                yield Made(1.0 + swing + noise, known=pressed._replace(noisy=random))
        for slope in (0.002, 0.005, 0.01, 0.02, 0.05):
            yield Made(1.0 + slope * (TIME_S - end_s) + noise)
        for force_n in (0.03, 0.8, 0.88, 0.93, 0.97, 1.03, 1.07, 1.12, 1.3):
            yield Made(force_n + noise, known=pressed)
        for peak_n in (1.5, 1.9, 2.1, 2.5, 3.0, 4.5, 8.0):
            yield Made(1.0 + noise, peak_n, pressed)
        for late_n, times in product((0.04, 0.3), (3.0, 6.0)):
            size_n = np.where(TIME_S > 7.2, late_n, late_n / times)
            yield Made(1.0 + size_n * np.sin(10.0 * np.pi * TIME_S) + noise)


def changes() -> list[tuple[str, float, dict[float, Counter[tuple[str, str]]], int]]:
    """Return for each threshold its value, by factor what its half and double change, and the number of holds."""
    holds = list(made_holds())
    before = [hold.kind() for hold in holds]
    found = []
    for name in THRESHOLDS:
        value = getattr(verdict, name)
        by: dict[float, Counter[tuple[str, str]]] = {}
        for factor in (0.5, 2.0):
            setattr(verdict, name, factor * value)
            after = [hold.kind() for hold in holds]
            by[factor] = Counter((a, b) for a, b in zip(before, after, strict=True) if a != b)
        setattr(verdict, name, value)
        found.append((name, value, by, len(holds)))
    return found


def words(changed: Counter[tuple[str, str]]) -> str:
    """Return how many change, and the commonest change."""
    common = [f" ({count} {a} to {b})".replace("_", " ") for (a, b), count in changed.most_common(1)]
    return f"{changed.total()}{''.join(common)}"


def table() -> str:
    """Return the table in Markdown."""
    rows = changes()
    lines = [f"| threshold (of {rows[0][3]} made holds) | value | halved | doubled |", "|---|---|---|---|"]
    for name, value, by, _ in rows:
        lines.append(f"| `{name.strip('_').lower()}` | {value:g} | {words(by[0.5])} | {words(by[2.0])} |")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(table() + "\n")
