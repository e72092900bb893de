"""The parts of a verdict: how far a force goes in eight windows, which lines rise, and what is not known."""

import itertools
import math

import numpy as np
import pytest

from telenano.analysis.decision import approaching, beside, shown_beside
from telenano.analysis.envelope import by_envelope, falls_as_noise, has_line, sizes_of
from telenano.analysis.findings import Cause, Finding
from telenano.analysis.modes import Fit, Mode
from telenano.analysis.motion_fit import (
    Fate,
    Motion,
    Window,
    classify,
    decided_by_modes,
    rises,
    rises_where_seen,
    time_until,
    undecided,
)
from telenano.analysis.read_out import even, gone_of
from telenano.analysis.verdict import judge
from telenano.analysis.verdict_sentences import sentence

PERIOD_S = 1e-3
SMALL_N = 0.05
# each of the eight windows is a tenth of a second
WINDOW = 100
NOTHING_LEFT = np.zeros(300)


def windows(*sizes_n: float) -> np.ndarray:
    """Return a swing of five turns in each window that goes as far there as is given."""
    turns = np.sin(2.0 * np.pi * (np.arange(WINDOW) + 0.5) / 20.0)
    return np.concatenate([0.5 * size * turns / np.abs(turns).max() for size in sizes_n])


def motion(values: np.ndarray, small_n: float = SMALL_N) -> Motion:
    return Motion(values, PERIOD_S, 7.0, small_n / 0.05, 0.0, 0.0, None)


def by_windows(*sizes_n: float) -> Finding:
    return by_envelope(motion(windows(*sizes_n)))


def line(**changes: object) -> Mode:
    """Return a mode whose course in a window of one second has its frequency, growth and end, unless one is given."""
    mode = Mode(5.0, 0.4, 0.01, 0.1, 0.3, (0.1, 0.2, 0.3), NOTHING_LEFT)._replace(**changes)
    times = np.linspace(-1.0, 0.0, len(NOTHING_LEFT))
    course = 0.5 * mode.end_n * np.exp(mode.growth_per_s * times) * np.cos(2.0 * np.pi * mode.frequency_hz * times)
    return mode._replace(**{"course": course, **changes})


def fit(left_n: float = 0.0, noise_n: float = 0.0) -> Fit:
    left = left_n * (-1.0) ** np.arange(300)
    return Fit([], 1.0, left, left, noise_n, True)


def window(mode: Mode, left: np.ndarray = NOTHING_LEFT, length_s: float = 1.0, unrounded_n: float = SMALL_N) -> Window:
    """Return a window with one mode that ends at 7 s, over what its fit leaves, of a force that moves as far as it."""
    found = Fit([mode], 1.0, left, left, 0.0, True)
    return Window(length_s, 7.0, SMALL_N, 0.0, unrounded_n, windows(*[mode.end_n] * 8), found)


def by_modes(
    mode: Mode, left: np.ndarray = NOTHING_LEFT, length_s: float = 1.0, unrounded_n: float = SMALL_N
) -> Finding:
    return decided_by_modes(window(mode, left, length_s, unrounded_n))


@pytest.mark.parametrize(
    ("changes", "fate"),
    [
        ({"growth_per_s": 1.0, "error_per_s": 0.0, "thirds_n": (0.1, 0.15, 0.25)}, Fate.GROWING),
        # surely grows and is not seen to
        ({"growth_per_s": 1.0, "error_per_s": 0.0, "thirds_n": (0.2, 0.2, 0.2)}, Fate.UNSURE),
        ({"growth_per_s": 1.0, "error_per_s": 0.0, "end_n": 0.01, "thirds_n": (0.2, 0.2, 0.2)}, Fate.NEGLIGIBLE),
        ({"growth_per_s": -1.0, "error_per_s": 0.1}, Fate.FALLING),
        # an error counts however small it is: 2.5 of them
        ({"growth_per_s": -0.2, "error_per_s": 0.021}, Fate.UNSURE),
        ({"growth_per_s": -0.2, "error_per_s": 0.019}, Fate.FALLING),
        ({"growth_per_s": 0.0, "error_per_s": 0.0}, Fate.LASTING),
        ({"growth_per_s": 0.0, "error_per_s": 0.0, "end_n": 0.04, "begin_n": 0.04}, Fate.NEGLIGIBLE),
        ({"growth_per_s": 0.0, "error_per_s": 0.0, "thirds_n": (0.3, 0.2, 0.1)}, Fate.UNSURE),
        ({"growth_per_s": 0.1, "error_per_s": 1.0}, Fate.UNSURE),
        ({"growth_per_s": 0.1, "error_per_s": 1.0, "end_n": 0.04}, Fate.NEGLIGIBLE),
    ],
)
def test_a_mode_has_the_fate_of_the_first_rule_of_the_table(changes: dict[str, object], fate: Fate) -> None:
    mode = line(**changes)
    assert classify(mode, window(mode)) is fate


def test_the_largest_mode_of_the_first_fate_decides() -> None:
    lasting = line(growth_per_s=0.0, error_per_s=0.0)
    growing = line(frequency_hz=9.0, growth_per_s=1.0, error_per_s=0.0, thirds_n=(0.1, 0.15, 0.25))
    unsure = line(frequency_hz=3.0, growth_per_s=0.1, error_per_s=1.0)

    def decided(*modes: Mode) -> str:
        own = window(modes[0])
        return decided_by_modes(own._replace(fit=own.fit._replace(modes=list(modes)))).kind

    assert decided(lasting, growing) == "diverged"
    assert decided(lasting, growing._replace(end_n=0.2)) == "limit_cycle"
    assert decided(lasting, unsure) == "limit_cycle"
    # what is in doubt, and twice as large, may be the motion of which the other is a harmonic
    assert decided(lasting, unsure._replace(end_n=0.7)) == "cannot_say"
    assert decided(line(growth_per_s=-1.0, error_per_s=0.1)) == "stable"


def test_what_a_growth_stands_out_of_is_left_at_the_end() -> None:
    grows = line(growth_per_s=1.0, error_per_s=0.0, thirds_n=(0.1, 0.15, 0.25))
    for sizes_n, kind in (((0.2, 0.0), "diverged"), ((0.0, 0.2), "cannot_say")):
        left = np.concatenate([np.full(150, sizes_n[0]), np.full(150, sizes_n[1])])
        assert by_modes(grows, left).kind == kind


def test_a_small_growth_that_stands_out_for_less_than_two_turns_is_not_said_to_become_large() -> None:
    # 2.5 of what is left are e^3.5 below the end: of ten turns in which it grows by e^20 the last 1.75 are seen.
    left = np.full(300, 0.04 / 2.5 / math.exp(3.5))
    grows = line(growth_per_s=10.0, error_per_s=0.0, begin_n=0.0, end_n=0.04, thirds_n=(0.0, 0.0, 0.04))
    assert by_modes(grows, left, 2.0).kind == "stable"
    assert by_modes(grows._replace(end_n=0.06), 1.5 * left, 2.0).kind == "diverged"


def test_a_motion_has_to_change_by_more_than_the_bounds_to_grow_or_die_out() -> None:
    """The bounds of docs/verdicts.md: at one of them a motion does not exceed it."""
    turns = line(frequency_hz=5.0, error_per_s=0.0, begin_n=0.3, thirds_n=(0.1, 0.2, 0.3))
    assert by_modes(turns._replace(growth_per_s=0.15)).kind == "limit_cycle"
    assert by_modes(turns._replace(growth_per_s=0.15 + 1e-9)).kind == "diverged"
    # a fifth of the least change is all that a motion which goes on may lose
    assert by_modes(turns._replace(growth_per_s=-0.03)).kind == "cannot_say"
    assert by_modes(turns._replace(growth_per_s=-0.03 + 1e-9)).kind == "limit_cycle"
    # an error counts against a decay, however small it is
    assert by_modes(turns._replace(growth_per_s=-0.2, error_per_s=0.019)).kind == "stable"
    assert by_modes(turns._replace(growth_per_s=-0.2, error_per_s=0.021)).kind == "cannot_say"


def test_a_motion_that_is_just_small_is_rest_whatever_it_does() -> None:
    small = line(frequency_hz=5.0, growth_per_s=0.0, error_per_s=0.0, begin_n=SMALL_N, end_n=SMALL_N)
    assert by_modes(small).kind == "stable"
    assert by_modes(small._replace(begin_n=1.001 * SMALL_N, end_n=1.001 * SMALL_N)).kind == "limit_cycle"
    seen_once = small._replace(frequency_hz=0.8, growth_per_s=4.0)
    assert by_modes(seen_once).kind == "stable"
    assert by_modes(seen_once._replace(end_n=1.001 * SMALL_N)).kind == "diverged"


def test_two_turns_show_a_swing_within_a_step_of_the_read_out() -> None:
    """Whether it grows is not known where it is small only because of the step; what turns less often may be chance."""
    rounded = line(growth_per_s=0.0, error_per_s=1.0, begin_n=0.04, end_n=0.04)
    assert by_modes(rounded._replace(frequency_hz=2.0), unrounded_n=0.02).kind == "cannot_say"
    assert by_modes(rounded._replace(frequency_hz=1.9), unrounded_n=0.02).kind == "stable"
    assert by_modes(rounded._replace(frequency_hz=2.0), unrounded_n=0.05).kind == "stable"


def test_a_cycle_has_the_size_of_its_last_turn() -> None:
    time_s = PERIOD_S * np.arange(1000)
    values = np.where(time_s < 0.5, 3.0, 0.2) * np.sin(2.0 * np.pi * 5.0 * time_s)
    cycles = Fit([line(growth_per_s=0.0, error_per_s=0.0)], 1.0, NOTHING_LEFT, NOTHING_LEFT, 0.0, True)
    found = decided_by_modes(Window(1.0, 7.0, SMALL_N, 0.0, SMALL_N, values, cycles))
    assert (found.kind, found.size_n) == ("limit_cycle", pytest.approx(0.4, rel=1e-3))


def test_a_rest_of_less_than_a_millionth_of_a_newton_is_not_told() -> None:
    dying = Finding("stable", Cause.DIES_OUT, growth_per_s=-1.0)
    assert sentence(dying._replace(decisive_n=1e-6), 0.0) != sentence(dying._replace(decisive_n=0.9e-6), 0.0)
    assert sentence(dying._replace(decisive_n=0.9e-6), 0.0) == sentence(dying, 0.0)


def falling(exponent: float) -> np.ndarray:
    """Return noise whose density falls with the frequency by an exponent."""
    frequencies = np.arange(1, 4097)
    turns = np.exp(2j * np.pi * np.random.default_rng(4).random(4096))
    return np.fft.irfft(np.concatenate([[0.0], turns / frequencies ** (0.5 * exponent)]), 8192)


@pytest.mark.parametrize(
    ("exponent", "is_noise"), [(0.36, False), (0.65, True), (1.0, True), (1.7, True), (2.4, False)]
)
def test_noise_falls_by_a_quarter_of_the_steepest_at_least(exponent: float, is_noise: bool) -> None:
    assert falls_as_noise(falling(exponent), 0.0) is is_noise


def test_noise_that_is_just_small_is_rest() -> None:
    values = falling(1.0)
    sizes = sizes_of(motion(values))
    for small_n, kind in ((max(sizes[-2:]), "stable"), (0.999 * max(sizes[-2:]), "cannot_say")):
        assert by_envelope(motion(values, small_n)).kind == kind


def test_a_line_stands_out_of_all_others_but_its_two_neighbours() -> None:
    power = np.ones(16)
    power[8] = 40.0
    assert has_line(power)
    for index, is_line in ((7, True), (9, True), (6, False), (10, False)):
        wide = power.copy()
        wide[index] = 35.0
        assert has_line(wide) is is_line


def test_how_far_a_force_goes_is_taken_in_eight_windows() -> None:
    assert sizes_of(motion(windows(*range(1, 9)))) == pytest.approx(range(1, 9), rel=0.03)


def test_noise_adds_nothing_to_an_envelope_and_hides_no_swing_of_its_size() -> None:
    generator = np.random.default_rng(1)
    noise = 0.1 * generator.standard_normal(4000)
    swing = 0.15 * np.sin(2.0 * np.pi * np.arange(4000) / 50.0)
    noisy = motion(noise)._replace(noise_n=0.1)
    assert max(sizes_of(noisy)) < 0.1
    assert sizes_of(noisy._replace(values=noise + swing)) == pytest.approx([0.3] * 8, rel=0.25)


@pytest.mark.parametrize("factor", [1.5, 1.2])
def test_an_irregular_motion_that_grows_from_window_to_window_has_diverged_at_its_rate(factor: float) -> None:
    found = by_windows(*(0.1 * factor**k for k in range(8)))
    assert (found.kind, found.rest_from_s) == ("diverged", None)
    assert found.growth_per_s == pytest.approx(math.log(factor) / 0.1, rel=1e-3)
    assert found.size_n == pytest.approx(0.1 * factor**7, rel=0.03)


def test_an_irregular_motion_that_grows_to_less_than_is_small_is_at_rest() -> None:
    assert by_windows(*(1e-4 * 1.1**k for k in range(8))).kind == "stable"


@pytest.mark.parametrize("factor", [1.01, 1.0, 0.995])
def test_an_irregular_motion_that_changes_by_less_than_a_seventh_over_all_goes_on(factor: float) -> None:
    assert by_windows(*(factor**k for k in range(8))).kind == "limit_cycle"


def test_an_irregular_motion_that_falls_from_window_to_window_dies_out_at_its_rate() -> None:
    found = by_windows(*(10.0 * 0.7**k for k in range(8)))
    assert (found.kind, found.cause) == ("stable", Cause.DIES_OUT)
    assert found.growth_per_s == pytest.approx(math.log(0.7) / 0.1, rel=1e-3)


def test_what_falls_to_a_swing_that_stays_does_not_die_out() -> None:
    assert by_windows(*(1.0 + 10.0 * 0.5**k for k in range(8))).kind != "stable"
    assert by_windows(*(1.0 + 10.0 * 0.2**k for k in range(8))).kind == "limit_cycle"


def test_what_grows_and_then_stays_goes_on() -> None:
    found = by_windows(0.3, 1.0, 1.7, 1.95, 2.0, 2.0, 2.0, 2.0)
    assert (found.kind, found.size_n) == ("limit_cycle", pytest.approx(2.0, rel=0.03))


def test_an_irregular_motion_that_rises_and_falls_goes_on_or_cannot_be_told() -> None:
    assert by_windows(2.0, 1.0, 2.0, 1.2, 1.9, 1.0, 1.8, 1.3).kind == "limit_cycle"
    assert by_windows(10.0, 10.0, 10.0, 10.0, 8.0, 6.0, 2.0, 2.5).kind == "cannot_say"


def test_an_irregular_motion_is_at_rest_from_the_window_on_in_which_it_is_small() -> None:
    found = by_windows(3.0, 2.0, 1.0, 0.5, 0.2, 0.04, 0.04, 0.03)
    # the episode ends at 7 s, and its last three tenths of a second are at rest
    assert (found.kind, found.rest_from_s) == ("stable", pytest.approx(6.7))
    # a window of noise that stands still at first is not a growth without end
    still = by_windows(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert (still.kind, still.growth_per_s) == ("stable", 0.0)


def test_a_line_rises_where_each_third_is_larger_than_the_one_before() -> None:
    # by half of what a growth by a factor of e in all says: a twelfth root and more from third to third
    least = math.exp(1.0 / 6.0)
    assert rises(fit(), line(thirds_n=(1.0, 1.01 * least, 1.03 * least**2)), 1.0)
    assert not rises(fit(), line(thirds_n=(1.0, 0.99 * least, 2.0)), 1.0)
    assert not rises(fit(), line(thirds_n=(1.0, 2.0, 1.99)), 1.0)
    # a third that does not stand out of what the fit leaves says nothing
    assert rises(fit(left_n=3.0), line(thirds_n=(1.0, 0.5, 2.0)), 1.0)


def test_modes_that_grow_and_cancel_one_another_do_not_rise_where_they_are_seen() -> None:
    growing = line(frequency_hz=12.0, growth_per_s=3.0, error_per_s=0.0)
    assert rises_where_seen(window(growing), growing)
    times = np.linspace(0.0, 1.0, len(NOTHING_LEFT))
    other = growing._replace(course=-0.99 * growing.course * np.exp(2.0 * np.minimum(times - 0.8, 0.0)))
    own = window(growing)._replace(fit=fit()._replace(modes=[growing, other]))
    assert not rises_where_seen(own, growing)
    # a mode that dies out has no part in what grows
    own = window(growing)._replace(fit=fit()._replace(modes=[growing, other._replace(growth_per_s=-3.0)]))
    assert rises_where_seen(own, growing)


@pytest.mark.parametrize(("slower", "is_rising"), [(0.45, True), (0.55, False)])
def test_a_motion_may_rise_by_half_of_a_growth_where_this_is_seen(slower: float, is_rising: bool) -> None:
    growing = line(frequency_hz=12.0, growth_per_s=3.0, error_per_s=0.0)
    times = np.linspace(-1.0, 0.0, len(NOTHING_LEFT))
    other = growing._replace(course=growing.course * np.expm1(-slower * 3.0 * times))
    own = window(growing)._replace(fit=fit()._replace(modes=[growing, other]))
    assert rises_where_seen(own, growing) is is_rising


def test_a_mode_is_small_from_when_it_has_died_out_to_that() -> None:
    assert time_until(line(growth_per_s=-2.0, begin_n=1.0), SMALL_N) == pytest.approx(math.log(20.0) / 2.0, rel=1e-12)
    assert time_until(line(growth_per_s=-2.0, begin_n=0.04), SMALL_N) == 0.0
    assert time_until(line(growth_per_s=2.0, begin_n=1.0), SMALL_N) == 0.0
    assert time_until(line(growth_per_s=0.0, begin_n=1.0), SMALL_N) == 0.0


def test_what_makes_half_a_swing_or_more_has_a_frequency() -> None:
    for frequency_hz, told_hz in ((0.5, 0.5), (0.49, 0.0)):
        grows = line(frequency_hz=frequency_hz, growth_per_s=9.0, error_per_s=0.0)
        assert by_modes(grows).frequency_hz == told_hz


@pytest.mark.parametrize(("frequency_hz", "needs_s"), [(0.25, 8.0), (0.125, 16.0), (0.12, 8.0), (0.0, 8.0)])
def test_a_force_on_its_way_needs_two_turns_or_four_such_holds(frequency_hz: float, needs_s: float) -> None:
    mode = line(frequency_hz=frequency_hz)
    found = undecided(mode, window(mode, length_s=2.0), mode.end_n)
    assert (found.cause, found.needs_s, found.decisive_n) == (Cause.ON_ITS_WAY, needs_s, 0.3)


def test_a_swing_that_is_not_told_needs_twice_the_hold_or_half_the_noise() -> None:
    own = window(line(), length_s=2.0)
    found = undecided(line(), own, 0.3)
    assert (found.cause, found.needs_s, found.needs_noise_n) == (Cause.CHANGE_UNKNOWN, 4.0, 0.0)
    noisy = undecided(line(), own._replace(fit=own.fit._replace(noise_n=0.1)), 0.3)
    assert noisy.needs_noise_n == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("end_n", "kind"), [(1.1, "stable"), (1.6, "stable"), (1.9, "cannot_say"), (2.5, "cannot_say")]
)
def test_a_force_on_its_way_is_stable_where_that_is_to_the_rest_of_the_law(end_n: float, kind: str) -> None:
    found = Finding("cannot_say", Cause.ON_ITS_WAY, 1.0)
    after = approaching(found, np.linspace(2.0, end_n, 1000), 1.0)
    assert after.kind == kind
    assert (after == found) is (kind == "cannot_say")
    assert kind == "cannot_say" or after.decisive_n == pytest.approx(end_n - 1.0, abs=0.05)


def test_the_ends_of_a_short_force_on_its_way_are_single_samples() -> None:
    found = approaching(Finding("cannot_say", Cause.ON_ITS_WAY), np.linspace(2.0, 1.1, 20), 1.0)
    assert (found.cause, found.decisive_n) == (Cause.TO_THE_REST, pytest.approx(0.1))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_how_far_a_force_goes_that_does_not_slow_down(sign: float) -> None:
    # from the mean of the first eighth, 1/192, to that of the last, 169/192
    assert gone_of(sign * np.linspace(0.0, 1.0, 801) ** 2) == pytest.approx(0.875, rel=0.01)
    assert gone_of(sign * (1.0 - np.exp(-np.linspace(0.0, 5.0, 801)))) == 0.0
    # fewer samples than eighths
    assert gone_of(sign * np.linspace(0.0, 1.0, 5) ** 2) == pytest.approx(1.0)


def test_the_period_of_an_even_grid_is_the_time_over_the_steps_between_the_samples() -> None:
    for times, apart_s in itertools.product(([0.0, 1.0, 2.0], [0.0, 0.9, 2.0]), (1.0, 2.0**-10)):
        values, period_s = even(apart_s * np.array(times), np.array([0.0, 1.0, 2.0]))
        assert period_s == apart_s
        assert len(values) == 3
        # a tenth of a period of 1.1 periods after the second sample
        assert values[1] == pytest.approx(1.0 if times[1] == 1.0 else 1.0 + 0.1 / 1.1)


def test_no_part_of_less_than_sixteen_samples_is_judged() -> None:
    """The last eight samples after a blow lie still, and 26 are too few to say that the force does."""
    time_s = 1e-3 * np.arange(26)
    blow = 1.0 + 0.5 * np.exp(-(((time_s / time_s[-1] - 0.5) / 0.05) ** 2))
    assert judge(time_s, blow, 1.0).cause is Cause.FEW_SAMPLES


def test_a_cycle_that_noise_hides_in_each_turn_has_the_size_of_its_line() -> None:
    time_s = 1e-3 * np.arange(8000)
    hidden = 0.03 * np.random.default_rng(2).standard_normal(8000)
    found = judge(time_s, 1.0 + 0.035 * np.sin(10.0 * np.pi * time_s) + hidden, 1.0)
    assert found.kind == "limit_cycle"
    assert found.peak_to_peak_n == pytest.approx(0.07, rel=0.1)


def test_a_swing_would_be_seen_beside_less_than_it_is_or_where_nothing_is_at_its_frequency() -> None:
    bare = 0.1 * np.random.default_rng(1).standard_normal(400)
    line_n = 0.15 * np.sin(2.0 * np.pi * 5.0 * np.arange(400) / 399.0)
    # 0.1 N is 0.28 N from peak to peak
    assert shown_beside(0.5, 5.0, bare, 1.0)
    assert shown_beside(0.3, 5.0, bare, 1.0)
    assert not shown_beside(0.15, 5.0, bare, 1.0)
    assert not shown_beside(0.3, 5.0, bare + line_n, 1.0)
    assert not shown_beside(0.3, 0.5, bare, 1.0)


@pytest.mark.parametrize(
    ("later_growth", "later_error", "kind"),
    [(-0.05, 0.1, "cannot_say"), (-0.05, 0.001, "limit_cycle"), (0.3, 0.5, "cannot_say")],
)
def test_a_short_part_says_only_what_it_surely_tells_otherwise(
    later_growth: float, later_error: float, kind: str
) -> None:
    """The whole of 8 s falls by 0.2/s; a part of 1 s that changes by as much within its error shows no cycle."""
    values = np.ones(400)
    before = Window(8.0, 8.0, 0.05, 0.0, 0.05, values, fit()._replace(modes=[line(growth_per_s=-0.2, end_n=0.3)]))
    found = Finding("limit_cycle", Cause.GOES_ON, 0.3, later_growth, 0.3, later_error, 5.0)
    window = Window(1.0, 8.0, 0.05, 0.0, 0.05, values, fit())
    said = beside([before], found, window, motion(values))
    assert said is not None and said.kind == kind


@pytest.mark.parametrize(("modes", "kind"), [(2, "limit_cycle"), (3, "cannot_say")])
def test_a_short_part_with_fewer_than_sixteen_samples_for_each_mode_leaves_a_doubt(modes: int, kind: str) -> None:
    fitted = fit()._replace(modes=[line(growth_per_s=0.0)] * modes, left=np.zeros(40))
    part = Window(1.0, 8.0, 0.05, 0.0, 0.05, np.ones(40), fitted)
    said = beside([], Finding("limit_cycle", Cause.GOES_ON, 0.3, 0.0, 0.3, 0.01, 5.0), part, motion(np.ones(400)))
    assert said is not None and said.kind == kind
    # A doubt states the length of a hold that would decide.
    assert said.needs_s == (2.0 if kind == "cannot_say" else 0.0)
