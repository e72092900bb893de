"""Verdicts on several modes at once: a sum of swings that all die out is no cycle, however it looks for a while."""

from collections import Counter
from typing import NamedTuple

import numpy as np
import pytest

from telenano.analysis.envelope import recurs
from telenano.analysis.verdict import judge

HAND_N, REST_N = 1.0, 0.9
DRAWS = 100


class Swing(NamedTuple):
    """A swing that changes by so much over its series [1, logarithm]."""

    frequency_hz: float
    amplitude_n: float
    change: float


class Sum(NamedTuple):
    """Swings, and the white noise over them; `lasts` has the first of them last."""

    swings: tuple[Swing, ...]
    noise_n: float
    count: int
    rate_hz: float

    @property
    def lasts(self) -> "Sum":
        return self._replace(swings=(self.swings[0]._replace(change=0.0), *self.swings[1:]))

    def kinds(self, seed: int) -> Counter[str]:
        """Return how often which verdict is said of series that differ in their phases and noise."""
        return Counter(self.judged((seed, draw)) for draw in range(DRAWS))

    def judged(self, seed: tuple[int, int]) -> str:
        generator = np.random.Generator(np.random.PCG64(seed))
        time_s = np.arange(self.count) / self.rate_hz
        force_n = REST_N + self.noise_n * generator.standard_normal(self.count)
        for swing in self.swings:
            size_n = swing.amplitude_n * np.exp(swing.change * time_s / time_s[-1])
            force_n += size_n * np.cos(2.0 * np.pi * (swing.frequency_hz * time_s + generator.random()))
        return judge(time_s, force_n, HAND_N, REST_N, 0.0).kind


SLOW = Sum((Swing(5.5, 0.09, -0.4), Swing(1.7, 0.07, -0.9)), 0.036, 250, 125.0)
# in windows of a twentieth of a second noise hides these swings where they turn
FEW_TURNS = Sum((Swing(6.0, 0.6, -0.6), Swing(7.4, 0.5, -0.9)), 0.05, 100, 250.0)


@pytest.mark.check("takes 1 s")
@pytest.mark.parametrize(("made", "most"), [(SLOW, 0.03), (FEW_TURNS, 0.0)])
def test_swings_that_die_out_at_once_are_hardly_ever_a_cycle(made: Sum, most: float) -> None:
    """Of those with few turns three in a hundred were one, because noise hid them in some windows."""
    kinds = made.kinds(794)
    assert kinds["limit_cycle"] + kinds["diverged"] <= most * DRAWS


@pytest.mark.check("takes 1 s")
@pytest.mark.parametrize("made", [SLOW, FEW_TURNS])
def test_one_that_lasts_among_them_is_hardly_ever_stable(made: Sum) -> None:
    kinds = made.lasts.kinds(795)
    assert kinds["stable"] <= 0.01 * DRAWS
    assert made is not SLOW or kinds["limit_cycle"] > 0.2 * DRAWS


@pytest.mark.parametrize(("hidden_n", "again"), [(0.0, True), (0.4, True), (0.5, False)])
def test_a_motion_begins_again_if_it_moves_farther_than_noise_hides(hidden_n: float, again: bool) -> None:
    """A swing of which noise hides as much as it moves in a window seems to rest there."""
    assert recurs([0.0, 1.0, 0.0, 0.9, 0.0, 0.0, 0.04, 1.0], 0.05, hidden_n) is again
