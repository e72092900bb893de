"""Normal numbers for disturbances: any of them by its place, so that a node remembers no more than how far it is."""

from functools import lru_cache

import numpy as np

# numbers that are made at once
_BLOCK = 1024


@lru_cache(maxsize=16)
def _block(seed: int, block: int) -> list[float]:
    # a counter-based generator: any block can be made without those before it
    source = np.random.Philox(key=seed, counter=[0, 0, block, 0])
    return np.random.Generator(source).standard_normal(_BLOCK).tolist()  # type: ignore[no-any-return]


def normal_number(seed: int, place: int) -> float:
    """Return the standard normal number at a place, from 0, in the row that a seed decides."""
    return _block(seed, place // _BLOCK)[place % _BLOCK]
