"""Decomposition of the loop's age, that of the force a hand feels, into its parts, from the stamps of messages.

Every message of the loop carries the stamp of the hand's sample from which it descends. The delay that the link adds on
purpose, and the least delay of the line between two machines, are known from link/delay; a recording of every datagram
also has the delay of each. The rest of a stage belongs to the node that sends next, and includes the jitter of the line
if the datagrams are unknown. The parts of a sample thus add up to its age by construction.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.timing.freshness import DelayHistory
from telenano.wire.nodes import site_of

Ints = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

# The messages that answer one sample of the hand, in order, each with the name of the part that ends when it is sent.
STAGES = {
    "teleop/forward": "law of the master",
    "afm/command": "law of the slave",
    "afm/state": "instrument",
    "teleop/backward": "law of the slave",
    "haptic/command": "law of the master",
}
# Names of the parts that are no stages.
DEVICE = "device of the hand"
QUEUE = "queue at the device"
TOGETHER = "laws and instrument"
WITH_JITTER = f"{TOGETHER}, and jitter of the line"
# Parts that begin at one site and end at the other: the clock offset leaves their split between directions uncertain.
ACROSS_CLOCKS = ("law of the slave", "law of the master", "line there", "line back", TOGETHER, WITH_JITTER)
WAYS = {"forward": "there", "backward": "back"}
_SLAVES = ("afm/command", "afm/state", "teleop/backward")
# Remaining uncertainty of the clocks of two machines [ns]; datagrams are further apart.
_CLOCKS_OPEN_NS = 200_000
# Share of the samples around a percentile over whose parts the mean is taken.
_BAND = 0.005
# Least number of samples for which parts are reported.
_LEAST_SAMPLES = 20
# Most samples that are kept.
_MOST_SAMPLES = 4000


class Part(NamedTuple):
    """A part of the age [s], for samples around the median and around the 99th percentile."""

    name: str
    p50_s: float
    p99_s: float


class Delay(NamedTuple):
    """Delay of one direction for each sample of the hand, shape (n,): added on purpose, and least of the line [ns]."""

    injected_ns: Ints
    line_ns: Ints


def split(passed_ns: Ints, topics: Sequence[str], delays: Mapping[str, Delay], device_s: Floats) -> dict[str, Floats]:
    """Return the parts of the age of each sample [s], by name; they add up to the age of the answer at the device.

    Args:
        passed_ns: For each sample its stamp, the send time of each topic that descends from it, and the arrival of the
            answer at the device, by the master's clock [ns]; shape (samples, topics + 2).
        topics: Those topics, in the order of `STAGES`; if some are missing, their parts are reported together.
        delays: The delays of the link, by direction.
        device_s: Age of each sample when it was stamped [s], shape (samples,).
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
                # Limit the delays, which are rounded to milliseconds, or may be reported after this message.
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
    """Return the line's delay of each message [ns], that of the first datagram sent when or after it was due.

    Args:
        due_ns: Time at which each message was sent or, with a delay of the link, due [ns]; shape (messages,).
        left_ns: Send time of each datagram that arrived, rising, by the same clock [ns]; shape (datagrams,).
        took_ns: Delay of each datagram [ns]; shape (datagrams,).
    """
    return np.asarray(took_ns[np.minimum(np.searchsorted(left_ns, due_ns - _CLOCKS_OPEN_NS), took_ns.size - 1)])


def _seconds(time_ns: Ints) -> Floats:
    return np.asarray(1e-9 * time_ns, np.float64)


def parts_of(split_s: Mapping[str, Floats]) -> list[Part]:
    """Return the parts for samples around the median and around the 99th percentile; the last one is the whole."""
    whole = np.sum(list(split_s.values()), axis=0)
    order = np.argsort(whole, kind="stable")
    half, places = max(1, round(0.5 * _BAND * len(whole))), [round(share * (len(whole) - 1)) for share in (0.5, 0.99)]
    bands = [order[max(0, place - half) : place + half + 1] for place in places]
    parts = [Part(name, *(float(values[band].mean()) for band in bands)) for name, values in split_s.items()]
    return [*parts, Part("whole", *(float(value) for value in np.percentile(whole, (50.0, 99.0))))]


class LoopAge:
    """Computes the parts of the loop's age for a running rig, from those of its messages that are passed in."""

    def __init__(self) -> None:
        self._sent: dict[str, dict[int, int]] = {topic: {} for topic in STAGES}
        self._answered: dict[int, int] = {}
        self._device: dict[int, float] = {}
        self._delays = {way: DelayHistory() for way in WAYS}
        self._line_ns = dict.fromkeys(WAYS, 0)
        self._ahead_ns = 0

    def take(self, topic: str, src: str, t_ns: int, fields: Mapping[str, Any]) -> None:
        """Add a message; of one that crosses the link, pass the original with its publisher's stamp `t_ns` [ns]."""
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
        """Return the parts for the samples answered since the last call; empty if there are too few."""
        topics = [topic for topic, sent in self._sent.items() if sent]
        keys = [key for key in self._answered if all(key in self._sent[topic] for topic in topics)]
        ages: list[Part] = []
        if len(keys) >= _LEAST_SAMPLES and topics:
            rows = [[key, *(self._sent[topic][key] for topic in topics), self._answered[key]] for key in keys]
            delays = {
                way: Delay(np.array([history.of(key) for key in keys]), np.full(len(keys), self._line_ns[way]))
                for way, history in self._delays.items()
            }
            device_s = np.array([self._device.get(key, 0.0) for key in keys])
            ages = parts_of(split(np.array(rows, np.int64), topics, delays, device_s))
        newest = max(keys) if ages else 0
        maps: list[dict[int, Any]] = [*self._sent.values(), self._answered, self._device]
        for kept in maps:
            for key in [key for number, key in enumerate(kept) if key <= newest or number < len(kept) - _MOST_SAMPLES]:
                del kept[key]
        return ages


def in_words(parts: Sequence[Part]) -> str:
    """Return a text on the largest part, such as `link there, on purpose: 20 of 42 ms`; empty without parts."""
    if len(parts) < 2:
        return ""
    largest = max(parts[:-1], key=lambda part: part.p50_s)
    return f"{largest.name}: {1e3 * largest.p50_s:.3g} of {1e3 * parts[-1].p50_s:.3g} ms"
