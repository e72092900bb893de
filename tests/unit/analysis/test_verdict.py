"""Verdicts on motions whose fate is known, with and without noise of the read-out."""

import math
from typing import get_args

import numpy as np
import pytest

from telenano.analysis.findings import Cause, Finding
from telenano.analysis.modes import LEAST_SAMPLES, fitted, noise_floor
from telenano.analysis.verdict import ERROR_SHARE, SMALL_SHARE, Kind, judge
from telenano.analysis.verdict_sentences import sentence

TIME_S = np.arange(8000) * 1e-3
SHORT_S = TIME_S[:1400]


def ringing(
    growth_per_s: float, frequency_hz: float = 5.0, size: float = 0.3, time_s: np.ndarray = TIME_S
) -> np.ndarray:
    return 1.0 + size * np.exp(growth_per_s * time_s) * np.sin(2.0 * np.pi * frequency_hz * time_s + 0.3)


def beating(first_hz: float, second_hz: float, turn: float) -> np.ndarray:
    """Two lines of 0.25 N; turn 0 begins where they add up, pi where they cancel."""
    return 1.0 + 0.25 * (np.sin(2.0 * np.pi * first_hz * TIME_S) + np.sin(2.0 * np.pi * second_hz * TIME_S + turn))


def noise(sigma_n: float, samples: int, seed: int) -> np.ndarray:
    return sigma_n * np.random.default_rng(seed).standard_normal(samples)


@pytest.mark.parametrize("growth", [-3.0, -0.4, -0.05, 0.05, 0.4, 3.0])
@pytest.mark.parametrize("frequency", [2.5, 9.3, 437.0])
def test_growth_rate_is_the_real_part_of_the_mode(growth: float, frequency: float) -> None:
    assert judge(TIME_S, ringing(growth, frequency), 1.0).growth_per_s == pytest.approx(growth, rel=0.01, abs=0.0)


@pytest.mark.parametrize(
    ("growth", "size", "kind"),
    [
        (-0.4, 0.3, "stable"),
        (0.4, 0.3, "diverged"),
        # A motion that grows from next to nothing is rest as long as it is small.
        (0.4, 1e-4, "stable"),
        (0.4, 1.05e-3, "diverged"),
        (0.0, 0.3, "limit_cycle"),
        (0.0, 0.51 * SMALL_SHARE, "limit_cycle"),
        (0.0, 0.49 * SMALL_SHARE, "stable"),
        # 0.12, 0.2 and -0.2 in eight seconds
        (0.015, 0.3, "limit_cycle"),
        (0.025, 0.3, "diverged"),
        (-0.025, 0.3, "stable"),
    ],
)
def test_verdict(growth: float, size: float, kind: str) -> None:
    assert judge(TIME_S, ringing(growth, size=size), 1.0).kind == kind


def test_when_a_motion_has_come_to_rest_is_known_to_a_sample() -> None:
    found = {}
    for every in (1, 10):
        rest_from_s = judge(TIME_S[::every], ringing(-2.0, 2.0)[::every], 1.0).rest_from_s
        assert rest_from_s is not None
        found[every] = rest_from_s
        later_s = judge(TIME_S[::every] + 1.0, ringing(-2.0, 2.0)[::every], 1.0).rest_from_s
        assert later_s == pytest.approx(rest_from_s + 1.0, rel=0.0, abs=1e-6)
    assert found[10] == pytest.approx(found[1], rel=0.0, abs=10 * 1e-3)


SNAPS = 1.5 * np.exp(-0.5 * ((TIME_S % 2.7 - 1.3) / 0.03) ** 2)
LATE = np.where(TIME_S > 7.0, 0.01 * np.exp(4.0 * (TIME_S - 7.0)) * np.sin(10.0 * np.pi * TIME_S), 0.0)
# name: series, what it is, the most noise [N] at which it can be told by 8 s of samples
SERIES: dict[str, tuple[np.ndarray, tuple[str, ...], float]] = {
    "grows slowly": (ringing(0.03, size=0.1), ("diverged",), 0.05),
    "grows from a hundredth": (ringing(0.1, size=0.015), ("diverged", "cannot_say"), 0.02),
    "grows in a hold of Fig. 12": (ringing(0.5, size=0.015, time_s=SHORT_S), ("diverged", "cannot_say"), 0.005),
    "decays slowly": (ringing(-0.03, size=0.1), ("stable",), 0.02),
    "decays": (ringing(-1.0), ("stable",), 0.05),
    "decays without a swing": (1.0 + 0.3 * np.exp(-0.5 * TIME_S), ("stable",), 0.05),
    "beat that falls": (beating(5.0, 5.1, 0.2), ("limit_cycle",), 0.02),
    "beat that rises": (beating(5.0, 5.1, np.pi), ("limit_cycle",), 0.02),
    "slow beat that rises": (beating(5.0, 5.05, np.pi), ("limit_cycle", "diverged", "cannot_say"), 0.05),
    "slow swing that grows": (ringing(0.2, 0.05, 0.1), ("diverged", "cannot_say"), 0.05),
    "slow swing": (ringing(0.0, 0.1, 0.2), ("limit_cycle", "cannot_say"), 0.05),
    "snaps": (1.0 + SNAPS, ("limit_cycle",), 0.05),
    "begins in the last second": (1.0 + LATE, ("diverged",), 0.05),
    "small cycle": (ringing(0.0, size=0.020), ("stable",), 0.02),
    "cycle": (ringing(0.0, size=0.035), ("limit_cycle",), 0.03),
    "chatter": (ringing(0.0, 437.0, 0.1), ("limit_cycle",), 0.05),
    "nothing": (np.ones_like(TIME_S), ("stable",), 0.05),
    "runs away": (1.0 + 0.2 * np.exp(0.5 * (TIME_S - 8.0)), ("diverged",), 0.02),
    "drift": (1.0 + 0.1 * TIME_S, ("cannot_say",), 0.05),
    "small drift": (1.0 + 0.01 * TIME_S, ("stable",), 0.05),
}


@pytest.mark.parametrize("name", SERIES)
def test_series_whose_fate_is_known(name: str) -> None:
    values, kinds, most_n = SERIES[name]
    time_s = TIME_S[: len(values)]
    for sigma_n, seed in ((0.0, 0), (0.5 * most_n, 1), (most_n, 2), (most_n, 3)):
        found = judge(time_s, values + noise(sigma_n, len(values), seed), 1.0)
        assert found.kind in kinds, (sigma_n, seed, found)


def test_what_cannot_be_said_comes_with_what_would_decide() -> None:
    slow = judge(SHORT_S, ringing(0.0, 0.2, 0.5, SHORT_S), 1.0)
    hidden = judge(SHORT_S, ringing(0.0, 5.0, 0.06, SHORT_S) + noise(0.08, 1400, 2), 1.0)
    short = judge(TIME_S[:15], TIME_S[:15], 1.0)
    causes = (Cause.ON_ITS_WAY, Cause.CHANGE_UNKNOWN, Cause.FEW_SAMPLES)
    for found, cause in zip((slow, hidden, short), causes, strict=True):
        assert (found.kind, found.cause) == ("cannot_say", cause), found


@pytest.mark.parametrize("sigma_n", [0.001, 0.02, 0.05])
def test_noise_is_estimated_and_is_no_motion(sigma_n: float) -> None:
    for seed in range(2):
        found = judge(TIME_S, 1.0 + noise(sigma_n, 8000, seed), 1.0)
        assert found.kind == "stable"
        assert found.noise_n == pytest.approx(sigma_n, rel=0.1)


def test_noise_floor_is_not_raised_by_bursts_or_lines() -> None:
    bare = noise(0.02, 8000, 3)
    for motion in (SNAPS, ringing(0.0, 437.0, 0.5), ringing(0.3, 5.0, 0.1)):
        assert noise_floor(motion + bare) == pytest.approx(noise_floor(bare), rel=0.15)


def test_more_than_a_read_out_can_have_hides_what_moves() -> None:
    assert judge(TIME_S, 1.0 + noise(0.2, 8000, 1), 1.0).kind == "cannot_say"


@pytest.mark.parametrize("frequency_hz", [3.0, 12.0, 60.0])
@pytest.mark.parametrize("growth_per_s", [0.4, 3.0])
def test_a_swing_that_grows_is_seen_whatever_its_phase(frequency_hz: float, growth_per_s: float) -> None:
    for phase in np.arange(4) * np.pi / 4.0:
        swing = np.exp(growth_per_s * (TIME_S - 8.0)) * np.sin(2.0 * np.pi * frequency_hz * TIME_S + phase)
        found, small = (judge(TIME_S, 1.0 + end_n * swing, 1.0) for end_n in (0.04, 0.004))
        assert found.kind == "diverged", found
        # Below a twentieth of the hand's force the motion is rest, and grows.
        assert (small.kind, small.cause) == ("stable", Cause.GROWS_SMALL), small
        assert small.growth_per_s == pytest.approx(growth_per_s, rel=0.01)


@pytest.mark.parametrize("arrival_s", [0.0, 2.0, 6.0, 7.0])
@pytest.mark.parametrize("rate_per_s", [2.0, 9.0, 30.0])
def test_a_landing_that_comes_to_rest_is_stable_whenever_it_is(arrival_s: float, rate_per_s: float) -> None:
    since_s = TIME_S[arrival_s <= TIME_S] - arrival_s
    force = 1.0 - 2.1 * np.exp(-rate_per_s * since_s) * np.cos(4.0 * np.pi * since_s)
    assert judge(since_s, force, 1.0).kind == "stable"


def test_two_lines_that_beat_are_two_modes() -> None:
    modes = fitted(beating(5.0, 5.1, 0.2), 1e-3, 1e-7).modes
    assert sorted(mode.frequency_hz for mode in modes) == pytest.approx([5.0, 5.1], abs=1e-3)
    assert [mode.end_n for mode in modes] == pytest.approx([0.5, 0.5], rel=0.01)


def test_stillness_is_stable_without_a_rate() -> None:
    found = judge(TIME_S, np.ones_like(TIME_S), 1.0)
    assert (found.kind, found.growth_per_s, found.peak_to_peak_n, found.cause) == ("stable", None, 0.0, Cause.AT_REST)


def test_the_rest_begins_when_the_motion_is_small() -> None:
    found = judge(TIME_S, ringing(-1.0, size=0.5), 1.0)
    assert found.rest_from_s == pytest.approx(np.log(1.0 / SMALL_SHARE), rel=0.01)


def test_force_that_is_no_number_means_diverged() -> None:
    force = ringing(0.0)
    force[5000:] = np.nan
    assert judge(TIME_S, force, 1.0).kind == "diverged"


def test_no_reason_has_a_number_that_is_none() -> None:
    for values in (np.ones_like(TIME_S), 1.0 + 1e-30 * TIME_S, ringing(-40.0), 1.0 + 0.2 * np.exp(TIME_S - 8.0)):
        reason = judge(TIME_S, values, 1.0).reason
        assert "0 N" not in reason.split()
        assert " 0 Hz" not in reason
        assert "e-3" not in reason


def test_seven_kinds_and_no_more() -> None:
    assert len(get_args(Kind)) <= 7


def test_what_is_no_motion_has_the_size_of_its_numbers_and_no_noise() -> None:
    force = ringing(0.0)
    force[100:200] = np.inf
    found = judge(TIME_S, force, 1.0)
    finite = force[np.isfinite(force)]
    assert (found.kind, found.peak_to_peak_n, found.noise_n) == ("diverged", float(np.ptp(finite)), 0.0)
    assert judge(TIME_S, np.full(TIME_S.size, np.nan), 1.0)[:4] == ("diverged", None, 0.0, 0.0)
    force = ringing(0.0)[: LEAST_SAMPLES - 1]
    found = judge(TIME_S[: LEAST_SAMPLES - 1], force, 1.0)
    assert (found.cause, found.peak_to_peak_n, found.noise_n) == (Cause.FEW_SAMPLES, float(np.ptp(force)), 0.0)
    assert judge(TIME_S[:LEAST_SAMPLES], ringing(0.0)[:LEAST_SAMPLES], 1.0).cause is not Cause.FEW_SAMPLES


@pytest.mark.parametrize("hand_force_n", [0.2, 2.0])
def test_what_noise_hides_is_said_with_the_noise_that_would_do(hand_force_n: float) -> None:
    found = judge(TIME_S, 1.0 + noise(hand_force_n, TIME_S.size, seed=5), hand_force_n)
    expected = Finding("cannot_say", Cause.HIDDEN_BY_NOISE, needs_noise_n=ERROR_SHARE * hand_force_n)
    assert (found.cause, found.reason) == (expected.cause, sentence(expected, found.noise_n))


@pytest.mark.parametrize("force_n", [-1.0, 0.0, math.nan])
def test_the_hand_has_to_press(force_n: float) -> None:
    assert LEAST_SAMPLES == 16
    with pytest.raises(ValueError, match=rf"is {force_n} N, it must be > 0 N"):
        judge(TIME_S, TIME_S, force_n)


@pytest.mark.parametrize("noise_n", [0.0, 0.01])
@pytest.mark.parametrize("harmonic", [0.0, 0.2, -0.15])
def test_a_cycle_goes_as_far_as_all_its_lines_together(harmonic: float, noise_n: float) -> None:
    wave = 2.0 + np.sin(2.0 * np.pi * 3.0 * TIME_S) + harmonic * np.sin(2.0 * np.pi * 9.0 * TIME_S)
    found = judge(TIME_S, wave + noise(noise_n, len(TIME_S), 3), 2.0)
    assert found.kind == "limit_cycle"
    # what noise can reach is taken off
    assert found.peak_to_peak_n == pytest.approx(np.ptp(wave), abs=0.005 + 10.0 * noise_n)
    assert found.cause is Cause.GOES_ON


@pytest.mark.parametrize("size_n", [0.07, 0.2, 0.4])
def test_a_motion_between_two_forces_is_a_cycle_unless_the_read_out_rounds_to_them(size_n: float) -> None:
    values = 1.0 + np.where(TIME_S % 0.2 < 0.1, size_n, 0.0)
    assert judge(TIME_S, values, 1.0, step_n=0.0).kind == "limit_cycle"
    if size_n < 0.3:
        found = judge(TIME_S, values, 1.0, step_n=size_n)
        assert (found.kind, found.cause) == ("cannot_say", Cause.WITHIN_A_STEP)
    assert judge(TIME_S, 1.0 + 0.1 * (values - 1.0), 1.0, step_n=0.1 * size_n).kind == "stable"


@pytest.mark.parametrize("seed", range(4))
def test_a_read_out_that_flickers_by_a_step_now_and_then_is_at_rest(seed: int) -> None:
    flicker = np.random.default_rng(seed).random(len(TIME_S)) < 0.2
    assert judge(TIME_S, 1.0 + np.where(flicker, 0.07, 0.0), 1.0, step_n=0.07).kind == "stable"


@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_friction_that_stops_a_motion_neither_keeps_it_up_nor_makes_it_grow(friction: float) -> None:
    """Its envelope goes to nothing at once, which no exponential does: A e^(-t) less a constant."""
    time_s = np.arange(3000) * 1e-3
    envelope = np.maximum((1.0 + friction) * np.exp(-time_s) - friction, 0.0)
    for motion in (envelope, envelope * np.cos(60.0 * time_s)):
        found = judge(time_s, 1.0 + 0.5 * motion, 1.0)
        assert found.kind in ("stable", "cannot_say"), found.reason


@pytest.mark.parametrize("place", [0.0, 0.3, 0.47])
def test_a_swing_within_a_step_of_the_read_out_is_not_called_rest(place: float) -> None:
    """A step of 0.07 N, and a swing that grows from 0.02 N to 0.09 N from peak to peak, or goes on."""
    time_s, step_n = np.arange(2000) * 1e-3, 0.07
    for growth_per_s in (0.0, 0.75):
        size_n = (0.04 if growth_per_s else 0.045) * np.exp(growth_per_s * (time_s - 2.0))
        bare_n = 1.0 + place * step_n + size_n * np.sin(2.0 * np.pi * 15.0 * time_s)
        found = judge(time_s, step_n * np.round(bare_n / step_n), 1.0, step_n=step_n)
        if np.ptp(step_n * np.round(bare_n / step_n)):
            assert (found.kind == "stable") <= (found.peak_to_peak_n <= 0.05), (place, growth_per_s, found)


SIZES = (0.3, 1.0, 3.0)


@pytest.mark.grid(noise_n=0.02)
@pytest.mark.parametrize("last", SIZES)
@pytest.mark.parametrize(("frequency_hz", "part"), [(3.1, 0.1), (9.658, 0.4), (22.0, 0.6)])
@pytest.mark.parametrize("noise_n", [0.0, 0.02])
def test_a_swing_that_grows_and_then_stays_is_not_at_rest(
    last: float, frequency_hz: float, part: float, noise_n: float
) -> None:
    """dA/dt = r A (1 - A²/S²), which has grown after a part of the hold."""
    time_s = 1e-3 * np.arange(4000)
    rate_per_s = np.log(20.0) / (4.0 * part)
    size = last / np.sqrt(1.0 + 399.0 * np.exp(-2.0 * rate_per_s * time_s))
    values = 0.95 + size * np.cos(2.0 * np.pi * frequency_hz * time_s) + noise(noise_n, 4000, 1)
    assert judge(time_s, values, 1.0).kind == "limit_cycle"


@pytest.mark.parametrize("depth", [0.3, 0.6])
@pytest.mark.parametrize("beats", [2.4, 5.0, 11.0])
def test_two_swings_that_beat_go_on_whatever_the_beat_is_at_at_the_end(depth: float, beats: float) -> None:
    time_s = 1e-3 * np.arange(4000)
    for turn in np.arange(4) * np.pi / 2.0:
        swing = np.cos(14.0 * np.pi * time_s) + depth * np.cos((14.0 + 0.5 * beats) * np.pi * time_s + turn)
        assert judge(time_s, 1.0 + 0.2 * swing, 1.0).kind == "limit_cycle"


def test_a_large_swing_that_dies_beside_one_that_stays_is_not_rest() -> None:
    time_s = 1e-3 * np.arange(4000)
    dies = 2.0 * np.exp(-time_s) * np.cos(2.0 * np.pi * 17.0 * time_s)
    assert judge(time_s, 1.0 + dies + 0.1 * np.cos(2.0 * np.pi * 8.0 * time_s), 1.0).kind == "limit_cycle"
    assert judge(time_s, 1.0 + dies, 1.0).kind == "stable"


SINCE_S = 1e-3 * np.arange(3000)


def test_beats_that_die_out_are_not_said_to_go_on_whatever_the_beat_is_at_at_the_end() -> None:
    """The last window of the envelope is larger than the ones before, and both lines die out by a third."""
    fade = np.exp(-0.15 * SINCE_S)
    for phase in np.arange(0.0, 6.0, 1.5):
        lines = np.cos(2.0 * np.pi * 20.0 * SINCE_S) + 0.5 * np.cos(2.0 * np.pi * 21.6 * SINCE_S + phase)
        found = judge(SINCE_S, 1.0 + 0.3 * fade * lines + noise(1e-3, len(SINCE_S), 5), 1.0)
        assert (found.kind, found.cause) == ("stable", Cause.DIES_OUT)


@pytest.mark.parametrize("dies_at_s", [0.8, 1.5, 2.1])
def test_what_dies_out_since_a_step_of_the_delay_is_stable(dies_at_s: float) -> None:
    """It grows to six times the hand's force before, which is most of what the whole hold shows."""
    late_s = np.maximum(SINCE_S - dies_at_s, 0.0)
    size_n = 3.0 * np.exp(3.0 * (np.minimum(SINCE_S, dies_at_s) - dies_at_s) - 2.0 * late_s)
    turns = 9.0 * np.minimum(SINCE_S, dies_at_s) + 7.0 * late_s
    values = 8.0 + size_n * np.cos(2.0 * np.pi * turns) + noise(0.01, len(SINCE_S), 6)
    assert judge(SINCE_S, values, 1.0).kind == "stable"


def test_an_amplitude_that_falls_in_a_line_dies_out_and_does_not_go_on_in_a_short_part() -> None:
    """The last eighth changes by less than its own error, as the whole of which it is a part would have it."""
    for rate_hz in (5.0, 15.0):
        size_n = 1.0 - 0.5 * SINCE_S / SINCE_S[-1]
        values = 1.0 + size_n * np.cos(2.0 * np.pi * rate_hz * SINCE_S) + noise(0.05, len(SINCE_S), 7)
        assert judge(SINCE_S, values, 1.0).kind in ("stable", "cannot_say")


def test_a_small_growth_beside_a_larger_way_that_is_not_known_is_no_growth() -> None:
    """A tip that is pulled off slowly runs away to one side, and what else the fit of that has is its residue."""
    way = 0.5 * (SINCE_S - 1.5) ** 2 - 0.5
    assert judge(SINCE_S, way, 2.0).kind != "diverged"


def test_every_cause_has_a_sentence() -> None:
    for cause in Cause:
        assert sentence(Finding("cannot_say", cause), 0.1)
