"""`telenano calibrate`: calibrations on the simulated instrument, or from the measurements of a real one."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.runtime.settings.config import validate
from telenano.cli.sample_options import AfmOption
from telenano.extend.commands import (
    ConfigError,
    JsonOption,
    command_group,
    flag_overrides,
    print_document,
    report_errors,
)

if TYPE_CHECKING:
    from telenano_calibration.own_calibration import Thermal

app = command_group()

SeedOption = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Seed of the noise.")]


@app.command()
def sensitivity(
    way: Annotated[float, typer.Option("--way", metavar="NM", help="Way of the base in contact [nm].")] = 20.0,
    points: Annotated[int, typer.Option("--points", min=3, metavar="N", help="Points of the regression.")] = 200,
    noise: Annotated[float, typer.Option("--noise", metavar="MV", help="White noise of a point [mV].")] = 1.0,
    bits: Annotated[int, typer.Option("--bits", min=4, max=32, metavar="N", help="Bits of a +-10 V converter.")] = 16,
    seed: SeedOption = 0,
    curve: Annotated[
        Path | None,
        typer.Option(
            "--curve",
            metavar="FILE",
            help="An own curve on a hard sample: text of way [nm] and deflection [V], or a file that a package reads.",
        ),
    ] = None,
    part: Annotated[
        tuple[float, float], typer.Option("--part", metavar="LOW HIGH", help="Shares of its span of voltage to use.")
    ] = (0.3, 0.95),
    afm: AfmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find S_c of Eq. 3: press onto a hard sample and regress the voltage on the way, with the standard error."""
    with report_errors(as_json):
        if curve is not None:
            _own_sensitivity(curve, part, as_json=as_json)
            return
        import telenano_calibration.instrument_calibration as calibration
        from services.afm_node.config import AfmConfig

        config = validate(AfmConfig, flag_overrides(afm or ()), "--afm")
        found = calibration.calibrate_sensitivity(config, way * 1e-9, points, noise * 1e-3, bits, seed)
    print_document(found.as_dict(), "sensitivity of the read-out", as_json=as_json)


@app.command()
def stiffness(
    duration: Annotated[float, typer.Option("--duration", metavar="S", help="Length of the record [s].")] = 0.2,
    temperature: Annotated[float, typer.Option("--temperature", metavar="K", help="Temperature [K].")] = 300.0,
    floor: Annotated[
        float, typer.Option("--floor", metavar="FM", help="White noise of the read-out [fm/sqrt(Hz)].")
    ] = 0.0,
    seed: SeedOption = 0,
    spectrum: Annotated[
        Path | None,
        typer.Option("--spectrum", metavar="FILE", help="An own thermal spectrum: frequency [Hz] and density."),
    ] = None,
    unit: Annotated[
        str,
        typer.Option(
            "--unit",
            metavar="UNIT",
            help="Of the density: V^2/Hz, V/sqrt(Hz), m^2/Hz or m/sqrt(Hz); default: its head.",
        ),
    ] = "",
    record: Annotated[
        Path | None, typer.Option("--record", metavar="FILE", help="An own record of the free deflection [V].")
    ] = None,
    sensitivity_nm: Annotated[
        float | None, typer.Option("--sensitivity", min=1e-6, metavar="NM/V", help="Way for a volt [nm/V].")
    ] = None,
    sensitivity_error: Annotated[
        float, typer.Option("--sensitivity-error", min=0.0, metavar="NM/V", help="Standard error of it [nm/V].")
    ] = 0.0,
    rate: Annotated[
        float | None, typer.Option("--rate", min=1e-3, metavar="HZ", help="Rate of the samples [Hz].")
    ] = None,
    averages: Annotated[
        float, typer.Option("--averages", min=1.0, metavar="N", help="Periodograms in a line of the spectrum.")
    ] = 1.0,
    factor: Annotated[
        float | None, typer.Option("--factor", min=0.1, max=2.0, metavar="C", help="Factor of the mode and read-out.")
    ] = None,
    size: Annotated[
        tuple[float, float] | None,
        typer.Option("--size", metavar="WIDTH LENGTH", help="Of a rectangular lever [um]: Sader's method as well."),
    ] = None,
    size_error: Annotated[
        float, typer.Option("--size-error", min=0.0, metavar="UM", help="Standard error of each of them [um].")
    ] = 0.0,
    as_json: JsonOption = False,
    afm: AfmOption = None,
) -> None:
    """Find the stiffness of the cantilever from its thermal noise, by the area of the fitted resonance."""
    with report_errors(as_json):
        if spectrum is not None or record is not None:
            from telenano_calibration.own_calibration import BY_ANGLE, Thermal

            width, length = (1e-6 * value for value in size) if size else (None, None)
            mode = BY_ANGLE if factor is None else factor
            errors = 1e-9 * sensitivity_error, 1e-6 * size_error
            way_m = None if sensitivity_nm is None else 1e-9 * sensitivity_nm
            known = Thermal(way_m or 1.0, temperature, mode, width, length, rate, averages, *errors)
            _own_stiffness(spectrum, record, known, unit, needs_sensitivity=way_m is None, as_json=as_json)
            return
        import telenano_calibration.instrument_calibration as calibration
        from services.afm_node.config import AfmConfig

        config = validate(AfmConfig, flag_overrides(afm or ()), "--afm")
        found = calibration.calibrate_stiffness(config, duration, temperature, floor * 1e-15, seed)
    print_document(found.as_dict(), "stiffness by thermal noise", as_json=as_json)


def _own_sensitivity(curve: Path, part: tuple[float, float], *, as_json: bool) -> None:
    from telenano_calibration.own_calibration import TEXTS, columns_of, sensitivities_of_file, sensitivity_of_curve

    if curve.suffix.lower() not in TEXTS:
        several, refused = sensitivities_of_file(curve, *part)
    else:
        way_nm, volts = columns_of(curve, 2)
        several, refused = [sensitivity_of_curve(1e-9 * way_nm, volts, *part)], 0
    if len(several) + refused > 1:
        from analysis.statistics import statistic

        over = statistic([1e9 * one.m_per_v for one in several])
        document = {
            "sensitivity_nm_per_v": over.mean,
            "deviation_nm_per_v": over.deviation,
            "low_nm_per_v": over.low,
            "high_nm_per_v": over.high,
            "curves": over.n,
            "curves_without_hard_contact": refused,
        }
        print_document(document, str(curve), as_json=as_json)
        return
    (found,) = several
    document = {
        "sensitivity_nm_per_v": 1e9 * found.m_per_v,
        "standard_error_nm_per_v": 1e9 * found.standard_error_m_per_v,
        "points": found.points,
        "residual_nm": 1e9 * found.residual_m,
    }
    print_document(document, str(curve), as_json=as_json)


def _own_stiffness(
    spectrum: Path | None,
    record: Path | None,
    known: "Thermal",
    unit: str,
    *,
    needs_sensitivity: bool,
    as_json: bool,
) -> None:
    from telenano_calibration.own_calibration import columns_of, spectrum_of, stiffness_of_record, stiffness_of_spectrum

    if spectrum is not None and record is not None:
        raise ConfigError("--spectrum, --record: give one of them")
    is_of_metres = False
    if spectrum is not None:
        frequency_hz, density, is_of_metres = spectrum_of(spectrum, unit)
    if needs_sensitivity and not is_of_metres:
        raise ConfigError("--sensitivity: what was measured in volts needs the way for a volt [nm/V]")
    if spectrum is not None:
        if is_of_metres:
            known = known._replace(sensitivity_m_per_v=1.0, sensitivity_error_m_per_v=0.0)
        found = stiffness_of_spectrum(frequency_hz, density, known)
    else:
        found = stiffness_of_record(columns_of(record or Path(), 1)[0], known)
    print_document(found._asdict(), str(spectrum or record), as_json=as_json)
