"""Draw a sample of cells: laws, networks, hands and environments in any combination, decided by one seed."""

import random
from typing import get_args

from telenano_lab.studies.loops.cells import Cell, Environment, Hand
from telenano_lab.studies.loops.tuning import Settings, tuned
from telenano_lab.studies.option_values import COMPARED_LAWS

_ROUND_TRIPS_MS = (0.0, 20.0, 40.0, 60.0, 100.0, 150.0, 200.0)
# The environments that the bus can run.
_ENVIRONMENTS: tuple[Environment, ...] = ("spring", "wall", "tip_sample")
# Each list has the good value twice, so that a good link is as frequent as a random one. Jitter is a share of the
# one-way delay.
_JITTER_SHARES = (0.0, 0.0, 0.25)
# Losses as a share of the messages.
_LOSSES = (0.0, 0.0, 0.05, 0.2)
# The stiffnesses of environments without a tip and a sample.
_STIFFNESSES_N_PER_M = (5.0, 10.0, 20.0, 38.0, 80.0)
# The stiffness of a cell with a tip and a sample.
_CONTACT_N_PER_M = 40.0
# The length of the judged hold, short enough to be run in real time [s].
HOLD_S = 4.0


def drawn_cells(number: int, seed: int) -> list[Cell]:
    """Draw this number of different cells; a seed gives the same ones on every machine.

    In half of the cells the law is tuned for its delay (`tuning`); the clamp is off, on, or as the law has it.
    """
    source, cells = random.Random(seed), list[Cell]()
    while len(cells) < number:
        cell = _drawn(source)
        if cell not in cells:
            cells.append(cell)
    return cells


def _drawn(source: random.Random) -> Cell:
    law, environment = source.choice(COMPARED_LAWS), source.choice(_ENVIRONMENTS)
    round_trip_ms = source.choice(_ROUND_TRIPS_MS)
    jitter_ms = 0.5 * round_trip_ms * source.choice(_JITTER_SHARES)
    stiffness = source.choice(_STIFFNESSES_N_PER_M)
    stiffness = _CONTACT_N_PER_M if environment == "tip_sample" else stiffness
    settings: Settings = ()
    if source.random() < 0.5:
        settings = tuned(law, stiffness, 1e-3 * (round_trip_ms + 2.0 * jitter_ms))
    clamp = source.choice((None, False, True))
    if clamp is not None:
        settings = (*settings, ("clamp.enabled", clamp))
    cell = Cell(
        law=law,
        environment=environment,
        hand=source.choice(get_args(Hand)),
        round_trip_ms=round_trip_ms,
        stiffness_n_per_m=stiffness,
        jitter_ms=jitter_ms,
        loss=source.choice(_LOSSES),
        seed=source.randrange(1000),
        settings=settings,
    )
    return cell.model_copy(update={"session_s": cell.hold_s()[0] + HOLD_S})
