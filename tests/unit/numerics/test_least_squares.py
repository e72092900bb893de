"""Least squares by steps of its own, against those of LAPACK."""

import numpy as np
import pytest

from telenano.numerics import regression


@pytest.mark.parametrize("seed", range(20))
def test_factors_and_what_is_left_are_those_of_lapack(seed: int) -> None:
    draw = np.random.default_rng(seed)
    count = int(draw.integers(1, 6))
    columns = (
        draw.standard_normal((200, count)) @ draw.standard_normal((count, count)) * 10.0 ** draw.uniform(-9, 9, count)
    )
    values = columns @ (draw.standard_normal(count) / np.abs(columns).max(axis=0)) + draw.standard_normal(200)
    factors, left = regression(list(columns.T), values)
    expected, *_ = np.linalg.lstsq(columns / np.abs(columns).max(axis=0), values, rcond=None)
    np.testing.assert_allclose(np.array(factors) * np.abs(columns).max(axis=0), expected, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(left, values - columns @ np.array(factors), atol=1e-9)


def test_a_column_that_follows_from_others_says_nothing() -> None:
    one, two = np.arange(10.0), np.ones(10)
    factors, left = regression([one, two, 2.0 * one - two, np.zeros(10)], 3.0 * one + two)
    assert factors[2:] == [0.0, 0.0]
    np.testing.assert_allclose(factors[:2], [3.0, 1.0])
    np.testing.assert_allclose(left, 0.0, atol=1e-12)
