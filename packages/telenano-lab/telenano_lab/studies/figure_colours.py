"""Colours, lines and marks of curves in the figures of studies, and the default formats of figures.

Readers with deuteranopia and protanopia can distinguish the six colours of Okabe and Ito, and each has its own line for
print in grey. A figure with more curves combines them anew, so that no two curves of a panel look alike.
"""

from typing import Any, NamedTuple

from telenano.analysis import FigureOptions
from telenano.wire import ConfigError

# The formats and style of figures unless an option of the command states others.
ON_SCREEN = FigureOptions()
# The colours of curves in one panel; each has its own line as well, for print in grey.
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
    """The colour, line and mark of a curve."""

    colour: str
    style: Any
    mark: str


def looks(count: int) -> list[Look]:
    """Return looks for a number of curves in one panel, no two alike: each colour with its line, then new combinations.

    Raises:
        ConfigError: There are more curves than combinations of a colour and a line, 36.
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
