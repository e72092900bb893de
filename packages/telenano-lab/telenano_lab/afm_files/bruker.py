r"""Read force curves and force volumes of Bruker's NanoScope; called in a child process with limits.

A header has lines `\Key: value` in sections `\*Name`; the integers follow at the offset that each list of samples
states. The deflection is the channel of `\@4:Z scale`, whose number in brackets is the volts per step. Both branches
are stored from the sample away; the ramp of the piezo has even steps. A sensitivity without a unit is in nm/V. Captured
PeakForce curves follow a sine and are refused.
"""

import re
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from telenano_lab.afm_files.recorded import Array, Curves, RecordedCurve

_END = b"\\*File list end"
# The end of the header must lie within this number of bytes.
_LONGEST_HEADER = 1 << 20
# Magnitude limit of the 16-bit converter.
_CONVERTER = 1 << 15
_METRES = {"": 1e-9, "nm": 1e-9, "um": 1e-6, "~m": 1e-6, "µm": 1e-6, "m": 1.0, "pm": 1e-12}
# A number before a parameter is that of a group and not part of its name.
_LINE = re.compile(r"\\(@(?:\d+:)?)?([^:]+): ?(.*)")


class _Section(NamedTuple):
    name: str
    values: dict[str, str]


def is_nanoscope(content: bytes) -> bool:
    """Return whether the content begins like a NanoScope file of force curves."""
    return content.startswith((b"\\*Force file list", b"?*Force file list"))


def curves_of(path: str) -> Curves:
    """Return the curves of a NanoScope file.

    Raises:
        ValueError: It has no curves over an even ramp, or is incomplete; the message names the key.
    """
    content = Path(path).read_bytes()
    sections = _sections_of(content)
    images = [part for part in sections if part.name == "Ciao force image list"]
    if not images:
        raise ValueError("has no force curves of NanoScope: its header has no \\*Ciao force image list")
    shown = {part.name: part.values for part in sections}
    scan, force = shown.get("Ciao scan list", {}), shown.get("Ciao force list", {})
    if "peakforce" in scan.get("PeakForce Capture", "").lower() or scan.get("PeakForce Capture") == "Allow":
        raise ValueError("holds captured PeakForce curves, whose piezo follows a sine: export them as force volume")
    chosen = next((part for part in images if "[Deflection" in part.values.get("Image Data", "")), None)
    if chosen is None:
        raise ValueError(f"has no deflection; it has {', '.join(p.values.get('Image Data', '?') for p in images)}")
    values = chosen.values
    counts = [int(word) for word in _wanted(values, "Samps/line").split()]
    counts = (counts * 2)[:2]
    side = int(force.get("force/line", "1").split()[0]) if "Force Volume" in scan.get("Operating mode", "") else 1
    offset, length = (int(_wanted(values, f"Data {key}")) for key in ("offset", "length"))
    samples = side * side * sum(counts)
    width = length // max(samples, 1)
    if width not in (2, 4) or width * samples != length or offset + length > len(content):
        raise ValueError(
            f"is not a complete file of NanoScope: {side} x {side} curves of {counts[0]} and {counts[1]} "
            "samples are not the "
            f"{length} bytes of data that it states, at {offset} of {len(content)}"
        )
    volts_per_step = float(_matched(r"\(([\d.eE+-]+) V/LSB\)", values, "Z scale"))
    ramp = float(_matched(r"([\d.eE+-]+) V$", values, "Ramp Size")) * _sensitivity(sections, values, "Ramp Size")
    sensitivity = _sensitivity(sections, values, "Z scale")
    k = float(values["Spring Constant"]) if "Spring Constant" in values else None
    data = np.frombuffer(content, f"<i{width}", samples, offset).reshape(side * side, -1)
    # In one force volume of version 9.2 the numbers were 256 times those that its header explains.
    if width == 4 and np.count_nonzero(np.abs(data.astype(np.int64)) > _CONVERTER) > samples // 1000:
        raise ValueError(
            "has deflections beyond the 16 bits of its converter, so that their volts are unknown: export the "
            "curves as text, for `telenano calibrate sensitivity --curve`"
        )

    def curve(number: int) -> RecordedCurve:
        ways = []
        for place, cut in enumerate((slice(None, counts[0]), slice(counts[0], None))):
            volts = data[number, cut] * volts_per_step
            height: Array = np.linspace(0.0, ramp, len(volts))
            # Points that were not sampled, because the trigger came first, hold the lowest integer.
            volts = np.where(data[number, cut] == np.iinfo(data.dtype).min, np.nan, volts)
            ways.append((height[::-1], volts[::-1]) if place == 0 else (height, volts))
        return RecordedCurve((number % side, number // side), tuple(ways), "V", k, sensitivity)

    match = re.match(r"([\d.eE+-]+)(?: [\d.eE+-]+)? ?(\S*)", scan.get("Scan Size", ""))
    metres = float(match[1]) * _METRES.get(match[2], 1e-9) if match and side > 1 else 0.0
    each = ((partial(curve, number), (number + 1) / side**2) for number in range(side**2))
    return Curves((side, side), (metres, metres), each)


def _sections_of(content: bytes) -> list[_Section]:
    end = content.find(_END, 0, _LONGEST_HEADER)
    if not is_nanoscope(content) or end < 0:
        raise ValueError(
            "is of no format of force curves that is known here; these are .csv, .dat, .h5, .ibw, .jpk-…, .nhf, .nid, "
            ".tab, .txt, .zip and NanoScope's, which begin with \\*Force file list"
        )
    sections: list[_Section] = []
    for line in content[:end].decode("latin-1").splitlines():
        if line[1:2] == "*":
            sections.append(_Section(line[2:].strip(), {}))
        elif (match := _LINE.match(line)) and sections:
            sections[-1].values.setdefault(match[2], match[3].strip())
    return sections


def _wanted(values: dict[str, str], key: str) -> str:
    if key not in values:
        raise ValueError(f"its \\*Ciao force image list lacks {key}")
    return values[key]


def _matched(form: str, values: dict[str, str], key: str) -> str:
    match = re.search(form, _wanted(values, key))
    if match is None:
        raise ValueError(f"{key} is {values[key]!r}, which is not understood")
    return match[1]


def _sensitivity(sections: list[_Section], values: dict[str, str], key: str) -> float:
    """Return metres per volt of a parameter, from the sensitivity that it names."""
    name = _matched(r"\[([^\]]+)\]", values, key)
    for part in sections:
        if match := re.match(r"V ([\d.eE+-]+) ?(?:(\S+)/V)?", part.values.get(name, "")):
            if (match[2] or "") not in _METRES:
                raise ValueError(f"{name} is in {match[2]}/V; a length is needed")
            return float(match[1]) * _METRES[match[2] or ""]
    raise ValueError(f"{key} refers to {name}, which the header does not have")
