"""The holds of a recorded session: where the hand's force stands still, and what the tip's force does meanwhile."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from analysis.modes import LEAST_SAMPLES
from analysis.verdict import Circumstances, Kind, judge

Series = npt.NDArray[np.float64]

# shorter holds end before a slow oscillation of the loop (about 5 Hz) has shown what becomes of it
SHORTEST_HOLD_S = 0.5
# the first part of a hold shows the answer to the step before it
SETTLING_SHARE = 0.2
_HAND_STEADY_SHARE = 0.01
# of the greatest force: below it the hand has let go
_PRESSING_SHARE = 0.05
# a session that swings and drifts swings: what a person meets first, and what does not end by itself
_WORST_FIRST: tuple[Kind, ...] = (
    *("diverged", "guarded", "limit_cycle", "contact_lost", "wrong_force", "drifting", "cannot_say", "released"),
    "stable",
)


class Hold(NamedTuple):
    """A stretch of constant hand force, and what became of alpha_f F_s in it: see `analysis.verdict.Verdict`."""

    start_s: float
    end_s: float
    hand_force_n: float
    verdict: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str


class Instrument(NamedTuple):
    """What the instrument says at the tip's times: whether it follows commands, and whether the tip touches."""

    following: npt.NDArray[np.bool_]
    in_contact: npt.NDArray[np.bool_]


def constant_stretches(time_s: Series, force_n: Series, tolerance_n: float) -> list[tuple[float, float]]:
    """Return the stretches [s] of at least SHORTEST_HOLD_S over which a force stays within a tolerance of its start."""
    stretches: list[tuple[float, float]] = []
    first = 0
    for index in range(1, len(time_s) + 1):
        if index < len(time_s) and abs(force_n[index] - force_n[first]) <= tolerance_n:
            continue
        if time_s[index - 1] - time_s[first] >= SHORTEST_HOLD_S:
            stretches.append((float(time_s[first]), float(time_s[index - 1])))
        first = index
    return stretches


def judge_holds(
    hand_time_s: Series,
    hand_force_n: Series,
    tip_time_s: Series,
    scaled_force_n: Series,
    tip: Instrument | None = None,
) -> list[Hold]:
    """Judge every hold of a session, each without its first fifth, as the studies judge theirs.

    Small is what is small beside the greatest force of the hand in the session, so that the holds share one measure; a
    trend has to be a factor of two to be believed, because messages on a real bus come when they come. Where the hand
    presses, the tip has to press with the same force, and to touch.

    Parameters: times [s], F_m [N] at the hand's times, alpha_f F_s [N] at the tip's times, and what the instrument says
    then; one dimension each.
    """
    greatest = float(np.abs(hand_force_n).max(initial=0.0))
    holds = []
    for start, end in constant_stretches(hand_time_s, hand_force_n, _HAND_STEADY_SHARE * greatest):
        judged = (tip_time_s >= start + SETTLING_SHARE * (end - start)) & (tip_time_s < end)
        if greatest == 0.0 or judged.sum() < LEAST_SAMPLES:
            continue
        force = float(np.interp(0.5 * (start + end), hand_time_s, hand_force_n))
        presses = abs(force) > _PRESSING_SHARE * greatest
        known = Circumstances(noisy=True, expected_n=force if presses else None)
        if tip is not None:
            lost = judged & ~tip.following
            later = judged & (tip_time_s >= 0.5 * (start + end))
            if lost.any():
                judged = judged & (tip_time_s < tip_time_s[int(np.argmax(lost))])
            touching = float(tip.in_contact[later].mean()) if presses and later.any() else None
            known = known._replace(guarded=bool(lost.any()), touching=touching)
        verdict = judge(tip_time_s[judged], scaled_force_n[judged], greatest, known)
        holds.append(Hold(start, end, force, *verdict))
    return holds


def verdict_of(holds: list[Hold]) -> tuple[Kind, str]:
    """Return the verdict on a session and the reason: those of its worst hold, or of the last where all are stable."""
    if not holds:
        return "cannot_say", "the hand never stood still for long enough"
    # of several that are as bad the first
    decisive = min(holds, key=lambda hold: _WORST_FIRST.index(hold.verdict))
    decisive = holds[-1] if decisive.verdict == "stable" else decisive
    return decisive.verdict, decisive.reason
