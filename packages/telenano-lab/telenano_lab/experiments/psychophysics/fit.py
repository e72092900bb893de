"""The posterior of a threshold over a grid: its median, and its credible interval.

The likelihood is tabulated over threshold, width and lapse rate, on a grid that is refined around the likely values,
and summed over width and lapse rate. A likelihood does not depend on how the levels were chosen, so constant stimuli,
staircases and QUEST+ share this fit. QUEST+ uses the prior of its settings. For the others, the prior is uniform over
thresholds up to the range of levels beyond either end, over ratios of widths from a fifth to four times that range, and
over lapse rates.

Intervals by profile likelihood contained the threshold of short staircases in 84 to 87 % of cases instead of 95 %: few
answers allow a narrow width, and with it a seemingly certain threshold. The prior excludes such widths.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from telenano_lab.experiments.psychophysics.exact import Numbers, exp, log, total
from telenano_lab.experiments.psychophysics.function import Psychometric

Answer = tuple[float, bool]
METHOD = "median of the posterior, credible interval"

# Points of the grid: thresholds, widths, lapse rates.
_GRID = 81, 13, 4
# Least width of the grid, as a share of the range of levels.
_NARROWEST = 0.2
# Greatest width of the grid, as a multiple of the range of levels.
_WIDEST = 4.0
# An end where the posterior exceeds this share of its maximum is a bound of the prior, not of the answers.
_CUT_OFF = 0.05
# The grid is refined to values whose log posterior is at most this much below the maximum.
_KEPT = 10.0
_LEAST = 1e-300
# A track is remarked on if half its interval exceeds this share of its threshold.
_LITTLE_SHARE = 0.5
# Score from which an observer is said to learn; without learning 1 of 100 tracks reaches it.
_LEARNS = 2.33
# Intervals of fewer answers were not tested with simulated observers.
LEAST_TRIALS = 12


class Estimate(NamedTuple):
    """A threshold with its interval, and the posterior mean of the function's width and lapse rate.

    Args:
        threshold: The level at which F is 1/2, or that of the given proportion: the median of its posterior, None if it
            cannot be estimated.
        low: The lower end of the interval; None if the answers do not bound it.
        high: The upper end of the interval; None if the answers do not bound it.
        confidence: The confidence of the interval.
        width: The width of the function on its axis; None if it cannot be estimated.
        lapse: The lapse rate; None if it cannot be estimated.
        proportion: The share of correct answers at the threshold.
        trials: The number of answers.
        method: The method of the interval.
        note: Reasons why interval or threshold are unreliable or uninformative; empty if there are none.
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
    note: str = ""


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
    answer_list = list(answers)
    middle = 0.5 * (1.0 + model.guess) if proportion is None else proportion
    if proportion is not None:
        model.distance_of(proportion, 0.0)
    if len({level for level, _ in answer_list}) < 2 or len({correct for _, correct in answer_list}) < 2:
        # With one level, or the same answer to all, every threshold to one side is equally likely.
        return Estimate(None, None, None, confidence, None, None, middle, len(answer_list))
    places = model.on_axis([level for level, _ in answer_list])
    low, high = float(places.min()), float(places.max())
    span = high - low
    ends = log(np.array([_NARROWEST * span, _WIDEST * span]))
    widths = exp(np.linspace(ends[0], ends[1], _GRID[1]))
    lapses = np.linspace(0.0, model.most_lapses, _GRID[2] if model.most_lapses > 0.0 else 1)
    return posterior(answer_list, model, (low - span, high + span), widths, lapses, proportion, confidence)


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
        thresholds: The ends, on the axis, of the uniform prior of the threshold.
        widths: The widths, equally likely a priori.
        lapses: The lapse rates, equally likely a priori.
        proportion: The share of correct answers that defines the threshold; None for F = 1/2.
        confidence: The confidence of the interval.

    Returns:
        The estimate; an end is None if the range of thresholds, and not the answers, bounds the posterior.
    """
    answer_list = list(answers)
    middle = 0.5 * (1.0 + model.guess) if proportion is None else proportion
    if not answer_list:
        return Estimate(None, None, None, confidence, None, None, middle, 0)
    grid = _Grid(model, _counted(answer_list), proportion, lapses)
    places = np.linspace(*thresholds, _GRID[0])
    for _ in range(2):
        logarithms = grid.likelihood(places, widths)
        density = exp(logarithms - logarithms.max())
        density_places, share = places, total(total(density))
        places = _closer(places, log(np.maximum(share, _LEAST)))
    # The distribution function by trapezoids, at the points of the grid.
    steps = np.concatenate(([0.0], np.cumsum(0.5 * (share[1:] + share[:-1]))))
    tail = 0.5 - 0.5 * confidence
    parts = [float(np.interp(part * steps[-1], steps, density_places)) for part in (0.5, tail, 1.0 - tail)]
    level, low, high = (float(level) for level in model.from_axis(parts))
    whole = total(share)
    width = float(total(total(total(density) * widths)) / whole)
    lapse = float(total(total(total(density * grid.lapses))) / whole)
    is_bounded = [part < _CUT_OFF * float(share.max()) for part in (share[0], share[-1])]
    least, greatest = low if is_bounded[0] else None, high if is_bounded[1] else None
    centre = parts[0] - (0.0 if proportion is None else width * model.distance_of(proportion, lapse))
    notes = [
        _short(len(answer_list)),
        _little(level, least, greatest),
        _learning(answer_list, model, (centre, width, lapse)),
    ]
    note = "; ".join(filter(None, notes))
    return Estimate(level, least, greatest, confidence, width, lapse, middle, len(answer_list), note=note)


def _short(trials: int) -> str:
    if trials >= LEAST_TRIALS:
        return ""
    return f"an interval of {trials} trials is not to be relied on; it was tried with {LEAST_TRIALS} and more"


def _little(level: float, low: float | None, high: float | None) -> str:
    """Return a note if the interval of a track is wide relative to its threshold, or open."""
    if low is None or high is None:
        return "this track bounds the threshold poorly: the answers leave an end open; run more trials"
    share = 0.5 * (high - low) / abs(level) if level else math.inf
    if share <= _LITTLE_SHARE:
        return ""
    return (
        f"this track bounds the threshold poorly: its interval is the threshold within {100.0 * share:.0f} %; "
        "more trials, or QUEST+, make it narrower"
    )


def _learning(answers: Sequence[Answer], model: Psychometric, function: tuple[float, float, float]) -> str:
    """Return a note if the answers improve along a track, by the score of a threshold that falls linearly.

    The part of the trend that threshold, width and lapse rate can explain is removed (J. Neyman's C(alpha) test). So,
    with many trials, the score of an observer who does not change is a standard normal number, however the levels are
    chosen, although a staircase follows a learning observer.
    """
    if len(answers) < LEAST_TRIALS:
        return ""
    places = model.on_axis([level for level, _ in answers])

    def shares(of: tuple[float, float, float]) -> Numbers:
        return np.clip(model.share(places, *map(np.asarray, of)), 1e-6, 1.0 - 1e-6)

    threshold, width, lapse = function
    step, fitted = 0.01 * width, shares(function)
    deviation = np.sqrt(fitted * (1.0 - fitted))
    right = (np.array([correct for _, correct in answers], dtype=float) - fitted) / deviation
    by_threshold = (shares((threshold - step, width, lapse)) - shares((threshold + step, width, lapse))) / deviation
    by_width = (shares((threshold, 1.01 * width, lapse)) - shares((threshold, 0.99 * width, lapse))) / deviation
    by_lapse = (shares((threshold, width, lapse + 0.01)) - fitted) / deviation
    trend = by_threshold * (np.arange(len(answers)) - 0.5 * (len(answers) - 1))
    taken: list[Numbers] = []
    for column in (by_threshold, by_width, by_lapse, trend):
        size, rest = float(total(column * column)), column
        for other in taken:
            rest = rest - float(total(rest * other)) * other
        left = float(total(rest * rest))
        if left <= 1e-9 * size or size == 0.0:
            # The column depends on the others; if it is the trend, nothing can be said.
            if column is trend:
                return ""
            continue
        taken.append(rest / math.sqrt(left))
    score = float(total(taken[-1] * right))
    if score < _LEARNS:
        return ""
    return (
        f"the answers get better along the track (score {score:.1f}): the observer learns, and the threshold is that of"
        " no moment; give practice before, or leave out the first trials"
    )


class _Grid:
    """The answers, and their likelihood over threshold, width and lapse rate."""

    def __init__(
        self,
        model: Psychometric,
        counts: Sequence[tuple[float, int, int]],
        proportion: float | None,
        lapses: Numbers,
    ) -> None:
        self._model, self._proportion = model, proportion
        self.places = model.on_axis([level for level, _, _ in counts])
        self._right = np.asarray([right for _, right, _ in counts], dtype=float)
        self._wrong = np.asarray([wrong for _, _, wrong in counts], dtype=float)
        self.lapses = lapses
        if proportion is not None:
            self.lapses = self.lapses[self.lapses < 1.0 - proportion]

    def likelihood(self, thresholds: Numbers, widths: Numbers) -> Numbers:
        """Return the logarithm of the likelihood, shape (thresholds, widths, lapse rates)."""
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


def _closer(points: Numbers, posterior: Numbers) -> Numbers:
    """Return a grid over the sufficiently likely points, extended by one point to either side."""
    likely = np.flatnonzero(posterior >= posterior.max() - _KEPT)
    first, last = max(int(likely[0]) - 1, 0), min(int(likely[-1]) + 1, len(points) - 1)
    return np.linspace(points[first], points[last], len(points))
