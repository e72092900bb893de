"""Convert the measured effect of a network on the link's datagrams to a trace that the link replays (`link probe`).

Each end reports for the direction that it receives when every datagram arrived, how long it took and which were lost
(`link/network`). Here these reports become, for each direction, delay and loss by the number of the datagram, in the
formats of the link's `delay_trace` and `loss_trace`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from telenano.timing import ClockLine
from telenano.wire import LinkNetwork, TelenanoError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Direction = Literal["forward", "backward"]
DIRECTIONS: tuple[Direction, ...] = ("forward", "backward")
QUANTILES = (0.5, 0.9, 0.99, 0.999)
# The length of the blocks of which the fastest datagram counts for the clocks [ns].
_BLOCK_NS = 100_000_000
# Fewer datagrams than this show nothing about a network.
_FEWEST = 100


@dataclass(frozen=True)
class NetworkTrace:
    """One direction: its datagrams in the order of sending, arrays of shape (n,).

    sent_s: time of sending since the first one [s]. delay_s: one-way delay [s], 0 if lost. lost: whether a datagram
    never arrived. late: the number that a newer one overtook. uncertainty_s: the bound of the common error of all
    delays [s].
    """

    direction: Direction
    sent_s: npt.NDArray[np.float64]
    delay_s: npt.NDArray[np.float64]
    lost: npt.NDArray[np.bool_]
    late: int
    uncertainty_s: float

    @property
    def arrived_s(self) -> npt.NDArray[np.float64]:
        """The delays of the datagrams that arrived [s]."""
        return np.asarray(self.delay_s[~self.lost])

    def summary(self) -> dict[str, Any]:
        """Return counts and quantiles of the delay [ms]."""
        quantiles = np.quantile(self.arrived_s, QUANTILES) * 1e3
        return {
            "datagrams": len(self.sent_s),
            "seconds": round(float(self.sent_s[-1]), 3),
            "lost_share": float(self.lost.mean()),
            "longest_loss": longest_run(self.lost),
            "late": self.late,
            **{f"delay_p{share * 100:g}_ms": round(float(v), 3) for share, v in zip(QUANTILES, quantiles, strict=True)},
            "delay_max_ms": round(float(self.arrived_s.max()) * 1e3, 3),
            "uncertainty_ms": round(self.uncertainty_s * 1e3, 3),
        }


def longest_run(lost: npt.NDArray[np.bool_]) -> int:
    """Return the greatest number of datagrams lost in a row."""
    longest = run = 0
    for is_lost in lost.tolist():
        run = run + 1 if is_lost else 0
        longest = max(longest, run)
    return longest


def traces_of(reports: Iterable[LinkNetwork]) -> dict[Direction, NetworkTrace]:
    """Return the trace of each direction with reports; TelenanoError if one has too few datagrams.

    Reports from before the clocks were compared have no delays and are left out. The delays rest on one line for the
    lead of the slave's clock, through the fastest datagrams of both directions (`telenano.timing.clock_fit`), because
    the leads that the single reports assumed differ. If one direction is missing, delays stay as reported.
    """
    reports_of: dict[Direction, list[LinkNetwork]] = {}
    for report in reports:
        if report.clock.valid:
            reports_of.setdefault(report.direction, []).append(report)
    columns = {direction: _columns(reports_of[direction]) for direction in DIRECTIONS if direction in reports_of}
    line = _clock_line(columns)
    return {
        direction: _trace(direction, reports_of[direction], _on_one_clock(direction, rows, line), line)
        for direction, rows in columns.items()
    }


Columns = dict[str, npt.NDArray[Any]]


def _columns(reports: Sequence[LinkNetwork]) -> Columns:
    """Return the rows of reports, with `transit_ns`: arrival minus sending, by two clocks [ns]."""
    names = ("number", "arrived_ns", "delay_ns", "lost_flag")
    rows = {
        name: np.concatenate([np.asarray(getattr(report, name).to_numpy()) for report in reports]) for name in names
    }
    # A report has corrected its delays by the lead of the other clock that it assumed.
    added_ns = [np.full(len(report.number.to_numpy()), round(report.clock.offset_s * 1e9)) for report in reports]
    rows["transit_ns"] = rows["delay_ns"] - np.concatenate(added_ns)
    return rows


def _clock_line(columns: Mapping[Direction, Columns]) -> ClockLine | None:
    """Return the lead of the slave's clock over the master's, by the master's clock; None without both directions."""
    bounds: dict[Direction, list[tuple[int, int]]] = {}
    for direction, rows in columns.items():
        arrived = rows["lost_flag"] == 0
        at_ns, transit_ns = rows["arrived_ns"][arrived], rows["transit_ns"][arrived]
        is_there = direction == "forward"
        # A datagram to the slave left the master at its arrival there minus its transit by two clocks.
        here_ns = at_ns - transit_ns if is_there else at_ns
        best: dict[int, tuple[int, int]] = {}
        for at, value in zip(here_ns.tolist(), transit_ns.tolist(), strict=True):
            block = at // _BLOCK_NS
            if block not in best or value < best[block][1]:
                best[block] = (at, value)
        bounds[direction] = [(at, value if is_there else -value) for at, value in best.values()]
    if not all(bounds.get(direction) for direction in DIRECTIONS):
        return None
    line = ClockLine.through(bounds["forward"], bounds["backward"])
    # The very fastest datagram of a direction is a matter of chance; the fastest of a usual tenth of a second is not.
    off_ns = [
        float(np.median([abs(value - line.at(at)) for at, value in bounds[direction]])) for direction in DIRECTIONS
    ]
    return line._replace(ahead_ns=line.ahead_ns + 0.5 * (off_ns[0] - off_ns[1]), round_trip_ns=sum(off_ns))


def _on_one_clock(direction: Direction, rows: Columns, line: ClockLine | None) -> Columns:
    """Return rows with times by the receiver's clock alone, and delays that rest on the line."""
    if line is None:
        return rows
    sign = -1.0 if direction == "forward" else 1.0
    here_ns = rows["arrived_ns"] - (rows["transit_ns"] if direction == "forward" else 0)
    ahead_ns = line.ahead_ns + line.drift * (here_ns - line.origin_ns).astype(np.float64)
    delay_ns = np.rint(rows["transit_ns"] + sign * ahead_ns).astype(np.int64)
    return {**rows, "delay_ns": np.where(rows["lost_flag"] == 0, np.maximum(delay_ns, 0), 0)}


def _trace(
    direction: Direction, reports: Sequence[LinkNetwork], columns: Columns, line: ClockLine | None
) -> NetworkTrace:
    # A datagram that arrived after it was reported lost has two rows; the one with its arrival counts.
    order = np.lexsort((columns["lost_flag"], columns["number"]))
    number = columns["number"][order]
    first = np.ones(len(number), dtype=bool)
    first[1:] = number[1:] != number[:-1]
    number, lost = number[first], columns["lost_flag"][order][first] == 1
    delay_ns = columns["delay_ns"][order][first]
    sent_ns = columns["arrived_ns"][order][first] - delay_ns
    if len(number) and not lost.all():
        # Losses of the last second are not reported yet: they are the numbers without a row.
        arrived = number[~lost]
        lately = arrived[sent_ns[~lost] >= sent_ns[~lost].max() - LinkNetwork.SETTLE_NS]
        absent = np.setdiff1d(np.arange(lately.min(), lately.max()), number)
        for before, after in _left_out(reports):
            absent = absent[(absent <= before) | (absent >= after)]
        order = np.argsort(np.concatenate([number, absent]), kind="stable")
        number = np.concatenate([number, absent])[order]
        lost = np.concatenate([lost, np.ones(len(absent), dtype=bool)])[order]
        zeros = np.zeros(len(absent), dtype=delay_ns.dtype)
        delay_ns, sent_ns = (np.concatenate([column, zeros])[order] for column in (delay_ns, sent_ns))
    has_arrived = ~lost
    if has_arrived.sum() < _FEWEST:
        raise TelenanoError(
            f"{direction}: {has_arrived.sum()} datagrams arrived, too few for a trace: does the link receive as"
            " datagrams? Over a line that is full, the reports to the master leave them out;"
            " `telenano link show` says both"
        )
    inside = slice(int(np.argmax(has_arrived)), len(has_arrived) - int(np.argmax(has_arrived[::-1])))
    number, lost, delay_ns, sent_ns, has_arrived = (x[inside] for x in (number, lost, delay_ns, sent_ns, has_arrived))
    # The time of sending of a lost datagram follows from its neighbours, because the loop is evenly clocked. Times
    # count from the first one, because a double cannot hold the nanoseconds of an epoch.
    since_ns = np.maximum.accumulate(sent_ns[has_arrived] - sent_ns[0])
    return NetworkTrace(
        direction,
        np.interp(number, number[has_arrived], since_ns) * 1e-9,
        np.where(lost, 0.0, delay_ns * 1e-9),
        lost,
        reports[-1].late - reports[0].late,
        max(report.clock.uncertainty_s for report in reports) if line is None else 0.5e-9 * line.round_trip_ns,
    )


def _left_out(reports: Sequence[LinkNetwork]) -> list[tuple[int, int]]:
    """Return the ranges of numbers for which reports left out the fates of datagrams, as they do over a full line."""
    spans: list[tuple[int, int]] = []
    newest, begin, counted = -1, None, reports[0].arrived
    for report in reports:
        came = report.number.to_numpy()[report.lost_flag.to_numpy() == 0]
        if report.arrived - counted > len(came) and begin is None:
            begin = newest
        counted = report.arrived
        if came.size:
            if begin is not None:
                spans.append((begin, int(came.min())))
                begin = None
            newest = max(newest, int(came.max()))
    return spans


def write_traces(traces: Mapping[Direction, NetworkTrace], folder: Path) -> dict[str, Any]:
    """Write FOLDER/DIRECTION.delay and .loss; return the section `delay_node` that replays them, with relative names.

    They are by the number of the datagram: neighbouring delays and runs of losses are then those of the network at any
    rate of sending.
    """
    section: dict[str, Any] = {}
    for direction, trace in traces.items():
        lost, delay_s = trace.lost.tolist(), trace.delay_s.tolist()
        delays = [f"{number} {delay_s[number]:.6f}" for number in range(len(lost)) if not lost[number]]
        losses = [f"{number} {int(is_lost)}" for number, is_lost in enumerate(lost)]
        # After the last number the trace repeats.
        delays.append(f"{len(lost)} {delays[0].split()[1]}")
        losses.append(f"{len(lost)} 0")
        head = f"# {direction}: measured, {trace.sent_s[-1]:.1f} s; number of the datagram"
        (folder / f"{direction}.delay").write_text("\n".join([f"{head}, delay [s]", *delays, ""]), encoding="utf-8")
        (folder / f"{direction}.loss").write_text("\n".join([f"{head}, lost", *losses, ""]), encoding="utf-8")
        section[direction] = {
            "delay_trace": {"file": f"{direction}.delay", "by": "number"},
            "loss_trace": {"file": f"{direction}.loss", "by": "number"},
        }
    return section


def trace_figure(traces: Mapping[Direction, NetworkTrace]) -> "Figure":
    """Draw delay over time with the losses below, and the distribution of the delay, with a row for each direction."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.0 * len(traces)), layout="constrained")
    axes = figure.subplots(len(traces), 2, squeeze=False, width_ratios=(3, 1))
    for (course, shares), (direction, trace) in zip(axes, traces.items(), strict=True):
        arrived = ~trace.lost
        course.plot(trace.sent_s[arrived], trace.arrived_s * 1e3, ".", markersize=1.5, color="C0")
        low = float(trace.arrived_s.min()) * 1e3
        course.plot(trace.sent_s[trace.lost], np.full(int(trace.lost.sum()), low), "|", color="C3", markersize=8)
        course.set_title(f"{direction}: {trace.lost.mean():.2%} lost (red)", loc="left", fontsize="medium")
        course.set_xlabel("time [s]")
        course.set_ylabel("one-way delay [ms]")
        ordered = np.sort(trace.arrived_s) * 1e3
        shares.plot(ordered, 1.0 - np.arange(len(ordered)) / len(ordered))
        shares.set_yscale("log")
        shares.set_xlabel("delay [ms]")
        shares.set_ylabel("share that takes longer")
    return figure
