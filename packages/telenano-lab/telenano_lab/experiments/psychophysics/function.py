"""The psychometric function: the share of correct answers at a level, by threshold, width, guess and lapse rate.

    share(x) = guess + (1 - guess - lapse) · F((s(x) - s(threshold)) / width)

s is the axis, x itself or its natural logarithm. F is 1/2 at the threshold, and the width is the distance on the axis
between F = 0.05 and F = 0.95, for each shape alike (H. H. Schütt and others, Vision Res. 122 (2016) 105).
"""

import math
from collections.abc import Sequence
from statistics import NormalDist
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from telenano.settings import Settings
from telenano_lab.experiments.psychophysics.exact import Numbers, exp, log, normal_share

Shape = Literal["logistic", "normal", "weibull"]

# These factors make the width of a function the distance between F = 0.05 and F = 0.95.
# 2 ln 19
_LOGISTIC = 5.8888779583328805
# Twice the 95 % quantile of the normal distribution.
_NORMAL = 3.289707253902943
# ln 0.5 makes F = 0.5 at the threshold of a Weibull function.
_LN_HALF = -0.6931471805599453
# ln(ln 0.05 / ln 0.95)
_WEIBULL = 4.0673839494071125
# No answer is impossible, so that the logarithm of a share stays finite.
_RAREST = 1e-9


class Psychometric(Settings):
    """The family of functions that describes answers."""

    shape: Shape = Field(
        default="logistic",
        description="logistic, normal (cumulative), or weibull, which needs the logarithmic axis",
    )
    axis: Literal["linear", "log"] = Field(
        default="linear", description="Whether equal steps are differences of the level (linear) or ratios (log)"
    )
    guess: float = Field(
        default=0.5,
        ge=0.0,
        lt=0.95,
        description="Share of correct answers far below the threshold: 1/n of n alternatives, or false alarms",
    )
    most_lapses: float = Field(
        default=0.06,
        ge=0.0,
        le=0.3,
        description="Greatest lapse rate, the share of wrong answers far above the threshold, that a fit considers",
    )

    @model_validator(mode="after")
    def _weibull_is_of_ratios(self) -> "Psychometric":
        if self.shape == "weibull" and self.axis != "log":
            raise ValueError("the weibull shape is a function of ratios: set axis: log, or take logistic or normal")
        return self

    def on_axis(self, levels: Sequence[float] | Numbers) -> Numbers:
        """Convert levels to places on the axis."""
        values = np.asarray(levels, dtype=float)
        return log(values) if self.axis == "log" else values

    def from_axis(self, places: Sequence[float] | Numbers) -> Numbers:
        """Convert places on the axis to levels."""
        values = np.asarray(places, dtype=float)
        return exp(values) if self.axis == "log" else values

    def grow(self, distances: Numbers) -> Numbers:
        """Return F at distances from the threshold, in widths."""
        if self.shape == "logistic":
            return 1.0 / (1.0 + exp(-_LOGISTIC * distances))
        if self.shape == "normal":
            return normal_share(_NORMAL * distances)
        return 1.0 - exp(_LN_HALF * exp(_WEIBULL * distances))

    def share(self, places: Numbers, threshold: Numbers, width: Numbers, lapse: Numbers) -> Numbers:
        """Return the shares of correct answers; places and threshold are on the axis, and shapes broadcast."""
        grown = self.grow((places - threshold) / width)
        return np.clip(self.guess + (1.0 - self.guess - lapse) * grown, _RAREST, 1.0 - _RAREST)

    def distance_of(self, proportion: float, lapse: float) -> float:
        """Return the distance from the threshold, in widths, at which a share of correct answers is reached.

        Raises:
            ValueError: The function never has that share.
        """
        grown = (proportion - self.guess) / (1.0 - self.guess - lapse)
        if not 0.0 < grown < 1.0:
            raise ValueError(f"a share of {proportion:g} is not between {self.guess:g} and {1.0 - lapse:g}")
        if self.shape == "logistic":
            return math.log(grown / (1.0 - grown)) / _LOGISTIC
        if self.shape == "normal":
            return NormalDist().inv_cdf(grown) / _NORMAL
        return math.log(math.log(1.0 - grown) / _LN_HALF) / _WEIBULL
