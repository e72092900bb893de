"""`telenano calibrate`: the calibrations of a laboratory, on the simulated instrument."""

from typing import Annotated

import typer

from services.runtime.settings.config import flag_overrides, validate
from telenano.cli.options import JsonOption, command_group
from telenano.cli.output import print_document, report_errors
from telenano.cli.sample_options import AfmOption

app = command_group()

SeedOption = Annotated[int, typer.Option("--seed", min=0, metavar="N", help="Seed of the noise.")]


@app.command()
def sensitivity(
    way: Annotated[float, typer.Option("--way", metavar="NM", help="Way of the base in contact [nm].")] = 20.0,
    points: Annotated[int, typer.Option("--points", min=3, metavar="N", help="Points of the regression.")] = 200,
    noise: Annotated[float, typer.Option("--noise", metavar="MV", help="White noise of a point [mV].")] = 1.0,
    bits: Annotated[int, typer.Option("--bits", min=4, max=32, metavar="N", help="Bits of a +-10 V converter.")] = 16,
    seed: SeedOption = 0,
    afm: AfmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find S_c of Eq. 3: press onto a hard sample and regress the voltage on the way, with the standard error."""
    with report_errors(as_json):
        import studies.instrument.instrument_calibration as calibration
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
    afm: AfmOption = None,
    as_json: JsonOption = False,
) -> None:
    """Find the stiffness of the cantilever from its thermal noise, by the area of the fitted resonance."""
    with report_errors(as_json):
        import studies.instrument.instrument_calibration as calibration
        from services.afm_node.config import AfmConfig

        config = validate(AfmConfig, flag_overrides(afm or ()), "--afm")
        found = calibration.calibrate_stiffness(config, duration, temperature, floor * 1e-15, seed)
    print_document(found.as_dict(), "stiffness by thermal noise", as_json=as_json)
