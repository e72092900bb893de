"""The parts of a verdict: sizes of a motion in tenths of a hold, their trend, and what is asked where it is open."""

import math

import numpy as np
import pytest

from telenano.analysis.decision import (
    Motion,
    by_parts,
    decide,
    fate_of,
    is_quiet,
    line_of,
    parts_of,
    trend,
)
from telenano.analysis.findings import Cause, Finding
from telenano.analysis.modes import Fit, Mode
from telenano.analysis.read_out import Noise
from telenano.analysis.verdict_thresholds import SMALL_SHARE, WAY_TRIPS

PERIOD_S = 1e-3
COUNT = 4000
SINCE = np.arange(COUNT) / COUNT
QUIET = Noise(0.0, ())


def motion(values: np.ndarray, noise: Noise = QUIET, **changes: object) -> Motion:
    return Motion(values, PERIOD_S, 7.0, 1.0, 0.0, noise, True, None, 0.0)._replace(**changes)


def swing(size: np.ndarray | float, turns: float = 40.0) -> np.ndarray:
    """Return a swing of a size from peak to peak about 1 N."""
    return np.asarray(1.0 + 0.5 * size * np.cos(2.0 * math.pi * turns * SINCE + 0.4))


def judged(size: np.ndarray | float, turns: float = 40.0) -> Finding:
    return decide(motion(swing(size, turns)))


@pytest.mark.parametrize("turns", [6.3, 13.0, 40.0, 300.0])
def test_the_sizes_of_a_swing_are_the_same_in_all_parts_however_it_turns(turns: float) -> None:
    parts = parts_of(motion(swing(0.4, turns)))
    assert parts.turns == pytest.approx(turns, rel=0.15)
    assert parts.sizes[1:-1] == pytest.approx([0.4] * (len(parts.sizes) - 2), rel=0.2)


def test_noise_that_was_measured_is_no_motion_and_hides_no_larger_swing() -> None:
    noise = 0.04 * np.random.default_rng(2).standard_normal(COUNT)
    known = Noise(0.04, ())
    assert max(parts_of(motion(1.0 + noise, known)).reaches) < 0.5 * SMALL_SHARE
    parts = parts_of(motion(swing(0.2) + noise, known))
    assert parts.sizes == pytest.approx([0.2] * len(parts.sizes), rel=0.3)


@pytest.mark.parametrize(("size", "kind"), [(0.9 * SMALL_SHARE, "stable"), (1.2 * SMALL_SHARE, "limit_cycle")])
def test_a_twentieth_of_the_hands_force_is_rest(size: float, kind: str) -> None:
    assert judged(size).kind == kind


def test_what_grows_and_is_small_rests_and_says_so() -> None:
    found = judged(0.03 * np.exp(2.0 * (SINCE - 1.0)))
    assert (found.kind, found.cause) == ("stable", Cause.GROWS_SMALL)
    assert found.growth_per_s == pytest.approx(0.5, rel=0.1)
    assert judged(0.3 * np.exp(2.0 * (SINCE - 1.0))).kind == "diverged"


@pytest.mark.parametrize("change", [-3.0, -0.5, 0.5, 3.0])
def test_the_trend_of_the_sizes_is_the_growth(change: float) -> None:
    found = judged(0.4 * np.exp(change * (SINCE - (change > 0.0))))
    assert found.kind == ("diverged" if change > 0.0 else "stable")
    assert found.growth_per_s == pytest.approx(change / (PERIOD_S * COUNT), rel=0.1)


def test_what_grows_and_then_stays_goes_on_and_so_does_what_falls_to_a_swing_that_stays() -> None:
    assert judged(0.4 / np.sqrt(1.0 + 99.0 * np.exp(-20.0 * SINCE))).kind == "limit_cycle"
    assert judged(0.3 + 2.0 * np.exp(-9.0 * SINCE)).kind == "limit_cycle"


def test_a_late_onset_grows_and_a_late_kick_does_not() -> None:
    assert judged(np.where(SINCE > 0.7, np.exp(20.0 * (SINCE - 1.0)), 0.0), 80.0).kind == "diverged"
    kick = np.where(SINCE > 0.8, 0.5 * np.exp(-20.0 * (SINCE - 0.8)), 0.0)
    assert judged(kick, 80.0).kind in ("stable", "cannot_say")


def test_a_motion_that_comes_again_and_again_does_not_rest_in_a_pause() -> None:
    bursts = np.where(SINCE * 8.0 % 1.0 < 0.3, 0.4, 0.0)
    found = judged(bursts, 160.0)
    assert found.kind == "limit_cycle"
    parts = parts_of(motion(swing(bursts, 160.0)))
    assert not is_quiet(parts, SMALL_SHARE, 3)
    # One that came twice and is away for longer than before does.
    assert judged(np.where((SINCE < 0.05) | (abs(SINCE - 0.3) < 0.05), 0.4, 0.0), 160.0).kind == "stable"


def test_an_irregular_motion_goes_on_with_its_size_and_its_band() -> None:
    dice = np.random.default_rng(5)
    changes = np.sort(dice.uniform(0.0, 1.0, 80))
    found = decide(motion(1.0 + 0.3 * (np.searchsorted(changes, SINCE) % 2)))
    assert (found.kind, found.cause) == ("limit_cycle", Cause.IRREGULAR)
    assert found.size_n == pytest.approx(0.3, rel=0.15)
    assert 0.0 < found.band_hz[0] < found.band_hz[1] < 500.0


def test_a_line_has_most_of_the_power() -> None:
    hz, _ = line_of(swing(0.3) + 0.02 * np.random.default_rng(1).standard_normal(COUNT), PERIOD_S)
    assert hz == pytest.approx(10.0, rel=0.01)
    assert line_of(np.random.default_rng(1).standard_normal(COUNT), PERIOD_S)[0] is None


def test_the_error_of_a_trend_is_that_of_its_scatter_and_grows_where_neighbours_are_alike() -> None:
    even = trend([math.exp(0.1 * k) for k in range(12)], 1e-9)
    assert even == pytest.approx((0.1, 0.0, 0.0), abs=1e-9)
    apart = trend([1.0, 1.5] * 6, 1e-9)
    alike = trend([1.0] * 3 + [1.5] * 3 + [1.0] * 3 + [1.5] * 3, 1e-9)
    assert alike[1] > 1.3 * apart[1]


def test_a_way_to_one_side_is_growth_only_after_four_round_trips() -> None:
    mode, left = Mode(0.0, 2.0, 0.01, 0.01, 0.5), np.zeros(100)
    fit = Fit([mode], 1.0, left, left)
    for trips, fate in ((1.01 * WAY_TRIPS, "grows"), (0.99 * WAY_TRIPS, "unsure")):
        own = motion(np.zeros(1000), trip_s=1.0 / trips)
        assert fate_of(mode, fit, own) == fate


@pytest.mark.parametrize(
    ("changes", "fate"),
    [
        ({"growth_per_s": 0.4}, "grows"),
        ({"growth_per_s": 0.4, "end_n": 0.9 * SMALL_SHARE}, "small"),
        ({"growth_per_s": -0.4}, "falls"),
        ({"growth_per_s": -0.4, "error_per_s": 0.2}, "unsure"),
        ({"growth_per_s": 0.0}, "lasts"),
        ({"growth_per_s": -0.14}, "unsure"),
        ({"growth_per_s": 0.4, "frequency_hz": 1.0}, "unsure"),
        ({"growth_per_s": 0.0, "frequency_hz": 0.2, "begin_n": 0.09, "end_n": 0.09}, "small"),
    ],
)
def test_a_mode_has_the_fate_of_its_change_and_its_error(changes: dict[str, float], fate: str) -> None:
    mode = Mode(5.0, 0.0, 0.01, 0.3, 0.3)._replace(**changes)
    left = np.zeros(100)
    assert fate_of(mode, Fit([mode], 1.0, left, left), motion(np.zeros(1000))) == fate


def test_what_a_trend_leaves_open_is_asked_of_the_modes() -> None:
    """Two lines that beat once in the hold have risen for the last half of it."""
    values = 1.0 + 0.1 * (np.cos(2.0 * math.pi * 20.0 * SINCE) + np.cos(2.0 * math.pi * 20.9 * SINCE))
    own = motion(values)
    assert by_parts(own, parts_of(own)).kind != "limit_cycle"
    assert decide(own).kind == "limit_cycle"


def test_a_force_on_its_way_is_stable_where_it_goes_to_the_rest_of_the_law() -> None:
    values = 1.0 - 0.5 * (1.0 - SINCE) ** 0.9
    assert decide(motion(values)).cause is Cause.ON_ITS_WAY
    assert decide(motion(values, rest_n=1.0)).cause is Cause.TO_THE_REST
    assert decide(motion(values, rest_n=0.0)).cause is Cause.ON_ITS_WAY
