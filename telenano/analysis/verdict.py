"""Verdict on the motion of a loop: whether it dies out, goes on, or grows.

    from telenano.analysis.verdict import judge
    judge(time_s, force_n, hand_force_n=1.0).kind          # "limit_cycle"

`judge` takes the force at the tip in one episode (`telenano.analysis.holds`): contact under a constant force with the
loop closed. `telenano.analysis.decision` decides from the fits of parts of the motion (`telenano.analysis.motion_fit`)
and from its envelope (`telenano.analysis.envelope`). The result is a value (`telenano.analysis.findings`), which is put
into a sentence last (`telenano.analysis.verdict_sentences`).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.decision import decide
from telenano.analysis.findings import Cause as Cause
from telenano.analysis.findings import Finding as Finding
from telenano.analysis.findings import Kind as Kind
from telenano.analysis.measured_noise import Noise
from telenano.analysis.modes import LEAST_SAMPLES
from telenano.analysis.motion_fit import Motion
from telenano.analysis.read_out import even
from telenano.analysis.read_out import noise_of as noise_of
from telenano.analysis.read_out import reach_of as reach_of
from telenano.analysis.read_out import rounding_of as rounding_of
from telenano.analysis.verdict_sentences import sentence
from telenano.analysis.verdict_thresholds import ERROR_SHARE as ERROR_SHARE
from telenano.analysis.verdict_thresholds import LEAST_CHANGE as LEAST_CHANGE
from telenano.analysis.verdict_thresholds import LEAST_TURNS as LEAST_TURNS
from telenano.analysis.verdict_thresholds import LIKELY_ERRORS as LIKELY_ERRORS
from telenano.analysis.verdict_thresholds import ONE_SIDED_CHANGE as ONE_SIDED_CHANGE
from telenano.analysis.verdict_thresholds import SMALL_SHARE as SMALL_SHARE
from telenano.analysis.verdict_thresholds import SURE_ERRORS as SURE_ERRORS
from telenano.analysis.verdict_thresholds import WAY_TRIPS as WAY_TRIPS

Series = npt.NDArray[np.float64]


class Verdict(NamedTuple):
    """Verdict on a motion.

    growth_per_s: growth of the mode that decides [1/s], None if nothing moves; peak_to_peak_n: size of the motion that
    decides, at its end, without noise [N]; noise_n: standard deviation of the read-out's noise [N]; reason: the verdict
    in words; rest_from_s: start of the rest [s], None without one; cause: the reason as a value.
    """

    kind: Kind
    growth_per_s: float | None
    peak_to_peak_n: float
    noise_n: float
    reason: str
    rest_from_s: float | None = None
    cause: Cause | None = None


def judge(
    time_s: Series,
    force_n: Series,
    hand_force_n: float,
    rest_n: float | None = None,
    step_n: float | None = None,
    *,
    free: Noise | None = None,
    answers_n: float = 0.0,
) -> Verdict:
    """Judge the motion of an episode.

    Args:
        time_s: The times of the samples [s], shape (n,), rising.
        force_n: alpha_f F_s at those times [N], shape (n,).
        hand_force_n: The hand's greatest force [N], > 0, which is the measure of large and small.
        rest_n: The force at which the law rests [N], None if the law does not state it: an approach to it is stable.
        step_n: The step of a read-out that rounds [N], as `rounding_of` finds it in the whole recording, 0 if it does
            not round; None finds it in the episode, where a motion between two values looks like rounding.
        free: The noise of the free tip, at the same rate of samples; None if it is not known.
        answers_n: The size from peak to peak of what may answer the trembling of the hand [N].

    Raises:
        ValueError: The hand's force is not positive.
    """
    if not hand_force_n > 0.0:
        raise ValueError(f"the hand's force in a hold is {hand_force_n} N, it must be > 0 N")
    finite = np.isfinite(force_n)
    size = float(np.ptp(force_n[finite])) if finite.any() else 0.0
    if not finite.all():
        return _in_words(Finding("diverged", Cause.NOT_A_NUMBER, size), 0.0)
    if len(time_s) < LEAST_SAMPLES:
        return _in_words(Finding("cannot_say", Cause.FEW_SAMPLES, size, samples=len(time_s)), 0.0)
    values, period_s = even(time_s, force_n)
    step = rounding_of(values) if step_n is None else step_n
    noise = noise_of(values, step)
    if noise > ERROR_SHARE * max(hand_force_n, float(np.ptp(values))):
        least_n = ERROR_SHARE * hand_force_n
        return _in_words(Finding("cannot_say", Cause.HIDDEN_BY_NOISE, needs_noise_n=least_n), noise)
    motion = Motion(values, period_s, float(time_s[-1]), hand_force_n, step, noise, rest_n, free, answers_n)
    return _in_words(decide(motion), noise)


def _in_words(found: Finding, noise_n: float) -> Verdict:
    """Return a finding as a verdict, with its sentence."""
    growth, size_n = found.growth_per_s, found.size_n
    return Verdict(found.kind, growth, size_n, noise_n, sentence(found, noise_n), found.rest_from_s, found.cause)
