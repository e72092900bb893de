"""The network between the machines of a rig in virtual time: what becomes of each message that crosses it.

What a reader takes the newest of crosses as datagrams, which may be lost, doubled, late or damaged. All else crosses as
a stream: it keeps its order, waits while the network is cut, and is lost with its connection where that takes long.
"""

import random
from typing import Any, NamedTuple

# A stream whose connection has carried nothing for so long is given up, and what waited in it is lost [s].
STREAM_S = 5.0
# A stream sends what was lost again after this time [s].
AGAIN_S = 0.2
# A queue in front of a narrow line holds so much [s].
QUEUE_S = 1.0
WAYS = ("forward", "backward")


class Arrival(NamedTuple):
    """A copy that arrives: how much later than it was sent [ns], and whether it is damaged."""

    after_ns: int
    damaged: bool = False


class Way:
    """One direction of the network."""

    def __init__(self, seed: int, name: str, delay_s: float) -> None:
        """Begin without a fault; every draw comes from the seed."""
        self._dice = random.Random(f"network {seed} {name}")
        self.delay_s = delay_s
        self._line: dict[str, float] = {}
        self._line_until_s = self._cut_until_s = self._narrow_until_s = self._free_s = -1.0
        self._cut_since_s = 0.0
        self._bytes_per_s = 0.0

    def spoil(self, event: dict[str, Any], now_s: float) -> None:
        """Lose, double, delay or damage datagrams for a while."""
        self._line, self._line_until_s = event, now_s + event["for_s"]

    def cut(self, now_s: float, for_s: float) -> None:
        """Let nothing through for a while."""
        if now_s >= self._cut_until_s:
            self._cut_since_s = now_s
        self._cut_until_s = max(self._cut_until_s, now_s + for_s)

    def narrow(self, now_s: float, for_s: float, bytes_per_s: float) -> None:
        """Carry no more than a rate for a while."""
        self._bytes_per_s, self._narrow_until_s, self._free_s = bytes_per_s, now_s + for_s, now_s

    def arrivals(self, now_s: float, size_bytes: int, *, is_stream: bool) -> list[Arrival]:
        """Return the copies of a message that arrive; none where it is lost."""
        after_s = self.delay_s
        if now_s < self._narrow_until_s:
            self._free_s = max(self._free_s, now_s) + size_bytes / self._bytes_per_s
            after_s += self._free_s - now_s
            if self._free_s - now_s > QUEUE_S:
                self._free_s -= size_bytes / self._bytes_per_s
                if not is_stream:
                    return []
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
