"""Draw a line: measured beside generated messages, or a network of the link alone."""

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from telenano_lab.networks.line_fit import ages_s, autocorrelation, lost_runs
from telenano_lab.networks.line_log import LineLog
from telenano_lab.networks.line_tally import scale_of, stalls_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_DRAWN = 20_000


def line_figure(log: LineLog, made: LineLog) -> Figure:
    """Draw a log beside the delays that were generated for its messages."""
    return lines_figure({"measured": log, "generated": made}, scale_log=log)


def lines_figure(lines: Mapping[str, LineLog], scale_log: LineLog | None = None) -> Figure:
    """Draw lines over one another, by name.

    The panels are: delay over time, the share of the messages that take longer, the autocorrelation, the length of the
    stalls, the runs of losses, and the age of the newest message at a reader. `scale_log` determines what counts as a
    stall; without it each line does so itself.
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
    # The course has the colours of the panel beside it; a legend would cover its messages.
    for axes in (tail, memory, lengths, runs, age):
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small", loc="lower left" if axes is tail else "upper right")
        else:
            axes.text(0.5, 0.5, "none", ha="center", transform=axes.transAxes)
    return figure


class Curves(NamedTuple):
    """The effect of a network on messages: x and y of each curve, as lists of numbers for a file.

    course: time [s], and the median and the longest delay [ms] in each of 120 parts of the log (None without a
    message). delay_ms and age_ms: the values that these shares of the messages, or of the time at a reader, exceed
    (`SLOWER`). memory: lags [s] and the autocorrelation of the delay at them (None if all delays are equal).
    """

    course: tuple[list[float], list[float | None], list[float | None]]
    delay_ms: list[float]
    age_ms: list[float]
    memory: tuple[list[float], list[float | None]]


# Shares of the messages that take longer, and of the time in which the newest message is older.
SLOWER = (0.999, 0.99, 0.9, 0.7, 0.5, 0.3, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01, 0.005, 0.003, 0.002, 0.001)
# The number of parts of the course of the delays.
_COURSE_PARTS = 120
# The number of lags at which the correlation is drawn.
_LAGS = 24
# An axis with a greater ratio of its ends is labelled at powers of ten only.
_WIDE = 20.0


def curves_of(log: LineLog) -> Curves:
    """Return the curves for the picture of a network and for the page of the operator."""
    part = max(log.segments, key=lambda one: len(one.sent_s))
    pieces = np.array_split(np.arange(len(part.sent_s)), min(_COURSE_PARTS, len(part.sent_s)))
    delays = [part.delay_s[piece][~np.isnan(part.delay_s[piece])] for piece in pieces]
    lags_s, values = autocorrelation(log)
    some = np.unique(np.linspace(0, len(lags_s) - 1, _LAGS).astype(int))
    delays_s = np.concatenate([one.delay_s[~np.isnan(one.delay_s)] for one in log.segments])
    shares = 1.0 - np.array(SLOWER)
    return Curves(
        (
            [_short(float(part.sent_s[piece].mean())) for piece in pieces],
            [_short(1e3 * float(np.median(one))) if len(one) else None for one in delays],
            [_short(1e3 * float(one.max())) if len(one) else None for one in delays],
        ),
        [_short(1e3 * value) for value in np.quantile(delays_s, shares).tolist()],
        [_short(1e3 * value) for value in np.quantile(ages_s(log), shares).tolist()],
        (
            [_short(value) for value in lags_s[some].tolist()],
            [None if math.isnan(value) else _short(value) for value in values[some].tolist()],
        ),
    )


def network_figure(name: str, curves: Curves) -> Figure:
    """Draw one network: delay over time, its distribution, its autocorrelation, and the age at a reader."""
    figure = Figure(figsize=(11.0, 2.6), layout="constrained")
    figure.suptitle(name, fontsize="medium")
    course, tail, memory, age = figure.subplots(1, 4)
    times_s, middle, longest = (np.array(one, dtype=np.float64) for one in curves.course)
    course.plot(times_s, longest, color="C1", lw=1.0, label="longest")
    course.plot(times_s, middle, color="C0", lw=1.0, label="median")
    course.set(xlabel="time [s]", ylabel="delay [ms]", yscale=_scale_of(longest))
    course.legend(fontsize="x-small")
    for axes, values, label in (
        (tail, curves.delay_ms, "delay [ms]"),
        (age, curves.age_ms, "age at the reader [ms]"),
    ):
        axes.plot(values, SLOWER, ".-", ms=3)
        axes.set(xlabel=label, ylabel="share above", xscale=_scale_of(values), yscale="log")
    lags_s, correlation = (np.array(one, dtype=np.float64) for one in curves.memory)
    memory.plot(lags_s, correlation, ".-", ms=3)
    memory.set(xlabel="lag [s]", ylabel="autocorrelation", xscale="log", ylim=(-0.1, 1.05))
    for axis in (course.yaxis, tail.xaxis, age.xaxis):
        if axis.get_scale() != "log":
            continue
        low, high = axis.get_view_interval()
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < _WIDE * low else (1.0,)))
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    return figure


def _scale_of(values: Iterable[float]) -> str:
    """Return the scale of an axis: linear for a network without any delay, which a logarithm cannot show."""
    return "log" if any(value > 0.0 for value in values) else "linear"


def _short(value: float) -> float:
    return float(f"{value:.3g}")


def _tail(axes: "Axes", values: "np.ndarray[Any, Any]", **style: Any) -> None:
    axes.step(np.sort(values), 1.0 - np.arange(len(values)) / len(values), **style)
