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
    last_s, last = _clock(), (0.0, what)

    def show(done: float, total: float | None = None, text: str | None = None) -> None:
        nonlocal last_s, last, whole
        whole = whole if total is None else total
        now_s, shown = _clock(), (done, text or last[1])
        if now_s - last_s < LINE_EVERY_S or shown == last:
            return
        last_s, last = now_s, shown
        say(f"{shown[1]}: {_amount(done, whole, counted=counted)}")

    return show


def _amount(done: float, whole: float | None, *, counted: bool) -> str:
    if not whole:
        return f"{done:g} done"
    return f"{done:g} of {whole:g}" if counted else f"{100.0 * done / whole:.0f} %"
