"""Normal numbers for disturbances: any of them by its place, so that a node remembers no more than how far it is."""

import numpy as np

# numbers that are made at once
_BLOCK = 1024


class NormalNumbers:
    """Standard normal numbers by their place in the row that a seed decides."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._block = -1
        self._numbers: list[float] = []

    def reseed(self, seed: int) -> None:
        """Go over to another row."""
        if seed != self._seed:
            self._seed, self._block, self._numbers = seed, -1, []

    def at(self, place: int) -> float:
        """Return the number at a place, from 0."""
        block = place // _BLOCK
        if block != self._block:
            # a counter-based generator: any block can be made without those before it
            source = np.random.Philox(key=self._seed, counter=[0, 0, block, 0])
            self._numbers, self._block = np.random.Generator(source).standard_normal(_BLOCK).tolist(), block
        return self._numbers[place % _BLOCK]
