"""What a recording lacks of the session that it is reported for."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.analysis.holds import LONGEST_STEP_S
from telenano.recording.arrays import replayed_sources
from telenano.recording.info import RecordingInfo
from telenano.recording.messages import readable
from telenano.recording.multi_file import RecordingSource
from telenano.wire.ends import END_TOPIC, read_end

# A recorder that received the hand from the start has its first sample long before this.
_LATE_START_S = 0.1

Spans = tuple[tuple[float, float], ...]


def cut_off(
    recording: RecordingSource, session_s: npt.NDArray[Any], running: npt.NDArray[np.intp], length_s: float
) -> list[str]:
    """Return in sentences what a recording lacks of the operator's force profile at either end.

    Args:
        recording: The recording that is judged.
        session_s: session_s of every haptic/state [s].
        running: The indices of the samples in the session.
        length_s: The time from the start of the force profile to the last of them [s].
    """
    hand = next(channel.src for channel in recording.channels if channel.channel_topic == "haptic/state")
    if hand in replayed_sources(recording):
        # The operator chose the beginning and the end of what is played.
        return []
    sentences = []
    first_s = float(session_s[running[0]])
    if first_s > _LATE_START_S:
        sentences.append(f"the recording begins {first_s:.3f} s after the operator's force profile")
    if running[-1] == session_s.size - 1 and not _has_ended(recording, hand):
        sentences.append(f"the recording ends within the operator's force profile, {length_s:.3f} s after its start")
    return sentences


def _has_ended(recording: RecordingSource, src: str) -> bool:
    events = recording.select(lambda channel: channel.topic == END_TOPIC and channel.src == src)
    return any(read_end(fields) is not None for _, fields in readable(events, recording.left_out))


def gaps(time_s: Iterable[npt.NDArray[np.float64]], end_s: float) -> Spans:
    """Return the spans [s] of a session in which some series has no sample, joined where they overlap.

    Args:
        time_s: The times of the samples of each series [s], in order.
        end_s: The end of the session [s].
    """
    spans: list[tuple[float, float]] = []
    for times in time_s:
        edges = np.concatenate(([0.0], times, [end_s]))
        wide = np.flatnonzero(np.diff(edges) > LONGEST_STEP_S)
        spans += [(float(edges[place]), float(edges[place + 1])) for place in wide]
    joined: list[tuple[float, float]] = []
    for first, last in sorted(spans):
        if joined and first <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(last, joined[-1][1]))
        else:
            joined.append((first, last))
    return tuple(joined)


def recording_facts(
    info: RecordingInfo, start_ns: int, missing: Sequence[str], odd: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the part of a summary on its recording; `complete` is whether nothing at all is missing.

    Args:
        info: What is known of the recording.
        start_ns: The start of the session, from which the times of the parts count [ns].
        missing: Sentences on what is missing besides those of `info`.
        odd: Sentences on what is odd besides those of `info`.
    """
    sentences = list(dict.fromkeys([*info.missing, *missing]))
    facts: dict[str, Any] = {
        "file": info.path,
        "complete": not sentences,
        "missing": sentences,
        "lost": info.lost,
        "messages": info.messages,
    }
    if info.odd or odd:
        facts["odd"] = [*info.odd, *odd]
    if info.parts:
        facts["parts"] = [
            {
                "file": Path(part.path).name,
                "begins_s": round((part.start_ns - start_ns) * 1e-9, 3),
                "ends_s": round((part.end_ns - start_ns) * 1e-9, 3),
                "pause_s": round(part.pause_s, 3),
                "messages": part.messages,
            }
            for part in info.parts
        ]
    return facts
