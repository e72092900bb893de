"""The order of conditions: as written, shuffled, by a Latin square balanced for carry-over, or by all permutations.

A *sequence* is the order in which one participant meets each condition once. Its number runs over the participants and
their repetitions, so that a design continues where the previous participant ended it.
"""

import itertools
import math
import random
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple, get_args

OrderKind = Literal["factorial", "shuffle", "latin_square", "counterbalanced"]
ORDERS: tuple[OrderKind, ...] = get_args(OrderKind)
# Greatest number of conditions whose permutations a realistic number of participants can cover.
MOST_PERMUTED = 5


def williams(size: int) -> list[tuple[int, ...]]:
    """Return a Latin square in which each condition follows each other one equally often.

    An even number of conditions needs as many sequences, an odd one twice as many: the square and its reversal
    (E. J. Williams, Australian Journal of Scientific Research A 2, 149, 1949).

    Args:
        size: The number of conditions, at least 1.

    Returns:
        The sequences, each of the numbers 0 to size - 1.
    """
    # 0, 1, n-1, 2, n-2, ...: all differences of neighbours are distinct.
    first = [0] + [(step + 1) // 2 if step % 2 else size - step // 2 for step in range(1, size)]
    square = [tuple((place + shift) % size for place in first) for shift in range(size)]
    return square + [row[::-1] for row in square] if size % 2 and size > 1 else square


def sequences_of_design(kind: OrderKind, size: int) -> int:
    """Return the number of sequences that complete a design; 1 if each sequence is complete by itself."""
    if kind == "latin_square":
        return len(williams(size))
    return math.factorial(size) if kind == "counterbalanced" else 1


def sequence(kind: OrderKind, size: int, number: int, seed: str) -> tuple[int, ...]:
    """Return the order of conditions in a sequence.

    Args:
        kind: The design.
        size: The number of conditions.
        number: The number of the sequence, from 0.
        seed: Seed of the shuffle, combined with the number.

    Returns:
        The conditions, as numbers from 0.
    """
    if kind == "latin_square":
        square = williams(size)
        return square[number % len(square)]
    if kind == "counterbalanced":
        return next(itertools.islice(itertools.permutations(range(size)), number % math.factorial(size), None))
    order = list(range(size))
    if kind == "shuffle":
        random.Random(f"{seed}/{number}").shuffle(order)
    return tuple(order)


class Balance(NamedTuple):
    """Counts of each condition at each place, and of each condition right after each other one; shapes (n, n).

    `followed[a][b]` counts b right after a within a sequence.
    """

    places: tuple[tuple[int, ...], ...]
    followed: tuple[tuple[int, ...], ...]

    @property
    def over_places(self) -> bool:
        """Whether each condition came equally often at each place."""
        return len({count for row in self.places for count in row}) <= 1

    @property
    def over_carry(self) -> bool:
        """Whether each condition came equally often right after each other one."""
        pairs = [count for a, row in enumerate(self.followed) for b, count in enumerate(row) if a != b]
        return len(set(pairs)) <= 1


def balance(sequences: Iterable[Sequence[int]], size: int) -> Balance:
    """Count places and neighbours of conditions in sequences."""
    places: Counter[tuple[int, int]] = Counter()
    followed: Counter[tuple[int, int]] = Counter()
    for sequence_of in sequences:
        places.update((condition, place) for place, condition in enumerate(sequence_of))
        followed.update(itertools.pairwise(sequence_of))
    square = range(size)
    return Balance(
        tuple(tuple(places[condition, place] for place in square) for condition in square),
        tuple(tuple(followed[before, after] for after in square) for before in square),
    )
