"""Messages of the instrument that only come while it does something of its own accord."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from proto.messages import Count, Facts, _Extended
from proto.ranges import Percent

# A text of this length has at most four times as many bytes, beside which the rest fits into a plain message.
MOST_TEXT = 512
# The program is one of the project, or of an installed package.
AfmProgramName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class AfmProgram(_Extended):
    """What the instrument does by itself, whatever afm/command says; ten times a second, and when it ends."""

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = {"values": 2}

    program: AfmProgramName = Field(
        examples=["scan", "curve", "tactile"],
        description="scan: an image; curve: a force curve; tactile: a path felt; or the program of a package",
    )
    state: Literal["running", "paused", "finished", "ended"] = Field(
        description="finished: all of it was done; ended: before that, see text"
    )
    text: Annotated[str, Field(max_length=MOST_TEXT)] = Field(
        description="One sentence for a person: what it is at, or why it ended"
    )
    done_percent: Percent = Field(description="How much of it is done [%]")
    line: Count = Field(description="Lines that are finished, there and back")
    lines: Count = Field(description="Lines in all; 0 where it has none")
    values: Facts | None = Field(
        default=None, description="What it has measured so far, by name with the unit; of a push where the particle is"
    )
