"""The random part of the delay as standardised quantile functions of uniform numbers."""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import NamedTuple

from telenano.link.random_streams import CorrelatedUniform, Draw, share_below
from telenano.settings.link_settings import Jitter

normal_quantile = NormalDist().inv_cdf
# Returns the random part of the delay [ns] of a message that arrives at a time [ns].
RandomDelay = Callable[[int], float]
# Newton's method ends after a step that changes the root by less than this share.
_SMALLEST_STEP = 1e-13
# Most steps of Newton's method.
_MOST_STEPS = 100


def uniform_quantile(u: float) -> float:
    """Quantile of the uniform distribution on [-1, 1]."""
    return 2.0 * u - 1.0


def pareto_quantile(shape: float) -> Callable[[float], float]:
    """Quantile of the Pareto distribution of shape a > 2, shifted and scaled to mean 0 and standard deviation 1.

    X = (1 - u)^(-1/a) has the mean a/(a - 1) and the variance a/((a - 1)^2 (a - 2)).
    """
    mean = shape / (shape - 1.0)
    deviation = math.sqrt(shape / (shape - 2.0)) / (shape - 1.0)
    exponent = -1.0 / shape

    def quantile(u: float) -> float:
        return float(((1.0 - u) ** exponent - mean) / deviation)

    return quantile


def hyperexponential_quantile(second_share: float, second_mean: float) -> Callable[[float], float]:
    """Quantile of a mixture of exponential distributions: the share w has the mean m, the rest the mean 1.

    S(x) = (1 - w) exp(-x) + w exp(-x/m) = 1 - u has no closed inverse. log S is convex and decreasing, so Newton's
    steps from 0 rise to the root without overshoot; for w = 0 the first step is exact.
    """
    rate = 1.0 / second_mean if second_share > 0.0 else 1.0

    def quantile(u: float) -> float:
        wanted, x = math.log1p(-u), 0.0
        for _ in range(_MOST_STEPS):
            first, second = (1.0 - second_share) * math.exp(-x), second_share * math.exp(-rate * x)
            step = (math.log(first + second) - wanted) * (first + second) / (first + rate * second)
            x += step
            if step <= _SMALLEST_STEP * x:
                break
        return x

    return quantile


def table_quantile(ordered: Sequence[float]) -> Callable[[float], float]:
    """Quantile of measured samples in ascending order: linear between them, first at u = 0, last at u = 1."""
    last = len(ordered) - 1

    def quantile(u: float) -> float:
        position = u * last
        below = int(position)
        above = ordered[min(below + 1, last)]
        return ordered[below] + (position - below) * (above - ordered[below])

    return quantile


def pairs_quantile(pairs: Sequence[tuple[float, float]]) -> Callable[[float], float]:
    """Quantile through (share, value) pairs whose shares rise from 0 to 1: linear between them."""
    shares, values = zip(*pairs, strict=True)

    def quantile(u: float) -> float:
        above = min(bisect_right(shares, u), len(shares) - 1)
        low, below = shares[above - 1], values[above - 1]
        return float(below + (u - low) / (shares[above] - low) * (values[above] - below))

    return quantile


class JitterState(NamedTuple):
    """State of a jitter source.

    score: the last normal score, None before the first one and without correlation; step and u: number of the last time
    step and its uniform number, for jitter with a correlation time.
    """

    score: float | None
    step: int
    u: float


class JitterSource:
    """Source of random delays [ns, may be negative], one for each message.

    Args:
        settings: The settings of the jitter.
        samples: The table of the distribution `table` in ascending order, else empty.
        draw: The stream of random numbers.
        now_ns: Time at which it begins [ns].
    """

    __slots__ = ("_quantile", "_scale_ns", "_step", "_step_ns", "_u", "_uniform")

    def __init__(self, settings: Jitter, samples: Sequence[float], draw: Draw, now_ns: int = 0) -> None:
        self._scale_ns = settings.scale_s * 1e9
        self._quantile = _quantile_of(settings, samples)
        self._step_ns = round(settings.correlation_time_s * 1e9 / Jitter.DRAWS_IN_CORRELATION_TIME)
        rho = math.exp(-1.0 / Jitter.DRAWS_IN_CORRELATION_TIME) if self._step_ns else settings.correlation
        self._uniform = CorrelatedUniform(rho, draw, normal_quantile)
        # With a correlation time, draws are made per time step, so that messages do not shift each other's draws.
        self._step = now_ns // self._step_ns - 1 if self._step_ns else 0
        self._u = 0.5

    @property
    def state(self) -> JitterState:
        return JitterState(self._uniform.score, self._step, self._u)

    @state.setter
    def state(self, state: JitterState) -> None:
        self._uniform.score, self._step, self._u = state

    def __call__(self, now_ns: int = 0) -> float:
        """Return the random delay [ns] of a message that arrives at `now_ns` [ns], which must not decrease."""
        if not self._step_ns:
            return self._scale_ns * self._quantile(self._uniform())
        self._advance(now_ns)
        return self._scale_ns * self._quantile(self._u)

    def beside(self, second: "JitterSource", share: float) -> RandomDelay:
        """Return a source [ns] that mixes the normal scores of both; `share` of their variance comes from `second`."""
        own, other = math.sqrt(1.0 - share), math.sqrt(share)

        def draw(now_ns: int) -> float:
            score = own * self._advance(now_ns) + other * second._advance(now_ns)
            return self._scale_ns * self._quantile(share_below(score))

        return draw

    def _advance(self, now_ns: int) -> float:
        behind = now_ns // self._step_ns - self._step
        if behind > Jitter.LONGEST_WALK:
            # After this time the new score is independent of the old one.
            self._uniform.score, behind = None, 1
        for _ in range(behind):
            self._u = self._uniform()
        self._step = now_ns // self._step_ns
        return self._uniform.score or 0.0


def _quantile_of(settings: Jitter, samples: Sequence[float]) -> Callable[[float], float]:
    match settings.distribution:
        case "uniform":
            return uniform_quantile
        case "pareto":
            return pareto_quantile(settings.pareto_shape)
        case "hyperexponential":
            ratio = settings.second_scale_s / settings.scale_s if settings.scale_s else 1.0
            return hyperexponential_quantile(settings.second_share, ratio)
        case "table":
            return pairs_quantile(settings.quantiles) if settings.quantiles else table_quantile(samples)
        case _:
            return normal_quantile
