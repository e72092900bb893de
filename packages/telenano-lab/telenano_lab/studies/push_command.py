"""`telenano study push`: placing of a particle by a delayed hand, against round trip, loss and law."""

from typing import TYPE_CHECKING, Annotated

import typer

from telenano.analysis import FigureOptions, Page
from telenano.cli import FormatOption, JsonOption, StyleOption, Void, law_names, report_errors, results_in, rules
from telenano_lab.studies import option_values
from telenano_lab.studies.figure_colours import looks
from telenano_lab.studies.image_files import write_images
from telenano_lab.studies.study_options import OutOption, WorkersOption
from telenano_lab.studies.study_results import INTERRUPTED, command_line, print_result, sweep_in, write_study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from telenano_lab.studies.loops.push_study import Row

_HEAD = ("law", "round trip [ms]", "loss", "placed", "of them", "at least", "at most", "time [s]", "error [nm]",
         "lost, a push", "across [nN]", "along [nN]")  # fmt: skip
_SEEDS, _QUICK_SEEDS = 100, 12
_ASIDE_MS = 4.0


@rules(Void("--seeds", f"with which there are {_QUICK_SEEDS} trials each", beside="--quick"))
def push(
    out: OutOption,
    law: Annotated[
        str, typer.Option("--law", metavar="LAW[,LAW]|all", help="Laws to study.", autocompletion=law_names)
    ] = "virtual_impedance,passivity,wave",
    delay: Annotated[str, typer.Option("--delay", metavar="LIST|RANGE", help="Round trips of the link [ms].")] = (
        "0,100,200,350,500"
    ),
    loss: Annotated[
        str, typer.Option("--loss", metavar="LIST", help="Share of messages lost each way, 0 to 1, or n%.")
    ] = "0,20%",
    seeds: Annotated[
        int | None,
        typer.Option("--seeds", min=1, max=10_000, metavar="N", help=f"Trials of each law over each link; {_SEEDS}."),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help=f"{_QUICK_SEEDS} trials each.")] = False,
    workers: WorkersOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Let a delayed hand push a particle to a goal: share placed, time, force, losses, against round trip and law."""
    with report_errors(as_json, INTERRUPTED):
        from telenano_lab.studies.loops.push_study import PLACED_M, PUSHES, REACTION_S, rows_of, trials_of

        delays, lost, laws = option_values.delays(delay), option_values.losses(loss), option_values.laws(law)
        trials = trials_of(laws, delays, lost, _QUICK_SEEDS if quick else seeds or _SEEDS)
        with sweep_in(out, workers, None, shown=not as_json, kind=PUSHES) as sweep:
            rows = rows_of(sweep.run(trials))
        records = [row._asdict() for row in rows]
        summary = {"study": "push", "seeds": rows[0].trials, "rows": records}
        lines = [(r.law, r.round_trip_ms, f"{100 * r.loss:g} %", r.placed, *r[3:4], *r[5:]) for r in rows]
        options = FigureOptions.of(formats, style)
        page = Page("Particles placed by a delayed hand")
        page.code(command_line())
        with results_in(out) as folder:
            with options.styled():
                images = write_images(folder, {"push": push_figure(rows)}, command_line(), options)
            page.image(
                images["push.png"],
                f"A hand with a reaction time of {1e3 * REACTION_S:g} ms pushes a latex sphere of 250 nm by 1 um;"
                f" {rows[0].trials} trials each, with intervals of 95 % (Wilson). Placed: within {1e9 * PLACED_M:g} nm"
                " at the end. Points lie a few ms aside, so that equal ones are seen.",
            )
            page.table(_HEAD, lines)
            write_study(folder, page, summary, push=records)
        print_result(summary, _HEAD, lines, out, as_json=as_json)


def push_figure(rows: "list[Row]") -> "Figure":
    """Return the figure: share placed, time, losses and peak force along the tip, against the round trip."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 6.4), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True).flat
    lines = sorted({(row.law, row.loss) for row in rows})
    laws = sorted({law for law, _ in lines})
    for law, loss in lines:
        chosen = [row for row in rows if (row.law, row.loss) == (law, loss)]
        # Lines are shifted by this, so that equal ones are seen beside each other.
        aside_ms = _ASIDE_MS * (lines.index((law, loss)) - 0.5 * (len(lines) - 1))
        trips = [row.round_trip_ms + aside_ms for row in chosen]
        colour, _, mark = looks(len(laws))[laws.index(law)]
        look = {"color": colour, "linestyle": "-" if loss == 0.0 else "--", "marker": mark, "ms": 4.0}
        label = law.replace("_", " ") + (f", {100 * loss:g} % lost" if loss else "")
        shares = [row.placed / row.trials for row in chosen]
        errors = [
            [share - row.low for share, row in zip(shares, chosen, strict=True)],
            [row.high - share for share, row in zip(shares, chosen, strict=True)],
        ]
        panels[0].errorbar(trips, shares, yerr=errors, capsize=3, label=label, **look)
        panels[1].plot(trips, [float("nan") if row.time_s is None else row.time_s for row in chosen], **look)
        panels[2].plot(trips, [row.losses for row in chosen], **look)
        panels[3].plot(trips, [row.press_nn for row in chosen], **look)
    names = (
        "share placed",
        "time of those placed, s",
        "losses of the particle, a push",
        "peak force along the tip, nN",
    )
    for axes, name in zip(panels, names, strict=True):
        axes.set_ylabel(name)
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    for axes in (panels[2], panels[3]):
        axes.set_xlabel("round trip, ms")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(4, len(labels)), fontsize=8)
    return figure
