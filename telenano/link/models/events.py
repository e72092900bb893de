"""Impairments of single messages: flipped bits, and overtaking."""

from telenano.link.random_streams import Draw, Occurrence


class Corruptor:
    """Flips bits in some messages."""

    __slots__ = ("_bits", "_draw", "happens")

    def __init__(self, happens: Occurrence, bits: int, draw: Draw) -> None:
        self.happens = happens
        self._bits = bits
        self._draw = draw

    def corrupt(self, payload: bytes) -> bytes:
        """Return the payload with the configured number of different bits flipped, or all if it has fewer."""
        available = 8 * len(payload)
        places: set[int] = set()
        while len(places) < min(self._bits, available):
            places.add(int(self._draw() * available))
        damaged = bytearray(payload)
        for place in places:
            damaged[place >> 3] ^= 1 << (place & 7)
        return bytes(damaged)


class Overtaking:
    """Selects the messages that are sent at once; at least gap - 1 messages are delayed normally between two of them.

    After the gap each message is selected with the probability p of the occurrence, so without correlation the share of
    selected messages is 1 / (gap - 1 + 1/p).
    """

    __slots__ = ("_gap", "_happens", "state")

    def __init__(self, happens: Occurrence, gap: int) -> None:
        self._happens = happens
        self._gap = gap
        # Number of messages since the last selected one; the occurrence has its own state.
        self.state = 0

    def __call__(self) -> bool:
        happens = self._happens()
        self.state += 1
        if self.state < self._gap or not happens:
            return False
        self.state = 0
        return True
