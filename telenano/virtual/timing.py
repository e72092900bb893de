"""Random delays of a rig in virtual time, each from its own stream of random numbers, all from one seed."""

import random
from collections.abc import Callable
from dataclasses import dataclass

# low <= delay < high [ns]
Range = tuple[int, int]


@dataclass(frozen=True)
class Timing:
    """Delays of the rig [ns], each drawn uniformly from low <= delay < high, and the share of stalls.

    sending: from the start of a turn to a message; site: transit on a site; link: transit between the sites, None if
    the link is a node of its own; start: from the start of one node to that of the next; wake: lateness of a loop;
    recorder: from sending a message to its reception by the recorder. A share stall_share of the turns are 3 ms later.
    """

    sending: Range = (0, 20_000)
    site: Range = (10_000, 200_000)
    link: Range | None = None
    start: Range = (100_000, 5_000_000)
    wake: Range = (0, 60_000)
    recorder: Range = (20_000, 400_000)
    stall_share: float = 2e-3


RANDOM_TIMING = Timing()


def constant_timing(link_ns: int | None, site_ns: int = 1_000) -> Timing:
    """Return a timing without jitter, lateness and stalls: one constant delay of the link and one on a site [ns].

    With link_ns None the link is a node of its own. The rig runs on the grid that the lockstep loop assumes. The delay
    on a site must be more than zero, because it orders the events within a tick. The recorder receives all
    messages with the same delay, so in the order of sending.
    """
    site, link = (site_ns, site_ns + 1), None if link_ns is None else (link_ns, link_ns + 1)
    return Timing((0, 1), site, link, (10_000, 10_001), (0, 1), site, stall_share=0.0)


class RandomStreams:
    """Streams of random numbers by name, all from one seed.

    Each topic and each loop has its own stream, so that an additional message, such as a part of a journal, changes no
    other delay. The numbers use the bits of Python's generator, which are the same on every processor and version.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self._streams: dict[tuple[str, ...], random.Random] = {}
        self._draws: dict[tuple[Range, tuple[str, ...]], Callable[[], int]] = {}

    def of(self, names: tuple[str, ...]) -> random.Random:
        """Return the stream of these names."""
        stream = self._streams.get(names)
        if stream is None:
            stream = self._streams[names] = random.Random(f"{self.seed} {' '.join(names)}")
        return stream

    def draw(self, low_high: Range, names: tuple[str, ...]) -> int:
        """Draw a delay [ns] from the stream of these names."""
        return self.draws(low_high, names)()

    def draws(self, low_high: Range, names: tuple[str, ...]) -> Callable[[], int]:
        """Return a function that draws a delay [ns] from the stream of these names, low <= delay < high."""
        low, high = low_high
        width = high - low
        if width == 1:
            return lambda: low
        place = (low_high, names)
        if (found := self._draws.get(place)) is not None:
            return found
        bits_of, bits = self.of(names).getrandbits, width.bit_length()

        def draw() -> int:
            while (drawn := bits_of(bits)) >= width:
                pass
            return low + drawn

        self._draws[place] = draw
        return draw
