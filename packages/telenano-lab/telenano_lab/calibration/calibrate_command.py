"""`telenano calibrate`: sensitivity and stiffness from the measurements of your own instrument."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import JsonOption, Void, command_group, print_document, report_errors, rules
from telenano.wire import ConfigError

app = command_group()


class Sides(StrEnum):
    """Sides of 0 Hz that a density is of."""

    ONE = "one"
    TWO = "two"


ColumnsOption = Annotated[
    tuple[str, str] | None,
    typer.Option(
        "--columns", metavar="X Y", help="Columns of a text table, by number or title; default: by its headings."
    ),
]


def _figure(path: Path | None) -> Path | None:
    if path is not None and path.suffix not in (".png", ".svg", ".pdf"):
        raise typer.BadParameter(f"{path}: must end in .png, .svg or .pdf")
    return path


FigureOption = Annotated[
    Path | None,
    typer.Option(
        "--figure",
        metavar="FILE",
        help="Draw the data, the parts left out and the fit, as .png, .svg, .pdf.",
        callback=_figure,
    ),
]


@app.command()
def sensitivity(
    curve: Annotated[
        Path,
        typer.Option(
            "--curve",
            metavar="FILE",
            help="A curve on a hard sample: text of way [nm] and deflection [V], or a file that a package reads. The "
            "way may rise towards the sample or away from it: the end where the lever is free shows which.",
        ),
    ],
    part: Annotated[
        tuple[float, float],
        typer.Option("--part", metavar="LOW HIGH", help="Part of the voltage span to use, as two shares."),
    ] = (0.3, 0.95),
    way_unit: Annotated[
        str,
        typer.Option(
            "--way-unit", metavar="UNIT", help="Unit of the way in a text table; default: by its heading, or nm."
        ),
    ] = "",
    deflection_unit: Annotated[
        str,
        typer.Option(
            "--deflection-unit", metavar="UNIT", help="Unit of the deflection; default: by its heading, or V."
        ),
    ] = "",
    columns: ColumnsOption = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Accept a deflection per volt outside the usual range.")
    ] = False,
    figure: FigureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the deflection per volt: the slope of height over voltage in contact with a hard sample, with its error.

    It uses the approach, and prints which parts of the curve it leaves out.
    """
    with report_errors(as_json):
        document = _sensitivity(curve, part, way_unit, deflection_unit, columns, anyway=anyway, figure=figure)
    print_document(document, str(curve), as_json=as_json)


@app.command()
@rules(
    Void("--sides, --noise-bandwidth, --frequency-unit, --columns", "which is no spectrum", beside="--record"),
    Void("--rate", "which has samples", unless="--record"),
    Void("--sensitivity-error", "whose error it is", unless="--sensitivity"),
    Void("--size-error", "whose error it is", unless="--size"),
)
def stiffness(
    temperature: Annotated[float, typer.Option("--temperature", metavar="K", help="Temperature [K].")] = 300.0,
    spectrum: Annotated[
        Path | None,
        typer.Option("--spectrum", metavar="FILE", help="A thermal spectrum: frequency and density."),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(
            "--unit",
            metavar="UNIT",
            help="Unit of the density: V^2/Hz, V/sqrt(Hz), m^2/Hz, m/sqrt(Hz), Vpk/sqrt(Hz), 'dB re 1 V^2/Hz'; of the"
            " power of lines V^2 or V; of a record V; default: by its heading.",
        ),
    ] = "",
    sides: Annotated[
        Sides | None,
        typer.Option(
            "--sides", help="Whether the density is that of one side of 0 Hz or of both; default: as the file shows."
        ),
    ] = None,
    noise_bandwidth: Annotated[
        float | None,
        typer.Option(
            "--noise-bandwidth",
            min=1e-9,
            metavar="HZ",
            help="Noise bandwidth of a line, where the file has the power of lines; default: by its head.",
        ),
    ] = None,
    frequency_unit: Annotated[
        str,
        typer.Option("--frequency-unit", metavar="UNIT", help="Unit of the frequency; default: by its heading, or Hz."),
    ] = "",
    columns: ColumnsOption = None,
    exclude: Annotated[
        tuple[float, float] | None,
        typer.Option("--exclude", metavar="LOW HIGH", help="Leave out lines of the electronics between these [Hz]."),
    ] = None,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Accept a resonance, Q and mass outside the usual range.")
    ] = False,
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help="A record of the free deflection [V].")
    ] = None,
    sensitivity_nm: Annotated[
        float | None, typer.Option("--sensitivity", min=1e-6, metavar="NM/V", help="Deflection per volt [nm/V].")
    ] = None,
    sensitivity_error: Annotated[
        float,
        typer.Option("--sensitivity-error", min=0.0, metavar="NM/V", help="Standard error of --sensitivity [nm/V]."),
    ] = 0.0,
    rate: Annotated[
        float | None, typer.Option("--rate", min=1e-3, metavar="HZ", help="Rate of the samples [Hz].")
    ] = None,
    averages: Annotated[
        float | None,
        typer.Option(
            "--averages",
            min=1.0,
            metavar="N",
            help="Periodograms averaged in each line; default: by the file or the scatter.",
        ),
    ] = None,
    factor: Annotated[
        float | None, typer.Option("--factor", min=0.1, max=2.0, metavar="C", help="Factor of the mode and read-out.")
    ] = None,
    size: Annotated[
        tuple[float, float] | None,
        typer.Option("--size", metavar="WIDTH LENGTH", help="Size of a rectangular lever [nm], to add Sader's method."),
    ] = None,
    size_error: Annotated[
        float, typer.Option("--size-error", min=0.0, metavar="NM", help="Standard error of width and of length [nm].")
    ] = 0.0,
    figure: FigureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the stiffness of the cantilever from its thermal noise, by the area of the fitted resonance."""
    with report_errors(as_json):
        from telenano_lab.calibration.own_calibration import (
            BY_ANGLE,
            Spectrum,
            Thermal,
            record_of,
            spectrum_of,
            stiffness_of_record,
            stiffness_of_spectrum,
        )
        from telenano_lab.calibration.resonance import periodogram

        if (spectrum is None) == (record is None):
            raise ConfigError("--spectrum, --record: give one of them")
        is_of_metres, window = False, None
        if spectrum is not None:
            found_spectrum = spectrum_of(
                spectrum, unit, frequency_unit, columns or (),
                sides=None if sides is None else 1 + (sides is Sides.TWO), noise_bandwidth_hz=noise_bandwidth,
            )  # fmt: skip
            window = found_spectrum.window
            is_of_metres = found_spectrum.is_of_metres
            averages = averages or found_spectrum.averages
        if sensitivity_nm is None and not is_of_metres:
            raise ConfigError("--sensitivity: a measurement in volts needs the deflection for a volt [nm/V]")
        width, length = (1e-9 * value for value in size) if size else (None, None)
        way_m, way_error_m = (1.0, 0.0) if is_of_metres else (1e-9 * (sensitivity_nm or 0.0), 1e-9 * sensitivity_error)
        mode = BY_ANGLE if factor is None else factor
        thermal = Thermal(
            way_m, temperature, mode, width, length, rate, averages, way_error_m, 1e-9 * size_error,
            (exclude,) if exclude else (), anyway, window,
        )  # fmt: skip
        if spectrum is not None:
            stiffness_found = stiffness_of_spectrum(found_spectrum.frequency_hz, found_spectrum.density_per_hz, thermal)
            remarks = found_spectrum.remarks
        else:
            deflection, remarks = record_of(record or Path(), unit)
            stiffness_found = stiffness_of_record(deflection, thermal)
            found_spectrum = Spectrum(*periodogram(deflection, rate or 1.0), is_of_metres=False)
        if figure is not None:
            from telenano_lab.calibration.calibration_figure import draw, resonance_figure

            draw(
                resonance_figure(found_spectrum.frequency_hz, found_spectrum.density_per_hz, stiffness_found, thermal),
                figure,
            )
        stiffness_found = stiffness_found._replace(remarks=(*remarks, *stiffness_found.remarks))
    print_document(stiffness_found._asdict(), str(spectrum or record), as_json=as_json)


def _sensitivity(
    curve: Path,
    part: tuple[float, float],
    way_unit: str,
    deflection_unit: str,
    columns: tuple[str, str] | None,
    *,
    anyway: bool,
    figure: Path | None,
) -> dict[str, Any]:
    """Return the result for one curve, or the statistic over the curves of a file."""
    from telenano_lab.calibration.own_calibration import (
        TEXTS,
        curve_of,
        require_usual,
        sensitivities_of_file,
        sensitivity_of_curve,
    )

    remarks: tuple[str, ...] = ()
    if curve.suffix.lower() not in TEXTS:
        if figure is not None:
            raise ConfigError("--figure: is for a text table of one curve")
        several, refused = sensitivities_of_file(curve, *part)
    else:
        way_m, volts, remarks = curve_of(curve, way_unit, deflection_unit, columns or ())
        several, refused = [sensitivity_of_curve(way_m, volts, *part)], 0
        if figure is not None:
            from telenano_lab.calibration.calibration_figure import contact_figure, draw

            draw(contact_figure(way_m, volts, several[0]), figure)
    if not anyway:
        require_usual(several)
    if len(several) + refused == 1:
        (sensitivity,) = several
        return {
            "sensitivity_nm_per_v": 1e9 * sensitivity.m_per_v,
            "standard_error_nm_per_v": 1e9 * sensitivity.standard_error_m_per_v,
            "points": sensitivity.points,
            "residual_nm": 1e9 * sensitivity.residual_m,
            "residual_ratio": sensitivity.residual_ratio,
            "remarks": (*remarks, *sensitivity.remarks),
        }
    from telenano_lab.studies.repetitions import statistic

    over = statistic([1e9 * one.m_per_v for one in several])
    return {
        "sensitivity_nm_per_v": over.mean,
        "deviation_nm_per_v": over.deviation,
        "low_nm_per_v": over.low,
        "high_nm_per_v": over.high,
        "curves": over.n,
        "curves_without_hard_contact": refused,
    }
