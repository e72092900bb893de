"""The posterior of a threshold over a grid: its median, and its credible interval.

The likelihood is tabulated over threshold, width and lapse rate, on a grid that closes in on what the answers allow,
and summed over width and lapse rate. How the levels were chosen does not matter to a likelihood, so constant stimuli,
staircases and QUEST+ have the same fit. QUEST+ has the prior of its settings. Of the others every threshold as far as
the range of levels beyond either end, every ratio of widths from a fifth to four times that range, and every lapse rate
is as likely beforehand.

Intervals by profile likelihood had the threshold of short staircases in 84 to 87 % in place of 95: few answers let the
width be narrow, and so the threshold certain. That width is what the prior takes away.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from telenano_lab.experiments.psychophysics.exact import Numbers, exp, log, total
from telenano_lab.experiments.psychophysics.function import Psychometric

Answer = tuple[float, bool]
METHOD = "median of the posterior, credible interval"

# points of the grid: thresholds, widths, lapse rates
_GRID = 81, 13, 4
# The grid has widths from this share of the range of levels on.
_NARROWEST = 0.2
# The grid has widths up to this multiple of the range of levels.
_WIDEST = 4.0
# An end at which the posterior is still so large a share of its maximum is one of the prior and not of the answers.
_CUT_OFF = 0.05
# The grid closes in on what is no further below the maximum, in units of the logarithm of the posterior.
_KEPT = 10.0
_LEAST = 1e-300
# A track tells little whose interval reaches further to either side than this share of its threshold.
_LITTLE_SHARE = 0.5
# An observer is said to learn from this score on, which one who does not learn has in 1 of 100 tracks.
_LEARNS = 2.33
# Intervals of fewer answers were not tried with simulated observers.
LEAST_TRIALS = 12


class Estimate(NamedTuple):
    """A threshold with its interval, and the mean of the function that the answers allow.

    Args:
        threshold: The level at which F is 1/2, or that of the share asked for: the median of its posterior, None where
            nothing can be said.
        low: The lower end of the interval; None where the answers do not bound it.
        high: The upper end of the interval; None where the answers do not bound it.
        confidence: The confidence of the interval.
        width: The width of the function on its axis; None where nothing can be said.
        lapse: The lapse rate; None where nothing can be said.
        proportion: The share of correct answers at the threshold.
        trials: How many answers there were.
        method: How the interval was found.
        note: Why the interval or the threshold is not to be relied on, or tells little; else empty.
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
        # one level, or one answer to all: every threshold to one side is as likely as any other
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
        thresholds: The ends, on the axis, between which every threshold is as likely beforehand.
        widths: Widths that are as likely beforehand.
        lapses: Lapse rates that are as likely beforehand.
        proportion: The share of correct answers that defines the threshold; None for F = 1/2.
        confidence: The confidence of the interval.

    Returns:
        The estimate; an end is None where the range of thresholds, and not the answers, bounds the posterior.
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
    # the distribution function by trapezoids, at the points of the grid
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
    """Say that a track tells little, where its interval is wide beside its threshold, or open."""
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
    """Say that answers get better along a track, by the score of a threshold that falls evenly from trial to trial.

    What the fitted threshold, width and lapse rate can take up of such a trend is taken out of it (J. Neyman's C(alpha)
    test), so the score is a standard normal number for an observer who does not change, in many trials, however the
    levels are chosen and though a staircase follows the one who learns.
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
            # the column is not one of its own: of the trend that means that nothing can be said
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
    """The answers, and the likelihood of them over threshold, width and lapse rate."""

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


def _closer(points: Numbers, posterior: Numbers) -> Numbers:
    """Return a grid over the points that are likely enough, and a point more to either side."""
    likely = np.flatnonzero(posterior >= posterior.max() - _KEPT)
    first, last = max(int(likely[0]) - 1, 0), min(int(likely[-1]) + 1, len(points) - 1)
    return np.linspace(points[first], points[last], len(points))
