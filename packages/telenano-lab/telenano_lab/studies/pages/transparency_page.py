"""The page of transparency: how the hand feels each law, over the delay and over frequency."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from telenano.analysis import Page, cell_text
from telenano.settings import Option
from telenano_lab.studies.loops.cells import Cell
from telenano_lab.studies.loops.felt import FeltCell
from telenano_lab.studies.loops.stability import Axes, Line
from telenano_lab.studies.loops.transparency import STIFFEST_N_PER_M, Spectrum, Transparency, measure, spectrum
from telenano_lab.studies.loops.tuning import tuned
from telenano_lab.studies.option_values import disturbances_of, frequencies, named_instruments
from telenano_lab.studies.pages.figures import hybrid_figure, impedance_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Faster swings are felt as masses and are in no table of stiffness [Hz].
FASTEST_HZ = 2.5
_FREQUENCIES = "0.2,0.5,1,2,5,10"


class Feel(Axes):
    """The conditions under which transparency is measured."""

    frequencies_hz: Annotated[
        tuple[float, ...], Option(("--frequency",), "LIST", frequencies, written=_FREQUENCIES)
    ] = Field(default=frequencies(_FREQUENCIES), description="Sines of the hand [Hz]")
    instruments: Annotated[
        tuple[str, ...], Option(("--instrument",), "NAME[,NAME]", named_instruments, written="ideal")
    ] = Field(default=("ideal",), description="Names of instruments for the table of felt stiffness")
    draws: Annotated[int, Option(("--draws",), "N")] = Field(
        default=4, ge=2, le=1000, description="Sessions per cell of that table; they differ in force, swing and noise"
    )
    tuned: Annotated[bool, Option(("--tuned",))] = Field(
        default=False, description="Tune each law for each delay, by the rule of `study advise`"
    )

    def check(self) -> list[str]:
        """Return the doubts about the cells, and a text if the rule of tuning changes no law."""
        doubts = super().check()
        if self.tuned and cells_of(self) == cells_of(self.model_copy(update={"tuned": False})):
            doubts.append(f"--tuned: {', '.join(self.laws)}: by its rule the defaults stay at these delays")
        return doubts


def cells_of(axes: Feel) -> list[Cell]:
    """Return a cell for every law and delay, on the first spring of the axes; tuned for the delay if requested."""
    lines: dict[str, Line] = {}
    for line in axes.lines():
        lines.setdefault(line.law, line)
    cells = [line.cell(delay) for line in lines.values() for delay in axes.delays_ms]
    if not axes.tuned:
        return cells
    return [
        cell.model_copy(
            update={"settings": (*cell.settings, *tuned(cell.law, cell.stiffness_n_per_m, cell.round_trip_s))}
        )
        for cell in cells
    ]


def felt_cells(axes: Feel) -> list[FeltCell]:
    """Return the cells of the table of felt stiffness: each law, instrument, delay, spring and swing.

    Cells that share the noise of their instruments follow one another, because drawing it takes longer than a run.
    """
    swings = [frequency for frequency in axes.frequencies_hz if frequency <= FASTEST_HZ]
    springs = dict.fromkeys(line.stiffness_n_per_m for line in axes.lines())
    return [
        FeltCell(
            **cell.model_dump(exclude={"stiffness_n_per_m", "disturbances"}),
            stiffness_n_per_m=stiffness,
            disturbances=disturbances_of(instrument),
            instrument_name=instrument,
            frequency_hz=frequency,
            draws=axes.draws,
        )
        for instrument in axes.instruments
        for delay in axes.delays_ms
        for frequency in swings
        for cell in cells_of(axes)
        if cell.round_trip_ms == delay
        for stiffness in springs
    ]


def measure_all(axes: Feel) -> tuple[list[Transparency], list[Spectrum]]:
    """Measure every law on the first spring of the axes at every delay: at one frequency, and over all frequencies."""
    cells = cells_of(axes)
    return [measure(cell) for cell in cells], [spectrum(cell, axes.frequencies_hz) for cell in cells]


def z_width_of(spectrum: Spectrum) -> dict[str, float | None]:
    """Return the stiffest spring that is rendered passively [N/m], and the Z-width [dB]."""
    return {"passive_n_per_m": spectrum.passive_n_per_m, "z_width_db": spectrum.z_width_db}


def spectrum_figures(spectra: Sequence[Spectrum]) -> "dict[str, Figure]":
    """Draw the figures over frequency: impedances at every delay, and a hybrid matrix for each delay."""
    figures = {"impedances": impedance_figure(spectra)}
    for delay in sorted({row.round_trip_ms for row in spectra}):
        some = [row for row in spectra if row.round_trip_ms == delay]
        figures[f"hybrid-{delay:g}ms"] = hybrid_figure(some)
    return figures


def write_spectra(page: Page, spectra: Sequence[Spectrum], images: dict[str, bytes]) -> None:
    """Add the Z-width and the figures over frequency to a page."""
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
    return f">= {STIFFEST_N_PER_M:g}" if value == STIFFEST_N_PER_M else cell_text(value)


def write_transparency(page: Page, rows: Sequence[Transparency]) -> None:
    """Add the table of transparency and an explanation of its columns to a page."""
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
