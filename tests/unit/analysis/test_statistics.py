"""The interval of a mean of correlated samples, and figures with their errors."""

from typing import Any

import numpy as np
import pytest

from analysis.intervals import with_error
from analysis.statistics import correlated_half_width


def correlated(random: np.random.Generator, count: int, samples: int, lasts: float) -> Any:
    """Return rows of samples of mean 0 and deviation 1, whose correlation falls to 1/e within `lasts` samples."""
    kept = np.exp(-1.0 / lasts) if lasts else 0.0
    rows = random.normal(size=(count, samples))
    for place in range(1, samples):
        rows[:, place] = kept * rows[:, place - 1] + np.sqrt(1.0 - kept * kept) * rows[:, place]
    return rows


@pytest.mark.parametrize(("samples", "lasts"), [(8, 0), (75, 0), (75, 1), (300, 0), (300, 2), (300, 5), (1000, 16)])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_interval_of_correlated_samples_covers_their_mean(samples: int, lasts: float, seed: int) -> None:
    rows = correlated(np.random.default_rng(seed), 2000, samples, lasts)
    halves = np.array([correlated_half_width(row) for row in rows])
    assert (np.abs(rows.mean(axis=1)) <= halves).mean() >= 0.93
    # half as wide again as the interval that knows the correlation, at most
    assert np.median(halves) <= 1.5 * 1.96 * rows.mean(axis=1).std()


def test_samples_that_follow_too_few_or_never_differ() -> None:
    assert correlated_half_width(np.arange(7.0)) is None
    assert correlated_half_width(np.full(8, 3.0)) == 0.0


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (1.0500000014573272, None, "1.050"),
        (1.0500000014573272, [1.05, 1.050000002], "1.050"),
        (1.0495902808336222, [1.0483682, 1.0508123], "1.0496 ± 0.0012"),
        (1.1, [0.8, 1.4], "1.10 ± 0.30"),
        (31.4, [11.4, 51.4], "31 ± 20"),
    ],
)
def test_a_figure_is_told_to_the_digits_that_its_error_leaves(
    value: float, interval: list[float] | None, text: str
) -> None:
    assert with_error(value, interval) == text
