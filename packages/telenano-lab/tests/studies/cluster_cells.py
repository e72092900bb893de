"""Cells that take a while and need no compiler, for workers on a cluster; each says which process ran it."""

import os
import time
from typing import Any, NamedTuple

from telenano_lab.studies.loops.sweep import Kind

TOOK_S = 0.1


class WaitingCell(NamedTuple):
    """A cell that takes a time [s]."""

    number: int
    takes_s: float = TOOK_S

    @property
    def key(self) -> str:
        return str(self.number)


class WaitedFor(NamedTuple):
    """What became of a cell: the process that ran it."""

    cell: WaitingCell
    process: int

    def as_dict(self) -> dict[str, Any]:
        return {"cell": list(self.cell), "process": self.process}


def wait_for(cell: WaitingCell) -> WaitedFor:
    """Run a cell."""
    time.sleep(cell.takes_s)
    return WaitedFor(cell, os.getpid())


def waited_for(fields: dict[str, Any]) -> WaitedFor:
    """Read a result from plain data."""
    return WaitedFor(WaitingCell(*fields["cell"]), fields["process"])


KIND = Kind(lambda cell: None, wait_for, waited_for, batch=2)
