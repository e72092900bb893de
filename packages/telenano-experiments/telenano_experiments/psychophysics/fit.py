"""Fit of a psychometric function by maximum likelihood, with the interval of the threshold by its profile likelihood.

The likelihood is tabulated over threshold, width and lapse rate, on a grid that closes in on what the answers allow, so
that no search can end beside the maximum. The interval is where the logarithm of the likelihood, greatest over width
and lapse rate, is no further below its maximum than half the quantile of chi² with one degree of freedom (D. J. Venzon
and S. H. Moolgavkar, Appl. Stat. 37 (1988) 87). How the levels were chosen does not matter to a likelihood, so constant
stimuli and staircases have the same fit.

QUEST+ has a prior, and the interval by its posterior (`posterior`). The few levels that it presents leave the width
open: by the likelihood alone, 95 % intervals had the threshold in 92 % of a thousand simulated observers.
"""

import math
from collections.abc import Iterable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from telenano_experiments.psychophysics.exact import Numbers, log
from telenano_experiments.psychophysics.function import Psychometric

Answer = tuple[float, bool]
METHOD = "maximum likelihood, interval by profile likelihood"
POSTERIOR = "median of the posterior, credible interval"

# points of the grid: thresholds, widths, lapse rates
_GRID = 41, 21, 5
_ROUNDS = 4
# widths from this share of the range of levels to this many times it
_NARROWEST, _WIDEST = 0.02, 5.0
# An end at which the posterior is still so large a share of its maximum is one of the prior and not of the answers.
_CUT_OFF = 0.05
# The grid closes in on what is no further below the maximum, in units of the logarithm of the likelihood.
_KEPT = 5.0
_LEAST = 1e-300


class Estimate(NamedTuple):
    """A threshold with its interval, and the function that the answers were fitted by.

    Args:
        threshold: The level at which F is 1/2, or that of the share asked for; None where nothing can be said.
        low: The lower end of the interval; None where the answers do not bound it.
        high: The upper end of the interval; None where the answers do not bound it.
        confidence: The confidence of the interval.
        width: The width of the function on its axis; None where nothing can be said.
        lapse: The lapse rate; None where nothing can be said.
        proportion: The share of correct answers at the threshold.
        trials: How many answers there were.
        method: How the interval was found.
    """

    threshold: float | None
    low: float | None
    high: float | None
    confidence: float
    width: float | None
    lapse: float | None
    proportion: float
    trials: int
    method: str = METHOD


def fit(
    answers: Iterable[Answer], model: Psychometric, proportion: float | None = None, confidence: float = 0.95
) -> Estimate:
    """Fit a psychometric function to answers.

    Args:
        answers: The level of each trial, and whether its answer was correct (or yes).
        model: The family of functions.
        proportion: The share of correct answers that defines the threshold; None for F = 1/2.
        confidence: The confidence of the interval.

    Returns:
        The estimate; its ends are None where the answers do not bound the threshold within three times their range.

    Raises:
        ValueError: The function never has that proportion.
    """
    given = list(answers)
    middle = 0.5 * (1.0 + model.guess) if proportion is None else proportion
    if proportion is not None:
        model.distance_of(proportion, 0.0)
    counts = _counted(given)
    if len(counts) < 2 or len({correct for _, correct in given}) < 2:
        # one level, or one answer to all: every threshold to one side is as likely as any other
        return Estimate(None, None, None, confidence, None, None, middle, len(given))
    grid = _Grid(model, counts, proportion)
    thresholds, widths = grid.whole()
    for _ in range(_ROUNDS):
        logarithms = grid.likelihood(thresholds, widths)
        best = tuple(int(part) for part in np.unravel_index(int(np.argmax(logarithms)), logarithms.shape))
        profile = logarithms.max(axis=(1, 2))
        found = thresholds, profile, widths[best[1]], grid.lapses[best[2]]
        thresholds = _closer(thresholds, profile)
        widths = _closer(widths, logarithms.max(axis=(0, 2)), ratio=True)
    return _estimate(model, found, confidence, middle, len(given))


def posterior(
    answers: Iterable[Answer],
    model: Psychometric,
    thresholds: tuple[float, float],
    widths: Numbers,
    lapses: Numbers,
    proportion: float | None = None,
    confidence: float = 0.95,
) -> Estimate:
    """Return the median of the posterior of the threshold with its credible interval.

    Args:
        answers: The level of each trial, and whether its answer was correct (or yes).
        model: The family of functions.
        thresholds: The ends, on the axis, between which every threshold is as likely beforehand.
        widths: Widths that are as likely beforehand.
        lapses: Lapse rates that are as likely beforehand.
        proportion: The share of correct answers that defines the threshold; None for F = 1/2.
        confidence: The confidence of the interval.

    Returns:
        The estimate; an end is None where the range of thresholds, and not the answers, bounds the posterior.
    """
    given = list(answers)
    middle = 0.5 * (1.0 + model.guess) if proportion is None else proportion
    if not given:
        return Estimate(None, None, None, confidence, None, None, middle, 0, POSTERIOR)
    grid = _Grid(model, _counted(given), proportion, lapses)
    places = np.linspace(*thresholds, 2 * _GRID[0])
    for _ in range(2):
        logarithms = grid.likelihood(places, widths)
        density = np.exp(logarithms - logarithms.max())
        found, share = places, density.sum(axis=(1, 2))
        places = _closer(places, np.log(np.maximum(share, _LEAST)), kept=2.0 * _KEPT)
    # the distribution function by trapezoids, at the points of the grid
    steps = np.concatenate(([0.0], np.cumsum(0.5 * (share[1:] + share[:-1]))))
    tail = 0.5 - 0.5 * confidence
    parts = [float(np.interp(part * steps[-1], steps, found)) for part in (0.5, tail, 1.0 - tail)]
    level, low, high = (float(level) for level in model.from_axis(parts))
    width = float((density.sum(axis=(0, 2)) * widths).sum() / density.sum())
    lapse = float((density.sum(axis=(0, 1)) * grid.lapses).sum() / density.sum())
    is_bounded = [part < _CUT_OFF * float(share.max()) for part in (share[0], share[-1])]
    least, greatest = low if is_bounded[0] else None, high if is_bounded[1] else None
    return Estimate(level, least, greatest, confidence, width, lapse, middle, len(given), POSTERIOR)


class _Grid:
    """The answers, and the likelihood of them over threshold, width and lapse rate."""

    def __init__(
        self,
        model: Psychometric,
        counts: Sequence[tuple[float, int, int]],
        proportion: float | None,
        lapses: Numbers | None = None,
    ) -> None:
        self._model, self._proportion = model, proportion
        self.places = model.on_axis([level for level, _, _ in counts])
        self._right = np.asarray([right for _, right, _ in counts], dtype=float)
        self._wrong = np.asarray([wrong for _, _, wrong in counts], dtype=float)
        free = np.linspace(0.0, model.most_lapses, _GRID[2] if model.most_lapses > 0.0 else 1)
        self.lapses = free if lapses is None else lapses
        if proportion is not None:
            self.lapses = self.lapses[self.lapses < 1.0 - proportion]

    def whole(self) -> tuple[Numbers, Numbers]:
        """Return thresholds and widths that reach beyond all that the answers could tell."""
        low, high = float(self.places.min()), float(self.places.max())
        span = high - low
        thresholds = np.linspace(low - span, high + span, _GRID[0])
        return thresholds, np.geomspace(_NARROWEST * span, _WIDEST * span, _GRID[1])

    def likelihood(self, thresholds: Numbers, widths: Numbers) -> Numbers:
        """Return its logarithm, of shape (thresholds, widths, lapse rates)."""
        width, lapse = widths[None, :, None], self.lapses[None, None, :]
        middle = thresholds[:, None, None]
        if self._proportion is not None:
            shifts = [self._model.distance_of(self._proportion, float(rate)) for rate in self.lapses]
            middle = middle - width * np.asarray(shifts)[None, None, :]
        result = np.zeros((len(thresholds), len(widths), len(self.lapses)))
        for place, right, wrong in zip(self.places, self._right, self._wrong, strict=True):
            share = self._model.share(place, middle, width, lapse)
            result = result + right * log(share) + wrong * log(1.0 - share)
        return result


def _counted(answers: Sequence[Answer]) -> list[tuple[float, int, int]]:
    """Return each level with its numbers of right and wrong answers, in ascending order."""
    counts: dict[float, list[int]] = {}
    for level, correct in answers:
        counts.setdefault(float(level), [0, 0])[0 if correct else 1] += 1
    return [(level, *counts[level]) for level in sorted(counts)]  # type: ignore[misc]


def _closer(points: Numbers, profile: Numbers, *, ratio: bool = False, kept: float = _KEPT) -> Numbers:
    """Return a grid over the points that are likely enough, and a point more to either side."""
    likely = np.flatnonzero(profile >= profile.max() - kept)
    first, last = max(int(likely[0]) - 1, 0), min(int(likely[-1]) + 1, len(points) - 1)
    space = np.geomspace if ratio else np.linspace
    return space(points[first], points[last], len(points))


def _estimate(
    model: Psychometric,
    found: tuple[Numbers, Numbers, float, float],
    confidence: float,
    proportion: float,
    trials: int,
) -> Estimate:
    thresholds, profile, width, lapse = found
    best = int(np.argmax(profile))
    # chi² with one degree of freedom is the square of a standard normal number
    drop = 0.5 * NormalDist().inv_cdf(0.5 + 0.5 * confidence) ** 2
    low = _crossing(thresholds[best::-1], profile[best::-1], profile[best] - drop)
    high = _crossing(thresholds[best:], profile[best:], profile[best] - drop)
    level, least, greatest = (
        None if place is None else float(model.from_axis([place])[0])
        for place in (_peak(thresholds, profile), low, high)
    )
    return Estimate(level, least, greatest, confidence, float(width), float(lapse), proportion, trials)


def _peak(points: Numbers, profile: Numbers) -> float:
    """Return where the parabola through the greatest value and its neighbours has its peak."""
    best = int(np.argmax(profile))
    if not 0 < best < len(points) - 1:
        return float(points[best])
    left, top, right = profile[best - 1 : best + 2]
    bend = left - 2.0 * top + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(points[best] + shift * (points[best + 1] - points[best]))


def _crossing(points: Numbers, profile: Numbers, least: float) -> float | None:
    """Return where a profile that begins at its maximum falls below a value for good; None if it does not."""
    above = int(np.flatnonzero(profile >= least)[-1])
    if above == len(profile) - 1:
        return None
    # the square root of the drop is nearly straight where the drop is nearly a parabola
    inner, outer, wanted = (
        math.sqrt(max(profile[0] - value, 0.0)) for value in (profile[above], profile[above + 1], least)
    )
    part = (wanted - inner) / (outer - inner)
    return float(points[above] + part * (points[above + 1] - points[above]))
