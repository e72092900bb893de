"""Normal random numbers for disturbances, accessible by index, so that the only state of a node is its index."""

from functools import lru_cache

import numpy as np

# Numbers that are generated at once.
_BLOCK = 1024


@lru_cache(maxsize=16)
def _block(seed: int, block: int) -> list[float]:
    # A counter-based generator can make any block without those before it.
    source = np.random.Philox(key=seed, counter=[0, 0, block, 0])
    return np.random.Generator(source).standard_normal(_BLOCK).tolist()  # type: ignore[no-any-return]


def normal_number(seed: int, place: int) -> float:
    """Return the standard normal random number at an index, counted from 0, of the sequence of a seed."""
    return _block(seed, place // _BLOCK)[place % _BLOCK]
