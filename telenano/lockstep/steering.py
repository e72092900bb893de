"""Hands that steer the tip across the sample in lockstep: what a package brings, and `simulate` runs.

A hand is a NamedTuple of arrays, which its steps change in place. It sees what has come back over the link, and says
how fast the tip is to go:

    class Hand(NamedTuple):
        seen: npt.NDArray[np.float64]  # shape (4,)

    HandSteps(moves, sees).register(Hand)

The steps are pure but for these arrays, marked `compiled`, and chosen by the class of the hand.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics.compiler import chosen_step, compiled

Row = npt.NDArray[np.float64]


@compiled
def _notes_nothing(hand: Any, part: Any, force_n: float, across_n: tuple[float, float]) -> None:
    pass


@compiled
def _never_ends(hand: Any) -> bool:
    return False


@compiled
def _writes_nothing(hand: Any, row: Row) -> None:
    pass


class HandSteps(NamedTuple):
    """The steps of a hand that steers, and what it adds to the course of a session.

    moves(hand, tick) gives the speed of the tip in x and y that it asks for [m/s]; the session begins at the tick 0.
    sees(hand, answer) takes the newest answer of the link, shape (4,): place of the tip [m], force across it [N].
    notes(hand, part, force_n, across_n) takes what a judge may know and the hand may not: the state of the instrument's
    part and the forces on the tip [N]. ends(hand) tells whether it is done; without a stylus the run ends then.
    writes(hand, row) fills a row of its columns, of which `columns` has unit and text by name.
    """

    moves: Callable[..., tuple[float, float]]
    sees: Callable[..., None]
    notes: Callable[..., None] = _notes_nothing
    ends: Callable[..., bool] = _never_ends
    writes: Callable[..., None] = _writes_nothing
    columns: Mapping[str, tuple[str, str]] = {}

    def register(self, kind: type) -> None:
        """Let `simulate` run the hands of a class; TypeError, if others have this class already."""
        if kind in _HANDS:
            raise TypeError(f"other steps are those of the hand {kind.__module__}.{kind.__name__} already")
        _HANDS[kind] = self


_HANDS: dict[type, HandSteps] = {}


def columns_of(hand: Any) -> Mapping[str, tuple[str, str]]:
    """Return the columns that a hand adds to the course, each with its unit and text; none for None."""
    return {} if hand is None else _HANDS[type(hand)].columns


hand_moves = chosen_step(lambda kind: _HANDS[kind].moves)
hand_sees = chosen_step(lambda kind: _HANDS[kind].sees)
hand_notes = chosen_step(lambda kind: _HANDS[kind].notes)
hand_ends = chosen_step(lambda kind: _HANDS[kind].ends)
hand_writes = chosen_step(lambda kind: _HANDS[kind].writes)
