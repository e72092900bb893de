"""The colours of verdicts and of curves in the figures of studies, and how these are written by default."""

from typing import Any

from telenano.analysis import FigureOptions

# how figures are written unless an option of the command states another way
ON_SCREEN = FigureOptions()
# found by a search for the greatest least difference, with these three first: stable is light, what diverges dark
VERDICTS = {
    "stable": "#99e6ff",
    "limit_cycle": "#e68000",
    "diverged": "#66004d",
    "contact_lost": "#0000e6",
    "guarded": "#001a00",
    "no_data": "#ffffe6",
    "cannot_say": "#4d4d00",
}
# curves of one panel: each has a line of its own as well, for print in grey
LINES: tuple[tuple[str, Any], ...] = (
    ("#000000", "-"),
    ("#d55e00", "--"),
    ("#0072b2", "-."),
    ("#009e73", ":"),
    ("#e69f00", (0, (6, 1, 1, 1, 1, 1))),
    ("#cc79a7", (0, (3, 1))),
)
