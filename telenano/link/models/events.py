"""Things that happen to single messages: flipped bits, and being sent past the delay."""

from telenano.link.random_streams import Draw, Occurrence


class Corruptor:
    """Flips bits in some messages."""

    __slots__ = ("_bits", "_draw", "happens")

    def __init__(self, happens: Occurrence, bits: int, draw: Draw) -> None:
        self.happens = happens
        self._bits = bits
        self._draw = draw

    def corrupt(self, payload: bytes) -> bytes:
        """Return the payload with this number of different bits flipped, all of them if it has fewer."""
        available = 8 * len(payload)
        places: set[int] = set()
        while len(places) < min(self._bits, available):
            places.add(int(self._draw() * available))
        damaged = bytearray(payload)
        for place in places:
            damaged[place >> 3] ^= 1 << (place & 7)
        return bytes(damaged)


class Overtaking:
    """Chooses the messages that are sent at once; at least gap - 1 go the normal way between two of them.

    After the gap each message is chosen with the probability of the occurrence, so that the share of those chosen
    is 1 / (gap - 1 + 1/p) without correlation.
    """

    __slots__ = ("_gap", "_happens", "state")

    def __init__(self, happens: Occurrence, gap: int) -> None:
        self._happens = happens
        self._gap = gap
        # messages since the last one that was chosen; the occurrence is a model of its own
        self.state = 0

    def __call__(self) -> bool:
        happens = self._happens()
        self.state += 1
        if self.state < self._gap or not happens:
            return False
        self.state = 0
        return True
