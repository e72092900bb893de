"""The sensitivity of a read-out from a curve on a hard sample: find its parts, and check the line of contact.

The displacement may rise towards the sample or away from it: the end at which the lever is free tells. Of the parts in
which the base moves the approach is used; pauses, other branches and rows beside the line are left out and named. The
residuals about the line are compared with the noise between neighbouring rows. A line that is bent by more than noise
is refused, because a soft sample, a creeping piezo and a saturating detector bend it alike.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import special
from telenano_devices.line_fit import regressed

from telenano.analysis import denied
from telenano.files import Column, Part, TextTable, orientation_of, parts_of, role_of
from telenano.settings import read_by_package
from telenano.wire import ConfigError, NoEstimateError

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

# Plausible sensitivity of AFM photodiodes, in contact with a hard sample.
_M_PER_V = (5e-10, 2e-5)
# Plausible span of the base on a hard sample, taken as nanometres if no unit is given.
_WAY_NM = (5.0, 1e5)
_FEWEST_ROWS = 16
_FEWEST_POINTS = 8
# A part that covers less than this share of the span is no branch.
_WAY = 0.3
# The lever is assumed to be free over this share of a branch at its far end.
_FREE = 0.15
# A line is bent if the slopes of its ends differ by more than this share and this number of errors.
_BENT = 0.02
_BENT_ERRORS = 3.5
# Above this ratio of residuals to noise that share alone counts, whatever the error of the bend.
_FAR_FROM_NOISE = 5.0
# Residuals of blocks of points are systematic if noise explains them with less than this probability.
_SYSTEMATIC = 1e-3
_BLOCKS = 12
# A step must reduce the sum of squared residuals to this share, with equal slopes on both sides within the errors.
_STEP_LEAVES = 0.5
# Two approaches that differ by more than this share and this number of errors are two curves.
_APART = 0.02
_APART_ERRORS = 5.0
# This number of rows at one extreme value means a saturated detector.
_AT_END = 5


class Sensitivity(NamedTuple):
    """Displacement per volt [m/V] and its standard error, number of points in contact, scatter about the line [m].

    residual_ratio: mean square of the residuals of blocks of points, relative to the noise between neighbours. remarks:
    the part that was used, and what was left out and found. rows: mask of the line's rows; parts: all parts, as name,
    first row and end.
    """

    m_per_v: float
    standard_error_m_per_v: float
    points: int
    residual_m: float
    residual_ratio: float = 1.0
    remarks: tuple[str, ...] = ()
    rows: Mask | None = None
    parts: tuple[tuple[str, int, int], ...] = ()

    @property
    def share(self) -> float:
        """The relative standard error, which counts twice in a stiffness."""
        return self.standard_error_m_per_v / abs(self.m_per_v)


class CurveFile(NamedTuple):
    """Displacement of the base [m] and deflection [V] of a curve in a text table, and remarks on how it was read."""

    way_m: Array
    volts: Array
    remarks: tuple[str, ...]


def curve_of(path: Path, way_unit: str = "", deflection_unit: str = "", columns: Sequence[str] = ()) -> CurveFile:
    """Return the curve on a hard sample in a text table: displacement [m], deflection [V], remarks on the reading.

    `columns` gives displacement and deflection by number or title; without them the names of the columns decide.

    Raises:
        ConfigError: The file cannot be read, a column is ambiguous, a unit is not known, or no unit is given and the
            span is implausible in nm; the message asks for it.
    """
    table = TextTable.read(path)
    first, second = _columns(table, columns, has_units=bool(way_unit and deflection_unit))
    remarks = [*table.remarks]
    if any(column.title for column in table.columns):
        remarks.append(f"{second.title!r} over {first.title!r} is taken; --columns takes others")
    way, volts = (
        table.in_si(column, wanted, unit, option)
        for column, wanted, unit, option in (
            (first, ("m",), way_unit, "--way-unit"),
            (second, ("V",), deflection_unit, "--deflection-unit"),
        )
    )
    if volts is None:
        volts = table.numbers(second)
        remarks.append("nothing names the unit of the deflection, which is taken as V")
    if way is None:
        way = table.numbers(first)
        span = float(np.nanmax(way) - np.nanmin(way))
        if not _WAY_NM[0] <= span <= _WAY_NM[1]:
            likely = "m" if span < 1e-3 else "um" if span < _WAY_NM[0] else "pm"
            raise ConfigError(
                f"{path}: its head names no unit of the way, whose span of {span:.3g} is not one in nm: is it "
                f"in {likely}?"
                f" Give --way-unit {likely}, or what it is"
            )
        way = 1e-9 * way
        remarks.append("nothing names the unit of the way, which is taken as nm")
    sound = np.isfinite(way) & np.isfinite(volts)
    return CurveFile(way[sound], volts[sound], tuple(remarks))


def _columns(table: TextTable, chosen: Sequence[str], *, has_units: bool) -> tuple[Column, Column]:
    """Return the columns of displacement and deflection: as chosen, else by name, else by unit, else the first two."""
    columns = table.columns
    if len(columns) < 2 or len(table.lines) < _FEWEST_ROWS:
        raise ConfigError(
            f"{table.name}: has {len(table.lines)} lines of {len(columns)} columns, {_FEWEST_ROWS} or more lines of 2"
            " are needed"
        )
    if chosen:
        return table.column(chosen[0]), table.column(chosen[1])
    roles = [role_of(column.name) for column in columns]
    lengths, volts = ([_has(column, unit) for column in columns] for unit in ("m", "V"))
    ways = _first_of(
        [one for one, role, fits in zip(columns, roles, lengths, strict=True) if fits and role == "base"],
        [one for one, role, fits in zip(columns, roles, lengths, strict=True) if fits and not role],
        [one for one, role in zip(columns, roles, strict=True) if role == "base" and not one.known],
    )
    reads = _first_of(
        [one for one, role, fits in zip(columns, roles, volts, strict=True) if fits and role == "deflection"],
        [one for one, role, fits in zip(columns, roles, volts, strict=True) if fits and not role],
        [one for one, role in zip(columns, roles, strict=True) if role in ("deflection", "force") and not one.known],
    )
    if not ways and "separation" in roles and not has_units:
        raise ConfigError(
            f"{table.name}: {columns[roles.index('separation')].title!r} is a separation of tip and sample, which does"
            " not change on a hard sample: the way of the base is needed (--columns X Y)"
        )
    second = _one(table, _of_approach(reads), "a deflection")
    first = _one(table, _measured(_of_approach(ways)), "a way of the base")
    others = [column for column in columns if not role_of(column.name) or not column.known]
    first = first or next((one for one in (*others, *columns) if one is not second), columns[0])
    second = second or next((one for one in (*others, *columns) if one is not first), columns[1])
    return first, second


def _has(column: Column, unit: str) -> bool:
    from telenano.files import unit_of

    known, wanted = column.known, unit_of(unit)
    return known is not None and wanted is not None and known.powers == wanted.powers


def _first_of(*lists: list[Column]) -> list[Column]:
    return next((each for each in lists if each), [])


def _of_approach(found: list[Column]) -> list[Column]:
    """Reduce columns of both branches to that of the approach, if exactly one is named so."""
    there = [
        one for one in found if re.search(r"(?i)(?:^|[\W_])(?:ex|ext|extend|approach|trace|fwd)(?:$|[\W_])", one.title)
    ]
    return there if len(there) == 1 else found


def _measured(found: list[Column]) -> list[Column]:
    """Reduce correlated heights, such as those of a sensor and its command, to the measured one."""
    if len(found) < 2:
        return found
    first = found[0].values
    if all(abs(float(np.corrcoef(first, one.values)[0, 1])) > 0.999 for one in found[1:]):
        return ([one for one in found if re.search(r"(?i)meas|sens|snsr|lvdt", one.title)] or found)[:1]
    return found


def _one(table: TextTable, found: list[Column], what: str) -> Column | None:
    if len(found) > 1:
        titles = ", ".join(repr(one.title) for one in found)
        raise ConfigError(f"{table.name}: {titles} each may be {what}: --columns X Y says which, by number or title")
    return found[0] if found else None


class _Line(NamedTuple):
    """The line of contact of a part: slope [V/m] with its error, scatter [V], mask of rows, residual ratio, remarks."""

    slope: float
    error: float
    scatter: float
    rows: Mask
    ratio: float
    remarks: tuple[str, ...]


def sensitivity_of_curve(way_m: Array, volts: Array, low: float = 0.3, high: float = 0.95) -> Sensitivity:
    """Return the displacement per volt in contact, on the approach, between two shares of the voltage span.

    Args:
        way_m: Displacement of the base [m], rising towards the sample or away from it, shape (n,), in the order of
            time.
        volts: Deflection [V], shape (n,).
        low: Share of the span above which contact is sure.
        high: Share up to which the read-out is linear.

    Raises:
        ConfigError: Too few points lie there, the voltage does not follow the displacement, the line is bent, or two
            approaches differ.
    """
    span_m = float(np.ptp(way_m)) if len(way_m) else 0.0
    if len(way_m) < _FEWEST_ROWS or not span_m > 0.0 or not float(np.ptp(volts)) > 0.0:
        _require(0, low, high)
    parts = parts_of(way_m)
    moving = [part for part in parts if part.direction and float(np.ptp(way_m[part.rows])) > _WAY * span_m]
    moving = moving or [Part(1, 0, len(way_m))]
    rows = np.concatenate([np.arange(part.start, part.end) for part in moving])
    lies = orientation_of(way_m[rows], volts[rows], falls_first=moving[0].direction < 0)
    towards, signal = -lies.away * way_m, lies.turned * volts
    is_approach = [part.direction * -lies.away > 0.0 for part in moving]
    lines: list[tuple[Part, bool, _Line]] = []
    reason: ConfigError | None = None
    for part, approaches in zip(moving, is_approach, strict=True):
        try:
            lines.append((part, approaches, _line_of(towards, signal, part, low, high)))
        except ConfigError as error:
            reason = reason or error
            if approaches:
                # Another approach in the file does not replace one that fails.
                raise
    if not lines:
        assert reason is not None
        raise reason
    part, approaches, line = next((one for one in lines if one[1]), lines[0])
    names = _names_of(parts, lies.away)
    remarks = [
        f"taken: {'approach' if approaches else 'retraction'}, rows {part.start + 1} to {part.end}",
        *line.remarks,
    ]
    left = [f"{name} (rows {start + 1} to {end})" for name, start, end in names if not start <= part.start < end]
    if left:
        remarks.append(f"left out: {', '.join(left[:6])}" + (" and more" if len(left) > 6 else ""))
    remarks += _compared(lines, line, part)
    remarks += _at_an_end(signal)
    if not lies.is_free:
        remarks.append("the lever is free at neither end of the curve: the base is taken to approach first")
    return Sensitivity(
        1.0 / line.slope, line.error / line.slope**2, int(line.rows.sum()), line.scatter / line.slope, line.ratio,
        tuple(remarks), line.rows, tuple(names),
    )  # fmt: skip


def _names_of(parts: Sequence[Part], away: float) -> list[tuple[str, int, int]]:
    names = {0: "rest", -int(away): "approach", int(away): "retraction"}
    return [(names[part.direction], part.start, part.end) for part in parts]


def _compared(lines: Sequence[tuple[Part, bool, _Line]], line: _Line, taken: Part) -> list[str]:
    """Return remarks on the results of the other parts; ConfigError if another approach has another slope."""
    said = []
    for part, approaches, other in lines:
        if part is taken:
            continue
        apart = abs(other.slope - line.slope)
        differs = apart > _APART * line.slope and apart > _APART_ERRORS * math.hypot(other.error, line.error)
        text = f"rows {part.start + 1} to {part.end} give {1e9 / other.slope:.4g} nm/V"
        if differs and approaches:
            raise ConfigError(
                f"it has two approaches that differ: rows {taken.start + 1} to {taken.end} give"
                f" {1e9 / line.slope:.4g} nm/V and {text}. They are two curves: give a file for each"
            )
        said.append(f"the {'other approach' if approaches else 'retraction'}, {text}" + (": it differs by more than its"
                    " error, as friction or creep make it" if differs else ""))  # fmt: skip
    return said


def _at_an_end(signal: Array) -> list[str]:
    top = float(signal.max())
    count = int((signal == top).sum())
    if count < _AT_END:
        return []
    return [f"{count} rows are at the extreme value, {abs(top):.4g} V: the detector was at its end there"]


def _line_of(towards: Array, signal: Array, part: Part, low: float, high: float) -> _Line:
    """Return the line of contact of a part, from the rows between two shares of the span from free to the near end."""
    x, v = towards[part.rows], signal[part.rows]
    order = np.argsort(x, kind="stable")
    free_rows = x < x.min() + _FREE * float(np.ptp(x))
    free = float(np.median(v[free_rows]))
    top = (
        float(np.max(ordered)) if len(ordered := np.sort(v)) < 64 else float(np.mean(ordered[-max(len(v) // 200, 3) :]))
    )
    span = top - free
    if not span > 0.0:
        raise ConfigError("the voltage does not follow the way there: this is not a curve on a hard sample")
    shares = (v - free) / span
    last = _last_below(shares[order], low)
    chosen = (shares >= low) & (shares <= high) & (np.argsort(order) >= last)
    _require(int(chosen.sum()), low, high)
    # Selecting points by their voltage also selects by its noise, so the fitted line then selects the range.
    for _ in range(2):
        slope, error, _ = regressed(x[chosen], shares[chosen])
        if not slope > 0.0:
            break
        predicted = shares[chosen].mean() + slope * (x - x[chosen].mean())
        chosen = (predicted >= low) & (predicted <= high)
        _require(int(chosen.sum()), low, high)
    slope, error, scatter = (span * value for value in regressed(x[chosen], shares[chosen]))
    if reason := denied("the volts of a metre", slope, error, "V/m"):
        raise NoEstimateError(f"{reason}: the voltage does not follow the way there, as on a hard sample it does")
    rows = np.zeros(len(towards), dtype=bool)
    rows[part.rows] = chosen
    return _judged(_Line(slope, error, scatter, rows, 1.0, ()), x[chosen], v[chosen])


def _last_below(shares: Array, low: float) -> int:
    """Return the index of the last point below half of `low`, by medians of three, so that noise does not count."""
    if len(shares) < 3:
        return 0
    middle = np.median(np.lib.stride_tricks.sliding_window_view(shares, 3), axis=1)
    below = np.flatnonzero(middle < 0.5 * low)
    return int(below[-1]) if len(below) else 0


def _judged(line: _Line, x: Array, v: Array) -> _Line:
    """Check the residuals of a line: they may widen its error or show a step; ConfigError if the line is bent."""
    residual = v - v.mean() - line.slope * (x - x.mean())
    noise = _noise(residual, line.scatter)
    ratio, chance = _mismatch(residual, x, noise, 2)
    bend, bend_error, left_by_bend = _bend(x, v, line.slope, noise)
    is_bent = abs(bend) > _BENT and (abs(bend) > _BENT_ERRORS * bend_error or ratio > _FAR_FROM_NOISE)
    if chance > _SYSTEMATIC and not is_bent:
        return line._replace(ratio=ratio)
    step = _step(x, v, noise)
    whole = float(residual @ residual)
    if step is not None and step.left < min(_STEP_LEAVES * whole, 0.8 * left_by_bend):
        return line._replace(
            slope=step.slope, error=step.error, ratio=step.ratio,
            remarks=(f"a step of {1e9 * step.height / step.slope:.3g} nm in the line of contact (a slip, at"
                     f" {1e9 * step.place:.5g} nm of the way) is left out",),
        )  # fmt: skip
    if is_bent:
        raise ConfigError(
            f"the line of contact is bent: at its end it has {1.0 + bend:.3g} times the slope of its begin. The sample"
            " gives way, the piezo creeps, or the read-out is not linear there: choose another --part LOW HIGH"
        )
    widened = math.sqrt(max(ratio, 1.0))
    error = math.hypot(line.error * widened, 0.5 * bend * line.slope if abs(bend) > bend_error else 0.0)
    said = f"the standard error is widened {error / line.error:.2g} times by the residuals, which are"
    return line._replace(error=error, ratio=ratio, remarks=(f"{said} {ratio:.3g} times those of noise",))


def _noise(residual: Array, scatter: float) -> float:
    """Return the noise between neighbouring rows, estimated from their second differences."""
    second = np.diff(residual, 2)
    found = float(np.median(np.abs(second))) / 0.6745 / math.sqrt(6.0) if len(second) else scatter
    return max(found, 1e-6 * scatter, 1e-300)


def _mismatch(residual: Array, x: Array, noise: float, parameters: int) -> tuple[float, float]:
    """Return the mean square of the residuals of blocks relative to noise, and the probability of as much by noise."""
    blocks = np.array_split(residual[np.argsort(x, kind="stable")], min(_BLOCKS, max(len(x) // 4, parameters + 1)))
    squares = [float(block.sum()) ** 2 / len(block) / noise**2 for block in blocks]
    free = max(len(squares) - parameters, 1)
    # Allow for the uncertainty of the noise itself, estimated from few differences.
    excess = 1.0 + 3.0 / math.sqrt(len(x))
    total = float(np.sum(squares))
    return total / free, float(special.chdtrc(free, total / excess))


def _bend(x: Array, v: Array, slope: float, noise: float) -> tuple[float, float, float]:
    """Return the relative difference of slope between both ends, its error, and the squared residuals with a bend."""
    u = 2.0 * (x - x.min()) / max(float(np.ptp(x)), 1e-300) - 1.0
    basis = np.stack([np.ones_like(u), u, u**2 - np.mean(u**2)], axis=1)
    found, *_ = np.linalg.lstsq(basis, v, rcond=None)
    residual = v - basis @ found
    inverse = np.linalg.inv(basis.T @ basis)
    ratio, _ = _mismatch(residual, x, noise, 3)
    error = noise * math.sqrt(max(ratio, 1.0) * float(inverse[2, 2]))
    scale = 4.0 / max(abs(float(found[1])), 1e-300)
    return scale * float(found[2]), scale * error, float(residual @ residual)


class _Step(NamedTuple):
    """A step in a line: its place [m], height [V], slope [V/m] with error, squared residuals, and residual ratio."""

    place: float
    height: float
    slope: float
    error: float
    left: float
    ratio: float


def _step(x: Array, v: Array, noise: float) -> _Step | None:
    """Return the step that leaves the smallest residuals, if both sides have one slope; None otherwise."""
    order = np.argsort(x, kind="stable")
    x, v = x[order], v[order]
    best: tuple[float, int] | None = None
    for place in range(_FEWEST_POINTS, len(x) - _FEWEST_POINTS, max(len(x) // 200, 1)):
        left = _squares_of_step(x, v, place)[0]
        best = min(best, (left, place)) if best else (left, place)
    if best is None:
        return None
    left, place = min(
        (_squares_of_step(x, v, near)[0], near)
        for near in range(
            max(best[1] - len(x) // 200, _FEWEST_POINTS), min(best[1] + len(x) // 200 + 1, len(x) - _FEWEST_POINTS)
        )
    )
    _, slope, height, residual, square = _squares_of_step(x, v, place)
    ratio, chance = _mismatch(residual, x, noise, 4)
    if chance < _SYSTEMATIC:
        return None
    (one, one_error, _), (two, two_error, _) = (
        regressed(x[part], v[part]) for part in (slice(place), slice(place, None))
    )
    if abs(one - two) > _BENT_ERRORS * math.hypot(one_error, two_error):
        return None
    error = noise * math.sqrt(max(ratio, 1.0)) / math.sqrt(square)
    return _Step(float(x[place]), height, slope, error, left, ratio)


def _squares_of_step(x: Array, v: Array, place: int) -> tuple[float, float, float, Array, float]:
    """Fit one slope with a step: squared residuals, slope, height, residuals, and sum of squared displacements."""
    sides = (slice(place), slice(place, None))
    xs, vs = (np.concatenate([each[side] - each[side].mean() for side in sides]) for each in (x, v))
    square = float(xs @ xs)
    slope = float(xs @ vs) / square if square > 0.0 else 0.0
    residual = vs - slope * xs
    offsets = [float(v[side].mean() - slope * x[side].mean()) for side in sides]
    return float(residual @ residual), slope, offsets[1] - offsets[0], residual, square


def require_usual(sensitivities: Sequence[Sensitivity]) -> None:
    """Raise ConfigError for an implausible displacement per volt, and name the likely mistake."""
    for one in sensitivities:
        if not _M_PER_V[0] <= one.m_per_v <= _M_PER_V[1]:
            raise ConfigError(
                f"{1e9 * one.m_per_v:.3g} nm/V is outside the usual range of a deflection per volt: check that "
                "--way-unit and --deflection-unit are those of the file; --anyway accepts it"
            )


def sensitivities_of_file(path: Path, low: float = 0.3, high: float = 0.95) -> tuple[list[Sensitivity], int]:
    """Return the sensitivity from each curve in a file, and the number of curves that are not on a hard sample.

    Of a force map or QI data with many curves only the first ones are used. `low` and `high` are those of
    `sensitivity_of_curve`.

    Raises:
        ConfigError: The file cannot be read, or none of its curves is usable; the message names it and the reason.
    """
    try:
        _, (counts, heights, volts) = read_by_package(path, "deflections")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: is not a file of curves: {error}") from error
    sensitivities, reason = [], ""
    ends = np.cumsum(counts)[:-1]
    for height, volt in zip(np.split(heights, ends), np.split(volts, ends), strict=True):
        try:
            # Heights of approaches rise away from the sample; reversed, they fall in the order of time.
            sensitivities.append(sensitivity_of_curve(height[::-1], volt[::-1], low, high))
        except ConfigError as error:
            reason = str(error)
    if not sensitivities:
        raise ConfigError(f"{path}: none of its {len(counts)} curves can be used: {reason}")
    return sensitivities, len(counts) - len(sensitivities)


def _require(points: int, low: float, high: float) -> None:
    if points < _FEWEST_POINTS:
        raise ConfigError(f"{points} points lie between {low:g} and {high:g} of the span: {_FEWEST_POINTS} are needed")
