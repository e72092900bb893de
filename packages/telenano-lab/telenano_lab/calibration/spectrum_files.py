"""Read thermal spectra from files: a text table of any normalisation, or an instrument's file that a package reads."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files import Column, TextTable, unit_of
from telenano.settings import read_by_package
from telenano.wire import ConfigError
from telenano_lab.calibration.spectrum_forms import (
    DENSITIES,
    LINES,
    Form,
    NoReference,
    SpectrumHead,
    bandwidth_hz,
    form_of,
    one_sided,
    power_of,
    said_of,
)

Array = npt.NDArray[np.float64]

# Files with other suffixes are those of an instrument, which packages read.
TEXTS = ("", ".asc", ".csv", ".dat", ".tsv", ".txt")
_FREQUENCIES = ("freq", "f", "omega", "ω", "\u03c9")
_DENSITIES = ("psd", "power", "density", "pwr", "amplitude", "asd", "level", "pxx")
_CHOICES = f"one of {', '.join(DENSITIES)}, with a prefix such as p where it has one"
_FEWEST_LINES = 16
# Two columns are the same spectrum if they differ by less than this share, which rounding explains.
_ALIKE = 0.02


class Spectrum(NamedTuple):
    """A thermal spectrum: lines [Hz], their one-sided density, whether that is in metres, and its averages.

    averages: number of periodograms averaged per line, None if not stated; remarks: how the file was read; window:
    window as `scipy.signal.get_window` takes it, None if the file names none.
    """

    frequency_hz: Array
    density_per_hz: Array
    is_of_metres: bool
    averages: float | None = None
    remarks: tuple[str, ...] = ()
    window: Any = None


class SpectrumOptions(NamedTuple):
    """The user's description of a spectrum, which replaces that of its file.

    unit, frequency_unit: units of density and frequency; columns: columns of frequency and density, by number or title;
    sides: 1 or 2; noise_bandwidth_hz: noise bandwidth of a line, if the file has the power of lines.
    """

    unit: str = ""
    frequency_unit: str = ""
    columns: Sequence[str] = ()
    sides: int | None = None
    noise_bandwidth_hz: float | None = None


def spectrum_of(
    path: Path,
    unit: str = "",
    frequency_unit: str = "",
    columns: Sequence[str] = (),
    *,
    sides: int | None = None,
    noise_bandwidth_hz: float | None = None,
) -> Spectrum:
    """Return the thermal spectrum in a file, as a one-sided power density.

    Args:
        path: A text table whose header may name the units, such as kHz and V/sqrt(Hz), or a file of an instrument that
            an installed package reads.
        unit: The unit of the density; empty for that of the file.
        frequency_unit: The unit of the frequency; empty for that of the file.
        columns: Columns of frequency and density in a text table, by number or title; empty to follow the header.
        sides: 1 for a one-sided density, 2 for a two-sided one; None for what the file states.
        noise_bandwidth_hz: Noise bandwidth of a line [Hz], if the file has the power of lines; None for that of the
            file.

    Raises:
        ConfigError: The file cannot be read, or its normalisation is not known or contradicts itself; the message says
            how to give it.
    """
    options = SpectrumOptions(unit, frequency_unit, columns, sides, noise_bandwidth_hz)
    if path.suffix.lower() not in TEXTS:
        return _of_instrument(path, options)
    return _of_table(TextTable.read(path), options)


def _of_instrument(path: Path, options: SpectrumOptions) -> Spectrum:
    try:
        facts, (frequency_hz, density) = read_by_package(path, "spectrum")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
    word = options.unit or facts["unit"]
    form = form_of(word)
    if not isinstance(form, Form) or form.per_line:
        raise ConfigError(
            f"{path}: its density is in {word!r}, which is not a unit of a density: give --unit, {_CHOICES}"
        )
    power = power_of(density, form, f"{path}: its density")
    doubled = 2.0 if options.sides == 2 else 1.0
    return Spectrum(
        frequency_hz, doubled * power, form.is_of_metres, float(facts["averages"]),
        (f"taken as a {'two' if options.sides == 2 else 'one'}-sided density, {form.words}; --unit and --sides say"
         " otherwise",),
    )  # fmt: skip


def _of_table(table: TextTable, options: SpectrumOptions) -> Spectrum:
    if len(table.columns) < 2 or len(table.lines) < _FEWEST_LINES:
        raise ConfigError(
            f"{table.name}: has {len(table.lines)} lines of {len(table.columns)} columns, {_FEWEST_LINES} or more lines"
            " of 2 are needed"
        )
    head = "\n".join((*table.head, *(column.title for column in table.columns)))
    try:
        said = said_of(head)
    except ConfigError as error:
        if options.sides is None:
            raise ConfigError(f"{table.name}: {error}") from error
        said = SpectrumHead(None, False, None, None, None)
    first = _frequency(table, options)
    second, form, remarks = _density(table, first, options, head)
    lines, of_unit = _lines_hz(table, first, options.frequency_unit)
    values = table.numbers(second)
    sound = np.isfinite(lines) & np.isfinite(values)
    power = power_of(values[sound], form, table.name)
    spacing = float(np.median(np.abs(np.diff(lines[sound])))) if sound.sum() > 1 else 0.0
    power, of_line = _per_hertz(power, form, said, spacing, options, table.name)
    sides = one_sided(lines[sound], power, options.sides or said.sides, table.name, table.lines[sound].tolist())
    two = bool(sides.words) and "sided" in sides.words
    taken = f"taken as a {'two' if two else 'one'}-sided density of {'metres' if form.is_of_metres else 'volts'}"
    taken += f", {form.words}{of_line}; --unit, --sides and --noise-bandwidth say otherwise"
    notes = (*table.remarks, *remarks, *of_unit, *((sides.words,) if sides.words else ()), taken)
    if said.averages:
        notes = (*notes, f"its head states {said.averages} averages; the scatter of the lines is relied upon")
    return Spectrum(sides.frequency_hz, sides.density, form.is_of_metres, None, notes, said.window)


def _frequency(table: TextTable, options: SpectrumOptions) -> Column:
    if options.columns:
        return table.column(options.columns[0])
    hertz = unit_of("Hz")
    of_unit = [one for one in table.columns if hertz and one.known and one.known.powers == hertz.powers]
    of_unit = of_unit or [one for one in table.columns if _is_angular(one.unit)]
    by_name = [one for one in of_unit if one.name.lower().startswith(_FREQUENCIES)]
    named = table.find(*_FREQUENCIES)
    # Prefer a name without a contradicting unit, else the first column that is no density.
    rest = [one for one in table.columns if not isinstance(form_of(one.unit), Form)]
    unnamed = [named] if named is not None and not named.known else []
    return next(iter((*by_name, *of_unit, *unnamed, *rest, *table.columns)))


def _is_angular(word: str) -> bool:
    unit, wanted = unit_of(word), unit_of("rad/s")
    return unit is not None and wanted is not None and unit.powers == wanted.powers


def _lines_hz(table: TextTable, column: Column, given: str) -> tuple[Array, tuple[str, ...]]:
    word = given or column.unit
    if _is_angular(word):
        unit = unit_of(word)
        assert unit is not None
        return table.numbers(column) * unit.factor / (2.0 * math.pi), ("its frequencies are angular ones, in rad/s",)
    words = table.units_in_head("Hz") if not word else set()
    if len(words) > 1:
        raise ConfigError(
            f"{table.name}: its head names the units {', '.join(sorted(words))} of a frequency: give one by "
            "--frequency-unit"
        )
    named = given or "".join(words)
    lines = table.in_si(column, ("Hz",), named, "--frequency-unit" if given or not named else "")
    if lines is None:
        return table.numbers(column), ("nothing names the unit of the frequency, which is taken as Hz",)
    return lines, ()


def _density(
    table: TextTable, frequency: Column, options: SpectrumOptions, head: str
) -> tuple[Column, Form, tuple[str, ...]]:
    """Return the column of the density, the form of its values, and remarks."""
    others = [column for column in table.columns if column is not frequency]
    chosen = table.column(options.columns[1]) if options.columns else None
    if options.unit:
        form = form_of(options.unit, head)
        if not isinstance(form, Form):
            raise ConfigError(f"--unit {options.unit}: must be {_CHOICES}")
        column = chosen or _by_name(others)
        if column.unit.lower().startswith("db") and not form.decibels:
            raise ConfigError(
                f"{table.name}, line {column.line}: {column.title!r} is in decibels, and --unit {options.unit} is not:"
                " give their reference, such as --unit 'dB re 1 V^2/Hz'"
            )
        return column, form, ()
    if chosen is not None:
        return chosen, _form(table, chosen, head), ()
    forms = [(column, form) for column in others if isinstance(form := form_of(column.unit, head), Form)]
    # A voltage beside a density is another channel.
    forms = [one for one in forms if not one[1].per_line] or forms
    if len(forms) > 1:
        _require_alike(table, forms)
    if forms:
        column, form = forms[0]
        more = (f"of its densities, which agree, {column.title!r} is taken",) if len(forms) > 1 else ()
        return column, _of_peak_in_name(form, column), more
    column = _by_name(others)
    return column, _form(table, column, head), ()


def _of_peak_in_name(form: Form, column: Column) -> Form:
    """Return the form of a column whose name, rather than unit, says that its values are peaks."""
    name = f" {column.name.lower()} "
    if "root of the mean square" not in form.words or not any(word in name for word in (" peak ", " pk ", "peak-")):
        return form
    if form.decibels or "rms" in name:
        return form
    return form._replace(factor=0.5 * form.factor, words=f"{column.unit} (peak, by its name {column.name!r})")


def _by_name(columns: Sequence[Column]) -> Column:
    named = (column for word in _DENSITIES for column in columns if column.name.lower().startswith(word))
    return next(named, columns[0])


def _require_alike(table: TextTable, forms: Sequence[tuple[Column, Form]]) -> None:
    """Raise ConfigError if columns that are each a spectrum are not the same one."""
    powers = [power_of(table.numbers(column), form, table.name) for column, form in forms]
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = [float(np.nanmedian(np.abs(np.log(power / powers[0])))) for power in powers[1:]]
    if len({form.per_line for _, form in forms}) > 1 or not all(value < _ALIKE for value in apart):
        titles = ", ".join(repr(column.title) for column, _ in forms)
        raise ConfigError(f"{table.name}: has several spectra, {titles}, which differ: --columns says which to take")


def _form(table: TextTable, column: Column, head: str) -> Form:
    form = form_of(column.unit, head)
    if isinstance(form, NoReference):
        raise ConfigError(
            f"{table.name}, line {column.line}: the unit {column.unit!r} of {column.title!r} is that of no density:"
            f" {form.words}. Give it by --unit, such as --unit 'dB re 1 V^2/Hz'"
        )
    if form is not None:
        return form
    if column.unit:
        raise ConfigError(
            f"{table.name}, line {column.line}: the unit {column.unit!r} of {column.title!r} is that of no density:"
            f" give --unit, {_CHOICES}"
        )
    words = table.units_in_head(*DENSITIES)
    if len({unit_of(word) for word in words}) != 1:
        several = f"names several units ({', '.join(sorted(words))})" if words else "names no unit"
        raise ConfigError(f"{table.name}: its head {several} for the density: give --unit, {_CHOICES}")
    found = form_of(words.pop(), head)
    assert isinstance(found, Form)
    return found


def _per_hertz(
    power: Array, form: Form, said: SpectrumHead, spacing_hz: float, options: SpectrumOptions, where: str
) -> tuple[Array, str]:
    """Return the power per hertz, and words on how it follows from the power of a line."""
    if not form.per_line:
        if said.of_lines and not options.unit:
            raise ConfigError(
                f"{where}: its head says that it has the power of lines, and the unit of its column is that of a"
                f" density: --unit says which, one of {', '.join((*DENSITIES, *LINES))}"
            )
        if options.noise_bandwidth_hz is not None:
            raise ConfigError(
                f"{where}: --noise-bandwidth: is of a file with the power of lines, and this one has a density:"
                f" leave it out, or give --unit, one of {', '.join(LINES)}"
            )
        return power, ""
    width = options.noise_bandwidth_hz or bandwidth_hz(said, spacing_hz)
    if width is None:
        raise ConfigError(
            f"{where}: has the power of lines and not a density ({form.words}), and its head names neither their noise"
            f" bandwidth nor a window that is known: give --noise-bandwidth HZ, or --unit if it is {_CHOICES}"
        )
    return power / width, f", of lines with a noise bandwidth of {width:.6g} Hz"
