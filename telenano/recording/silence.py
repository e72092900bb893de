"""Distinction of silence and loss in a session, and detection of a recording that is cut off at either end.

If nothing of a source is recorded for a while, either it was silent or the recorder lost its messages. The sequence
numbers decide: they continue after a silence, restart with another process, and skip after a loss. At the end the
count of messages that the publisher announces decides. A silence interrupts the session; only a loss makes the
recording incomplete.
"""

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.recording.arrays import last_session, replayed_sources
from telenano.recording.messages import readable
from telenano.recording.multi_file import RecordingSource
from telenano.recording.reader import END_OF_TIME
from telenano.wire.ends import END_TOPIC, read_end
from telenano.wire.nodes import LAUNCHER, name_of

HAND = "haptic/state"
# Samples come every millisecond; after this time the deadline of the loop has passed [s].
LONGEST_STEP_S = 0.05
# A recorder that received the hand from the start has its first sample long before this [s].
_LATE_START_S = 0.1
# A recorder that continues for longer than this without a source [s] proves that the source was silent.
_GOES_ON_S = 0.1

Ints = npt.NDArray[np.int64]


class Break(NamedTuple):
    """Interval of a session without a sample of a topic [s], and its cause.

    lost: True if the sequence numbers show that most of the samples due were sent and are missing; anew: True if the
    numbers restart after it, with the next process of the source.
    """

    topic: str
    start_s: float
    end_s: float
    lost: bool
    anew: bool = False


def breaks_of(
    topic: str,
    time_s: npt.NDArray[np.float64],
    seq: Ints,
    span_s: tuple[float, float],
    sent: int | None = None,
    *,
    is_closed: bool = True,
) -> list[Break]:
    """Return the intervals of a session without a sample of a topic for more than LONGEST_STEP_S, in order of time.

    Args:
        topic: The topic.
        time_s: The times of all its samples in the recording, also outside of the session [s], shape (n,).
        seq: The sequence numbers of the samples, shape (n,).
        span_s: The start and the end of the session [s].
        sent: The number of messages that the publisher announced at its end; None if it announced none.
        is_closed: Whether the file was closed; if not, and `sent` is None, its end counts as lost.
    """
    start_s, end_s = span_s
    if not time_s.size:
        return [Break(topic, start_s, end_s, sent != 0)]
    steps_s = np.diff(time_s)
    moving = steps_s[steps_s > 0.0]
    period_s = float(np.median(moving)) if moving.size else LONGEST_STEP_S
    # Missing numbers before each sample and after the last one; negative where the numbers restart.
    between = np.diff(seq) - 1
    after = (sent - 1 - int(seq[-1])) if sent is not None else (0 if is_closed else np.inf)
    missing = np.concatenate(([float(seq[0])], between.astype(np.float64), [float(after)]))
    edges = np.concatenate(([min(start_s, float(time_s[0]))], time_s, [max(end_s, float(time_s[-1]))]))
    found = []
    for place in np.flatnonzero(np.diff(edges) > LONGEST_STEP_S).tolist():
        first_s, last_s = float(edges[place]), float(edges[place + 1])
        if last_s <= start_s or first_s >= end_s:
            continue
        lost = bool(missing[place] * period_s > 0.5 * (last_s - first_s))
        anew = bool(0 < place < len(time_s) and missing[place] < 0)
        found.append(Break(topic, max(first_s, start_s), min(last_s, end_s), lost, anew))
    return found


def joined(breaks: Iterable[Break], *, lost: bool) -> tuple[tuple[float, float], ...]:
    """Return the intervals [s] of the losses (`lost`) or of the silences of several topics; overlaps are joined."""
    spans: list[tuple[float, float]] = []
    for first, last in sorted((one.start_s, one.end_s) for one in breaks if one.lost is lost):
        if spans and first <= spans[-1][1]:
            spans[-1] = (spans[-1][0], max(last, spans[-1][1]))
        else:
            spans.append((first, last))
    return tuple(spans)


def sent_of(recording: RecordingSource) -> dict[tuple[str, str], int]:
    """Return the number of messages that each publisher announced at its end, by topic and source; the last one counts.

    A publisher that ended has at least an entry for its events.
    """
    events = recording.select(lambda channel: channel.topic == END_TOPIC and channel.via == "direct")
    counts: dict[tuple[str, str], int] = {}
    for message, fields in readable(events, recording.left_out):
        if (sent := read_end(fields)) is None:
            continue
        counts.setdefault((END_TOPIC, message.src), 0)
        # Counts of forwarded messages are not those of their publishers.
        counts |= {key: count for key, count in sent.items() if key[1] == message.src}
    return counts


def running_of(recording: RecordingSource, hand: Mapping[str, npt.NDArray[np.generic]]) -> npt.NDArray[np.intp]:
    """Return the indices of the hand's samples in the last session of a recording; fewer than two if none ran.

    Args:
        recording: The recording.
        hand: Columns `session_s`, `seq` and `t_ns` of haptic/state, shape (n,).
    """
    events = recording.select(
        lambda channel: (
            channel.topic == "session/event" and channel.via == "direct" and name_of(channel.src) == name_of(LAUNCHER)
        )
    )
    reports = [(event.publish_ns, fields["data"]) for event, fields in readable(events, recording.left_out)]
    starts_ns, ends_ns = ([at_ns for at_ns, data in reports if key in data] for key in ("duration_s", "interrupted"))
    return last_session(hand["session_s"], hand["seq"], hand["t_ns"], starts_ns, ends_ns)


class SessionEnds(NamedTuple):
    """State of a recording at the two ends of its session.

    cut: sentences on the missing parts of the operator's force profile at either end. is_cut: True if the recording
    ends within the profile. silent_s: time for which the recording continues after the hand fell silent during its
    profile [s]; None if it does not.
    """

    cut: tuple[str, ...] = ()
    is_cut: bool = False
    silent_s: float | None = None


def ends_of(
    recording: RecordingSource, hand: Mapping[str, npt.NDArray[np.generic]], running: npt.NDArray[np.intp]
) -> SessionEnds:
    """Return the parts of the operator's force profile that a recording lacks at either end.

    A silent hand is no loss: its numbers begin with 0 or continue from an earlier sample, or the recorder continues
    without it.

    Args:
        recording: The recording.
        hand: Columns `session_s`, `seq`, `t_ns` and `log_ns` of haptic/state, shape (n,).
        running: The result of `running_of`, at least two indices.
    """
    src = next(channel.src for channel in recording.channels if channel.channel_topic == HAND)
    if src in replayed_sources(recording):
        # Both ends of a replayed hand were chosen by the operator.
        return SessionEnds()
    cut: list[str] = []
    first, last = int(running[0]), int(running[-1])
    session_s, seq = np.asarray(hand["session_s"], dtype=np.float64), np.asarray(hand["seq"], dtype=np.int64)
    if session_s[first] > _LATE_START_S and first == 0 and seq[0] > 0:
        cut.append(f"the recording begins {session_s[0]:.3f} s after the operator's force profile")
    if last < session_s.size - 1 or (END_TOPIC, src) in sent_of(recording) or session_s[last] < 0.0:
        return SessionEnds(tuple(cut))
    further_s = 1e-9 * (recording.span_ns[1] - int(hand["log_ns"][last]))
    if further_s > _GOES_ON_S and recording.closed:
        return SessionEnds(tuple(cut), silent_s=further_s)
    length_s = float(session_s[first]) + 1e-9 * (int(hand["t_ns"][last]) - int(hand["t_ns"][first]))
    cut.append(f"the recording ends within the operator's force profile, {length_s:.3f} s after its start")
    return SessionEnds(tuple(cut), is_cut=True)


def cut_off(recording: RecordingSource) -> tuple[str, ...]:
    """Return sentences on the parts of its last session that a recording lacks at either end.

    Empty if there is no session, or if the recording has no scenario.
    """
    has_session = "scenario.yaml" in recording.attachments and any(
        channel.channel_topic == HAND for channel in recording.channels
    )
    if not has_session or not _may_be_cut(recording):
        return ()
    hand = recording.columns(HAND, ("session_s", "seq", "t_ns", "log_ns"))
    running = running_of(recording, hand)
    return ends_of(recording, hand, running).cut if running.size > 1 else ()


def _may_be_cut(recording: RecordingSource) -> bool:
    """Return whether a force profile runs in the first or last sample of the hand; only then must all be read."""
    newest = recording.newest_before(END_OF_TIME, lambda channel: channel.channel_topic == HAND)
    ends = [*islice(recording.messages((HAND,)), 1), *newest.values()]
    return any(fields["session_s"] >= 0.0 for _, fields in readable(ends, recording.left_out)) or not ends
