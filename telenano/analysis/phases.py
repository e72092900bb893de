"""Phases of a session for a page: when the hand approached, touched, held and let go, and the moments between.

Times are in the session [s]. The holds are those of `telenano.analysis.holds`.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Phase = Literal["apart", "approach", "contact", "hold", "release", "released"]

# longest loss of contact that still counts as one contact, because the tip bounces when it lands [s]
_LEAST_GAP_S = 0.02
# A shorter stretch is no phase, but the end of a series [s].
_SHORTEST_S = 0.005
# share of its greatest force below which the hand does not press [1]
_PRESSING_SHARE = 0.05
# share of its greatest force above which the hand has begun to press [1]
_MOVING_SHARE = 0.02


class Span(NamedTuple):
    """A phase of a session: its kind, start and end [s]."""

    kind: Phase
    from_s: float
    to_s: float


class Moment(NamedTuple):
    """An instant of a session: `contact` or `lost`, its time [s], and the sentence."""

    kind: str
    time_s: float
    text: str


def contacts_of(time_s: npt.NDArray[np.float64], in_contact: npt.NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return start and end [s] of each contact of the tip, bounces joined; both arrays of shape (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], in_contact, [False]]).astype(np.int8)))
    contacts: list[tuple[float, float]] = []
    for first, end in edges.reshape(-1, 2):
        begin_s, end_s = float(time_s[first]), float(time_s[min(end, len(time_s) - 1)])
        if contacts and begin_s - contacts[-1][1] < _LEAST_GAP_S:
            begin_s = contacts.pop()[0]
        contacts.append((begin_s, end_s))
    return contacts


def moments_of(contacts: Sequence[tuple[float, float]], end_s: float) -> list[Moment]:
    """Return the moments at which the tip came into contact, and came off again before the end [s]."""
    moments = []
    for begin_s, off_s in contacts:
        moments.append(Moment("contact", begin_s, "the tip jumps into contact"))
        if off_s < end_s - _SHORTEST_S:
            moments.append(Moment("lost", off_s, "the tip comes off the sample"))
    return moments


def phases_of(
    hand_time_s: npt.NDArray[np.float64],
    hand_force_n: npt.NDArray[np.float64],
    contacts: Sequence[tuple[float, float]],
    holds: Sequence[Mapping[str, Any]],
    end_s: float,
) -> list[Span]:
    """Return the phases of a session in order, from 0 to its end [s].

    Args:
        hand_time_s: The hand's times [s], shape (n,).
        hand_force_n: F_m at these times [N], shape (n,).
        contacts: The contacts as returned by `contacts_of`.
        holds: The holds with the keys of `summary.json`.
        end_s: The end of the session [s].
    """
    greatest = float(np.abs(hand_force_n).max(initial=0.0))
    pressed = [hold for hold in holds if abs(hold["hand_force_n"]) > _PRESSING_SHARE * greatest]
    held = [(hold["start_s"], hold["end_s"]) for hold in pressed]
    moving = np.flatnonzero(np.abs(hand_force_n) > _MOVING_SHARE * greatest)
    begins_s = float(hand_time_s[moving[0]]) if moving.size and greatest > 0.0 else end_s
    last_held_s = held[-1][1] if held else end_s
    # A hold is one phase, even if the tip comes into contact during it.
    free = [at for span in contacts for at in span if not any(begin < at < end for begin, end in held)]
    edges = {0.0, end_s, begins_s, *free, *(at for span in held for at in span)}
    spans: list[Span] = []
    for first, last in pairwise(sorted(at for at in edges if 0.0 <= at <= end_s)):
        if last - first < _SHORTEST_S:
            continue
        middle = 0.5 * (first + last)
        touches = any(begin <= middle < end for begin, end in contacts)
        kind: Phase
        if any(begin <= middle < end for begin, end in held):
            kind = "hold"
        elif touches:
            kind = "release" if middle > last_held_s else "contact"
        elif contacts and middle > contacts[-1][1]:
            kind = "released"
        else:
            kind = "approach" if middle > begins_s else "apart"
        if spans and spans[-1].kind == kind and kind != "hold":
            first = spans.pop().from_s
        spans.append(Span(kind, first, last))
    return spans
