"""A sweep that runs nothing: a test says how each cell ends."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from telenano_lab.studies.loops.cells import Cell, CellResult
from telenano_lab.studies.loops.sweep import Journal, Sweep

ORDINARY = {
    "growth_per_s": None,
    "peak_to_peak_n": 0.0,
    "out_of_contact_share": 0.0,
    "hold_ratio": 1.0,
    "lowest_energy_j": 0.0,
    "guarded": False,
}


class Answered(Sweep):
    """A sweep whose cells end as `answer` says, in the names of `CellResult`; it keeps what it was asked for."""

    def __init__(self, answer: Callable[[Cell], dict[str, Any]]) -> None:
        super().__init__(Journal(Path("nowhere")), 1)
        self.answer = answer
        self.cells: list[Cell] = []

    def run(self, cells: Sequence[Cell]) -> list[CellResult]:
        self.cells += cells
        return [CellResult(cell, **{**ORDINARY, **self.answer(cell)}) for cell in cells]
