"""Read the files that the settings of the link name: traces, delivery opportunities, tables of jitter."""

from pathlib import Path
from typing import NamedTuple

from telenano.settings.link_settings import DirectionSettings, Impairment
from telenano.settings.link_traces import (
    DelayCourse,
    LossCourse,
    parse_delay_trace,
    parse_delivery_trace,
    parse_jitter_table,
    parse_loss_trace,
    read_text,
)
from telenano.wire.errors import ConfigError


class Files(NamedTuple):
    """The contents of the files of one block of settings; None or empty where the block names no file."""

    course: DelayCourse | None
    delivery_ns: tuple[int, ...] | None
    samples: tuple[float, ...]
    losses: LossCourse | None


def read_files(settings: DirectionSettings, folder: Path, prefix: str) -> dict[str, Files]:
    """Read the files that the settings of a direction name, by topic pattern; '' is the pattern of its own block.

    Raises:
        ConfigError: A file cannot be used; the message names the key, which begins with `prefix`, the file and the
            line.
    """
    return {
        pattern: _read(settings.block(pattern), folder, f"{prefix}.topics.{pattern}." if pattern else f"{prefix}.")
        for pattern in ("", *settings.topics)
    }


def _read(block: Impairment, folder: Path, prefix: str) -> Files:
    trace, delivery, jitter = block.delay_trace, block.delivery_trace, block.jitter
    course = delivery_ns = None
    samples: tuple[float, ...] = ()
    losses = None
    key = ""
    try:
        if trace.file is not None:
            key = "delay_trace.file"
            course = parse_delay_trace(read_text(folder / trace.file), trace.file, by_number=trace.by == "number")
        lost = block.loss_trace
        if lost.file is not None:
            key = "loss_trace.file"
            losses = parse_loss_trace(read_text(folder / lost.file), lost.file, by_number=lost.by == "number")
        if delivery.file is not None:
            key = "delivery_trace.file"
            delivery_ns = parse_delivery_trace(read_text(folder / delivery.file), delivery.file, delivery.unit_s)
        if jitter.distribution == "table" and jitter.table_file is not None:
            key = "jitter.table_file"
            samples = parse_jitter_table(read_text(folder / jitter.table_file), jitter.table_file)
    except ConfigError as error:
        raise ConfigError(f"{prefix}{key}: {error}") from error
    return Files(course, delivery_ns, samples, losses)
