"""The colours of curves in the figures of studies, and how these are written by default."""

from typing import Any

from telenano.analysis import FigureOptions

# how figures are written unless an option of the command states another way
ON_SCREEN = FigureOptions()
# curves of one panel: each has a line of its own as well, for print in grey
LINES: tuple[tuple[str, Any], ...] = (
    ("#000000", "-"),
    ("#d55e00", "--"),
    ("#0072b2", "-."),
    ("#009e73", ":"),
    ("#e69f00", (0, (6, 1, 1, 1, 1, 1))),
    ("#cc79a7", (0, (3, 1))),
)
