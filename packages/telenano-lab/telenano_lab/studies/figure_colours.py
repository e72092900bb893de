"""The looks of curves in the figures of studies, and how these are written by default.

Six colours of Okabe and Ito are distinguished by readers with deuteranopia and protanopia, and each has a line of its
own for print in grey. A figure of more curves than that pairs them anew, so that no two curves of a panel look alike.
"""

from typing import Any, NamedTuple

from telenano.analysis import FigureOptions
from telenano.wire import ConfigError

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
_MARKS = ("o", "s", "^", "D", "v", "P")


class Look(NamedTuple):
    """How a curve is drawn."""

    colour: str
    style: Any
    mark: str


def looks(count: int) -> list[Look]:
    """Return the looks of a number of curves in one panel, no two alike: the colours first, then new pairs with lines.

    Raises:
        ConfigError: There are more curves than pairs of a colour and a line, 36.
    """
    most = len(LINES) ** 2
    if count > most:
        raise ConfigError(f"{count} curves are too many for one panel, which shows {most}: choose fewer")
    found = []
    for number in range(count):
        turn, place = divmod(number, len(LINES))
        other = (place + turn) % len(LINES)
        found.append(Look(LINES[place][0], LINES[other][1], _MARKS[other]))
    return found
