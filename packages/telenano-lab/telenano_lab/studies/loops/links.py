"""The links of the studies: with two directions alike, or with an uneven flow of signals."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from telenano.lockstep import Schedule
from telenano.settings import LinkSettings

Times = npt.NDArray[np.int64]

# The kinds of an uneven flow of signals; `uneven_ns` describes them.
Uneven = Literal["slots", "outages", "bursts", "sawtooth"]


def uneven_ns(sent_ns: Times, kind: Uneven, size_ns: int) -> Times:
    """Return the times at which a link with an uneven flow releases signals [ns].

    Args:
        sent_ns: The times at which they are sent [ns].
        kind: slots: signals are released together at the end of each slot; outages: for a fifth of the time the link
            holds signals, and releases them together at the end; bursts: like slots, but one after another within a
            tenth of the time; sawtooth: the delay rises with time and falls back, so that signals are overtaken.
        size_ns: The length of a slot, an outage, a pause or a tooth [ns].
    """
    phase_ns = sent_ns % (5 * size_ns if kind == "outages" else size_ns)
    if kind == "sawtooth":
        return np.asarray(sent_ns + phase_ns)
    released = sent_ns - phase_ns + size_ns
    if kind == "bursts":
        released += phase_ns // 10
    return np.asarray(np.where(phase_ns < size_ns, released, sent_ns))


def uneven_schedule(round_trip_s: float, kind: Uneven, size_s: float, ticks: int, period_s: float) -> Schedule:
    """Return the arrivals over a link with the same uneven flow in both directions (`uneven_ns`); times in [s]."""
    period_ns, one_way_ns, size_ns = round(period_s * 1e9), round(0.5e9 * round_trip_s), round(size_s * 1e9)

    def crossed(sent_ns: Times) -> tuple[Times, Times]:
        released = uneven_ns(sent_ns, kind, size_ns) + one_way_ns
        order = np.argsort(released, kind="stable")
        return Schedule.newest(released[order], order)

    return Schedule.over(crossed, crossed, ticks, period_ns)


def direction_of(one_way_s: float, jitter_s: float, loss: float, burst: float | None = None) -> dict[str, object]:
    """Return the settings of one direction that differ from their defaults.

    Args:
        one_way_s: The delay of the direction [s].
        jitter_s: The half-width of its uniform random part [s].
        loss: The share of the messages lost, 0..1.
        burst: The mean number of messages lost in a row (E. N. Gilbert, Bell System Technical Journal 39, 1960); None
            if losses are independent.
    """
    direction: dict[str, object] = {"delay_s": one_way_s}
    if jitter_s != 0.0:
        direction["jitter"] = {"scale_s": jitter_s, "distribution": "uniform"}
    if burst is not None and 0.0 < loss < 1.0:
        # The channel is in the bad state for the share `loss` of the time, and each stay there is `burst` messages long
        # on average.
        direction["gilbert_elliott"] = {"p": min(loss / (1.0 - loss) / burst, 1.0), "r": 1.0 / burst}
    elif loss != 0.0:
        direction["loss"] = {"probability": loss}
    return direction


def symmetric_link(
    round_trip_s: float, jitter_s: float, loss: float, seed: int, burst: float | None = None
) -> LinkSettings:
    """Return a link with equal directions, each with half of the round trip [s]; other arguments as `direction_of`.

    Raises:
        ConfigError: A value is out of range; the message names its key.
    """
    direction = direction_of(0.5 * round_trip_s, jitter_s, loss, burst)
    return LinkSettings.of({"seed": seed, "forward": direction, "backward": direction})
