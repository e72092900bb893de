"""The journal of an experiment: append-only JSON lines, each written by one call and forced to the disk.

The state of an experiment is the fold of its records and nothing else, so a run that was killed continues from them.
The records, each with its kind in `record` and the time in `utc`:

- `begun`: digest of the experiment's file, seed, versions, apparatus; once, and `resumed` at each later run;
- `participant`: a participant's session with its number begins; `session_over`: its planned trials are done;
- `trying`: an attempt at a trial begins (participant, index, attempt);
- `trial`: the outcome of the attempt: the fields of Trial and TrialOutcome, and the attempt;
- `interrupted`: an attempt whose outcome a killed run did not record; it does not count;
- `asked`: the answers to a questionnaire such as NASA-TLX (participant, block, trial or -1, instrument, items);
- `practice`: a practice with a criterion is over (participant, session, block, task, trials, met);
- `break`: a rest and its duration [s]; `excluded`, `included`: a participant does not count, or counts again;
- `stopped`: reason why a run ended before its plan did; `ended`: the plan is done; `published`: path of an export;
- `erased`: the data of a participant are gone; the participant is not asked again.
"""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from telenano.files import atomic_file, locked
from telenano.wire import ConfigError, RigError

NAME = "journal.jsonl"
Record = dict[str, Any]
_BUSY = "another `telenano experiment` is at work on it; wait for it or end it"


def now_utc() -> str:
    """Return the current time as ISO 8601 text in UTC, with milliseconds."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def read(path: Path) -> list[Record]:
    """Return the records of a journal, without a last one that is incomplete because its writer died.

    Raises:
        ConfigError: The file cannot be read, or a line before the last one is no record; the message names it.
    """
    return _parsed(path)[0]


def torn(path: Path) -> str:
    """Return the beginning of an incomplete last record; empty if there is none."""
    return _parsed(path)[1].decode(errors="replace")[:80]


def _parsed(path: Path) -> tuple[list[Record], bytes]:
    """Return the records, and the incomplete rest after the last newline."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    lines = content.split(b"\n")
    records: list[Record] = []
    for number, line in enumerate(lines[:-1], 1):
        try:
            record = json.loads(line)
        except ValueError as error:
            raise ConfigError(f"{path}: line {number} is not JSON: {error}; restore it from a backup") from error
        if not isinstance(record, dict) or not isinstance(record.get("record"), str):
            raise ConfigError(f"{path}: line {number} is not a record of an experiment: it has no `record`")
        records.append(record)
    return records, lines[-1]


class Journal:
    """The journal of an experiment, open for writing by one process at a time.

    Args:
        path: The file; it is created if it does not exist.

    Raises:
        RigError: Another process has it open.
        ConfigError: It cannot be read or written.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with contextlib.ExitStack() as opened:
            try:
                opened.enter_context(locked(path, 0.0, mode=0o666, busy=_BUSY))
                # An erasure replaces the journal, so the lock is a file of its own.
                self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
                opened.callback(lambda: os.close(self._descriptor))
                self.records, rest = _parsed(path)
                self.torn = rest.decode(errors="replace")[:80]
                self._whole_bytes = os.fstat(self._descriptor).st_size - len(rest)
                os.ftruncate(self._descriptor, self._whole_bytes)
            except OSError as error:
                raise ConfigError(f"{path}: cannot be opened: {error.strerror}") from error
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def write(self, record: str, **fields: Any) -> Record:
        """Append a record, and return it once it is on the disk.

        Raises:
            RigError: It could not be written whole; the journal is then as it was before.
        """
        entry: Record = {"record": record, "utc": now_utc(), **fields}
        line = (json.dumps(entry, allow_nan=False, default=_plain) + "\n").encode()
        try:
            # First remove the remains of an earlier failure.
            os.ftruncate(self._descriptor, self._whole_bytes)
            written = os.write(self._descriptor, line)
            if written < len(line):
                raise OSError(0, f"only {written} of {len(line)} bytes were written")
            os.fsync(self._descriptor)
        except OSError as error:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._whole_bytes)
            raise RigError(f"{self.path}: a record could not be written: {error.strerror}") from error
        self._whole_bytes += len(line)
        # The record in memory equals what a later run will read.
        self.records.append(json.loads(line))
        return self.records[-1]

    def of(self, *kinds: str) -> Iterator[Record]:
        """Yield the records of some kinds, in their order."""
        return (record for record in self.records if record["record"] in kinds)

    def replace(self, records: list[Record]) -> None:
        """Replace all records atomically, for an erasure.

        Raises:
            RigError: They cannot be written; the journal is then as it was before.
        """
        content = "".join(json.dumps(record) + "\n" for record in records).encode()
        try:
            with atomic_file(self.path) as part, part.open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            descriptor = os.open(self.path, os.O_RDWR | os.O_APPEND)
        except OSError as error:
            raise RigError(f"{self.path}: the records cannot be replaced: {error.strerror}") from error
        os.close(self._descriptor)
        self._descriptor, self._whole_bytes, self.records = descriptor, len(content), list(records)


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold, for arrays, NumPy scalars and mappings; TypeError for others."""
    if isinstance(value, Mapping):
        return dict(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a record cannot hold a {type(value).__name__}")
