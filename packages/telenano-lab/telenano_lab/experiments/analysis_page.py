"""The analysis of an experiment as figures, tables, a methods paragraph and one page."""

import json
import math
import platform
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from telenano.analysis import FigureOptions, Page
from telenano.recording import versions as origin_of
from telenano_lab.experiments.analyse import Analysis, versions
from telenano_lab.experiments.effects import Factor
from telenano_lab.experiments.psychophysics.function import Psychometric
from telenano_lab.experiments.table import Row, Tables, write_tables
from telenano_lab.studies.figure_colours import LINES, looks
from telenano_lab.studies.image_files import write_images

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAME = "experiment"
_CORRECTED = {
    "holm": "Holm's method",
    "bonferroni": "Bonferroni's method",
    "fdr_bh": "the false discovery rate of Benjamini and Hochberg",
    "none": "nothing",
}
_MOST_TRACKS = 12


def write_analysis(
    folder: Path, analysis: Analysis, tables: Tables, about: Mapping[str, Any], command: str, options: FigureOptions
) -> dict[str, Any]:
    """Write tables, figures, results and page of an experiment into a folder.

    Args:
        folder: The folder.
        analysis: The analysis.
        tables: The tables that were analysed.
        about: Facts for the methods paragraph: title, seed, order, apparatus, digest.
        command: The command that makes the page.
        options: The formats and the style of the figures.

    Returns:
        The results as in `experiment.json`.
    """
    write_tables(tables, folder)
    methods = methods_paragraph(analysis, about)
    document = {**analysis.as_dict(), "about": dict(about), "methods": methods}
    (folder / f"{NAME}.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    (folder / "methods.md").write_text(methods + "\n", encoding="utf-8")
    with options.styled():
        images = write_images(folder, dict(figures(analysis, tables, options)), command, options)
    _page(analysis, about, methods, images, command).write(folder / f"{NAME}.html")
    return document


def figures(analysis: Analysis, tables: Tables, options: FigureOptions) -> "Iterator[tuple[str, Figure]]":
    """Yield, by name, a figure of each measure, one of the effect sizes, and one of the thresholds."""
    from matplotlib.figure import Figure

    for task, measures in analysis.measures.items():
        for measure, unit in measures.items():
            factors = analysis.factors[task]
            if factors and any(row["measure"] == measure and row["task"] == task for row in analysis.cells):
                figure = Figure(
                    figsize=(1.6 * FigureOptions.COLUMN_IN, 1.05 * FigureOptions.COLUMN_IN), layout="constrained"
                )
                _measure(figure.subplots(), analysis, tables, task, measure, unit)
                yield f"{task}_{measure}".replace("/", "_").replace(".", "_"), figure
    terms = [(task, measure, term) for (task, measure), effects in analysis.effects.items() for term in effects.terms]
    if terms:
        figure = Figure(figsize=(1.6 * FigureOptions.COLUMN_IN, 0.8 + 0.22 * len(terms)), layout="constrained")
        _forest(figure.subplots(), terms)
        yield "effect_sizes", figure
    if analysis.thresholds:
        yield "thresholds", _psychometric(analysis, options)


def methods_paragraph(analysis: Analysis, about: Mapping[str, Any]) -> str:
    """Return the methods paragraph of a paper: numbers, conditions, tests, seeds and versions."""
    counts, choice = analysis.counts, analysis.choice
    percent = f"{100.0 * choice.confidence:g} %"
    excluded = f"; {counts['excluded']} more were excluded" if counts["excluded"] else ""
    sentences = [
        f"{_many(counts['participants'], 'participant')} completed {_many(counts['trials'], 'trial')} of "
        f"{_listed(list(analysis.measures))}{excluded}.",
        f"The analysis leaves out {_many(counts['practice'], 'attempt')} of practice, {counts['disturbed']} disturbed "
        f"by something that the settings of the link do not explain, and {counts['aborted']} aborted.",
    ]
    apparatus = about.get("apparatus")
    if apparatus:
        sentences.append(f"The apparatus was {apparatus}.")
    for factor in {factor.name: factor for factors in analysis.factors.values() for factor in factors}.values():
        levels = ", ".join(f"{level:g}" if isinstance(level, float) else str(level) for level in factor.levels)
        unit = f" {factor.unit}" if factor.unit else ""
        sentences.append(
            f"{factor.name} was {levels}{unit}, {'within' if factor.is_within else 'between'} participants."
        )
    if about.get("order"):
        sentences.append(f"The order of the trials was {about['order']}, from seed {about.get('seed')}.")
    for model in dict.fromkeys(factors.model for factors in analysis.effects.values()):
        number = sum(factors.model == model for factors in analysis.effects.values())
        verb = "was" if number == 1 else "were"
        what = "not tested" if model == "none" else f"analysed by a {model}"
        sentences.append(f"{_many(number, 'measure')} {verb} {what}.")
    sentences += [
        f"p values were corrected by {_CORRECTED[choice.correction]}: those of the terms over all measures together, "
        "those of the pairs of levels within each measure.",
        f"Effect sizes are partial η² and Hedges' g of participants' means; all intervals are {percent}.",
    ]
    if analysis.thresholds:
        sentences.append(f"Thresholds are by {analysis.thresholds[0]['method']}.")
    named = ", ".join(f"{name} {number}" for name, number in versions().items())
    commit = origin_of()["commit"]
    sentences.append(f"Made with {named} (commit {commit}) on Python {platform.python_version()}.")
    if about.get("digest"):
        sentences.append(f"The digest of the experiment's file is {about['digest']}.")
    return " ".join(sentences)


def _many(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _listed(names: Sequence[str]) -> str:
    shown = [name.replace("_", " ") for name in names]
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def _measure(axes: "Axes", analysis: Analysis, tables: Tables, task: str, measure: str, unit: str) -> None:
    """Draw the means over participants with their intervals, and each participant's own mean."""
    factors = analysis.factors[task]
    # The abscissa is the factor with most levels, numeric ones first.
    across = max(factors, key=lambda factor: (_are_numbers(factor.levels), len(factor.levels)))
    others = [factor for factor in factors if factor is not across]
    cells = [row for row in analysis.cells if (row["task"], row["measure"]) == (task, measure)]
    series = list(dict.fromkeys(tuple(row[factor.name] for factor in others) for row in cells))
    places = list(across.levels) if _are_numbers(across.levels) else list(range(len(across.levels)))
    apart = 0.012 * (max(places) - min(places))
    for number, (key, look) in enumerate(zip(series, looks(len(series)), strict=True)):
        chosen = {row[across.name]: row for row in cells if tuple(row[factor.name] for factor in others) == key}
        shift = (number - 0.5 * (len(series) - 1)) * apart
        xs = [place + shift for level, place in zip(across.levels, places, strict=True) if level in chosen]
        rows = [chosen[level] for level in across.levels if level in chosen]
        means = np.array([row["mean"] for row in rows])
        ends = np.array([[row["mean"] if row[end] is None else row[end] for row in rows] for end in ("low", "high")])
        for person in _people(tables, task, measure, across, others, key):
            axes.plot(
                xs, [person.get(row[across.name], math.nan) for row in rows], "o", ms=2.2, color=look.colour, alpha=0.35
            )
        label = ", ".join(str(level) for level in key) or None
        bars = np.abs(ends - means)
        axes.errorbar(
            xs, means, bars, color=look.colour, ls=look.style, lw=1.2, capsize=2.5, marker="s", ms=3.5, label=label
        )
    if not _are_numbers(across.levels):
        axes.set_xticks(places, [str(level) for level in across.levels])
    axes.set(xlabel=_label(across.name, across.unit), ylabel=_label(measure, unit))
    if len(series) > 1:
        axes.legend(title=", ".join(factor.name for factor in others), frameon=False, fontsize="small")


def _are_numbers(levels: Sequence[Any]) -> bool:
    return all(isinstance(level, int | float) and not isinstance(level, bool) for level in levels)


def _people(
    tables: Tables, task: str, measure: str, across: Factor, others: Sequence[Factor], key: tuple[Any, ...]
) -> list[dict[Any, float]]:
    """Return each participant's mean at each level of the abscissa, for one series."""
    values: dict[str, dict[Any, list[float]]] = {}
    for row in tables.trials:
        counts = row["task"] == task and row["phase"] == "main" and row["status"] == "done" and not row["excluded"]
        if counts and row[measure] is not None and tuple(row[factor.column] for factor in others) == key:
            values.setdefault(row["participant"], {}).setdefault(row[across.column], []).append(float(row[measure]))
    return [
        {level: float(np.mean(values_at_level)) for level, values_at_level in person.items()}
        for person in values.values()
    ]


def _forest(axes: "Axes", terms: Sequence[tuple[str, str, Any]]) -> None:
    for row, (_, _, term) in enumerate(terms):
        colour = LINES[0][0] if (term.p_corrected or 0.0) < 0.05 else "#9a9a9a"
        axes.plot([term.partial_eta2_low, term.partial_eta2_high], [row, row], color=colour, lw=1.2)
        axes.plot(term.partial_eta2, row, "s", ms=4, color=colour)
    axes.set_yticks(range(len(terms)), [f"{measure}: {term.term}" for _, measure, term in terms])
    axes.set_ylim(len(terms) - 0.5, -0.5)
    axes.set(xlim=(0.0, 1.0), xlabel="partial η² (grey: p ≥ 0.05 after correction)")


def _psychometric(analysis: Analysis, options: FigureOptions) -> "Figure":
    """Draw the answers and the fitted function of up to twelve tracks."""
    from matplotlib.figure import Figure

    tracks = analysis.thresholds[:_MOST_TRACKS]
    wide = min(len(tracks), 4)
    high = math.ceil(len(tracks) / wide)
    figure = Figure(figsize=(0.2 + 1.7 * wide, 0.3 + 1.5 * high), layout="constrained")
    grid = figure.subplots(high, wide, squeeze=False, sharey=True)
    for axes, track in zip(grid.flat, tracks, strict=False):
        _track(axes, track)
    for axes in list(grid.flat)[len(tracks) :]:
        axes.set_visible(False)
    options.lettered(list(grid.flat)[: len(tracks)])
    figure.supxlabel(f"{tracks[0]['factor']}")
    figure.supylabel("share correct")
    return figure


def _track(axes: "Axes", track: Row) -> None:
    levels = sorted({level for level, _ in track["answers"]})
    for level in levels:
        answers = [right for at, right in track["answers"] if at == level]
        axes.plot(
            level, np.mean(answers), "o", ms=2.0 + min(6.0, math.sqrt(len(answers))), color=LINES[2][0], alpha=0.6
        )
    model = Psychometric.model_validate(track["function"])
    if track["threshold"] is not None and track["width"] is not None:
        places = np.linspace(float(model.on_axis([levels[0]])[0]), float(model.on_axis([levels[-1]])[0]), 200)
        middle = float(model.on_axis([track["threshold"]])[0])
        middle -= track["width"] * model.distance_of(track["proportion"], track["lapse"])
        shares = model.share(places, np.asarray(middle), np.asarray(track["width"]), np.asarray(track["lapse"]))
        axes.plot(model.from_axis(places), shares, color=LINES[0][0], lw=1.0)
        axes.axvline(track["threshold"], color=LINES[1][0], lw=0.9, ls="--")
        if track["low"] is not None and track["high"] is not None:
            axes.axvspan(track["low"], track["high"], color=LINES[1][0], alpha=0.15, lw=0)
    if model.axis == "log":
        axes.set_xscale("log")
        axes.minorticks_off()
    ends = (levels[0], levels[-1])
    axes.set_xticks(ends, [f"{level:.3g}" for level in ends])
    axes.set_ylim(-0.03, 1.03)
    names = list(track)
    shown = [str(track[name]) for name in names[names.index("participant") : names.index("factor")]]
    axes.annotate(", ".join(shown), (0.97, 0.05), xycoords="axes fraction", ha="right", fontsize="small")


def _label(name: str, unit: str) -> str:
    words = name
    for suffix in ("_n_per_m", "_m_per_s", "_percent", "_ms", "_s", "_n", "_m", "_j", "_hz"):
        if unit and name.endswith(suffix):
            words = name.removesuffix(suffix)
            break
    words = words.replace("_", " ")
    return f"{words} ({unit})" if unit else words


def _page(
    analysis: Analysis, about: Mapping[str, Any], methods: str, images: Mapping[str, bytes], command: str
) -> Page:
    page = Page(str(about.get("title") or "Analysis of an experiment"))
    page.code(command)
    page.paragraph(methods)
    for (task, measure), effects in analysis.effects.items():
        for remark in effects.remarks:
            page.paragraph(f"{task}, {measure}: {remark}.")
    document = analysis.as_dict()
    heads = {
        "terms": ("Factors and interactions", ()),
        "slopes": ("Change with numeric factors, for each unit of the factor", ()),
        "pairs": ("Levels against one another, over participants' means", ()),
        "thresholds": ("Thresholds", ("answers", "function", "method")),
        "detections": ("Sensitivity and criterion of each participant", ()),
        "cells": ("Descriptive statistics; intervals are over participants' means", ()),
    }
    for part, (title, left_out) in heads.items():
        rows = document[part]
        if rows:
            page.heading(title)
            head = [name for name in dict.fromkeys(key for row in rows for key in row) if name not in left_out]
            page.table([name.replace("_", " ") for name in head], [[row.get(name) for name in head] for row in rows])
    for name, png in images.items():
        page.image(png, name.removesuffix(".png").replace("_", " "))
    return page
