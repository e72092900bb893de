"""The random part of the delay as standardised quantile functions of uniform numbers."""

import math
from collections.abc import Callable, Sequence
from statistics import NormalDist

from services.delay_node.config import Jitter
from services.delay_node.random_streams import CorrelatedUniform, Draw

# Weights of the normal and the Pareto part, the proportion that is customary for this mixture.
NORMAL_WEIGHT = 0.25
PARETO_WEIGHT = 0.75

normal_quantile = NormalDist().inv_cdf
# Newton's steps end where they change the root by less than this share, and there are never more.
_SMALLEST_STEP, _MOST_STEPS = 1e-13, 100


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
    """Quantile of exponential numbers, of which the share w has the mean m and the others have the mean 1.

    S(x) = (1 - w) exp(-x) + w exp(-x/m) = 1 - u has no inverse in closed form. log S is convex and falls, so Newton's
    steps from 0 on rise to the root and never pass it; without a second part the first step is exact.
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


def table_quantile(samples: Sequence[float]) -> Callable[[float], float]:
    """Quantile of measured samples: linear between the sorted values, first at u = 0, last at u = 1."""
    ordered = sorted(samples)
    last = len(ordered) - 1

    def quantile(u: float) -> float:
        position = u * last
        below = int(position)
        above = ordered[min(below + 1, last)]
        return ordered[below] + (position - below) * (above - ordered[below])

    return quantile


class JitterSource:
    """Random delays [ns, may be negative], one for each message."""

    __slots__ = ("_draws", "_scale_ns", "_uniforms")

    def __init__(self, settings: Jitter, samples: Sequence[float], streams: Callable[[str], Draw]) -> None:
        self._scale_ns = settings.scale_s * 1e9
        parts = _parts(settings, samples)
        self._uniforms = tuple(
            CorrelatedUniform(settings.correlation, streams(name), normal_quantile) for _, name, _ in parts
        )
        self._draws = [
            (weight, quantile, uniform) for (weight, _, quantile), uniform in zip(parts, self._uniforms, strict=True)
        ]

    @property
    def state(self) -> list[float | None]:
        """The last normal score of each part, None before the first message and where there is no correlation."""
        return [uniform.score for uniform in self._uniforms]

    @state.setter
    def state(self, scores: list[float | None]) -> None:
        for uniform, score in zip(self._uniforms, scores, strict=True):
            uniform.score = score

    def __call__(self) -> float:
        """Return the next random part [ns]."""
        return self._scale_ns * sum(weight * quantile(uniform()) for weight, quantile, uniform in self._draws)


def _parts(settings: Jitter, samples: Sequence[float]) -> list[tuple[float, str, Callable[[float], float]]]:
    match settings.distribution:
        case "uniform":
            return [(1.0, "jitter", uniform_quantile)]
        case "normal":
            return [(1.0, "jitter", normal_quantile)]
        case "pareto":
            return [(1.0, "jitter", pareto_quantile(settings.pareto_shape))]
        case "hyperexponential":
            ratio = settings.second_scale_s / settings.scale_s if settings.scale_s else 1.0
            return [(1.0, "jitter", hyperexponential_quantile(settings.second_share, ratio))]
        case "table":
            return [(1.0, "jitter", table_quantile(samples))]
        case "pareto_normal":
            norm = math.hypot(NORMAL_WEIGHT, PARETO_WEIGHT)
            return [
                (NORMAL_WEIGHT / norm, "jitter/normal", normal_quantile),
                (PARETO_WEIGHT / norm, "jitter/pareto", pareto_quantile(settings.pareto_shape)),
            ]
