"""The stability page: map, growth rates, two-port conditions, energy, table; as PNG, Parquet, JSON and HTML."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from telenano.analysis import VERDICT_COLOURS, FigureOptions, Page
from telenano.cli import results_in
from telenano.wire import RigError
from telenano_lab.studies.figure_colours import ON_SCREEN, looks
from telenano_lab.studies.image_files import write_images, write_tables
from telenano_lab.studies.loops.cells import Cell, CellResult, energies_of, scales_of, trajectory_of
from telenano_lab.studies.loops.stability import LineResult
from telenano_lab.studies.loops.theory import hybrid_of, llewellyn

if TYPE_CHECKING:
    from matplotlib.axes import Axes as PlotAxes
    from matplotlib.figure import Figure

# The colours of curves; those of the verdicts are for areas, and too light for lines.
_CURVES = (("#0072b2", "-"), ("#d55e00", "--"), ("#000000", ":"))
# Growth rates are drawn on a scale that is linear below this, around zero, where the edge is [1/s].
_LINEAR_PER_S = 0.5
# The line widths of the edge in lockstep and of the edge by theory.
_EDGE_PT = 4.0
_THEORY_PT = 1.4
# The ticks of the axis of growth rates [1/s].
_RATES_PER_S = (-10.0, -1.0, 0.0, 1.0, 10.0)

VERDICT_WORDS = (
    "Stable: the motion of the tip's force dies out while the hand's force stands still, or is smaller than a"
    " twentieth of it. Limit cycle: the motion neither grows nor dies out (over a link with jitter or loss, a motion"
    " that the link's randomness keeps up is one too, and so is one that a disturbance drives). Diverged: a mode of it"
    " grows. Contact lost: the tip left the surface and stays away. Guarded: the instrument withdrew. Cannot say: the"
    " hold is too short, or noise hides it. The growth rate is that of the mode that decides."
)
SAMPLE_PERIOD = (
    "The sample period adds its own delay. A constant delay of the link acts in whole samples, and the zero-order hold "
    "of the law adds Ts/2 of delay. So a loop that is neutral with T_d of "
    "link delay compares with the continuous theory at T_c = T_d + Ts/2. The column 'lockstep' includes that half "
    "period; 'link' is T_d itself, and theory gives it exactly from the sampled loop."
)
TWO_PORTS = (
    "Absolute stability of the two-port (Llewellyn), whatever passive hand and environment it is put between: holds"
    " where the curve is not below zero. Position forward and force backward fail at once with any delay, and remain"
    " stable only because the environment is not arbitrary; waves never fall below zero."
)


def write_stability(
    results: Sequence[LineResult],
    out: Path,
    command: str,
    options: FigureOptions = ON_SCREEN,
    tables: Sequence[str] = ("parquet",),
) -> dict[str, Any]:
    """Write stability.png, tables, .json and .html into a folder; return the summary in the JSON file."""
    summary = summarise(results)
    with options.styled():
        figures = {"stability": map_figure(results), "growth": growth_figure(results)}
        if (ports := two_port_figure(results)) is not None:
            figures["two_ports"] = ports
        figures["energy"] = energy_figure(results)
        with results_in(out) as folder:
            images = write_images(folder, figures, command, options)
            rows = [row.as_dict() for result in results for row in result.cells]
            write_tables(folder, "stability", rows, tables)
            text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
            (folder / "stability.json").write_text(text, encoding="utf-8")
            _page(results, images, command).write(folder / "stability.html")
    return summary


def summarise(results: Sequence[LineResult]) -> dict[str, Any]:
    """Return the object that --json prints.

    critical_delay_ms: stiffness -> round trip [ms] of the first conditions given, with half a period; null if no delay
    was unstable. With several laws it is by law.
    """
    laws = list(dict.fromkeys(result.line.law for result in results))
    by_law = {law: _by_stiffness([result for result in results if result.line.law == law]) for law in laws}
    only = laws[0] if len(laws) == 1 else None
    return {
        "study": "stability",
        "environment": results[0].line.axes.environment,
        "laws": laws,
        "critical_delay_ms": by_law[only]["critical_delay_ms"] if only else {
            law: values["critical_delay_ms"] for law, values in by_law.items()
        },
        "theory_delay_ms": by_law[only]["theory_delay_ms"] if only else {
            law: values["theory_delay_ms"] for law, values in by_law.items()
        },
        "period_ms": 1e3 * results[0].line.cell(0.0).controller().period_s,
        "lines": [result.as_dict() for result in results],
    }  # fmt: skip


def _by_stiffness(results: Sequence[LineResult]) -> dict[str, dict[str, float | None]]:
    first: dict[str, LineResult] = {}
    for result in results:
        first.setdefault(f"{result.line.stiffness_n_per_m:g}", result)
    return {
        "critical_delay_ms": {key: result.critical_delay_ms for key, result in first.items()},
        "theory_delay_ms": {key: result.theory_ms for key, result in first.items()},
    }


def _panels(count: int, height: float) -> "tuple[Figure, list[PlotAxes]]":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, max(2.4, height * count)), layout="constrained")
    axes = figure.subplots(count, 1, squeeze=False)[:, 0]
    return figure, list(axes)


def _by_law(results: Sequence[LineResult]) -> dict[str, list[LineResult]]:
    laws: dict[str, list[LineResult]] = {}
    for result in results:
        laws.setdefault(result.line.law, []).append(result)
    return laws


def map_figure(results: Sequence[LineResult]) -> "Figure":
    """Draw delay against conditions in a panel for each law: verdicts of the cells, found edge, edge by theory."""
    from matplotlib.colors import to_rgb

    # Each verdict has one colour, because shades of one could not be distinguished.
    laws = _by_law(results)
    figure, axes = _panels(len(laws), 1.0 + 0.42 * max(len(rows) for rows in laws.values()))
    for axis, (law, rows) in zip(axes, laws.items(), strict=True):
        delays = np.array([cell.cell.round_trip_ms for cell in rows[0].cells])
        edges = _edges(delays)
        for y, row in enumerate(rows):
            colours = [[to_rgb(VERDICT_COLOURS[cell.verdict]) for cell in row.cells]]
            axis.pcolormesh(_up_to(row, delays, edges), [y - 0.42, y + 0.42], np.array(colours))
            _mark(axis, y, row)
        axis.set_yticks(range(len(rows)), [row.line.label for row in rows])
        axis.set_ylim(-0.6, len(rows) - 0.4)
        axis.set_title(law.replace("_", " "), loc="left", fontsize="medium")
    axes[-1].set_xlabel("round trip of the link [ms]")
    shown = {cell.verdict for result in results for cell in result.cells}
    handles = [_patch(VERDICT_COLOURS[kind], kind.replace("_", " ")) for kind in VERDICT_COLOURS if kind in shown]
    edge = axes[0].plot([], [], "k-", linewidth=_EDGE_PT, label="edge, lockstep")
    theory = axes[0].plot([], [], "w--", linewidth=_THEORY_PT, label="edge, theory (sampled loop)")
    figure.legend(
        handles=[*handles, *edge, *theory], loc="outside upper center", ncols=5, fontsize="small", facecolor="0.75"
    )
    return figure


def _patch(colour: str, label: str) -> Any:
    from matplotlib.patches import Patch

    return Patch(color=colour, label=label)


def _mark(axis: "PlotAxes", y: int, row: LineResult) -> None:
    # The theory is drawn on the found edge, which is wide enough to be seen beside it.
    for link_ms, style, width in ((row.critical_link_ms, "k-", _EDGE_PT), (row.theory_link_ms, "w--", _THEORY_PT)):
        if link_ms is not None and link_ms <= max(row.line.axes.delays_ms):
            axis.plot([link_ms, link_ms], [y - 0.42, y + 0.42], style, linewidth=width)


def _up_to(row: LineResult, delays_ms: npt.NDArray[np.float64], edges: npt.NDArray[np.float64]) -> Any:
    """Return the borders of a line's cells, with the found edge instead of the border nearest to it."""
    if row.critical_link_ms is None or not 0 < (place := int(np.searchsorted(delays_ms, row.critical_link_ms))) < len(
        delays_ms
    ):
        return edges
    return np.concatenate([edges[:place], [row.critical_link_ms], edges[place + 1 :]])


def _edges(delays_ms: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the borders of the cells of a map, shape (n + 1,)."""
    middles = 0.5 * (delays_ms[1:] + delays_ms[:-1])
    lone = 0.5 if len(delays_ms) == 1 else 0.0
    return np.concatenate([[delays_ms[0] - lone], middles, [delays_ms[-1] + lone]])


def growth_figure(results: Sequence[LineResult]) -> "Figure":
    """Draw the growth rate over the delay, in a panel for each law."""
    laws = _by_law(results)
    figure, axes = _panels(len(laws), 2.6)
    for axis, (law, rows) in zip(axes, laws.items(), strict=True):
        for look, row in zip(looks(len(rows)), rows, strict=True):
            growths = [(c.cell.round_trip_ms, c.growth_per_s) for c in row.cells if c.growth_per_s is not None]
            if growths:
                axis.plot(
                    *zip(*growths, strict=True), look.mark, ls=look.style, ms=3, color=look.colour, label=row.line.label
                )
            if row.theory_link_ms is not None:
                axis.axvline(row.theory_link_ms, color=look.colour, linestyle=":")
        axis.axhline(0.0, color="0.4", linewidth=0.8)
        axis.set_yscale("symlog", linthresh=_LINEAR_PER_S)
        axis.set_yticks(_RATES_PER_S)
        axis.set_xlim(0.0, max(rows[0].line.axes.delays_ms) + 1.0)
        axis.set_ylabel("growth rate [1/s]")
        axis.set_title(law.replace("_", " "), loc="left", fontsize="medium")
        if axis.get_legend_handles_labels()[0]:
            axis.legend(fontsize="small")
        else:
            axis.text(
                0.5, 0.6, "nothing left to measure: all motion has died out", transform=axis.transAxes, ha="center"
            )
    axes[-1].set_xlabel("round trip of the link [ms] (dotted: edge of the sampled loop in theory)")
    return figure


def two_port_figure(results: Sequence[LineResult]) -> "Figure | None":
    """Draw Llewellyn's condition over frequency for the linear laws, without delay and at two delays."""
    omega = np.geomspace(0.5, 500.0, 600)
    longest = max(results[0].line.axes.delays_ms)
    drawn: dict[str, list[tuple[float, npt.NDArray[np.float64]]]] = {}
    for law, rows in _by_law(results).items():
        section = rows[0].line.cell(0.0).controller().law_config()
        for delay_ms in dict.fromkeys((0.0, 0.2 * longest, longest)):
            hybrid = hybrid_of(law, section, delay_ms * 1e-3, omega)
            if hybrid is not None:
                drawn.setdefault(law, []).append((delay_ms, llewellyn(hybrid)))
    if not drawn:
        return None
    figure, axes = _panels(len(drawn), 2.4)
    for axis, (law, curves) in zip(axes, drawn.items(), strict=True):
        for (delay_ms, values), (colour, style) in zip(curves, _CURVES, strict=False):
            axis.semilogx(omega / (2.0 * np.pi), values, color=colour, ls=style, label=f"{delay_ms:g} ms")
        axis.axhline(0.0, color="0.4", linewidth=0.8)
        axis.set_ylabel("Llewellyn\nstability parameter")
        axis.set_title(law.replace("_", " "), loc="left", fontsize="medium")
        axis.legend(fontsize="small", title="round trip")
    axes[-1].set_xlabel("frequency [Hz] (absolutely stable where no curve is below 0)")
    return figure


def energy_figure(results: Sequence[LineResult]) -> "Figure":
    """Draw the net energy absorbed by the two-port in a law's last stable cell and in the first that is not stable."""
    # The last line of a law has the stiffest environment, the greatest gain and the worst link.
    shown = [rows[-1] for rows in _by_law(results).values()]
    figure, axes = _panels(len(shown), 2.4)
    for axis, result in zip(axes, shown, strict=True):
        for cell, (colour, style) in zip(boundary_cells(result), _CURVES, strict=False):
            try:
                course = trajectory_of(cell.cell)
            except RigError:
                # The session never began and has no energies.
                continue
            stored = energies_of(course, scales_of(cell.cell.controller())).stored_j
            label = f"{cell.cell.round_trip_ms:g} ms: {cell.verdict.replace('_', ' ')}"
            axis.plot(course.time_s, 1e3 * stored, color=colour, ls=style, linewidth=1.2, label=label)
        axis.axhline(0.0, color="0.4", linewidth=0.8)
        axis.set_ylabel("net energy absorbed\nby the teleoperator [mJ]")
        axis.set_title(f"{result.line.law.replace('_', ' ')}, {result.line.label}", loc="left", fontsize="medium")
        axis.legend(fontsize="small")
    axes[-1].set_xlabel("time [s]")
    return figure


def boundary_cells(result: LineResult) -> list[CellResult]:
    """Return the last cell before the first unstable one, and that one; if all are stable, the longest delay."""
    unstable = [i for i, cell in enumerate(result.cells) if cell.verdict != "stable"]
    if not unstable:
        return [result.cells[-1]]
    first = unstable[0]
    return list(result.cells[max(0, first - 1) : first + 1])


def broken_assumption(cell: Cell, result: CellResult) -> str:
    """Return a sentence on the assumption of passivity that fails in a cell that is not stable."""
    if result.lowest_energy_j < 0.0:
        made = f"the two-port has given out {-1e3 * result.lowest_energy_j:.3g} mJ more than it was given"
        if cell.law in ("virtual_impedance", "position_force"):
            return f"{made}: a channel that sends position and force as they are is not passive with delay"
        return f"{made}: the channel's own bound did not hold at its ports"
    if cell.has_random_link:
        return (
            "the two-port held its bound: what is lost or late holds the motion back, the hand of constant force makes"
            " up for it, and the link's randomness keeps that going"
        )
    if cell.environment == "tip_sample":
        return (
            "the two-port held its bound: the energy comes from the contact itself, which snaps in and out"
            " (an environment with adhesion is not passive over a cycle that jumps), and from a hand of constant force"
        )
    return "the two-port held its bound: the hand of constant force supplies the energy of the motion"


def _page(results: Sequence[LineResult], images: dict[str, bytes], command: str) -> Page:
    environment = results[0].line.axes.environment
    page = Page(f"Stability under delay: {environment}")
    page.code(command)
    page.heading("Which delay each law tolerates")
    page.table(
        ("law", "conditions", "theory [ms]", "lockstep [ms]", "difference [%]", "theory, link [ms]", "link [ms]"),
        [_row(result) for result in results],
    )
    page.paragraph(
        "A dash in the columns of theory: the law's loop is not linear with a constant delay; any: its gain stays"
        " below 1, so no delay makes it neutral. A dash under lockstep:"
        f" no cell up to {max(results[0].line.axes.delays_ms):g} ms was unstable."
    )
    page.paragraph(SAMPLE_PERIOD)
    page.heading("Map")
    page.image(images["stability.png"], VERDICT_WORDS)
    page.image(images["growth.png"], "Growth rates: the edge is where they pass zero.")
    if "two_ports.png" in images:
        page.heading("Two-ports")
        page.image(images["two_ports.png"], TWO_PORTS)
    page.heading("Energy")
    page.image(
        images["energy.png"],
        "What the hand has put into the law's two-port less what the two-port has given to the tip, at the hand's"
        " scale. Below zero the two-port has made energy.",
    )
    page.table(
        (
            "law",
            "conditions",
            "round trip [ms]",
            "verdict",
            "motion left [N]",
            "least energy [mJ]",
            "off the surface [%]",
            "why",
        ),
        [_energy_row(result, cell) for result in results for cell in boundary_cells(result)],
    )
    page.heading("Cells")
    delays = [f"{cell.cell.round_trip_ms:g}" for cell in results[0].cells]
    page.table(
        ("law", "conditions", *delays),
        [(r.line.law, r.line.label, *(cell.verdict for cell in r.cells)) for r in results],
    )
    return page


def _row(result: LineResult) -> tuple[Any, ...]:
    edge_ms, theory = result.critical_delay_ms, result.theory_ms
    difference = 100.0 * (edge_ms / theory - 1.0) if edge_ms is not None and theory is not None else None
    values = (theory, edge_ms, difference, result.theory_link_ms, result.critical_link_ms)
    words = [None if v is None else f"{v:.2f}" for v in values]
    if result.theory_unlimited:
        words[0] = words[3] = "any"
    return (result.line.law, result.line.label, *words)


def _energy_row(result: LineResult, cell: CellResult) -> tuple[Any, ...]:
    return (
        result.line.law,
        result.line.label,
        cell.cell.round_trip_ms,
        cell.verdict,
        cell.peak_to_peak_n,
        1e3 * cell.lowest_energy_j,
        100.0 * cell.out_of_contact_share,
        "" if cell.verdict == "stable" else broken_assumption(cell.cell, cell),
    )
