"""The benchmark's runs that are kept with the package: read them, compare them with repeated runs, and write them.

    python -m telenano_lab.experiments.benchmark.kept out/benchmark/runs.csv

`runs.csv.xz` is a losslessly compressed `runs.csv` of `telenano benchmark`, and `runs.sha256` its digest: a table that
does not match its digest is refused. `telenano benchmark cell` repeats some of its runs, and `study advise` counts
those on lines like the asked one.
"""

import csv
import io
import lzma
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from telenano.settings import flag_overrides, flatten
from telenano.wire import ConfigError
from telenano_lab.experiments.benchmark.plan import VERSION, Run
from telenano_lab.experiments.benchmark.results import digest_of
from telenano_lab.experiments.benchmark.run import MEASURES, Outcome

TABLE = Path(__file__).with_name("runs.csv.xz")
DIGEST = TABLE.with_name("runs.sha256")
# Columns that identify a run.
_CONDITION = ("instrument", "steadiness", "network", "task", "law", "hand", "seed", "settings")


class Kept(NamedTuple):
    """The outcomes of a table, by run, and its digest."""

    outcomes: Mapping[Run, Outcome]
    digest: str


class Difference(NamedTuple):
    """A figure that differs in a repeated run: its name, the kept value, and the new one."""

    what: str
    kept: Any
    again: Any


def read_outcomes(text: str) -> list[Outcome]:
    """Return the runs in the text of a `runs.csv`, which does not contain the reasons of verdicts.

    Raises:
        ValueError: The text is not that of this version of the benchmark.
    """
    lines = csv.DictReader(io.StringIO(text))
    if list(lines.fieldnames or ()) != ["benchmark", *_CONDITION, "verdict", *MEASURES]:
        raise ValueError("not the runs of a benchmark: the first line names other columns")
    found = []
    for number, line in enumerate(lines, start=2):
        if line["benchmark"] != str(VERSION):
            raise ValueError(f"line {number}: a run of benchmark {line['benchmark']}, and this is benchmark {VERSION}")
        try:
            found.append(_outcome(line))
        except (TypeError, ValueError) as error:
            raise ValueError(f"line {number}: {error}") from error
    return found


def _outcome(line: Mapping[str, str]) -> Outcome:
    condition: dict[str, Any] = {name: line[name] for name in _CONDITION}
    settings = tuple(flatten(flag_overrides(line["settings"].split())).items())
    run = Run(**{**condition, "seed": int(line["seed"]), "settings": settings})
    measures = {name: float(line[name]) if line[name] else None for name in MEASURES}
    return Outcome(run, line["verdict"], "", measures)


@cache
def kept(table: Path = TABLE, digest: Path = DIGEST) -> Kept:
    """Return the runs that are kept with the package.

    Raises:
        ConfigError: The table cannot be read or does not match its digest; the message names the file.
    """
    try:
        text = lzma.decompress(table.read_bytes()).decode()
        written = digest.read_text(encoding="utf-8").split()
    except (OSError, lzma.LZMAError, UnicodeError) as error:
        raise ConfigError(
            f"{table}: the runs of the benchmark cannot be read: {error}; install the package again"
        ) from error
    if written[:1] != [found := digest_of(text)]:
        raise ConfigError(
            f"{table}: its runs have the digest {found}, and {digest.name} has {' '.join(written[:1]) or 'none'};"
            " install the package again"
        )
    try:
        return Kept({outcome.cell: outcome for outcome in read_outcomes(text)}, found)
    except ValueError as error:
        raise ConfigError(f"{table}: {error}") from error


def differences(before: Outcome, again: Outcome) -> list[Difference]:
    """Return the differences of two outcomes of one run, to the last digit that is kept."""
    found = [Difference("verdict", before.verdict, again.verdict)] if before.verdict != again.verdict else []
    figures = ((name, before.measures[name], again.measures[name]) for name in MEASURES)
    return found + [Difference(name, one, other) for name, one, other in figures if one != other]


def write(runs_csv: str, table: Path = TABLE, digest: Path = DIGEST) -> None:
    """Write a table and its digest.

    Args:
        runs_csv: The text of a `runs.csv`.
        table: The file of the table.
        digest: The file of its digest.

    Raises:
        ValueError: The text is not that of this version of the benchmark.
    """
    read_outcomes(runs_csv)
    table.write_bytes(lzma.compress(runs_csv.encode(), preset=9 | lzma.PRESET_EXTREME))
    digest.write_text(f"{digest_of(runs_csv)}  runs.csv\n", encoding="utf-8", newline="")


def chosen(outcomes: Iterable[Outcome], **wanted: Sequence[Any]) -> list[Outcome]:
    """Return the runs whose fields each have one of the wanted values; no value means any."""
    return [
        one for one in outcomes if all(not some or getattr(one.cell, name) in some for name, some in wanted.items())
    ]


def main(arguments: Sequence[str]) -> None:
    """Keep the runs of a file."""
    if len(arguments) != 1:
        raise SystemExit("usage: python -m telenano_lab.experiments.benchmark.kept RUNS.CSV")
    source = Path(arguments[0])
    try:
        text = source.read_bytes().decode()
        write(text)
    except (OSError, ValueError) as error:
        raise SystemExit(f"{source}: {error}") from error


if __name__ == "__main__":
    main(sys.argv[1:])
