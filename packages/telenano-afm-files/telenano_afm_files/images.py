"""Images of other makers: most by SurfaceTopography (Bruker, Agilent, JPK, Nanosurf, text), Nanonis by nanonispy2.

Both libraries are called in a child process with limits. SurfaceTopography (MIT) was chosen before AFMReader (LGPL),
which reads neither .mi nor .nid and brings some twenty packages more; neither of the two reads .sxm.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]

_WITHOUT_A_NAME = "Default"


def load_image(path: str) -> Found:
    """Return the maps of a file that SurfaceTopography reads, y rising with the row; called in a child.

    Values: `channels`, for each map its name, its width and depth, and the units of both.
    """
    from SurfaceTopography.Exceptions import CannotDetectFileFormat
    from SurfaceTopography.IO import open_topography

    try:
        reader = open_topography(path)
    except CannotDetectFileFormat:
        raise ValueError("is of no format that is known here; Gwyddion may open it and save it as .gwy") from None
    facts, maps, others = [], [], []
    for channel in reader.channels:
        if channel.dim != 2 or isinstance(channel.unit, tuple) or channel.unit is None:
            others.append(str(channel.name))
            continue
        values = reader.topography(channel_index=channel.index).heights()
        gaps = int(np.ma.getmaskarray(values).sum())
        if gaps:
            raise ValueError(f"its map {channel.name} has {gaps} points without a height")
        name = "heights" if channel.name == _WITHOUT_A_NAME else str(channel.name)
        sides = [float(side) for side in channel.physical_sizes]
        facts.append({"name": name, "sides": sides, "unit": _unit(channel.lateral_unit), "z": _unit(channel.data_unit)})
        # The transposed heights have the top of the picture in their first row, in each format.
        maps.append(np.asarray(values, dtype=np.float64).T[::-1])
    if not maps:
        listed = f" ({', '.join(others)})" if others else ""
        raise ValueError(f"has no map whose heights and sides have a unit of length{listed}")
    return {"channels": facts}, maps


def _unit(unit: Any) -> str:
    return unit if isinstance(unit, str) else ""


def load_nanonis(path: str) -> Found:
    """Return the maps of the forward lines of a Nanonis .sxm file, y rising with the row; called in a child."""
    from nanonispy2.read import Scan

    scan = Scan(path)
    width, depth = (float(side) for side in scan.header["scan_range"])
    units = dict(zip(scan.header["data_info"]["Name"], scan.header["data_info"]["Unit"], strict=True))
    facts, maps = [], []
    for name, directions in scan.signals.items():
        values = np.asarray(directions["forward"], dtype=np.float64)
        if not np.isfinite(values).all():
            raise ValueError(f"its map {name} was not scanned to its end")
        facts.append({"name": name, "sides": [width, depth], "unit": "m", "z": units.get(name, "")})
        # Lines are kept in the order of the scan.
        maps.append(values[::-1] if scan.header["scan_dir"] == "down" else values)
    return {"channels": facts}, maps
