"""Messages that the instrument sends only while it runs a program of its own."""

from typing import Annotated, Literal

from telenano.wire.messages import Count, Facts, Message, about
from telenano.wire.ranges import Percent

# Most characters of a text: with four bytes each, the message still fits the limit of a plain one.
MOST_TEXT = 512
# Name of a program of the project or of an installed package.
AfmProgramName = Annotated[str, about(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class AfmProgram(Message):
    """What the instrument does by itself, whatever afm/command says; ten times a second, and when it ends."""

    program: Annotated[
        AfmProgramName,
        about(
            "scan: an image; curve: a force curve; tactile: a path felt; or the program of a package",
            examples=["scan", "curve", "tactile"],
        ),
    ]
    state: Annotated[
        Literal["running", "paused", "finished", "ended"],
        about("finished: all of it was done; ended: before that, see text"),
    ]
    text: Annotated[str, about("One sentence for a person: what it is at, or why it ended", max_length=MOST_TEXT)]
    done_percent: Annotated[Percent, about("How much of it is done [%]")]
    line: Annotated[Count, about("Lines that are finished, there and back")]
    lines: Annotated[Count, about("Lines in all; 0 where it has none")]
    values: Annotated[
        Facts | None, about("What it has measured so far, by name with the unit; of a push where the particle is")
    ] = None
