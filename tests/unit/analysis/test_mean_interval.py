"""The interval of a mean covers where there is one, and there is none where the record cannot say.

The records are made by `benchmarks/made_records.py`, which knows no estimator.
"""

import numpy as np
import pytest

from benchmarks.made_records import RECORDS, hand
from benchmarks.mean_intervals import covered
from telenano.analysis.intervals import student
from telenano.analysis.mean_interval import FEWEST_PARTS, mean_half_width


@pytest.mark.check("makes hundreds of records")
@pytest.mark.drawn(0.0, "telenano/analysis/")
@pytest.mark.parametrize("name", ["1/f", "1/f^1.5", "1/f^2", "hand, 2 Hz", "hand, 2 Hz, 2nd order"])
def test_a_hand_that_trembles_slowly_has_no_interval_within_a_third_of_a_second(name: str) -> None:
    known, _ = covered(name, 0.3, 200, 3)
    assert known <= 0.06 * 200


@pytest.mark.check("makes hundreds of records")
@pytest.mark.drawn(0.0, "telenano/analysis/")
@pytest.mark.parametrize("name", ["1/f", "1/f^2"])
def test_power_laws_have_no_interval_in_ten_seconds_either(name: str) -> None:
    known, _ = covered(name, 10.0, 100, 3)
    assert known <= 0.1 * 100


@pytest.mark.check("makes hundreds of records")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize(
    ("name", "window_s", "share"),
    [
        ("white", 0.3, 0.9),
        ("white", 3.0, 0.9),
        # the estimator cannot say of one record of nine
        ("hand, 2 Hz", 10.0, 0.8),
        ("hand, 2 Hz, 2nd order", 10.0, 0.9),
    ],
)
def test_what_settles_within_the_window_has_an_interval_that_covers(name: str, window_s: float, share: float) -> None:
    known, inside = covered(name, window_s, 300, 5)
    assert known >= share * 300
    # 95 % and three standard deviations of a share of 300
    assert 0.91 * known <= inside


@pytest.mark.check("makes a hundred records")
@pytest.mark.parametrize("window_s", [1.5, 4.0])
def test_a_wave_that_is_longer_than_the_window_makes_the_interval_wide(window_s: float) -> None:
    """A breath of four seconds in a window of one and a half is a trend, and its mean is not that of the window."""
    known, inside = covered("breathing, 0.25 Hz", window_s, 60, 5)
    assert known >= 0.8 * 60
    # it covers in 83 to 100 % of other windows
    assert inside >= 0.75 * known


@pytest.mark.check("takes 1 s")
def test_the_interval_of_white_noise_is_that_of_student_or_somewhat_wider() -> None:
    rows = RECORDS["white"](np.random.default_rng(2), 20, 300)
    halves = [half for row in rows if (half := mean_half_width(row)) is not None]
    assert len(halves) >= 18
    known = student(299) / np.sqrt(300.0)
    assert 0.9 * known < np.median(halves) < 1.4 * known


def test_a_mean_over_three_tenths_of_a_second_of_a_slow_hand_is_not_called_known() -> None:
    rows = hand()(np.random.default_rng(1), 10, 300)
    assert sum(mean_half_width(row) is None for row in rows) >= 9


def test_scale_and_place_of_the_samples_do_not_matter() -> None:
    row = RECORDS["white"](np.random.default_rng(4), 1, 300)[0]
    half = mean_half_width(row)
    assert half is not None
    assert mean_half_width(1.05 + 1e-3 * row) == pytest.approx(1e-3 * half, rel=1e-6)


def test_samples_that_are_too_few_or_never_differ() -> None:
    assert mean_half_width(np.arange(FEWEST_PARTS - 1.0)) is None
    assert mean_half_width(np.full(300, 3.0)) == 0.0


def test_samples_that_run_in_one_direction_have_no_interval() -> None:
    assert mean_half_width(np.linspace(1.0, 1.2, 300)) is None
