"""Mean, deviation and interval of numbers and of shares."""

import numpy as np
import pytest

from analysis.intervals import with_error
from analysis.statistics import CONFIDENCE, share, statistic


def test_the_statistic_of_numbers_is_that_of_student() -> None:
    found = statistic([1.0, 2.0, 3.0, 4.0])
    # t of three degrees of freedom at 97.5 %: 3.182446
    half = 3.182446305 * found.deviation / 2.0 if found.deviation else 0.0
    assert (found.n, found.mean) == (4, 2.5)
    assert found.deviation == pytest.approx((5.0 / 3.0) ** 0.5, rel=1e-12)
    assert (found.low, found.high) == pytest.approx((2.5 - half, 2.5 + half), rel=1e-8)
    assert statistic([7.0]) == (1, 7.0, None, None, None)


def test_the_interval_covers_the_mean_in_95_of_100_draws() -> None:
    random = np.random.default_rng(1)
    draws = random.normal(3.0, 2.0, (2000, 6))
    inside = [found.low <= 3.0 <= found.high for found in map(statistic, draws.tolist()) if found.low is not None]
    assert 0.935 <= sum(inside) / 2000 <= 0.965
    assert CONFIDENCE == 0.95


def test_a_share_has_an_interval_within_0_and_1() -> None:
    # Wilson, of 8 of 10: 0.4901625, 0.9433178
    assert share(8, 10)[1::2] == (0.8, pytest.approx(0.4901625, rel=1e-6))
    assert share(8, 10).high == pytest.approx(0.9433178, rel=1e-6)
    assert share(10, 10).high == 1.0
    assert 0.69 < (share(10, 10).low or 0.0) < 0.73


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
