"""The link of the lockstep loop: the arrival times of all signals, computed before the loop runs.

The fate of a message depends on its number and time of sending, not on its content. The hand sends at every tick and
the slave answers every received signal at once, so the link's own engine (`DirectionEngine.fates`) can compute both
directions in advance, and the loop only merges arrivals. Readers use only the newest message: overtaken and repeated
ones are dropped here, as on the bus. Among messages that arrive together, at the end of a slot or of an outage that
holds them, the loop uses the newest one that was sent, and there is one answer to all of them.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.link.direction import DirectionEngine
from telenano.link.fate import Direction
from telenano.settings.link_settings import DirectionSettings, LinkSettings
from telenano.timing.play_out import PlayOut

Times = npt.NDArray[np.int64]
# Function of the times of sending [ns] that returns the times of arrival [ns], and the number of each arrived message.
Crossing = Callable[[Times], tuple[Times, Times]]

FORWARD_TOPIC = "teleop/forward"
BACKWARD_TOPIC = "teleop/backward"
# Approximate size of a teleop message on the wire [bytes]; it matters only if the link has a finite rate.
MESSAGE_BYTES = 300


class Schedule(NamedTuple):
    """Arrivals at the other side, in the order of time.

    forward_ns: times of arrival at the slave [ns]; forward_of: the tick of the hand's sample that each one carries;
    backward_ns: times of arrival at the master [ns]; backward_of: index of the forward arrival that each one answers,
    the last of those that come together; ticks: length of the run; window: a power of two, greater than the number of
    messages between any sending and its arrival.
    """

    forward_ns: Times
    forward_of: Times
    backward_ns: Times
    backward_of: Times
    ticks: int
    window: int

    @classmethod
    def of(
        cls, settings: LinkSettings, ticks: int, period_s: float, folder: Path = Path(), *, play_out: bool = False
    ) -> "Schedule":
        """Compute the arrivals of a run over a link that starts at the same time.

        Args:
            settings: The settings of the link.
            ticks: The number of samples.
            period_s: The time between two samples [s].
            folder: The folder of the files that the settings name.
            play_out: Whether each direction ends in a buffer that keeps the delay nearly constant.
        """
        period_ns = round(period_s * 1e9)
        return cls.over(
            lambda sent_ns: _arrivals(settings, "forward", FORWARD_TOPIC, sent_ns, folder, play_out=play_out),
            lambda sent_ns: _arrivals(settings, "backward", BACKWARD_TOPIC, sent_ns, folder, play_out=play_out),
            ticks,
            period_ns,
        )

    @staticmethod
    def over(forward: Crossing, backward: Crossing, ticks: int, period_ns: int) -> "Schedule":
        """Return the arrivals of a run over two directions, given as functions.

        Each function is called once, with the times at which its messages are sent [ns]. It returns the arrival times
        of those that a reader uses, in the order of time [ns], and the index of each among the messages sent.

        Args:
            forward: The direction of the signals of the hand.
            backward: The direction of the answers; signals that arrive together have one answer.
            ticks: The number of samples.
            period_ns: The time between two samples [ns].
        """
        forward_ns, forward_of = forward(np.arange(ticks, dtype=np.int64) * period_ns)
        answered = last_together(forward_ns)
        backward_ns, answer = backward(forward_ns[answered])
        return schedule_from(forward_ns, forward_of, backward_ns, answered[answer], ticks, period_ns)

    @staticmethod
    def newest(times_ns: Times, numbers: Times) -> tuple[Times, Times]:
        """Return the arrivals that a reader of the newest message uses; the arrivals must be in the order of time."""
        newest_before = np.maximum.accumulate(np.concatenate([[-1], numbers]))[:-1]
        kept = numbers > newest_before
        return times_ns[kept], numbers[kept]


def last_together(times_ns: Times) -> Times:
    """Return the index of the last arrival of each group with equal times [ns]; the times must be in order."""
    return np.flatnonzero(np.diff(times_ns, append=-1))


def schedule_from(
    forward_ns: Times, forward_of: Times, backward_ns: Times, backward_of: Times, ticks: int, period_ns: int
) -> Schedule:
    """Return the schedule of known arrivals, in the order of time; `Schedule` explains the arguments."""
    behind = [
        forward_ns // period_ns - forward_of,
        np.searchsorted(forward_ns, backward_ns, side="right") - backward_of,
    ]
    longest = max((int(lag.max(initial=0)) for lag in behind), default=0)
    return Schedule(
        forward_ns=forward_ns,
        forward_of=forward_of,
        backward_ns=backward_ns,
        backward_of=backward_of,
        ticks=ticks,
        window=1 << (longest + 1).bit_length(),
    )


def _arrivals(
    settings: LinkSettings, way: Direction, topic: str, sent_ns: Times, folder: Path, *, play_out: bool
) -> tuple[Times, Times]:
    """Return times [ns] and indices of the messages of one direction that a reader uses, in the order of arrival.

    A constant delay, with or without losses, is the common case in a map. Messages then keep their order, so only the
    losses need to be drawn: the result is the same (tested).
    """
    direction: DirectionSettings = getattr(settings, way)
    plain = DirectionSettings(delay_s=direction.delay_s)
    lossy = plain.model_copy(update={"loss": direction.loss, "gilbert_elliott": direction.gilbert_elliott})
    if direction.model_dump() == lossy.model_dump():
        kept = np.arange(len(sent_ns), dtype=np.int64)
        if direction.model_dump() != plain.model_dump():
            kept = kept[~np.array(DirectionEngine(way, settings, 0).draw_losses(topic, len(sent_ns)), np.bool_)]
        return sent_ns[kept] + round(direction.delay_s * 1e9), kept
    fates = DirectionEngine.fates(settings, way, topic, sent_ns.tolist(), MESSAGE_BYTES, folder=folder)
    # A reader usually refuses a message with flipped bits, so it counts as lost.
    released = [(fate.release_ns, fate.seq) for fate in fates if fate.release_ns is not None and not fate.corrupted]
    released.sort()
    if play_out:
        buffer = PlayOut()
        released = [(buffer.release_ns(int(sent_ns[seq]), at_ns), seq) for at_ns, seq in released]
        released.sort()
    pairs = np.array(released, dtype=np.int64).reshape(-1, 2)
    return Schedule.newest(pairs[:, 0], pairs[:, 1])
