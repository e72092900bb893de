"""Messages that the instrument sends only while it runs a program of its own."""

from typing import Annotated, Literal

from telenano.wire.messages import Count, Facts, Message, about
from telenano.wire.ranges import Percent

# Most characters of a text: with four bytes each, the message still fits the limit of a plain one.
MOST_TEXT = 512
# Name of a program of the project or of an installed package.
AfmProgramName = Annotated[str, about(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class AfmProgram(Message):
    """Progress of a program that the instrument runs regardless of afm/command; ten times a second, and at its end."""

    program: Annotated[
        AfmProgramName,
        about(
            "scan: an image; curve: a force curve; tactile: a path that the hand feels; or the program of a package",
            examples=["scan", "curve", "tactile"],
        ),
    ]
    state: Annotated[
        Literal["running", "paused", "finished", "ended"],
        about("finished: the program was completed; ended: it ended before that, see text"),
    ]
    text: Annotated[
        str, about("One sentence for a person: its present action, or the reason why it ended", max_length=MOST_TEXT)
    ]
    done_percent: Annotated[Percent, about("Share of the program that is done [%]")]
    line: Annotated[Count, about("Lines that are finished, trace and retrace")]
    lines: Annotated[Count, about("Lines in total; 0 for a program without lines")]
    values: Annotated[
        Facts | None, about("Values measured so far, by name with the unit; for a push, the place of the particle")
    ] = None
