"""Datagrams that the holder of a machine's key can send and none of our ends would; a seed gives the same contents."""

import random
from collections.abc import Sequence
from dataclasses import dataclass

from telenano.testing import Frames
from telenano_wide_area.datagram.body import (
    ASKING_TRAIN,
    CARRIES,
    MOST_SAMPLE_BYTES,
    NUMBERS,
    REPORT,
    SAMPLE,
    TRAIN,
    mark,
    packed,
    short_report,
)
from telenano_wide_area.datagram.replay_window import WINDOW
from telenano_wide_area.datagram.sealing import Sealer

MOST = 2**64 - 1
# A jump of the number beyond the window that a sender can have reached now and then.
NEXT = 5000
# The causes under which an end may reject datagrams of a holder of a key, besides those of strangers.
CAUSES = {"malformed", "time", "count", "ahead", "replayed", "forged", "truncated", "oversized", "unknown_key", "key"}


@dataclass
class Datagrams:
    """Makes datagrams that are properly sealed; `topics` are those that cross in the sender's direction."""

    seed: str
    now_ns: int
    topics: Sequence[str]

    def __post_init__(self) -> None:
        self.random = random.Random(self.seed)
        self._frames = Frames(self.seed, self.now_ns)

    def sealed(self, sealer: Sealer, now_ns: int) -> bytes:
        """Return a datagram in which number, report and samples may each be extreme or broken."""
        own = sealer.number
        sealer.number = self._number(own)
        datagram = sealer.seal(self._report(now_ns) + self._samples())
        # A sender that continued from an older or a refused number would send nothing more that is opened.
        sealer.number = sealer.number if own < sealer.number <= own + NEXT + 1 else own + 1
        return datagram

    def _number(self, own: int) -> int:
        rng = self.random
        if rng.random() < 0.94:
            return own
        near = (own + WINDOW - 1, own + WINDOW, own + WINDOW + 1, max(0, own - WINDOW), max(0, own - 1))
        far = (own + NEXT, own + 10**9, 2**40, 2**62, 2**63 - 1, 2**63, MOST - 1, 0)
        return rng.choice(near if rng.random() < 0.5 else far)

    def _report(self, now_ns: int) -> bytes:
        rng = self.random
        times = [self._extreme(now_ns) if rng.random() < 0.1 else now_ns for _ in range(3)]
        counts = [self._extreme(10**4) if rng.random() < 0.1 else rng.randrange(10**4) for _ in range(2)]
        if rng.random() < 0.9:
            counts.sort(reverse=True)
        if rng.random() < 0.2:
            return short_report(times[0] % 2**63)
        return REPORT.pack(*times, *counts)

    def _extreme(self, usual: int) -> int:
        choices = (0, 1, MOST, MOST - 1, 2**63, 2**63 - 1, 2**62, 2**62 - 1, 2**61, usual + 10**9, usual + 10**17)
        return min(self.random.choice(choices), MOST)

    def _samples(self) -> bytes:
        rng, body = self.random, b""
        for _ in range(rng.choice((0, 1, 1, 2, 5))):
            topic = rng.choice(self.topics)
            payload = self._frames.extreme(topic) if rng.random() < 0.5 else self._frames.broken(topic)[-1]
            body += packed(topic, payload[:MOST_SAMPLE_BYTES])
        if rng.random() < 0.1:
            body += mark(rng.choice((TRAIN, ASKING_TRAIN, CARRIES)), rng.randbytes(rng.choice((0, 1, 8, 400))))
        if rng.random() < 0.1:
            body += SAMPLE.pack(rng.choice((*NUMBERS.values(), 3, 255)), rng.choice((0, 1, 65535)))
        return body[: MOST_SAMPLE_BYTES + rng.choice((0, 0, 200))]
