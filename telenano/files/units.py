"""Parsing of units in common spellings, such as `kHz`, `µm`, `V/√Hz`, `nm/V`, `%`, to a factor and base units."""

import re
from typing import NamedTuple

_PREFIXES = {"f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "m": 1e-3, "c": 1e-2, "k": 1e3, "M": 1e6, "G": 1e9}
_LONG_PREFIXES = {"femto": "f", "pico": "p", "nano": "n", "micro": "u", "milli": "m", "kilo": "k", "mega": "M"}
# Base unit of each unit, and the factor to it.
_BASES = {
    **{name: (name, 1.0) for name in ("m", "V", "N", "Hz", "s", "A", "Pa", "rad")},
    **{"v": ("V", 1.0), "Å": ("m", 1e-10), "min": ("s", 60.0), "%": ("", 0.01), "1": ("", 1.0)},
    **{name: ("rad", 0.017453292519943295) for name in ("°", "deg")},
}
_NEVER_PREFIXED = ("min", "%", "1", "°", "deg", "Å")
_LONG = {
    "metre": "m", "meter": "m", "volt": "V", "newton": "N", "hertz": "Hz", "second": "s", "sec": "s", "micron": "um",
    "angstrom": "Å", "ang": "Å", "percent": "%", "degree": "°", "ampere": "A", "minute": "min",
}  # fmt: skip
_SPELLINGS = (
    ("[\u00b5\u03bc]", "u"), ("\u212b", "\u00c5"), (r"²", "^2"), (r"³", "^3"),
    (r"⁻¹", "^-1"), (r"⁻²", "^-2"), (r"\*\*", "^"),
    (r"[−–]", "-"), (r"\^\(?(-?)1/2\)?", r"^\g<1>0.5"), (r"\bper\b", "/"),
    (r"√|\b(?:sqrt|root|rt)(?=[ (]|\w*Hz)", "sqrt "), (r"\s*/\s*", "/"), (r"sqrt\s*", "sqrt"), (r"[·*]", " "),
)  # fmt: skip
_FACTOR = re.compile(r"(sqrt)?\(?([^\W\d_]+|[%°]|1(?![\d.]))\)?(?:\^?\(?(-?\d*\.?\d+)\)?)?")


class Unit(NamedTuple):
    """A factor to SI, and the powers of base units such as (("Hz", -0.5), ("V", 1.0)); empty for a pure number."""

    factor: float
    powers: tuple[tuple[str, float], ...]


def unit_of(text: str) -> Unit | None:
    """Parse a unit; return None if it is unknown or ambiguous, such as `mhz`.

    Example:
        >>> unit_of("kHz")
        Unit(factor=1000.0, powers=(('Hz', 1.0),))
    """
    if not text or len(text) > 60 or text.count("(") != text.count(")"):
        return None
    for spelling, plain in _SPELLINGS:
        text = re.sub(spelling, plain, text.strip())
    factor = 1.0
    powers: dict[str, float] = {}
    for place, part in enumerate(text.split("/")):
        if not part.split():
            return None
        for word in part.split():
            match = _FACTOR.fullmatch(word)
            base = match and _simple(match[2])
            if not match or base is None:
                return None
            power = (0.5 if match[1] else 1.0) * float(match[3] or 1.0) * (-1.0 if place else 1.0)
            if abs(power) > 8.0:
                return None
            factor *= base[1] ** power
            powers[base[0]] = powers.get(base[0], 0.0) + power
    return Unit(factor, tuple(sorted((name, power) for name, power in powers.items() if name and power)))


def _simple(word: str) -> tuple[str, float] | None:
    """Return base unit and factor of a word without a power: `mV`, `khz`, `nanometres`; None if unknown."""
    if word in _BASES:
        return _BASES[word]
    if word[1:] in _BASES and word[1:] not in _NEVER_PREFIXED and word[0] in _PREFIXES:
        base, factor = _BASES[word[1:]]
        return base, factor * _PREFIXES[word[0]]
    lower = word.lower()
    # mHz and MHz differ only in case, so mhz is rejected.
    if lower.endswith("hz") and (lower in ("hz", "khz", "ghz") or word.startswith("M")) and len(word) <= 3:
        return "Hz", {"h": 1.0, "k": 1e3, "g": 1e9, "m": 1e6}[lower[0]]
    if lower in ("msec", "usec", "nsec"):
        return "s", _PREFIXES[lower[0]]
    whole = lower if lower in _LONG else lower.removesuffix("s")
    prefix = "" if whole in _LONG else next((long for long in _LONG_PREFIXES if lower.startswith(long)), "")
    short = _LONG.get(lower[len(prefix) :], _LONG.get(lower[len(prefix) :].removesuffix("s")))
    if short is None or (prefix and short not in ("m", "V", "N", "Hz", "s", "A")):
        return None
    return _simple(f"{_LONG_PREFIXES.get(prefix, '')}{short}")
