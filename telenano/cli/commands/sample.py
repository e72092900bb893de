"""`telenano sample`: the surface that the tip meets, and what a round tip sees of it; recorded maps to feel."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from proto.errors import ConfigError
from services.runtime.settings.config import flag_overrides
from telenano.cli.options import HELP_NAMES, JsonOption
from telenano.cli.output import print_document, report_errors
from telenano.cli.progress import progress
from telenano.cli.sample_options import (
    ChannelOption,
    SampleOption,
    SampleSetOption,
    SampleSizeOption,
    require,
    results_in,
    sample_config,
)

if TYPE_CHECKING:
    from services.afm_node.physics.sample.map_files import Imported


app = typer.Typer(
    context_settings=HELP_NAMES, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help=".npz, .h5, .3ds, or force curves that afmformats reads.")
]
MembersOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="What the file lacks, such as stiffness_n_per_m=0.1 (repeatable)."),
]
MapChannelOption = Annotated[
    str | None, typer.Option("--channel", metavar="NAME", help="Part of the name of a channel of a .3ds file.")
]


class Level(StrEnum):
    """What the heights of curves count from."""

    EACH = "each"
    COMMON = "common"


class Quantity(StrEnum):
    """What a map is converted to."""

    FORCE = "force"


@app.callback(invoke_without_command=True)
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
    as_json: JsonOption = False,
) -> None:
    """Write a sample and what a tip of this radius sees of it, as .gwy, .gsf and PNG."""
    if context.invoked_subcommand is not None:
        return
    with report_errors(as_json):
        if out is None:
            raise ConfigError("missing option '--out'")
        require("gwyfile")
        config = sample_config(name, size, channel, settings)
        from analysis.image_files import Image, write_gsf, write_gwy, write_png
        from services.afm_node.physics.sample.surface import dilated

        surface = config.build()
        try:
            seen = dilated(surface, tip_radius * 1e-9)
        except ValueError as error:
            raise ConfigError(f"--tip-radius: {error}") from error
        images = {
            "sample": Image("Sample", "m", surface.height_m, surface.width_m, surface.depth_m),
            "seen": Image(f"Seen by a tip of {tip_radius:g} nm", "m", seen.height_m, surface.width_m, surface.depth_m),
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
        "lowest_m": float(heights.min()),
        "highest_m": float(heights.max()),
        "height_span_m": float(heights.max() - heights.min()),
        "height_std_m": float(heights.std()),
        "files": [str(out / name) for name in ("sample.gwy", "sample.gsf", "sample.png")],
    }
    print_document(document, str(out), as_json=as_json)


@app.command("import")
def import_map(
    file: FileArgument,
    out: Annotated[Path, typer.Option("--out", metavar="MAP", help="The map to write, a .npz.")],
    members: MembersOption = None,
    channel: MapChannelOption = None,
    level: Annotated[
        Level, typer.Option("--level", help="Heights of curves: each from its own lowest point, or common to all.")
    ] = Level.EACH,
    points: Annotated[
        int, typer.Option("--points", min=0, max=4096, help="Points of the height; 0: as the curves have.")
    ] = 0,
    baseline: Annotated[
        float,
        typer.Option("--baseline", min=0.0, max=50.0, help="Share of the approach whose mean force is taken as 0 [%]."),
    ] = 10.0,
    converted: Annotated[
        Quantity | None, typer.Option("--as", help="Make the force of a frequency shift, by Sader and Jarvis.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Bring a recorded map into a file that `afm_node.sample.map` feels."""
    with report_errors(as_json):
        if out.suffix.lower() != ".npz":
            raise ConfigError(f"--out {out}: must be a .npz")
        found = _read(file, members, channel, level.value, points, baseline, as_json, converted=converted is not None)
        from services.afm_node.physics.sample.force_map import write_map

        write_map(out, found.map)
    print_document({**_about(found), "file": str(out)}, str(out), as_json=as_json)


@app.command()
def info(
    file: FileArgument, members: MembersOption = None, channel: MapChannelOption = None, as_json: JsonOption = False
) -> None:
    """Show what a recorded map is, or what it lacks to be felt."""
    with report_errors(as_json):
        found = _read(file, members, channel, Level.EACH.value, 0, 10.0, as_json)
    print_document(_about(found), str(file), as_json=as_json)


def _read(
    file: Path,
    members: list[str] | None,
    channel: str | None,
    level: str,
    points: int,
    baseline: float,
    as_json: bool,
    *,
    converted: bool = False,
) -> "Imported":
    from services.afm_node.physics.sample.force_map import MEMBERS
    from services.afm_node.physics.sample.map_files import Wanted, import_map
    from services.afm_node.physics.sample.sader_jarvis import ASKED

    given = flag_overrides(members or ())
    known = (*MEMBERS, *ASKED) if converted else MEMBERS
    if unknown := sorted(set(given) - set(known)):
        raise ConfigError(f"--set {unknown[0]}: is no member of a map; these are {', '.join(known)}")
    with progress(file.name, 1.0, shown=not as_json) as show:
        return import_map(file, Wanted(given, channel, level, points, 0.01 * baseline, converted), show)


def _about(found: "Imported") -> dict[str, Any]:
    from services.afm_node.physics.sample.force_map import SI_UNITS, gates

    whole = found.map
    onset, release = gates(whole)
    contact = {"contact_m": [float(onset.min()), float(onset.max())]} if whole.quantity == "force" else {}
    loop = {"loop_closed_m": [float(release.min()), float(release.max())]} if contact and len(whole.values) == 2 else {}
    return {
        "source": whole.source,
        "quantity": f"{whole.quantity} [{SI_UNITS[whole.quantity]}]",
        "branches": ["approach", "retract"][: len(whole.values)],
        "points": list(whole.values.shape[1:]),
        **{f"{name}_m": [float(axis[0]), float(axis[-1])] for name, axis in zip("xyz", whole[1:4], strict=True)},
        "lowest": float(whole.values.min()),
        "highest": float(whole.values.max()),
        **({"stiffness_n_per_m": whole.stiffness_n_per_m} if whole.stiffness_n_per_m else {}),
        **contact,
        **loop,
        "megabytes": round(whole.values.nbytes / 1e6, 3),
        **({"notes": list(found.notes)} if found.notes else {}),
    }
