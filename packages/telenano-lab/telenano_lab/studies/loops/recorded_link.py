"""The link of a recording for the lockstep loop: the true losses and delays of a session's messages.

Over a random link the bus is one draw of the losses, and the same seed gives lockstep another draw, because the session
starts at another message. The recording has the ground truth of every message that crossed the link (`link/fates`), so
lockstep can run over that same draw; remaining differences are then due to the bus and not to the link.
"""

from pathlib import Path

import numpy as np

from telenano.lockstep import Schedule
from telenano.recording import Recording, last_force_profile
from telenano.wire import RecordingError
from telenano_lab.studies.loops.links import Times


def recorded_schedule(path: Path, settle: int, ticks: int, period_s: float) -> Schedule:
    """Return the arrivals of the last session of a recording.

    Args:
        path: The recording.
        settle: The ticks of the hand before the session.
        ticks: The ticks of the whole run.
        period_s: The period of the hand [s].

    Raises:
        RecordingError: Something is missing in the file; the message names the file and what is missing.
    """
    recording = Recording(path)
    period_ns = round(period_s * 1e9)
    hand = recording.columns("haptic/state", ("t_ns", "session_s", "step_s"))
    running = last_force_profile(hand["session_s"], hand["t_ns"])
    if not running.size:
        raise RecordingError(f"{path}: the operator's force profile never ran in it")
    # Each sample states the periods since the one before, which gives its tick, however late it was.
    stamps, tick_of = hand["t_ns"], np.cumsum(np.round(hand["step_s"] / period_s)).astype(np.int64)
    first = running[0]
    tick_of += settle + round(hand["session_s"][first] / period_s) - tick_of[first]
    # The grid follows the sample that was least late.
    origin_ns = int((stamps - tick_of * period_ns)[running].min())

    forward_ns, forward_hand_ns = _crossed(recording, "forward", "teleop/forward")
    backward_ns, backward_hand_ns = _crossed(recording, "backward", "teleop/backward")
    forward_ns, forward_of = _within(forward_ns - origin_ns, _ticks(forward_hand_ns, stamps, tick_of), ticks)
    # No message arrives before its tick.
    forward_ns = np.maximum(forward_ns, forward_of * period_ns)
    # An answer belongs to the forward message of the same sample.
    answered_tick = _ticks(backward_hand_ns, stamps, tick_of)
    backward_ns, answered_tick = _within(backward_ns - origin_ns, answered_tick, ticks)
    place = np.searchsorted(forward_of, answered_tick)
    is_recorded = place < len(forward_of)
    is_recorded[is_recorded] = forward_of[place[is_recorded]] == answered_tick[is_recorded]

    def answers(sent_ns: Times) -> tuple[Times, Times]:
        # Forward messages that arrive together have one answer.
        times_ns, answered = Schedule.newest(
            backward_ns[is_recorded], np.searchsorted(sent_ns, forward_ns[place[is_recorded]])
        )
        # An answer comes after its forward message.
        return np.maximum(times_ns, sent_ns[answered]), answered

    return Schedule.over(lambda sent_ns: (forward_ns, forward_of), answers, ticks, period_ns)


def _ticks(hand_ns: Times, stamps: Times, tick_of: Times) -> Times:
    """Return the ticks of samples of the hand by their stamps [ns]; -1 for a sample that is not in the recording."""
    place = np.minimum(np.searchsorted(stamps, hand_ns), len(stamps) - 1)
    return np.where(stamps[place] == hand_ns, tick_of[place], -1)


def _crossed(recording: Recording, direction: str, topic: str) -> tuple[Times, Times]:
    """Return the sorted times at which the link released a topic's messages, and the stamps of their samples [ns]."""
    crossings = []
    for message in recording.messages(("link/fates",)):
        fates = message.fields()
        if fates["direction"] != direction:
            continue
        crossings += [
            (fate["arrived_ns"] + fate["delay_ns"], fate["seq"])
            for fate in fates["fates"]
            if fate["topic"] == topic and not fate["dropped"] and not fate["corrupted"]
        ]
    if not crossings:
        raise RecordingError(f"{recording.path}: link/fates has no {topic} that crossed the link")
    sent = recording.columns(topic, ("seq", "hand_t_ns"))
    order = np.argsort(sent["seq"], kind="stable")
    seqs, hand_ns = sent["seq"][order], sent["hand_t_ns"][order]
    released = np.array(sorted(crossings), dtype=np.int64)
    # Messages that crossed before the recorder had connected, or after its last message, belong to no session.
    released = released[(released[:, 1] >= seqs[0]) & (released[:, 1] <= seqs[-1])]
    place = np.searchsorted(seqs, released[:, 1])
    if not (seqs[place] == released[:, 1]).all():
        raise RecordingError(f"{recording.path}: lacks messages of {topic} that crossed the link")
    return released[:, 0], np.asarray(hand_ns[place], dtype=np.int64)


def _within(times_ns: Times, tick_of: Times, ticks: int) -> tuple[Times, Times]:
    """Return the messages of the run that were not overtaken, because readers use the newest sample only."""
    inside = (tick_of >= 0) & (tick_of < ticks)
    return Schedule.newest(times_ns[inside], tick_of[inside])
