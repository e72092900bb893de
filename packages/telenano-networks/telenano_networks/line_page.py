"""The picture of a line: what was measured beside what the link generates, or what a network of the link does alone."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, ScalarFormatter

from telenano_networks.line_fit import ages_s, autocorrelation, lost_runs, scale_of, stalls_of
from telenano_networks.line_log import LineLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_DRAWN = 20_000


def line_figure(log: LineLog, made: LineLog) -> Figure:
    """Draw a log beside what was generated for its messages."""
    return lines_figure({"measured": log, "generated": made}, scale_log=log)


def lines_figure(lines: Mapping[str, LineLog], scale_log: LineLog | None = None) -> Figure:
    """Draw lines over one another, by name.

    Delay over time, the share of the messages that take longer, the autocorrelation, the length of the stalls, the runs
    of losses, and the age of the newest message at a reader. What a stall is follows from `scale_log`, else from each.
    """
    figure = Figure(figsize=(9.5, 9.0), layout="constrained")
    (course, tail), (memory, lengths), (runs, age) = figure.subplots(3, 2)
    first = next(iter(lines.values()))
    longest = max(range(len(first.segments)), key=lambda n: len(first.segments[n].sent_s))
    for number, (name, log) in enumerate(lines.items()):
        colour, scale = f"C{number}", scale_of(scale_log or log)
        part = log.segments[longest]
        some = slice(None, _MOST_DRAWN)
        course.plot(part.sent_s[some], 1e3 * part.delay_s[some], ".", ms=2, color=colour, label=name, alpha=0.6)
        _tail(
            tail,
            1e3 * np.concatenate([p.delay_s[~np.isnan(p.delay_s)] for p in log.segments]),
            color=colour,
            label=name,
        )
        lags_s, values = autocorrelation(log)
        memory.plot(lags_s, values, ".-", color=colour, label=name)
        late_ms = np.array([1e3 * stall.late_s for p in log.segments for stall in stalls_of(p, scale)])
        if len(late_ms):
            _tail(lengths, late_ms, color=colour, label=f"{name}, {len(late_ms)}")
        lost = np.array(lost_runs(log))
        if len(lost):
            _tail(runs, lost, color=colour, label=f"{name}, {len(lost)}")
        _tail(age, 1e3 * ages_s(log), color=colour, label=name)
    course.set(xlabel="time [s]", ylabel="delay [ms]", yscale="log")
    tail.set(xlabel="delay [ms]", ylabel="share that takes longer", xscale="log", yscale="log")
    memory.set(xlabel="lag [s]", ylabel="autocorrelation", xscale="log")
    lengths.set(xlabel="length of a stall [ms]", ylabel="share that is longer")
    runs.set(xlabel="lost in a row", ylabel="share of the runs that are longer")
    age.set(xlabel="age of the newest at the reader [ms]", ylabel="share of the time", xscale="log", yscale="log")
    for axis in (course.yaxis, tail.xaxis, memory.xaxis, age.xaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    # The colours of the course are those of the panel beside it; a legend would lie on its messages.
    for axes in (tail, memory, lengths, runs, age):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small", loc="lower left" if axes is tail else "upper right")
        else:
            axes.text(0.5, 0.5, "none", ha="center", transform=axes.transAxes)
    return figure


def _tail(axes: "Axes", values: "np.ndarray[Any, Any]", **style: Any) -> None:
    axes.step(np.sort(values), 1.0 - np.arange(len(values)) / len(values), **style)
