"""The page of the benchmark: which law for which network, a figure, the measures, and what was run."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from telenano_studies.loops.cells import STRUCK_FORCES
from telenano_studies.page import Page, text

from telenano.link import profile_named
from telenano_experiments.benchmark.plan import HANDS, STEADINESS, TASKS, VERSION, Plan
from telenano_experiments.benchmark.results import Row, Spread, choices
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
ROW_HEAD = (
    *("instrument", "hand", "network", "law", "held", "of", "made energy", "force error", "peak force [N]"),
    *("position error [mm]", "hand and tip parted [mm]", "stiffness felt / true", "tracking error"),
    *("time-offset there, back [ms]", "value-offset back [N]", "not held"),
)
# beyond this share of the scale of colours the words on it are dark
_LIGHT = 0.45


def choice_rows(rows: Sequence[Row]) -> list[tuple[Any, ...]]:
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


def law_rows(rows: Sequence[Row]) -> list[tuple[Any, ...]]:
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


def _median(row: Row, measure: str) -> str:
    spread = row.measures[measure]
    return text(None) if spread is None else f"{spread.median:.0f}"


def benchmark_figure(rows: Sequence[Row]) -> "Figure":
    """Return the figure: share of the runs that each law held over each network, and how near it followed.

    A panel is an instrument and a hand.
    """
    from matplotlib.figure import Figure

    networks, laws = list(dict.fromkeys(row.network for row in rows)), list(dict.fromkeys(row.law for row in rows))
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


def _draw_shares(axes: Any, rows: Sequence[Row], networks: Sequence[str], laws: Sequence[str]) -> Any:
    """Draw the shares of one instrument and hand, and return what has their scale of colours."""
    known = {(row.network, row.law): row for row in rows}
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


def benchmark_page(plan: Plan, summary: dict[str, Any], rows: Sequence[Row], image: bytes, command: str) -> Page:
    """Return the page of a result."""
    page = Page(f"Benchmark {VERSION}: which law for which network")
    page.code(command)
    page.paragraph(f"{summary['runs']} runs. SHA-256 of runs.csv: {summary['digest']}.")
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
        image,
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
