"""`telenano sample import` and `telenano sample info`: convert recorded maps into maps that a rig feels."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import JsonOption, Void, print_document, progress, report_errors, rules
from telenano.extend.maps import SI_UNITS
from telenano.settings import flag_overrides
from telenano.wire import ConfigError
from telenano_lab.afm_files.force_map import MEMBERS, gates, write_map
from telenano_lab.afm_files.map_files import ImportedMap, MapOptions
from telenano_lab.afm_files.map_files import import_map as read_map_of
from telenano_lab.afm_files.sader_jarvis import ASKED
from telenano_lab.afm_files.text_curves import TableOptions

FileArgument = Annotated[
    Path, typer.Argument(metavar="FILE", help=".npz, .h5, .3ds, .dat of Nanonis, or force curves of an instrument.")
]
MembersOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Facts that the file lacks, such as stiffness_n_per_m=0.1, or of a text table columns=1,2, way_unit=nm "
        "and value_unit=nN (repeatable).",
    ),
]
MapChannelOption = Annotated[
    str | None, typer.Option("--channel", metavar="NAME", help="Part of the name of a channel of a .3ds file.")
]


class Level(StrEnum):
    """Reference of the heights of curves."""

    EACH = "each"
    COMMON = "common"


class Correction(StrEnum):
    """Free-air signal that is subtracted from the curves of a map."""

    NOTHING = "nothing"
    OFFSET = "offset"
    TILT = "tilt"


class Quantity(StrEnum):
    """Quantity that a map is converted to."""

    FORCE = "force"


@rules(Void("--baseline", "which subtracts no background", beside="--correct nothing"))
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
    correct: Annotated[
        Correction | None,
        typer.Option(
            "--correct",
            help="Background to subtract, as measured in free air: the mean of each curve (offset), also the slope "
            "common to all (tilt), or nothing; default: offset for curves, nothing for a plain grid. --set sign=-1 "
            "inverts all values.",
        ),
    ] = None,
    baseline: Annotated[
        float | None,
        typer.Option(
            "--baseline",
            min=0.0,
            max=50.0,
            help="Share of the heights that is free air, farthest from the sample [%]; default: 10, for tilt 25.",
        ),
    ] = None,
    converted: Annotated[
        Quantity | None, typer.Option("--as", help="Compute the force from a frequency shift, by Sader and Jarvis.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Convert a recorded map into a file for `afm_node.sample.map`."""
    with report_errors(as_json):
        if out.suffix.lower() != ".npz":
            raise ConfigError(f"--out {out}: must be a .npz")
        imported = _read(
            file, members, channel, as_json, level=level.value, points=points, converted=converted is not None,
            correct=None if correct is None else correct.value, baseline=None if baseline is None else 0.01 * baseline,
        )  # fmt: skip
        write_map(out, imported.map)
    print_document({**_about(imported), "file": str(out)}, str(out), as_json=as_json)


def info(
    file: FileArgument, members: MembersOption = None, channel: MapChannelOption = None, as_json: JsonOption = False
) -> None:
    """Show the contents of a recorded map, or the facts that it lacks to be felt."""
    with report_errors(as_json):
        imported = _read(file, members, channel, as_json)
    print_document(_about(imported), str(file), as_json=as_json)


def _read(
    file: Path,
    members: list[str] | None,
    channel: str | None,
    as_json: bool,
    *,
    converted: bool = False,
    **further: Any,
) -> ImportedMap:
    overrides = flag_overrides(members or ())
    names = (*MEMBERS, *TableOptions._fields, *(ASKED if converted else ()))
    if unknown := sorted(set(overrides) - set(names)):
        raise ConfigError(f"--set {unknown[0]}: is not a member of a map; these are {', '.join(names)}")
    with progress(file.name, 1.0, shown=not as_json) as show:
        return read_map_of(file, MapOptions(overrides, channel, converted=converted, **further), show)


def _about(imported: ImportedMap) -> dict[str, Any]:
    whole = imported.map
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
        **({"notes": list(imported.notes)} if imported.notes else {}),
    }
