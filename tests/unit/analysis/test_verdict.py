"""Verdicts on signals whose fate is known, with and without noise of the read-out."""

import numpy as np
import pytest

from analysis.modes import LEAST_SAMPLES, modes_of, noise_floor
from analysis.verdict import (
    SMALL_SHARE,
    WINDOWS,
    Circumstances,
    Verdict,
    growth_rate,
    judge,
    struck,
    window_sizes,
)

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
        # growing from next to nothing is growing all the same
        (0.4, 1e-4, "diverged"),
        (0.0, 0.3, "limit_cycle"),
        (0.0, 0.51 * SMALL_SHARE, "limit_cycle"),
        (0.0, 0.49 * SMALL_SHARE, "stable"),
        # less than a tenth over the later part of the hold
        (0.015, 0.3, "limit_cycle"),
        (0.025, 0.3, "diverged"),
        (-0.025, 0.3, "stable"),
    ],
)
def test_verdict(growth: float, size: float, kind: str) -> None:
    assert judge(TIME_S, ringing(growth, size=size), 1.0).kind == kind


SNAPS = 1.5 * np.exp(-0.5 * ((TIME_S % 2.7 - 1.3) / 0.03) ** 2)
LATE = np.where(TIME_S > 7.0, 0.01 * np.exp(4.0 * (TIME_S - 7.0)) * np.sin(10.0 * np.pi * TIME_S), 0.0)
# name: series, what it is, the most noise [N] at which it can be told by 8 s of samples
SERIES: dict[str, tuple[np.ndarray, tuple[str, ...], float]] = {
    "grows slowly": (ringing(0.03, size=0.1), ("diverged",), 0.05),
    "grows from a hundredth": (ringing(0.1, size=0.01), ("diverged",), 0.02),
    "grows in a hold of Fig. 12": (ringing(0.5, size=0.01, time_s=SHORT_S), ("diverged",), 0.005),
    "decays slowly": (ringing(-0.03, size=0.1), ("stable",), 0.05),
    "decays": (ringing(-1.0), ("stable",), 0.05),
    "decays without a swing": (1.0 + 0.3 * np.exp(-0.5 * TIME_S), ("stable",), 0.05),
    "beat that falls": (beating(5.0, 5.1, 0.2), ("limit_cycle",), 0.02),
    "beat that rises": (beating(5.0, 5.1, np.pi), ("limit_cycle",), 0.02),
    "slow beat that rises": (beating(5.0, 5.05, np.pi), ("limit_cycle", "diverged"), 0.05),
    "slow swing that grows": (ringing(0.2, 0.05, 0.1), ("diverged", "drifting", "cannot_say"), 0.05),
    "slow swing": (ringing(0.0, 0.1, 0.2), ("limit_cycle", "cannot_say"), 0.05),
    "snaps": (1.0 + SNAPS, ("limit_cycle",), 0.05),
    "begins in the last second": (1.0 + LATE, ("diverged",), 0.05),
    "small cycle": (ringing(0.0, size=0.020), ("stable",), 0.02),
    "cycle": (ringing(0.0, size=0.035), ("limit_cycle",), 0.05),
    "chatter": (ringing(0.0, 437.0, 0.1), ("limit_cycle",), 0.05),
    "nothing": (np.ones_like(TIME_S), ("stable",), 0.05),
    "small drift that bends": (1.0 + 0.006 * np.exp(0.16 * (TIME_S - 8.0)), ("stable",), 0.0),
    "large drift that bends": (1.0 + 0.2 * np.exp(0.5 * (TIME_S - 8.0)), ("diverged",), 0.02),
    "drift": (1.0 + 0.1 * TIME_S, ("drifting",), 0.05),
}


@pytest.mark.parametrize("name", SERIES)
def test_series_whose_fate_is_known(name: str) -> None:
    values, kinds, most_n = SERIES[name]
    time_s = TIME_S[: len(values)]
    for sigma_n, seed in ((0.0, 0), (0.5 * most_n, 1), (most_n, 2), (most_n, 3)):
        found = judge(time_s, values + noise(sigma_n, len(values), seed), 1.0)
        assert found.kind in kinds, (sigma_n, seed, found)


def test_what_noise_hides_is_never_called_steady_growth() -> None:
    # 0.02 N from peak to peak in noise of 0.05 N and a hold of 1.4 s
    kinds = {judge(SHORT_S, ringing(0.5, size=0.01, time_s=SHORT_S) + noise(0.05, 1400, s), 1.0).kind for s in range(3)}
    assert kinds <= {"stable", "diverged", "cannot_say"}


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


def test_more_than_a_read_out_can_have_is_a_motion() -> None:
    found = judge(TIME_S, 1.0 + noise(0.2, 8000, 1), 1.0)
    assert found.kind == "limit_cycle"
    assert found.noise_n == 0.0


@pytest.mark.parametrize("back_s", [0.05, 0.09, 0.2])
def test_a_dip_that_a_late_message_leaves_is_no_swing_that_grows(back_s: float) -> None:
    """The fit makes modes of up to 41 N of a dip of 2.7 mN that goes back where it was."""
    time_s = TIME_S[:5300]
    since_s = time_s - (time_s[-1] - 0.3)
    dip = np.where(since_s >= 0.0, 2.7e-3 * np.exp(-np.maximum(since_s, 0.0) / back_s), 0.0)
    found = judge(time_s, 0.963 - dip, 1.0, Circumstances(noisy=True, expected_n=0.963))
    assert found.kind == "stable", found
    assert found.peak_to_peak_n < 3e-3


@pytest.mark.parametrize("frequency_hz", [0.7, 3.0, 12.0, 60.0])
@pytest.mark.parametrize("growth_per_s", [0.4, 3.0])
def test_a_swing_that_grows_is_seen_at_its_end_whatever_its_phase(frequency_hz: float, growth_per_s: float) -> None:
    for phase in np.arange(8) * np.pi / 8.0:
        swing = np.exp(growth_per_s * (TIME_S - 8.0)) * np.sin(2.0 * np.pi * frequency_hz * TIME_S + phase)
        assert judge(TIME_S, 1.0 + 0.004 * swing, 1.0).kind == "diverged"


def test_two_lines_that_beat_are_two_modes() -> None:
    modes = modes_of(beating(5.0, 5.1, 0.2), 1e-3, 0.0, 1e-7)
    assert sorted(mode.frequency_hz for mode in modes) == pytest.approx([5.0, 5.1], abs=1e-3)
    assert [mode.end_n for mode in modes] == pytest.approx([0.25, 0.25], rel=0.01)


def test_stillness_is_stable_without_a_rate() -> None:
    assert judge(TIME_S, np.ones_like(TIME_S), 1.0)[:4] == ("stable", None, 0.0, 0.0)


def test_a_guard_is_told_from_a_motion_that_grew() -> None:
    guarded = Circumstances(guarded=True)
    assert judge(TIME_S, ringing(0.5), 1.0, guarded).kind == "diverged"
    assert judge(TIME_S, ringing(-1.0, size=0.1), 1.0, guarded).kind == "guarded"
    assert judge(TIME_S[:5], ringing(-1.0)[:5], 1.0, guarded).kind == "guarded"
    assert judge(TIME_S[:0], TIME_S[:0], 1.0, guarded)[:3] == ("guarded", None, 0.0)


def test_a_tip_that_is_off_the_surface_is_not_stable() -> None:
    still = np.zeros_like(TIME_S)
    assert judge(TIME_S, still, 1.0, Circumstances(touching=0.0)).kind == "contact_lost"
    assert judge(TIME_S, still, 1.0, Circumstances(touching=None)).kind == "stable"
    cycling = judge(TIME_S, ringing(0.0), 1.0, Circumstances(touching=0.8))
    assert cycling.kind == "limit_cycle"
    assert "off the surface" in cycling.reason


def test_hand_and_tip_without_force_are_no_hold() -> None:
    found = judge(TIME_S, np.full(8000, 1e-4), 1.0, Circumstances(expected_n=2e-4))
    assert found.kind == "released"
    assert found.reason == "the hand presses with 0.0002 N and the tip with 0.0001 N: this is no hold"
    # a hand that presses with little is one: the arm of a law that gives force away
    assert judge(TIME_S, np.full(8000, 0.06), 1.0, Circumstances(expected_n=0.06)).kind == "stable"
    assert judge(TIME_S, np.full(8000, 0.06), 1.0, Circumstances(expected_n=1e-4)).kind == "wrong_force"


@pytest.mark.parametrize(("tip_n", "kind"), [(4.0, "wrong_force"), (1.12, "wrong_force"), (0.95, "stable")])
def test_the_force_has_to_be_the_hands_to_a_tenth(tip_n: float, kind: str) -> None:
    found = judge(TIME_S, np.full(8000, tip_n), 1.0, Circumstances(expected_n=1.0))
    assert found.kind == kind
    if kind == "wrong_force":
        assert found.reason == f"the tip presses with {tip_n:.3g} N, the hand with 1 N"


def test_force_that_is_no_number_means_diverged() -> None:
    force = ringing(0.0)
    force[5000:] = np.nan
    assert judge(TIME_S, force, 1.0).kind == "diverged"


# of the hand that presses with 1 N in a hold of 1.125 s, with 2 N at its greatest
HOLD_S = np.arange(1125) * 1e-3
PRESSED = Circumstances(noisy=True, touching=1.0, expected_n=1.0, touching_at_end=1.0)


def late_contact(contact_s: float, time_constant_s: float = 0.09, overshoot_n: float = 0.0) -> np.ndarray:
    """The tip in the air, the jump into contact with its pull, and the approach of the hand's force from one side."""
    since_s = HOLD_S - contact_s
    pulled = -0.5 - 0.6 * np.clip(since_s / 0.1, 0.0, 1.0)
    pressed = 1.0 - 2.1 * np.exp(-(since_s - 0.1) / time_constant_s)
    pressed += overshoot_n * np.sin(np.pi * np.clip(since_s - 0.3, 0.0, 0.2) / 0.2)
    return np.where(since_s < 0.0, -0.002, np.where(since_s < 0.1, pulled, pressed))


@pytest.mark.parametrize("contact_s", [0.05, 0.2, 0.3, 0.35, 0.4])
@pytest.mark.parametrize("overshoot_n", [0.0, 0.12])
@pytest.mark.parametrize("sigma_n", [0.0, 0.005])
def test_an_approach_from_one_side_that_dies_out_is_no_cycle(
    contact_s: float, overshoot_n: float, sigma_n: float
) -> None:
    # 9.5, 9.8, 9.94, 9.99 nN by 0.1 s
    force = late_contact(contact_s, overshoot_n=overshoot_n) + noise(sigma_n, len(HOLD_S), 4)
    found = judge(HOLD_S, force, 2.0, PRESSED)
    assert found.kind in ("stable", "settling"), found


def test_a_tip_that_comes_into_contact_in_the_later_half_settles() -> None:
    touching = float((HOLD_S[562:] > 0.6).mean())
    known = PRESSED._replace(touching=touching)
    found = judge(HOLD_S, late_contact(0.6, 0.03), 2.0, known)
    assert found.kind == "settling"
    assert f"off the surface for {100.0 * (1.0 - touching):.3g} %" in found.reason
    # one that has not arrived when the hold ends has lost its contact
    assert (
        judge(HOLD_S, late_contact(1.2), 2.0, known._replace(touching=0.0, touching_at_end=0.0)).kind == "contact_lost"
    )
    # the wrong force is none that it settled at
    assert judge(HOLD_S, 0.8 * late_contact(0.6, 0.03), 2.0, known).kind != "settling"


@pytest.mark.parametrize("frequency_hz", [1.8, 2.6, 4.1, 5.0, 9.3, 60.0])
@pytest.mark.parametrize("size_n", [0.12, 0.4])
@pytest.mark.parametrize("sigma_n", [0.0, 0.005])
@pytest.mark.parametrize("phase", [0.0, 1.0, 2.0])
def test_a_cycle_just_above_what_is_small_stays_one_after_an_approach(
    frequency_hz: float, size_n: float, sigma_n: float, phase: float
) -> None:
    # small is 0.1 N from peak to peak beside a hand of 2 N
    swing = 0.5 * size_n * np.sin(2.0 * np.pi * frequency_hz * HOLD_S + phase)
    approach = 1.0 - 0.5 * np.exp(-HOLD_S / 0.09)
    for values in (1.0 + swing, approach + swing):
        found = judge(HOLD_S, values + noise(sigma_n, len(HOLD_S), 6), 2.0, PRESSED)
        # the fit may have the slower of the two for the one that goes on: not stable either
        assert found.kind in ("limit_cycle", "drifting"), found


def landing(force: np.ndarray, contact_s: float, *, known: bool = True) -> Verdict:
    """Judge a hold in which the tip met the surface at a time, knowing that it did or not."""
    touches = contact_s < HOLD_S
    told = PRESSED._replace(touching=float(touches[562:].mean()), touching_at_end=float(touches[-281:].mean()))
    return judge(HOLD_S, force, 2.0, told._replace(landed_s=HOLD_S[-1] - contact_s if known else None))


def test_a_landing_in_the_hold_is_no_cycle_and_no_drift() -> None:
    # as over a line of 1 Mbit/s: 1.7 N at 2 Hz that neither grew nor died out was the jump into contact and the rest
    unknown = set()
    for contact_s in (0.45, 0.5, 0.6, 0.65, 0.7):
        for time_constant_s in (0.06, 0.09, 0.12):
            force = late_contact(contact_s, time_constant_s)
            unknown.add(landing(force, contact_s, known=False).kind)
            found = landing(force, contact_s)
            arrived = abs(float(force[-140:].mean()) - 1.0) < 0.05 and np.ptp(force[-140:]) < 0.1
            assert found.kind in (("settling", "stable") if arrived else ("settling", "cannot_say")), found
            assert found.kind != "cannot_say" or "was on its way to its rest" in found.reason
    assert unknown & {"limit_cycle", "drifting"}


@pytest.mark.parametrize("frequency_hz", [4.0, 9.0, 30.0])
@pytest.mark.parametrize("contact_s", [0.2, 0.4])
def test_a_tip_that_swings_after_its_landing_is_not_excused(frequency_hz: float, contact_s: float) -> None:
    swing = 0.2 * np.sin(2.0 * np.pi * frequency_hz * (HOLD_S - contact_s)) * (contact_s + 0.1 < HOLD_S)
    assert landing(late_contact(contact_s, 0.05) + swing, contact_s).kind in ("limit_cycle", "drifting", "diverged")


def test_a_small_motion_in_the_air_is_lost_contact_and_no_divergence() -> None:
    # 0.016 N from peak to peak, growing as the tip nears the surface
    growing = -1e-2 - 8e-3 * np.exp(2.0 * (HOLD_S - HOLD_S[-1])) * np.sin(2.0 * np.pi * 9.0 * HOLD_S)
    away = PRESSED._replace(touching=0.0, touching_at_end=0.0)
    assert judge(HOLD_S, growing, 2.0).kind == "diverged"
    found = judge(HOLD_S, growing, 2.0, away)
    assert found.kind == "contact_lost"
    assert "100 % of the later half" in found.reason
    # a tip that touches and swings more and more is not in the air
    assert judge(HOLD_S, 1.0 + growing, 2.0, PRESSED).kind == "diverged"
    # nor is one that is thrown off again and again
    bouncing = np.clip(3.0 * np.exp(2.0 * (HOLD_S - HOLD_S[-1])) * np.sin(2.0 * np.pi * 5.0 * HOLD_S), 0.0, None)
    assert judge(HOLD_S, bouncing, 2.0, PRESSED._replace(touching=0.5)).kind == "diverged"


def test_a_jump_into_contact_in_the_last_eighth_is_no_motion_that_begins() -> None:
    known = PRESSED._replace(touching=0.2, touching_at_end=0.4)
    assert judge(HOLD_S, late_contact(1.0), 2.0, known).kind == "contact_lost"
    assert judge(HOLD_S, late_contact(1.0), 2.0).kind == "diverged"


def test_a_guard_that_acted_for_want_of_commands_says_nothing_of_the_law() -> None:
    starved = Circumstances(guarded=True, starved=True, guard="no command came")
    # the motion is the jump into contact
    for values in (late_contact(0.4), ringing(0.5, time_s=HOLD_S)):
        assert judge(HOLD_S, values, 1.0, starved)[::4] == ("guarded", "no command came")
    assert judge(HOLD_S, ringing(2.0, time_s=HOLD_S), 1.0, starved._replace(starved=False)).kind == "diverged"


def random_motion(seed: int, size_n: float = 0.1) -> np.ndarray:
    """A motion that a random link keeps up: what is heard for 20 ms on average and then not."""
    steps = np.random.default_rng(seed).standard_normal(len(TIME_S))
    values = np.zeros_like(steps)
    for n in range(1, len(steps)):
        values[n] = 0.95 * values[n - 1] + steps[n]
    return 1.0 + size_n * values / values.std()


def test_motion_that_the_link_keeps_up_is_a_cycle() -> None:
    kinds = {judge(TIME_S, random_motion(seed), 1.0, Circumstances(noisy=True)).kind for seed in range(3)}
    assert kinds == {"limit_cycle"}


@pytest.mark.parametrize(("growth", "kind"), [(0.2, "diverged"), (0.1, "limit_cycle"), (-0.2, "stable")])
def test_trend_over_a_random_link_has_to_be_a_factor_of_two(growth: float, kind: str) -> None:
    # over 0.7 of the 8 s, so that 0.125 per second is a factor of two
    assert judge(TIME_S, ringing(growth), 1.0, Circumstances(noisy=True)).kind == kind


def test_times_of_messages_may_be_uneven() -> None:
    late = TIME_S + 2e-4 * np.random.default_rng(2).random(len(TIME_S))
    force = 1.0 + 0.1 * np.exp(0.05 * late) * np.sin(10.0 * np.pi * late)
    assert judge(late, force, 1.0).growth_per_s == pytest.approx(0.05, abs=0.003)


def test_one_missed_burst_does_not_change_the_rate() -> None:
    sizes = np.array([1.0, 1.0, 0.3, 1.0, 1.0, 1.0])
    slope, trend = growth_rate(np.arange(6.0), sizes, 0.0)
    assert slope == 0.0
    assert abs(trend) < 0.7


def test_sizes_below_the_floor_count_as_nothing() -> None:
    assert growth_rate(np.arange(3.0), np.array([1.0, 1e-9, 1e-9]), 1e-7) == (None, 0.0)
    slope, trend = growth_rate(np.arange(3.0), np.array([1.0, np.exp(-2.0), 1e-9]), 1e-7)
    assert slope == pytest.approx(-2.0, rel=1e-12, abs=0.0)
    assert trend == -1.0


def growing_at_the_end(size_n: float, growth_per_s: float, length_s: float) -> tuple[np.ndarray, np.ndarray]:
    """A swing of so much from peak to peak where the hold ends."""
    time_s = np.arange(0.0, length_s, 1e-3)
    return time_s, 0.5 * size_n * np.exp(growth_per_s * (time_s - length_s)) * np.sin(2.0 * np.pi * 1.05 * time_s)


@pytest.mark.parametrize("growth_per_s", [0.1, 0.5])
@pytest.mark.parametrize("length_s", [5.0, 8.0])
@pytest.mark.parametrize(("share", "kind"), [(0.8, "stable"), (1.2, "diverged")])
def test_what_is_small_and_would_be_after_another_hold_does_not_diverge(
    share: float, kind: str, length_s: float, growth_per_s: float
) -> None:
    size_n = share * SMALL_SHARE * np.exp(-growth_per_s * length_s)
    time_s, swing = growing_at_the_end(size_n, growth_per_s, length_s)
    assert judge(time_s, 1.0 + swing, 1.0).kind == kind


def test_two_tenths_of_a_millinewton_that_settle_do_not_diverge() -> None:
    time_s, swing = growing_at_the_end(1.8e-4, 0.1, 8.0)
    # until the last tenth of a second it grows, and then it is gone
    settled = np.where(time_s < 7.9, swing, 0.0)
    for force in (swing, settled):
        assert judge(time_s, 1.0 + force, 1.0).kind == "stable"


@pytest.mark.parametrize(("peak_n", "kind"), [(1.9, "stable"), (2.1, "struck"), (30.0, "struck")])
def test_rest_after_a_blow_of_twice_the_force_of_the_hand_has_a_word(peak_n: float, kind: str) -> None:
    for force_n in (1.0, 2.0):
        found = struck(judge(TIME_S, np.full_like(TIME_S, force_n), force_n), peak_n * force_n, force_n)
        assert found.kind == kind
        assert ("times the force of the hand" in found.reason) == (kind == "struck")


def test_a_blow_does_not_hide_what_is_worse_than_it() -> None:
    assert struck(judge(TIME_S, ringing(0.4), 1.0), 30.0, 1.0).kind == "diverged"
    assert struck(judge(TIME_S, ringing(0.0), 1.0), 30.0, 1.0).kind == "limit_cycle"


def test_windows_cover_the_hold() -> None:
    centres, sizes = window_sizes(TIME_S, TIME_S)
    assert len(centres) == len(sizes) == WINDOWS
    np.testing.assert_allclose(sizes, 0.999, rtol=1e-9, atol=0.0)
    assert centres[0] == pytest.approx(0.4995, rel=1e-9, abs=0.0)


def test_short_hold_is_no_verdict_and_the_hand_has_to_press() -> None:
    short = judge(TIME_S[:15], TIME_S[:15], 1.0)
    assert short == Verdict(
        "cannot_say", None, pytest.approx(0.014), 0.0, "the hold has 15 samples: 74 are needed to judge it"
    )
    assert LEAST_SAMPLES == 74
    with pytest.raises(ValueError, match=r"-1\.0 N"):
        judge(TIME_S, TIME_S, -1.0)
