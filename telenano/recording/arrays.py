"""Time shifts of replayed nodes, and the part of a recording in which a force profile or a session ran."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.recording.messages import RecordedChannel, readable
from telenano.recording.multi_file import RecordingSource

Column = npt.NDArray[Any]

# Topics with at least this declared rate belong to the loop [Hz].
_FAST_HZ = 100.0
# So many older samples in a row come from a player that was set back; fewer are outliers.
_REWIND_RUN = 8
# Stamps that differ by more than this belong to different runs.
_REWIND_NS = 1_000_000_000
# A launcher reports a session late: it waits until the device has confirmed that its force profile runs.
_START_REPORT_NS = 2_000_000_000


def replayed_sources(recording: RecordingSource, *, newest: bool = False) -> set[str]:
    """Return the nodes that report in `node/health` that a player replays them; `newest` reads only the last reports.

    Messages that cannot be read are counted in `recording.left_out`.
    """

    def is_health(channel: RecordedChannel) -> bool:
        return channel.channel_topic == "node/health"

    last_ns = recording.span_ns[1] + 1
    health = recording.newest_before(last_ns, is_health).values() if newest else recording.select(is_health)
    return {message.src for message, fields in readable(health, recording.left_out) if fields["replay"]}


def replay_shifts(recording: RecordingSource, *, newest: bool = False) -> dict[str, int]:
    """Return for each replayed source the delay of its time stamps behind those of live nodes [ns].

    A rig that mixes a player with live nodes has old stamps beside new ones. The delay is the median of reception time
    minus send time. The dict is empty if no node of the loop was replayed or all were: the stamps then agree already.
    """
    replayed = replayed_sources(recording, newest=newest)
    fast = {c.src: c.channel_topic for c in recording.channels if c.via == "direct" and (c.rate_hz or 0.0) >= _FAST_HZ}
    if not replayed & set(fast) or set(fast) <= replayed:
        return {}
    shifts = {}
    for src in replayed & set(fast):
        times = recording.columns(fast[src], ("log_ns", "publish_ns"))
        shifts[src] = round(float(np.median(times["log_ns"] - times["publish_ns"])))
    return shifts


def in_step(t_ns: Column) -> npt.NDArray[np.bool_]:
    """Return a mask of the samples whose stamp [ns] agrees with its neighbours, shape (n,).

    Fewer than `_REWIND_RUN` stamps in a row that jump by more than a second and back are outliers and are masked out.
    Longer runs are kept: the clock was set, or a player was set back.
    """
    kept = np.ones(len(t_ns), dtype=np.bool_)
    stamps = t_ns.astype(np.int64)
    edges = [0, *(1 + np.flatnonzero(np.abs(np.diff(stamps)) > _REWIND_NS)).tolist(), len(t_ns)]
    runs = [(first, after) for first, after in pairwise(edges) if after > first]
    place = 0
    while place < len(runs) and len(runs) > 1:
        first, after = runs[place]
        before_ns = int(stamps[first]) - int(stamps[runs[place - 1][1] - 1]) if place else 0
        after_ns = int(stamps[runs[place + 1][0]]) - int(stamps[after - 1]) if place + 1 < len(runs) else 0
        # In the middle an outlier jumps there and back; at either end only a fall distinguishes it from a pause.
        is_apart = before_ns * after_ns < 0 if before_ns and after_ns else before_ns + after_ns < 0
        is_next_apart = not before_ns and place + 1 < len(runs) and _is_spike(stamps, runs, place + 1)
        if after - first < _REWIND_RUN and is_apart and not is_next_apart:
            kept[first:after] = False
            del runs[place]
            place = max(0, place - 1)
        else:
            place += 1
    return kept


def _is_spike(stamps: npt.NDArray[np.int64], runs: Sequence[tuple[int, int]], place: int) -> bool:
    """Return whether a short run of stamps jumps away from the run before it and the next run jumps back."""
    if place + 1 >= len(runs) or runs[place][1] - runs[place][0] >= _REWIND_RUN:
        return False
    away_ns = int(stamps[runs[place][0]]) - int(stamps[runs[place - 1][1] - 1])
    back_ns = int(stamps[runs[place + 1][0]]) - int(stamps[runs[place][1] - 1])
    return away_ns * back_ns < 0


def last_force_profile(session_s: Column, t_ns: Column) -> npt.NDArray[np.intp]:
    """Return the indices of the last run of the operator's force profile.

    A run begins where `session_s` falls while the send time continues, or where a player was set back. Messages that
    arrived after later ones are left out.

    Args:
        session_s: session_s of `haptic/state` [s], negative while no force profile runs, shape (n,).
        t_ns: Send times [ns], shape (n,).

    Returns:
        The indices, fewer than two when no force profile ran.
    """
    running = np.flatnonzero(session_s >= 0.0)
    old = t_ns[running] < np.maximum.accumulate(t_ns[running])
    while old.any():
        begins, ends = np.flatnonzero(np.diff(old, prepend=False, append=False)).reshape(-1, 2).T
        set_back_ns = t_ns[running[begins - 1]] - t_ns[running[begins]]
        rewinds = begins[(ends - begins >= _REWIND_RUN) & (set_back_ns > _REWIND_NS)]
        if not rewinds.size:
            running = running[~old]
            break
        running = running[rewinds[0] :]
        old = t_ns[running] < np.maximum.accumulate(t_ns[running])
    restarts = np.flatnonzero(np.diff(session_s[running]) < 0.0)
    return running[restarts[-1] + 1 :] if restarts.size else running


def last_session(
    session_s: Column, seq: Column, t_ns: Column, starts_ns: Sequence[int] = (), ends_ns: Sequence[int] = ()
) -> npt.NDArray[np.intp]:
    """Return the indices of the last session: the last force profile and the earlier runs of it that a crash cut off.

    If the process of a device dies during the force profile, its successor restarts the profile on command. That is
    the same session, unless a launcher has started another one since. Messages that the new process sent before the
    command, or before a launcher ended the session without one, also belong to the session.

    Args:
        session_s: session_s of `haptic/state` [s], negative while no force profile runs, shape (n,).
        seq: The seq of its messages, shape (n,).
        t_ns: The send times of its messages [ns], shape (n,).
        starts_ns: The times at which launchers reported that a session runs [ns].
        ends_ns: The times at which launchers reported that a session is over [ns].

    Returns:
        The indices, fewer than two when no force profile ran.
    """
    session = last_force_profile(session_s, t_ns)
    if session.size and (last := int(session[-1])) + 1 < len(seq) and _died(last, seq, t_ns):
        end_ns = min((end_ns for end_ns in ends_ns if end_ns > t_ns[last]), default=t_ns.max() + 1)
        after = _rising(np.arange(last + 1, len(seq)), t_ns)
        session = np.concatenate((session, after[t_ns[after] < end_ns]))
    while session.size and (first := int(session[0])) > 0:
        before = last_force_profile(session_s[:first], t_ns[:first])
        if not before.size or not _was_cut_off(int(before[-1]), first, seq, t_ns, starts_ns):
            break
        between = _rising(np.arange(before[-1] + 1, first), t_ns)
        session = np.concatenate((before, between[t_ns[between] < t_ns[first]], session))
    return session


def _died(last: int, seq: Column, t_ns: Column) -> bool:
    """Return whether the message after `last` is the first of a new process: seq restarts while the time continues."""
    return bool(seq[last + 1] <= seq[last] and t_ns[last + 1] > t_ns[last])


def _rising(places: npt.NDArray[np.intp], t_ns: Column) -> npt.NDArray[np.intp]:
    """Return the places without those of messages that arrived after later ones."""
    return places[t_ns[places] >= np.maximum.accumulate(t_ns[places])] if places.size else places


def _was_cut_off(last: int, first: int, seq: Column, t_ns: Column, starts_ns: Sequence[int]) -> bool:
    """Return whether the process died during a force profile and no launcher started a session before the next one."""
    is_restarted = any(t_ns[last] < start_ns < t_ns[first] + _START_REPORT_NS for start_ns in starts_ns)
    return _died(last, seq, t_ns) and not is_restarted
