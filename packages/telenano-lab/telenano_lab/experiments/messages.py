"""The messages of an experiment: cues for the participant, answers, and the trial with its condition.

Their topics are entry points of this package (`telenano.topics`). A recording of them opens and plays without it.
"""

from typing import Annotated, Literal

from msgspec import Meta

from telenano.wire import Array, Count, DurationS, Facts, Message, Name, Range, Record, Topic, about

MOST_QUESTIONS = 16
_NAME = r"^[a-z][a-z0-9_]{0,31}$"
_ID = r"^[A-Za-z0-9_-]{1,64}$"
Label = Annotated[str, Meta(max_length=128)]
Paragraph = Annotated[str, Meta(max_length=1024)]
SCALE = Range("value of a scale", -1e9, 1e9, "", "the answer to a question for a number, such as an amount of money")
ScaleValue = Annotated[float, SCALE.of_value()]


class Question(Record):
    """A question to a participant: a choice where there are options, else a scale from `least` to `most`."""

    name: Annotated[str, about("Name of the value in the answer", pattern=_NAME, examples=["mental_demand", "answer"])]
    text: Annotated[Label, about("The question in words")]
    low: Annotated[Label, about("Meaning of the lower end of a scale")]
    high: Annotated[Label, about("Meaning of the upper end of a scale")]
    least: Annotated[ScaleValue, about("Lowest value of a scale")]
    most: Annotated[ScaleValue, about("Highest value of a scale; not above the lowest for a choice")]
    step: Annotated[ScaleValue, about("Distance of the values of a scale; 0 for a choice")]
    options: Annotated[tuple[Label, ...], about("Choices; empty for a scale", max_length=MOST_QUESTIONS)]


class ExperimentCue(Message):
    """Page and questions that a participant has now, repeated while they stand; nothing in it reveals the condition."""

    id: Annotated[str, about("Identifier that the answers to it name", pattern=_ID)]
    stage: Annotated[
        Literal["consent", "instruction", "countdown", "trial", "rest", "question", "pause", "end"],
        about("Stage of the session"),
    ]
    title: Annotated[Label, about("Heading of the page")]
    text: Annotated[Paragraph, about("Instruction to the participant")]
    remaining_s: Annotated[
        DurationS | None, about("Time after which the stage ends by itself [s]; nil if it ends with an answer")
    ]
    done: Annotated[Count, about("Trials of this session that are over")]
    total: Annotated[Count, about("Trials of this session")]
    practice: Annotated[bool, about("This is practice")]
    labels: Annotated[Facts, about("Own words of the page: language, begin, end_rest, submit, practice, trial")]
    quantity: Annotated[
        Literal["none", "force", "position", "place"],
        about(
            "Quantity that is to follow the target: none; force on the tip; position of the base along the axis; "
            "place across it"
        ),
    ]
    band: Annotated[ScaleValue, about("Half the width of the band about the target, in N or m; 0 without a band")]
    times_s: Annotated[Array, about("f8: times of the corners of the target since the stage began [s], shape (n,)")]
    target: Annotated[
        Array, about("f8: the target at these times, in N or m, shape (n,); x and y of the place, shape (n, 2)")
    ]
    questions: Annotated[tuple[Question, ...], about("Questions, answered all at once", max_length=MOST_QUESTIONS)]
    answered: Annotated[
        tuple[Name, ...],
        about("Ids of the answers received last, so that the pages do not send them again", max_length=MOST_QUESTIONS),
    ]


class ExperimentAnswer(Message):
    """Answer of a person at a page; sent again, with the same id, until a cue has that id in `answered`."""

    id: Annotated[str, about("Identifier of the answer", pattern=_ID)]
    cue: Annotated[str, about("Id of the cue that was shown", pattern=_ID, examples=["7f3a-02"])]
    role: Annotated[Literal["participant", "experimenter"], about("Role of the person who answered")]
    values: Annotated[Facts, about("Answers by the name of the question; an experimenter's request by `action`")]
    given_ns: Annotated[Count, about("Time at which it was given, on the clock of the page's server [ns]")]
    shown_s: Annotated[DurationS, about("Time for which the cue had been shown by then [s]")]


class ExperimentTrial(Message):
    """The trial with its condition, for the recording and the experimenter; no participant's page receives it."""

    participant: Annotated[str, about("Pseudonym, never a name", pattern=r"^[A-Za-z0-9_-]{1,32}$", examples=["P01"])]
    session: Annotated[Count, about("Number of the visit")]
    block: Annotated[Count, about("Number of the block in the session")]
    index: Annotated[Count, about("Number of the trial, from 0")]
    trials: Annotated[Count, about("Trials of the session")]
    attempt: Annotated[Count, about("Number of the attempt at this trial, from 0")]
    phase: Annotated[Literal["practice", "main"], about("Phase of the trial; practice does not count")]
    task: Annotated[str, about("Name of the task", pattern=_NAME, examples=["touch_and_hold"])]
    condition: Annotated[Facts, about("Level of each factor, by its name")]
    seed: Annotated[Count, about("Seed of the trial")]
    state: Annotated[
        Literal["planned", "running", "done", "disturbed", "aborted", "skipped", "paused"],
        about("State of the trial"),
    ]
    text: Annotated[Paragraph, about("The same in words, such as the cause of a disturbance")]
    picture_delay_s: Annotated[DurationS, about("Delay of the picture on a participant's page [s]")]


# A participant's page receives only the cue, and sends the answer.
CUE = Topic("experiment/cue", ExperimentCue, ("experiment",), "lossless", None, None, None)
ANSWER = Topic("experiment/answer", ExperimentAnswer, ("view",), "lossless", None, None, None)
TRIAL = Topic("experiment/trial", ExperimentTrial, ("experiment",), "lossless", None, None, None)
