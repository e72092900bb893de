"""Hands that steer the tip across the sample in lockstep: a package provides them, and `simulate` runs them.

A hand is a NamedTuple of arrays, which its steps change in place. It gets the answers that come over the link, and
returns the speed with which the tip should move:

    class Hand(NamedTuple):
        seen: npt.NDArray[np.float64]  # shape (4,)

    HandSteps(moves, sees).register(Hand)

The steps are pure except for these arrays, marked `compiled`, and selected by the class of the hand.
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
    """The steps of a hand that steers, and the columns that it adds to the results of a session.

    moves(hand, tick) returns the desired speed of the tip in x and y [m/s]; the session begins at tick 0.
    sees(hand, answer) gets the newest answer of the link, shape (4,): position of the tip [m] and lateral force [N].
    notes(hand, part, force_n, across_n) gets data for a judge that the hand itself must not use: the state of the
    instrument's plant and the forces on the tip [N]. ends(hand) returns whether it is done; the run ends then, unless
    it has a stylus. writes(hand, row) fills a row of its columns; `columns` has the unit and text of each by name.
    """

    moves: Callable[..., tuple[float, float]]
    sees: Callable[..., None]
    notes: Callable[..., None] = _notes_nothing
    ends: Callable[..., bool] = _never_ends
    writes: Callable[..., None] = _writes_nothing
    columns: Mapping[str, tuple[str, str]] = {}

    def register(self, kind: type) -> None:
        """Register these steps for the hands of a class; raise TypeError if the class has steps already."""
        if kind in _HANDS:
            raise TypeError(f"other steps are those of the hand {kind.__module__}.{kind.__name__} already")
        _HANDS[kind] = self


_HANDS: dict[type, HandSteps] = {}


def columns_of(hand: Any) -> Mapping[str, tuple[str, str]]:
    """Return the columns that a hand adds to the results, with unit and text by name; empty for None."""
    return {} if hand is None else _HANDS[type(hand)].columns


hand_moves = chosen_step(lambda kind: _HANDS[kind].moves)
hand_sees = chosen_step(lambda kind: _HANDS[kind].sees)
hand_notes = chosen_step(lambda kind: _HANDS[kind].notes)
hand_ends = chosen_step(lambda kind: _HANDS[kind].ends)
hand_writes = chosen_step(lambda kind: _HANDS[kind].writes)
