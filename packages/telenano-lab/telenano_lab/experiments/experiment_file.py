"""The file of an experiment: every key with its type, bounds and description."""

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PlainValidator, model_validator

from telenano.settings import Settings, flatten
from telenano.wire import Scalar, known_names
from telenano_lab.experiments.asked import CONSENT, CONSENT_TEXT, INSTRUMENTS, worded
from telenano_lab.experiments.extend import choice, scale
from telenano_lab.experiments.messages import Question
from telenano_lab.experiments.orders import OrderKind

# Factors for the delay of both directions, with the one-way delay per unit of the level [s].
DELAYS = {"round_trip_ms": 0.5e-3, "delay_ms": 1e-3}

# A name in braces in the words for a participant, which stands for a value.
IN_BRACES = re.compile(r"\{([A-Za-z_]\w*)\}")
# Longest delay of the picture [s]: the page of a participant keeps ten seconds of pictures.
LONGEST_PICTURE_DELAY_S = 9.0


def _levels_alone(value: object) -> object:
    return {"levels": value} if isinstance(value, list) else value


def _levels(value: object) -> object:
    """Return levels as a tuple of scalars, or as dotted keys by name; ValueError describes the allowed forms."""
    if value is None:
        return None
    if isinstance(value, list) and all(isinstance(level, bool | int | float | str) for level in value):
        return tuple(value)
    if isinstance(value, dict) and all(isinstance(keys, dict) for keys in value.values()):
        return {str(name): flatten(keys) for name, keys in value.items()}
    raise ValueError("levels must be a list of values, or names of levels, each with the keys that it means")


def _name_alone(value: object) -> object:
    return {"name": value} if isinstance(value, str) else value


class Factor(Settings):
    """A factor: levels that are given, or that a psychophysical method chooses from trial to trial."""

    levels: Annotated[Any, PlainValidator(_levels)] = Field(
        default=None, description="Values of the key; or names of levels, each with the dotted keys that it sets"
    )
    adaptive: dict[str, Any] | None = Field(
        default=None, description="Settings of a psychophysical method, which chooses the level of each trial"
    )
    measure: str = Field(
        default="correct", description="Measure of the task by which the method takes a trial as right or wrong"
    )
    key: str | None = Field(
        default=None, description="Dotted key, or task.PARAMETER, where the factor has another name"
    )

    @model_validator(mode="after")
    def _levels_or_method(self) -> Self:
        if (self.levels is None) == (self.adaptive is None):
            raise ValueError("give either levels or adaptive")
        if self.levels is not None and not self.levels:
            raise ValueError("levels: at least one is needed")
        if isinstance(self.levels, tuple) and len(set(map(str, self.levels))) < len(self.levels):
            raise ValueError("levels: each value may appear once; `repetitions` repeats all of them")
        if isinstance(self.levels, dict) and self.key is not None:
            raise ValueError("key: levels with names have the keys that they mean themselves")
        return self

    @property
    def names(self) -> tuple[Scalar, ...]:
        """The levels as shown in a table; empty for an adaptive factor."""
        return tuple(self.levels or ())


class Picture(Settings):
    """The participant's picture of the tip."""

    delay_s: float = Field(
        default=0.0,
        ge=0.0,
        le=LONGEST_PICTURE_DELAY_S,
        description="Delay of the picture, apart from that of the force [s]",
    )


class TaskEntry(Settings):
    """A task with its parameters."""

    name: str = Field(description="Name of the task")
    parameters: dict[str, Any] = Field(default={}, description="Parameters of the task")


class Blocks(Settings):
    """Factors that keep their level for a block of trials, and the order of the blocks."""

    factors: tuple[str, ...] = Field(default=(), description="Factors whose level is the same for all of a block")
    order: OrderKind = Field(default="shuffle", description="Order of the blocks")


class Criterion(Settings):
    """Criterion of sufficient practice: the mean of a measure over the last trials, where right counts as 1."""

    measure: str = Field(description="Measure of the task, such as success")
    last: int = Field(
        default=4, ge=1, le=1000, description="Number of the last practice trials over which the mean is taken"
    )
    at_least: float | None = Field(default=None, description="The mean is not below this")
    at_most: float | None = Field(default=None, description="The mean is not above this")

    @model_validator(mode="after")
    def _one_bound(self) -> Self:
        if (self.at_least is None) == (self.at_most is None):
            raise ValueError("give either at_least or at_most")
        return self

    def is_met(self, values: Sequence[float | bool | str | None]) -> bool:
        """Return whether the last practice trials meet the criterion; False if too few of them have a value."""
        last = [value for value in values[-self.last :] if isinstance(value, bool | int | float)]
        if len(last) < self.last:
            return False
        mean = math.fsum(last) / self.last
        is_high, is_low = self.at_least is None or mean >= self.at_least, self.at_most is None or mean <= self.at_most
        return is_high and is_low


class Practice(Settings):
    """Trials that do not count, before the first block of each task in a session."""

    trials: int = Field(
        default=0,
        ge=0,
        le=1000,
        description="Number of trials, of the conditions of that block in turn; with `until` the greatest number",
    )
    until: dict[str, Criterion] = Field(default={}, description="Criterion that ends the practice of a task, by task")
    missed: Literal["keep", "exclude"] = Field(
        default="keep", description="Consequence for a participant who does not meet the criterion in these trials"
    )

    @model_validator(mode="after")
    def _can_be_met(self) -> Self:
        for name, criterion in self.until.items():
            if criterion.last > self.trials:
                raise ValueError(
                    f"until.{name}.last: {criterion.last} trials are more than the {self.trials} of practice"
                )
        return self


class Breaks(Settings):
    """Rests within and between blocks."""

    every_trials: int | None = Field(default=None, ge=1, description="Number of trials of a block before a rest")
    duration_s: float = Field(default=60.0, ge=0.0, le=3600.0, description="Length of a rest [s]")
    between_blocks_s: float = Field(default=0.0, ge=0.0, le=3600.0, description="Length of a rest between blocks [s]")


class Disturbed(Settings):
    """Condition on which a trial counts as disturbed, and its repetition."""

    stall_s: float = Field(
        default=0.02,
        gt=0.0,
        le=10.0,
        description="Longest standstill of a process of the loop in an undisturbed trial [s]",
    )
    again: Literal["at_once", "end_of_block"] = Field(
        default="end_of_block", description="Time at which a disturbed trial is repeated"
    )
    most_attempts: int = Field(
        default=3, ge=1, le=100, description="Greatest number of attempts at one trial, the first one included"
    )


class Stop(Settings):
    """Conditions that end a run before its plan is done; `resume` continues it."""

    disturbed_in_a_row: int = Field(
        default=5, ge=1, description="Stop after this number of disturbed attempts in a row"
    )
    session_s: float | None = Field(default=None, gt=0.0, description="The longest session of a participant [s]")


class Asked(Settings):
    """An instrument of questions, and when it is asked."""

    instrument: str = Field(description="Name of the instrument, such as nasa_tlx")
    after: Literal["trial", "block", "session"] = Field(
        default="block", description="Whether it is asked after each trial, block or session"
    )


class Item(Settings):
    """A question of an instrument of your own: a scale, or a choice where there are options."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]{0,31}$", description="Name of the item in the table")
    text: str = Field(max_length=128, description="The question")
    low: str = Field(default="", max_length=128, description="Meaning of the lower end of the scale")
    high: str = Field(default="", max_length=128, description="Meaning of its upper end")
    least: float = Field(default=1.0, description="Lowest value")
    most: float = Field(default=7.0, description="Highest value")
    step: float = Field(default=1.0, gt=0.0, description="Distance of the values")
    options: tuple[str, ...] = Field(default=(), max_length=16, description="Choices, instead of a scale")

    def question(self) -> Question:
        """Return the item as a question for the page."""
        if self.options:
            return choice(self.name, self.text, self.options)
        return scale(self.name, self.text, self.low, self.high, self.least, self.most, self.step)


Heading = Annotated[str, Field(max_length=128)]
Paragraph = Annotated[str, Field(max_length=1024)]


class QuestionWords(Settings):
    """A question of a task in other words; the task's own text stands where one is empty."""

    text: Heading = Field(default="", description="The question")
    low: Heading = Field(default="", description="Meaning of the lower end of its scale")
    high: Heading = Field(default="", description="Meaning of its upper end")
    options: tuple[Heading, ...] = Field(default=(), max_length=16, description="Choices, in their order")


class TaskWords(Settings):
    """A task in other words; the task's own text stands where one is empty."""

    title: Heading = Field(default="", description="Heading")
    instruction: Paragraph = Field(
        default="", description="Instruction; a parameter of the task in braces stands for its value"
    )
    questions: dict[str, QuestionWords] = Field(default={}, description="Its questions by name")


class Words(Settings):
    """Texts that a participant reads, in the words and the language of the experiment."""

    language: str = Field(
        default="en",
        pattern=r"^[A-Za-z]{2,8}(-[A-Za-z0-9]{1,8})*$",
        description="Language by BCP 47, such as de or ar, which gives the direction of writing as well",
    )
    consent_title: Heading = Field(default="Consent", description="Heading of the consent")
    consent: Paragraph = Field(default=CONSENT_TEXT, description="Text to which a participant agrees")
    consent_question: Heading = Field(default=CONSENT.text, description="Question that follows the consent")
    agree: Heading = Field(default=CONSENT.options[0], description="Answer of one who takes part")
    disagree: Heading = Field(default=CONSENT.options[1], description="Answer of one who does not")
    questions: Heading = Field(default="A few questions", description="Heading of questionnaires")
    rest: Heading = Field(default="Rest", description="Heading of a rest")
    pause: Heading = Field(default="Pause", description="Heading of a pause that the experimenter makes")
    end: Heading = Field(default="Thank you", description="Heading of the end")
    end_text: Paragraph = Field(default="The session is over.", description="Text below that heading")
    begin: Heading = Field(default="Begin", description="Button below an instruction")
    end_rest: Heading = Field(default="Continue", description="Button that ends a rest")
    submit: Heading = Field(default="Continue", description="Button below questions")
    practice: Heading = Field(default="Practice", description="Text beside the bar in practice")
    trial: Heading = Field(
        default="Trial {number} of {total}", description="Text beside the bar otherwise; with {number} and {total}"
    )
    tasks: dict[str, TaskWords] = Field(default={}, description="Tasks by name")

    @model_validator(mode="after")
    def _known_names(self) -> Self:
        known = ("number", "total")
        if unknown := [name for name in IN_BRACES.findall(self.trial) if name not in known]:
            raise ValueError(f"trial: {{{unknown[0]}}} has no value here; {known_names(unknown[0], known)}")
        return self

    @property
    def labels(self) -> dict[str, str]:
        """The words of the page itself by their use; empty for the English defaults."""
        default = Words()
        names = ("language", "begin", "end_rest", "submit", "practice", "trial")
        return {name: getattr(self, name) for name in names if getattr(self, name) != getattr(default, name)}

    @property
    def consent_choice(self) -> Question:
        """The question for consent; the first answer agrees."""
        return worded(CONSENT, self.consent_question, options=(self.agree, self.disagree))

    def of(self, task: str, question: Question) -> Question:
        """Return a question of a task in the words of this experiment."""
        words = self.tasks.get(task, TaskWords()).questions.get(question.name)
        return question if words is None else worded(question, words.text, words.low, words.high, words.options)


class Operator(Settings):
    """The person or simulated operator who does the trials."""

    kind: Literal["person", "simulated"] = Field(default="simulated", description="A person, or a simulated operator")
    profile: dict[str, Any] = Field(default={}, description="Settings of the simulated operator")


Prefix = Annotated[str, Field(pattern=r"^[A-Za-z]{1,4}[-_]?$")]


class Experiment(Settings):
    """The file of an experiment."""

    name: str = Field(pattern=r"^[a-z0-9_-]{1,64}$", description="Name of the experiment, used for files")
    title: str = Field(default="", max_length=200, description="Subject of the experiment")
    scenario: str = Field(description="Scenario that every trial begins from: a name or a YAML file")
    settings: dict[str, Any] = Field(default={}, description="Dotted keys of the scenario that apply in every trial")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Seed of every order and of every trial")
    apparatus: Literal["live", "lockstep"] = Field(default="live", description="A rig of processes, or simulated time")
    participants: Annotated[int, Field(ge=1, le=999)] | tuple[str, ...] = Field(
        description="Number of participants, who are then numbered; or their pseudonyms"
    )
    pseudonym: Prefix = Field(default="P", description="Beginning of a pseudonym; a number follows")
    sessions: int = Field(default=1, ge=1, le=100, description="Visits of a participant, each with all blocks")
    operator: Operator = Field(default=Operator(), description="Person or simulated operator who does the trials")
    tasks: tuple[Annotated[TaskEntry, BeforeValidator(_name_alone)], ...] = Field(
        min_length=1, max_length=50, description="Tasks, each in blocks of its own"
    )
    factors: dict[str, Annotated[Factor, BeforeValidator(_levels_alone)]] = Field(
        default={},
        description="Factors by name: law, round_trip_ms, delay_ms, network, a dotted key, or task.PARAMETER",
    )
    repetitions: int = Field(
        default=1, ge=1, le=10_000, description="Number of times that a condition comes in a block"
    )
    order: OrderKind = Field(default="shuffle", description="Order of the conditions of a block")
    blocks: Blocks = Field(default=Blocks(), description="Factors that keep their level for a block")
    practice: Practice = Field(default=Practice(), description="Trials that do not count")
    breaks: Breaks = Field(default=Breaks(), description="Rests")
    disturbed: Disturbed = Field(default=Disturbed(), description="Trials that are repeated")
    stop: Stop = Field(default=Stop(), description="Conditions that end a run early")
    questionnaires: dict[str, tuple[Item, ...]] = Field(default={}, description="Your own instruments, by name")
    ask: tuple[Asked, ...] = Field(default=(), description="Instruments of questions, and when they are asked")
    words: Words = Field(default=Words(), description="Texts for participants, in your own words")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if unknown := sorted(set(self.blocks.factors) - set(self.factors)):
            raise ValueError(f"blocks.factors: {unknown[0]} is not a factor; {known_names(unknown[0], self.factors)}")
        adaptive = [name for name, factor in self.factors.items() if factor.adaptive is not None]
        if len(adaptive) > 1:
            raise ValueError(f"factors: {', '.join(adaptive)} are adaptive; a trial can have one such factor")
        if len(DELAYS.keys() & self.factors.keys()) > 1:
            raise ValueError("factors: round_trip_ms and delay_ms are the same delay: give one of them")
        for asked in self.ask:
            if asked.instrument not in self.instruments:
                raise ValueError(
                    f"ask: {asked.instrument} is not an instrument; {known_names(asked.instrument, self.instruments)}"
                )
        if len({task.name for task in self.tasks}) < len(self.tasks):
            raise ValueError("tasks: each may appear once")
        for name in self.pseudonyms:
            if not re.fullmatch(re.escape(self.pseudonym) + r"\d{1,6}", name):
                raise ValueError(f"participants: {name!r} is not a pseudonym: it must be {self.pseudonym} and a number")
        numbers: dict[int, str] = {}
        for name in self.pseudonyms:
            if (other := numbers.setdefault(int(name.removeprefix(self.pseudonym)), name)) != name:
                raise ValueError(
                    f"participants: {other} and {name} have one number, as one person typed in two ways has"
                )
        if len(numbers) < len(self.pseudonyms):
            raise ValueError("participants: each may appear once")
        names = [task.name for task in self.tasks]
        if unknown := sorted(set(self.words.tasks) - set(names)):
            raise ValueError(f"words.tasks: {unknown[0]} is not a task of this file; {known_names(unknown[0], names)}")
        if unknown := sorted(set(self.practice.until) - set(names)):
            raise ValueError(
                f"practice.until: {unknown[0]} is not a task of this file; {known_names(unknown[0], names)}"
            )
        if self.words.agree == self.words.disagree:
            raise ValueError("words.agree and words.disagree are the same word")
        return self

    @property
    def instruments(self) -> dict[str, tuple[Question, ...]]:
        """The available questionnaires, by name."""
        own = {name: tuple(item.question() for item in items) for name, items in self.questionnaires.items()}
        return {**INSTRUMENTS, **own}

    @property
    def pseudonyms(self) -> tuple[str, ...]:
        """The participants, in the order of the design."""
        if isinstance(self.participants, tuple):
            return self.participants
        return tuple(f"{self.pseudonym}{number:02d}" for number in range(1, self.participants + 1))
