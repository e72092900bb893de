"""Where the age of what a hand feels comes from: the parts of the way of its samples, by the stamps of messages.

Every message of the loop carries the stamp of the sample of the hand that it descends from. What the link adds on
purpose, and the least that the line between two machines takes besides, are known from link/delay; a recording of
every datagram has what the line took of each. The rest of a stage is that of who sends next, and has the jitter of the
line in it where the datagrams are not known. So the parts of a sample add up to its age by construction.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.timing.freshness import DelayHistory
from telenano.wire.nodes import site_of

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

# The messages that answer one sample of the hand, in their order, and whose part it is until each is sent.
STAGES = {
    "teleop/forward": "law of the master",
    "afm/command": "law of the slave",
    "afm/state": "instrument",
    "teleop/backward": "law of the slave",
    "haptic/command": "law of the master",
}
DEVICE, QUEUE, TOGETHER = "device of the hand", "queue at the device", "laws and instrument"
WITH_JITTER = f"{TOGETHER}, and jitter of the line"
# These parts begin at one site and end at the other: the clocks leave open how much belongs to which way.
ACROSS_CLOCKS = ("law of the slave", "law of the master", "line there", "line back", TOGETHER, WITH_JITTER)
WAYS = {"forward": "there", "backward": "back"}
_SLAVES = ("afm/command", "afm/state", "teleop/backward")
# By so much the clocks of two machines may differ after they were compared [ns]; datagrams are further apart.
_CLOCKS_OPEN_NS = 200_000
# A share of the samples around a percentile, whose parts stand for it.
_BAND = 0.005
_LEAST_SAMPLES, _MOST_SAMPLES = 20, 4000


class Part(NamedTuple):
    """A part of the age [s], of the median sample and of the slow one at 99 %; the last part is the whole."""

    name: str
    p50_s: float
    p99_s: float


class Delay(NamedTuple):
    """What the link says of one way by sample of the hand: added on purpose, and the least of the line besides [ns]."""

    injected_ns: Ints
    line_ns: Ints


def split(passed_ns: Ints, topics: Sequence[str], delays: Mapping[str, Delay], device_s: Floats) -> dict[str, Floats]:
    """Return the parts of the age of each sample [s], by name; they add up to the age of the answer at the device.

    Args:
        passed_ns: Of each sample its stamp, when each topic that descends from it was sent, and when the answer reached
            the device, on the master's clock; shape (samples, topics + 2).
        topics: Those topics, in the order of `STAGES`; where some are not known, their parts are reported together.
        delays: What the link says, by direction.
        device_s: How old each sample was when it was stamped, shape (samples,).
    """
    order, ends = list(STAGES), ["", *topics]
    parts_s: dict[str, Floats] = {DEVICE: device_s}
    together = WITH_JITTER if any(delay.line_ns.any() for delay in delays.values()) else TOGETHER
    for number, topic in enumerate(topics):
        rest = passed_ns[:, number + 1] - passed_ns[:, number]
        first = order.index(ends[number]) + 1 if ends[number] else 0
        crossed = order[first : order.index(topic) + 1]
        for way, begins in (("forward", "afm/command"), ("backward", "haptic/command")):
            if begins in crossed and way in delays:
                # a delay is stated in whole milliseconds, and a message may have overtaken the one that stated it
                on_purpose = np.minimum(delays[way].injected_ns, np.maximum(rest, 0))
                line = np.minimum(delays[way].line_ns, np.maximum(rest - on_purpose, 0))
                rest = rest - on_purpose - line
                parts_s[f"link {WAYS[way]}, on purpose"], parts_s[f"line {WAYS[way]}"] = (
                    _seconds(on_purpose),
                    _seconds(line),
                )
        name = STAGES[topic] if len(crossed) == 1 else together
        parts_s[name] = _seconds(rest) + parts_s.get(name, 0.0)
    parts_s[QUEUE] = _seconds(passed_ns[:, -1] - passed_ns[:, -2])
    return parts_s


def took_from(due_ns: Ints, left_ns: Ints, took_ns: Ints) -> Ints:
    """Return what the line took of messages that were due at times [ns]: the first datagram that left then had them.

    Args:
        due_ns: When each was sent or, over a link with a delay, due; shape (messages,).
        left_ns: When each datagram that arrived had left, rising, on the same clock; shape (datagrams,).
        took_ns: What each of them took.
    """
    return np.asarray(took_ns[np.minimum(np.searchsorted(left_ns, due_ns - _CLOCKS_OPEN_NS), took_ns.size - 1)])


def _seconds(time_ns: Ints) -> Floats:
    return np.asarray(1e-9 * time_ns, np.float64)


def parts_of(split_s: Mapping[str, Floats]) -> list[Part]:
    """Return the parts of the samples around the median and around 99 %, and the whole as the last one."""
    whole = np.sum(list(split_s.values()), axis=0)
    order = np.argsort(whole, kind="stable")
    half, places = max(1, round(0.5 * _BAND * len(whole))), [round(share * (len(whole) - 1)) for share in (0.5, 0.99)]
    bands = [order[max(0, place - half) : place + half + 1] for place in places]
    parts = [Part(name, *(float(values[band].mean()) for band in bands)) for name, values in split_s.items()]
    return [*parts, Part("whole", *(float(value) for value in np.percentile(whole, (50.0, 99.0))))]


class LoopAge:
    """The age of the loop by its parts, of a rig that runs, from whatever of its messages is taken."""

    def __init__(self) -> None:
        self._sent: dict[str, dict[int, int]] = {topic: {} for topic in STAGES}
        self._answered: dict[int, int] = {}
        self._device: dict[int, float] = {}
        self._delays = {way: DelayHistory() for way in WAYS}
        self._line_ns = dict.fromkeys(WAYS, 0)
        self._ahead_ns = 0

    def take(self, topic: str, src: str, t_ns: int, fields: Mapping[str, Any]) -> None:
        """Take a message; of what crossed the link the original is to be taken, as its publisher stamped it."""
        if topic == "link/delay":
            self._delays[fields["direction"]].record(fields["hand_t_ns"], fields["delay_ns"])
            self._line_ns[fields["direction"]] = fields["transit_ns"]
            self._ahead_ns = fields["clock_ahead_ns"]
        elif topic == "haptic/state":
            if fields.get("sample_age_s") is not None:
                self._device[t_ns] = fields["sample_age_s"]
            if fields["answered_t_ns"] > 0:
                self._answered.setdefault(fields["answered_t_ns"], fields["answered_at_ns"])
        elif topic in self._sent and fields["hand_t_ns"] > 0:
            ahead_ns = self._ahead_ns if site_of(src) == "slave" else 0
            self._sent[topic].setdefault(fields["hand_t_ns"], t_ns - ahead_ns)

    def parts(self) -> list[Part]:
        """Return the parts of the samples that were answered since the last call; none of too few."""
        topics = [topic for topic, sent in self._sent.items() if sent]
        keys = [key for key in self._answered if all(key in self._sent[topic] for topic in topics)]
        found: list[Part] = []
        if len(keys) >= _LEAST_SAMPLES and topics:
            rows = [[key, *(self._sent[topic][key] for topic in topics), self._answered[key]] for key in keys]
            delays = {
                way: Delay(np.array([history.of(key) for key in keys]), np.full(len(keys), self._line_ns[way]))
                for way, history in self._delays.items()
            }
            device_s = np.array([self._device.get(key, 0.0) for key in keys])
            found = parts_of(split(np.array(rows, np.int64), topics, delays, device_s))
        newest = max(keys) if found else 0
        maps: list[dict[int, Any]] = [*self._sent.values(), self._answered, self._device]
        for kept in maps:
            for key in [key for number, key in enumerate(kept) if key <= newest or number < len(kept) - _MOST_SAMPLES]:
                del kept[key]
        return found


def in_words(parts: Sequence[Part]) -> str:
    """Return which part is the largest, such as `link there, on purpose: 20 of 42 ms`; empty without any."""
    if len(parts) < 2:
        return ""
    largest = max(parts[:-1], key=lambda part: part.p50_s)
    return f"{largest.name}: {1e3 * largest.p50_s:.3g} of {1e3 * parts[-1].p50_s:.3g} ms"
