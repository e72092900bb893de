"""The analysis of an experiment from its tables: descriptive statistics, tests, effect sizes and thresholds.

`analyse` needs only the tables, so a notebook that reads the Parquet file gives the same results as the command.
"""

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from telenano.analysis import wilson
from telenano.wire import ConfigError, known_names
from telenano_lab.experiments.effect_sizes import CORRECTIONS, corrected, mean_interval
from telenano_lab.experiments.effects import Effects, Factor, as_rows, effects
from telenano_lab.experiments.psychophysics.detection import detection
from telenano_lab.experiments.psychophysics.methods import replay
from telenano_lab.experiments.table import ANSWER, CONDITION, FIXED, Row, Tables

PACKAGES = ("telenano", "numpy", "scipy", "pandas", "statsmodels", "matplotlib")


class Choice(NamedTuple):
    """Options of an analysis.

    Args:
        measures: The measures to analyse; empty for all.
        correction: The correction for multiple comparisons, one of `CORRECTIONS`.
        confidence: The confidence of all intervals.
        categories: Numeric factors to treat as categories rather than slopes.
        within: The factor at whose levels the other factors are compared; empty to compare over all of them.
    """

    measures: tuple[str, ...] = ()
    correction: str = "holm"
    confidence: float = 0.95
    categories: tuple[str, ...] = ()
    within: str = ""


class Analysis(NamedTuple):
    """The results of an analysis.

    Args:
        counts: Numbers of participants and trials, by status.
        factors: The factors of each task.
        measures: The analysed measures of each task, with their units.
        cells: A row for each task, measure and condition: count, mean, interval, deviation, quartiles, extremes.
        effects: The tests by task and measure.
        thresholds: A row for each participant and condition of an adaptive factor.
        detections: d' and criterion of each participant and condition, if a task is one of detection.
        choice: The options of the analysis.
    """

    counts: dict[str, int]
    factors: dict[str, tuple[Factor, ...]]
    measures: dict[str, dict[str, str]]
    cells: list[Row]
    effects: dict[tuple[str, str], Effects]
    thresholds: list[Row]
    detections: list[Row]
    choice: Choice

    def as_dict(self) -> dict[str, Any]:
        """Return the results as a dict that JSON can hold."""
        return {
            "counts": self.counts,
            "choice": self.choice._asdict(),
            "factors": {task: [factor._asdict() for factor in factors] for task, factors in self.factors.items()},
            "measures": self.measures,
            "models": [
                {"task": task, "measure": measure, "model": factors.model, "remarks": list(factors.remarks)}
                for (task, measure), factors in self.effects.items()
            ],
            **{part: as_rows(self.effects, part) for part in ("terms", "slopes", "pairs")},
            "cells": self.cells,
            "thresholds": self.thresholds,
            "detections": self.detections,
            "versions": versions(),
        }


EVERYTHING = Choice()


def versions() -> dict[str, str]:
    """Return the versions of the packages that the results of an analysis depend on."""
    return {name: version(name) for name in PACKAGES}


def analyse(
    tables: Tables, choice: Choice = EVERYTHING, adaptive: Mapping[str, Mapping[str, Any]] | None = None
) -> Analysis:
    """Analyse the completed trials of the main phase, without excluded participants.

    Args:
        tables: The tables of the experiment.
        choice: The options.
        adaptive: The settings of each adaptive factor, by name; their thresholds are fitted.

    Raises:
        ConfigError: A measure, factor or correction is not known, or no trial counts.
    """
    import pandas as pd

    check_choice(tables, choice)
    rows = [row for row in tables.trials if row["phase"] == "main" and row["status"] == "done" and not row["excluded"]]
    if not rows:
        raise ConfigError("no trial counts: none of the main phase was done by a participant who is not excluded")
    frame = pd.DataFrame(rows)
    known = measures_of(tables)
    fitted = dict(adaptive or {})
    factors, measures, cells, tested = {}, {}, [], {}
    for task, of_task in frame.groupby("task", sort=True):
        factors_of_task = tuple(
            factor for factor in _factors(of_task, tables, choice.categories) if factor.name not in fitted
        )
        chosen = {name: unit for name, unit in known.items() if _is_measured(of_task, name, choice.measures)}
        factors[str(task)], measures[str(task)] = factors_of_task, chosen
        for name in chosen:
            cells += _cells(of_task, str(task), name, factors_of_task, choice.confidence)
            result = effects(of_task, name, factors_of_task, choice.correction, choice.confidence, choice.within)
            if result.terms and _is_yes_or_no(of_task[name].dropna()):
                remark = "yes and no are taken as 1 and 0, so that differences are of shares"
                result = result._replace(remarks=(*result.remarks, remark))
            tested[str(task), name] = result
    thresholds = [row for name, settings in fitted.items() for row in _thresholds(frame, name, settings)]
    for task, factors_of_task in factors.items():
        rows_of_task = [row for row in thresholds if row["task"] == task]
        if rows_of_task and factors_of_task:
            name = f"threshold of {rows_of_task[0]['factor']}"
            tracks = pd.DataFrame(rows_of_task).rename(
                columns={factor.name: factor.column for factor in factors_of_task}
            )
            cells += _cells(tracks.rename(columns={"threshold": name}), task, name, factors_of_task, choice.confidence)
            tested[task, name] = effects(
                tracks, "threshold", factors_of_task, choice.correction, choice.confidence, choice.within
            )
    detections = _detections(frame, factors, choice.confidence)
    terms = _terms_corrected(tested, choice.correction)
    return Analysis(_counts(tables, rows), factors, measures, cells, terms, thresholds, detections, choice)


def check_choice(tables: Tables, choice: Choice) -> None:
    """Raise ConfigError if a chosen measure, factor or correction is not known."""
    if choice.correction not in CORRECTIONS:
        raise ConfigError(f"correction {choice.correction}: {known_names(choice.correction, CORRECTIONS)}")
    measures = measures_of(tables)
    factors = [row.name.removeprefix(CONDITION) for row in tables.dictionary if row.name.startswith(CONDITION)]
    within = (choice.within,) if choice.within else ()
    for kind, names, there in (
        ("measure", choice.measures, measures),
        ("factor", (*choice.categories, *within), factors),
    ):
        for name in names:
            if name not in there:
                raise ConfigError(f"{kind} {name}: {known_names(name, there)}")


def measures_of(tables: Tables) -> dict[str, str]:
    """Return the numeric and boolean measures of the table, with their units."""
    return {
        row.name: row.unit
        for row in tables.dictionary
        if row.table == "trials" and row.type != "text" and row.name not in FIXED and not row.name.startswith(CONDITION)
    }


def _is_measured(frame: Any, name: str, chosen: Sequence[str]) -> bool:
    return (not chosen or name in chosen) and bool(frame[name].notna().any())


def _factors(frame: Any, tables: Tables, categories: Sequence[str]) -> list[Factor]:
    factors = []
    for column in (name for name in frame.columns if name.startswith(CONDITION)):
        levels = sorted(frame[column].dropna().unique().tolist())
        if len(levels) < 2:
            continue
        name = column.removeprefix(CONDITION)
        is_number = all(isinstance(level, int | float) and not isinstance(level, bool) for level in levels)
        is_within = bool((frame.groupby("participant")[column].nunique() > 1).any())
        numeric = is_number and name not in categories
        factors.append(Factor(name, column, tables.unit(column), tuple(levels), numeric, is_within))
    return factors


def _counts(tables: Tables, rows: Sequence[Row]) -> dict[str, int]:
    main = [row for row in tables.trials if row["phase"] == "main"]
    return {
        "participants": len({row["participant"] for row in rows}),
        "excluded": len({row["participant"] for row in main if row["excluded"]}),
        "trials": len(rows),
        "disturbed": sum(row["status"] == "disturbed" for row in main),
        "aborted": sum(row["status"] == "aborted" for row in main),
        "practice": len(tables.trials) - len(main),
    }


def _cells(frame: Any, task: str, measure: str, factors: Sequence[Factor], confidence: float) -> list[Row]:
    """Return the descriptive statistics of a measure in each condition; intervals are over participants' means."""
    columns = [factor.column for factor in factors]
    cells = []
    for levels, cell in frame.groupby(columns, sort=True) if columns else [((), frame)]:
        values = cell[measure].dropna()
        if not len(values):
            continue
        numbers = values.to_numpy(float)
        people = cell.dropna(subset=[measure]).groupby("participant")[measure].mean().to_numpy(float)
        mean, low, high = mean_interval(people, confidence)
        if _is_yes_or_no(values):
            low, high = wilson(int(numbers.sum()), len(numbers)) if len(people) < 2 else (max(low, 0.0), min(high, 1.0))
        quarter, median, three = (float(part) for part in np.quantile(numbers, (0.25, 0.5, 0.75)))
        cells.append({
            "task": task, "measure": measure,
            **{factor.name: level for factor, level in zip(factors, levels, strict=True)},
            "participants": len(people), "trials": len(numbers), "mean": mean, "low": _finite(low),
            "high": _finite(high), "deviation": _finite(float(numbers.std(ddof=1)) if len(numbers) > 1 else math.nan),
            "least": float(numbers.min()), "quarter": quarter, "median": median, "three_quarters": three,
            "greatest": float(numbers.max()),
        })  # fmt: skip
    return cells


def _is_yes_or_no(values: Any) -> bool:
    return all(isinstance(value, bool | np.bool_) for value in values)


def _terms_corrected(tested: Mapping[tuple[str, str], Effects], correction: str) -> dict[tuple[str, str], Effects]:
    """Correct the tests of terms together, over all measures of all tasks."""
    ps = iter(corrected([term.p for effects in tested.values() for term in effects.terms], correction))
    return {
        key: effects._replace(terms=tuple(term._replace(p_corrected=next(ps)) for term in effects.terms))
        for key, effects in tested.items()
    }


def _thresholds(frame: Any, factor: str, settings: Mapping[str, Any]) -> list[Row]:
    """Return the threshold of an adaptive factor for each participant and condition of the other factors."""
    column = CONDITION + factor
    answered = next((name for name in ("correct", ANSWER + "correct") if name in frame.columns), None)
    if column not in frame.columns or answered is None:
        raise ConfigError(f"factor {factor}: its thresholds need a measure or an answer named `correct`")
    others = [
        name for name in frame.columns
        if name.startswith(CONDITION) and name != column and frame[name].nunique() > 1
    ]  # fmt: skip
    given = frame.dropna(subset=[column, answered])
    thresholds = []
    for key, track in given.groupby(["task", "participant", *others], sort=True):
        ordered = track.sort_values("trial")
        answers = [(float(level), bool(right)) for level, right in zip(ordered[column], ordered[answered], strict=True)]
        method = replay(settings, 0, answers)
        names = ("task", "participant", *(name.removeprefix(CONDITION) for name in others))
        thresholds.append({
            **dict(zip(names, key, strict=True)), "factor": factor, **method.estimate()._asdict(), **method.summary(),
            "function": method.settings.function.model_dump(), "answers": answers,
        })  # fmt: skip
    return thresholds


def _detections(frame: Any, factors: Mapping[str, Sequence[Factor]], confidence: float) -> list[Row]:
    """Return d' and criterion of each participant and condition, over all levels of an adaptive factor.

    In a 2AFC task the signal is a stiffer sample that comes first. In the detection of a touch, the time before the
    touch is the noise of the same trial: a trial with a false alarm has no signal left to detect.
    """
    detections = []
    for task, of_task in frame.groupby("task", sort=True):
        measured = {str(name) for name in of_task.columns[of_task.notna().any()]}
        of_two = {"chose_first", "comparison_first"} <= measured
        names = ("chose_first", "comparison_first") if of_two else ("success", "false_alarm")
        if not set(names) <= measured:
            continue
        varied = factors[str(task)]
        answers = of_task.dropna(subset=list(names))
        for key, cell in answers.groupby(["participant", *(factor.column for factor in varied)], sort=True):
            yes, second = (cell[name].to_numpy(bool) for name in names)
            if of_two:
                counts = int((yes & second).sum()), int(second.sum()), int((yes & ~second).sum()), int((~second).sum())
            else:
                counts = int((yes & ~second).sum()), int((~second).sum()), int(second.sum()), len(second)
            row = detection(*counts, of_two=of_two, confidence=confidence)
            labels = ("participant", *(factor.name for factor in varied))
            detections.append({"task": task, **dict(zip(labels, key, strict=True)), **row._asdict()})
    return detections


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
