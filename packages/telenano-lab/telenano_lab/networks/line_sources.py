"""Read times of sending and delays from recordings, delivery traces and histograms, which hold no messages."""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.files import TextTable
from telenano.link import DirectionEngine
from telenano.recording import Recording
from telenano.settings import LinkSettings
from telenano.wire import ConfigError
from telenano_lab.networks.network_trace import Direction, traces_of
from telenano_lab.networks.report_command import fates_in

Column = npt.NDArray[np.float64]
# The size of messages that are sent through a delivery trace [bytes].
_SIZE_BYTES = 200
# The interval at which they are sent [s].
_PERIOD_S = 0.010
# The bytes that a line of a trace carries.
_OPPORTUNITY_BYTES = 1500
# The unit of the times in a trace [s].
_OPPORTUNITY_S = 1e-3
# The least number of opportunities in a trace.
_FEWEST_OPPORTUNITIES = 100
# With more messages than this for each opportunity, a trace carries next to nothing.
_MOST_SENT_FOR_EACH = 1000


class Histogram(NamedTuple):
    """The edges of the bins, shape (n + 1,) [s], and the share of each bin, shape (n,)."""

    edges_s: Column
    shares: Column

    def quantiles_s(self, shares: tuple[float, ...]) -> list[float]:
        """Return the delays below which these shares lie [s]; within a bin delays are evenly distributed."""
        below = np.concatenate([[0.0], np.cumsum(self.shares)])
        return [float(value) for value in np.interp(shares, below / below[-1], self.edges_s)]


def of_recording(path: Path, direction: Direction, notes: list[str]) -> tuple[Column, Column]:
    """Return sending times and delays [s] of the network in a recording, or else of its link.

    Raises:
        ConfigError: The recording has data of neither.
        RecordingError: The file is no recording.
        TelenanoError: There are too few datagrams.
    """
    reports = [message.decode() for message in Recording(path).messages(("link/network",))]
    own = [report for report in reports if report.direction == direction and report.clock.valid]  # type: ignore[attr-defined]
    if own:
        trace = traces_of(reports)[direction]  # type: ignore[arg-type]
        notes.append(
            f"{path.name}: what the network between the sites did {direction}, from link/network; its clocks were"
            f" compared to {1e3 * trace.uncertainty_s:.3g} ms"
        )
        return trace.sent_s, np.where(trace.lost, np.nan, trace.delay_s)
    rows = fates_in(path)[direction]
    counts: dict[str, int] = {}
    for row in rows:
        counts[row[0]] = counts.get(row[0], 0) + 1
    if not counts:
        raise ConfigError(f"{path.name}: has no link/network and no link/fates of the direction {direction}")
    topic = max(counts, key=lambda name: counts[name])
    notes.append(f"{path.name}: what the link did to {topic} {direction}, from link/fates")
    chosen = [row for row in rows if row[0] == topic]
    sent_s = np.array([1e-9 * (row[2] - chosen[0][2]) for row in chosen])
    return sent_s, np.array([np.nan if row[5] else 1e-9 * row[3] for row in chosen])


def is_delivery_trace(text: str) -> bool:
    """Return whether a text is a mahimahi trace of delivery opportunities: a whole number a line, not decreasing."""
    words = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if len(words) < _FEWEST_OPPORTUNITIES or not all(word.isdecimal() and len(word) < 19 for word in words):
        return False
    return bool((np.diff(np.array(words, dtype=np.int64)) >= 0).all())


def through_delivery_trace(text: str, name: str, notes: list[str]) -> tuple[Column, Column]:
    """Return sending times and delays [s] of small messages that are sent through a delivery trace.

    Raises:
        ConfigError: All opportunities are at time 0, or there are too few of them.
    """
    times = [int(word) for word in text.split() if word.isdecimal()]
    if times[-1] == 0:
        raise ConfigError(f"{name}: all opportunities of the trace are at time 0")
    count = int(times[-1] * _OPPORTUNITY_S / _PERIOD_S)
    if count > _MOST_SENT_FOR_EACH * len(times):
        raise ConfigError(
            f"{name}: its last opportunity is at {times[-1]} ms, {count / len(times):.3g} messages for each of its"
            f" {len(times)}: is its last line right?"
        )
    folder, file = _written(text)
    try:
        way = {"delivery_trace": {"file": file}, "queue": {"limit_messages": None}}
        sent_ns = [round(1e9 * _PERIOD_S * number) for number in range(count)]
        settings = LinkSettings.of({"forward": way})
        fates = DirectionEngine.fates(settings, "forward", "teleop/forward", sent_ns, _SIZE_BYTES, folder=folder)
    finally:
        (folder / file).unlink()
        folder.rmdir()
    delays_s = np.array([1e-9 * fate.delay_ns for fate in fates])
    if not np.nanmedian(delays_s) > 0.0:
        rate = 1e-6 * _OPPORTUNITY_BYTES * 8.0 * len(times) / (times[-1] * _OPPORTUNITY_S)
        raise ConfigError(
            f"{name}: is a capacity trace of mahimahi, of a line of {rate:.3g} Mbit/s, that delays nothing at this"
            f" rate: of messages of {_SIZE_BYTES} bytes each {1e3 * _PERIOD_S:g} ms most go at once. The link takes it"
            " as it is (delivery_trace); a log of delays says what the way adds"
        )
    notes.append(
        f"{name}: the trace says when the line carried 1500 bytes, and nothing of the way behind it. Messages of"
        f" {_SIZE_BYTES} bytes each {1e3 * _PERIOD_S:g} ms were sent through it; add the delay of the way, and expect"
        " more delay for more messages"
    )
    return np.arange(count) * np.float64(_PERIOD_S), delays_s


# A line of the log of mm-link: time [ms], what happened, and of a departure its bytes and how long it waited [ms].
_OF_MM_LINK = re.compile(r"(?m)^(\d+) (?:- \d+ (\d+)|d (\d+) \d+)\s*$")
_HEAD_OF_MM_LINK = re.compile(r"(?im)^#.*mm-link|^#.*mahimahi")
# The fixed delay of the shells around it, as its head names them.
_FIXED_DELAY = re.compile(r"(?m)^#.*?(?:mm-delay|\[delay)[ ](\d+)")


def of_mm_link(text: str, name: str, notes: list[str]) -> tuple[Column, Column] | None:
    """Return sending times and delays [s] of the packets in a log of mm-link, nan for dropped ones; None if it is none.

    A packet was sent when it came to the queue, and what the shell `mm-delay` around it adds stands in the head alone.

    Raises:
        ConfigError: No packet departed.
    """
    if not _HEAD_OF_MM_LINK.search(text):
        return None
    rows: list[tuple[float, float]] = []
    fixed_s = 1e-3 * sum(float(found) for found in set(_FIXED_DELAY.findall(text)))
    for at, waited, dropped in _OF_MM_LINK.findall(text):
        rows += [(1e-3 * (int(at) - int(waited)), 1e-3 * int(waited) + fixed_s)] if waited else []
        rows += [(1e-3 * int(at), np.nan)] * int(dropped or 0)
    if not rows:
        raise ConfigError(f"{name}: is a log of mm-link (mahimahi) in which no packet departed")
    rows.sort(key=lambda row: row[0])
    added = (
        f"with the fixed delay of {1e3 * fixed_s:g} ms of its head" if fixed_s else "and its head names no fixed delay"
    )
    notes.append(f"{name}: a log of mm-link (mahimahi): how long each packet waited, {added}")
    sent_s, delay_s = np.array(rows).T
    return sent_s - sent_s[0], delay_s


def _written(text: str) -> tuple[Path, str]:
    import tempfile

    folder = Path(tempfile.mkdtemp())
    (folder / "trace.txt").write_text(text, encoding="utf-8")
    return folder, "trace.txt"


def read_histogram(path: Path, unit_s: float | None) -> Histogram:
    """Read rows of a bin's lower edge and its count, or its share; a line of headings may state the unit.

    Raises:
        ConfigError: The unit is not stated, a row is no pair of numbers, the edges do not rise, or nothing is counted;
            the message names file and line.
    """
    table = TextTable.read(path)
    name = path.name
    if len(table.columns) != 2:
        raise ConfigError(
            f"{name}: has {len(table.columns)} columns; a histogram has two, a bin's lower edge and its count"
        )
    bins, counted = table.columns
    edges, counts = (table.numbers(column).tolist() for column in (bins, counted))
    if bins.unit and unit_s is None:
        table.in_si(bins, ("s",))
        unit_s = bins.known.factor if bins.known else None
    for place, (edge, count) in enumerate(zip(edges, counts, strict=True)):
        if not (edge == edge and count >= 0.0) or (place and edge <= edges[place - 1]):
            raise ConfigError(f"{name}, line {table.lines[place]}: the bins have to rise, and no count is below 0")
    if unit_s is None:
        raise ConfigError(f"{path.name}: does not say the unit of its bins; give --unit ms")
    if len(edges) < 2 or sum(counts) <= 0.0:
        raise ConfigError(
            f"{path.name}: has {len(edges)} bins with {sum(counts):g} counts in all, which is not a histogram"
        )
    edges.append(2.0 * edges[-1] - edges[-2])
    return Histogram(unit_s * np.array(edges), np.array(counts) / sum(counts))
