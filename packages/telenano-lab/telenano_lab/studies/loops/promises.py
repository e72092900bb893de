"""Test the promises of the laws over bad links on drawn cells: passivity at the device, a stable hold, the full force.

Every seed has a link of its own, with a round trip of 0 to 500 ms, jitter of half the delay and a loss of 0, 5 or 20 %,
and over it a hand for every sample: a constant force or an arm of 300 or 1000 N/m, on springs of 5 to 200 N/m and in
the contact. In bursts, 5, 20 or 50 % are lost, a mean number of messages in a row. An uneven link has slots, outages
that hold, bursts or a sawtooth delay in both directions instead of jitter and loss. The laws have their defaults, each
with its own clamp. The energy at the device is the energy that the hand put in minus the energy given to the tip, with
that of the device's servo; LEAST_J below zero is left by rounding and the trapezoidal rule.
"""

import itertools
import random
import statistics
from collections.abc import Sequence
from typing import Any, NamedTuple

from telenano.sections import OWN_LAWS
from telenano_lab.studies.loops.cells import Cell, CellResult, Environment, Hand
from telenano_lab.studies.loops.links import Uneven
from telenano_lab.studies.loops.sweep import Sweep

ROUND_TRIPS_MS = (0.0, 20.0, 60.0, 120.0, 200.0, 500.0)
LOSSES = (0.0, 0.05, 0.2)
BURST_LOSSES = (0.05, 0.2, 0.5)
HANDS: tuple[Hand, ...] = ("force", "ordinary", "stiff")
SAMPLES: tuple[tuple[Environment, float], ...] = (
    ("spring", 5.0),
    ("spring", 20.0),
    ("spring", 38.0),
    ("spring", 80.0),
    ("spring", 200.0),
    ("tip_sample", 40.0),
)
UNEVEN: tuple[Uneven, ...] = ("slots", "outages", "bursts", "sawtooth")
UNEVEN_MS = (15.0, 30.0, 60.0, 120.0)
# The half-width of the jitter: half of the delay of each direction, as a share of the round trip.
_JITTER = 0.25
LEAST_J = -1e-6
# The laws that promise passivity over any link.
PASSIVE_LAWS = tuple(name for name, law in OWN_LAWS.items() if law.passive)
_INTENDED_N: dict[str, float] = {"spring": 1.0, "tip_sample": 2.0}


class Outcome(NamedTuple):
    """The results of a law at a round trip [ms]: runs, runs with energy >= LEAST_J, the least energy [J], stable runs.

    share, least_share: median and least force at the tip over the intended one; apart_m: the median lead of the hand
    over the tip [m]. These are of the runs that were stable and came to rest properly, None without any. failed: the
    count of each outcome of the others.
    """

    law: str
    hand: str
    round_trip_ms: float
    runs: int
    passive: int
    lowest_energy_j: float
    stable: int
    share: float | None
    least_share: float | None
    apart_m: float | None
    failed: dict[str, int]


def drawn_cells(laws: Sequence[str], seeds: int, burst: float | None = None, *, uneven: bool = False) -> list[Cell]:
    """Return a link for every seed with a hand drawn for every sample on it, the same ones for every law.

    Cells over one link follow one another, because drawing a random link takes longer than a run over it.

    Args:
        laws: The laws.
        seeds: The number of seeds.
        burst: The mean number of messages lost in a row; None if losses are independent.
        uneven: Whether the link has an uneven flow, without jitter and loss.
    """
    return [cell for seed in range(seeds) for cell in _drawn(laws, seed, burst, uneven=uneven)]


def _drawn(laws: Sequence[str], seed: int, burst: float | None, *, uneven: bool) -> list[Cell]:
    source = random.Random(seed)
    round_trip_ms = ROUND_TRIPS_MS[seed % len(ROUND_TRIPS_MS)]
    losses = LOSSES if burst is None else BURST_LOSSES
    loss = losses[seed // len(ROUND_TRIPS_MS) % len(losses)]
    places = [(environment, stiffness, source.choice(HANDS)) for environment, stiffness in SAMPLES]
    link: dict[str, Any] = {"jitter_ms": _JITTER * round_trip_ms, "loss": loss, "burst": burst}
    if uneven:
        kind = UNEVEN[seed // len(ROUND_TRIPS_MS) % len(UNEVEN)]
        link = {"uneven": kind, "uneven_ms": source.choice(UNEVEN_MS)}
    return [
        Cell(
            law=law,
            environment=environment,
            hand=hand,
            round_trip_ms=round_trip_ms,
            stiffness_n_per_m=stiffness,
            seed=seed,
            **link,
        )
        for environment, stiffness, hand in places
        for law in laws
    ]


def outcomes(
    laws: Sequence[str], seeds: int, sweep: Sweep, burst: float | None = None, *, uneven: bool = False
) -> list[Outcome]:
    """Run the drawn cells; return a row for every law and round trip, of the constant force and of the arms."""
    results = sweep.run(drawn_cells(laws, seeds, burst, uneven=uneven))
    rows = []
    for law, round_trip_ms in itertools.product(laws, ROUND_TRIPS_MS):
        for hand, hands in (("force", HANDS[:1]), ("arms", HANDS[1:])):
            some = [r for r in results if (r.cell.law, r.cell.round_trip_ms) == (law, round_trip_ms)]
            some = [r for r in some if r.cell.hand in hands]
            if some:
                rows.append(_row(law, hand, round_trip_ms, some))
    return rows


def _row(law: str, hand: str, round_trip_ms: float, results: Sequence[CellResult]) -> Outcome:
    stable = [result for result in results if result.outcome == "stable"]
    shares = [(result.tip_n or 0.0) / _INTENDED_N[result.cell.environment] for result in stable]
    failed: dict[str, int] = {}
    for result in results:
        if result.outcome != "stable":
            failed[result.outcome] = failed.get(result.outcome, 0) + 1
    return Outcome(
        law=law,
        hand=hand,
        round_trip_ms=round_trip_ms,
        runs=len(results),
        passive=sum(result.lowest_energy_j >= LEAST_J for result in results),
        lowest_energy_j=min(result.lowest_energy_j for result in results),
        stable=len(stable),
        share=statistics.median(shares) if shares else None,
        least_share=min(shares, default=None),
        apart_m=statistics.median(result.apart_m or 0.0 for result in stable) if stable else None,
        failed=failed,
    )


def broken(rows: Sequence[Outcome]) -> list[Outcome]:
    """Return the rows in which a law that promises passivity generated energy."""
    return [row for row in rows if row.law in PASSIVE_LAWS and row.passive < row.runs]


def as_dict(row: Outcome) -> dict[str, Any]:
    """Return a row as plain data, with whether its law promises passivity."""
    return {**row._asdict(), "promised": row.law in PASSIVE_LAWS}
