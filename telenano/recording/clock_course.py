"""Offset of another clock over a whole recording: runs between which it was set, each of straight lines.

A process counts its time on from the clock that it read at its start, so a clock is set only where a site begins again.
An exchange whose bounds no drift reconciles with those before it proves this, and begins another run.
"""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from operator import itemgetter
from typing import NamedTuple

from telenano.timing.clock_fit import MOST_DRIFT, Bound, Bounds, ClockLine, are_apart

_BLOCK_NS = 1_000_000_000
# No line is longer, because temperature and time services change the rate of a clock slowly.
_LONGEST_NS = 600 * _BLOCK_NS
# Two lines that are further apart than this mean that the clock was set in between [ns].
_SET_NS = 2_000_000.0
# Accuracy to which the search finds the time at which the clock was set [ns].
_SOUGHT_NS = 200_000_000
# Bounds that are further apart than this, besides the greatest drift, are of two runs [ns].
_PROVEN_NS = 2_000_000.0


class Stretch(NamedTuple):
    """A line of the clock offset and the interval of this clock in which it holds [ns]."""

    first_ns: int
    last_ns: int
    line: ClockLine


class Run(NamedTuple):
    """Course of the offset between two settings of the clock.

    first_ns and last_ns: first and last measurement, by this clock [ns]; knots: times by this clock [ns] and the lead
    of the other clock there [ns], linear in between; error_ns: bound of its error [ns].
    """

    first_ns: int
    last_ns: int
    knots: tuple[tuple[int, float], ...]
    error_ns: float


# Reads the bounds of an interval of the recording, given by this clock [ns]; None if there are none.
Read = Callable[[int, int], Bounds | None]


def bounds_of(upper: Iterable[Bound], lower: Iterable[Bound]) -> Bounds | None:
    """Return the least upper and the greatest lower bound of each second; None if either side is empty."""
    high = _least_of_seconds(upper)
    low = [(at_ns, -value_ns) for at_ns, value_ns in _least_of_seconds((at_ns, -value_ns) for at_ns, value_ns in lower)]
    return Bounds(high, low) if high and low else None


def _least_of_seconds(bounds: Iterable[Bound]) -> list[Bound]:
    least: dict[int, Bound] = {}
    for bound in bounds:
        second = bound[0] // _BLOCK_NS
        least[second] = min(least.get(second, bound), bound, key=itemgetter(1))
    return list(least.values())


def split(bounds: Bounds) -> list[Bounds]:
    """Return the bounds of an interval in parts, between which the clock was set; no part is empty on either side."""
    rows = sorted([(at_ns, value, True) for at_ns, value in bounds.upper] + [(*low, False) for low in bounds.lower])
    parts: list[Bounds] = []
    upper: list[Bound] = []
    lower: list[Bound] = []
    low_ns, high_ns, before_ns = -math.inf, math.inf, rows[0][0] if rows else 0
    for at_ns, value, is_upper in rows:
        apart_ns = MOST_DRIFT * (at_ns - before_ns)
        low_ns, high_ns, before_ns = low_ns - apart_ns, high_ns + apart_ns, at_ns
        if value < low_ns - _PROVEN_NS if is_upper else value > high_ns + _PROVEN_NS:
            parts.append(Bounds(upper, lower))
            upper, lower, low_ns, high_ns = [], [], -math.inf, math.inf
        if is_upper:
            upper.append((at_ns, value))
            high_ns = min(high_ns, value)
        else:
            lower.append((at_ns, value))
            low_ns = max(low_ns, value)
    return [part for part in (*parts, Bounds(upper, lower)) if part.upper and part.lower]


def runs(pieces: Sequence[Bounds], read: Read) -> list[Run]:
    """Return the runs of the clock, in order of time.

    Args:
        pieces: Bounds in order of time, none empty, none with a proven step within it (`split`).
        read: Reads the bounds of an interval of the recording, to find when the clock was set between two pieces.
    """
    found: list[list[Stretch]] = []
    chains = list(_chains(pieces))
    # A clock that is set runs on at its rate, which the longest part shows best.
    drift = mean_drift([_run(stretches(max(chains, key=_length_ns)))]) if len(chains) > 1 else 0.0
    for chain in chains:
        for stretch in stretches(chain, drift):
            if found and not _is_set(found[-1][-1], stretch):
                found[-1].append(stretch)
                continue
            if found:
                before, behind = _sought(found[-1][-1], stretch, read)
                found[-1][-1], stretch = before[0], behind[-1]
                found += [[one] for one in (*before[1:], *behind[:-1])]
            found.append([stretch])
    return [_run(parts) for parts in found]


def _chains(pieces: Sequence[Bounds]) -> Iterator[list[Bounds]]:
    """Yield the pieces between proven steps."""
    chain: list[Bounds] = []
    for piece in pieces:
        if chain and len(split(_joined([chain[-1], piece]))) > 1:
            yield chain
            chain = []
        chain.append(piece)
    yield chain


def _length_ns(chain: Sequence[Bounds]) -> int:
    return chain[-1].upper[-1][0] - chain[0].upper[0][0]


def _is_set(part: Stretch, after: Stretch) -> bool:
    between_ns = (part.last_ns + after.first_ns) // 2
    return abs(part.line.at(between_ns) - after.line.at(between_ns)) > _SET_NS


def _run(parts: Sequence[Stretch]) -> Run:
    knots = [(parts[0].first_ns, parts[0].line.at(parts[0].first_ns))]
    for part, after in itertools.pairwise(parts):
        between_ns = (part.last_ns + after.first_ns) // 2
        knots.append((between_ns, 0.5 * (part.line.at(between_ns) + after.line.at(between_ns))))
    last_ns = max(parts[-1].last_ns, knots[-1][0] + 1)
    knots.append((last_ns, parts[-1].line.at(last_ns)))
    error_ns = max(0.0, *(0.5 * part.line.round_trip_ns for part in parts))
    return Run(parts[0].first_ns, parts[-1].last_ns, tuple(knots), error_ns)


def stretches(pieces: Sequence[Bounds], drift: float = 0.0) -> list[Stretch]:
    """Fit lines to pieces of bounds, which are in order of time and not empty; each line is as long as it fits.

    The newest one, two, four ... pieces are compared with those before them: a few reveal a clock that was set by a
    large step, more are needed to reveal a small one. `drift` is the rate that holds unless they show another one
    [s/s].
    """
    found_stretches: list[Stretch] = []
    run: list[Bounds] = []
    for piece in pieces:
        if len(pieces) > 1 and ClockLine.through(*piece, drift).round_trip_ns < 0.0:
            # The clock was set within it.
            continue
        if run and piece.upper[0][0] - run[0].upper[0][0] > _LONGEST_NS:
            found_stretches.append(_stretch(run, drift))
            run = []
        run.append(piece)
        if (newest := _newest_apart(run, drift, len(pieces))) > 0:
            found_stretches.append(_stretch(_older(run, newest), drift))
            run = run[-newest:]
        drift = _line_of(run, drift).drift
    return [*found_stretches, _stretch(run or pieces, drift)]


def _newest_apart(run: Sequence[Bounds], drift: float, pieces: int) -> int:
    """Return the number of newest pieces that need a line of their own; 0 if one line fits all of them."""
    whole = _line_of(run, drift)
    newest = 1
    while newest < len(run):
        parts = [(_line_of(part, drift), _joined(part)) for part in (_older(run, newest), run[-newest:])]
        if are_apart(whole, parts, pieces):
            return newest
        newest *= 2
    return 0


def _older(run: Sequence[Bounds], newest: int) -> Sequence[Bounds]:
    """Return the pieces before the `newest` ones, without the last of them: the clock may have been set within it."""
    return run[: -newest - 1] or run[:-newest]


def _joined(run: Sequence[Bounds]) -> Bounds:
    return Bounds([bound for piece in run for bound in piece.upper], [bound for piece in run for bound in piece.lower])


def _line_of(run: Sequence[Bounds], drift: float) -> ClockLine:
    return ClockLine.through(*_joined(run), drift)


def mean_drift(found: Sequence[Run]) -> float:
    """Return the mean drift of the runs, weighted with their durations [s/s]."""
    lengths = [max(1, run.last_ns - run.first_ns) for run in found]
    return sum(run.knots[-1][1] - run.knots[0][1] for run in found) / sum(lengths)


def _stretch(run: Sequence[Bounds], drift: float) -> Stretch:
    bounds = _joined(run)
    times = [at_ns for at_ns, _ in (*bounds.upper, *bounds.lower)]
    return Stretch(min(times), max(times), _line_of(run, drift))


def _sought(part: Stretch, after: Stretch, read: Read) -> tuple[list[Stretch], list[Stretch]]:
    """Find by bisection the end of the first line and the start of the second, and the runs between them.

    A bound may be dated outside of the interval in which it was recorded, because that is by the recorder's clock; it
    counts as one at the nearer end.

    Returns:
        The first line with its end and the runs behind it, and the runs before the second line and that with its start.
    """
    begin_ns, end_ns = part.last_ns, after.first_ns
    while end_ns - begin_ns > 2 * _SOUGHT_NS:
        middle_ns = (begin_ns + end_ns) // 2
        piece = read(middle_ns, middle_ns + _SOUGHT_NS) or read(middle_ns, end_ns)
        # An interval in which the clock was set belongs to neither side; its first part decides.
        first = split(piece)[:1] if piece is not None else []
        if not first:
            end_ns = middle_ns
            continue
        found = first[0]
        at_ns = min(max(min(found.upper)[0], middle_ns), end_ns)
        is_first, is_after = _is_of(part, found), _is_of(after, found)
        if is_first and is_after:
            at, high_ns = min(found.upper)
            is_first = abs(high_ns - _high(part.line, at)) < abs(high_ns - _high(after.line, at))
            is_after = not is_first
        if is_first:
            begin_ns = at_ns
            part = part._replace(last_ns=at_ns)
        elif is_after:
            after = after._replace(first_ns=at_ns)
            # Only the bounds that count are kept, so others may lie between the middle and this one.
            end_ns = at_ns if at_ns < end_ns else middle_ns
        else:
            own = _stretch([found], 0.0)
            before, inside = _sought(part, own, read)
            behind, ends = _sought(inside[-1], after, read)
            return before, [*inside[:-1], *behind, *ends]
    return [part], [after]


def _is_of(part: Stretch, bounds: Bounds) -> bool:
    """Return whether a line lies between bounds; beyond its ends its rate may err."""

    def most_ns(at_ns: int) -> float:
        return _PROVEN_NS + MOST_DRIFT * max(part.first_ns - at_ns, at_ns - part.last_ns, 0)

    return all(value > part.line.at(at_ns) - most_ns(at_ns) for at_ns, value in bounds.upper) and all(
        value < part.line.at(at_ns) + most_ns(at_ns) for at_ns, value in bounds.lower
    )


def _high(line: ClockLine, at_ns: int) -> float:
    return line.at(at_ns) + 0.5 * line.round_trip_ns
