"""Simulated observers by the hundred: how often the interval of a threshold has it, and how wide the interval is.

    python packages/telenano-lab/tests/experiments/made_observers.py [NAME ...]

prints the table of docs/experiments.md.
"""

import random
import statistics
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

from observer import Observer
from telenano_lab.experiments.psychophysics.function import Psychometric
from telenano_lab.experiments.psychophysics.methods import make

LINEAR = {"shape": "logistic", "axis": "linear", "guess": 0.5}
RATIOS = {"shape": "weibull", "axis": "log", "guess": 0.5}
STAIRCASE = {
    "method": "staircase", "start": 0.12, "steps": [0.03, 0.02, 0.01], "low": 0.0, "high": 0.2, "reversals": 12,
    "trials": 300,
}  # fmt: skip
METHODS: dict[str, dict[str, Any]] = {
    # A staircase of one down would rest at the guess of a 2AFC task, so it is for yes and no.
    "1 down": {**STAIRCASE, "downs": 1, "function": {**LINEAR, "guess": 0.0}},
    "2 down": {**STAIRCASE, "downs": 2, "function": LINEAR},
    "3 down": {**STAIRCASE, "downs": 3, "function": LINEAR},
    "2 down, ratios": {
        **STAIRCASE, "downs": 2, "start": 0.24, "steps": [2.0, 1.5, 1.2], "low": 0.005, "high": 0.5, "function": RATIOS,
    },
    "constant 7 x 5": {
        "method": "constant", "levels": [0.0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.12], "repetitions": 5, "function": LINEAR,
    },
    "QUEST+ 40": {
        "method": "quest_plus", "levels": {"low": 0.005, "high": 0.3, "count": 25},
        "thresholds": {"low": 0.01, "high": 0.25, "count": 25}, "widths": {"low": 0.5, "high": 4.0, "count": 7},
        "trials": 40, "function": RATIOS,
    },
}  # fmt: skip
# The answers truly follow the function that is fitted, another shape, or one with more lapses than the fit considers.
TRUTHS: dict[str, dict[str, Any]] = {"as fitted": {}, "normal": {"shape": "normal"}, "8 % lapses": {"lapse": 0.08}}


class Covered(NamedTuple):
    """How the intervals of observers are.

    Args:
        share: The share that has the threshold.
        width: The median width, a difference of levels, of those with two ends.
        closed: The share with two ends.
        trials: The mean number of trials.
        bias: The mean error of the threshold, as a share of it.
    """

    share: float
    width: float
    closed: float
    trials: float
    bias: float


def covered(settings: dict[str, Any], truth: dict[str, Any], observers: int, seed: int = 0) -> Covered:
    """Return how the intervals of a method are for observers whose thresholds are drawn between 0.04 and 0.08.

    Args:
        settings: The method.
        truth: The shape of the observers' function and their lapse rate; else as fitted, and up to 2 %.
        observers: How many.
        seed: Decides them.
    """
    fitted = Psychometric.model_validate(settings["function"])
    model = fitted.model_copy(update={"shape": truth.get("shape", fitted.shape)})
    held, widths, trials, errors = 0, [], 0, 0.0
    for number in range(seed, seed + observers):
        source = random.Random(number)
        threshold, lapse = 0.04 + 0.04 * source.random(), truth.get("lapse", 0.02 * source.random())
        observer = Observer(model, threshold, 0.08 if model.axis == "linear" else 1.5, lapse, 1000 + number)
        method = make(settings, number)
        while (level := method.next()) is not None:
            method.take(level, observer.answer(level))
        found = method.estimate()
        held += (found.low is None or found.low <= threshold) and (found.high is None or threshold <= found.high)
        if found.low is not None and found.high is not None:
            widths.append(found.high - found.low)
        trials += found.trials
        errors += ((found.threshold or 0.0) - threshold) / threshold
    share, closed = held / observers, len(widths) / observers
    return Covered(share, statistics.median(widths), closed, trials / observers, errors / observers)


def main(names: Sequence[str]) -> None:
    """Print the table."""
    for name in names or METHODS:
        for truth, changed in TRUTHS.items():
            found = covered(METHODS[name], changed, 500)
            sys.stdout.write(
                f"{name:15} {truth:10} {found.trials:5.1f} trials: {100.0 * found.share:5.1f} % have it, "
                f"median width {found.width:.3f}, {100.0 * found.closed:5.1f} % closed, bias {found.bias:+.3f}\n"
            )
            sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
