"""The linear loop of a cell, if its law and its environment have one."""

from telenano.wire import ConfigError
from telenano_lab.studies.loops import linear_loop as of_a_law
from telenano_lab.studies.loops.cells import Cell
from telenano_lab.studies.loops.linear_loop import LinearLoop


def not_linear(cell: Cell) -> str:
    """Return why the loop of a cell is not linear; empty if it is."""
    if cell.law in of_a_law.LINEAR_LAWS and cell.environment != "spring":
        return f"the environment {cell.environment} is not linear; spring is, at the stiffness of a contact"
    return of_a_law.not_linear(cell.controller())


def linear_loop(cell: Cell) -> LinearLoop:
    """Return the linear loop of a cell; ConfigError if its law, its environment or the clamp is not linear."""
    if reason := not_linear(cell):
        raise ConfigError(reason)
    round_trip_s = 1e-3 * (cell.round_trip_ms + cell.device_latency_ms)
    return of_a_law.linear_loop(cell.controller(), cell.stiffness_n_per_m, round_trip_s, cell.hand)
