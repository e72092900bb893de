"""`telenano study`: stability maps, transparency, all laws compared, and the check that the bus agrees.

What imports numba or matplotlib is imported when a command runs, so that `telenano study --help` answers at once.
"""

import contextlib
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Column, Table

from proto.errors import ConfigError
from services.viz_node.figure_style import figure_options, styled
from studies.pages.page import Page, text, write_images, write_parquet
from telenano.cli.commands.study_options import (
    BodyDampingOption,
    DeviceLatencyOption,
    DisturbOption,
    Environment,
    EnvironmentName,
    EnvironmentOption,
    FrequencyOption,
    HandName,
    HandOption,
    JitterOption,
    LawOption,
    LengthOption,
    LossOption,
    MassOption,
    OutOption,
    SampleName,
    SchedulerOption,
    SeedOption,
    SetOption,
    StiffnessOption,
    WorkersOption,
    hands,
)
from telenano.cli.commands.study_promises import promises
from telenano.cli.exit_codes import EXIT_FAILED
from telenano.cli.options import FormatOption, JsonOption, StyleOption, command_group
from telenano.cli.output import console, print_json, report_errors, results_folder
from telenano.cli.sample_options import results_in

if TYPE_CHECKING:
    from studies.loops.stability import Axes, Body
    from studies.loops.sweep import Sweep
    from studies.loops.validate import Agreement

_INTERRUPTED = "interrupted: the journal keeps the finished cells, the same command continues"
_BUS_INTERRUPTED = "interrupted: each session that ended has its folder, no other result was written"
_LONGEST_MS = 10_000.0
_STIFFEST_N_PER_M = 1e5
_PIPE_COLUMNS = 160
_FREQUENCIES = "0.2,0.5,1,2,5,10"

app = command_group()
app.command()(promises)


@app.command()
def stability(
    law: LawOption,
    environment: EnvironmentOption,
    out: OutOption,
    delay: Annotated[
        str, typer.Option("--delay", metavar="LIST|RANGE", help="Round trips of the link [ms], half of it each way.")
    ] = "0:200:5",
    stiffness: StiffnessOption = None,
    gain: Annotated[
        str | None, typer.Option("--gain", metavar="LIST|RANGE", help="Force gain K_f, for a law that has one.")
    ] = None,
    jitter: JitterOption = "0",
    loss: LossOption = "0",
    device_latency: DeviceLatencyOption = 0.0,
    seed: SeedOption = 0,
    duration: LengthOption = None,
    hand: HandOption = HandName.FORCE,
    mass: MassOption = None,
    body_damping: BodyDampingOption = None,
    disturb: DisturbOption = None,
    settings: SetOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Map delay against stiffness, gain, jitter or loss: stable, limit cycle or diverged, and the critical delay."""
    with report_errors(as_json, _INTERRUPTED):
        from studies.loops.stability import run_stability
        from studies.pages.stability_page import write_stability

        given = _Given(law, environment, stiffness, gain, jitter, loss, seed, duration, settings, hand,
                       mass, body_damping, device_latency, disturb)  # fmt: skip
        axes = given.axes(delay)
        with _sweep(out, workers, scheduler, shown=not as_json) as sweep:
            results = run_stability(axes, sweep)
        summary = write_stability(results, out, _command(), figure_options(formats, style))
        head = ("law", "conditions", "theory [ms]", "lockstep [ms]", "link alone [ms]")
        rows = [
            (
                r.line.law,
                r.line.label,
                "any" if r.theory_unlimited else _ms(r.theory_ms),
                _ms(r.critical_delay_ms),
                _ms(r.critical_link_ms),
            )
            for r in results
        ]
        _print_result(summary, head, rows, out / "stability.html", as_json=as_json)


@app.command()
def transparency(
    out: OutOption,
    law: LawOption = "all",
    delay: Annotated[
        str, typer.Option("--delay", metavar="LIST|RANGE", help="Round trips of the link [ms].")
    ] = "0,20,40,100,200",
    stiffness: StiffnessOption = None,
    seed: SeedOption = 0,
    hand: HandOption = HandName.FORCE,
    frequency: FrequencyOption = _FREQUENCIES,
    tuned: Annotated[
        bool, typer.Option("--tuned", help="Tune each law for each delay, by the rule of `study advise`.")
    ] = False,
    settings: SetOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Measure what the hand feels: tracking, stiffness, hybrid matrix over frequency, Z-width of each law."""
    with report_errors(as_json):
        from studies import option_values
        from studies.pages.compare import (
            measure_all,
            spectra_of,
            spectrum_figures,
            write_spectra,
            write_transparency,
            z_width_of,
        )

        given = _Given(law, EnvironmentName.SPRING, stiffness or "10", None, "0", "0", seed, None, settings, hand)
        axes = given.axes(delay)
        frequencies = option_values.frequencies(frequency)
        rows = measure_all(axes, axes.delays_ms, for_delay=tuned)
        spectra = spectra_of(axes, axes.delays_ms, frequencies, for_delay=tuned)
        options = figure_options(formats, style)
        records = [
            {**asdict(row), "hand": hand.value, **z_width_of(found)} for row, found in zip(rows, spectra, strict=True)
        ]
        summary = {"study": "transparency", "rows": records}
        with results_in(out) as folder:
            with styled(options):
                images = write_images(folder, spectrum_figures(spectra), _command(), options)
            page = Page("Transparency under delay")
            page.code(_command())
            write_transparency(page, rows)
            write_spectra(page, spectra, images)
            page.write(folder / "transparency.html")
            write_parquet(folder / "transparency.parquet", records)
            write_parquet(folder / "spectra.parquet", [line for found in spectra for line in found.rows()])
            (folder / "transparency.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        head = ("law", "delay [ms]", "verdict", "tracking [%]", "rendered [N/m]", "perceived [ms]", "contrast [dB]",
                "passive to [N/m]", "Z-width [dB]")  # fmt: skip
        _print_result(summary, head, [
            (r.law, r.round_trip_ms, r.verdict, r.tracking_error_percent, r.rendered_stiffness_n_per_m,
             r.perceived_delay_ms, r.contrast_db, found.passive_n_per_m, found.z_width_db)
            for r, found in zip(rows, spectra, strict=True)
        ], out / "transparency.html", as_json=as_json)  # fmt: skip


@app.command()
def compare(
    out: OutOption,
    law: LawOption = "all",
    delay: Annotated[
        str, typer.Option("--delay", metavar="LIST|RANGE", help="Round trips that are studied in detail [ms].")
    ] = "50,120,250",
    map_delay: Annotated[
        str, typer.Option("--map-delay", metavar="LIST|RANGE", help="Round trips of the maps [ms].")
    ] = "0:500:20",
    stiffness: StiffnessOption = None,
    seed: SeedOption = 0,
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=1000, help="Seeds of the random link.")] = 3,
    hand: Annotated[
        str, typer.Option("--hand", "--arm", metavar="HAND[,HAND]|all", help="force, soft, ordinary, stiff.")
    ] = "all",
    sample: Annotated[
        str, typer.Option("--sample", metavar="LIST", help="What is pressed on: contact, soft, ordinary, stiff.")
    ] = "contact,stiff",
    frequency: FrequencyOption = _FREQUENCIES,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Compare all laws on one page: advice, critical delays, holds with a force and with arms, transparency."""
    with report_errors(as_json, _INTERRUPTED):
        from studies import option_values
        from studies.loops.cells import DEFAULT_STIFFNESS
        from studies.pages.compare import Request, run_comparison, write_comparison

        springs = option_values.numbers("--stiffness", stiffness or "10,20,38", 1e-3, _STIFFEST_N_PER_M, "N/m")
        request = Request(
            option_values.laws(law),
            option_values.numbers("--map-delay", map_delay, 0.0, _LONGEST_MS, "ms"),
            option_values.numbers("--delay", delay, 0.0, _LONGEST_MS, "ms"),
            springs,
            DEFAULT_STIFFNESS["contact"][0],
            seed,
            seeds,
            hands(hand),
            option_values.frequencies(frequency),
            option_values.samples(sample),
        )
        with _sweep(out, workers, scheduler, shown=not as_json) as sweep:
            result = run_comparison(request, sweep)
        summary = write_comparison(result, out, _command(), figure_options(formats, style))
        if not as_json:
            for sentence in summary["advice"]:
                typer.echo(sentence)
        head = ("law", *(f"spring {k:g} N/m" for k in springs), "contact")
        _print_result(summary, head, [
            (name, *(_ms(v) for v in found["critical_delay_ms"].values()), _ms(found["critical_delay_contact_ms"]))
            for name, found in summary["laws"].items()
        ], out / "compare.html", as_json=as_json)  # fmt: skip


@app.command()
def advise(
    delay: Annotated[float, typer.Option("--delay", metavar="MS", min=0.0, help="Round trip of the network [ms].")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for page, table and journal; resumes a journal.")
    ] = Path("advice"),
    loss: Annotated[str, typer.Option("--loss", metavar="SHARE", help="Messages lost each way, 0 to 1, or n%.")] = "0",
    jitter: Annotated[
        str,
        typer.Option("--jitter", metavar="MS", help="Half-width of uniform jitter each way [ms], or n% of the delay."),
    ] = "0",
    sample: Annotated[
        SampleName, typer.Option("--sample", help="soft: 5 N/m, ordinary: 20 N/m, stiff: 80 N/m at the tip.")
    ] = SampleName.ORDINARY,
    stiffness: Annotated[
        float | None, typer.Option("--stiffness", metavar="N/M", help="Stiffness at the tip, in place of --sample.")
    ] = None,
    environment: EnvironmentOption = EnvironmentName.WALL,
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=1000, help="Seeds of a random network.")] = 3,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say which law to take for a network and a sample: every law, tuned for them, tried with a force and with arms."""
    with report_errors(as_json, _INTERRUPTED):
        from studies import option_values
        from studies.loops.advice import Question, in_words
        from studies.loops.advice import advise as find

        k = stiffness if stiffness is not None else option_values.WALLS_N_PER_M[sample.value]
        if not 0.0 < k <= _STIFFEST_N_PER_M:
            raise ConfigError(f"--stiffness: {k:g} N/m is outside 0 to {_STIFFEST_N_PER_M:g} N/m")
        if delay > _LONGEST_MS:
            raise ConfigError(f"--delay: {delay:g} ms is outside 0 to {_LONGEST_MS:g} ms")
        kind: Environment = environment.value
        question = Question(delay, option_values.jitters(jitter)[0], option_values.losses(loss)[0], kind, k, seeds)
        with _sweep(out, workers, None, shown=not as_json) as sweep:
            candidates = find(question, sweep)
        words = in_words(question, candidates)
        records = [candidate.as_dict() for candidate in candidates]
        summary = {"study": "advise", "take": records[0]["law"] if records[0]["suited"] else None, "advice": words,
                   "candidates": records}  # fmt: skip
        head = ("law", "stable runs", "force in a hold", "peak force", "free [N s/m]", "least energy [mJ]", "price")
        rows = [
            (c.name, f"{r['stable_runs']}/{r['runs']}", r["force_share"], r["peak_share"], r["free_n_s_per_m"],
             1e3 * r["lowest_energy_j"], r["price"]) for c, r in zip(candidates, records, strict=True)
        ]  # fmt: skip
        page = Page("Which law to take")
        page.code(_command())
        for sentence in words:
            page.paragraph(sentence)
        page.table(head, rows)
        with results_in(out) as folder:
            document = json.dumps(summary, indent=2, allow_nan=False) + "\n"
            (folder / "advise.json").write_text(document, encoding="utf-8")
            page.write(folder / "advise.html")
        if not as_json:
            for sentence in words:
                typer.echo(sentence)
            typer.echo(f"set: {candidates[0].as_flags()}")
        _print_result(summary, head, rows, out / "advise.html", as_json=as_json)


@app.command()
def validate(
    out: OutOption,
    law: LawOption = "virtual_impedance",
    environment: EnvironmentOption = EnvironmentName.CONTACT,
    delay: Annotated[
        str, typer.Option("--delay", metavar="LIST|RANGE", help="Round trips of the link [ms].")
    ] = "0,40,60",
    stiffness: StiffnessOption = None,
    jitter: JitterOption = "0",
    loss: LossOption = "0",
    seed: SeedOption = 0,
    duration: LengthOption = None,
    hand: HandOption = HandName.FORCE,
    settings: SetOption = None,
    sample: Annotated[
        int | None,
        typer.Option(
            "--sample", min=1, max=1000, metavar="N", help="Run so many drawn cells instead of those of the options."
        ),
    ] = None,
    sample_seed: Annotated[int, typer.Option("--sample-seed", min=0, help="Seed of the draw.")] = 1,
    site_file: Annotated[
        Path | None, typer.Option("--site-file", metavar="FILE", help="Address book of the rig; default: this machine.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run cells on real processes over the link and compare with lockstep; exit code 1 where they disagree."""
    with report_errors(as_json, _BUS_INTERRUPTED):
        from studies.loops.sample import drawn_cells
        from studies.loops.validate import SEEDS, TOLERANCE_SHARE, Bus, bus_edges, scenario_of, validate_cells

        given = _Given(law, environment, stiffness, None, jitter, loss, seed, duration, settings, hand)
        axes = given.axes(delay)
        cells = [line.cell(d) for line in axes.lines() for d in axes.delays_ms]
        cells = drawn_cells(sample, sample_seed) if sample is not None else cells
        for cell in cells:
            scenario_of(cell)
        with results_folder(out):
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
        what = f"{sample} drawn cells" if sample is not None else environment.value
        page = Page(f"The bus against lockstep: {what}")
        page.code(_command())
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
            write_parquet(folder / "validate.parquet", records)
            (folder / "validate.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
            page.write(folder / "validate.html")
        _print_result(summary, head, rows, out / "validate.html", as_json=as_json)
    if not summary["agree"]:
        raise typer.Exit(EXIT_FAILED)


@dataclass(frozen=True)
class _Given:
    """The options as given."""

    law: str
    environment: EnvironmentName
    stiffness: str | None
    gain: str | None
    jitter: str
    loss: str
    seed: int
    duration: float | None
    settings: list[str] | None
    hand: HandName = HandName.FORCE
    mass_kg: float | None = None
    body_damping_n_s_per_m: float | None = None
    device_latency_ms: float = 0.0
    disturbances: list[str] | None = None

    def axes(self, delay: str) -> "Axes":
        """Validate all options; ConfigError names the option."""
        from studies import option_values
        from studies.loops.cells import DEFAULT_STIFFNESS
        from studies.loops.stability import Axes

        name: Environment = self.environment.value
        if self.duration is not None and not 0.0 < self.duration <= 3600.0:
            raise ConfigError(f"--duration: {self.duration:g} s is outside 0 to 3600 s")
        stiffness = self.stiffness or ",".join(f"{k:g}" for k in DEFAULT_STIFFNESS[name])
        axes = Axes(
            option_values.laws(self.law),
            name,
            option_values.numbers("--delay", delay, 0.0, _LONGEST_MS, "ms"),
            option_values.numbers("--stiffness", stiffness, 1e-3, _STIFFEST_N_PER_M, "N/m"),
            (None,) if self.gain is None else option_values.numbers("--gain", self.gain, 0.0, 1e6, ""),
            option_values.jitters(self.jitter),
            option_values.losses(self.loss),
            self.seed,
            self.duration,
            option_values.settings(self.settings or ()),
            self.hand.value,
            self._body(),
            self.device_latency_ms,
            option_values.disturbances(self.disturbances or ()),
        )
        for line in axes.lines():
            cell = line.cell(max(axes.delays_ms))
            cell.controller()
            cell.hold_s()
            cell.disturbed_instrument(0.0)
        return axes

    def _body(self) -> "Body":
        """Return mass and damper of the body; ConfigError where there is none, or a value is out of range."""
        from studies.loops.stability import DEFAULT_BODY, Body

        for option, value in (("--mass", self.mass_kg), ("--body-damping", self.body_damping_n_s_per_m)):
            if value is not None and self.environment is not EnvironmentName.BODY:
                raise ConfigError(f"{option}: {self.environment.value} has none; give --environment body")
            if value is not None and not 0.0 <= value <= 1e3:
                raise ConfigError(f"{option}: {value:g} is outside 0 to 1000")
        default = DEFAULT_BODY
        return Body(
            default.mass_kg if self.mass_kg is None else self.mass_kg,
            default.damping_n_s_per_m if self.body_damping_n_s_per_m is None else self.body_damping_n_s_per_m,
        )


def _agreed(agreement: "Agreement") -> str:
    if not agreement.agree:
        return "no"
    if agreement.near_an_edge:
        return "yes, near an edge"
    return "undecided" if agreement.undecided else "yes"


@contextlib.contextmanager
def _sweep(out: Path, workers: int | None, scheduler: str | None, *, shown: bool) -> "Iterator[Sweep]":
    """Open the journal of a folder, with a progress bar on stderr while the sweep runs."""
    from studies.loops.sweep import JOURNAL_NAME, Journal, Sweep

    columns = (TextColumn("cells"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bar = Progress(*columns, console=Console(stderr=True), disable=not shown, transient=True)
    with results_folder(out), bar:
        task = bar.add_task("cells", total=None)
        yield Sweep(
            Journal(out / JOURNAL_NAME),
            workers or os.cpu_count() or 1,
            scheduler,
            lambda done, total: bar.update(task, completed=done, total=total),
        )


def _command() -> str:
    """Return the command that makes the page."""
    return " ".join(["telenano", *(() if sys.argv[1:2] == ["study"] else ("study",)), *sys.argv[1:]])


def _ms(value: float | None) -> str:
    return "none found" if value is None else f"{value:.2f}"


def _print_result(
    summary: dict[str, Any], head: tuple[str, ...], rows: list[tuple[Any, ...]], page: Path, *, as_json: bool
) -> None:
    if as_json:
        print_json(summary)
        return
    # folded, so that no figure is cut off on a narrow terminal
    table = Table(*(Column(name, overflow="fold") for name in head))
    for row in rows:
        table.add_row(*(text(value) for value in row))
    out = console(_PIPE_COLUMNS)
    out.print(table)
    out.print(f"page: {page}", markup=False, highlight=False)
