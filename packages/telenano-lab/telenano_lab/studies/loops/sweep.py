"""Run many cells: on every core or on a Dask cluster, with a journal from which an interrupted sweep continues.

The journal holds a line of JSON for each finished cell. Its key includes a digest of all model sources, so that cells
of a changed model are computed again while all others are taken from the file.
"""

import contextlib
import json
import logging
import os
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from telenano.files import locked
from telenano.signals import in_processes
from telenano.wire import ConfigError, RigError
from telenano_lab.studies.loops.cells import Cell, CellResult, run_cell

JOURNAL_NAME = "journal.jsonl"
# The number of cells in a batch: a cell takes about 20 ms, and a message to a process or a machine a good part of that.
_BATCH = 8
# After this time without a worker a cluster is reported to have none; after this time without a result, if it has other
# work, it is reported to be busy [s].
_WORKER_S = 5.0
_CONTINUES = "finished cells are in the journal; start a scheduler there and repeat the command to continue"

Progress = Callable[[int, int], None]


def silent(done: int, total: int) -> None:
    """Show nothing."""


def unheard(text: str) -> None:
    """Ignore a text."""


def _none(cell: Any) -> str:
    return ""


class Kind(NamedTuple):
    """A kind of cells: the check of a cell before anything starts, its run, and the reading of its result.

    A cell has a `key`; a result has its `cell`, and `as_dict` for the journal, whose plain data `result` reads.
    `doubts` returns a warning about a cell, or ''; `batch` is the number of consecutive cells that are handed over
    together.
    """

    check: Callable[[Any], object]
    run: Callable[[Any], Any]
    result: Callable[[dict[str, Any]], Any]
    doubts: Callable[[Any], str] = _none
    batch: int = _BATCH


def _check(cell: Cell) -> None:
    cell.controller()
    cell.hold_s()


HOLDS = Kind(_check, run_cell, CellResult.from_dict, Cell.stiffness_doubts)


def run_batch(cells: Sequence[Any], run: Callable[[Any], Any] = run_cell) -> list[Any]:
    """Run some cells one after the other: the task of a worker."""
    return [run(cell) for cell in cells]


class Journal:
    """The results on disk, by key."""

    def __init__(self, path: Path, kind: Kind = HOLDS) -> None:
        """Read the journal if it exists.

        Raises:
            ConfigError: The file is not a journal of a study; the message names file and line.
        """
        self.path, self.kind = path, kind
        self.results: dict[str, Any] = {}
        for number, line in enumerate(self._whole_lines(), start=1):
            try:
                entry = json.loads(line)
                self.results[entry["key"]] = kind.result(entry["result"])
            except (ValueError, KeyError, TypeError) as error:
                raise ConfigError(f"{path}:{number}: is not a line of a study's journal: {error}") from error

    def record(self, results: Iterable[Any]) -> None:
        """Write results to the file, then keep them in memory."""
        entries = [(result.cell.key, result) for result in results]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        lines = [json.dumps({"key": key, "result": result.as_dict()}, allow_nan=False) for key, result in entries]
        content = "".join(line + "\n" for line in lines).encode()
        # Another sweep into this folder may be reading, and removes an incomplete line from the file.
        with locked(self.path, mode=0o666):
            try:
                size = self.path.stat().st_size if self.path.exists() else 0
                with self.path.open("ab") as file:
                    file.write(content)
            except OSError as error:
                with contextlib.suppress(OSError):
                    os.truncate(self.path, size)
                raise RigError(f"{self.path}: results cannot be written: {error.strerror}") from error
        self.results.update(entries)

    def _whole_lines(self) -> list[bytes]:
        """Return the complete lines; an incomplete last line is removed from the file."""
        data = self.path.read_bytes() if self.path.exists() else b""
        if data and not data.endswith(b"\n"):
            with locked(self.path, mode=0o666):
                data = self.path.read_bytes()
                os.truncate(self.path, data.rfind(b"\n") + 1)
        end = data.rfind(b"\n") + 1
        return data[:end].splitlines()


@dataclass
class Sweep:
    """Runs cells and keeps their results.

    `workers`: processes on this machine, None for one a processor; `scheduler`: a Dask cluster instead.
    `warn` receives a sentence, once, for each sample that is too stiff for its law.
    """

    journal: Journal
    workers: int | None
    scheduler: str | None = None
    progress: Progress = silent
    warn: Callable[[str], None] = unheard
    computed: int = field(default=0, init=False)
    _warned: set[str] = field(default_factory=lambda: {""}, init=False)

    def run(self, cells: Sequence[Any]) -> list[Any]:
        """Return the result of each cell, in order; those in the journal are not computed again."""
        keys = {cell: cell.key for cell in dict.fromkeys(cells)}
        for text in dict.fromkeys(self.journal.kind.doubts(cell) for cell in keys):
            if text not in self._warned:
                self._warned.add(text)
                self.warn(text)
        missing = [cell for cell, key in keys.items() if key not in self.journal.results]
        done = len(keys) - len(missing)
        self.progress(done, len(keys))
        # Close the generator here, because an interruption must not wait for the workers.
        with contextlib.closing(self._computed(missing)) as computed:
            for results in computed:
                self.journal.record(results)
                self.computed += len(results)
                done += len(results)
                self.progress(done, len(keys))
        return [self.journal.results[keys[cell]] for cell in cells]

    def _computed(self, cells: list[Any]) -> Generator[list[Any], None, None]:
        kind = self.journal.kind
        for cell in cells:
            # Check all cells before anything is started: a cell that cannot be run is the caller's mistake.
            kind.check(cell)
        batches = [cells[i : i + kind.batch] for i in range(0, len(cells), kind.batch)]
        if self.scheduler is not None:
            yield from _on_cluster(self.scheduler, batches, kind, self.warn)
        else:
            run = partial(run_batch, run=kind.run)
            with contextlib.closing(in_processes(self.workers, run, batches)) as computed:
                for _, results in computed:
                    yield results


def _on_cluster(address: str, batches: list[list[Any]], kind: Kind, warn: Callable[[str], None]) -> Iterator[list[Any]]:
    """Run on a cluster whose workers have this project installed; ConfigError if it does not answer, or is lost.

    `warn` receives a sentence if the work has to wait for a first worker, or for the work of others.
    """
    # dask has types for some of its parts only.
    cluster: Any = import_module("dask.distributed")
    # It would write a traceback for each lost connection, besides the message here.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    try:
        client = cluster.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise ConfigError(f"--scheduler {address}: no Dask scheduler answers there: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WORKER_S)
        except TimeoutError:
            warn(
                f"--scheduler {address}: it has no worker; the study begins when one is started: dask worker {address}"
            )
        futures: list[Any] = client.map(run_batch, batches, run=kind.run, pure=False)
        try:
            cluster.wait(futures, timeout=_WORKER_S, return_when="FIRST_COMPLETED")
        except TimeoutError:
            own = {future.key for future in futures}
            others = {key for keys in client.processing().values() for key in keys} - own
            if others:
                busy = f"its workers first finish {len(others)} tasks of other programs"
                warn(f"--scheduler {address}: {busy}")
        came = 0
        try:
            for future, results in cluster.as_completed(futures, with_results=True):
                if not future.cancelled():
                    came += 1
                    yield results
        except cluster.KilledWorker as error:
            raise ConfigError(f"--scheduler {address}: cells ended one worker after the other: {error}") from error
    # When a scheduler is lost, its work is cancelled and gives no results.
    if came < len(batches):
        lost = f"{len(batches) - came} of {len(batches)} batches of cells have no result"
        raise ConfigError(f"--scheduler {address}: the Dask scheduler was lost, {lost}: {_CONTINUES}")
