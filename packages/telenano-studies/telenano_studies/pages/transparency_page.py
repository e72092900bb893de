"""All laws on one page: the delay each one bears, what it does under loss and jitter, and what the hand feels of it."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_args

from pydantic import Field

from analysis.page import Page, text, write_images, write_tables
from analysis.statistics import Statistic
from recording.whole_files import whole_results
from services.controller.config import LAWS
from services.runtime.settings.config import Settings
from services.runtime.settings.option import Option
from services.viz_node.figure_style import ON_SCREEN, FigureOptions, styled
from telenano_studies import option_values
from telenano_studies.loops.cells import (
    DEFAULT_STIFFNESS,
    Cell,
    CellResult,
    Hand,
    energies_of,
    scales_of,
    trajectory_of,
)
from telenano_studies.loops.merits import (
    FIGURES,
    SAMPLES,
    Merit,
    Network,
    Sample,
    Trial,
    in_words,
    run_merits,
    tables_of,
)
from telenano_studies.loops.stability import Axes, Line, LineResult, run_stability
from telenano_studies.loops.sweep import Sweep
from telenano_studies.loops.transparency import STIFFEST_N_PER_M, Spectrum, Transparency, measure, spectrum
from telenano_studies.loops.tuning import tuned
from telenano_studies.option_values import Jitter, chosen, delays, frequencies, stiffnesses
from telenano_studies.pages.figures import hybrid_figure, impedance_figure, merits_figure
from telenano_studies.pages.stability_page import SAMPLE_PERIOD, VERDICT_WORDS, broken_assumption

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OVER_SEEDS_HEAD = ("sample", "network", "take", "seeds that hold", "force in the worst hold", "peak force")
OVER_SEEDS_KEYS = ("stable_share", "force_share", "peak_share")
OVER_SEEDS = "Over the seeds of a random link: mean ± standard deviation and, in brackets, the interval of 95 %."
LIGHT_LOSS = 0.03
HARD_LOSS = 0.2
HARD_JITTER = Jitter(0.5, relative=True)


_FREQUENCIES = "0.2,0.5,1,2,5,10"
_Frequencies = Annotated[
    tuple[float, ...], Option(("--frequency",), "LIST", frequencies, written=_FREQUENCIES)
]  # fmt: skip
_SINES = "Sines of the hand [Hz], of a whole number of ms each"


class Feel(Axes):
    """What the transparency is measured for."""

    frequencies_hz: _Frequencies = Field(default=frequencies(_FREQUENCIES), description=_SINES)
    tuned: Annotated[bool, Option(("--tuned",))] = Field(
        default=False, description="Tune each law for each delay, by the rule of `study advise`"
    )


def _hands(text: str) -> tuple[str, ...]:
    given = chosen("--hand", "hand", text, get_args(Hand))
    return tuple(name for name in get_args(Hand) if name in given)


def _samples(text: str) -> tuple[Sample, ...]:
    return tuple(SAMPLES[name] for name in chosen("--sample", "sample", text, tuple(SAMPLES)))


class Request(Settings):
    """What to compare."""

    laws: Annotated[tuple[str, ...], Option(("--law",), "LAW[,LAW]|all", option_values.laws, written="all")] = Field(
        default=tuple(LAWS), description="Laws to study"
    )
    map_delays_ms: Annotated[
        tuple[float, ...],
        Option(("--map-delay",), "LIST|RANGE", partial(delays, option="--map-delay"), written="0:500:20"),
    ] = Field(default=delays("0:500:20"), description="Round trips of the maps [ms]")
    delays_ms: Annotated[tuple[float, ...], Option(("--delay",), "LIST|RANGE", delays, written="50,120,250")] = Field(
        default=(50.0, 120.0, 250.0), description="Round trips that are studied in detail [ms]"
    )
    spring_n_per_m: Annotated[
        tuple[float, ...], Option(("--stiffness",), "LIST|RANGE", stiffnesses, written="10,20,38")
    ] = Field(default=DEFAULT_STIFFNESS["spring"], description="K of the springs [N/m]")
    seed: int = Field(default=0, ge=0, description="Seed of the link's random streams")
    seeds: int = Field(default=3, ge=1, le=1000, description="Seeds of the random link")
    hands: Annotated[tuple[Hand, ...], Option(("--hand", "--arm"), "HAND[,HAND]|all", _hands, written="all")] = Field(
        default=get_args(Hand), description="force, soft, ordinary, stiff"
    )
    frequencies_hz: _Frequencies = Field(default=frequencies(_FREQUENCIES), description=_SINES)
    samples: Annotated[tuple[Sample, ...], Option(("--sample",), "LIST", _samples, written="contact,stiff")] = Field(
        default=_samples("contact,stiff"), description="What is pressed on: contact, soft, ordinary, stiff"
    )

    @property
    def trial(self) -> Trial:
        """Return what the figures of merit are taken from: every delay, constant, with a little loss, and bad."""
        networks = [Network(delay) for delay in self.delays_ms]
        networks += [Network(delay, loss=LIGHT_LOSS) for delay in self.delays_ms]
        networks += [Network(delay, HARD_JITTER, HARD_LOSS) for delay in self.delays_ms]
        return Trial(self.laws, tuple(networks), self.hands, self.samples, self.seed, self.seeds)


@dataclass(frozen=True)
class Comparison:
    """Maps on the spring and in the contact; courses at the chosen delays over a good and a bad link; merits; feel."""

    request: Request
    spring: list[LineResult]
    contact: list[LineResult]
    good: list[CellResult]
    bad: list[CellResult]
    merits: list[Merit]
    transparency: list[Transparency]
    spectra: list[Spectrum]


def run_comparison(request: Request, sweep: Sweep) -> Comparison:
    """Run everything that the page shows; the maps go through the sweep and its journal."""
    axes = Axes(environment="contact", laws=request.laws, delays_ms=request.map_delays_ms, seed=request.seed)
    spring = axes.model_copy(update={"environment": "spring", "stiffnesses_n_per_m": request.spring_n_per_m})
    contact = axes
    bad = {"delays_ms": request.delays_ms, "jitters": (HARD_JITTER,), "losses": (HARD_LOSS,)}
    hard = axes.model_copy(update=bad)
    cells = [[line.cell(d) for line in axes.lines() for d in request.delays_ms] for axes in (contact, hard)]
    return Comparison(
        request,
        run_stability(spring, sweep),
        run_stability(contact, sweep),
        sweep.run(cells[0]),
        sweep.run(cells[1]),
        run_merits(request.trial, sweep),
        measure_all(spring, request.delays_ms, for_delay=True),
        spectra_of(spring, request.delays_ms, request.frequencies_hz, for_delay=True),
    )


def _first_lines(axes: Axes) -> list[Line]:
    """Return the line of each law on the first spring of the axes."""
    lines: dict[str, Line] = {}
    for line in axes.lines():
        lines.setdefault(line.law, line)
    return list(lines.values())


def _cells(axes: Axes, delays_ms: Sequence[float], *, for_delay: bool) -> list[Cell]:
    """Return a cell for every law, on the first spring of the axes, and delay; tuned for the delay if asked."""
    cells = [line.cell(delay) for line in _first_lines(axes) for delay in delays_ms]
    if not for_delay:
        return cells
    return [
        cell.model_copy(
            update={"settings": (*cell.settings, *tuned(cell.law, cell.stiffness_n_per_m, cell.round_trip_s))}
        )
        for cell in cells
    ]


def measure_all(axes: Axes, delays_ms: Sequence[float], *, for_delay: bool = False) -> list[Transparency]:
    """Measure every law on the first spring of the axes, at every delay; tuned for the delay if asked."""
    return [measure(cell) for cell in _cells(axes, delays_ms, for_delay=for_delay)]


def spectra_of(
    axes: Axes, delays_ms: Sequence[float], frequencies_hz: tuple[float, ...], *, for_delay: bool = False
) -> list[Spectrum]:
    """Measure every law over frequency on the first spring of the axes, at every delay; tuned for it if asked."""
    return [spectrum(cell, frequencies_hz) for cell in _cells(axes, delays_ms, for_delay=for_delay)]


def write_comparison(
    result: Comparison,
    out: Path,
    command: str,
    options: FigureOptions = ON_SCREEN,
    tables: Sequence[str] = ("parquet",),
) -> dict[str, Any]:
    """Write compare.html, .json, tables and the figures into a folder; gives the object of the JSON file."""
    summary = summarise(result)
    with styled(options):
        figures = {
            "courses": _drawn(result, "tip force, hand's scale [N]", energy=False),
            "energies": _drawn(result, "net energy absorbed [mJ]", energy=True),
            **{
                Path(name).stem: merits_figure([m for m in result.merits if (m.sample, _kind(m.network)) == place])
                for place, name in _merits_files(result).items()
            },
            **spectrum_figures(result.spectra),
        }
        with whole_results(out) as folder:
            images = write_images(folder, figures, command, options)
            write_tables(folder, "compare", [cell.as_dict() for cell in (*result.good, *result.bad)], tables)
            write_tables(folder, "merits", [merit.as_dict() for merit in result.merits], tables)
            write_tables(folder, "spectra", [row for found in result.spectra for row in found.rows()], tables)
            write_tables(folder, "take", summary["take"], tables)
            document = json.dumps(summary, indent=2, allow_nan=False) + "\n"
            (folder / "compare.json").write_text(document, encoding="utf-8")
            _page(result, images, command).write(folder / "compare.html")
    return summary


def summarise(result: Comparison) -> dict[str, Any]:
    """Return law -> critical delays, verdicts over the good and the bad link, transparency."""
    laws: dict[str, dict[str, Any]] = {}
    for law in result.request.laws:
        springs = {f"{r.line.stiffness_n_per_m:g}": r for r in result.spring if r.line.law == law}
        contact = next(r for r in result.contact if r.line.law == law)
        laws[law] = {
            "critical_delay_ms": {key: r.critical_delay_ms for key, r in springs.items()},
            "theory_delay_ms": {key: r.theory_ms for key, r in springs.items()},
            "critical_delay_contact_ms": contact.critical_delay_ms,
            "contact": {f"{c.cell.round_trip_ms:g}": _outcome(c) for c in result.good if c.cell.law == law},
            "contact_lossy": {f"{c.cell.round_trip_ms:g}": _outcome(c) for c in result.bad if c.cell.law == law},
            "transparency": [asdict(t) for t in result.transparency if t.law == law],
            "z_width": {f"{s.round_trip_ms:g}": z_width_of(s) for s in result.spectra if s.law == law},
            "merits": [merit.as_dict() for merit in result.merits if merit.law == law],
        }
    return {
        "study": "compare",
        "longest_delay_ms": max(result.request.map_delays_ms),
        "advice": in_words(result.merits),
        "take": _best(result),
        "laws": laws,
    }


def _kind(network: Network) -> str:
    return "jitter" if network.jitter.value else "loss" if network.loss else "constant"


def _merits_files(result: Comparison) -> dict[tuple[Sample, str], str]:
    """Return the name of the figure of merits of every sample and kind of network: no more than a page is wide."""
    places = dict.fromkeys((merit.sample, _kind(merit.network)) for merit in result.merits)
    return {
        (sample, kind): f"merits-{sample.environment}-{sample.stiffness_n_per_m:g}-{kind}.png"
        for sample, kind in places
    }


def _best(result: Comparison) -> list[dict[str, Any]]:
    """Return the law to take on every sample over every network, with its figures, and the next one."""
    rows = []
    for (sample, network), found in tables_of(result.merits).items():
        suited = [candidate for candidate in found if not candidate.failed]
        best = suited[0] if suited else None
        rows.append({
            "sample": str(sample),
            "network": str(network),
            "take": best.name if best else None,
            "force_share": best.force_share() if best else None,
            "peak_share": best.peak_share() if best else None,
            "free_n_s_per_m": best.free_n_s_per_m if best else None,
            "price": best.price() if best else None,
            "over_seeds": best.over_seeds_as_dict() if best else {},
            "next": suited[1].name if suited[1:] else None,
            "suited": len(suited),
        })  # fmt: skip
    return rows


def over_seeds_rows(best: Sequence[dict[str, Any]]) -> list[tuple[str, ...]]:
    """Return sample, network, law, and its figures over the seeds, where a network is random."""
    return [
        (
            row["sample"],
            row["network"],
            row["take"],
            *(str(Statistic(**row["over_seeds"][key])) for key in OVER_SEEDS_KEYS),
        )
        for row in best
        if row["over_seeds"]
    ]


def z_width_of(found: Spectrum) -> dict[str, float | None]:
    """Return the stiffest spring that is rendered passively [N/m] and the width [dB]."""
    return {"passive_n_per_m": found.passive_n_per_m, "z_width_db": found.z_width_db}


def spectrum_figures(spectra: Sequence[Spectrum]) -> "dict[str, Figure]":
    """Draw what is measured over frequency: impedances at every delay, a hybrid matrix for each delay."""
    figures = {"impedances": impedance_figure(spectra)}
    for delay in sorted({found.round_trip_ms for found in spectra}):
        some = [found for found in spectra if found.round_trip_ms == delay]
        figures[f"hybrid-{delay:g}ms"] = hybrid_figure(some)
    return figures


def _outcome(cell: CellResult) -> dict[str, Any]:
    return {
        "verdict": cell.verdict,
        "peak_to_peak_n": cell.peak_to_peak_n,
        "out_of_contact_share": cell.out_of_contact_share,
        "hold_ratio": cell.hold_ratio,
        "lowest_energy_j": cell.lowest_energy_j,
    }


def _drawn(result: Comparison, label: str, *, energy: bool) -> "Figure":
    """Draw alpha_f F_s or the energy over time at the longest of the delays, over both links, a panel a law."""
    from matplotlib.figure import Figure

    laws = result.request.laws
    delay = max(result.request.delays_ms)
    figure = Figure(figsize=(9.0, 2.3 * len(laws)), layout="constrained")
    axes = figure.subplots(len(laws), 1, squeeze=False, sharex=True)[:, 0]
    for axis, law in zip(axes, laws, strict=True):
        for cells, colour, style, name in (
            (result.good, "#0072b2", "-", "constant delay"),
            (result.bad, "#d55e00", "--", "jitter and loss"),
        ):
            cell = next(c for c in cells if c.cell.law == law and c.cell.round_trip_ms == delay)
            course, scales = trajectory_of(cell.cell), scales_of(cell.cell.controller())
            values = 1e3 * energies_of(course, scales).stored_j if energy else scales.force_scale * course.tip_force_n
            words = f"{name}: {cell.verdict.replace('_', ' ')}"
            axis.plot(course.time_s, values, style, color=colour, linewidth=1.0, label=words)
        axis.axhline(0.0, color="0.4", linewidth=0.8)
        axis.set_title(law.replace("_", " "), loc="left", fontsize="medium")
        axis.legend(fontsize="small")
    figure.supylabel(label, fontsize="medium")
    axes[-1].set_xlabel("time [s]")
    return figure


def _page(result: Comparison, images: dict[str, bytes], command: str) -> Page:
    longest = max(result.request.map_delays_ms)
    delay = max(result.request.delays_ms)
    page = Page("The laws compared")
    page.code(command)
    page.heading("Which law for which network")
    for sentence in in_words(result.merits):
        page.paragraph(sentence)
    page.paragraph(
        f"Every law tuned for the network, with the force clamp off and on; hands: {', '.join(result.request.hands)}."
        " Ranked by the price of `telenano study advise`, over all hands and seeds; suited is what held in every run."
    )
    best = _best(result)
    page.table(
        (
            "sample",
            "network",
            "take",
            "force in the worst hold",
            "peak force",
            "free [N s/m]",
            "price",
            "next",
            "suited",
        ),
        [tuple(value for key, value in row.items() if key != "over_seeds") for row in best],
    )
    over_seeds = over_seeds_rows(best)
    if over_seeds:
        page.paragraph(OVER_SEEDS)
        page.table(OVER_SEEDS_HEAD, over_seeds)
    page.heading("Delay that each law bears (round trip, ms)")
    names = [f"spring {k:g} N/m" for k in result.request.spring_n_per_m]
    page.table(
        ("law", *names, *(f"theory {name}" for name in names), f"contact, k = {DEFAULT_STIFFNESS['contact'][0]:g} N/m"),
        [_delay_row(result, law) for law in result.request.laws],
    )
    page.paragraph(f"More than {longest:g}: no cell up to that delay was unstable. {SAMPLE_PERIOD}")
    page.heading("In the contact, over a good and a bad link")
    page.paragraph(
        f"The bad link loses {100.0 * HARD_LOSS:g} % of the messages each way and varies each delay by up to half of it"
        f" (seed {result.request.seed}). {VERDICT_WORDS}"
    )
    page.table(
        ("law", "link", "round trip [ms]", "verdict", "motion left [N]", "off the surface [%]", "F_m/(alpha_f F_s)",
         "least energy [mJ]", "why"),
        [_cell_row(cell, name) for cells, name in ((result.good, "constant"), (result.bad, "jitter, loss"))
         for cell in cells],
    )  # fmt: skip
    page.image(images["courses.png"], f"Force of the tip at {delay:g} ms; the hand presses with 1 N, then with 2 N.")
    page.image(
        images["energies.png"],
        f"Energy that the two-port holds at {delay:g} ms: put in by the hand less given to the tip, at the hand's"
        " scale. Below zero it has made energy.",
    )
    page.heading("What the laws do with arms, tuned for the delay")
    for (sample, _), name in _merits_files(result).items():
        page.image(
            images[name],
            f"On the {sample}. Each mark is a law, tuned for the network; bars reach over the seeds of a random link. A"
            " cross stands for runs of which one is not stable. Grey line: what would be ideal.",
        )
    page.table(
        ("sample", "law", "clamp", "network", "hand", "verdict", "stable runs", *FIGURES.values()),
        map(_merit_row, result.merits),
    )
    page.heading("Transparency, tuned for the delay")
    write_transparency(page, result.transparency)
    write_spectra(page, result.spectra, images)
    return page


def _merit_row(merit: Merit) -> tuple[Any, ...]:
    figures = [None if spread is None else str(spread) for spread in merit.figures.values()]
    runs = f"{merit.stable}/{len(merit.results)}"
    clamp = "on" if merit.clamp else "off"
    return (str(merit.sample), merit.law, clamp, str(merit.network), merit.hand, merit.verdict, runs, *figures)


def write_spectra(page: Page, spectra: Sequence[Spectrum], images: dict[str, bytes]) -> None:
    """Add the Z-width and the figures over frequency."""
    page.table(
        ("law", "round trip [ms]", "stiffest spring rendered passively [N/m]", "Z-width at 1 Hz [dB]"),
        [(s.law, s.round_trip_ms, _limit(s.passive_n_per_m), s.z_width_db) for s in spectra],
    )
    page.paragraph(
        "Z-width after Colgate and Brown (1994): from free motion to the stiffest spring at the tip on which the"
        " impedance at the device has no negative real part at any frequency of the figures. A law can be stable with a"
        " hand of constant force beyond it; then an arm of some impedance exists that makes it unstable. A dash: none."
    )
    page.image(
        images["impedances.png"],
        f"What the hand feels over frequency, on a spring of {spectra[0].stiffness_n_per_m:g} N/m and on nothing; sines"
        " of 0.3 N. A stiffness below zero: the mass of the law and of its device.",
    )
    for name, png in images.items():
        if name.startswith("hybrid"):
            delay = name.removeprefix("hybrid-").removesuffix("ms.png")
            page.image(png, f"Hybrid matrix (Hannaford 1989) at a round trip of {delay} ms, at the hand's scale.")


def _limit(value: float | None) -> str | None:
    return f">= {STIFFEST_N_PER_M:g}" if value == STIFFEST_N_PER_M else text(value)


def write_transparency(page: Page, rows: Sequence[Transparency]) -> None:
    """Add the table of transparency and what its columns mean."""
    page.table(
        ("law", "round trip [ms]", "verdict", "tracking error [%]", "true stiffness [N/m]", "rendered [N/m]",
         "perceived delay [ms]", "free |Z| [N s/m]", "contrast [dB]"),
        [
            (t.law, t.round_trip_ms, t.verdict, t.tracking_error_percent, t.true_stiffness_n_per_m,
             t.rendered_stiffness_n_per_m, t.perceived_delay_ms, t.free_impedance_n_s_per_m, t.contrast_db)
            for t in rows
        ],
    )  # fmt: skip
    page.paragraph(
        "A hand that presses with 1 N and a sine of 0.3 N at 0.5 Hz on the spring, and with the sine alone on nothing."
        " Stiffness is at the hand: alpha_f alpha_p K. The perceived delay is that of the rendered force behind the"
        " hand's motion; the device follows its reference about 11 ms late (its bandwidth is 30 Hz), so a law without"
        " delay stands at -11 ms. A dash: the law is not stable there."
    )


def _delay_row(result: Comparison, law: str) -> tuple[Any, ...]:
    springs = [r for r in result.spring if r.line.law == law]
    contact = next(r for r in result.contact if r.line.law == law)
    longest = max(result.request.map_delays_ms)
    found = [_delay(r.critical_delay_ms, longest) for r in (*springs, contact)]
    theory = [None if r.theory_ms is None else f"{r.theory_ms:.2f}" for r in springs]
    return (law, *found[:-1], *theory, found[-1])


def _delay(value_ms: float | None, longest_ms: float) -> str:
    return f"> {longest_ms:g}" if value_ms is None else f"{value_ms:.2f}"


def _cell_row(cell: CellResult, link: str) -> tuple[Any, ...]:
    return (
        cell.cell.law,
        link,
        cell.cell.round_trip_ms,
        cell.verdict,
        cell.peak_to_peak_n,
        100.0 * cell.out_of_contact_share,
        cell.hold_ratio,
        1e3 * cell.lowest_energy_j,
        "" if cell.verdict == "stable" else broken_assumption(cell.cell, cell),
    )
