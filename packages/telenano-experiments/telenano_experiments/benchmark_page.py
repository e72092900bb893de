"""The page of the benchmark: which law for which network, a figure, the measures, and what was run."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from telenano_studies.loops.cells import STRUCK_FORCES
from telenano_studies.page import Page, text

from telenano.link import profile_named
from telenano_experiments.benchmark.plan import HANDS, STEADINESS, TASKS, VERSION, Plan
from telenano_experiments.benchmark.results import Case, Row, Situation, Spread, choices
from telenano_experiments.benchmark.run import DIGITS, MEASURES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CHOICE_HEAD = (
    "instrument",
    "hand",
    "network",
    "round trip [ms]",
    "take",
    "held",
    "of",
    "at least",
    "tracking error",
    "then",
)
SITUATION_HEAD = (
    *("line", "instrument", "sample", "take", "held", "made energy", "tracking error", "stiffness felt / true"),
    *("force error", "hand and tip parted [mm]", "then"),
)
ROW_HEAD = (
    *("instrument", "hand", "network", "law", "held", "of", "made energy", "force error", "peak force [N]"),
    *("position error [mm]", "hand and tip parted [mm]", "stiffness felt / true", "tracking error"),
    *("time-offset there, back [ms]", "value-offset back [N]", "not held"),
)
# distinct in shades of grey as well as in colour (Okabe and Ito 2008)
_COLOURS = ("#000000", "#e69f00", "#56b4e9", "#009e73", "#d55e00", "#cc79a7", "#0072b2")
_TRACKING_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
_MARKERS = ("o", "s", "^", "D")
# beyond this share of the scale of colours the words on it are dark
_LIGHT = 0.45


def choice_rows(rows: Sequence[Row[Case]]) -> list[tuple[Any, ...]]:
    """Return the table that says which law for which network."""
    found = []
    for case, some in choices(rows).items():
        first, spread = some[0], some[0].measures["tracking_error"]
        others = ", ".join(f"{row.law} {100.0 * row.share:.0f} %" for row in some[1:3])
        found.append((
            *case, profile_named(case.network).round_trip_ms, first.law if first.held else "none", first.held,
            first.runs,
            f"{100.0 * first.low:.0f} %", None if spread is None else spread.median, others,
        ))  # fmt: skip
    return found


def situation_rows(situations: Mapping[Situation, Sequence[Row[Situation]]]) -> list[tuple[Any, ...]]:
    """Return the table of the laws that are recommended, with what each costs."""
    columns = ("tracking_error", "stiffness_ratio", "force_error", "parted_mm")
    table = []
    for situation, some in situations.items():
        first = some[0]
        table.append((
            *situation, first.law if first.held else "none", f"{100.0 * first.share:.0f} %",
            f"{100.0 * first.made_energy / first.runs:.0f} %",
            *(_middle(first.measures[name]) for name in columns),
            ", ".join(f"{row.law} {100.0 * row.share:.0f} %" for row in some[1:3] if row.held),
        ))  # fmt: skip
    return table


def _middle(spread: Spread | None) -> str | None:
    return None if spread is None else f"{spread.median:.2g}"


def frontier_figure(situations: Mapping[Situation, Sequence[Row[Situation]]]) -> "Figure":
    """Return the figure of what a law costs: stiffness felt and energy made against the tracking error.

    A column is a sample, a point a law in a kind of line; a line leads from the ideal instrument (hollow) to the real
    one (filled).
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter

    samples = list(dict.fromkeys(situation.sample for situation in situations))
    lines = list(dict.fromkeys(situation.line for situation in situations))
    laws = list(dict.fromkeys(row.law for some in situations.values() for row in some))
    instruments = list(dict.fromkeys(situation.instrument for situation in situations))
    figure = Figure(figsize=(1.0 + 4.6 * len(samples), 6.6), layout="constrained")
    axes = figure.subplots(2, len(samples), sharex="col", squeeze=False)
    for column, sample in enumerate(samples):
        upper, lower = axes[:, column]
        for line, marker in zip(lines, _MARKERS, strict=False):
            for law, colour in zip(laws, _COLOURS, strict=False):
                points = []
                for instrument in instruments:
                    some = situations.get(Situation(line, instrument, sample), ())
                    points.append(next((_cost(row) for row in some if row.law == law), None))
                _draw_costs((upper, lower), points, marker, colour)
        upper.set_title(f"sample of {sample}", fontsize=9)
        upper.axhline(1.0, color="0.6", linewidth=0.8)
        lower.set_xscale("log")
        lower.xaxis.set_major_locator(FixedLocator(_TRACKING_TICKS))
        lower.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        lower.xaxis.set_minor_formatter(NullFormatter())
        lower.set_xlabel("tracking error (0: the tip follows the hand)")
    axes[0, 0].set_ylabel("stiffness felt / true")
    axes[1, 0].set_ylabel("runs that made energy [%]")
    handles = [
        Line2D([], [], color=colour, marker="o", linestyle="", label=law.replace("_", " "))
        for law, colour in zip(laws, _COLOURS, strict=False)
    ]
    handles += [
        Line2D([], [], color="0.3", marker=marker, linestyle="", label=line)
        for line, marker in zip(lines, _MARKERS, strict=False)
    ]
    handles += [
        Line2D([], [], color="0.3", marker="o", linestyle="", markerfacecolor=fill, label=f"{instrument} instrument")
        for instrument, fill in zip(instruments, ("none", "0.3"), strict=False)
    ]
    figure.legend(handles=handles, loc="outside right upper", fontsize="small")
    return figure


def _cost(row: Row[Situation]) -> tuple[float, float, float] | None:
    """Return tracking error, stiffness ratio and share that made energy [%]; None where nothing that swung was held."""
    tracking, stiffness = row.measures["tracking_error"], row.measures["stiffness_ratio"]
    if tracking is None or stiffness is None:
        return None
    return tracking.median, stiffness.median, 100.0 * row.made_energy / row.runs


def _draw_costs(axes: Any, points: Sequence[tuple[float, float, float] | None], marker: str, colour: str) -> None:
    """Draw one law in one kind of line: the ideal instrument, the real one, and a line between."""
    for index, axis in enumerate(axes, start=1):
        if all(point is not None for point in points):
            axis.plot([p[0] for p in points if p], [p[index] for p in points if p], color=colour, linewidth=0.7)
        for point, fill in zip(points, ("none", colour), strict=False):
            if point is not None:
                axis.plot(point[0], point[index], marker, color=colour, markerfacecolor=fill, markersize=6)


def law_rows(rows: Sequence[Row[Case]]) -> list[tuple[Any, ...]]:
    """Return the table of all laws over all networks."""
    return [
        (*row.case, row.law, row.held, row.runs, row.made_energy,
         *(_spread(row.measures[name]) for name in ("force_error", "peak_force_n", "position_error_mm",
                                                    "parted_mm", "stiffness_ratio", "tracking_error")),
         f"{_median(row, 'eto_forward_ms')}, {_median(row, 'eto_backward_ms')}",
         _spread(row.measures["evo_backward_n"]),
         ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in row.verdicts.items() if kind != "stable"))
        for row in rows
    ]  # fmt: skip


def _spread(spread: Spread | None) -> str | None:
    if spread is None:
        return None
    if f"{spread.least:.3g}" == f"{spread.most:.3g}":
        return f"{spread.median:.3g}"
    return f"{spread.median:.3g} ({spread.least:.3g} to {spread.most:.3g})"


def _median(row: Row[Case], measure: str) -> str:
    spread = row.measures[measure]
    return text(None) if spread is None else f"{spread.median:.0f}"


def benchmark_figure(rows: Sequence[Row[Case]]) -> "Figure":
    """Return the figure: share of the runs that each law held over each network, and how near it followed.

    A panel is an instrument and a hand.
    """
    from matplotlib.figure import Figure

    networks, laws = list(dict.fromkeys(row.case.network for row in rows)), list(dict.fromkeys(row.law for row in rows))
    panels = list(dict.fromkeys(row.case[:2] for row in rows))
    width = 2.6 + 1.25 * len(laws) * len(panels)
    figure = Figure(figsize=(width, 1.8 + 0.48 * len(networks)), layout="constrained")
    image: Any = None
    columns = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, panel in zip(columns, panels, strict=True):
        image = _draw_shares(axes, [row for row in rows if row.case[:2] == panel], networks, laws)
        if len(panels) > 1:
            axes.set_title(f"{panel[0].replace('_', ' ')} instrument, {panel[1]} hand", fontsize=9)
    columns[0].set_ylabel("network, mean round trip")
    figure.colorbar(image, ax=columns.tolist(), label="share of runs held", fraction=0.05)
    return figure


def _draw_shares(axes: Any, rows: Sequence[Row[Case]], networks: Sequence[str], laws: Sequence[str]) -> Any:
    """Draw the shares of one instrument and hand, and return what has their scale of colours."""
    known = {(row.case.network, row.law): row for row in rows}
    shares = [[known[network, law].share for law in laws] for network in networks]
    image = axes.imshow(shares, vmin=0.0, vmax=1.0, cmap="cividis", aspect="auto")
    best = {case.network: some[0].law for case, some in choices(rows).items() if some[0].held}
    for y, network in enumerate(networks):
        for x, law in enumerate(laws):
            row = known[network, law]
            spread = row.measures["tracking_error"]
            words = f"{100.0 * row.share:.0f} %" + (f"\n{spread.median:.2g}" if spread is not None else "")
            weight = "bold" if best.get(network) == law else "normal"
            colour = "black" if row.share > _LIGHT else "white"
            axes.text(x, y, words, ha="center", va="center", color=colour, fontsize=8, weight=weight)
    axes.set_xticks(range(len(laws)), [law.replace("_", " ") for law in laws], rotation=20, ha="right")
    labels = [f"{name.replace('_', ' ')}, {profile_named(name).round_trip_ms:.3g} ms" for name in networks]
    axes.set_yticks(range(len(networks)), labels)
    return image


def benchmark_page(
    plan: Plan,
    summary: dict[str, Any],
    rows: Sequence[Row[Case]],
    situations: Mapping[Situation, Sequence[Row[Situation]]],
    images: Mapping[str, bytes],
    command: str,
) -> Page:
    """Return the page of a result."""
    page = Page(f"Benchmark {VERSION}: which law for which network")
    page.code(command)
    page.paragraph(f"{summary['runs']} runs. SHA-256 of runs.csv: {summary['digest']}.")
    if situations:
        page.table(SITUATION_HEAD, situation_rows(situations))
        page.paragraph(
            "Recommended by what is known of a line, an instrument and a sample beforehand, over all hands: the law"
            " that followed the swing nearest, of those whose share of runs held has a 95 % interval that meets that of"
            " the best. Medians of the runs held."
        )
        page.image(
            images["frontier.png"],
            "What a law costs: medians of the runs held. From the ideal instrument (hollow) to the real one (filled).",
        )
    page.table(CHOICE_HEAD, choice_rows(rows))
    page.paragraph(
        "Held: the verdict is stable, that is, the force comes to rest where the hand means it to, and it was never"
        f" above {STRUCK_FORCES:g} times that; where it was, the run is struck. At least: lower end of the 95 %"
        " interval of the share held (Wilson). The law to take held most runs, and of equal ones it followed the swing"
        " nearest."
        " Made energy: runs in which the loop gave at least 1 uJ more than the hand had put in. The laws are as they"
        " come, none is tuned for a network."
    )
    page.image(
        images["benchmark.png"],
        "Share of the runs held, and below it the tracking error (RMS of the tip's motion against the hand's, median of"
        " the runs held). Bold: the law to take.",
    )
    page.table(ROW_HEAD, law_rows(rows))
    page.paragraph(
        "Median, and in brackets least and greatest, of the runs that were held, over tasks, hands and seeds."
    )
    page.heading("What was run")
    page.table(("task", "what it is"), [(name, TASKS[name].about) for name in plan.tasks])
    page.table(("network", "what it is"), [(name, profile_named(name).about) for name in plan.networks])
    page.table(("hand", "what it is"), [(name, HANDS[name]) for name in plan.hands])
    page.table(("hand is", "what it does"), [(name, STEADINESS[name]) for name in plan.steadiness])
    page.paragraph(
        f"Instruments: {', '.join(plan.instruments)}, with the disturbances that docs/instrument.md names. Seeds:"
        f" {plan.seeds} for each run that is random, each with a draw of delays, losses and noise that all laws get."
    )
    page.heading("Measures")
    page.table(("measure", "unit", "what it is"), [(name, m.unit, m.about) for name, m in MEASURES.items()])
    page.paragraph(f"Every figure of runs.csv has {DIGITS} digits, and is the same on every machine.")
    return page
