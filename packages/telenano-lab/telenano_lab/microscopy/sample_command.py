"""`telenano sample`: write the surface of a sample, and the surface that a round tip sees."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import JsonOption, command_group, print_document, report_errors, results_in, rules
from telenano.wire import ConfigError
from telenano_lab.microscopy.row_levels import LEVEL_RULES, AboveOption, AlignOption, BelowOption, aligned_image
from telenano_lab.microscopy.sample_options import (
    ChannelOption,
    SampleOption,
    SampleSetOption,
    SampleSizeOption,
    sample_config,
)

app = command_group()


@app.callback(invoke_without_command=True, no_args_is_help=False)
@rules(*LEVEL_RULES)
def sample(
    context: typer.Context,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for sample.gwy, sample.gsf, sample.png.")
    ] = None,
    name: SampleOption = "dots",
    size: SampleSizeOption = None,
    channel: ChannelOption = None,
    settings: SampleSetOption = None,
    tip_radius: Annotated[
        float, typer.Option("--tip-radius", min=0.0, max=1e6, metavar="NM", help="Radius of the tip's sphere [nm].")
    ] = 10.0,
    align: AlignOption = None,
    above: AboveOption = None,
    below: BelowOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write a sample, and its image by a tip of this radius, as .gwy, .gsf and PNG."""
    if context.invoked_subcommand is not None:
        return
    with report_errors(as_json):
        if out is None:
            raise ConfigError("missing option '--out'")
        config = sample_config(name, size, channel, settings)
        from telenano_lab.microscopy.image_files import Image, write_gsf, write_gwy, write_png

        surface = config.build()
        whole = Image("Sample", "m", surface.height_m, surface.width_m, surface.depth_m)
        whole = aligned_image(whole, align, above, below)
        surface = surface._replace(height_m=whole.values)
        try:
            seen = surface.dilated(tip_radius * 1e-9)
        except ValueError as error:
            raise ConfigError(f"--tip-radius: {error}") from error
        images = {
            "sample": whole,
            "seen": whole._replace(title=f"Seen by a tip of {tip_radius:g} nm", values=seen.height_m),
        }
        with results_in(out) as folder:
            write_gsf(folder / "sample.gsf", images["sample"])
            write_gwy(folder / "sample.gwy", images)
            write_png(folder / "sample.png", images)
    heights = surface.height_m
    document = {
        "sample": config.name,
        "rows": heights.shape[0],
        "columns": heights.shape[1],
        "width_m": surface.width_m,
        "depth_m": surface.depth_m,
        **({"level": f"{config.level}: {config.levelled}"} if config.levelled else {}),
        **({"steps": list(whole.log)} if whole.log else {}),
        "lowest_m": float(heights.min()),
        "highest_m": float(heights.max()),
        "height_span_m": float(heights.max() - heights.min()),
        "height_std_m": float(heights.std()),
        "files": [str(out / name) for name in ("sample.gwy", "sample.gsf", "sample.png")],
    }
    print_document(document, str(out), as_json=as_json)
