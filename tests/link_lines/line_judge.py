"""Whether what was said of a line was right, against its truth."""

from typing import NamedTuple

from lines import BORNE_MS, LIMITED, LineOf, Piece, Seen, Session, WayOf, at

# After a change, figures are to be right from here on [s].
FOLLOWS_S = 1.0
# The hand may be off for so long after a step [ms].
OFF_MS = 300
# A capacity is right within this share.
CAPACITY = 0.25
# Of a line without a limit a capacity below this is wrong, as a sender of 1 kHz needs that [Mbit/s].
FREE_MBIT = 10.0
# A sample and what is around it takes so much of a line [kbit].
_OWN_KBIT = 1.8
# A figure is wrong of a line if more than this share of what was said of it is.
FEW = 0.1


class Verdict(NamedTuple):
    """What was right of a line: round trip, queue; capacity (right, wrong, null) and whether a queue limits it.

    in_interval: share of the intervals of the round trip that hold the truth; off_ms: for how long the hand was off
    after a step that is borne, None of other lines; over_ms: by how much the round trip that counts as the line's own
    was above what every message took, at most: so much older a hand may be than it is taken for. queue_in_interval and
    capacity_in_interval: shares of those intervals that hold the truth, None where nothing was said, or where the truth
    has no value.
    """

    round_trip: bool
    queue: bool
    capacity: str
    limited: bool
    in_interval: float
    off_ms: int | None
    over_ms: float
    queue_in_interval: float | None = None
    capacity_in_interval: float | None = None


def _scale_ms(way: WayOf) -> float:
    return way.jitter[1]


def _settled(line: LineOf, seen: list[Seen]) -> list[Seen]:
    changes = [0.7, *line.changes_s, *([] if line.set_clock is None else [line.set_clock[0]])]
    return [one for one in seen if not any(0.0 <= one.at_s - change < FOLLOWS_S for change in changes) and one.at_s > 1]


def _fills(line: LineOf) -> bool:
    """Whether the samples, or others, make queues on it."""
    return line.kind in (*LIMITED, "widens", "queue of others", "wide")


def _queue_right(line: LineOf, one: Seen) -> bool:
    slack = 5.0 + 2.0 * (_scale_ms(line.there) + _scale_ms(line.back))
    return all(said is None or least - slack <= said <= 1.1 * most + slack for said, least, most in one.queues_ms)


def _capacity(line: LineOf, seen: list[Seen], way: int) -> str:
    said = [one.capacities[way] for one in seen]
    wrong = 0
    for mbit, truth in said:
        if mbit is not None:
            wrong += abs(mbit / truth - 1.0) > CAPACITY if truth else mbit < FREE_MBIT
    if wrong > FEW * len(said):
        return "wrong"
    return "null" if sum(mbit is None for mbit, _ in said) > 0.5 * len(said) else "right"


def _queue_inside(line: LineOf, seen: list[Seen], way: int) -> float | None:
    """Return the share of the intervals of a queue that have a value in common with what datagrams waited.

    What a datagram itself takes of the line is in its time, and in that of every one before the queue as well.
    """
    rate_mbit = (line.there, line.back)[way].rate_mbit
    jitter_ms = 2.0 * (_scale_ms(line.there) + _scale_ms(line.back))
    held = []
    for one in seen:
        if (interval := one.queue_intervals_ms[way]) is not None:
            _, least, most = one.queues_ms[way]
            mbit = at(rate_mbit, one.at_s)
            own_ms = _OWN_KBIT / mbit if mbit else 0.0
            held.append(interval[0] <= most + jitter_ms and interval[1] >= least - own_ms)
    return sum(held) / len(held) if held else None


def _capacity_inside(seen: list[Seen], way: int) -> float | None:
    """Return the share of the intervals of a capacity that hold it."""
    held = []
    for one in seen:
        (_, truth), interval = one.capacities[way], one.capacity_intervals[way]
        if truth and interval is not None:
            held.append(interval[0] <= truth and (interval[1] is None or truth <= interval[1]))
    return sum(held) / len(held) if held else None


def _limits(line: LineOf, way: WayOf) -> bool:
    return line.kind in LIMITED and 0 < way.rate_mbit[-1].value < 1.2 * line.hz * 175 * 8e-6


def step_s(line: LineOf) -> float | None:
    """Return when a line makes a step up that is borne, and stays for a second at least; None where it does not."""
    ways = line.there.delay_ms, line.back.delay_ms
    steps = [pieces for pieces in ways if len(pieces) > 1]
    if not line.kind.startswith("step") or not steps:
        return None
    after = sum(pieces[1].value if len(pieces) > 1 else pieces[0].value for pieces in ways)
    before = sum(pieces[0].value for pieces in ways)
    return steps[0][1].from_s if before < after <= BORNE_MS else None


def judge(session: Session) -> list[Verdict]:
    """Return the verdict on both ways of a line; the first has what is of the line as a whole."""
    line, settled = session.line, _settled(session.line, session.seen)
    slack = 2.0 + 2.0 * (_scale_ms(line.there) + _scale_ms(line.back))
    off = [one for one in settled if abs(one.round_trip_ms - one.true_ms) > slack]
    inside = [one.low_ms <= one.true_ms <= one.high_ms for one in settled]
    begin_s = step_s(line)
    off_ms = None if begin_s is None else session.hand_off_in(begin_s, begin_s + 3.0)
    late = [one for one in settled if one.at_s > 0.6 * line.seconds]
    # What every message took at least for a while is the line and the least queues of that while.
    over_ms = max(
        (one.round_trip_ms - one.true_ms - sum(most for _, _, most in one.queues_ms) for one in settled), default=0.0
    )
    queue_wrong = sum(not _queue_right(line, one) for one in settled) > FEW * len(settled)
    found = []
    for place, way in enumerate((line.there, line.back)):
        found.append(
            Verdict(
                round_trip=_fills(line) or len(off) <= FEW * len(settled),
                queue=not queue_wrong,
                capacity=_capacity(line, late, place),
                limited=_limits(line, way),
                in_interval=sum(inside) / max(1, len(inside)),
                off_ms=off_ms,
                over_ms=over_ms,
                queue_in_interval=_queue_inside(line, settled, place),
                capacity_in_interval=_capacity_inside(late, place),
            )
        )
    return found


__all__ = ["FEW", "OFF_MS", "Piece", "Verdict", "at", "judge", "step_s"]
