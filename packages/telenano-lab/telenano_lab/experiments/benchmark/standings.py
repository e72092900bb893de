"""The standing of the laws in each situation of the benchmark, as a table that the advice reads.

`standings.json` has the order and the counts of `results.standings_of` over all runs of the benchmark. `kept.main`
makes it from a complete set of runs, together with the kept runs themselves. A null figure was not kept.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import msgspec

from telenano.wire import ConfigError
from telenano_lab.experiments.benchmark.plan import VERSION
from telenano_lab.experiments.benchmark.results import Situation, Standing, standings_of
from telenano_lab.experiments.benchmark.run import Outcome

TABLE = Path(__file__).with_name("standings.json")
_ABOUT = (
    "What the benchmark says of each law in each situation, the one to take first; digest is that of its runs.csv."
    " held: runs that were held; sound: of them those without energy made by the loop; is_behind: the share cannot by"
    " chance be the greatest. null: not kept."
)


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


def text_of(standings: Standings) -> str:
    """Return the table as JSON with a line per law."""
    head = json.dumps({"about": _ABOUT, "benchmark": VERSION, "digest": standings.digest}, indent=1)[:-2]
    situations = [
        f'  {json.dumps(case._asdict())[:-1]}, "laws": [\n'
        + ",\n".join(f"   {json.dumps(one.as_dict())}" for one in some)
        + "\n  ]}"
        for case, some in standings.situations.items()
    ]
    return head + ',\n "situations": [\n' + ",\n".join(situations) + "\n ]\n}\n"


class _Place(msgspec.Struct):
    line: str
    instrument: str
    sample: str
    laws: list[Stood]


class _Table(msgspec.Struct):
    benchmark: int
    digest: str
    situations: list[_Place]


@cache
def read_standings(path: Path = TABLE) -> Standings:
    """Read the table of the package.

    Raises:
        ConfigError: It cannot be read, or is of another benchmark; the message names the file.
    """
    try:
        table = msgspec.json.decode(path.read_bytes(), type=_Table)
        if table.benchmark != VERSION:
            raise ValueError(f"it is of benchmark {table.benchmark}, and this is benchmark {VERSION}")
        situations = {Situation(place.line, place.instrument, place.sample): place.laws for place in table.situations}
    except (OSError, msgspec.MsgspecError, ValueError) as error:
        raise ConfigError(f"{path}: the table cannot be used: {error}; install the package again") from error
    return Standings(situations, table.digest)
