"""Verdicts on forces that an instrument as it is has read: what is made of noise and drift alone is no limit cycle.

The truth of each series is how it was made: noise of a read-out over a force that rests, or a cycle beneath the noise.
"""

from collections import Counter

import numpy as np
import pytest

from telenano.analysis.envelope import falls_as_noise
from telenano.analysis.holds import judge_holds
from telenano.analysis.verdict import Verdict, judge

DT, HOLD_S, FORCE_N = 1e-3, 6.0, 1.0
SEEDS = range(40)


def pink(generator: np.random.Generator, count: int, lowest_hz: float = 0.1) -> np.ndarray:
    """Return 1/f noise of unit variance by its spectrum, which is not how the rig makes it."""
    long = 1 << int(np.ceil(np.log2(2.0 / (lowest_hz * DT))))
    frequencies = np.fft.rfftfreq(long, DT)
    size = np.where(frequencies >= lowest_hz, 1.0 / np.sqrt(np.maximum(frequencies, lowest_hz)), 0.0)
    turns = generator.normal(size=(2, frequencies.size))
    values = np.fft.irfft(size * (turns[0] + 1j * turns[1]), long)
    return values[:count] / values.std()


def read(seed: int, flicker_n: float, cycle_n: float = 0.0, cycle_hz: float = 3.0) -> Verdict:
    """Return the verdict on a force of 1 N with noise, rounding, a drift of 3 % and a cycle from peak to peak [N]."""
    generator = np.random.Generator(np.random.PCG64(seed))
    time_s = DT * np.arange(round(HOLD_S / DT))
    force = FORCE_N + 0.03 * generator.uniform(-1.0, 1.0) * time_s / HOLD_S
    force += 0.5 * cycle_n * np.sin(2.0 * np.pi * (cycle_hz * time_s + generator.random()))
    force += flicker_n * pink(generator, time_s.size) + 0.03 * generator.normal(size=time_s.size)
    return judge(time_s, np.round(force / 0.02) * 0.02, FORCE_N, FORCE_N)


@pytest.mark.check("takes 0.6 s")
@pytest.mark.parametrize("flicker_n", [0.02, 0.04, 0.1, 0.2, 0.4])
def test_noise_and_drift_are_no_cycle_and_no_growth(flicker_n: float) -> None:
    kinds = Counter(read(seed, flicker_n).kind for seed in SEEDS)
    assert kinds.keys() <= {"stable", "cannot_say"}, kinds
    # the noise of the named instrument, 0.04 N at the hand, hides nothing
    assert flicker_n > 0.04 or kinds["stable"] >= 0.9 * len(SEEDS)


@pytest.mark.check("judges 850 series")
def test_few_draws_of_other_seeds_are_judged_wrongly_and_few_are_not_judged() -> None:
    """The rule was made with the seeds of the tests above; these hold what it costs with others."""
    for flicker_n, wrong, unsaid in (
        (0.02, 0.0, 0.05),
        (0.04, 0.0, 0.05),
        (0.1, 0.0, 0.15),
        (0.2, 0.02, 1.0),
        (0.4, 0.02, 1.0),
    ):
        kinds = Counter(read(seed, flicker_n).kind for seed in range(5000, 5170))
        assert 170 - kinds["stable"] - kinds["cannot_say"] <= wrong * 170, (flicker_n, kinds)
        assert kinds["cannot_say"] <= unsaid * 170, (flicker_n, kinds)


@pytest.mark.check("takes 0.9 s")
@pytest.mark.parametrize("flicker_n", [0.02, 0.04, 0.1])
def test_a_cycle_is_one_under_noise(flicker_n: float) -> None:
    """A cycle that is ten times the noise from peak to peak is not rest, and is seen where it turns often."""
    for cycle_hz, seen in ((1.1, 0.0), (3.0, 0.5), (11.0, 0.9)):
        kinds = Counter(read(seed, flicker_n, 10.0 * flicker_n, cycle_hz).kind for seed in SEEDS[:12])
        assert kinds.keys() <= {"limit_cycle", "cannot_say"}, (cycle_hz, kinds)
        assert kinds["limit_cycle"] >= seen * len(SEEDS[:12]), (cycle_hz, kinds)


def test_a_cycle_over_the_smallest_noise_is_no_noise() -> None:
    """The line of a cycle, and the band of an irregular one, stand out of a density that falls."""
    generator = np.random.Generator(np.random.PCG64(3))
    time_s = DT * np.arange(6000)
    noise = pink(generator, 6000)
    assert falls_as_noise(noise, 0.0)
    assert falls_as_noise(noise + 0.05 * generator.normal(size=6000), 0.05)
    assert not falls_as_noise(noise + 1.5 * np.sin(2.0 * np.pi * 7.0 * time_s), 0.0)
    # its phase wanders by a turn within a second
    irregular = np.sin(2.0 * np.pi * 7.0 * time_s + np.cumsum(0.1 * generator.normal(size=6000)))
    assert not falls_as_noise(irregular + 0.1 * noise, 0.0)
    assert not falls_as_noise(generator.normal(size=6000), 1.0)
    assert not falls_as_noise(np.exp(-time_s / 0.3), 0.0)


def test_a_blow_is_not_what_noise_reaches() -> None:
    """1 N with noise of 0.3 N reaches 2.3 N in six seconds, and a real blow stands out of it."""
    generator = np.random.Generator(np.random.PCG64(2))
    time_s = DT * np.arange(6000)
    hand = np.where(time_s < 0.5, 0.0, 1.0)
    tip = hand + 0.3 * generator.normal(size=6000)
    assert tip.max() > 2.0
    (hold,) = judge_holds(time_s, hand, time_s, tip)
    assert not hold.has("struck")
    tip[700:720] += 3.0 * np.sin(np.linspace(0.0, np.pi, 20))
    (hold,) = judge_holds(time_s, hand, time_s, tip)
    assert hold.has("struck")


def test_the_words_name_what_would_decide() -> None:
    found = next(verdict for seed in SEEDS if (verdict := read(seed, 0.4)).kind == "cannot_say")
    assert found.cause is not None and found.reason.endswith("would decide")
