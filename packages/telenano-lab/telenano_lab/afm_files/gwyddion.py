"""Read maps with Gwyddion in a child process with limits: .gwy files with `gwyfile`, others with Gwyddion's converter.

The converter (`gwyconvert` of gwyddionpy-converter, GPL version 2 or later) is a separate program that the user
installs: telenano starts it with the path of an image and that of the .gwy to write, and imports nothing of it. The
.gwy is read here instead of with `gwyddionpy`, which drops the masks: where nothing was measured Gwyddion fills in
heights, and only a mask tells them from the measured ones.
"""

import os
import re
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.signals import run as run_child

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]

# A .gwy begins with these bytes, followed by the name of its type.
_MAGIC = b"GWYP"
_NAME = b"GwyContainer\0"
_START = len(_MAGIC) + len(_NAME) + 4
# Command of the converter of other files.
_PROGRAM = "gwyconvert"
# The package that installs the converter.
_DISTRIBUTION = "gwyddionpy-converter"
# Most files take the converter less than a second; the time limit of the waiting child itself may be longer.
_LONGEST_S = 60.0
_TEXTS = (".asc", ".csv", ".txt", ".xyz")
_WAYS_OUT = "or open it in Gwyddion and save it as .gwy"


def load_image(path: str) -> Found:
    """Return the maps of an image that Gwyddion knows; y rises with the row, heights that were not measured are NaN.

    Raises:
        ValueError: The converter is not installed, or it cannot read the file; the message says what to do.
    """
    program = converter()
    if program is None:
        raise ValueError(
            f"images of this kind are read by Gwyddion's converter: pip install {_DISTRIBUTION} (a program under the "
            f"GPL), {_WAYS_OUT}"
        )
    with tempfile.TemporaryDirectory() as folder:
        out, source = Path(folder, "converted.gwy"), path
        content = Path(path).read_bytes() if Path(path).suffix.lower() in _TEXTS else b"\n"
        if not content.endswith(b"\n"):
            # Gwyddion drops a last line without a newline.
            source = os.fspath(Path(folder, Path(path).name))
            Path(source).write_bytes(content + b"\n")
        # A decimal comma would change numbers, and Gwyddion makes a settings folder in HOME.
        kept = {key: value for key, value in os.environ.items() if key not in ("LC_ALL", "DISPLAY")}
        try:
            ended = run_child(
                [program, source, os.fspath(out)], stdin=subprocess.DEVNULL, capture_output=True, check=False,
                timeout=_LONGEST_S, env=kept | {"LC_NUMERIC": "C", "GTK_MODULES": "", "HOME": folder},
            )  # fmt: skip
        except subprocess.TimeoutExpired as error:
            raise ValueError(f"Gwyddion's converter did not read it within {_LONGEST_S:g} s") from error
        if ended.returncode != 0 or not out.is_file():
            if b"No module can load" in ended.stderr:
                raise ValueError("is of no format that Gwyddion knows; export it as .gsf, or as .npy (with --size)")
            message = ended.stderr.decode("utf-8", "replace").strip().rpartition(source)[2].strip("': \n")
            raise ValueError(
                f"Gwyddion's converter cannot read it: {message or f'it ended with code {ended.returncode}'}"
            )
        facts, maps = _maps_of(out, "it holds curves, and no image")
    return facts, maps


def converter() -> str | None:
    """Return the path of Gwyddion's converter, from PATH or from gwyddionpy-converter; None if it is not installed."""
    if path := shutil.which(_PROGRAM):
        return path
    place = find_spec("gwyddionpy_converter")
    if place is None or place.origin is None:
        return None
    return shutil.which(_PROGRAM, path=os.fspath(Path(place.origin).parent / "bin"))


def load_maps(path: str) -> Found:
    """Return the maps of a .gwy file in the order of their numbers; y rises with the row.

    Masks are ignored, because the user drew them. Values: `channels`, for each map its title, its width and depth, and
    the units of both and of the values.
    """
    return _maps_of(Path(path), "it has no map", is_converted=False)


def _maps_of(path: Path, without: str, *, is_converted: bool = True) -> Found:
    from gwyfile.objects import GwyDataField, GwyObject

    content = path.read_bytes()
    if not content.startswith(_MAGIC):
        raise ValueError("is not a Gwyddion file: it does not begin with GWYP")
    # gwyfile accepts a truncated file as a smaller one.
    stated = int.from_bytes(content[_START - 4 : _START], "little")
    if not content.startswith(_MAGIC + _NAME) or len(content) != _START + stated:
        raise ValueError("is not a complete Gwyddion file: it must be one container of the length that it states")
    facts, maps = [], []
    # gwyfile raises exceptions of any kind on damaged files.
    try:
        whole = GwyObject.frombuffer(content[len(_MAGIC) :])
        for key in sorted((key for key in whole if re.fullmatch(r"/\d+/data", key)), key=lambda key: int(key[1:-5])):
            field = whole[key]
            if not isinstance(field, GwyDataField):
                continue
            units = {"unit": _unit(field.si_unit_xy), "z": _unit(field.si_unit_z)}
            title = str(whole.get(f"{key}/title", key))
            facts.append({"name": title, "sides": [float(field.xreal), float(field.yreal)], **units})
            values = np.asarray(field.data, dtype=np.float64)[::-1]
            mask = whole.get(f"{key[:-5]}/mask") if is_converted else None
            maps.append(values if mask is None else np.where(np.asarray(mask.data)[::-1] > 0.5, np.nan, values))
    except Exception as error:
        raise ValueError(f"is not a complete Gwyddion file: {type(error).__name__}: {error}") from error
    if not maps:
        raise ValueError(without)
    return {"channels": facts}, maps


def _unit(part: Any) -> str:
    return str(part.get("unitstr", "")) if isinstance(part, dict) else ""
