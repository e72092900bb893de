"""Progress of a command on stderr: a bar on a terminal, and an occasional line in a pipe or a log."""

import contextlib
import sys
import time
from collections.abc import Iterator
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from telenano.cli.output import say

# The time between lines [s]: a log needs no more of them, and a shorter command needs none.
LINE_EVERY_S = 10.0
_clock = time.monotonic


class Show(Protocol):
    """Update the progress: the amount done, the total if it is known only now, and the text if it has changed."""

    def __call__(self, done: float, total: float | None = None, text: str | None = None) -> None: ...


@contextlib.contextmanager
def progress(what: str, total: float | None = None, *, shown: bool = True, counted: bool = False) -> Iterator[Show]:
    """Show progress while a block runs.

    Args:
        what: A word or two for the task.
        total: The amount of work; None if it is not known yet.
        shown: Whether anything is shown; False with JSON output.
        counted: Whether the numbers themselves mean something, such as lines or cells, and are shown.
    """
    if not shown:
        yield lambda done, total=None, text=None: None
    elif not sys.stderr.isatty():
        yield _lines(what, total, counted=counted)
    else:
        columns = (TextColumn("{task.description}"), BarColumn(), *([MofNCompleteColumn()] if counted else []))
        with Progress(*columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as bar:
            yield _bar(bar, bar.add_task(what, total=total))


def _bar(bar: Progress, task: TaskID) -> Show:
    def show(done: float, total: float | None = None, text: str | None = None) -> None:
        bar.update(task, completed=done, description=text)
        if total is not None:
            bar.update(task, total=total)

    return show


def _lines(what: str, whole: float | None, *, counted: bool) -> Show:
    begun_s = last_s = _clock()
    first: float | None = None
    last = (0.0, what)

    def show(done: float, total: float | None = None, text: str | None = None) -> None:
        nonlocal last_s, last, whole, first
        # What was done before this command says nothing about its speed.
        first = done if first is None else first
        whole = whole if total is None else total
        now_s, shown = _clock(), (done, text or last[1])
        if now_s - last_s < LINE_EVERY_S or shown == last:
            return
        last_s, last = now_s, shown
        left = _left(now_s - begun_s, done - first, (whole or done) - done)
        say(f"{shown[1]}: {_amount(done, whole, counted=counted)}{left}")

    return show


def _left(spent_s: float, done: float, left: float) -> str:
    """Return the time left at the speed so far, as `, some 3 min left`; empty where it is not known."""
    if done <= 0.0 or left <= 0.0:
        return ""
    left_s = spent_s * left / done
    return f", some {left_s / 60.0:.0f} min left" if left_s >= 90.0 else f", some {left_s:.0f} s left"


def _amount(done: float, whole: float | None, *, counted: bool) -> str:
    if not whole:
        return f"{done:g} done"
    return f"{done:g} of {whole:g}" if counted else f"{100.0 * done / whole:.0f} %"
