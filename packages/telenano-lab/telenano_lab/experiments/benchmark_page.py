"""The page of the benchmark: the law for each network, a figure, the measures, and the runs."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from telenano.analysis import Page, cell_text
from telenano.settings import profile_named
from telenano_lab.experiments.benchmark.plan import HANDS, STEADINESS, TASKS, VERSION, Plan
from telenano_lab.experiments.benchmark.results import Case, Row, Situation, Spread, choices
from telenano_lab.experiments.benchmark.run import DIGITS, MEASURES
from telenano_lab.studies.loops.cells import STRUCK_FORCES

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
_TRACKING_TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_TRACKING = (0.01, 2.0)
_SOFTEST = -0.15
_STIFFEST = 1.25
# Lower end of the colour scale of energy [mJ].
_LEAST_MJ = -2.0
# Above this share of the colour scale the text is dark.
_LIGHT = 0.45


def choice_rows(rows: Sequence[Row[Case]]) -> list[tuple[Any, ...]]:
    """Return the table of the law to take for each network."""
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
    """Return the table of recommended laws and their costs."""
    columns = ("tracking_error", "stiffness_ratio", "force_error", "parted_mm")
    table = []
    for situation, some in situations.items():
        first = some[0]
        table.append((
            *situation, first.law if first.held else "none", f"{100.0 * first.share:.0f} %",
            f"{100.0 * first.made_energy / first.runs:.0f} %",
            *(_middle(first.measures[name]) for name in columns),
            ", ".join(f"{row.law} {100.0 * row.share:.0f} %" for row in some[1:4] if row.held),
        ))  # fmt: skip
    return table


def _middle(spread: Spread | None) -> str | None:
    return None if spread is None else f"{spread.median:.2g}"


def frontier_figure(situations: Mapping[Situation, Sequence[Row[Situation]]]) -> "Figure":
    """Draw the frontier of the laws: felt stiffness against tracking error and energy, a panel per kind of line.

    A law is a line from the first instrument (diamond) to the second (circle), or a single point; its label has the
    shares of the runs held. Further right the tip follows worse, further down the sample feels softer, and the colour
    is the least energy at the ports.
    """
    from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter

    first_sample = next(iter(situations)).sample
    shown = {situation: rows for situation, rows in situations.items() if situation.sample == first_sample}
    lines = list(dict.fromkeys(situation.line for situation in shown))
    figure, panels = _panels(len(lines), 6.2, 4.2)
    dots: Any = None
    for axes, line in zip(panels.flat, lines, strict=False):
        axes.axhline(1.0, color="0.8", linewidth=0.8, zorder=0)
        rows = {situation.instrument: some for situation, some in shown.items() if situation.line == line}
        dots = _draw_frontier(axes, rows) or dots
        axes.set(xscale="log", xlim=_TRACKING, ylim=(_SOFTEST, _STIFFEST), ylabel="stiffness felt / true")
        axes.set_xlabel("tracking error, 0: the tip follows the hand")
        axes.set_title(f"{line}, sample of {first_sample}", fontsize=9)
        axes.xaxis.set_major_locator(FixedLocator(_TRACKING_TICKS))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    if dots is not None:
        label = f"least energy at the ports of the runs held [mJ], {_LEAST_MJ:g} or less"
        figure.colorbar(dots, ax=panels.ravel().tolist(), label=label, fraction=0.03)
    return figure


def _panels(count: int, width: float, height: float, **options: Any) -> "tuple[Figure, Any]":
    """Return a figure and its panels, two in a row, each with a width and a height [inch]."""
    from matplotlib.figure import Figure

    across = min(2, count)
    down = -(-count // across)
    figure = Figure(figsize=(width * across, height * down), layout="constrained")
    panels = figure.subplots(down, across, squeeze=False, **options)
    for axes in panels.flat[count:]:
        axes.set_visible(False)
    return figure, panels


def _draw_frontier(axes: Any, rows: Mapping[str, Sequence[Row[Situation]]]) -> Any:
    """Draw the laws of one kind of line, by instrument; return the artist with the colour scale, or None."""
    by_law: dict[str, list[tuple[int, Row[Situation]]]] = {}
    for index, some in enumerate(rows.values()):
        for row in some:
            by_law.setdefault(row.law, []).append((index, row))
    dots, names, nowhere = None, [], []
    for law, results in by_law.items():
        points = [(index, cost) for index, row in results if (cost := _cost(row)) is not None]
        name = f"{law} {' → '.join(f'{100.0 * row.share:.0f} %' for _, row in results)}"
        if not points:
            nowhere.append(name)
            continue
        axes.plot(
            [cost.tracking for _, cost in points],
            [cost.stiffness for _, cost in points],
            color="0.5",
            linewidth=0.8,
            zorder=1,
        )
        for index, cost in points:
            look = {"cmap": "viridis", "vmin": _LEAST_MJ, "vmax": 0.0, "edgecolors": "black", "zorder": 2}
            size, marker = (26, "o") if index else (46, "D")
            dots = axes.scatter(
                [cost.tracking], [cost.stiffness], c=[max(cost.least_mj, _LEAST_MJ)], s=size, marker=marker, **look
            )
        last = points[-1][1]
        names.append((last.tracking, last.stiffness, name))
    _write_names(axes, names, nowhere)
    return dots


def _write_names(axes: Any, names: Sequence[tuple[float, float, str]], nowhere: Sequence[str]) -> None:
    """Write names in a column beside the panel: those of points in their order, then the others.

    Args:
        axes: The panel.
        names: Tracking error, stiffness ratio and name of each point.
        nowhere: The names without a point.
    """
    beside, level = 1.02 * _TRACKING[1], _STIFFEST
    arrow = {"arrowstyle": "-", "color": "0.75", "linewidth": 0.6}
    for tracking, stiffness, name in sorted(names, key=lambda one: -one[1]):
        level = min(level - 0.085, stiffness + 0.02)
        place = (tracking, stiffness)
        axes.annotate(name, place, xytext=(beside, level), fontsize=7, arrowprops=arrow, annotation_clip=False)
    for name in nowhere:
        level -= 0.085
        axes.text(beside, level, name, fontsize=7)


class _Cost(NamedTuple):
    """The cost of a law: medians of tracking error and stiffness ratio, and the least energy of a run [mJ]."""

    tracking: float
    stiffness: float
    least_mj: float


def _cost(row: Row[Situation]) -> _Cost | None:
    """Return the cost of a law; None if no run with a swing was held."""
    tracking, stiffness, energy = (
        row.measures[name] for name in ("tracking_error", "stiffness_ratio", "least_energy_mj")
    )
    if tracking is None or stiffness is None or energy is None:
        return None
    return _Cost(tracking.median, stiffness.median, energy.least)


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
    return cell_text(None) if spread is None else f"{spread.median:.0f}"


def benchmark_figure(rows: Sequence[Row[Case]]) -> "Figure":
    """Draw the share of runs that each law held over each network, and its tracking error.

    A panel is an instrument and a hand.
    """
    networks, laws = list(dict.fromkeys(row.case.network for row in rows)), list(dict.fromkeys(row.law for row in rows))
    panels = list(dict.fromkeys(row.case[:2] for row in rows))
    figure, grid = _panels(len(panels), 1.3 + 1.25 * len(laws), 1.8 + 0.48 * len(networks), sharey=True)
    image: Any = None
    for axes, panel in zip(grid.flat, panels, strict=False):
        image = _draw_shares(axes, [row for row in rows if row.case[:2] == panel], networks, laws)
        if len(panels) > 1:
            axes.set_title(f"{panel[0].replace('_', ' ')} instrument, {panel[1]} hand", fontsize=9)
    for axes in grid[:, 0]:
        axes.set_ylabel("network, mean round trip")
    figure.colorbar(image, ax=grid.ravel().tolist(), label="share of runs held", fraction=0.05)
    return figure


def _draw_shares(axes: Any, rows: Sequence[Row[Case]], networks: Sequence[str], laws: Sequence[str]) -> Any:
    """Draw the shares of one instrument and hand; return the image with the colour scale."""
    by_line = {(row.case.network, row.law): row for row in rows}
    shares = [[by_line[network, law].share for law in laws] for network in networks]
    image = axes.imshow(shares, vmin=0.0, vmax=1.0, cmap="cividis", aspect="auto")
    best = {case.network: some[0].law for case, some in choices(rows).items() if some[0].held}
    for y, network in enumerate(networks):
        for x, law in enumerate(laws):
            row = by_line[network, law]
            spread = row.measures["tracking_error"]
            words = f"{100.0 * row.share:.0f} %" + (f"\n{spread.median:.2g}" if spread is not None else "")
            weight = "bold" if best.get(network) == law else "normal"
            colour = "black" if row.share > _LIGHT else "white"
            axes.text(x, y, words, ha="center", va="center", color=colour, fontsize=8, weight=weight)
    axes.set_xticks(range(len(laws)), [law.replace("_", "\n") for law in laws])
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
            " that followed the swing nearest, of those whose share of runs held without making energy has a 95 %"
            " interval that meets that of the best. Medians of the runs held."
        )
        page.image(
            images["frontier.png"],
            "What a law costs: medians of the runs held, from the ideal instrument (diamond) to the real one (circle)."
            " To the right follows worse, downwards is softer. A name has the shares of the runs held.",
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
