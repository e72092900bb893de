"""The links of the studies: two directions that are alike, and links that let signals out in no even flow."""

from typing import Literal

import numpy as np
import numpy.typing as npt

from telenano.lockstep import Schedule
from telenano.settings import LinkSettings

Times = npt.NDArray[np.int64]

# How a link lets signals out in no even flow; `uneven_ns` says what each is.
Uneven = Literal["slots", "outages", "bursts", "sawtooth"]


def uneven_ns(sent_ns: Times, kind: Uneven, size_ns: int) -> Times:
    """Return when each signal is let out of a link that is uneven in time [ns].

    Args:
        sent_ns: When each is sent [ns].
        kind: slots: at the end of each slot, together; outages: a fifth of the time is an outage that holds, and all
            come together at its end; bursts: as slots, but one after another in a tenth of the time; sawtooth: the
            delay rises by the time that goes by, and falls back, so that signals are overtaken.
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
    """Return the arrivals over a link whose two directions are uneven alike: see `uneven_ns`; times in [s]."""
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
        burst: The mean number of messages that are lost in a row (E. N. Gilbert, Bell System Technical Journal 39,
            1960); None if each is lost by itself.
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
    """Return a link whose two directions are alike, each with half of the round trip [s]; the rest as `direction_of`.

    Raises:
        ConfigError: A value is out of range; the message names its key.
    """
    direction = direction_of(0.5 * round_trip_s, jitter_s, loss, burst)
    return LinkSettings.of({"seed": seed, "forward": direction, "backward": direction})
