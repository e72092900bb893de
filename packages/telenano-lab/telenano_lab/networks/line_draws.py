"""Draw the delays that the link gives to the messages of a fitted line, without its engine for each message.

The models are those of the link (`services/delay_node`), drawn in the same order from the same streams, so that the
delays equal those of `DirectionEngine.fates`. The engine spends most of its time on a heap of releases and the record
of each message, which a fit does not need.
"""

import math
from collections.abc import Sequence
from itertools import accumulate, pairwise

import numpy as np
import numpy.typing as npt
from scipy import special

from telenano.link import DirectionEngine, Outages, stream
from telenano.settings import LinkSettings
from telenano_lab.networks.line_sources import Column

Times = npt.NDArray[np.int64]
# The settings of a direction that a fitted line, or its twin without memory, has.
_PARTS = {"delay_s", "jitter", "order", "queue", "outage", "gilbert_elliott", "loss"}


def delays_ns(settings: LinkSettings, topic: str, times_ns: Sequence[int], size_bytes: int) -> Column:
    """Return the forward delays of messages of a topic that arrive at these times [ns]; nan for a lost one.

    A line with further settings than a fitted one is run through the engine itself.

    Raises:
        ConfigError: A file of the settings cannot be used.
    """
    way, arrived_ns = settings.forward, np.asarray(times_ns, dtype=np.int64)
    if not len(arrived_ns):
        return np.empty(0)
    held_ns = _held_ns(settings, arrived_ns, size_bytes) if _is_fitted(settings) else None
    if held_ns is None:
        fates = DirectionEngine.fates(settings, "forward", topic, times_ns, size_bytes)
        return np.array([np.nan if fate.dropped else fate.delay_ns for fate in fates if fate.copy == 0])
    engine = DirectionEngine("forward", settings, int(arrived_ns[0]))
    lost = np.array(engine.draw_losses(topic, len(arrived_ns)), dtype=bool)
    usual_ns = np.maximum(0.0, np.rint(round(way.delay_s * 1e9) + _jitter_ns(settings, topic, arrived_ns)))
    released_ns = (held_ns + usual_ns)[~lost]
    if way.order != "any":
        released_ns = np.maximum.accumulate(released_ns)
    delay_ns = np.full(len(arrived_ns), np.nan)
    delay_ns[~lost] = released_ns - arrived_ns[~lost]
    return delay_ns


def _is_fitted(settings: LinkSettings) -> bool:
    way = settings.forward
    jitter, outage = way.jitter, way.outage
    plain = bool(jitter.quantiles) and jitter.distribution == "table" and jitter.correlation == 0.0
    return (
        not way.topics
        and way.model_fields_set <= _PARTS
        and (plain or not jitter.scale_s)
        and not outage.schedule
        and (outage.mean_up_s is None or outage.mode == "hold")
    )


def _held_ns(settings: LinkSettings, arrived_ns: Times, size_bytes: int) -> Times | None:
    """Return the time at which each message may continue [ns]; None if a stall holds more than the queue can."""
    ready_ns = arrived_ns.copy()
    outage, queue = settings.forward.outage, settings.forward.queue
    if outage.mean_up_s is None:
        return ready_ns
    draw = stream(settings.seed, "forward", "shared", "outage", "")
    outages = Outages(outage, int(arrived_ns[0]), draw)
    at = 0
    while at < len(arrived_ns):
        end_ns = outages.end_ns(int(arrived_ns[at]))
        # If there is no stall now, the newest one that was drawn is the next.
        after = int(np.searchsorted(arrived_ns, outages.state.random[-1][0] if end_ns is None else end_ns))
        if end_ns is not None:
            ready_ns[at:after] = end_ns
            held = after - at
            if held > (queue.limit_messages or math.inf) or held * size_bytes > (queue.limit_bytes or math.inf):
                return None
        at = after
    return ready_ns


def _jitter_ns(settings: LinkSettings, topic: str, arrived_ns: Times) -> Column:
    jitter = settings.forward.jitter
    if not jitter.scale_s:
        return np.zeros(len(arrived_ns))
    shares, values = zip(*jitter.quantiles, strict=True)
    if jitter.correlation_time_s:
        uniform = _lasting(settings, arrived_ns)
    else:
        draw = stream(settings.seed, "forward", topic, "original", "jitter")
        uniform = np.array([draw.positive() for _ in range(len(arrived_ns))])
    return np.asarray(jitter.scale_s * 1e9 * np.interp(uniform, shares, values))


def _lasting(settings: LinkSettings, arrived_ns: Times) -> Column:
    """Return the uniform number of each message for a correlation over time, as `JitterSource` draws it."""
    jitter = settings.forward.jitter
    share = jitter.second_correlation_share
    scores = _scores(settings, "jitter", jitter.correlation_time_s, arrived_ns)
    if share > 0.0:
        second = _scores(settings, "second jitter", jitter.second_correlation_time_s, arrived_ns)
        scores = math.sqrt(1.0 - share) * scores + math.sqrt(share) * second
    return np.asarray(special.ndtr(scores))


def _scores(settings: LinkSettings, name: str, time_s: float, arrived_ns: Times) -> Column:
    jitter = settings.forward.jitter
    steps = arrived_ns // round(time_s * 1e9 / jitter.DRAWS_IN_CORRELATION_TIME)
    behind = np.diff(steps, prepend=steps[0] - 1)
    jumped = behind > jitter.LONGEST_WALK
    behind[jumped] = 1
    place = np.cumsum(behind) - 1
    draw = stream(settings.seed, "forward", "shared", name, "")
    fresh = special.ndtri(np.array([draw.positive() for _ in range(int(place[-1]) + 1)])).tolist()
    rho = math.exp(-1.0 / jitter.DRAWS_IN_CORRELATION_TIME)
    gain = math.sqrt(1.0 - rho * rho)
    scores: list[float] = []
    # After a long pause nothing of the previous score is left.
    for first, end in pairwise([0, *place[jumped].tolist(), len(fresh)]):
        scores += accumulate(fresh[first:end], lambda score, new: rho * score + gain * new)
    chosen: Column = np.asarray(scores)[place]
    return chosen
