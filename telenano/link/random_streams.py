"""Random numbers of the link: one stream for each direction, topic and model, all from one seed.

Only `random.Random.random` is used, the only method whose sequence Python guarantees for a seed. Every enabled model
draws for every message, even for one that another model has already dropped, so that switching one model on or off
never shifts the draws of another.
"""

import hashlib
import math
import random
from collections.abc import Callable

Draw = Callable[[], float]

# Uniform numbers are kept away from 0 and 1, where the quantiles of unbounded distributions are infinite.
SMALLEST = 2.0**-54
LARGEST = 1.0 - 2.0**-53


class RandomStream:
    """A stream that counts its numbers; with the seed and names of the stream, the count is its whole state."""

    __slots__ = ("_draw", "drawn")

    def __init__(self, draw: Draw) -> None:
        self._draw = draw
        self.drawn = 0

    def __call__(self) -> float:
        self.drawn += 1
        return self._draw()

    def positive(self) -> float:
        """Return the next number, which is never 0."""
        return self() or SMALLEST

    def advance_to(self, drawn: int) -> None:
        """Draw until `drawn` numbers have been drawn in total; raise ValueError if more have been drawn already."""
        if drawn < self.drawn:
            raise ValueError(f"drawn is {drawn}, {self.drawn} numbers have been drawn already")
        for _ in range(drawn - self.drawn):
            self._draw()
        self.drawn = drawn


def stream(seed: int, *names: str) -> RandomStream:
    """Return the uniform [0, 1) stream of a seed and names; other names give an independent stream."""
    digest = hashlib.sha256("\n".join((str(seed), *names)).encode()).digest()
    return RandomStream(random.Random(int.from_bytes(digest)).random)


class Occurrence:
    """Events of probability p whose indicators have the lag-one correlation rho.

    The two-state Markov chain with P(event | event) = p + rho (1 - p) and P(event | none) = p (1 - rho): its rate is
    p for any rho, its lag-k correlation rho^k and its mean run 1 / ((1 - p)(1 - rho)).
    """

    __slots__ = ("_after_event", "_after_none", "_draw", "state")

    def __init__(self, probability: float, correlation: float, draw: Draw) -> None:
        self._draw = draw
        self._after_event = probability + correlation * (1.0 - probability)
        self._after_none = probability * (1.0 - correlation)
        # Probability of an event at the next draw.
        self.state = probability

    def __call__(self) -> bool:
        happens = self._draw() < self.state
        self.state = self._after_event if happens else self._after_none
        return happens


class CorrelatedUniform:
    """Uniform numbers in (0, 1) whose normal scores are a first-order autoregression with coefficient rho.

    z_k = rho z_(k-1) + sqrt(1 - rho^2) n_k, u_k = Phi(z_k): the distribution is the same for any rho, which blending
    successive uniform numbers would not give.
    """

    __slots__ = ("_draw", "_fresh", "_inverse", "_rho", "score")

    def __init__(self, correlation: float, draw: Draw, normal_score: Callable[[float], float]) -> None:
        self._draw = draw
        self._rho = correlation
        self._fresh = math.sqrt(1.0 - correlation * correlation)
        self._inverse = normal_score
        self.score: float | None = None

    def __call__(self) -> float:
        u = self._draw() or SMALLEST
        if self._rho == 0.0:
            return u
        fresh = self._inverse(u)
        # The first score has no predecessor, so it is drawn from the stationary distribution.
        self.score = fresh if self.score is None else self._rho * self.score + self._fresh * fresh
        return share_below(self.score)


def share_below(score: float) -> float:
    """Return the standard normal distribution function Phi(score), limited to the open interval (0, 1)."""
    return min(max(0.5 * math.erfc(-score / math.sqrt(2.0)), SMALLEST), LARGEST)
