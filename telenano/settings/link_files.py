"""Read the files that the settings of the link name: traces, delivery opportunities, tables of jitter.

A line of such a file takes 10 us to parse, and a long one a second. A link that runs has its files read in a child
process (`telenano/runtime/wiring/trace_reader.py`), which returns the columns as arrays.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

from telenano.settings.link_settings import DirectionSettings, Impairment
from telenano.settings.link_traces import Columns, DelayCourse, LossCourse, TraceKind, read_columns
from telenano.wire.errors import ConfigError


class Files(NamedTuple):
    """The contents of the files of one block of settings; None or empty where the block names no file.

    `samples` are in ascending order.
    """

    course: DelayCourse | None
    delivery_ns: Sequence[int] | None
    samples: Sequence[float]
    losses: LossCourse | None


class TraceFile(NamedTuple):
    """A file that settings name: its kind, its path, and its name as the settings have it, for errors.

    `by_number` is for delay and loss traces, `unit_s` for delivery traces.
    """

    kind: TraceKind
    path: Path
    name: str
    by_number: bool = False
    unit_s: float = 1.0


class Traces:
    """Reads the files that settings name, when they are asked for.

    A subclass may cache the files, and read them in another process once the link runs (`begin`).
    """

    def begin(self) -> None:
        """Read in another process from now on, if the subclass can."""

    def read(self, file: TraceFile) -> Columns:
        """Return the columns of a file.

        Raises:
            ConfigError: The file cannot be used; the message names file and line.
            LaterError: The file is still being read; call again later.
        """
        return read_columns(file.path, file.kind, file.name, by_number=file.by_number, unit_s=file.unit_s)

    def forget_unused(self) -> None:
        """Forget the files that were not asked for since the last call."""

    def close(self) -> None:
        """Cancel reads under way."""


# It has no state, so all callers can share it.
OWN_TRACES = Traces()


def read_files(settings: DirectionSettings, folder: Path, prefix: str, traces: Traces = OWN_TRACES) -> dict[str, Files]:
    """Read the files that the settings of a direction name, by topic pattern; '' is the pattern of its own block.

    Raises:
        ConfigError: A file cannot be used; the message names the key, which begins with `prefix`, the file and the
            line.
    """
    places = {"": f"{prefix}.", **{pattern: f"{prefix}.topics.{pattern}." for pattern in settings.topics}}
    return {pattern: _read(settings.block(pattern), folder, place, traces) for pattern, place in places.items()}


def _read(block: Impairment, folder: Path, prefix: str, traces: Traces) -> Files:
    trace, lost, delivery, jitter = block.delay_trace, block.loss_trace, block.delivery_trace, block.jitter
    course = delivery_ns = losses = None
    samples: Sequence[float] = ()
    read, key = traces.read, ""
    try:
        if trace.file is not None:
            key = "delay_trace.file"
            file = TraceFile("delay", folder / trace.file, trace.file, by_number=trace.by == "number")
            course = DelayCourse(*cast(Any, read(file)))
        if lost.file is not None:
            key = "loss_trace.file"
            file = TraceFile("loss", folder / lost.file, lost.file, by_number=lost.by == "number")
            losses = LossCourse(*cast(Any, read(file)))
        if delivery.file is not None:
            key = "delivery_trace.file"
            file = TraceFile("delivery", folder / delivery.file, delivery.file, unit_s=delivery.unit_s)
            (delivery_ns,) = read(file)
        if jitter.distribution == "table" and jitter.table_file is not None:
            key = "jitter.table_file"
            (samples,) = read(TraceFile("table", folder / jitter.table_file, jitter.table_file))
    except ConfigError as error:
        raise ConfigError(f"{prefix}{key}: {error}") from error
    return Files(course, delivery_ns, samples, losses)
