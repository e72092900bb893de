"""The standing of the laws in each situation of some runs of the benchmark, as `study advise` reads it."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import msgspec

from telenano_lab.experiments.benchmark.results import Situation, Standing, standings_of
from telenano_lab.experiments.benchmark.run import Outcome


class Stood(msgspec.Struct, frozen=True):
    """A law in a situation: counts of its runs, its tracking error, and whether it is behind the best."""

    law: str
    runs: int
    held: int
    sound: int | None
    made_energy: int | None
    tracking_error: float | None
    is_behind: bool

    def as_dict(self) -> dict[str, object]:
        """Return the law as plain data."""
        return msgspec.structs.asdict(self)


class Standings(NamedTuple):
    """The laws in each situation, the recommended one first, and the digest of the runs."""

    situations: Mapping[Situation, Sequence[Stood]]
    digest: str


def of_runs(outcomes: Iterable[Outcome], digest: str) -> Standings:
    """Compute the standings from runs of the benchmark."""
    return Standings({case: [_stood(one) for one in some] for case, some in standings_of(outcomes).items()}, digest)


def _stood(one: Standing) -> Stood:
    row, spread = one.row, one.row.measures["tracking_error"]
    error = None if spread is None else spread.median
    return Stood(row.law, row.runs, row.held, row.sound, row.made_energy, error, one.is_behind)
