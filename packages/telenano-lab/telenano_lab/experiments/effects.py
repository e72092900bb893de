"""Tests and effect sizes of one measure: the repeated-measures F of every effect, with its own error term.

The values are the means of each participant in each condition. Every effect, main or interaction, is tested against its
own variation over participants (`repeated_measures`). A numeric factor is a slope: its effect is one contrast, and so
is its part of an interaction. Other factors, and numeric ones treated as categories, are all differences of their
levels, with the correction of Huynh and Feldt for sphericity.

A participant without a value in some condition is left out of the tests, because the gap would act like an effect.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from telenano_lab.experiments.effect_sizes import compared, corrected, partial_eta2
from telenano_lab.experiments.repeated_measures import Matrix, RepeatedF, average, contrasts, product, repeated_f

MODEL = "repeated-measures F of participants' means, each effect with its own error term, Huynh–Feldt"
# Least number of participants of a test, beyond one for each further group.
LEAST_PEOPLE = 3
# F ratios beyond this arise from rounding alone.
_NO_SCATTER = 1e20


class Factor(NamedTuple):
    """A factor of the analysis.

    Args:
        name: Its name in the experiment's file.
        column: Its column in the table.
        unit: Its unit, or an empty string.
        levels: Its levels, in ascending order.
        is_numeric: Whether its effect is a slope.
        is_within: Whether some participant has more than one of its levels.
    """

    name: str
    column: str
    unit: str
    levels: tuple[Any, ...]
    is_numeric: bool
    is_within: bool


class Term(NamedTuple):
    """A factor or an interaction, tested as a whole, with partial η² and its interval.

    The degrees of freedom are uncorrected; the correction for sphericity multiplies both by `epsilon`.
    """

    term: str
    f: float
    df1: float
    df2: float
    p: float
    partial_eta2: float
    partial_eta2_low: float
    partial_eta2_high: float
    epsilon: float
    p_corrected: float | None = None


class Slope(NamedTuple):
    """The change of the measure per unit of a numeric factor, with its interval."""

    factor: str
    slope: float
    low: float
    high: float
    df: float
    p: float


class Pair(NamedTuple):
    """The difference of two levels over participants' means, and Hedges' g with its interval.

    `at` is the level of another factor at which they are compared, empty for a comparison over all of them.
    """

    factor: str
    level: Any
    against: Any
    difference: float
    low: float
    high: float
    df: float
    p: float
    g: float
    g_low: float
    g_high: float
    at: str = ""
    p_corrected: float | None = None


class Effects(NamedTuple):
    """The results of the tests of one measure, and their model.

    Args:
        model: The model in words.
        remarks: Sentences on what was left out.
        terms: Factors and interactions.
        slopes: Numeric factors.
        pairs: Comparisons of levels.
    """

    model: str
    remarks: tuple[str, ...]
    terms: tuple[Term, ...] = ()
    slopes: tuple[Slope, ...] = ()
    pairs: tuple[Pair, ...] = ()


def effects(
    frame: Any,
    measure: str,
    factors: Sequence[Factor],
    correction: str = "holm",
    confidence: float = 0.95,
    within: str = "",
) -> Effects:
    """Test the effects of factors on a measure.

    Args:
        frame: A pandas DataFrame with a row per trial: `participant`, the measure, the columns of the factors.
        measure: The column of the measure; booleans are 0 and 1.
        factors: The factors; one with values of the measure at a single level is left out, with a remark.
        correction: The correction of the comparisons of levels, one of CORRECTIONS.
        confidence: The confidence of all intervals.
        within: The factor at whose levels the other factors are compared; empty to compare over all of them.

    Returns:
        The effects; if nothing can be fitted, only remarks that give the reason.
    """
    data = frame[["participant", measure, *(factor.column for factor in factors)]].dropna()
    remarks: list[str] = []
    try:
        return _tested(data, measure, _with_values(data, factors, remarks), correction, confidence, within, remarks)
    except (ArithmeticError, ValueError) as error:
        # NumPy and SciPy raise these errors for degenerate data.
        return Effects("none", (*remarks, f"the values cannot be fitted ({error}): nothing is tested"))


def _with_values(data: Any, factors: Sequence[Factor], remarks: list[str]) -> list[Factor]:
    """Return the factors reduced to the rows that have a value of the measure."""
    rows = []
    for factor in factors:
        there = set(data[factor.column].tolist())
        levels = tuple(level for level in factor.levels if level in there)
        if len(levels) == 1:
            remarks.append(f"{factor.name} is not tested: there are values at {levels[0]} only")
        elif levels:
            is_within = bool((data.groupby("participant")[factor.column].nunique() > 1).any())
            rows.append(factor._replace(levels=levels, is_within=is_within))
    return rows


def _tested(
    data: Any,
    measure: str,
    factors: Sequence[Factor],
    correction: str,
    confidence: float,
    within: str,
    remarks: list[str],
) -> Effects:
    people = data["participant"].nunique()
    if people < 2 or not factors:
        lack = ("no trial has a value", "one participant has values")
        why = lack[people] if people < 2 else "no factor has values at two levels"
        return Effects("none", (*remarks, f"{why}: nothing is tested"))
    values = data[measure].to_numpy(float)
    if float(np.ptp(values)) <= 1e-12 * float(np.abs(values).max(initial=0.0)):
        return Effects("none", (*remarks, "every trial has the same value: nothing is tested"))
    cells = _cells(data, measure, factors, remarks)
    terms, slopes = _terms(cells, factors, remarks, confidence) if cells is not None else ((), ())
    pairs = _pairs(data, measure, factors, confidence, within)
    ps = corrected([pair.p for pair in pairs], correction)
    pairs = tuple(pair._replace(p_corrected=p) for pair, p in zip(pairs, ps, strict=True))
    return Effects(MODEL if terms or pairs else "none", tuple(remarks), terms, slopes, pairs)


class _Cells(NamedTuple):
    """The means of participants (rows) in all conditions within them, and the group of each participant."""

    means: Matrix
    groups: tuple[int, ...]


def _cells(data: Any, measure: str, factors: Sequence[Factor], remarks: list[str]) -> _Cells | None:
    """Return the cells of participants who have every condition; None, with a remark, if they are too few."""
    within = [factor for factor in factors if factor.is_within]
    between = [factor for factor in factors if not factor.is_within]
    means = _means(data, measure, within)
    people = list(dict.fromkeys(person for person, _ in means))
    conditions = list(itertools.product(*(factor.levels for factor in within)))
    missing = {person: [row for row in conditions if (person, row) not in means] for person in people}
    whole = [person for person in people if not missing[person]]
    if len(whole) < len(people):
        gaps = "; ".join(
            f"{person}: {_condition(within, rows[0])}{_and_more(rows)}" for person, rows in missing.items() if rows
        )
        remarks.append(f"participants without a value in every condition are in no test ({gaps})")
    kinds = list(itertools.product(*(factor.levels for factor in between)))
    first = data.drop_duplicates("participant").set_index("participant")
    groups = tuple(kinds.index(tuple(first.at[person, factor.column] for factor in between)) for person in whole)
    empty = [kind for number, kind in enumerate(kinds) if number not in groups]
    if whole and empty:
        remarks.append(f"no participant has every condition at {_condition(between, empty[0])}: nothing is tested")
        return None
    needed = LEAST_PEOPLE + len(kinds) - 1
    if len(whole) < needed:
        have = f"{len(whole)} participant{' has' if len(whole) == 1 else 's have'}"
        remarks.append(f"{have} a value in every condition, and a test needs {needed}: no effect is tested")
        return None
    return _Cells(np.array([[means[person, row] for row in conditions] for person in whole]), groups)


def _means(data: Any, measure: str, factors: Sequence[Factor]) -> dict[tuple[str, tuple[Any, ...]], float]:
    """Return the mean of each participant in each condition that they have."""
    columns = [factor.column for factor in factors]
    grouped = data.assign(_y=data[measure].astype(float)).groupby(["participant", *columns], sort=True)["_y"].mean()
    keys = (key if isinstance(key, tuple) else (key,) for key in grouped.index)
    return {(str(key[0]), key[1:]): float(mean) for key, mean in zip(keys, grouped, strict=True)}


def _condition(factors: Sequence[Factor], levels: Sequence[Any]) -> str:
    return ", ".join(f"{factor.name} = {level}" for factor, level in zip(factors, levels, strict=True))


def _and_more(rows: Sequence[Any]) -> str:
    return f" and {len(rows) - 1} more" if len(rows) > 1 else ""


def _terms(
    cells: _Cells, factors: Sequence[Factor], remarks: list[str], confidence: float
) -> tuple[tuple[Term, ...], tuple[Slope, ...]]:
    """Return the tests of all factors and interactions, and the slopes of numeric factors."""
    terms, slopes = [], []
    number_of_cells = math.prod(len(factor.levels) for factor in factors)
    for number in range(1, len(factors) + 1):
        for chosen in itertools.combinations(factors, number):
            title = " × ".join(factor.name for factor in chosen)
            tests = _test(cells, factors, chosen)
            f, epsilon, p = (float(part) for part in (tests.f, tests.epsilon, tests.p))
            if not f < _NO_SCATTER:
                remarks.append(f"every participant has the same difference: {title} is not tested")
                continue
            eta = partial_eta2(f, epsilon * tests.df1, epsilon * tests.df2, confidence)
            terms.append(Term(title, f, tests.df1, tests.df2, p, *eta, epsilon))
            if number == 1 and chosen[0].is_numeric:
                slopes.append(_slope(chosen[0], tests, number_of_cells, p, confidence))
    return tuple(terms), tuple(slopes)


def _test(cells: _Cells, factors: Sequence[Factor], chosen: Sequence[Factor]) -> RepeatedF:
    sides = []
    for is_within in (True, False):
        rows = [
            (
                contrasts(factor.levels if factor.is_numeric else len(factor.levels))
                if factor in chosen
                else average(len(factor.levels))
            )
            for factor in factors
            if factor.is_within is is_within
        ]
        sides.append(product(rows))
    return repeated_f(cells.means, sides[0], cells.groups, sides[1])


def _slope(factor: Factor, effect: RepeatedF, conditions: int, p: float, confidence: float) -> Slope:
    """Convert the estimate of a contrast of unit length over the levels into a slope per unit of the factor."""
    from scipy import stats

    levels = np.asarray(factor.levels, dtype=float)
    length = math.sqrt(float(((levels - levels.mean()) ** 2).sum()) * conditions / len(levels))
    slope, error = float(effect.estimate.item()) / length, math.sqrt(float(effect.variance.item())) / length
    half = float(stats.t.ppf(0.5 + 0.5 * confidence, effect.df2)) * error
    return Slope(factor.name, slope, slope - half, slope + half, effect.df2, p)


def _pairs(data: Any, measure: str, factors: Sequence[Factor], confidence: float, within: str) -> tuple[Pair, ...]:
    """Compare the levels of each factor; if `within` is one of them, those of the others at each of its levels.

    Only participants with a value in every compared condition count, and each condition has the same weight.
    """
    held = next((factor for factor in factors if factor.name == within), None)
    if held is not None:
        others = [factor for factor in factors if factor is not held]
        return tuple(
            pair._replace(at=f"{held.name} = {level}")
            for level in held.levels
            for pair in _pairs(data[data[held.column] == level], measure, others, confidence, "")
        )
    pairs = []
    for factor in factors:
        others = [other for other in factors if other.is_within and other is not factor]
        rows = list(itertools.product(*(other.levels for other in others)))
        cells = _means(data, measure, [factor, *others])
        people = sorted({person for person, _ in cells})
        means = {
            (person, level): math.fsum(cells[person, (level, *row)] for row in rows) / len(rows)
            for person in people
            for level in factor.levels
            if all((person, (level, *row)) in cells for row in rows)
        }
        for against, level in itertools.combinations(factor.levels, 2):
            left, right = (
                np.array([means[who, at] for who in people if (who, at) in means]) for at in (level, against)
            )
            both = [who for who in people if (who, level) in means and (who, against) in means]
            paired = np.array([means[who, level] - means[who, against] for who in both]) if factor.is_within else None
            pair = compared(left, right, paired, confidence)
            if pair is not None:
                pairs.append(Pair(factor.name, level, against, *pair))
    return tuple(pairs)


def as_rows(effects: Mapping[tuple[str, str], Effects], part: str) -> list[dict[str, Any]]:
    """Return the terms, slopes or pairs of several measures as rows with task and measure."""
    return [
        {"task": task, "measure": measure, **row._asdict()}
        for (task, measure), effect in effects.items()
        for row in getattr(effect, part)
    ]
