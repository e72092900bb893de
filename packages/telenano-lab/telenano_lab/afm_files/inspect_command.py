"""`telenano inspect FILE`: report how telenano interprets a file, before using it."""

import json
import re
import shlex
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from telenano.cli import JsonOption, print_document, report_errors
from telenano.files import Column, TextTable, as_number, decoded, read_in_child, read_regular, unit_of
from telenano.settings import FileReader, flag_overrides
from telenano.wire import ConfigError, quoted
from telenano_lab.afm_files.text_curves import NOTHING, TableOptions, curves_of, table_options_of

_LARGEST_BYTES = 256_000_000
# Bytes that do not occur at the beginning of a text.
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
_BEGIN = 4096
_PING = re.compile(r"\b(?:icmp_)?seq[= ]\d| : \[\d+\], (?:\d+ bytes|timed out)|\bTTL=\d+\s*$", re.MULTILINE)
_DELAY = re.compile(r"(?i)sent|send|received|recv|delay|latency|rtt|ping")
_SPECTRAL = re.compile(r"(?i)db|[munp]?v[ _]?(?:rms|pk|pp|peak)|[munp]?v(?:\^2|²|\*\*2|/√|/sqrt|/rt)")
_DENSITIES = ("V^2/Hz", "V/sqrt(Hz)", "m^2/Hz", "m/sqrt(Hz)")
_SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas", "": "blanks"}


def inspect(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File of an instrument, or log of a line.")],
    lacking: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Of a curve: columns=1,2, way_unit=nm, value_unit=nN, value_sign=-1.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show how a file is read: format, columns, units, sign, parts left out, and the command that uses it."""
    with report_errors(as_json):
        overrides = flag_overrides(lacking or ())
        if unknown := sorted(set(overrides) - set(TableOptions._fields)):
            raise ConfigError(f"--set {unknown[0]}: is not one of {', '.join(TableOptions._fields)}")
        try:
            options = table_options_of(json.dumps(overrides))
        except ValueError as error:
            raise ConfigError(str(error)) from error
        document = inspected(file, options)
    print_document(document, str(file), as_json=as_json)


def inspected(path: Path, options: TableOptions = NOTHING) -> dict[str, Any]:
    """Return how a file is interpreted; a curve also by the user's options on columns and units.

    Raises:
        ConfigError: It cannot be read, or is empty.
    """
    try:
        content = read_regular(path, _LARGEST_BYTES)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not content.strip():
        raise ConfigError(f"{path}: is empty")
    is_wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    # The header of an instrument's file may be many kilobytes of text, but a text has no zero byte anywhere.
    if (_BINARY.search(content[:_BEGIN]) or b"\0" in content) and not is_wide:
        return _of_instrument(path)
    if _PING.search(decoded(content[:200_000], str(path))):
        return {"format": "what ping printed", "takes_it": f"telenano link fit {_quoted(path)}"}
    try:
        table = TextTable.parse(content, str(path))
    except ConfigError as error:
        document = _of_instrument(path)
        if document["takes_it"]:
            return {**document, "as_a_table": str(error)}
        return {**document, "format": "no table, and no file that an installed package reads", "reason": str(error)}
    return _of_table(path, table, options)


def _of_table(path: Path, table: TextTable, options: TableOptions) -> dict[str, Any]:
    columns = table.columns
    document: dict[str, Any] = {
        "format": f"text table, separated by {_SEPARATORS[table.separator]}",
        "decimal_mark": "comma" if table.decimal_comma else "point",
        "rows": len(table.lines),
        "first_row_in_line": int(table.lines[0]),
        "lines_of_head": len(table.head),
    }
    if len(columns) > 8:
        values = np.array([column.values for column in columns])
        document["columns"] = f"{len(columns)}, from {np.nanmin(values):.4g} to {np.nanmax(values):.4g}"
    else:
        document["columns"] = {f"column {n}": _column(column) for n, column in enumerate(columns, start=1)}
    document["left_out"] = list(table.remarks)
    kind, takes, gives = _kind(path, table, options)
    document |= {"taken_for": kind, "takes_it": takes}
    return document | ({"would_give": gives} if gives else {})


def _column(column: Column) -> str:
    known = column.known
    unit = column.unit or "no unit"
    if column.unit:
        of_spectrum = " (of a spectrum)" if _SPECTRAL.match(column.unit) else " (NOT KNOWN: it will be refused)"
        unit += f" (times {known.factor:.6g} in SI)" if known else of_spectrum
    if column.bad:
        return f"{column.title or 'without a name'}: texts, such as {column.bad[1][:20]!r} in line {column.bad[0]}"
    sound = column.values[np.isfinite(column.values)]
    if not len(sound):
        return f"{column.title or 'without a name'}: no number"
    steps = np.diff(sound)
    course = "rises" if (steps > 0.0).all() else "falls" if (steps < 0.0).all() else "goes both ways"
    lost = f", {len(column.values) - len(sound)} missing" if len(sound) < len(column.values) else ""
    name = column.name or column.title or "without a name"
    return f"{name}: {unit}, {sound.min():.6g} to {sound.max():.6g}, {course}{lost}"


def _kind(path: Path, table: TextTable, options: TableOptions) -> tuple[str, list[str], dict[str, Any]]:
    columns = table.columns
    kinds = {name: _of(columns, name) for name in ("Hz", "m", "N", "V", "s", *_DENSITIES)}
    if any(options):
        settings = " ".join(
            f"--set {shlex.quote(f'{name}={value}')}" for name, value in options._asdict().items() if value
        )
        takes = [
            f"telenano curve --overlay {_quoted(path)} {settings}",
            f"telenano sample import {_quoted(path)} {settings} --out map.npz",
        ]
        return "a force curve, as --set says", takes, _curve(path, options)
    in_head = table.units_in_head(*_DENSITIES)
    # Decibels, peaks and line powers count too: the command accepts them or says what they lack.
    is_spectral = any(kinds[name] for name in _DENSITIES) or any(_SPECTRAL.match(one.unit) for one in columns)
    if (kinds["Hz"] and is_spectral) or in_head:
        return "a thermal spectrum", [f"telenano calibrate stiffness --spectrum {_quoted(path)}"], {}
    if kinds["m"] and (kinds["N"] or kinds["V"] or len(kinds["m"]) > 1) and len(table.lines) > 1:
        takes = [f"telenano curve --overlay {_quoted(path)}", f"telenano sample import {_quoted(path)} --out map.npz"]
        takes += [f"telenano calibrate sensitivity --curve {_quoted(path)}"] if kinds["V"] else []
        return "a force curve", takes, _curve(path, NOTHING)
    if any(_DELAY.match(column.name or column.title) for column in columns):
        return "a log of a line", [f"telenano link fit {_quoted(path)}"], {}
    # A last header line of facts, such as `Width: 1 µm`, is no line of names.
    is_named = all(column.title and as_number(column.title) is None and ":" not in column.title for column in columns)
    if len(columns) > 2 and is_named:
        return (
            f"a table of {len(columns)} columns whose head names no units that are known; of a curve --set columns=1,2"
            " --set way_unit=nm --set value_unit=nN give them",
            [],
            {},
        )
    if len(columns) > 2:
        text = f"a matrix of {len(table.lines)} x {len(columns)} heights"
        return text, [f"telenano scan --sample {_quoted(path)} --size WIDTH"], {}
    if len(columns) == 1:
        return (
            "one column: a record of a deflection, or delays",
            [
                f"telenano calibrate stiffness --record {_quoted(path)} --rate HZ",
                f"telenano link fit {_quoted(path)} --unit ms --period S",
            ],
            {},
        )
    return (
        "two columns without known units: a head such as `z [nm]`, `force [nN]` or `f [kHz]`, `PSD [V^2/Hz]` says them;"
        " of a curve --set way_unit=nm --set value_unit=nN does, of a spectrum --frequency-unit kHz --unit V^2/Hz",
        [],
        {},
    )


def _quoted(path: Path) -> str:
    """Return a path quoted for a command line."""
    return quoted(path)


def _of(columns: tuple[Column, ...], unit: str) -> list[Column]:
    wanted = unit_of(unit)
    return [column for column in columns if wanted and column.known and column.known.powers == wanted.powers]


def _curve(path: Path, options: TableOptions) -> dict[str, Any]:
    try:
        read, _ = next(curves_of(str(path), options).each)
        curve = read()
    except (ValueError, ConfigError) as error:
        return {"refused": str(error)}
    approach, retract = curve.ways[0], curve.ways[-1]
    return {
        "values": f"in {curve.unit}, positive where the sample pushes; heights in m rise away from the sample",
        "approach": f"{len(approach[0])} points, {approach[0].min():.4g} to {approach[0].max():.4g} m",
        "retract": f"{len(retract[0])} points" + (", the approach again" if len(approach[0]) == len(retract[0])
                                                  and np.array_equal(approach[1], retract[1][::-1]) else ""),
        "least_value": float(min(approach[1].min(), retract[1].min())),
        "greatest_value": float(max(approach[1].max(), retract[1].max())),
        "assumed": list(curve.remarks),
    }  # fmt: skip


def _of_instrument(path: Path) -> dict[str, Any]:
    """Return what the readers of installed packages find in a file: images, curves and spectra."""
    ending = path.suffix.lower().removeprefix(".").replace("-", "_")
    readers = {point.name: point for point in entry_points(group="telenano.readers")}
    document: dict[str, Any] = {"format": f"a file of an instrument, by its ending {path.suffix or 'other'}"}
    takes, refused = [], []
    for name in (ending, "other"):
        reader = readers[name].load() if name in readers else FileReader()
        for what, line in (
            ("heights", f"telenano scan --sample {_quoted(path)}"),
            ("curve", f"telenano curve --overlay {_quoted(path)}"),
            ("spectrum", f"telenano calibrate stiffness --spectrum {_quoted(path)}"),
        ):
            function = getattr(reader, what)
            if not function:
                continue
            try:
                arguments = ("0", "1.0", "1.0") if what == "curve" else ()
                facts, arrays = read_in_child(function, path, *arguments, limits=reader.limits(path.stat().st_size))
            except (OSError, ImportError, ValueError) as error:
                refused.append(f"as {what}: {error}")
                continue
            document[what] = _facts(what, facts, arrays)
            takes.append(line)
        if takes:
            break
    return {**document, "takes_it": takes, **({} if takes else {"refused": refused})}


def _facts(what: str, facts: dict[str, Any], arrays: list[Any]) -> dict[str, str]:
    if what == "heights":
        rows = {}
        for fact, values in zip(facts["channels"], arrays, strict=True):
            lost = int(np.count_nonzero(~np.isfinite(values)))
            width, depth = fact["sides"]
            text = f"{values.shape[1]} x {values.shape[0]}, {width:.4g} x {depth:.4g} {fact['unit']}"
            text += f", values in {fact['z'] or 'no unit'}" + (f", {lost} not measured" if lost else "")
            rows[fact["name"]] = text + (f"; left out: {fact['left_out']}" if "left_out" in fact else "")
        return rows
    if what == "curve":
        base = arrays[0]
        return {
            "curve 0": f"{len(base)} points, base {base.min():.4g} to {base.max():.4g} m, rising towards the sample"
        }
    lines = arrays[0]
    text = f"{len(lines)} lines from {lines[0]:.6g} to {lines[-1]:.6g} Hz, density in {facts['unit']}"
    return {"spectrum": f"{text}, {facts['averages']} averages"}
