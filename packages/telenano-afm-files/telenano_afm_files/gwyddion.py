"""Maps in Gwyddion's own files (.gwy), by `gwyfile`: called in a child process with limits."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]

_MAGIC, _NAME = b"GWYP", b"GwyContainer\0"
_START = len(_MAGIC) + len(_NAME) + 4


def load_maps(path: str) -> Found:
    """Return the maps of a file in the order of their keys, y rising with the row.

    Values: `channels`, for each map its title, its width and depth, and the units of both and of the values.
    """
    from gwyfile.objects import GwyDataField, GwyObject

    content = Path(path).read_bytes()
    if not content.startswith(_MAGIC):
        raise ValueError("is no Gwyddion file: it does not begin with GWYP")
    # gwyfile takes a file that was cut for a smaller one
    stated = int.from_bytes(content[_START - 4 : _START], "little")
    if not content.startswith(_MAGIC + _NAME) or len(content) != _START + stated:
        raise ValueError("is no whole Gwyddion file: it must be one container of the length that it states")
    facts, maps = [], []
    # it fails in whatever way the damage leads it to
    try:
        whole = GwyObject.frombuffer(content[len(_MAGIC) :])
        for key in sorted(key for key in whole if re.fullmatch(r"/\d+/data", key)):
            field = whole[key]
            if not isinstance(field, GwyDataField):
                continue
            units = {"unit": _unit(field.si_unit_xy), "z": _unit(field.si_unit_z)}
            title = str(whole.get(f"{key}/title", key))
            facts.append({"name": title, "sides": [float(field.xreal), float(field.yreal)], **units})
            maps.append(np.asarray(field.data, dtype=np.float64)[::-1])
    except Exception as error:
        raise ValueError(f"is no whole Gwyddion file: {type(error).__name__}: {error}") from error
    return {"channels": facts}, maps


def _unit(part: Any) -> str:
    return str(part.get("unitstr", "")) if isinstance(part, dict) else ""
