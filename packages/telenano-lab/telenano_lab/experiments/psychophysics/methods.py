"""Methods that choose the level of the next trial: constant stimuli, staircases, and QUEST+.

The state of a method is a function of its settings, its seed and the sequence of answers, so a resumed experiment
replays its journal: `replay` restores the method. A level has the unit of the factor that it sets.
"""

import random
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from pydantic import Field, RootModel, model_validator

from telenano.settings import Settings, validate
from telenano_lab.experiments.psychophysics.exact import Numbers, exp, log, total
from telenano_lab.experiments.psychophysics.fit import Answer, Estimate, fit, posterior
from telenano_lab.experiments.psychophysics.function import Psychometric

_MOST_TRIALS = 10_000


class Range(Settings):
    """Values between two ends, which belong to them."""

    low: float = Field(description="The least value")
    high: float = Field(description="The greatest value")
    count: int = Field(default=31, ge=2, le=201, description="Number of values")

    @model_validator(mode="after")
    def _has_a_length(self) -> "Range":
        if self.high <= self.low:
            raise ValueError(f"high is {self.high:g}, must be greater than low, {self.low:g}")
        return self

    def steps(self) -> Numbers:
        """Return values at equal differences."""
        return self.low + (self.high - self.low) * np.arange(self.count) / (self.count - 1)

    def ratios(self) -> Numbers:
        """Return values at equal ratios; both ends must be positive."""
        low, high = log(np.array([self.low, self.high]))
        return exp(low + (high - low) * np.arange(self.count) / (self.count - 1))


class _Adaptive(Settings):
    function: Psychometric = Field(default=Psychometric(), description="The family of functions that answers follow")
    proportion: float | None = Field(
        default=None,
        gt=0.0,
        lt=1.0,
        description="Share of correct answers that defines the threshold; midway between guess and 1 if not given",
    )
    confidence: float = Field(default=0.95, ge=0.5, le=0.999, description="Confidence of the interval")

    @model_validator(mode="after")
    def _reaches_the_proportion(self) -> "_Adaptive":
        if self.proportion is not None:
            self.function.distance_of(self.proportion, 0.0)
        return self

    def _must_be_positive(self, **values: float) -> None:
        for name, value in values.items():
            if self.function.axis == "log" and value <= 0.0:
                raise ValueError(f"{name} is {value:g}, must be greater than 0 on a logarithmic axis")


class ConstantSettings(_Adaptive):
    """Constant stimuli: fixed levels, each once in every repetition, in a seeded order."""

    method: Literal["constant"]
    levels: tuple[float, ...] = Field(min_length=2, max_length=100, description="The levels")
    repetitions: int = Field(ge=1, le=1000, description="Number of presentations of each level")

    @model_validator(mode="after")
    def _fits_the_axis(self) -> "ConstantSettings":
        self._must_be_positive(levels=min(self.levels))
        return self


class StaircaseSettings(_Adaptive):
    """A staircase: the level falls after n correct answers in a row and rises after a wrong one.

    It comes to rest where n correct answers in a row are as likely as not, at a share of 0.5^(1/n): H. Levitt, J.
    Acoust. Soc. Am. 49 (1971) 467.
    """

    method: Literal["staircase"]
    start: float = Field(description="The first level")
    downs: int = Field(default=2, ge=1, le=8, description="Correct answers in a row before the level falls")
    steps: tuple[float, ...] = Field(
        min_length=1,
        max_length=20,
        description="Step before the first reversal, before the second, …; the last one stays. Differences of the "
        "level, or on a logarithmic axis ratios greater than 1",
    )
    low: float = Field(description="The least level")
    high: float = Field(description="The greatest level")
    reversals: int = Field(default=12, ge=2, le=1000, description="Number of reversals with which it ends")
    discarded: int = Field(
        default=4,
        ge=0,
        le=1000,
        description="Number of the first reversals, which the mean of the reversals leaves out",
    )
    trials: int = Field(default=200, ge=1, le=_MOST_TRIALS, description="Largest number of trials, after which it ends")

    @model_validator(mode="after")
    def _can_move(self) -> "StaircaseSettings":
        if not self.low <= self.start <= self.high:
            raise ValueError(f"start is {self.start:g}, must be between low, {self.low:g}, and high, {self.high:g}")
        least = 1.0 if self.function.axis == "log" else 0.0
        if min(self.steps) <= least:
            raise ValueError(f"steps has {min(self.steps):g}, must be greater than {least:g}")
        if self.discarded >= self.reversals:
            raise ValueError(f"discarded is {self.discarded}, must be less than reversals, {self.reversals}")
        self._must_be_positive(low=self.low)
        return self


class QuestSettings(_Adaptive):
    """QUEST+: the level whose answer is expected to leave the least entropy of threshold, width and lapse rate.

    A. B. Watson, J. Vis. 17 (2017) 3:10. The prior is uniform over the values that are named here.
    """

    method: Literal["quest_plus"]
    levels: Range = Field(description="Levels that may be presented, at equal steps of the axis")
    thresholds: Range = Field(description="Thresholds that are thought possible, at equal steps of the axis")
    widths: Range = Field(
        description="Widths that are thought possible, at equal ratios: differences of the level, or of its logarithm"
    )
    lapses: tuple[float, ...] = Field(
        default=(0.0, 0.02, 0.04), min_length=1, max_length=20, description="Lapse rates that are thought possible"
    )
    trials: int = Field(default=60, ge=1, le=_MOST_TRIALS, description="Largest number of trials, after which it ends")
    precision: float = Field(
        default=0.0,
        ge=0.0,
        description="It ends when the standard deviation of the threshold, on its axis, is below this; 0: never",
    )

    @model_validator(mode="after")
    def _has_a_grid(self) -> "QuestSettings":
        self._must_be_positive(**{"levels.low": self.levels.low, "thresholds.low": self.thresholds.low})
        if self.widths.low <= 0.0:
            raise ValueError(f"widths.low is {self.widths.low:g}, must be greater than 0")
        if not all(0.0 <= lapse <= 0.3 for lapse in self.lapses):
            raise ValueError("lapses: each must be between 0 and 0.3")
        cells = self.levels.count * self.thresholds.count * self.widths.count * len(self.lapses)
        if cells > 2_000_000:
            raise ValueError(f"{cells} cells of level, threshold, width and lapse rate; at most 2 000 000 are computed")
        return self


AdaptiveSettings = Annotated[ConstantSettings | StaircaseSettings | QuestSettings, Field(discriminator="method")]


class Adaptive(RootModel[AdaptiveSettings]):
    """The settings of any method, as a factor of an experiment's file has them below `adaptive`."""


class Method(Protocol):
    """A method in the middle of its trials."""

    settings: Any
    answers: list[Answer]

    def next(self) -> float | None:
        """Return the level of the next trial; None when the method has ended."""

    def take(self, level: float, correct: bool) -> None:
        """Add an answer (True for correct or yes) at a level."""

    def estimate(self) -> Estimate:
        """Return the threshold estimated from the answers so far."""

    def summary(self) -> dict[str, float]:
        """Return the method's own figures on the threshold, by name."""


class _Base:
    def __init__(self, settings: Any) -> None:
        self.settings = settings
        self.answers: list[Answer] = []

    def take(self, level: float, correct: bool) -> None:
        """Add an answer at a level."""
        self.answers.append((float(level), bool(correct)))

    def estimate(self) -> Estimate:
        """Return the threshold estimated from the answers so far."""
        return fit(self.answers, self.settings.function, self.settings.proportion, self.settings.confidence)

    def summary(self) -> dict[str, float]:
        """Return no figures beyond those of the fit."""
        return {}


class ConstantStimuli(_Base):
    """Each level once in every repetition, in an order that depends on the seed."""

    def __init__(self, settings: ConstantSettings, seed: int) -> None:
        super().__init__(settings)
        source, self._order = random.Random(seed), []
        for _ in range(settings.repetitions):
            block = list(settings.levels)
            source.shuffle(block)
            self._order += block

    def next(self) -> float | None:
        """Return the level of the next trial; None after all repetitions."""
        done = len(self.answers)
        return self._order[done] if done < len(self._order) else None


class Staircase(_Base):
    """A level that falls after several correct answers in a row, and rises after a wrong one."""

    def __init__(self, settings: StaircaseSettings) -> None:
        super().__init__(settings)
        self.reversals: list[float] = []
        self._level, self._in_a_row, self._direction = settings.start, 0, 0

    def next(self) -> float | None:
        """Return the level of the next trial; None after enough reversals or trials."""
        ended = len(self.reversals) >= self.settings.reversals or len(self.answers) >= self.settings.trials
        return None if ended else self._level

    def take(self, level: float, correct: bool) -> None:
        super().take(level, correct)
        self._in_a_row = self._in_a_row + 1 if correct else 0
        if correct and self._in_a_row < self.settings.downs:
            return
        self._in_a_row = 0
        direction = -1 if correct else 1
        if self._direction and direction != self._direction:
            self.reversals.append(self._level)
        self._direction = direction
        self._level = self._moved(direction)

    def summary(self) -> dict[str, float]:
        """Return the share of correct answers to which it converges, the number of reversals, and their mean level."""
        used = self.reversals[self.settings.discarded :]
        used = used[len(used) % 2 :]
        facts = {"target": 0.5 ** (1.0 / self.settings.downs), "reversals": float(len(self.reversals))}
        if used:
            function = self.settings.function
            places = function.on_axis(used)
            facts["mean_of_reversals"] = float(function.from_axis([total(places) / len(used)])[0])
        return facts

    def _moved(self, direction: int) -> float:
        settings = self.settings
        step = settings.steps[min(len(self.reversals), len(settings.steps) - 1)]
        if settings.function.axis == "log":
            moved = self._level * step if direction > 0 else self._level / step
        else:
            moved = self._level + direction * step
        return float(min(max(moved, settings.low), settings.high))


class QuestPlus(_Base):
    """The level whose answer is expected to leave the least entropy."""

    def __init__(self, settings: QuestSettings) -> None:
        super().__init__(settings)
        function = settings.function
        spaced = Range.ratios if function.axis == "log" else Range.steps
        self.levels = spaced(settings.levels)
        grids = function.on_axis(spaced(settings.thresholds)), settings.widths.ratios(), np.asarray(settings.lapses)
        self._prior = (float(grids[0][0]), float(grids[0][-1])), grids[1], grids[2]
        self._thresholds, self._widths, self._lapses = (part.ravel() for part in np.meshgrid(*grids, indexing="ij"))
        shares = np.stack([self._shares(level) for level in self.levels])
        self._tables = [(table, log(table)) for table in (shares, 1.0 - shares)]
        cells = len(self._thresholds)
        self.posterior = np.full(cells, 1.0 / cells)
        self._logarithm = log(self.posterior)

    def next(self) -> float | None:
        """Return the level of the next trial; None after the last one, or once the threshold is precise enough."""
        settings = self.settings
        if len(self.answers) >= settings.trials or (self.answers and self._deviation() < settings.precision):
            return None
        return float(self.levels[int(np.argmin(self.entropies()))])

    def take(self, level: float, correct: bool) -> None:
        super().take(level, correct)
        share = self._shares(level)
        share = share if correct else 1.0 - share
        weighted = self.posterior * share
        sum_of_all = total(weighted)
        self.posterior = weighted / sum_of_all
        self._logarithm = self._logarithm + log(share) - log(sum_of_all)

    def estimate(self) -> Estimate:
        """Return the median of the posterior, with its credible interval."""
        settings = self.settings
        return posterior(self.answers, settings.function, *self._prior, settings.proportion, settings.confidence)

    def entropies(self) -> Numbers:
        """Return the expected entropy after the next answer, for each level."""
        result = np.zeros(len(self.levels))
        for table, logarithm in self._tables:
            weighted = self.posterior * table
            chance = total(weighted)
            # -Σ p ln p of the posterior p = weighted / chance, times the probability of this answer.
            result = result + chance * log(chance) - total(weighted * (self._logarithm + logarithm))
        return result

    def summary(self) -> dict[str, float]:
        """Return the posterior mean of the threshold as a level, and its standard deviation on the axis."""
        mean = self.settings.function.from_axis([self._mean()])[0]
        return {"posterior_mean": float(mean), "posterior_deviation_on_axis": self._deviation()}

    def _mean(self) -> float:
        return float(total(self.posterior * self._thresholds))

    def _deviation(self) -> float:
        away = self._thresholds - self._mean()
        return float(np.sqrt(total(self.posterior * away * away)))

    def _shares(self, level: float) -> Numbers:
        function: Psychometric = self.settings.function
        return function.share(function.on_axis([level]), self._thresholds, self._widths, self._lapses)


def checked(settings: Mapping[str, Any], origin: str = "adaptive") -> Any:
    """Return the checked settings of a method from those of an experiment's file.

    Without a `method` it is QUEST+, which has the narrowest intervals for a number of trials (docs/experiments.md).

    Raises:
        ConfigError: A key is wrong; the error names it after `origin`.
    """
    return validate(Adaptive, {"method": "quest_plus", **settings}, origin).root


def most_trials(settings: Mapping[str, Any]) -> int:
    """Return the greatest number of trials of a method; ConfigError for wrong settings."""
    checked_settings = checked(settings)
    return (
        len(checked_settings.levels) * checked_settings.repetitions
        if isinstance(checked_settings, ConstantSettings)
        else checked_settings.trials
    )


def extreme_levels(settings: Mapping[str, Any]) -> tuple[float, float]:
    """Return the least and the greatest level that a method can present; ConfigError for wrong settings."""
    found = checked(settings)
    if isinstance(found, ConstantSettings):
        return min(found.levels), max(found.levels)
    ends = found if isinstance(found, StaircaseSettings) else found.levels
    return ends.low, ends.high


def make(settings: Mapping[str, Any], seed: int, origin: str = "adaptive") -> Method:
    """Return a method before its first trial.

    Args:
        settings: Its settings, with `method`: constant, staircase or quest_plus.
        seed: Decides the order of constant stimuli; the other methods draw nothing.
        origin: The file and key that an error names.

    Raises:
        ConfigError: A key of the settings is wrong.
    """
    checked_settings = checked(settings, origin)
    if isinstance(checked_settings, ConstantSettings):
        return ConstantStimuli(checked_settings, seed)
    return (
        Staircase(checked_settings) if isinstance(checked_settings, StaircaseSettings) else QuestPlus(checked_settings)
    )


def replay(settings: Mapping[str, Any], seed: int, answers: Iterable[Answer]) -> Method:
    """Return the state of a method after recorded answers."""
    method = make(settings, seed)
    for level, correct in answers:
        method.take(level, correct)
    return method
