"""Find what disturbed a trial, as opposed to effects of its condition, from the ground truth of the link.

A stalled process, an emergency stop or a restarted node invalidates a trial. A device that held because it received
nothing is different: if the link held back, dropped or delayed messages that it had received, this is the condition
under study, and an outcome. `link/fates` has the true fate of every message, so nothing has to be guessed.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.wire import TOPICS

Times = npt.NDArray[np.float64]
# A node reports twice a second; one that sent nothing for this time counts as absent.
_SILENT_S = 3.0
# A device holds if nothing arrives within its deadline, and reports the hold within a period or two.
_SHARE = 0.5
_LOOK_BACK_S = 0.2
# A hold for one of these reasons means that nothing arrived in time; others, such as too much force, are outcomes.
STALE = ("command_deadline", "hold_expired", "no command within the deadline")
LOST = ("device_lost", "the device is lost")


class Passage(NamedTuple):
    """One direction of the link: sorted times [s] at which messages reached it, and at which undropped ones left it."""

    arrived_s: Times
    released_s: Times


class Hold(NamedTuple):
    """A device that ceased to follow commands: time [s], node and reason."""

    time_s: float
    node: str
    reason: str


class Evidence(NamedTuple):
    """The facts of a recorded trial; times [s] since its beginning.

    Args:
        duration_s: Planned duration.
        hand_s: The times of the hand's samples and the duration of each step, shape (n, 2).
        tip_s: The same for the instrument.
        forward: The direction from the hand to the tip.
        backward: The opposite direction.
        holds: Devices that ceased to follow.
        estops: Time of each node's first emergency stop.
        restarted: Nodes that were restarted or fell silent.
        faults: Errors that nodes reported.
        missing: Gaps of the recording, in sentences.
        quiet_s: The longest time for which the dead band may suppress signals.
    """

    duration_s: float
    hand_s: Times
    tip_s: Times
    forward: Passage
    backward: Passage
    holds: Sequence[Hold] = ()
    estops: Sequence[tuple[str, float]] = ()
    restarted: Sequence[str] = ()
    faults: Sequence[str] = ()
    missing: Sequence[str] = ()
    quiet_s: float = 0.0


def disturbances(evidence: Evidence, stall_s: float) -> list[str]:
    """Return the disturbances of a trial, in sentences; empty if only the condition acted.

    Args:
        evidence: The facts of the trial.
        stall_s: The longest stall of a process that is tolerated [s].
    """
    stalls = [
        *_stalls("the hand's device", evidence.hand_s, stall_s),
        *_stalls("the instrument", evidence.tip_s, stall_s),
        *_silences(evidence, stall_s),
    ]
    return [
        *(f"{node} was in emergency stop at {time_s:.2f} s" for node, time_s in evidence.estops),
        *stalls,
        # A hold after a stall is its consequence and needs no sentence of its own.
        *(() if stalls else _unexplained(evidence)),
        *(f"{hold.node} lost its device at {hold.time_s:.2f} s" for hold in _during(evidence, LOST)),
        *(f"{node} was started again or fell silent" for node in evidence.restarted),
        *evidence.faults,
        *(f"the recording is not whole: {text}" for text in evidence.missing),
    ]


def longest_gap(times_s: Times, begin_s: float, end_s: float) -> tuple[float, float]:
    """Return the longest gap between entries within an interval [s] and its beginning; the ends count as entries."""
    inside = times_s[(times_s > begin_s) & (times_s < end_s)]
    edges = np.concatenate(([begin_s], inside, [end_s]))
    gaps = np.diff(edges)
    place = int(np.argmax(gaps))
    return float(gaps[place]), float(edges[place])


def _stalls(what: str, steps_s: Times, stall_s: float) -> Iterable[str]:
    if not len(steps_s):
        yield f"{what} reported nothing"
        return
    longest = int(np.argmax(steps_s[:, 1]))
    time_s, step_s = steps_s[longest].tolist()
    if step_s > stall_s:
        yield f"{what} stood still for {1e3 * step_s:.0f} ms at {time_s:.2f} s"


def _silences(evidence: Evidence, stall_s: float) -> Iterable[str]:
    """Yield gaps in the messages that reached the link, which the link itself cannot cause."""
    allowed_s = stall_s + evidence.quiet_s
    gap_s, begin_s = longest_gap(evidence.forward.arrived_s, 0.0, evidence.duration_s)
    if gap_s > allowed_s:
        yield f"nothing of the hand reached the link for {1e3 * gap_s:.0f} ms at {begin_s:.2f} s"
    gap_s, begin_s = longest_gap(evidence.backward.arrived_s, 0.0, evidence.duration_s)
    if gap_s > allowed_s and not _link_was_silent(evidence.forward, begin_s, begin_s + gap_s, allowed_s):
        yield f"nothing of the tip reached the link for {1e3 * gap_s:.0f} ms at {begin_s:.2f} s"


def _during(evidence: Evidence, words: Sequence[str]) -> list[Hold]:
    """Return the holds within a trial whose reason contains one of the words."""
    return [
        hold
        for hold in evidence.holds
        if 0.0 <= hold.time_s <= evidence.duration_s and any(word in hold.reason for word in words)
    ]


def _unexplained(evidence: Evidence) -> Iterable[str]:
    """Yield holds for lack of commands although the link had delivered."""
    least_s = _SHARE * min(TOPICS[topic].deadline_s or 0.0 for topic in ("afm/command", "haptic/command"))
    for hold in _during(evidence, STALE):
        begin_s = hold.time_s - least_s / _SHARE - _LOOK_BACK_S
        ways = (evidence.forward, evidence.backward)
        if not any(_link_was_silent(way, begin_s, hold.time_s, least_s) for way in ways):
            yield f"{hold.node} held at {hold.time_s:.2f} s ({hold.reason}) although the link had delivered"


def _link_was_silent(way: Passage, begin_s: float, end_s: float, least_s: float) -> bool:
    """Return whether the link delivered nothing for a time although messages had reached it before."""
    gap_s, gap_begin_s = longest_gap(way.released_s, begin_s, end_s)
    if gap_s < least_s:
        return False
    arrived = way.arrived_s
    return bool(np.any((arrived > gap_begin_s - least_s) & (arrived < gap_begin_s + gap_s)))
