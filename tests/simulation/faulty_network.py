"""The network between the machines of a rig in virtual time: the fate of each message that crosses it.

Topics of which readers use only the newest message cross as datagrams, which may be lost, doubled, late or damaged. All
other messages cross as a stream: it keeps its order, waits while the network is cut, and is lost with its connection
after a long cut.
"""

import random
from bisect import bisect_left
from typing import Any, NamedTuple

# Length of a cut after which the connection of a stream is given up, and its waiting messages are lost [s].
STREAM_S = 5.0
# Time after which a stream sends lost data again [s].
AGAIN_S = 0.2
# Capacity of the queue in front of a narrow line [s].
QUEUE_S = 1.0
# A queue stands if, for this time, its least wait rises by no more than `SAME_S` from one half to the other [s].
STOOD_S = 0.04
SAME_S = 0.0035
WAYS = ("forward", "backward")


class Arrival(NamedTuple):
    """A copy that arrives: the time since it was sent [ns], and whether it is damaged."""

    after_ns: int
    damaged: bool = False


class Way:
    """One direction of the network."""

    def __init__(self, seed: int, name: str, delay_s: float) -> None:
        """Begin without a fault; the seed determines all random draws."""
        self._dice = random.Random(f"network {seed} {name}")
        self.delay_s = delay_s
        self._line: dict[str, float] = {}
        self._line_until_s = self._cut_until_s = self._narrow_until_s = self._free_s = -1.0
        self._cut_since_s = 0.0
        self._bytes_per_s = 0.0
        # Times at which messages were sent over the narrow line, and their waits [s].
        self._waits: list[tuple[float, float]] = []

    def spoil(self, event: dict[str, Any], now_s: float) -> None:
        """Lose, double, delay or damage datagrams for a time, as the event says."""
        self._line, self._line_until_s = event, now_s + event["for_s"]

    def cut(self, now_s: float, for_s: float) -> None:
        """Let nothing through for a time [s]."""
        if now_s >= self._cut_until_s:
            self._cut_since_s = now_s
        self._cut_until_s = max(self._cut_until_s, now_s + for_s)

    def narrow(self, now_s: float, for_s: float, bytes_per_s: float) -> None:
        """Limit the rate [bytes/s] for a time [s]."""
        self._bytes_per_s, self._narrow_until_s, self._free_s = bytes_per_s, now_s + for_s, now_s

    def stood(self) -> list[tuple[float, float]]:
        """Return the waits of queues that stood: did not grow for `STOOD_S`, with the end of that time [s].

        Nobody can tell such a queue from a longer line by the times of the messages.
        """
        waits, stood = self._waits, []
        for begin, (at_s, _) in enumerate(waits):
            middle, end = (bisect_left(waits, (at_s + part * STOOD_S,)) for part in (0.5, 1.0))
            first, then = ([wait_s for _, wait_s in part] for part in (waits[begin:middle], waits[middle:end]))
            if then and min(then) <= min(first) + SAME_S:
                stood.append((at_s + STOOD_S, min(first + then)))
        return stood

    def arrivals(self, now_s: float, size_bytes: int, *, is_stream: bool) -> list[Arrival]:
        """Return the copies of a message that arrive; empty if it is lost."""
        after_s = self.delay_s
        if now_s < self._narrow_until_s:
            self._free_s = max(self._free_s, now_s) + size_bytes / self._bytes_per_s
            after_s += self._free_s - now_s
            if self._free_s - now_s > QUEUE_S:
                self._free_s -= size_bytes / self._bytes_per_s
                if not is_stream:
                    return []
            self._waits.append((now_s, self._free_s - now_s))
        if now_s < self._cut_until_s:
            if not is_stream or self._cut_until_s - self._cut_since_s > STREAM_S:
                return []
            after_s += self._cut_until_s - now_s + AGAIN_S
        line = self._line if now_s < self._line_until_s else {}
        if not line:
            return [Arrival(round(1e9 * after_s))]
        draw = self._dice.random
        after_s += line["jitter_s"] * draw()
        if is_stream:
            return [Arrival(round(1e9 * (after_s + AGAIN_S * (draw() < line["loss"]))))]
        if draw() < line["loss"]:
            return []
        after_s += 0.02 * (draw() < line["reorder"])
        copies = [Arrival(round(1e9 * after_s), draw() < line["corrupt"])]
        if draw() < line["duplicate"]:
            copies.append(Arrival(round(1e9 * (after_s + 0.015 * draw()))))
        return copies
