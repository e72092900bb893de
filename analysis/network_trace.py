"""What a network did to the datagrams of the link, as a trace that the link replays (`telenano link probe`).

Each end reports of the direction that it receives when every datagram arrived, how long it took and which were lost
(`link/network`). Here these become, for each direction, a course of delay and one of loss over the time of sending, in
the format of `delay_trace` and `loss_trace` of the link.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from proto.errors import TelenanoError
from proto.network_messages import LinkNetwork
from services.runtime.datagram.arrivals import SETTLE_NS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Direction = Literal["forward", "backward"]
DIRECTIONS: tuple[Direction, ...] = ("forward", "backward")
QUANTILES = (0.5, 0.9, 0.99, 0.999)
# fewer than this say nothing of a network
_FEWEST = 100


@dataclass(frozen=True)
class NetworkTrace:
    """One direction: the datagrams in the order of sending, each of shape (n,).

    sent_s: time of sending from that of the first [s]; delay_s: one-way delay [s], 0 where lost; lost: which never
    arrived. late counts those that a newer one overtook, uncertainty_s bounds what all delays may be off by [s].
    """

    direction: Direction
    sent_s: npt.NDArray[np.float64]
    delay_s: npt.NDArray[np.float64]
    lost: npt.NDArray[np.bool_]
    late: int
    uncertainty_s: float

    @property
    def arrived_s(self) -> npt.NDArray[np.float64]:
        """The delays of those that arrived [s]."""
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
    """Return how many datagrams were lost in a row at most."""
    longest = run = 0
    for is_lost in lost.tolist():
        run = run + 1 if is_lost else 0
        longest = max(longest, run)
    return longest


def traces_of(reports: Iterable[LinkNetwork]) -> dict[Direction, NetworkTrace]:
    """Return the trace of each direction of which there are reports; TelenanoError when one has too few datagrams.

    Reports from before the clocks were compared have no delays, and are left out.
    """
    found: dict[Direction, list[LinkNetwork]] = {}
    for report in reports:
        if report.clock.valid:
            found.setdefault(report.direction, []).append(report)
    return {direction: _trace(direction, found[direction]) for direction in DIRECTIONS if direction in found}


def _trace(direction: Direction, reports: Sequence[LinkNetwork]) -> NetworkTrace:
    columns = {
        name: np.concatenate([np.asarray(getattr(report, name).to_numpy()) for report in reports])
        for name in ("number", "arrived_ns", "delay_ns", "lost_flag")
    }
    # A message that was given up and came after all has two rows; the one with its arrival counts.
    order = np.lexsort((columns["lost_flag"], columns["number"]))
    number = columns["number"][order]
    first = np.concatenate([[True], number[1:] != number[:-1]])
    number, lost = number[first], columns["lost_flag"][order][first] == 1
    delay_ns = columns["delay_ns"][order][first]
    sent_ns = columns["arrived_ns"][order][first] - delay_ns
    if len(number) and not lost.all():
        # Losses in the last second are not reported yet: these are the numbers without a row.
        arrived = number[~lost]
        lately = arrived[sent_ns[~lost] >= sent_ns[~lost].max() - SETTLE_NS]
        absent = np.setdiff1d(np.arange(lately.min(), lately.max()), number)
        order = np.argsort(np.concatenate([number, absent]), kind="stable")
        number = np.concatenate([number, absent])[order]
        lost = np.concatenate([lost, np.ones(len(absent), dtype=bool)])[order]
        zeros = np.zeros(len(absent), dtype=delay_ns.dtype)
        delay_ns, sent_ns = (np.concatenate([column, zeros])[order] for column in (delay_ns, sent_ns))
    known = ~lost
    if known.sum() < _FEWEST:
        raise TelenanoError(
            f"{direction}: {known.sum()} datagrams arrived, too few for a trace: does the link receive as datagrams?"
        )
    inside = slice(int(np.argmax(known)), len(known) - int(np.argmax(known[::-1])))
    number, lost, delay_ns, sent_ns, known = (x[inside] for x in (number, lost, delay_ns, sent_ns, known))
    # The neighbours of a lost message tell when it was sent, because the clock of the loop is even. Times count from
    # the first, because a double has no nanoseconds of an epoch.
    since_ns = np.maximum.accumulate(sent_ns[known] - sent_ns[0])
    return NetworkTrace(
        direction,
        np.interp(number, number[known], since_ns) * 1e-9,
        np.where(lost, 0.0, delay_ns * 1e-9),
        lost,
        reports[-1].late - reports[0].late,
        max(report.clock.uncertainty_s for report in reports),
    )


def write_traces(traces: Mapping[Direction, NetworkTrace], folder: Path) -> dict[str, Any]:
    """Write FOLDER/DIRECTION.delay and .loss, and give the section `delay_node` that replays them, names relative."""
    section: dict[str, Any] = {}
    for direction, trace in traces.items():
        period_s = float(trace.sent_s[-1])
        delays, losses = [], []
        last = -1.0
        for sent, delay, lost in zip(trace.sent_s.tolist(), trace.delay_s.tolist(), trace.lost.tolist(), strict=True):
            # The times are rounded to the microsecond, strictly increasing, and not beyond the time after which the
            # trace repeats.
            at = round(sent, 6)
            if at <= last:
                continue
            last = at
            losses.append(f"{at:.6f} {int(lost)}")
            if not lost:
                delays.append(f"{at:.6f} {delay:.6f}")
        head = f"# {direction}: measured, {period_s:.1f} s; time of sending [s]"
        (folder / f"{direction}.delay").write_text("\n".join([f"{head}, delay [s]", *delays, ""]), encoding="utf-8")
        (folder / f"{direction}.loss").write_text("\n".join([f"{head}, lost", *losses, ""]), encoding="utf-8")
        section[direction] = {
            "delay_trace": {"file": f"{direction}.delay"},
            "loss_trace": {"file": f"{direction}.loss"},
        }
    return section


def trace_figure(traces: Mapping[Direction, NetworkTrace]) -> "Figure":
    """Draw delay over time with the losses below, and the distribution of the delay, a row for each direction."""
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
