"""Tests and effect sizes of one measure: a mixed-effects model, or a repeated-measures analysis of variance.

The mixed model has the factors and their two-way interactions as fixed effects. A numeric factor is a slope, others are
sum-coded, so each term is an average over the others. Random effects are chosen by a rule, from the first model that
converges: (1) an intercept and an effect of each factor for each participant, uncorrelated (D. J. Barr and others, J.
Mem. Lang. 68 (2013) 255); (2) an intercept alone; (3) none: the analysis of variance of participants' means.

Tests of the mixed model are F tests. Their denominator has the degrees of freedom of the participants where each
participant has an effect of that factor of their own, and those of the residuals where not (J. C. Pinheiro and D. M.
Bates, Mixed-Effects Models in S and S-PLUS (2000), section 2.4.2).
"""

import itertools
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from telenano_experiments.effect_sizes import Matrix, compared, corrected, partial_eta2, sphericity

Test = Literal["mixed", "anova"]
# one after the other, until a search for the greatest likelihood ends
_SEARCHES = ("bfgs", "lbfgs", "powell")
# F ratios beyond it come of rounding alone
_NO_SCATTER = 1e20


class Factor(NamedTuple):
    """A factor of the analysis.

    Args:
        name: Its name in the experiment's file.
        column: Its column in the table.
        unit: Its unit, empty where it has none.
        levels: Its levels, in ascending order.
        is_numeric: Whether it is a slope in the mixed model.
        is_within: Whether each participant has more than one of its levels.
    """

    name: str
    column: str
    unit: str
    levels: tuple[Any, ...]
    is_numeric: bool
    is_within: bool


class Term(NamedTuple):
    """A factor or an interaction, tested as a whole, with partial η² and its interval."""

    term: str
    test: str
    f: float
    df1: float
    df2: float
    p: float
    partial_eta2: float
    partial_eta2_low: float
    partial_eta2_high: float
    epsilon: float | None = None
    p_corrected: float | None = None


class Slope(NamedTuple):
    """The change of the measure for each unit of a numeric factor, with its interval."""

    factor: str
    slope: float
    low: float
    high: float
    df: float
    p: float


class Pair(NamedTuple):
    """The difference of two levels over participants' means, and Hedges' g with its interval.

    `at` is the level of another factor that the comparison is within, empty for one over all of them.
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
    """What the tests of one measure say, and how they were made.

    Args:
        model: The model in words.
        remarks: Where the rule went on to a simpler model, and what was left out.
        terms: Factors and interactions.
        slopes: Numeric factors.
        pairs: Levels against one another.
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
    test: Test = "mixed",
    correction: str = "holm",
    confidence: float = 0.95,
    within: str = "",
) -> Effects:
    """Test the effects of factors on a measure.

    Args:
        frame: A pandas DataFrame with a row a trial: `participant`, the measure, the columns of the factors.
        measure: The column of the measure; booleans are 0 and 1.
        factors: The factors; one at a single level of which the measure has values is left out, with a remark.
        test: The test to begin with.
        correction: The correction of the comparisons of levels, one of CORRECTIONS.
        confidence: The confidence of all intervals.
        within: The factor within whose levels those of the others are compared; empty compares over all of them.

    Returns:
        The effects; where nothing can be fitted, the remarks alone, which say why.
    """
    data = frame[["participant", measure, *(factor.column for factor in factors)]].dropna()
    remarks: list[str] = []
    try:
        return _tested(
            data, measure, _with_values(data, factors, remarks), test, correction, confidence, within, remarks
        )
    except (ArithmeticError, ValueError) as error:
        # numpy, scipy and statsmodels raise these of data from which nothing follows
        return Effects("none", (*remarks, f"the values cannot be fitted ({error}): nothing is tested"))


def _with_values(data: Any, factors: Sequence[Factor], remarks: list[str]) -> list[Factor]:
    """Return the factors as they are in the rows that have a value of the measure."""
    found = []
    for factor in factors:
        there = set(data[factor.column].tolist())
        levels = tuple(level for level in factor.levels if level in there)
        if len(levels) == 1:
            remarks.append(f"{factor.name} is not tested: there are values at {levels[0]} only")
        elif levels:
            is_within = bool((data.groupby("participant")[factor.column].nunique() > 1).any())
            found.append(factor._replace(levels=levels, is_within=is_within))
    return found


def _tested(
    data: Any,
    measure: str,
    factors: Sequence[Factor],
    test: Test,
    correction: str,
    confidence: float,
    within: str,
    remarks: list[str],
) -> Effects:
    people = data["participant"].nunique()
    if people < 2 or not factors:
        why = "one participant" if people < 2 else "no factor with two levels"
        return Effects("none", (*remarks, f"{why}: nothing is tested"))
    values = data[measure].to_numpy(float)
    if float(np.ptp(values)) <= 1e-12 * float(np.abs(values).max(initial=0.0)):
        return Effects("none", (*remarks, "every trial has the same value: nothing is tested"))
    fitted = _mixed(data, values, factors, remarks) if test == "mixed" else None
    if fitted is not None:
        terms, slopes = _terms_of(fitted, confidence), _slopes_of(fitted, confidence)
        model = fitted.words
    else:
        terms, slopes = _anova(data, measure, factors, remarks, confidence), ()
        model = "repeated-measures analysis of variance of participants' means, Greenhouse–Geisser"
    pairs = _pairs(data, measure, factors, confidence, within)
    ps = corrected([pair.p for pair in pairs], correction)
    pairs = tuple(pair._replace(p_corrected=p) for pair, p in zip(pairs, ps, strict=True))
    return Effects(model, tuple(remarks), terms, slopes, pairs)


class _Column(NamedTuple):
    """A factor as columns of the design: sum-coded contrasts, or the number itself in standard deviations."""

    factor: Factor
    fixed: Matrix
    random: Matrix
    scale: float


class _Fitted(NamedTuple):
    words: str
    terms: tuple[tuple[tuple[_Column, ...], slice], ...]
    estimate: Matrix
    covariance: Matrix
    scale: float
    own_effects: bool
    people: int
    residual_df: int


def _mixed(data: Any, values: Matrix, factors: Sequence[Factor], remarks: list[str]) -> _Fitted | None:
    """Fit the first model of the rule that converges; None where none does."""
    columns = [_column(data[factor.column], factor) for factor in factors]
    terms = [(column,) for column in columns] + list(itertools.combinations(columns, 2))
    blocks, slices, start = [np.ones((len(data), 1))], [], 1
    for term in terms:
        blocks.append(_products([column.fixed for column in term]))
        slices.append(slice(start, start := start + blocks[-1].shape[1]))
    design = np.hstack(blocks)
    if np.linalg.matrix_rank(design) < design.shape[1]:
        remarks.append("the conditions do not tell all effects apart, so the mixed model was not fitted")
        return None
    scale = float(values.std())
    groups = data["participant"].to_numpy()
    shared = len(np.unique(groups)), len(data) - design.shape[1] - len(np.unique(groups)) + 1
    within = [column for column in columns if column.factor.is_within]
    standard = (values - values.mean()) / scale
    for own in (True, False) if within else (False,):
        words = "random intercept" + (f" and effects of {_names(within)}" if own else "") + " for each participant"
        result, why = _fit_mixed(standard, design, groups, within if own else [])
        if result is not None:
            fixed = design.shape[1]
            covariance = np.asarray(result.cov_params())[:fixed, :fixed]
            pairs = tuple(zip(terms, slices, strict=True))
            estimate = np.asarray(result.fe_params, dtype=float)
            return _Fitted(
                f"linear mixed-effects model (REML), {words}", pairs, estimate, covariance, scale, own, *shared
            )
        remarks.append(f"the mixed model with {words} did not converge ({why})")
    return None


def _fit_mixed(values: Matrix, design: Matrix, groups: Any, own: Sequence[_Column]) -> tuple[Any, str]:
    """Return the fitted model, or None and why it cannot be used."""
    from statsmodels.regression.mixed_linear_model import MixedLM, VCSpec

    labels = sorted(set(groups))
    parts = [[column.random[groups == label] for label in labels] for column in own]
    names = [[[f"{j}" for j in range(part.shape[1])] for part in of_factor] for of_factor in parts]
    spec = VCSpec([column.factor.name for column in own], names, parts) if own else None
    intercept, why = np.ones((len(values), 1)), ""
    for search in _SEARCHES:
        with warnings.catch_warnings():
            # what matters of them is judged below, and named
            warnings.simplefilter("ignore")
            try:
                model = MixedLM(values, design, groups, exog_re=intercept, exog_vc=spec)
                result = model.fit(reml=True, method=search)
                errors = np.asarray(result.bse_fe, dtype=float)
            except (ArithmeticError, ValueError) as error:
                why = str(error)
                continue
        if not result.converged:
            why = "the search for the greatest likelihood did not end"
        elif not np.all(np.isfinite(errors)) or np.any(errors <= 0.0):
            why = "standard errors are not finite"
        else:
            return result, ""
    return None, why


def _terms_of(fitted: _Fitted, confidence: float) -> tuple[Term, ...]:
    from scipy import stats

    found = []
    for columns, part in fitted.terms:
        estimate, covariance = fitted.estimate[part], fitted.covariance[part, part]
        df1, df2 = len(estimate), _denominator(fitted, columns)
        f = float(estimate @ np.linalg.solve(covariance, estimate)) / df1
        eta = partial_eta2(f, df1, df2, confidence)
        name = _names([column for column in columns], " × ")
        found.append(Term(name, "F test of the mixed model", f, df1, df2, float(stats.f.sf(f, df1, df2)), *eta))
    return tuple(found)


def _slopes_of(fitted: _Fitted, confidence: float) -> tuple[Slope, ...]:
    from scipy import stats

    found = []
    for columns, part in fitted.terms:
        if len(columns) > 1 or not columns[0].factor.is_numeric:
            continue
        ratio = fitted.scale / columns[0].scale
        slope = float(fitted.estimate[part][0]) * ratio
        error = math.sqrt(float(fitted.covariance[part, part][0, 0])) * ratio
        df = _denominator(fitted, columns)
        half = float(stats.t.ppf(0.5 + 0.5 * confidence, df)) * error
        p = 2.0 * float(stats.t.sf(abs(slope) / error, df))
        found.append(Slope(columns[0].factor.name, slope, slope - half, slope + half, df, p))
    return tuple(found)


def _denominator(fitted: _Fitted, columns: Sequence[_Column]) -> float:
    """Return the degrees of freedom of the denominator: of participants, or of residuals."""
    between = [column for column in columns if not column.factor.is_within]
    if between and len(between) == len(columns):
        groups = math.prod(len(column.factor.levels) for column in between)
        return float(max(fitted.people - groups, 1))
    if fitted.own_effects and len(columns) == 1:
        contrasts = 1 if columns[0].factor.is_numeric else len(columns[0].factor.levels) - 1
        return float(contrasts * (fitted.people - 1))
    return float(max(fitted.residual_df, 1))


def _column(values: Any, factor: Factor) -> _Column:
    if factor.is_numeric:
        numbers = values.to_numpy(float)
        scale = float(numbers.std())
        standard = ((numbers - numbers.mean()) / scale)[:, None]
        return _Column(factor, standard, standard, scale)
    dummies = np.stack([(values == level).to_numpy(float) for level in factor.levels], axis=1)
    return _Column(factor, dummies[:, :-1] - dummies[:, -1:], dummies, 1.0)


def _products(parts: Sequence[Matrix]) -> Matrix:
    """Return the products of every column of one part with every column of the next."""
    result = parts[0]
    for part in parts[1:]:
        result = (result[:, :, None] * part[:, None, :]).reshape(len(result), -1)
    return result


def _names(columns: Sequence[_Column], between: str = ", ") -> str:
    return between.join(column.factor.name for column in columns)


def _anova(
    data: Any, measure: str, factors: Sequence[Factor], remarks: list[str], confidence: float
) -> tuple[Term, ...]:
    """Return the terms of the repeated-measures analysis of variance, of participants who have every condition."""
    from scipy import stats
    from statsmodels.stats.anova import AnovaRM

    within = [factor for factor in factors if factor.is_within]
    if len(within) < len(factors):
        left = ", ".join(factor.name for factor in factors if not factor.is_within)
        remarks.append(f"{left}: differs between participants and is not in the analysis of variance")
    if not within:
        return ()
    names = {factor.column: f"f{number}" for number, factor in enumerate(within)}
    renamed = data.rename(columns={measure: "y", **names}).assign(y=lambda found: found["y"].astype(float))
    cells = renamed.pivot_table(index="participant", columns=list(names.values()), values="y", aggfunc="mean")
    whole = cells.dropna()
    if whole.shape[1] < math.prod(len(factor.levels) for factor in within) or len(whole) < 2:
        remarks.append("fewer than two participants have every condition: no analysis of variance")
        return ()
    if len(whole) < len(cells):
        remarks.append(f"{len(cells) - len(whole)} participants without every condition are not in it")
    long = whole.stack(list(names.values()), future_stack=True).rename("y").reset_index()
    rows = AnovaRM(long, "y", "participant", within=list(names.values())).fit().anova_table
    found = []
    for label, row in rows.iterrows():
        parts = str(label).split(":")
        f, df1, df2 = (float(row[key]) for key in ("F Value", "Num DF", "Den DF"))
        sizes = [(len(factor.levels), names[factor.column] in parts) for factor in within]
        epsilon = sphericity(whole.to_numpy(float), sizes)
        title = " × ".join(factor.name for factor in within if names[factor.column] in parts)
        if not f < _NO_SCATTER:
            remarks.append(f"every participant has the same difference: {title} is not tested")
            continue
        p = float(stats.f.sf(f, epsilon * df1, epsilon * df2))
        eta = partial_eta2(f, df1, df2, confidence)
        found.append(Term(title, "repeated measures, Greenhouse–Geisser", f, df1, df2, p, *eta, epsilon))
    return tuple(found)


def _pairs(data: Any, measure: str, factors: Sequence[Factor], confidence: float, within: str) -> tuple[Pair, ...]:
    """Compare the levels of each factor, where `within` is one of them those of the others at each of its levels."""
    held = next((factor for factor in factors if factor.name == within), None)
    if held is not None:
        others = [factor for factor in factors if factor is not held]
        return tuple(
            pair._replace(at=f"{held.name} = {level}")
            for level in held.levels
            for pair in _pairs(data[data[held.column] == level], measure, others, confidence, "")
        )
    found = []
    for factor in factors:
        means = data.assign(_y=data[measure].astype(float)).pivot_table(
            index="participant", columns=factor.column, values="_y", aggfunc="mean"
        )
        # a level of this factor may have no value at the one level of `within`
        means = means.reindex(columns=factor.levels)
        for against, level in itertools.combinations(factor.levels, 2):
            left, right = means[level].dropna().to_numpy(float), means[against].dropna().to_numpy(float)
            both = means[[level, against]].dropna()
            paired = both[level].to_numpy(float) - both[against].to_numpy(float) if factor.is_within else None
            pair = compared(left, right, paired, confidence)
            if pair is not None:
                found.append(Pair(factor.name, level, against, *pair))
    return tuple(found)


def as_rows(found: Mapping[tuple[str, str], Effects], part: str) -> list[dict[str, Any]]:
    """Return the terms, slopes or pairs of several measures as rows, each with task and measure."""
    return [
        {"task": task, "measure": measure, **row._asdict()}
        for (task, measure), effect in found.items()
        for row in getattr(effect, part)
    ]
