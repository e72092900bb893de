"""What a force does beyond the noise that was measured in the free tip, where no mode explains it."""

import numpy as np
import pytest

from telenano.analysis.beyond_noise import Parts, comes_again, is_small, parts_of
from telenano.analysis.findings import Cause
from telenano.analysis.measured_noise import Noise, free_noise, octaves_of
from telenano.analysis.modes import rms
from telenano.analysis.verdict import judge

TIME_S = np.arange(3000) * 2e-3
QUIET = Noise(0.0, (0.0,), 1000)


def dice(seed: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(seed))


def slips(seed: int, size_n: float = 0.3) -> np.ndarray:
    """Return a load that rises and slips 80 times, whose times and sizes scatter by a third [N]."""
    generator = dice(seed)
    at_s = np.cumsum(np.maximum(1.0 + 0.3 * generator.standard_normal(200), 0.2)) * TIME_S[-1] / 80.0
    now = np.searchsorted(at_s, TIME_S)
    begins = np.concatenate([[0.0], at_s])
    part = (TIME_S - begins[now]) / (begins[now + 1] - begins[now])
    return size_n * np.clip(1.0 + 0.3 * generator.standard_normal(201), 0.3, 2.0)[now] * (part - 0.5)


def pink(seed: int, count: int, size_n: float) -> np.ndarray:
    """Return noise with the same power in each octave, of a root mean square [N]."""
    frequencies = np.arange(1, 8193)
    turns = np.exp(2j * np.pi * dice(seed).random(8192))
    values = np.fft.irfft(np.concatenate([[0.0], turns / np.sqrt(frequencies)]), 16384)
    return size_n * values[:count] / values.std()


def test_white_noise_has_the_same_density_in_each_octave() -> None:
    values = dice(1).standard_normal(200_000)
    for octave, own in enumerate(octaves_of(values)):
        if octave < 8:
            mean, most = Noise(1.0, ()).within(octave, len(values))
            assert rms(own) ** 2 == pytest.approx(mean, rel=0.1)
            assert rms(own) ** 2 < most


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_measured_in_the_free_tip_whatever_touches_it_for_a_moment(seed: int) -> None:
    free_n = pink(seed, 4000, 0.02)
    bare = free_noise([free_n, free_n[:100]])
    free_n[1200:1240] += 3.0
    struck = free_noise([free_n])
    assert bare is not None and struck is not None
    assert bare.octaves_n2[2:6] == pytest.approx(struck.octaves_n2[2:6], rel=0.5)
    assert free_noise([free_n[:63]]) is None
    assert free_noise([]) is None


@pytest.mark.parametrize("seed", range(6))
def test_what_slips_without_end_is_a_cycle_of_the_size_of_the_data(seed: int) -> None:
    found = judge(TIME_S, 1.0 + slips(seed), 1.0, free=QUIET)
    assert (found.kind, found.cause) == ("limit_cycle", Cause.IRREGULAR), found
    assert found.peak_to_peak_n == pytest.approx(np.ptp(slips(seed)[-600:]), rel=0.3)
    assert " Hz" in found.reason
    # its noise was not measured
    assert judge(TIME_S, 1.0 + slips(seed), 1.0).kind != "stable"


def test_noise_as_large_as_in_the_free_tip_is_no_motion() -> None:
    free = [free_noise([pink(seed + 100, 2000, 0.03)]) for seed in range(6)]
    kinds = [judge(TIME_S, 1.0 + pink(seed, 3000, 0.03), 1.0, free=own).kind for seed, own in enumerate(free)]
    # a slow line by chance leaves one of them open
    assert set(kinds) <= {"stable", "cannot_say"}
    assert kinds.count("stable") >= 5


@pytest.mark.parametrize("seed", range(6))
def test_what_slips_and_stops_is_at_rest(seed: int) -> None:
    stopped = np.where(TIME_S < 3.0, slips(seed), 0.0)
    assert judge(TIME_S, 1.0 + stopped, 1.0, free=QUIET).kind == "stable"


@pytest.mark.parametrize("seed", range(3))
def test_what_may_answer_the_trembling_of_the_hand_is_no_motion_of_the_loop(seed: int) -> None:
    values = 1.0 + slips(seed, 0.12)
    assert judge(TIME_S, values, 1.0, free=QUIET).kind == "limit_cycle"
    assert judge(TIME_S, values, 1.0, free=QUIET, answers_n=0.6).kind in ("stable", "cannot_say")


def parts(*reaches: float) -> Parts:
    return Parts(np.zeros(100), [0.5 * own for own in reaches], list(reaches), 20.0)


def test_a_motion_that_begins_three_times_comes_again_until_it_pauses_for_longer() -> None:
    bursts = (0.3, 0.0, 0.3, 0.0, 0.3, 0.0, 0.3)
    assert comes_again(parts(*bursts, 0.0, 0.0, 0.0), 0.05) is False
    assert comes_again(parts(0.0, 0.0, *bursts, 0.0), 0.05) is True
    assert comes_again(parts(0.3, 0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0, 0.0), 0.05) is False
    # A motion that is just not small begins nothing.
    assert comes_again(parts(*[0.09, 0.0] * 5), 0.05) is False


def test_a_motion_is_small_by_its_reach_or_by_its_power_and_half_of_its_reach() -> None:
    assert is_small(parts(*[1.0] * 7, 0.05, 0.05, 0.05), 0.05)
    assert not is_small(parts(*[1.0] * 7, 0.05, 0.06, 0.05), 0.05)
    one = parts(*[0.09] * 10)
    assert not is_small(one, 0.05)
    assert is_small(one._replace(sizes=[0.025] * 10), 0.05)
    assert not is_small(one._replace(sizes=[0.025] * 10, reaches=[0.11] * 10), 0.05)


def test_what_is_left_of_a_motion_has_no_noise() -> None:
    noise_n = 0.05 * dice(2).standard_normal(3000)
    own = parts_of(noise_n, Noise(0.05, ()), 0.05)
    assert max(own.reaches) < 0.03
    swing = 0.1 * np.sin(2.0 * np.pi * 6.0 * TIME_S)
    own = parts_of(noise_n + swing, Noise(0.05, ()), 0.05)
    assert own.sizes == pytest.approx([0.16] * len(own.sizes), rel=0.1)
    assert own.turns == pytest.approx(36.0, abs=4.0)
