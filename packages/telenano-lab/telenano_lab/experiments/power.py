"""Power analysis: the number of people and trials that an effect needs, for the F test of the analysis.

The unit of all effects is the standard deviation of one person's trials in one condition. An effect is the difference
of the extreme levels of a factor, or of such differences in an interaction. People's own effects differ by a normally
distributed number. The score of a person (`repeated_measures`) then has a variance from the trials and one from the
person, and the F ratio has the noncentral distribution. For three or more levels without a slope, all levels but the
extreme ones are assumed midway, which gives the least effect for that difference, and people vary equally in all
contrasts (J. Cohen, Statistical Power Analysis for the Behavioral Sciences, 2nd ed. (1988), section 8.2).
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from telenano_lab.experiments.effects import LEAST_PEOPLE
from telenano_lab.experiments.psychophysics.exact import total
from telenano_lab.experiments.repeated_measures import Matrix, average, contrasts, product

# Greatest number of people that is tried.
MOST_PEOPLE = 1000
_ALPHA = 0.05


class Levels(NamedTuple):
    """A factor within participants: its name, its levels, and whether its effect is a slope over them."""

    name: str
    levels: tuple[float, ...]
    is_numeric: bool


class ExpectedEffect(NamedTuple):
    """An effect whose power is computed.

    Args:
        term: The factor or interaction.
        contrasts: Its orthonormal contrasts, a row each over all conditions.
        pattern: The means of the conditions for an effect of 1.
    """

    term: str
    contrasts: Matrix
    pattern: Matrix

    def power(self, people: int, trials: int, effect: float, spread: float) -> float:
        """Return the probability that the test finds the effect at p < 0.05; 0 for fewer people than the test needs.

        Args:
            people: The number of participants.
            trials: The number of trials of each participant in each condition.
            effect: The size of the effect.
            spread: The standard deviation of people's own effects.
        """
        from scipy import stats

        if people < LEAST_PEOPLE:
            return 0.0
        df1 = len(self.contrasts)
        df2 = df1 * (people - 1)
        square = float(total(self.pattern * self.pattern))
        centre = people * effect * effect * square / (1.0 / trials + spread * spread * square)
        return float(stats.ncf.sf(stats.f.isf(_ALPHA, df1, df2), df1, df2, centre))

    def people(self, power: float, trials: int, effect: float, spread: float) -> int | None:
        """Return the least number of people with that power; None if it exceeds MOST_PEOPLE."""
        low, high = LEAST_PEOPLE - 1, MOST_PEOPLE + 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self.power(middle, trials, effect, spread) >= power else (middle, high)
        return high if high <= MOST_PEOPLE else None


def expected(factors: Sequence[Levels]) -> Iterator[ExpectedEffect]:
    """Yield every factor and interaction of a design."""
    for number in range(1, len(factors) + 1):
        for chosen in itertools.combinations(factors, number):
            rows, pattern = [], np.ones(1)
            for factor in factors:
                is_in = factor in chosen
                kind = factor.levels if factor.is_numeric else len(factor.levels)
                rows.append(contrasts(kind) if is_in else average(len(factor.levels)))
                own = _between_extremes(factor) if is_in else np.ones(len(factor.levels))
                pattern = (pattern[:, None] * own).ravel()
            yield ExpectedEffect(" × ".join(factor.name for factor in chosen), product(rows), pattern)


def _between_extremes(factor: Levels) -> Matrix:
    """Return the means of the levels for a difference of 1 between the extremes and a mean of 0."""
    if not factor.is_numeric:
        return np.array([-0.5, *[0.0] * (len(factor.levels) - 2), 0.5])
    numbers = np.asarray(factor.levels)
    centred = numbers - total(numbers) / len(numbers)
    return np.asarray(centred / (numbers.max() - numbers.min()))
