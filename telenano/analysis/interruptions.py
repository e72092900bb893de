"""What interrupted the loop of a session: processes that ended, or sent nothing, a tip that was held, a hand let go.

A source that sends nothing for a while, and goes on with its numbers, has lost no message (`telenano.recording.silence`
tells it from a loss). A tip is held, and a hand let go, where no command came within the deadline of its guard. Both
continue by themselves as soon as commands come again, so that no mode of a device shows it any more when the hold of
the hand is over. The law is not to blame for what moves then: `telenano.analysis.holds` judges it by what it did
before.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

InterruptionKind = Literal["process_ended", "source_silent", "tip_held", "hand_let_go"]
# the reason that the instrument gives where it holds the tip for want of commands, and the hand's beginning of its own
DEADLINE = "command_deadline"
_HAND_DEADLINE = "no command within the deadline"
# A report of a device belongs to what it did at most this long before or after [s].
REPORTED_WITHIN_S = 0.2


class Interruption(NamedTuple):
    """A time in which the loop was open, or a process was away: from when to when in the session [s], and why."""

    kind: InterruptionKind
    start_s: float
    end_s: float
    reason: str

    @property
    def starved(self) -> bool:
        """Whether a device went without commands, which is the fault of the network, a node or the machine."""
        return self.kind == "tip_held" or self.reason.startswith(_HAND_DEADLINE)


class ModeReport(NamedTuple):
    """What a device reported of its mode: when in the session [s], the mode, and why."""

    time_s: float
    mode: str
    reason: str


def interruptions_of(
    kind: InterruptionKind,
    time_s: npt.NDArray[np.float64],
    is_open: npt.NDArray[np.bool_],
    reports: Sequence[ModeReport],
    restarts: Iterable[int] = (),
) -> list[Interruption]:
    """Return each stretch in which a device was held or let go, but for one that the series begins with.

    A tip that is held because somebody asked for it is no interruption.

    Args:
        kind: What the stretches are.
        time_s: The times of the device's samples [s], shape (n,).
        is_open: Whether the device was held, or let go, at those times.
        reports: The device's reports of modes held or let go.
        restarts: The indices of the first samples of processes that were started again, which begin with nothing.
    """
    restarted, interruptions = set(restarts), []
    edges = np.flatnonzero(np.diff(is_open, prepend=False, append=False))
    for first, after in edges.reshape(-1, 2).tolist():
        if first == 0 or first in restarted:
            continue
        begins_s, ends_s = float(time_s[first]), float(time_s[min(after, len(time_s) - 1)])
        near = [report for report in reports if abs(report.time_s - begins_s) <= REPORTED_WITHIN_S]
        reason = min(near, key=lambda report: abs(report.time_s - begins_s)).reason if near else ""
        if kind == "hand_let_go" or reason in (DEADLINE, ""):
            interruptions.append(
                Interruption(kind, begins_s, ends_s, reason or (DEADLINE if kind == "tip_held" else ""))
            )
    return interruptions


def in_words(interruptions: Sequence[Interruption]) -> str:
    """Return a sentence on all interruptions of a stretch, with the first of each kind by its time; empty for none."""
    clauses = []
    for kind in ("process_ended", "source_silent", "tip_held", "hand_let_go"):
        of_kind = [one for one in interruptions if one.kind == kind]
        # each source that was silent has a clause of its own
        groups = dict.fromkeys(one.reason if kind == "source_silent" else "" for one in of_kind)
        clauses += [_clause(kind, [one for one in of_kind if one.reason == group or not group]) for group in groups]
    return "; ".join(clauses)


def _clause(kind: str, interruptions: Sequence[Interruption]) -> str:
    first, times = interruptions[0], "once" if len(interruptions) == 1 else f"{len(interruptions)} times"
    if kind == "process_ended":
        more = f", and {len(interruptions) - 1} more processes of the rig ended" if len(interruptions) > 1 else ""
        return f"at {first.start_s:.3f} s {first.reason}{more}"
    if kind == "source_silent" and len(interruptions) == 1:
        return f"{first.reason} from {first.start_s:.3f} s to {first.end_s:.3f} s"
    longest_ms = 1e3 * max(one.end_s - one.start_s for one in interruptions)
    when = f"{'' if len(interruptions) == 1 else 'first '}at {first.start_s:.3f} s, for {longest_ms:.0f} ms" + (
        " at the longest" if len(interruptions) > 1 else ""
    )
    if kind == "source_silent":
        return f"{first.reason} {times}, {when}"
    if kind == "tip_held":
        return f"the tip was held {times} because no command came ({DEADLINE}), {when}"
    why = Counter(one.reason for one in interruptions).most_common(1)[0][0]
    return f"the hand was let go {times}, {when}" + (f" ({why})" if why else "")
