"""Interruptions of the loop in a session: a process ended or was silent, the tip was held, or the hand was let go.

If a source sends nothing for a while and then continues its numbers, no message is lost (`telenano.recording.silence`
distinguishes this from a loss). A tip is held, and a hand let go, if no command came within the deadline of its guard.
Both continue by themselves as soon as commands come again, so at the end of a hold no mode of a device shows it. The
law is not to blame for motion during an interruption: `telenano.analysis.holds` judges it by the motion before.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

InterruptionKind = Literal["process_ended", "source_silent", "tip_held", "hand_let_go"]
# reason that the instrument states when it holds the tip for want of commands, and start of the reason of the hand
DEADLINE = "command_deadline"
_HAND_DEADLINE = "no command within the deadline"
# longest time between an action of a device and its report, before or after [s]
REPORTED_WITHIN_S = 0.2


class Interruption(NamedTuple):
    """A span in which the loop was open, or a process was away: start and end in the session [s], and the reason."""

    kind: InterruptionKind
    start_s: float
    end_s: float
    reason: str

    @property
    def starved(self) -> bool:
        """Whether a device received no commands, which is the fault of the network, a node or the machine."""
        return self.kind == "tip_held" or self.reason.startswith(_HAND_DEADLINE)


class ModeReport(NamedTuple):
    """A device's report of its mode: time in the session [s], mode, and reason."""

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
    """Return each stretch in which a device was held or let go, except one at the start of the series.

    A tip that is held on request is not interrupted.

    Args:
        kind: The kind of interruption of these stretches.
        time_s: The times of the device's samples [s], shape (n,).
        is_open: Whether the device was held, or let go, at those times, shape (n,).
        reports: The device's reports of modes held or let go.
        restarts: The indices of the first samples of restarted processes; a stretch at one of them is left out too.
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
    """Return a sentence on all interruptions of a stretch, with the time of the first of each kind; empty for none."""
    clauses = []
    for kind in ("process_ended", "source_silent", "tip_held", "hand_let_go"):
        of_kind = [one for one in interruptions if one.kind == kind]
        # Each silent source gets its own clause.
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
