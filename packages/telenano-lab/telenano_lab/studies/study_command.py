"""`telenano study`: stability maps, transparency, and the check that the bus agrees with lockstep.

Modules that import matplotlib are imported when a command runs, so that `telenano study --help` answers at once.
"""

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from telenano.analysis import FigureOptions, Page
from telenano.cli import (
    EXIT_FAILED,
    FormatOption,
    JsonOption,
    RigFileOption,
    StyleOption,
    TableOption,
    Void,
    command_group,
    report_errors,
    results_in,
    rules,
    table_formats,
    validated,
    with_options,
)
from telenano.runtime import AddressBook
from telenano.settings import profile_named
from telenano_lab.studies.gallery_command import gallery_command
from telenano_lab.studies.image_files import write_images
from telenano_lab.studies.loops.felt import FELT, refusals
from telenano_lab.studies.loops.sample import drawn_cells
from telenano_lab.studies.loops.stability import Axes, LineResult, run_stability
from telenano_lab.studies.network_command import network_command
from telenano_lab.studies.pages.felt_page import write_felt
from telenano_lab.studies.pages.transparency_page import (
    Feel,
    felt_cells,
    measure_all,
    spectrum_figures,
    write_spectra,
    write_transparency,
    z_width_of,
)
from telenano_lab.studies.promises_command import promises
from telenano_lab.studies.push_command import push
from telenano_lab.studies.study_options import OutOption, SchedulerOption, WorkersOption
from telenano_lab.studies.study_results import (
    INTERRUPTED,
    command_line,
    print_result,
    sweep_in,
    warn_of,
    write_study,
)

if TYPE_CHECKING:
    from telenano_lab.studies.loops.validate import Agreement

_BUS_INTERRUPTED = "interrupted: each session that ended has its folder, no other result was written"
# Fields without an option in studies of one link and one environment.
_ONE_LINK = ("mass_kg", "damping_n_s_per_m", "device_latency_ms", "disturbances", "seeds")
# Defaults of a study instead of those of the model, as a person would write them.
_TRANSPARENCY = {"laws": "all", "environment": "spring", "delays_ms": "0,20,40,100,200", "stiffnesses_n_per_m": "10"}
_VALIDATE = {"laws": "virtual_impedance", "environment": "tip_sample", "delays_ms": "0,40,60"}

app = command_group()
app.command()(promises)
app.command()(push)
app.command("gallery")(gallery_command)
app.command("network")(network_command)


@app.command()
@with_options(Axes)
def stability(
    given: dict[str, Any],
    out: OutOption,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    table: TableOption = "parquet",
    as_json: JsonOption = False,
) -> None:
    """Map delay against stiffness, gain, jitter or loss: stable, limit cycle or diverged, and the critical delay."""
    with report_errors(as_json, INTERRUPTED):
        from telenano_lab.studies.pages.stability_page import write_stability

        axes, tables = validated(Axes, given), table_formats(table)
        axes.check()
        with sweep_in(out, workers, scheduler, shown=not as_json) as sweep:
            results = run_stability(axes, sweep)
        summary = write_stability(results, out, command_line(), FigureOptions.of(formats, style), tables)
        over_seeds = ("link, over seeds [ms]",) if axes.seeds > 1 else ()
        head = ("law", "conditions", "theory [ms]", "lockstep [ms]", "link alone [ms]", *over_seeds)
        rows = [
            (
                r.line.law,
                r.line.label,
                "any" if r.theory_unlimited else "no theory" if r.theory_ms is None else f"{r.theory_ms:.2f}",
                _edge(r, r.critical_delay_ms),
                _edge(r, r.critical_link_ms),
                *([_over_seeds(r)] if over_seeds else []),
            )
            for r in results
        ]
        print_result(summary, head, rows, out, as_json=as_json)


@app.command()
@with_options(Feel, ("environment", "gains", "jitters", "losses", "session_s", "seed", *_ONE_LINK), _TRANSPARENCY)
def transparency(
    given: dict[str, Any],
    out: OutOption,
    workers: WorkersOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    table: TableOption = "parquet",
    as_json: JsonOption = False,
) -> None:
    """Measure what the hand feels: tracking, stiffness, hybrid matrix over frequency, Z-width of each law."""
    with report_errors(as_json, INTERRUPTED):
        axes, tables = validated(Feel, given), table_formats(table)
        warn_of(*axes.check())
        with sweep_in(out, workers, None, shown=not as_json, kind=FELT) as sweep:
            results = sweep.run(felt_cells(axes))
        places = {name: place for place, name in enumerate((*axes.instruments, *axes.laws))}
        felt = [result.row() for result in results]
        felt.sort(key=lambda row: (places[row["instrument"]], places[row["law"]], row["round_trip_ms"]))
        rows, spectra = measure_all(axes)
        options = FigureOptions.of(formats, style)
        records = [
            {**asdict(row), "hand": axes.hand, **z_width_of(spectrum)}
            for row, spectrum in zip(rows, spectra, strict=True)
        ]
        summary = {"study": "transparency", "rows": records, "felt": felt, "felt_refused": refusals(results)}
        with results_in(out) as folder:
            with options.styled():
                images = write_images(folder, spectrum_figures(spectra), command_line(), options)
            page = Page("Transparency under delay")
            page.code(command_line())
            write_transparency(page, rows)
            write_spectra(page, spectra, images)
            if felt:
                write_felt(page, felt)
            lines = [line for spectrum in spectra for line in spectrum.rows()]
            write_study(folder, page, summary, tables, transparency=records, spectra=lines, felt=felt)
        head = ("law", "delay [ms]", "verdict", "tracking [%]", "rendered [N/m]", "perceived [ms]", "contrast [dB]",
                "passive to [N/m]", "Z-width [dB]")  # fmt: skip
        print_result(summary, head, [
            (r.law, r.round_trip_ms, r.verdict, r.tracking_error_percent, r.rendered_stiffness_n_per_m,
             r.perceived_delay_ms, r.contrast_db, spectrum.passive_n_per_m, spectrum.z_width_db)
            for r, spectrum in zip(rows, spectra, strict=True)
        ], out, as_json=as_json)  # fmt: skip


@app.command()
@rules(
    Void(
        "*",
        "whose cells are drawn",
        beside="--sample",
        but="--sample-seed, --out, --site-file, --rig, --table, --json",
    ),
    Void("--sample-seed", "which draws", unless="--sample"),
    Void("--delay", "whose delays are taken", beside="--network"),
)
@with_options(Axes, ("gains", *_ONE_LINK), _VALIDATE)
def validate(
    given: dict[str, Any],
    out: OutOption,
    sample: Annotated[
        int | None,
        typer.Option(
            "--sample", min=1, max=1000, metavar="N", help="Run N drawn cells instead of those of the options."
        ),
    ] = None,
    sample_seed: Annotated[int, typer.Option("--sample-seed", min=0, help="Seed of the draw.")] = 1,
    network: Annotated[
        str, typer.Option("--network", metavar="NAME[,NAME]", help="Networks instead of the delays.")
    ] = "",
    site_file: RigFileOption = None,
    table: TableOption = "parquet",
    as_json: JsonOption = False,
) -> None:
    """Run cells on real processes over the link and compare with lockstep; exit code 1 where they disagree."""
    with report_errors(as_json, _BUS_INTERRUPTED):
        from telenano_lab.studies.loops.validate import (
            SEEDS,
            TOLERANCE_SHARE,
            Bus,
            bus_edges,
            scenario_of,
            validate_cells,
        )

        axes, tables = validated(Axes, given), table_formats(table)
        warn_of(*axes.check())
        cells = [line.cell(d) for line in axes.lines() for d in axes.delays_ms]
        if network:
            trips_ms = {name: profile_named(name).round_trip_ms for name in network.split(",")}
            cells = [
                line.cell(trip_ms).model_copy(update={"network": name.lower()})
                for line in axes.lines()
                for name, trip_ms in trips_ms.items()
            ]
        cells = drawn_cells(sample, sample_seed) if sample is not None else cells
        for cell in cells:
            scenario_of(cell)
        if site_file is not None:
            AddressBook.load(site_file)
        with results_in(out, at_once=True):
            agreements = validate_cells(cells, Bus(site_file, out), lambda text: typer.echo(text, err=True))
        records = [asdict(agreement) for agreement in agreements]
        edges = bus_edges(agreements, cells[0].controller().period_s)
        summary = {
            "study": "validate",
            "agree": all(a.agree for a in agreements),
            "bus_critical_delay_ms": [edge._asdict() for edge in edges],
            "cells": records,
        }
        head = ("law", "environment", "stiffness [N/m]", "hand", "delay [ms]", "jitter [ms]", "loss", "lockstep", "bus",
                "draws", "growth, lockstep [1/s]", "growth, bus [1/s]", "difference", "at most", "agree")  # fmt: skip
        rows = [
            (a.law, a.environment, a.stiffness_n_per_m, a.hand, a.round_trip_ms, a.jitter_ms, a.loss, a.lockstep, a.bus,
             a.draws, a.lockstep_growth_per_s, a.bus_growth_per_s, a.difference_share, a.tolerance_share, _agreed(a))
            for a in agreements
        ]  # fmt: skip
        what = f"{sample} drawn cells" if sample is not None else axes.environment
        page = Page(f"The bus against lockstep: {what}")
        page.code(command_line())
        page.table(head, rows)
        page.paragraph(
            "Difference: RMS of the tip's force on the bus less that in lockstep, over the session, as a share of the"
            f" hand's force; at most {TOLERANCE_SHARE:g} where both are stable. Over a random link lockstep runs over"
            " the losses and delays that the recording has of every message, and the bus has to have its verdict;"
            f" the draws are {SEEDS} runs over other losses, and show how much depends on them."
        )
        if edges:
            page.table(("law", "stiffness [N/m]", "critical delay on the bus [ms]"), [(e[0], *e[2:]) for e in edges])
            page.paragraph(
                "Where the growth rate on the bus passes zero, taken as linear between two cells, half a sample period"
                " included: it compares with the continuous theory and with lockstep."
            )
        with results_in(out) as folder:
            write_study(folder, page, summary, tables, validate=records)
        print_result(summary, head, rows, out, as_json=as_json)
    if not summary["agree"]:
        raise typer.Exit(EXIT_FAILED)


def _agreed(agreement: "Agreement") -> str:
    if not agreement.agree:
        late = f", a process was held up for {1e3 * agreement.stalled_s:.0f} ms" if agreement.stalled_s else ""
        return f"no{late}"
    if agreement.near_an_edge:
        return "yes, near an edge"
    return "undecided" if agreement.undecided else "yes"


def _over_seeds(result: LineResult) -> str:
    """Return deviation, interval and number of the seeds that have an edge, as text; "not random" without draws."""
    if not result.stable_shares:
        return "not random"
    of = f"{result.seeds.n if result.seeds else 0} of {result.line.axes.seeds} seeds"
    if result.seeds is None or result.seeds.deviation is None:
        return of
    return f"± {result.seeds.deviation:.2f}, mean {result.seeds.low:.1f} to {result.seeds.high:.1f}, {of}"


def _edge(result: LineResult, value_ms: float | None) -> str:
    """Return a critical delay as text, or the longest delay that was tried if all of them are stable."""
    return f"> {max(result.line.axes.delays_ms):g}" if value_ms is None else f"{value_ms:.2f}"
