"""Cycles of a loop on a grid of deadlines: the time of each answer, the late cycles, and the confidence in their rate.

A cycle begins at its deadline and ends when its answer arrives, or the answer of a later cycle, which then takes its
place. So a deadline that a loop skipped has a cycle as well, which ends with a later one: a loop that stood still for 5
ms was late five times, however few samples it took meanwhile.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv

from telenano.recording.reader import Recording

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
# A cycle is late if it ends more than this after its usual time [ms].
LATE_MS = 1.0
# The last samples of a session that may lack an answer only because the session has ended [cycles].
_NO_ANSWER_YET = 20
_NONE_NS = np.iinfo(np.int64).max


class Cycle(NamedTuple):
    """A cycle that a loop took: its deadline, its beginning, and the arrival of its answer, on one clock [ns]."""

    due_ns: int
    begun_ns: int
    ended_ns: int


class Samples(NamedTuple):
    """The samples of a hand in their order, each array of shape (samples,).

    `periods`: the number of periods of the grid that a sample stands for, 1 unless deadlines were missed. `sampled_ns`:
    the time of the sample. `answered_ns`, `arrived_ns`: the stamp of the sample whose answer was in force, 0 before the
    first answer, and the time at which that answer arrived.
    """

    periods: Ints
    sampled_ns: Ints
    answered_ns: Ints
    arrived_ns: Ints


class Late(NamedTuple):
    """Late cycles: the length of each run of consecutive late cycles, and the number of all cycles measured."""

    runs: tuple[int, ...]
    cycles: int

    @property
    def in_million(self) -> float:
        """Return the number of late cycles in a million."""
        return 1e6 * sum(self.runs) / self.cycles if self.cycles else math.nan

    def __add__(self, other: object) -> "Late":
        """Return the late cycles of two runs of a benchmark together."""
        if not isinstance(other, Late):
            return NotImplemented
        return Late(self.runs + other.runs, self.cycles + other.cycles)


class Interval(NamedTuple):
    """A rate in a million cycles, and the interval that contains the true rate in 95 of 100 measurements."""

    rate: float
    low: float
    high: float


def responses_ms(cycles: Sequence[Cycle], period_ns: int) -> Floats:
    """Return for each deadline, from the first to the last, the time until an answer was there [ms].

    Args:
        cycles: The cycles that the loop took, in the order of their deadlines, without the skipped ones.
        period_ns: The period of the grid.

    Returns:
        Shape (deadlines,), the skipped deadlines included.
    """
    due_ns, _, ended_ns = np.array(cycles, np.int64).reshape(-1, 3).T
    if not due_ns.size:
        return np.empty(0)
    number = np.round((due_ns - due_ns[0]) / period_ns).astype(np.int64)
    ends_ns = np.full(int(number.max()) + 1, _NONE_NS)
    np.minimum.at(ends_ns, number, ended_ns)
    ends_ns = np.minimum.accumulate(ends_ns[::-1])[::-1]
    grid_ns = due_ns[0] + period_ns * np.arange(ends_ns.size)
    return np.asarray((ends_ns - grid_ns) * 1e-6, np.float64)


def later_than(found_ms: Floats, limit_ms: float) -> Late:
    """Return the cycles that took longer than a limit [ms], in runs."""
    is_late = np.concatenate(([False], found_ms > limit_ms, [False])).astype(np.int8)
    edges = np.diff(is_late)
    runs = np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)
    return Late(tuple(int(length) for length in runs), int(found_ms.size))


def runs_in_million(late: Late, confidence: float = 0.95) -> Interval:
    """Return the number of runs of late cycles in a million cycles, with its interval.

    Runs and not cycles come by chance and independently, so the interval is the exact one for a Poisson count (Garwood,
    Biometrika 28, 437, 1936). Without any run it ends at 3.7 runs.
    """
    count, tail = len(late.runs), 0.5 * (1.0 - confidence)
    low = float(gammaincinv(count, tail)) if count else 0.0
    high = float(gammaincinv(count + 1, 1.0 - tail))
    scale = 1e6 / late.cycles if late.cycles else math.nan
    return Interval(count * scale, low * scale, high * scale)


def cycles_of(folder: Path, period_ns: int, begin_ns: int = 0, end_ns: int = _NONE_NS) -> list[Cycle]:
    """Return the cycles of a recorded session with deadlines within a time [ns], on a grid of this period [ns]."""
    recording = Recording(folder / "session.mcap")
    rows, expected = [], 0
    for message in recording.messages(["haptic/state"]):
        fields = message.fields()
        if fields["session_s"] >= 0.0:
            # A sample that was not recorded stood for one period.
            missing = max(0, message.seq - expected) if rows else 0
            expected = message.seq + 1
            periods = round(fields["step_s"] * 1e9 / period_ns) + missing
            rows.append((periods, message.publish_ns, fields["answered_t_ns"], fields["answered_at_ns"]))
    if not rows:
        return []
    sent = {message.fields()["hand_t_ns"]: message.publish_ns for message in recording.messages(["haptic/command"])}
    return matched(Samples(*np.array(rows, np.int64).T), sent, period_ns, begin_ns, end_ns)


def matched(
    samples: Samples, sent: Mapping[int, int], period_ns: int, begin_ns: int = 0, end_ns: int = _NONE_NS
) -> list[Cycle]:
    """Return the cycles of a hand whose deadlines are within a time [ns].

    Each sample tells the number of periods that it stands for, so the grid includes the skipped deadlines; its phase is
    that of the earliest sample. A cycle ends when the hand receives its answer. The hand does not show an answer that
    another one overtook between two ticks: such a cycle ends at the time of its command, plus the median time from
    there to the hand.

    Args:
        samples: The samples of the whole session.
        sent: The time at which the command that answers a sample was sent, by the stamp of the sample [ns].
        period_ns: The period of the grid [ns].
        begin_ns: The first deadline wanted [ns].
        end_ns: The last deadline wanted [ns].
    """
    number = np.cumsum(samples.periods)
    first_ns = int((samples.sampled_ns - period_ns * number).min())
    arrived: dict[int, int] = {}
    for stamp, at_ns in zip(samples.answered_ns.tolist(), samples.arrived_ns.tolist(), strict=True):
        # The hand shows an answer until it receives another.
        if stamp:
            arrived.setdefault(stamp, at_ns)
    queues_ns = [at_ns - sent[stamp] for stamp, at_ns in arrived.items() if stamp in sent]
    queue_ns = round(float(np.median(queues_ns))) if queues_ns else 0
    next_on_time = np.append(samples.periods[1:] == 1, False).tolist()
    last_ns = min(end_ns, int(samples.sampled_ns[-1]) - _NO_ANSWER_YET * period_ns)
    found: list[Cycle] = []
    for each, stamp, on_time in zip(number.tolist(), samples.sampled_ns.tolist(), next_on_time, strict=True):
        due_ns, at_ns = first_ns + period_ns * each, arrived.get(stamp)
        if at_ns is None and on_time and stamp in sent:
            at_ns = sent[stamp] + queue_ns
        if at_ns is not None and begin_ns <= due_ns <= last_ns:
            found.append(Cycle(due_ns, stamp, at_ns))
    if found and (left := (last_ns - found[-1].due_ns) // period_ns) > 0:
        # A cycle without an answer by then lasts until the next answer, or until the end.
        due_ns = found[-1].due_ns + period_ns * left
        later = (at_ns for stamp, at_ns in arrived.items() if stamp >= due_ns)
        found.append(Cycle(due_ns, due_ns, min(later, default=int(samples.sampled_ns[-1]))))
    return found
