"""The broken line through the fastest exchanges: that of least squares, with digits of no linear algebra library."""

import numpy as np
import pytest

from recording.site_clock import _through


@pytest.mark.parametrize("knots", [2, 3, 7, 20])
def test_it_is_the_broken_line_of_least_squares(knots: int) -> None:
    dice = np.random.default_rng(knots)
    times = np.sort(dice.uniform(0.0, 1e12, 300))
    values = dice.normal(5e6, 1e4, 300) + 1e-8 * times
    places = np.unique(np.quantile(times, np.linspace(0.0, 1.0, knots)))
    shapes = np.stack([np.interp(times, places, one) for one in np.eye(len(places))], axis=1)
    expected = np.linalg.lstsq(shapes, values, rcond=None)[0]
    np.testing.assert_allclose(_through(times, values, places), expected, rtol=1e-12, atol=0.0)


def test_points_on_a_broken_line_give_it_back() -> None:
    places = np.array([0.0, 3.0, 10.0])
    times = np.linspace(0.0, 10.0, 41)
    values = np.interp(times, places, [1e6, -2e6, 5e6])
    np.testing.assert_allclose(_through(times, values, places), [1e6, -2e6, 5e6], rtol=1e-12, atol=0.0)
