"""Made-up experiments, thousands at once: how often the tests find what is not there, and what is.

    python packages/telenano-lab/tests/experiments/made_experiments.py

prints the tables of docs/experiments.md. People differ in everything: in the mean, in the effect of each factor and in
that of each interaction, each by a normal number of their own.
"""

import itertools
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from telenano_lab.experiments.power import Levels, expected
from telenano_lab.experiments.repeated_measures import Matrix, repeated_f

PEOPLE = 6, 12, 24
TRIALS = 4
# standard deviation of people's own effects, in that of a trial
SPREAD = 0.8


class Design(NamedTuple):
    """How many levels two factors have, and whether the second is a slope."""

    laws: int
    delays: int
    is_numeric: bool

    @property
    def factors(self) -> tuple[Levels, Levels]:
        """The factors as the analysis has them."""
        laws, delays = (tuple(float(level) for level in range(number)) for number in self[:2])
        return Levels("law", laws, False), Levels("delay", delays, self.is_numeric)

    def __str__(self) -> str:
        return f"{self.laws} x {self.delays}{'' if self.is_numeric else ' categories'}"


DESIGNS = tuple(Design(*size, numeric) for size in ((2, 3), (2, 5), (3, 4)) for numeric in (True, False))


def experiments(
    design: Design,
    number: int,
    people: int,
    trials: int,
    spread: float,
    seed: int,
    term: str = "",
    effect: float = 0.0,
    uneven: bool = True,
) -> Matrix:
    """Return the means of cells of made-up experiments, of shape (experiments, people, conditions).

    Args:
        design: The factors.
        number: How many experiments.
        people: How many people each has.
        trials: How many trials in each condition, each with a standard deviation of 1.
        spread: The standard deviation of people's own effects.
        seed: Decides all numbers.
        term: The factor or interaction that has an effect.
        effect: Its size.
        uneven: Whether people differ along one direction of each effect, as slopes do, or alike in all.
    """
    source = np.random.default_rng(seed)
    conditions = design.laws * design.delays
    cells = source.normal(0.0, trials**-0.5, (number, people, conditions)) + source.normal(
        0.0, 1.0, (number, people, 1)
    )
    for found in expected(design.factors):
        if found.term == term:
            cells += effect * found.pattern
        if uneven:
            cells += spread * source.normal(size=(number, people, 1)) * found.pattern
        else:
            size = spread * np.sqrt((found.pattern**2).sum())
            for contrast in found.contrasts:
                cells += size * source.normal(size=(number, people, 1)) * contrast
    return cells


def share_found(design: Design, cells: Matrix) -> dict[str, float]:
    """Return the share of experiments in which each effect has p < 0.05."""
    return {
        found.term: float(np.mean(repeated_f(cells, found.contrasts).p < 0.05)) for found in expected(design.factors)
    }


def type_i(
    number: int, designs: Sequence[Design] = DESIGNS, seed: int = 1
) -> Iterator[tuple[Design, int, dict[str, float]]]:
    """Yield how often each effect is found in experiments that have none: design, people, shares."""
    for design, people in itertools.product(designs, PEOPLE):
        yield design, people, share_found(design, experiments(design, number, people, TRIALS, SPREAD, seed))


def powers(
    number: int, designs: Sequence[Design] = DESIGNS, seed: int = 2
) -> Iterator[tuple[Design, str, int, float, float]]:
    """Yield design, effect, people, the power that is computed, and how often an effect of 1 is found."""
    for design, people in itertools.product(designs, PEOPLE):
        for found in expected(design.factors):
            cells = experiments(design, number, people, TRIALS, 0.5, seed, found.term, 1.0, uneven=False)
            simulated = share_found(design, cells)[found.term]
            yield design, found.term, people, found.power(people, TRIALS, 1.0, 0.5), simulated


def main() -> None:
    """Print both tables."""
    lines = ["p < 0.05 without an effect [%], 2000 experiments: law / delay / law × delay"]
    for design, people, shares in type_i(2000):
        found = "  ".join(f"{100.0 * share:4.1f}" for share in shares.values())
        lines.append(f"{design!s:18} {people:3} people  {found}")
    lines.append("power for an effect of 1, people differ by 0.5 [%]: computed, found in 2000 experiments")
    for design, term, people, computed, simulated in powers(2000):
        lines.append(f"{design!s:18} {term:12} {people:3} people  {100.0 * computed:5.1f} {100.0 * simulated:5.1f}")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
