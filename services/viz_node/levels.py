"""The curves of a recording: least and greatest values in equal spans of time, and all samples of a part.

A page that shows an hour has a thousand columns of pixels for 3.6 million samples. It draws the least and the greatest
value of each column, so that no spike disappears. These are found once, while the file is read.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from services.viz_node.streams import BY_SOURCE, LATEST_NS, STREAMS, LinkLoss, Stream
from telenano.recording.messages import LeftOut, RecordedChannel, RecordedMessage
from telenano.recording.site_clock import Timeline

Floats = npt.NDArray[np.float64]

# Least length of a span of the finest level [s].
_LEAST_WIDTH_S = 0.005
# Greatest number of spans of the finest level: 35 MB for all curves.
_MOST_SPANS = 200_000
# Number of messages of a stream that are converted to arrays at once.
_AT_ONCE = 4000
_NS = 1_000_000_000


class Samples:
    """Samples of a stream that wait to be converted to arrays: time stamps [ns], and a row of values for each."""

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self._loss, self._left_out = LinkLoss(), LeftOut()
        # When each was sent, and received [ns].
        self._stamps: list[tuple[int, int]] = []
        self._rows: list[list[float]] = []
        self.src = ""

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, message: RecordedMessage) -> None:
        """Add a message; leave out one that is invalid or has an impossible time, as for a live rig."""
        if message.publish_ns <= LATEST_NS:
            self._left_out.guard(self._add, message)

    def _add(self, message: RecordedMessage) -> None:
        fields = message.checked_fields()
        complete = self._loss.added(fields) if self.stream.name == "link" else fields
        row = [column.value(complete) for column in self.stream.columns]
        self.src = message.src
        self._stamps.append((message.publish_ns, message.log_ns))
        self._rows.append(row)

    def note(self, message: RecordedMessage) -> None:
        """Record a link report from before the first sample, from which the losses are counted."""
        self._left_out.guard(lambda found: self._loss.added(found.checked_fields()), message)

    def take(self, timeline: Timeline, start_ns: int) -> tuple[Floats, Floats]:
        """Return and remove the samples: times since the start [s], of shape (n,), and values of shape (columns, n)."""
        stamps, heard = np.array(self._stamps, dtype=np.int64).reshape(-1, 2).T
        times = (timeline.times_ns(self.src, stamps, heard) - min(start_ns, LATEST_NS)) * 1e-9
        values = np.array(self._rows, dtype=np.float64).reshape(len(stamps), len(self.stream.columns)).T
        self._stamps, self._rows = [], []
        return np.asarray(times, dtype=np.float64), values


class Levels:
    """Least and greatest value of each column in spans of equal width, filled while the recording is read."""

    def __init__(self, length_s: float) -> None:
        """Prepare for a recording of a length [s]."""
        self.length_s = length_s
        self.width_s = max(_LEAST_WIDTH_S, length_s / _MOST_SPANS)
        self._count = max(1, math.ceil(length_s / self.width_s))
        shape = {stream.name: (len(stream.columns), self._count) for stream in STREAMS}
        self._least = {name: np.full(size, np.inf, dtype="<f4") for name, size in shape.items()}
        self._greatest = {name: np.full(size, -np.inf, dtype="<f4") for name, size in shape.items()}

    def add(self, name: str, times_s: Floats, values: Floats) -> None:
        """Add samples of a stream: times [s] of shape (n,), values of shape (columns, n)."""
        inside = (times_s >= 0.0) & (times_s < self._count * self.width_s)
        place = (times_s[inside] / self.width_s).astype(np.int64)
        least, greatest = self._least[name], self._greatest[name]
        for row, column in enumerate(values[:, inside]):
            finite = np.isfinite(column)
            np.minimum.at(least[row], place[finite], column[finite].astype(np.float32))
            np.maximum.at(greatest[row], place[finite], column[finite].astype(np.float32))

    def kept(self) -> dict[str, list[bytes]]:
        """Return all values as bytes: for each stream the least and the greatest ones."""
        return {name: [least.tobytes(), self._greatest[name].tobytes()] for name, least in self._least.items()}

    def restore(self, kept: Mapping[str, Sequence[bytes]]) -> None:
        """Restore the result of `kept` for a recording of the same length; raise ValueError if the sizes differ."""
        shapes = {name: least.shape for name, least in self._least.items()}
        arrays = {n: [np.frombuffer(each, dtype="<f4").reshape(size) for each in kept[n]] for n, size in shapes.items()}
        for name, (least, greatest) in arrays.items():
            self._least[name][:], self._greatest[name][:] = least, greatest

    def between(self, name: str, from_s: float, to_s: float, most: int) -> tuple[Floats, Floats, float]:
        """Return the least and greatest values of a part [s] as samples, in at most `most` spans.

        Returns: times [s] of shape (2 n,), values of shape (columns, 2 n), and the width of the spans [s]. Of each pair
        of samples, the first is the least of its span and the second the greatest. Empty spans are left out.
        """
        first = max(0, math.floor(from_s / self.width_s))
        last = min(self._count, max(first + 1, math.ceil(to_s / self.width_s)))
        of = max(1, math.ceil((last - first) / max(1, most)))
        spans = math.ceil((last - first) / of)
        starts = np.arange(spans) * of
        least = np.minimum.reduceat(self._least[name][:, first:last], starts, axis=1)
        greatest = np.maximum.reduceat(self._greatest[name][:, first:last], starts, axis=1)
        width_s = self.width_s * of
        filled = np.isfinite(least).any(axis=0)
        begin_s = (first + starts[filled]) * self.width_s
        times = np.column_stack([begin_s + 0.25 * width_s, begin_s + 0.75 * width_s]).ravel()
        values = np.stack([least[:, filled], greatest[:, filled]], axis=2).reshape(len(least), -1).astype(np.float64)
        values[~np.isfinite(values)] = math.nan
        return times, values, width_s


def is_curve(channel: RecordedChannel) -> bool:
    """Return whether a channel of a recording is drawn as curves."""
    return channel.via == "direct" and stream_of(channel) is not None


def is_link(channel: RecordedChannel) -> bool:
    """Return whether a channel of a recording contains the reports of the link."""
    stream = stream_of(channel)
    return channel.via == "direct" and stream is not None and stream.name == "link"


def stream_of(channel: RecordedChannel) -> Stream | None:
    """Return the stream that is made from a channel, or None."""
    return BY_SOURCE.get((channel.topic, channel.src.rpartition("@")[2]))


def read_samples(
    messages: Iterable[RecordedMessage], before: Iterable[RecordedMessage], timeline: Timeline, start_ns: int
) -> Iterator[tuple[str, Floats, Floats]]:
    """Yield some thousand samples at a time: name of the stream, times since the start [s], values.

    Args:
        messages: Messages of channels that are drawn as curves.
        before: Earlier reports of the link, from which its losses are counted.
        timeline: The clocks of the recording.
        start_ns: The start of the recording [ns].
    """
    waiting = {stream.name: Samples(stream) for stream in STREAMS}
    for message in before:
        waiting["link"].note(message)
    for message in messages:
        stream = stream_of(message.channel)
        if stream is None:
            continue
        samples = waiting[stream.name]
        samples.add(message)
        if len(samples) >= _AT_ONCE:
            yield (stream.name, *samples.take(timeline, start_ns))
    for name, samples in waiting.items():
        if len(samples):
            yield (name, *samples.take(timeline, start_ns))


def packed(times_s: Floats, values: Floats) -> Mapping[str, Any]:
    """Return samples in the format that a page reads, as `streams.Batch.take` does; `t0` is since the start [s]."""
    order = np.argsort(times_s, kind="stable")
    t0_s = float(times_s[order[0]]) if times_s.size else 0.0
    with np.errstate(over="ignore"):
        columns = np.vstack([times_s[order] - t0_s, values[:, order]]).astype("<f4")
    columns[np.isinf(columns)] = math.nan
    return {"n": int(times_s.size), "t0": t0_s, "data": columns.tobytes()}
