"""The view of a running rig: a live table on a terminal, a few lines elsewhere."""

import contextlib
from contextlib import AbstractContextManager
from typing import Self

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from telenano.cli.tables import LEVEL_STYLES, figures
from telenano.launcher.rig_node import Phase, RigNode
from telenano.launcher.rig_status import node_facts
from telenano.launcher.session import SessionNode

_REFRESH_TICKS = 5
# Interval of the lines that name the nodes still awaited [ns].
_REMIND_NS = 5_000_000_000
_REPORTS_SHOWN = 6


class LineView(AbstractContextManager["LineView"]):
    """A view that prints a line for each change of phase and each report, for logs and pipes."""

    def __init__(self, console: Console, *, quiet: bool = False) -> None:
        self._console = console
        self._quiet = quiet
        self._phase: Phase | None = None
        self._reasons: dict[str, str] = {}
        self._reminded_ns = 0

    def __exit__(self, *error: object) -> None:
        """Do nothing: each line has been printed already."""

    def observe(self, rig: RigNode) -> None:
        """Print the news: reports, a new phase, the nodes that are waited for."""
        while rig.reports:
            self.show(rig.reports.popleft())
        if rig.phase != self._phase:
            self._phase = rig.phase
            self._reasons, self._reminded_ns = {}, rig.clock.monotonic_ns()
            self.show(rig.status_line())
        elif isinstance(rig, SessionNode) and rig.others and rig.phase == "starting":
            self._remind(rig)

    def _remind(self, session: SessionNode) -> None:
        now, reasons = session.clock.monotonic_ns(), session.causes()
        if reasons and reasons != self._reasons and now - self._reminded_ns >= _REMIND_NS:
            self._reasons, self._reminded_ns = reasons, now
            self.show("still waiting: " + "; ".join(f"{node} {reason}" for node, reason in reasons.items()))

    def show(self, text: str) -> None:
        """Print a line; the session continues if its output cannot be written."""
        if self._quiet:
            return
        with contextlib.suppress(OSError):
            self._console.print(text, markup=False, highlight=False, soft_wrap=True)


class LiveView(AbstractContextManager["LiveView"]):
    """A view that redraws the table of nodes, the progress of the session and the last events."""

    def __init__(self, console: Console) -> None:
        # The view has no thread of its own: the launcher's loop refreshes it.
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._ticks = 0
        self._last: Group | None = None
        # A line that stays below the table, because the table covers what was printed before it.
        self.footnote = ""

    def __enter__(self) -> Self:
        with contextlib.suppress(OSError):
            self._live.start()
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(OSError):
            self._live.stop()

    def observe(self, rig: RigNode) -> None:
        """Redraw the rig, a few times a second; called at every tick."""
        self._ticks += 1
        if self._ticks % _REFRESH_TICKS == 1:
            picture = rig_picture(rig)
            self._last = Group(picture, Text(self.footnote, "yellow")) if self.footnote else picture
            self._update(self._last)

    def show(self, text: str) -> None:
        """Show a line below the table, or print it when the table is closed, as while the report is made."""
        if not self._live.is_started:
            LineView(self._live.console).show(text)
            return
        self._update(Group(*([self._last] if self._last else []), Text(text)))

    def _update(self, picture: Group) -> None:
        # The terminal may be gone, but the session continues.
        with contextlib.suppress(OSError):
            self._live.update(picture, refresh=True)


def rig_picture(rig: RigNode) -> Group:
    """Draw a rig: nodes, phase, last reports and events."""
    parts: list[RenderableType] = [nodes_table(rig), Text(rig.status_line())]
    if rig.phase == "starting":
        parts += [Text(f"  {node} {reason}", "yellow") for node, reason in rig.causes().items()]
    if rig.progress is not None:
        done_s, whole_s = rig.progress
        bar = Table.grid(padding=(0, 1))
        bar.add_row(ProgressBar(whole_s, done_s, width=50), f"{done_s:.1f} of {whole_s:g} s")
        parts.append(bar)
    parts += [Text(text, "yellow", overflow="ellipsis", no_wrap=True) for text in list(rig.reports)[-_REPORTS_SHOWN:]]
    for event in rig.events:
        text, style = f"{event.src}: {event.text}", LEVEL_STYLES[event.level]
        parts.append(Text(text, style, overflow="ellipsis", no_wrap=True))
    return Group(*parts)


def nodes_table(rig: RigNode) -> Table:
    """Draw the table of nodes from their last health messages; restarts are known for this launcher's nodes only."""
    columns = {heading: figure for heading, figure in figures().items() if figure.is_live}
    table = Table("node", *columns, "restarts")
    for column in table.columns[2:]:
        column.justify = "right"
    restarts = rig.supervisor.restarts()
    for node in rig.nodes:
        facts = node_facts(node, rig.health.get(node), None)
        cells = [figure.cell(facts) if facts["heard"] else Text("-", "dim") for figure in columns.values()]
        table.add_row(node, *cells, Text(str(restarts.get(node, "-"))))
    return table
