"""`telenano particles` and `telenano assemble`: find particles in an image, and push them into a pattern."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from telenano.cli import (
    JsonOption,
    Keys,
    SiteFileOption,
    Void,
    console,
    print_document,
    progress,
    report_errors,
    results_in,
    rules,
)
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import ConfigError
from telenano_lab.microscopy.program_view import LIVE_RULES, AfmOption, LiveOption, decided_by_rig
from telenano_lab.microscopy.sample_options import ChannelOption

if TYPE_CHECKING:
    from telenano.sections import AfmConfig
    from telenano_lab.assembly.find import FoundParticle
    from telenano_lab.assembly.plan import Point
    from telenano_lab.assembly.run import ProgramBench

# A particle has arrived within this share of its diameter.
_DONE_SHARE = 0.1


def particles(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Image: .gsf, .npy, or what a package reads.")],
    channel: ChannelOption = None,
    size: Annotated[
        float | None,
        typer.Option("--size", metavar="NM", help="Side of the image [nm], for .npy, which does not state it."),
    ] = None,
    tip_radius: Annotated[
        float, typer.Option("--tip-radius", min=0.1, max=1e4, metavar="NM", help="Radius of the apex of the tip [nm].")
    ] = 10.0,
    cone: Annotated[
        float, typer.Option("--cone", min=1.0, max=60.0, metavar="DEG", help="Half-angle of the tip [degrees].")
    ] = 15.0,
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="Write the particles as JSON.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Find spheres in an image: places, radii and their standard errors."""
    with report_errors(as_json):
        from telenano.files import atomic_file
        from telenano.sections import read_surface
        from telenano_lab.assembly.find import find_particles
        from telenano_lab.assembly.particles.tip_shape import tip_shape

        surface = read_surface(file, channel, None if size is None else size * 1e-9, may_lack=True)
        shape = tip_shape(tip_radius * 1e-9, math.radians(cone))
        try:
            particles_here = find_particles(surface.height_m, surface.step_x_m, surface.step_y_m, shape)
        except ValueError as error:
            raise ConfigError(f"{file}: {error}") from error
        document = {"file": str(file), "particles": [one._asdict() for one in particles_here]}
        if out is not None:
            with atomic_file(out) as part:
                part.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    if as_json:
        print_document(document, "", as_json=True)
        return
    _print_found(particles_here, file)


def _print_found(particles: "list[FoundParticle]", file: Path) -> None:
    from rich.table import Table

    table = Table(title=f"{len(particles)} particles in {file}; places from the middle of the image")
    for name in ("", "x, nm", "y, nm", "radius, nm", ""):
        table.add_column(name, justify="right")
    for number, one in enumerate(particles):
        table.add_row(
            str(number),
            f"{one.x_m * 1e9:.2f} ± {one.x_error_m * 1e9:.2f}",
            f"{one.y_m * 1e9:.2f} ± {one.y_error_m * 1e9:.2f}",
            f"{one.radius_m * 1e9:.2f} ± {one.radius_error_m * 1e9:.2f}",
            "more than spheres" if one.is_cluster else "",
        )
    console().print(table)


@rules(
    *LIVE_RULES,
    decided_by_rig("--seed"),
    Void(
        "--count",
        "which has places of its own",
        beside="--pattern",
        unless="--pattern line, --pattern square, --pattern ring",
    ),
    Void(
        "--spacing",
        "which has places of its own",
        beside="--pattern",
        unless="--pattern line, --pattern square, --pattern ring, --pattern letters*",
    ),
    Keys("--seed", "disturbances.seed, sample.particles.seed", "--afm"),
)
def assemble(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for assembly.json and assembly.png.")
    ] = Path("out/assembly"),
    pattern: Annotated[
        str,
        typer.Option("--pattern", metavar="NAME|FILE", help="line, square, ring, letters:TEXT, or a file of x, y [m]."),
    ] = "square",
    count: Annotated[int, typer.Option("--count", min=1, max=50, metavar="N", help="Places of a named pattern.")] = 8,
    spacing: Annotated[
        float, typer.Option("--spacing", min=1.0, metavar="NM", help="Distance of neighbouring places [nm].")
    ] = 1000.0,
    seed: Annotated[
        int, typer.Option("--seed", min=0, metavar="N", help="Seed of the particles' places and of the noise.")
    ] = 0,
    afm: AfmOption = None,
    live: LiveOption = False,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Image, push particles into a pattern, and look again: in simulated time with noise and drift, or on a rig."""
    with report_errors(as_json):
        from telenano_lab.assembly import recording
        from telenano_lab.assembly.figure import assembly_figure
        from telenano_lab.assembly.live import LiveBench
        from telenano_lab.assembly.patterns import pattern as places_of
        from telenano_lab.assembly.run import Assembler, ProgramBench, VirtualBench

        config = _config(seed, afm or [])
        targets = places_of(pattern, count, spacing * 1e-9)
        sides = config.sample_sides_m()
        with results_in(out) as folder:
            with progress("the first image", len(targets), shown=not as_json, counted=True) as show:
                virtual = None if live else VirtualBench(config, folder)
                bench: ProgramBench = virtual or LiveBench(config, site_file)

                def tell(text: str, done: int) -> None:
                    show(done, text=text)
                    if virtual is not None and virtual.recorder is not None:
                        virtual.recorder.say(text)

                try:
                    result = Assembler(bench, config, targets, sides, tell).run()
                finally:
                    if virtual is not None and virtual.recorder is not None:
                        virtual.recorder.finish()
            tolerance_m = _DONE_SHARE * _diameter_m(config)
            assembly_figure(result, tolerance_m).savefig(folder / "assembly.png", dpi=120)
            document = {
                "pattern": pattern,
                "seed": seed,
                "placed": sum(one.error_m <= tolerance_m for one in result.placed),
                "particles": [
                    {
                        "target_m": one.target,
                        "believed_m": one.believed,
                        "error_m": one.error_m,
                        "pushes": one.pushes,
                        **_true_error(bench, one.target),
                    }
                    for one in result.placed
                ],
                "tolerance_m": tolerance_m,
                "pushes": result.pushes,
                "looks": result.looks,
                "losses": result.losses,
                "duration_s": result.duration_s,
                "drift_m_per_s": [result.drift.x.speed_m_per_s, result.drift.y.speed_m_per_s],
            }
            (folder / "assembly.json").write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    names = ["assembly.json", "assembly.png", *([] if live else [recording.NAME])]
    document["files"] = [str(out / name) for name in names]
    print_document(document, str(out), as_json=as_json)


def _true_error(bench: "ProgramBench", target: "Point") -> dict[str, float]:
    """Return the true error, which only a simulation knows and no step of the assembly uses; empty on a rig."""
    from telenano_lab.assembly.run import VirtualBench

    if not isinstance(bench, VirtualBench):
        return {}
    return {"true_error_m": min(math.dist(target, place) for place in bench.truth())}


def _config(seed: int, overrides: list[str]) -> "AfmConfig":
    from telenano_lab.assembly.particle_bench import DISTURBED, configured, particles_of

    disturbances = {**DISTURBED, "seed": seed}
    config = configured(overrides, {"count": 8, "seed": seed}, disturbances, "places")
    if particles_of(config) is None:
        raise ConfigError("--afm: an assembly needs sample.particles")
    return config


def _diameter_m(config: "AfmConfig") -> float:
    from telenano_lab.assembly.particle_bench import particles_of

    particles = particles_of(config)
    assert particles is not None
    return 2.0 * particles.kind.radius_m
