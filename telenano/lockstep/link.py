"""The link of the lockstep loop: when each signal reaches the other side, known before the loop runs.

What happens to a message depends on its number and the time it is sent, not on its content. The hand sends at every
tick and the slave answers at once what it takes, so both directions can be computed beforehand by the link's own
engine (`DirectionEngine.fates`), and the loop merely merges arrivals. Readers take the newest message only: what was
overtaken or came twice is dropped here as the bus drops it. Of messages that arrive together, at the end of a slot or
of an outage that holds them, the loop takes the newest one that was sent, and there is one answer to them.
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
# When messages arrive [ns], and which of them each one is, by the times at which they are sent [ns].
Crossing = Callable[[Times], tuple[Times, Times]]

FORWARD_TOPIC = "teleop/forward"
BACKWARD_TOPIC = "teleop/backward"
# about the size of a teleop message on the wire; it matters only where the link has a finite rate
MESSAGE_BYTES = 300


class Schedule(NamedTuple):
    """Arrivals at the other side, in the order of time.

    forward_ns: at the slave [ns]; forward_of: the tick of the hand's sample each one carries; backward_ns: at the
    master [ns]; backward_of: the forward arrival each one answers, the last of those that come
    together; ticks: length of the run; window: a power of two, more than are ever between a sending and the arrival
    that it leads to.
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
        """Compute the arrivals of a run of `ticks` samples, one every period_s [s], over a link that starts with it.

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
        """Return the arrivals of a run of `ticks` samples, one every period_ns [ns], over two directions.

        Each direction is called once, with the times at which its messages are sent [ns], and returns when those that a
        reader takes arrive, in the order of time [ns], and which message each one is: its place among those sent.

        Args:
            forward: The direction of the signals of the hand.
            backward: The direction of the answers, of which there is one to all that come together.
            ticks: The number of samples.
            period_ns: The time between two samples [ns].
        """
        forward_ns, forward_of = forward(np.arange(ticks, dtype=np.int64) * period_ns)
        answered = last_together(forward_ns)
        backward_ns, answer = backward(forward_ns[answered])
        return schedule_from(forward_ns, forward_of, backward_ns, answered[answer], ticks, period_ns)

    @staticmethod
    def newest(times_ns: Times, numbers: Times) -> tuple[Times, Times]:
        """Return the arrivals, in the order of time, that a reader of the newest takes: none late and none twice."""
        newest_before = np.maximum.accumulate(np.concatenate([[-1], numbers]))[:-1]
        kept = numbers > newest_before
        return times_ns[kept], numbers[kept]


def last_together(times_ns: Times) -> Times:
    """Return the places of the arrivals that no other one comes together with later in the order [ns]."""
    return np.flatnonzero(np.diff(times_ns, append=-1))


def schedule_from(
    forward_ns: Times, forward_of: Times, backward_ns: Times, backward_of: Times, ticks: int, period_ns: int
) -> Schedule:
    """Return the schedule of known arrivals, in the order of time; the fields of `Schedule` say what is what."""
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
    """Return when messages of one direction arrive, and which message each one is, as a reader takes them.

    A constant delay, with losses or without, is the common case of a map. Messages keep their order then, so that only
    the losses need to be drawn: the result is the same (tested).
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
    # a message with flipped bits is refused by its reader, as a rule: it counts as lost
    released = [(fate.release_ns, fate.seq) for fate in fates if fate.release_ns is not None and not fate.corrupted]
    released.sort()
    if play_out:
        buffer = PlayOut()
        released = [(buffer.release_ns(int(sent_ns[seq]), at_ns), seq) for at_ns, seq in released]
        released.sort()
    pairs = np.array(released, dtype=np.int64).reshape(-1, 2)
    return Schedule.newest(pairs[:, 0], pairs[:, 1])
