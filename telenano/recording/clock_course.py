"""Offset of another clock over a whole recording, as straight lines; each lasts as long as it fits the bounds."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from operator import itemgetter
from typing import NamedTuple

from telenano.timing.clock_fit import Bound, Bounds, ClockLine, are_apart

_BLOCK_NS = 1_000_000_000
# No line is longer, because temperature and time services change the rate of a clock slowly.
_LONGEST_NS = 600 * _BLOCK_NS
# Two lines that are further apart than this mean that the clock was set in between [ns].
_SET_NS = 2_000_000.0
# Accuracy to which the search finds the time at which the clock was set [ns].
_SOUGHT_NS = 200_000_000


class Stretch(NamedTuple):
    """A line of the clock offset and the interval of this clock in which it holds [ns]."""

    first_ns: int
    last_ns: int
    line: ClockLine


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


def stretches(pieces: Sequence[Bounds]) -> list[Stretch]:
    """Fit lines to pieces of bounds, which are in order of time and not empty; each line is as long as it fits.

    The newest one, two, four ... pieces are compared with those before them: a few reveal a clock that was set by a
    large step, more are needed to reveal a small one.
    """
    found_stretches: list[Stretch] = []
    run: list[Bounds] = []
    drift = 0.0
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


def knots(parts: Sequence[Stretch], read: Read) -> list[tuple[int, float]]:
    """Return the knots of the piecewise linear offset: times of the other clock [ns] and its lead there [ns].

    A step has a knot on either side, at the same time if the clock was set back over times that it already had.

    Args:
        parts: The lines, in order of time.
        read: Reads the bounds of an interval of the recording, to find when the clock was set between two lines.
    """
    runs = [[(parts[0].first_ns, parts[0].line.at(parts[0].first_ns))]]
    for part, after in itertools.pairwise(parts):
        between_ns = (part.last_ns + after.first_ns) // 2
        if abs(part.line.at(between_ns) - after.line.at(between_ns)) <= _SET_NS:
            runs[-1].append((between_ns, 0.5 * (part.line.at(between_ns) + after.line.at(between_ns))))
            continue
        last_ns, first_ns = _sought(part, after, read)
        runs[-1].append((last_ns, part.line.at(last_ns)))
        runs.append([(first_ns, after.line.at(first_ns))])
    runs[-1].append((max(parts[-1].last_ns, runs[-1][-1][0] + 1), parts[-1].line.at(parts[-1].last_ns)))
    # If the clock was set back far, the stamps of the later run lie before those of the earlier run.
    stamped = sorted([(at_ns + round(ahead_ns), ahead_ns) for at_ns, ahead_ns in run] for run in runs)
    for before, behind in itertools.pairwise(stamped):
        if behind[0][0] < before[-1][0]:
            # The clock was set back by more than the site was silent, so some stamps occur twice: split them in half.
            middle_ns = (behind[0][0] + before[-1][0]) // 2
            before[-1], behind[0] = (middle_ns, before[-1][1]), (middle_ns, behind[0][1])
    return [knot for run in stamped for knot in run]


def mean_drift(parts: Sequence[Stretch]) -> float:
    """Return the mean drift of the lines, weighted with their durations [s/s]."""
    lengths = [max(1, part.last_ns - part.first_ns) for part in parts]
    return sum(length * part.line.drift for length, part in zip(lengths, parts, strict=True)) / sum(lengths)


def _stretch(run: Sequence[Bounds], drift: float) -> Stretch:
    bounds = _joined(run)
    times = [at_ns for at_ns, _ in (*bounds.upper, *bounds.lower)]
    return Stretch(min(times), max(times), _line_of(run, drift))


def _sought(part: Stretch, after: Stretch, read: Read) -> tuple[int, int]:
    """Find by bisection the end of the first line and the start of the second, by this clock [ns].

    A bound may be dated outside of the interval in which it was recorded, because that is by the recorder's clock; it
    counts as one at the nearer end.
    """
    begin_ns, end_ns = last_ns, first_ns = part.last_ns, after.first_ns
    while end_ns - begin_ns > 2 * _SOUGHT_NS:
        middle_ns = (begin_ns + end_ns) // 2
        piece = read(middle_ns, middle_ns + _SOUGHT_NS) or read(middle_ns, end_ns)
        if piece is None:
            end_ns = middle_ns
            continue
        at_ns, high_ns = min(piece.upper)
        is_first = abs(high_ns - _high(part.line, at_ns)) < abs(high_ns - _high(after.line, at_ns))
        at_ns = min(max(at_ns, middle_ns), end_ns)
        if is_first:
            begin_ns = last_ns = at_ns
        else:
            # Only the bounds that count are kept, so others may lie between the middle and this one.
            first_ns = at_ns
            end_ns = at_ns if at_ns < end_ns else middle_ns
    return last_ns, first_ns


def _high(line: ClockLine, at_ns: int) -> float:
    return line.at(at_ns) + 0.5 * line.round_trip_ns
