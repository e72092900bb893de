"""The messages of an experiment: what a participant sees, what is answered, and the trial with its condition."""

from typing import Annotated, Literal

from pydantic import Field

from telenano.wire.messages import Array, Count, Facts, Message, Record
from telenano.wire.ranges import DurationS, ScaleValue

MOST_QUESTIONS = 16
_NAME = r"^[a-z][a-z0-9_]{0,31}$"
_ID = r"^[A-Za-z0-9_-]{1,64}$"
Label = Annotated[str, Field(max_length=128)]
Paragraph = Annotated[str, Field(max_length=1024)]
AnswerId = Annotated[str, Field(max_length=64)]


class Question(Record):
    """A question to a participant: a choice where there are options, else a scale from `least` to `most`."""

    name: str = Field(
        pattern=_NAME, examples=["mental_demand", "answer"], description="Name of the value in the answer"
    )
    text: Label = Field(description="The question in words")
    low: Label = Field(description="What the lower end of a scale means")
    high: Label = Field(description="What the upper end of a scale means")
    least: ScaleValue = Field(description="Lowest value of a scale")
    most: ScaleValue = Field(description="Highest value of a scale; not above the lowest for a choice")
    step: ScaleValue = Field(description="Distance of the values of a scale; 0 for a choice")
    options: Annotated[tuple[Label, ...], Field(max_length=MOST_QUESTIONS)] = Field(
        description="What can be chosen; empty for a scale"
    )


class ExperimentCue(Message):
    """What a participant sees and is asked now, repeated while it stands. Nothing in it tells of the condition."""

    id: str = Field(pattern=_ID, description="Identifier that the answers to it name")
    stage: Literal["consent", "instruction", "countdown", "trial", "rest", "question", "pause", "end"] = Field(
        description="What the session is at"
    )
    title: Label = Field(description="Heading of the page")
    text: Paragraph = Field(description="What the participant is to do, in words")
    remaining_s: DurationS | None = Field(
        description="Time after which it ends by itself [s]; nil where it ends with an answer"
    )
    done: Count = Field(description="Trials of this session that are over")
    total: Count = Field(description="Trials of this session")
    practice: bool = Field(description="This is practice")
    labels: Facts = Field(description="Own words of the page: language, begin, go_on, submit, practice, trial")
    quantity: Literal["none", "force", "position", "place"] = Field(
        description="What is to follow the target: nothing; force on the tip; base, along the axis; place across it"
    )
    band: ScaleValue = Field(description="Half the width of the band about the target, in N or m; 0 without")
    times_s: Array = Field(description="f8: times of the corners of the target since the stage began [s], shape (n,)")
    target: Array = Field(
        description="f8: the target at these times, in N or m, shape (n,); x and y of the place, shape (n, 2)"
    )
    questions: Annotated[tuple[Question, ...], Field(max_length=MOST_QUESTIONS)] = Field(
        description="What is asked; answered all at once"
    )
    answered: Annotated[tuple[AnswerId, ...], Field(max_length=MOST_QUESTIONS)] = Field(
        description="Ids of the answers taken last, so that they are not sent again"
    )


class ExperimentAnswer(Message):
    """What a person at a page answered; sent again, with the same id, until a cue says that it was taken."""

    id: str = Field(pattern=_ID, description="Identifier of the answer")
    cue: str = Field(pattern=_ID, examples=["7f3a-02"], description="Id of the cue that was shown")
    role: Literal["participant", "experimenter"] = Field(description="Who answered")
    values: Facts = Field(description="By name of the question the answer; by `action` what an experimenter asks for")
    given_ns: Count = Field(description="When it was given, on the clock of the page's server [ns]")
    shown_s: DurationS = Field(description="How long the cue had been shown by then [s]")


class ExperimentTrial(Message):
    """The trial with its condition, for the recording and the experimenter; no participant's page is told of it."""

    participant: str = Field(pattern=r"^[A-Za-z0-9_-]{1,32}$", examples=["P01"], description="Pseudonym, never a name")
    session: Count = Field(description="Number of the visit")
    block: Count = Field(description="Number of the block in the session")
    index: Count = Field(description="Number of the trial, from 0")
    trials: Count = Field(description="Trials of the session")
    attempt: Count = Field(description="Number of the attempt at this trial, from 0")
    phase: Literal["practice", "main"] = Field(description="Whether it counts")
    task: str = Field(pattern=_NAME, examples=["touch_and_hold"], description="Name of the task")
    condition: Facts = Field(description="Level of each factor, by its name")
    seed: Count = Field(description="Seed of the trial")
    state: Literal["planned", "running", "done", "disturbed", "aborted", "skipped", "paused"] = Field(
        description="What the trial is at"
    )
    text: Paragraph = Field(description="The same in words, such as what disturbed it")
    picture_delay_s: DurationS = Field(description="Delay of the picture on a participant's page [s]")
