"""Read thermal spectra that JPK's software exports as text (.tnd); called in a child process with limits."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]


def load_spectrum(path: str) -> Found:
    """Return the frequencies [Hz] and the mean density of a spectrum, with the unit of that column in the header."""
    text = Path(path).read_bytes().decode("utf-8", "replace")
    names, units = (re.findall(r"'([^']*)'", match[1]) if (match := re.search(rf"^# {key}:(.*)$", text, re.M)) else []
                    for key in ("Channels", "Units"))  # fmt: skip
    if len(names) < 2 or len(names) != len(units) or units[0] != "Hz":
        raise ValueError("is not a thermal spectrum of JPK: its head has no lines of channels and units")
    chosen = names.index("average") if "average" in names else 1
    rows = [line.split() for line in text.splitlines() if line and not line.startswith("#")]
    if len(rows) < 16 or any(len(row) != len(names) for row in rows):
        raise ValueError(f"its rows must have {len(names)} numbers each, 16 rows or more")
    table = np.array(rows, dtype=np.float64).T
    return {"unit": units[chosen], "averages": 1}, [table[0], table[chosen]]
