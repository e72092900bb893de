"""Messages of the instrument that only come while it does something of its own accord."""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from telenano.wire.messages import Array, Count, Facts, Lengths, Message, _Extended
from telenano.wire.ranges import Percent

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


class AfmParticles(Message):
    """Where the particles of a simulated instrument really are: no instrument knows it, and who plans must not read it.

    For who judges a session afterwards; 20 times a second while one moves, else once a second.
    """

    simulated: Literal[True] = Field(
        examples=[True], description="Always true: this is the truth of a simulation, and no measurement"
    )
    places_m: Lengths = Field(description="Centres on the sample, 0, 0 its middle, shape (n, 2) [m]")
    radii_m: Lengths = Field(description="Radii, shape (n,) [m]")
    moving: Array = Field(description="Which of them have moved within their time of rest, shape (n,), 0 or 1")
