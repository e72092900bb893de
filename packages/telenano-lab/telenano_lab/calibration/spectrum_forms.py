"""Normalisations of spectra: interpret a unit, a header and the order of the lines, and convert to a one-sided density.

A spectrum may be a density or the power per line, a power or its root, an RMS or a peak value, in decibels of a
reference, one-sided or two-sided. The statements of a file are honoured; what a file leaves open or contradicts is
refused with the option that decides it.
"""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files import unit_of
from telenano.wire import ConfigError
from telenano_lab.calibration.resonance import noise_bandwidth_of

Array = npt.NDArray[np.float64]

# Units of a density in column titles: of a power or its root, in volts or metres.
DENSITIES = ("V^2/Hz", "V/sqrt(Hz)", "m^2/Hz", "m/sqrt(Hz)")
# Units of the power of a line or its root, which divided by the noise bandwidth is a density.
LINES = ("V^2", "V", "m^2", "m")
# Mean square per squared value, for RMS, peak and peak-to-peak values.
_OF_PEAKS = {"rms": 1.0, "eff": 1.0, "pk": 0.5, "peak": 0.5, "p": 0.5, "pp": 0.125, "p-p": 0.125, "pk-pk": 0.125,
             "pkpk": 0.125, "peak-to-peak": 0.125}  # fmt: skip
_PEAK = re.compile(
    r"(?i)(?<=[vm2])[_ ]*\(?(pk-pk|p-p|pkpk|pp|peak-to-peak|peak|pk|rms|eff|p)\)?(?=$|[/\s^²)])|\b(rms|peak) (?=\w)"
)
_DECIBELS = re.compile(r"(?i)\s*db\s*(?:\(?\s*re\.?l?\.?\s*(?:to\s*)?(?:1\s*)?)?(.*?)\s*")
_ANGULAR = re.compile(r"/\s*\(?\s*rad\s*/\s*s(?:ec)?\s*\)?")
_PER_LINE = re.compile(r"(?i)\s*(?:/|per)\s*(?:bin|line)\b")
_MILLIWATT = re.compile(r"(?i)m(?:W)?(/Hz)?")
_OHMS = re.compile(r"(?i)(\d+(?:[.,]\d+)?)\s*(k?)(?:Ω|\u2126|ohms?\b)")
_TWO_SIDED = re.compile(
    r"(?i)(?:two|double|2)[-_ ]?sided|zweiseitig|bilat[eé]ral|bilateral|return_onesided\s*[=:]\s*false"
)
_ONE_SIDED = re.compile(
    r"(?i)(?:one|single|1)[-_ ]?sided|einseitig|unilat[eé]ral|unilateral|return_onesided\s*[=:]\s*true"
)
_WORD_OF_SIDES = re.compile(r"(?i)(?:two|double|2|one|single|1)[-_ ]sided|(?:two|double)sided")
# Words on sides count only in a line on spectra: a sample may be on two-sided tape.
_SPECTRAL = re.compile(r"(?i)spectr|spektr|psd|densi|dichte|sides?\b|seiten|onesided|periodogram|welch|range")
_OF_LINES = re.compile(r"(?i)scaling\s*[=:]\s*['\"]?spectrum|per (?:bin|line)\b|pro (?:linie|bin)\b|\bpro Kanal\b")
_BANDWIDTH = re.compile(
    r"(?i)(?:enbw|(?:equivalent )?noise[- _]?bandwidth|rauschbandbreite|bande (?:é|e)quivalente de bruit)\W*?"
    r"(\d+(?:[.,]\d+)?(?:e[-+]?\d+)?)\s*\)?\s*(m?Hz|kHz|MHz|bins?|lines?)\b"
)
_WINDOW = re.compile(
    r"(?i)\b(?:window(?: function)?|windowing|fenster(?:funktion)?|fen[eê]tre|ventana|finestra)\b\s*[=:\t]?\s*['\"(\[]*"
    r"([a-z]+(?:[- ](?:top|harris))?)(?:['\",\s)\]]+(\d+(?:\.\d+)?))?"
)
_NAMES = {
    "hanning": "hann", "von": "hann", "rectangular": "boxcar", "rect": "boxcar", "rectangle": "boxcar",
    "none": "boxcar", "uniform": "boxcar", "rechteck": "boxcar", "keine": "boxcar", "no": "boxcar", "aucune": "boxcar",
    "flat top": "flattop", "flat-top": "flattop", "blackman-harris": "blackmanharris",
    "blackman harris": "blackmanharris",
}  # fmt: skip
_KNOWN = ("hann", "boxcar", "hamming", "blackman", "blackmanharris", "flattop", "bartlett", "nuttall")
_WITH_PARAMETER = ("kaiser", "tukey", "gaussian")
_AVERAGES = re.compile(
    r"(?i)\b(?:number of averages|averages?|averaged spectra|mittelungen|moyennes|promedios|medie)\b\s*[=:\t]\s*(\d+)\b"
)
# Both sides of 0 Hz agree if they differ by less than this share, which rounding explains.
_ALIKE = 0.01


class Form(NamedTuple):
    """The meaning of values in a unit: their SI power is factor * value^power, or in decibels factor * 10^(value/10).

    per_line: whether it is the power of a line rather than per hertz; is_of_metres: metres rather than volts; words:
    name.
    """

    factor: float
    power: float
    decibels: bool
    per_line: bool
    is_of_metres: bool
    words: str


class NoReference(NamedTuple):
    """Decibels without a stated reference, or of a milliwatt in a resistance that the file does not name."""

    words: str


def form_of(word: str, head: str = "") -> Form | NoReference | None:
    """Return the meaning of a unit of a spectrum; None if it is none, NoReference if it lacks a reference.

    head: The text above the table, which may name the resistance that a milliwatt refers to.
    """
    text = word.strip()
    decibels = _DECIBELS.fullmatch(text)
    if decibels and not unit_of(text):
        reference = decibels[1].strip()
        reference = reference[1:-1] if reference.startswith("(") and reference.endswith(")") else reference
        reference = reference.rstrip(")") if reference.count(")") > reference.count("(") else reference
        if milliwatt := _MILLIWATT.fullmatch(reference):
            ohms = _OHMS.search(head)
            if not ohms:
                return NoReference(f"{text}, of a milliwatt in a resistance that the head does not name")
            resistance = float(ohms[1].replace(",", ".")) * (1e3 if ohms[2] else 1.0)
            return Form(1e-3 * resistance, 1.0, True, not milliwatt[1], False, f"{text} in {resistance:g} ohm")
        form = form_of(reference) if reference else None
        if not isinstance(form, Form) or form.decibels:
            return NoReference(f"{text}, decibels of a reference that it does not say")
        return form._replace(decibels=True, words=f"decibels of {form.words}")
    per_line = bool(_PER_LINE.search(text))
    text = _PER_LINE.sub("", text)
    peak = _PEAK.search(text)
    plain, angular = _ANGULAR.subn("/Hz", _PEAK.sub("", text))
    unit = unit_of(plain.strip())
    share = _OF_PEAKS[(peak[1] or peak[2]).lower()] if peak else 1.0
    for name in (*DENSITIES, *LINES):
        kind = unit_of(name)
        if unit is None or kind is None or unit.powers != kind.powers:
            continue
        is_root = "^2" not in name
        factor = share * unit.factor ** (2.0 if is_root else 1.0)
        # A density over angular frequency is 2 pi times smaller than one over frequency.
        factor *= (2.0 * math.pi) ** angular
        of = {1.0: "root of the mean square", 0.5: "peak", 0.125: "peak to peak"}[share]
        return Form(
            factor, 2.0 if is_root else 1.0, False, per_line or name in LINES, name.startswith("m"), f"{text} ({of})"
        )
    return None


def power_of(values: Array, form: Form, where: str) -> Array:
    """Return the power of values, per hertz or per line; ConfigError for negative values that are not in decibels."""
    if form.decibels:
        return np.asarray(form.factor * 10.0 ** (values / 10.0))
    if np.any(values < 0.0):
        raise ConfigError(
            f"{where}: a density in {form.words} is below 0: is it in decibels? Then --unit says of what, such as"
            " 'dB re 1 V^2/Hz'"
        )
    return np.asarray(form.factor * values**form.power)


class SpectrumHead(NamedTuple):
    """The statements of a header on its spectrum; None or False where it states nothing.

    sides: 1 or 2; of_lines: whether it has the power of lines; bandwidth: value and unit of the noise bandwidth;
    window: as `scipy.signal.get_window` takes it; averages: number of averages.
    """

    sides: int | None
    of_lines: bool
    bandwidth: tuple[float, str] | None
    window: Any
    averages: int | None


def said_of(head: str) -> SpectrumHead:
    """Parse the header of a spectrum; ConfigError if it claims both one and two sides."""
    of_sides = "\n".join(line for line in head.splitlines() if _SPECTRAL.search(_WORD_OF_SIDES.sub("", line)))
    two, one = _TWO_SIDED.search(of_sides), _ONE_SIDED.search(of_sides)
    if two and one:
        raise ConfigError(f"its head says {two[0]!r} and {one[0]!r}: --sides says which it is")
    bandwidth = _BANDWIDTH.search(head)
    averages = _AVERAGES.search(head)
    return SpectrumHead(
        2 if two else 1 if one else None,
        bool(_OF_LINES.search(head)),
        (float(bandwidth[1].replace(",", ".")), bandwidth[2]) if bandwidth else None,
        _window_of(head),
        int(averages[1]) if averages else None,
    )


def _window_of(head: str) -> Any:
    match = _WINDOW.search(head)
    if not match:
        return None
    name = _NAMES.get(match[1].lower(), match[1].lower())
    if name in _KNOWN:
        return name
    return (name, float(match[2])) if name in _WITH_PARAMETER and match[2] else None


def bandwidth_hz(said: SpectrumHead, spacing_hz: float) -> float | None:
    """Return the noise bandwidth of a line [Hz] from bandwidth or window in the header; None if it states neither."""
    if said.bandwidth:
        value, unit = said.bandwidth
        known = unit_of(unit) if unit.endswith("Hz") else None
        return value * known.factor if known else value * spacing_hz
    if said.window is None:
        return None
    return noise_bandwidth_of(said.window) * spacing_hz


class Sides(NamedTuple):
    """Lines [Hz] rising from 0, their one-sided density, and a sentence on the conversion, empty if there was none."""

    frequency_hz: Array
    density: Array
    words: str


def one_sided(frequency_hz: Array, density: Array, sides: int | None, where: str, lines: Sequence[int]) -> Sides:
    """Return the sorted lines with a one-sided density, judged by their order and the header.

    Args:
        frequency_hz: The lines in their original order, shape (n,).
        density: The density there.
        sides: 1 or 2 where it is stated.
        where: The file, for the messages.
        lines: The line number in the file of each.

    Raises:
        ConfigError: The frequencies repeat, or those below 0 Hz do not mirror those above.
    """
    steps = np.diff(frequency_hz)
    falls = np.flatnonzero(steps < 0.0)
    order = np.argsort(frequency_hz, kind="stable")
    f, p = frequency_hz[order], density[order]
    spacing = float(np.median(np.diff(f))) if len(f) > 1 else 0.0
    if np.any(np.diff(f) <= 1e-6 * spacing) or not spacing > 0.0:
        place = int(falls[0]) + 1 if len(falls) else int(np.argmin(np.abs(steps))) + 1
        raise ConfigError(
            f"{where}, line {lines[place]}: its frequencies begin again or stand twice: are there two spectra in one"
            " file? Give a file for each"
        )
    words = ""
    if len(falls) and len(falls) < len(steps) and not (len(falls) == 1 and frequency_hz[falls[0] + 1] < 0.0):
        if np.ptp(np.diff(f)) > 0.5 * spacing:
            raise ConfigError(
                f"{where}, line {lines[int(falls[0]) + 1]}: its frequencies begin again: are there two spectra in one"
                " file? Give a file for each"
            )
        words = "its lines were not in order, and are sorted"
    if f[0] < -0.5 * spacing:
        return _folded(f, p, spacing, sides, where)
    if mirrored := _mirrored(f, p, spacing, sides, where):
        return mirrored
    if sides == 2:
        return Sides(f, np.where(f > 0.0, 2.0, 1.0) * p, "the positive half of a two-sided density is doubled")
    return Sides(f, p, words)


def _folded(f: Array, p: Array, spacing: float, sides: int | None, where: str) -> Sides:
    above = f > 0.5 * spacing
    lines = f[above]
    places = np.clip(np.searchsorted(f, -lines), 0, len(f) - 1)
    places = np.where(np.abs(f[np.maximum(places - 1, 0)] + lines) < np.abs(f[places] + lines), places - 1, places)
    paired = np.abs(f[places] + lines) < 0.1 * spacing
    unlike = float(np.mean(~paired)) if len(paired) else 1.0
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(np.log(p[above] / p[places]))
    if unlike > _ALIKE or not np.nanmedian(apart[paired]) < _ALIKE:
        raise ConfigError(
            f"{where}: its lines below 0 Hz are no mirror of those above it: is it a spectrum about a carrier, as"
            " that of a lock-in or a receiver? Export the spectrum of the deflection itself, from 0 Hz"
        )
    if sides == 1:
        raise ConfigError(
            f"{where}: is said to be one-sided, and has lines below 0 Hz with a density as large as above it: write"
            " the lines from 0 Hz alone, or --sides two"
        )
    density = p[above] + np.where(paired, p[places], p[above])
    return Sides(lines, density, "lines below 0 Hz are there (two-sided): both sides are added")


def _mirrored(f: Array, p: Array, spacing: float, sides: int | None, where: str) -> Sides | None:
    """Fold lines from 0 to the sampling rate whose upper half mirrors the lower one; None for other spectra."""
    if len(f) < 32 or np.ptp(np.diff(f)) > 0.1 * spacing:
        return None
    kept = f > 0.5 * spacing
    values = p[kept]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(np.log(values / values[::-1]))
    if not np.nanmax(apart) < _ALIKE:
        return None
    if sides == 1:
        raise ConfigError(
            f"{where}: is said to be one-sided, and its upper half is the mirror of the lower one, as of a two-sided"
            " spectrum from 0 Hz to the rate: write the lower half alone, or --sides two"
        )
    rate = float(f[kept][-1]) + float(f[kept][0])
    low = kept & (f < 0.5 * rate - 0.25 * spacing)
    return Sides(f[low], 2.0 * p[low], "its upper half is the mirror of the lower one (two-sided): both are added")
