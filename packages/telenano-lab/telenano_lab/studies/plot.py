"""`telenano bag plot`: fields of a recording over time, as PNG or drawn with characters on the terminal."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files import atomic_file
from telenano.recording import RecordedTime, Timeline, open_recordings, span_of
from telenano.wire import ConfigError, RecordingError

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Bits of the dots of a braille character: rows from the top, two columns.
_DOTS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])
_BRAILLE = 0x2800
_LABEL_COLUMNS = 12
# Spans of a trace in a picture, two for each of its pixels.
_BINS = 2160
# The most samples of a trace that are kept in memory.
_MOST_KEPT = 1 << 20


class Trace(NamedTuple):
    """A field over time [s] since the first message drawn, by the time of sending on the master's clock."""

    name: str
    time_s: Floats
    values: Floats


class _Course:
    """The samples of a field in the order of sending; of very many, the extremes of spans much shorter than a pixel."""

    def __init__(self) -> None:
        self._sent_ns: list[Ints] = []
        self._values: list[Floats] = []
        self._count = 0

    def add(self, sent_ns: Ints, values: Floats) -> None:
        self._sent_ns.append(sent_ns)
        self._values.append(values)
        self._count += len(values)
        if self._count > _MOST_KEPT:
            sent_ns, values = self.samples()
            kept = _extreme_places(sent_ns, values, _MOST_KEPT // 8)
            self._sent_ns, self._values, self._count = [sent_ns[kept]], [values[kept]], len(kept)

    def samples(self) -> tuple[Ints, Floats]:
        sent_ns, values = np.concatenate(self._sent_ns), np.concatenate(self._values)
        # A topic may have several publishers, and messages may overtake others on the link.
        order = np.argsort(sent_ns, kind="stable")
        return sent_ns[order], values[order]


def read_traces(
    path: Path, names: Sequence[str], start: RecordedTime | None = None, end: RecordedTime | None = None
) -> list[Trace]:
    """Read the fields named TOPIC.FIELD, each topic once and by the index of the recording, in a part of its time.

    Of more than a million samples, only those are kept that a line in a picture shows.

    Raises:
        ConfigError: A name is not of that form.
        RecordingError: The channel or field does not exist, or is text; the message lists those that exist.
    """
    fields_of: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        topic, _, field = name.partition(".")
        if not field:
            raise ConfigError(f"{name}: is not of the form TOPIC.FIELD, such as afm/state.tip_force_n.2")
        fields_of.setdefault(topic, []).append(field)
    recording = open_recordings([path])
    # The recorder's delay varies: over its times a ramp would be a staircase.
    timeline = Timeline(recording, quick=True)
    courses = {name: _Course() for name in names}
    for topic, fields in fields_of.items():
        for piece in recording.column_pieces(topic, ("publish_ns", "log_ns", "src", *fields)):
            sent_ns = piece["publish_ns"].astype(np.int64)
            for src in set(piece["src"]):
                own = piece["src"] == src
                sent_ns[own] = timeline.times_ns(src, sent_ns[own], piece["log_ns"][own])
            for field in fields:
                if piece[field].dtype == object:
                    raise RecordingError(f"{path}: {topic}: {field} is text, which cannot be drawn")
                courses[f"{topic}.{field}"].add(sent_ns, piece[field].astype(np.float64))
    samples = {name: course.samples() for name, course in courses.items()}
    origin_ns = min((int(sent_ns[0]) for sent_ns, _ in samples.values() if sent_ns.size), default=0)
    from_ns, to_ns = span_of(recording.span_ns[0], start, end)
    traces = []
    for name, (sent_ns, values) in samples.items():
        chosen = np.full(sent_ns.size, True) if start is None else sent_ns >= from_ns
        chosen &= True if to_ns is None else sent_ns < to_ns
        if sent_ns.size and not chosen.any():
            raise RecordingError(f"{path}: {name} has no sample from {start or 'its start'} to {end or 'its end'}")
        time_s = np.asarray((sent_ns[chosen] - origin_ns) * 1e-9, dtype=np.float64)
        traces.append(Trace(name, time_s, values[chosen]))
    return traces


def extremes(trace: Trace, bins: int = _BINS) -> tuple[Floats, Floats]:
    """Return times [s] and values of the least and the greatest value in each of `bins` equal spans of time.

    A line through them covers the same pixels as one through all samples, so no peak is lost. A short trace is returned
    unchanged.
    """
    if len(trace.values) <= 2 * bins:
        return trace.time_s, trace.values
    kept = _extreme_places(trace.time_s, trace.values, bins)
    return trace.time_s[kept], trace.values[kept]


def _extreme_places(times: npt.NDArray[Any], values: Floats, bins: int) -> npt.NDArray[np.intp]:
    """Return the places of the least and the greatest value in each of `bins` equal spans of ascending times.

    A span without a number has its first place, so that the line has a gap. The first and the last sample are included.
    """
    since = times - times[0]
    starts = np.unique(np.searchsorted(since, since[-1] * (np.arange(bins) / bins)))
    places = [_first_least(np.where(np.isnan(values), np.inf, sign * values), starts) for sign in (1.0, -1.0)]
    return np.unique(np.concatenate([[0, len(values) - 1], *places]))


def _first_least(values: Floats, starts: npt.NDArray[np.intp]) -> npt.NDArray[np.intp]:
    """Return the first place of the least value in each part of an array; the parts begin at `starts`."""
    least = np.repeat(np.minimum.reduceat(values, starts), np.diff(starts, append=len(values)))
    places = np.flatnonzero(values == least)
    parts = np.searchsorted(starts, places, side="right")
    return places[np.unique(parts, return_index=True)[1]]


def save_png(traces: Sequence[Trace], path: Path, title: str) -> None:
    """Draw each trace in its own panel over a common time axis; RecordingError if the file cannot be written."""
    # Imported here, because the import takes a second that other commands should not pay.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 1.0 + 2.0 * len(traces)), layout="constrained")
    panels = figure.subplots(len(traces), 1, sharex=True, squeeze=False)[:, 0]
    for panel, trace in zip(panels, traces, strict=True):
        panel.plot(*extremes(trace), linewidth=0.8)
        panel.set_ylabel(trace.name.replace(".", "\n", 1), fontsize=8)
        panel.grid(alpha=0.3)
    panels[-1].set_xlabel("time of sending since the first message, s")
    panels[0].set_title(title, fontsize=9)
    try:
        with atomic_file(path) as file:
            figure.savefig(file, dpi=120, format=path.suffix[1:] or "png")
    except (OSError, ValueError) as error:
        raise RecordingError(f"{path}: cannot be written: {error}") from error


def draw(trace: Trace, width: int, height: int) -> str:
    """Draw a trace with braille characters.

    Args:
        trace: The trace to draw.
        width: The width of the whole drawing in characters, at least 20.
        height: The height of the whole drawing in characters, at least 3.

    Returns:
        The lines, with the range of values on the left and that of time below.
    """
    finite = np.isfinite(trace.values)
    if not finite.any():
        return f"{trace.name}: no value"
    time_s, values = trace.time_s[finite], trace.values[finite]
    highest, lowest = _distinct(values.max(), values.min())
    margin = max(_LABEL_COLUMNS, len(highest), len(lowest))
    inner = max(8, width - margin - 1)
    grid = np.zeros((height * 4, inner * 2), dtype=bool)
    across = _cells(time_s, inner * 2)
    down = height * 4 - 1 - _cells(values, height * 4)
    grid[down, across] = True
    blocks = grid.reshape(height, 4, inner, 2).transpose(0, 2, 1, 3)
    codes = (blocks * _DOTS).sum(axis=(2, 3)) + _BRAILLE
    labels = [highest, *[""] * (height - 2), lowest]
    lines = [f"{label:>{margin}} {''.join(map(chr, row))}" for label, row in zip(labels, codes, strict=True)]
    left, right = f"{time_s.min():.3f} s", f"{time_s.max():.3f} s"
    axis = " " * (margin + 1) + left + right.rjust(max(1, inner - len(left)))
    return "\n".join([trace.name, *lines, axis])


def _distinct(high: float, low: float) -> tuple[str, str]:
    """Return two numbers as text with enough digits to distinguish them: a base at 1 µm may move by 1 pm."""
    span = high - low
    digits = 4 if span == 0.0 else max(4, 2 + math.ceil(math.log10(max(abs(high), abs(low)) / span)))
    return f"{high:.{digits}g}", f"{low:.{digits}g}"


def _cells(values: Floats, count: int) -> npt.NDArray[np.int64]:
    """Return the number of each value's cell, among `count` equal cells between the least and the greatest value."""
    low, span = values.min(), np.ptp(values)
    if span == 0.0:
        return np.full(values.shape, count // 2, dtype=np.int64)
    cells: npt.NDArray[np.int64] = np.minimum(((values - low) / span * count).astype(np.int64), count - 1)
    return cells
