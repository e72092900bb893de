"""`telenano scan`: an image of a sample, in simulated time on this machine."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from services.runtime.config import flag_overrides, validate
from telenano.options import JsonOption
from telenano.output import print_document, report_errors
from telenano.sample_options import (
    ChannelOption,
    SampleOption,
    SampleSetOption,
    SampleSizeOption,
    make_folder,
    require,
    sample_config,
)

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from analysis.image_files import Image
    from studies.scan import ScanResult


class ScanMode(StrEnum):
    """How the tip follows the surface."""

    TAPPING = "tapping"
    CONTACT = "contact"


def scan(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for scan.gwy, scan.gsf, scan.png.")],
    mode: Annotated[
        ScanMode, typer.Option("--mode", help="tapping: constant amplitude; contact: constant force.")
    ] = ScanMode.TAPPING,
    name: SampleOption = "dots",
    size: SampleSizeOption = None,
    channel: ChannelOption = None,
    settings: SampleSetOption = None,
    pixels: Annotated[int, typer.Option("--pixels", metavar="N", help="Pixels of a line.")] = 128,
    lines: Annotated[int, typer.Option("--lines", metavar="N", help="Lines of the image.")] = 128,
    dwell: Annotated[float, typer.Option("--dwell", metavar="MS", help="Time on each pixel, each way [ms].")] = 1.0,
    amplitude: Annotated[float, typer.Option("--amplitude", metavar="NM", help="Free amplitude [nm].")] = 20.0,
    setpoint: Annotated[
        float | None,
        typer.Option("--setpoint", metavar="X", help="Share of that amplitude, or force [nN] in contact; 0.8 or 5."),
    ] = None,
    gain: Annotated[float, typer.Option("--gain", metavar="1/S", help="Integral gain of the feedback [1/s].")] = 5000.0,
    proportional: Annotated[
        float, typer.Option("--proportional", metavar="P", help="Proportional gain, in tapping mode.")
    ] = 1.0,
    temperature: Annotated[
        float, typer.Option("--temperature", metavar="K", help="Temperature of the thermal noise [K]; 0: none.")
    ] = 0.0,
    seed: Annotated[int, typer.Option("--noise-seed", min=0, metavar="N", help="Seed of the thermal noise.")] = 0,
    afm: Annotated[
        list[str] | None,
        typer.Option("--afm", metavar="KEY=VALUE", help="Change a key of afm_node, as in a scenario (repeatable)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Image a sample and write .gwy, .gsf and PNG; Ctrl-C ends the image and keeps the lines so far."""
    with report_errors(as_json):
        require("gwyfile")
        # before all other models: it has every step compiled that is imported after it
        import studies.scan as scans
        from services.afm_node.config import AfmConfig

        sample = sample_config(name, size, channel, settings)
        config = validate(AfmConfig, flag_overrides(afm or ()), "--afm")
        request = scans.ScanRequest(
            mode=mode.value,
            pixels=pixels,
            lines=lines,
            dwell_s=dwell * 1e-3,
            amplitude_m=amplitude * 1e-9,
            setpoint_share=0.8 if setpoint is None or mode is ScanMode.CONTACT else setpoint,
            setpoint_n=5e-9 if setpoint is None or mode is ScanMode.TAPPING else setpoint * 1e-9,
            integral_per_s=gain,
            proportional=proportional,
            temperature_k=temperature,
            seed=seed,
        )
        request.check()
        surface = sample.build()
        make_folder(out)
        columns = (TextColumn("lines"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Progress(*columns, console=Console(stderr=True), disable=as_json, transient=True) as bar:
            task = bar.add_task("lines", total=lines)
            result = scans.scan(surface, request, config, lambda n, of: _show(bar, task, n))
        images = _images(result, mode)
        _write(out, images)
    document = {
        "sample": sample.name,
        "mode": mode.value,
        "lines": len(result.trace),
        "pixels": pixels,
        "simulated_s": result.simulated_s,
        "rms_error_m": result.rms_error_m,
        "correlation": result.correlation,
        "files": [str(out / name) for name in ("scan.gwy", "scan.gsf", "scan.png")],
    }
    print_document(document, str(out), as_json=as_json)


def _show(bar: Progress, task: TaskID, lines: int) -> bool:
    bar.update(task, completed=lines)
    return True


def _images(result: "ScanResult", mode: ScanMode) -> "dict[str, Image]":
    """Return the channels that the mode has, and what the tip sees of the sample."""
    from analysis.image_files import Image
    from services.afm_node.imaging import AMPLITUDE, DISSIPATED, FORCE, HEIGHT, PHASE

    width, depth = result.width_m, result.depth_m

    def image(title: str, unit: str, values: "npt.NDArray[np.float64]") -> Image:
        return Image(title, unit, values, width, depth)

    trace, back = result.trace, result.retrace
    images = {
        "height": image("Height", "m", result.height_m),
        "retrace": image("Height retrace", "m", back[:, :, HEIGHT] - back[:, :, HEIGHT].mean()),
        "truth": image("Surface as the tip sees it", "m", result.truth_m),
    }
    if mode is ScanMode.CONTACT:
        return images | {"force": image("Force", "N", trace[:, :, FORCE])}
    return images | {
        "amplitude": image("Amplitude", "m", trace[:, :, AMPLITUDE]),
        "phase": image("Phase", "rad", trace[:, :, PHASE]),
        "dissipated": image("Dissipated energy in a period", "J", trace[:, :, DISSIPATED]),
        "peak": image("Peak force", "N", trace[:, :, FORCE]),
    }


def _write(out: Path, images: "dict[str, Image]") -> None:
    from analysis.image_files import write_gsf, write_gwy, write_png

    write_gsf(out / "scan.gsf", images["height"])
    write_gwy(out / "scan.gwy", images)
    write_png(out / "scan.png", images)
