"""The plan of an experiment: one YAML file, and the list of trials of each participant that follows from it."""

import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PlainValidator, model_validator

from presets import find_scenario
from proto.errors import ConfigError, known_names
from proto.experiment_messages import Question
from proto.messages import Scalar
from services.launcher.plan import anchored, check_sections
from services.runtime.settings.config import Settings, flatten, merge, nested, read_yaml, validate
from services.runtime.settings.scenario import LoadedScenario, Scenario
from studies.experiments.asked import INSTRUMENTS, choice, scale
from studies.experiments.orders import (
    MOST_PERMUTED,
    Balance,
    OrderKind,
    balance,
    sequence,
    sequences_of_design,
)
from studies.experiments.psychophysics.methods import checked, most_trials
from studies.experiments.tasks import TASKS
from studies.experiments.tasks.base import Task
from studies.experiments.types import Trial

# Factors that stand for a key, or for the delay of both directions.
SHORT_NAMES = {"law": "controller.law", "network": "delay_node.profile"}
_DELAYS = {"round_trip_ms": 0.5e-3, "delay_ms": 1e-3}
_OF_TASK = "task."
# The delay of what a participant's page shows, apart from that of the force [s]; it is no key of a scenario.
PICTURE_DELAY = "picture.delay_s"
# What a rig that runs takes by `set`, by section; everything else needs it to be started anew.
_RUNNING: Mapping[str, tuple[str, ...]] = {
    "controller": ("",),
    "delay_node": ("",),
    "haptic_node": ("operator.", "disturbances."),
    "afm_node": ("disturbances.", "spring.stiffness_n_per_m"),
}
_PERIOD = "controller.period_s"
_MOST_TRIALS = 100_000


def changes_while_running(key: str) -> bool:
    """Return whether a dotted key of a scenario can change while the rig runs."""
    section, _, below = key.partition(".")
    return key == PICTURE_DELAY or (
        key != _PERIOD and any(below.startswith(prefix) for prefix in _RUNNING.get(section, ()))
    )


def _levels_alone(value: object) -> object:
    return {"levels": value} if isinstance(value, list) else value


def _levels(value: object) -> object:
    """Return levels as a tuple of scalars, or as dotted keys by name; ValueError says what they have to be."""
    if value is None:
        return None
    if isinstance(value, list) and all(isinstance(level, bool | int | float | str) for level in value):
        return tuple(value)
    if isinstance(value, dict) and all(isinstance(keys, dict) for keys in value.values()):
        return {str(name): flatten(keys) for name, keys in value.items()}
    raise ValueError("levels have to be a list of values, or names of levels, each with the keys that it means")


def _name_alone(value: object) -> object:
    return {"name": value} if isinstance(value, str) else value


class Factor(Settings):
    """A factor: levels that are given, or that a psychophysical method chooses from trial to trial."""

    levels: Annotated[Any, PlainValidator(_levels)] = Field(
        default=None, description="Values of the key; or names of levels, each with the dotted keys that it means"
    )
    adaptive: dict[str, Any] | None = Field(
        default=None, description="Settings of a psychophysical method, which chooses the level of each trial"
    )
    measure: str = Field(default="correct", description="The measure of the task that tells the method right or wrong")
    key: str | None = Field(default=None, description="Dotted key, or task.PARAMETER, where the name is another")

    @model_validator(mode="after")
    def _levels_or_method(self) -> Self:
        if (self.levels is None) == (self.adaptive is None):
            raise ValueError("give either levels or adaptive")
        if self.levels is not None and not self.levels:
            raise ValueError("levels: at least one is needed")
        if isinstance(self.levels, tuple) and len(set(map(str, self.levels))) < len(self.levels):
            raise ValueError("levels: each may be there once; repetitions say how often it comes")
        if isinstance(self.levels, dict) and self.key is not None:
            raise ValueError("key: levels with names have the keys that they mean themselves")
        return self

    @property
    def names(self) -> tuple[Scalar, ...]:
        """The levels as a table shows them; none of an adaptive factor."""
        return tuple(self.levels or ())


class TaskEntry(Settings):
    """A task with its parameters."""

    name: str = Field(description="Name of the task")
    parameters: dict[str, Any] = Field(default={}, description="Parameters of the task")


class Blocks(Settings):
    """What is held for a block of trials, and the order of the blocks."""

    factors: tuple[str, ...] = Field(default=(), description="Factors whose level is the same for all of a block")
    order: OrderKind = Field(default="shuffle", description="Order of the blocks")


class Practice(Settings):
    """Trials that do not count, before the first block of each task in a session."""

    trials: int = Field(default=0, ge=0, le=1000, description="How many, of the conditions of that block in turn")


class Breaks(Settings):
    """Rests."""

    every_trials: int | None = Field(default=None, ge=1, description="A rest after so many trials of a block")
    duration_s: float = Field(default=60.0, ge=0.0, le=3600.0, description="Length of a rest [s]")
    between_blocks_s: float = Field(default=0.0, ge=0.0, le=3600.0, description="Length of a rest between blocks [s]")


class Disturbed(Settings):
    """When a trial counts as disturbed, and what becomes of it."""

    stall_s: float = Field(
        default=0.02, gt=0.0, le=10.0, description="The longest standstill of a process of the loop [s]"
    )
    again: Literal["at_once", "end_of_block"] = Field(default="end_of_block", description="When a trial is repeated")
    most_attempts: int = Field(default=3, ge=1, le=100, description="Attempts at one trial, the first one included")


class Stop(Settings):
    """What ends a run before its plan is done; `resume` goes on."""

    disturbed_in_a_row: int = Field(default=5, ge=1, description="Attempts that were disturbed, one after the other")
    session_s: float | None = Field(default=None, gt=0.0, description="The longest session of a participant [s]")


class Asked(Settings):
    """An instrument of questions, and when it is asked."""

    instrument: str = Field(description="Name of the instrument, such as nasa_tlx")
    after: Literal["trial", "block", "session"] = Field(default="block", description="After what it is asked")


class Item(Settings):
    """A question of an instrument of one's own: a scale, or a choice where there are options."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]{0,31}$", description="Name of the item in the table")
    text: str = Field(max_length=128, description="The question")
    low: str = Field(default="", max_length=128, description="What the lower end of the scale means")
    high: str = Field(default="", max_length=128, description="What its upper end means")
    least: float = Field(default=1.0, description="Lowest value")
    most: float = Field(default=7.0, description="Highest value")
    step: float = Field(default=1.0, gt=0.0, description="Distance of the values")
    options: tuple[str, ...] = Field(default=(), max_length=16, description="What can be chosen, in place of a scale")

    def question(self) -> Question:
        """Return the question as it goes to the page."""
        if self.options:
            return choice(self.name, self.text, self.options)
        return scale(self.name, self.text, self.low, self.high, self.least, self.most, self.step)


class Operator(Settings):
    """Who does the trials."""

    kind: Literal["person", "simulated"] = Field(default="simulated", description="A person, or a simulated operator")
    profile: dict[str, Any] = Field(default={}, description="Settings of the simulated operator")


Prefix = Annotated[str, Field(pattern=r"^[A-Za-z]{1,4}[-_]?$")]


class Experiment(Settings):
    """The file of an experiment."""

    name: str = Field(pattern=r"^[a-z0-9_-]{1,64}$", description="Name of the experiment, used for files")
    title: str = Field(default="", max_length=200, description="What it is about")
    scenario: str = Field(description="Scenario that every trial begins from: a name or a YAML file")
    settings: dict[str, Any] = Field(default={}, description="Dotted keys of the scenario that hold in every trial")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Seed of every order and of every trial")
    apparatus: Literal["live", "lockstep"] = Field(default="live", description="A rig of processes, or simulated time")
    participants: Annotated[int, Field(ge=1, le=999)] | tuple[str, ...] = Field(
        description="How many, which are then numbered; or their pseudonyms"
    )
    pseudonym: Prefix = Field(default="P", description="What a pseudonym begins with; a number follows")
    sessions: int = Field(default=1, ge=1, le=100, description="Visits of a participant, each with all blocks")
    operator: Operator = Field(default=Operator(), description="Who does the trials")
    tasks: tuple[Annotated[TaskEntry, BeforeValidator(_name_alone)], ...] = Field(
        min_length=1, max_length=50, description="Tasks, each in blocks of its own"
    )
    factors: dict[str, Annotated[Factor, BeforeValidator(_levels_alone)]] = Field(
        default={},
        description="Factors by name: law, round_trip_ms, delay_ms, network, a dotted key, or task.PARAMETER",
    )
    repetitions: int = Field(default=1, ge=1, le=10_000, description="How often a condition comes in a block")
    order: OrderKind = Field(default="shuffle", description="Order of the conditions of a block")
    blocks: Blocks = Field(default=Blocks(), description="What is held for a block")
    practice: Practice = Field(default=Practice(), description="Trials that do not count")
    breaks: Breaks = Field(default=Breaks(), description="Rests")
    disturbed: Disturbed = Field(default=Disturbed(), description="Trials that are repeated")
    stop: Stop = Field(default=Stop(), description="What ends a run early")
    questionnaires: dict[str, tuple[Item, ...]] = Field(default={}, description="Instruments of one's own, by name")
    ask: tuple[Asked, ...] = Field(default=(), description="Instruments of questions, and when they are asked")

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if unknown := sorted(set(self.blocks.factors) - set(self.factors)):
            raise ValueError(f"blocks.factors: {unknown[0]} is no factor; {known_names(unknown[0], self.factors)}")
        adaptive = [name for name, factor in self.factors.items() if factor.adaptive is not None]
        if len(adaptive) > 1:
            raise ValueError(f"factors: {', '.join(adaptive)} are adaptive; a trial can have one such factor")
        if len(_DELAYS.keys() & self.factors.keys()) > 1:
            raise ValueError("factors: round_trip_ms and delay_ms are the same delay: give one of them")
        for asked in self.ask:
            if asked.instrument not in self.instruments:
                raise ValueError(
                    f"ask: {asked.instrument} is no instrument; {known_names(asked.instrument, self.instruments)}"
                )
        if len({task.name for task in self.tasks}) < len(self.tasks):
            raise ValueError("tasks: each may be there once")
        for name in self.pseudonyms:
            if not re.fullmatch(re.escape(self.pseudonym) + r"\d{1,6}", name):
                raise ValueError(f"participants: {name!r} is no pseudonym: it has to be {self.pseudonym} and a number")
        if len(set(self.pseudonyms)) < len(self.pseudonyms):
            raise ValueError("participants: each may be there once")
        return self

    @property
    def instruments(self) -> dict[str, tuple[Question, ...]]:
        """The instruments that can be asked, by name."""
        own = {name: tuple(item.question() for item in items) for name, items in self.questionnaires.items()}
        return {**INSTRUMENTS, **own}

    @property
    def pseudonyms(self) -> tuple[str, ...]:
        """The participants in the order in which the design counts them."""
        if isinstance(self.participants, tuple):
            return self.participants
        return tuple(f"{self.pseudonym}{number:02d}" for number in range(1, self.participants + 1))


Condition = dict[str, Scalar]


@dataclass(frozen=True)
class Plan:
    """An experiment whose file was read, with its tasks.

    Args:
        experiment: The content of the file.
        path: The file.
        tasks: The tasks by name.
    """

    experiment: Experiment
    path: Path
    tasks: Mapping[str, Task]

    @cached_property
    def digest(self) -> str:
        """Digest of the content, 16 hex digits: two files of equal content are one experiment."""
        return hashlib.sha256(self.experiment.model_dump_json().encode()).hexdigest()[:16]

    @cached_property
    def scenario(self) -> dict[str, Any]:
        """The scenario that every trial begins from, with absolute file names."""
        name = self.experiment.scenario
        beside = self.path.parent / name
        path = beside if beside.is_file() else find_scenario(name)
        return anchored(read_yaml(path), path.resolve().parent)

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """The parameters of each task, checked, without those that are factors."""
        return {entry.name: self._checked(number, entry, {}) for number, entry in enumerate(self.experiment.tasks)}

    def _checked(self, number: int, entry: TaskEntry, changed: Mapping[str, Any]) -> dict[str, Any]:
        model = self.tasks[entry.name].parameters
        found = validate(model, {**entry.parameters, **changed}, str(self.path), f"tasks.{number}.parameters")
        return dict(found.model_dump(mode="json"))

    @property
    def adaptive(self) -> str:
        """The name of the adaptive factor; empty where there is none."""
        return next((name for name, factor in self.experiment.factors.items() if factor.adaptive is not None), "")

    @property
    def method(self) -> dict[str, Any]:
        """The settings of the adaptive method; empty where there is none."""
        return dict(self.experiment.factors[self.adaptive].adaptive or {}) if self.adaptive else {}

    @cached_property
    def block_factors(self) -> tuple[str, ...]:
        """The factors that are held for a block: those that the file says, and those that need the rig to start."""
        held = set(self.experiment.blocks.factors) | set(self.restarting)
        return tuple(name for name in self.experiment.factors if name in held)

    @cached_property
    def restarting(self) -> tuple[str, ...]:
        """The factors with a key that a running rig does not take."""
        return tuple(
            name
            for name, factor in self.experiment.factors.items()
            if not all(changes_while_running(key) for level in factor.names or (0.0,) for key in self.keys(name, level))
        )

    @cached_property
    def trial_factors(self) -> tuple[str, ...]:
        """The factors whose level may differ from trial to trial, without the adaptive one."""
        others = (*self.block_factors, self.adaptive)
        return tuple(name for name in self.experiment.factors if name not in others)

    def keys(self, name: str, level: Scalar) -> dict[str, Any]:
        """Return the dotted keys that a level of a factor means; none of a parameter of the task."""
        factor = self.experiment.factors[name]
        if isinstance(factor.levels, dict):
            return dict(factor.levels[str(level)])
        key = factor.key or SHORT_NAMES.get(name, name)
        if key in _DELAYS:
            one_way_s = float(level) * _DELAYS[key]
            return {"delay_node.forward.delay_s": one_way_s, "delay_node.backward.delay_s": one_way_s}
        return {} if key.startswith(_OF_TASK) else {key: level}

    def of_task(self, condition: Mapping[str, Scalar]) -> dict[str, Any]:
        """Return the parameters of the task that a condition sets."""
        keys = {name: self.experiment.factors[name].key or name for name in condition}
        return {key.removeprefix(_OF_TASK): condition[n] for n, key in keys.items() if key.startswith(_OF_TASK)}

    def settings(self, condition: Mapping[str, Scalar]) -> dict[str, Any]:
        """Return the dotted keys that hold in a condition."""
        found = dict(flatten(nested(self.experiment.settings, f"{self.path}: settings")))
        for name, level in condition.items():
            found |= self.keys(name, level)
        return found

    def conditions(self, names: Sequence[str]) -> list[Condition]:
        """Return all combinations of the levels of some factors."""
        levels = [self.experiment.factors[name].names for name in names]
        return [dict(zip(names, found, strict=True)) for found in itertools.product(*levels)]

    @cached_property
    def block_conditions(self) -> list[tuple[str, Condition]]:
        """The blocks of a session, as the file has them: the task and the levels that are held."""
        held = self.conditions(self.block_factors)
        return [(task.name, condition) for task in self.experiment.tasks for condition in held]

    @cached_property
    def within_block(self) -> list[Condition]:
        """The conditions within a block, as the file has them."""
        return self.conditions(self.trial_factors)

    @property
    def rounds(self) -> int:
        """How often each condition comes in a block, at most so often where a method decides."""
        return most_trials(self.method) if self.adaptive else self.experiment.repetitions

    def sequences(self, number: int, session: int) -> list[tuple[int, ...]]:
        """Return the order of conditions in each repetition of a block, of the participant of that number."""
        first = (number * self.experiment.sessions + session - 1) * self.rounds
        return [
            self._sequence(self.experiment.order, self.within_block, first + r, "within") for r in range(self.rounds)
        ]

    def _sequence(self, kind: OrderKind, things: Sequence[Any], number: int, what: str) -> tuple[int, ...]:
        return sequence(kind, len(things), number, f"{self.experiment.seed}/{what}")

    def trials(self, participant: str) -> list[Trial]:
        """Return the trials of a participant, in their order over all sessions."""
        number = self.experiment.pseudonyms.index(participant)
        found: list[Trial] = []
        for session in range(1, self.experiment.sessions + 1):
            found += self._session(participant, number, session, len(found))
        return found

    def _session(self, participant: str, number: int, session: int, first: int) -> Iterator[Trial]:
        order = self._sequence(
            self.experiment.blocks.order,
            self.block_conditions,
            number * self.experiment.sessions + session - 1,
            "blocks",
        )
        rows = self.sequences(number, session)
        practised: set[str] = set()
        count = itertools.count(first)
        blocks = itertools.count()
        for place in order:
            task, held = self.block_conditions[place]
            if self.experiment.practice.trials and task not in practised:
                block = next(blocks)
                turns = itertools.islice(itertools.cycle(rows[0]), self.experiment.practice.trials)
                for turn in turns:
                    condition = {**held, **self.within_block[turn]}
                    yield self._trial(participant, session, block, next(count), "practice", task, condition)
            practised.add(task)
            block = next(blocks)
            for turn in itertools.chain.from_iterable(rows):
                condition = {**held, **self.within_block[turn]}
                yield self._trial(participant, session, block, next(count), "main", task, condition)

    def _trial(
        self, participant: str, session: int, block: int, index: int, phase: str, task: str, condition: Condition
    ) -> Trial:
        ordered = {name: condition[name] for name in self.experiment.factors if name in condition}
        return Trial(
            participant=participant,
            session=session,
            block=block,
            index=index,
            phase=phase,
            task=task,
            task_parameters={**self.parameters[task], **self.of_task(ordered)},
            condition=ordered,
            settings=self.settings(ordered),
            seed=seed_of(self.experiment.seed, participant, index),
        )

    def with_level(self, trial: Trial, level: Scalar) -> Trial:
        """Return a trial with the level that the adaptive method chose."""
        condition = {**trial.condition, self.adaptive: level}
        return trial._replace(
            condition=condition,
            settings=self.settings(condition),
            task_parameters={**self.parameters[trial.task], **self.of_task(condition)},
        )

    def document(self, settings: Mapping[str, Any], origin: str) -> dict[str, Any]:
        """Return the scenario with dotted keys changed, not yet checked."""
        keys = {key: value for key, value in settings.items() if key != PICTURE_DELAY}
        document = merge(self.scenario, nested(keys, origin))
        hand = document.get("haptic_node", {})
        if self.experiment.operator.kind == "person" and hand.get("driver", "simulated").startswith("simulated"):
            # The hand of a simulated device is the person at the page.
            interactive = {"kind": "interactive"}
            given = hand.get("operator", {})
            operator = given if given.get("kind") == "interactive" else interactive
            document["haptic_node"] = {**hand, "operator": operator}
        return document

    def balance(self) -> Balance:
        """Count places and neighbours of the conditions in the blocks of all participants."""
        rows = [
            row
            for number in range(len(self.experiment.pseudonyms))
            for session in range(1, self.experiment.sessions + 1)
            for row in self.sequences(number, session)
        ]
        return balance(rows, len(self.within_block))

    @property
    def complete_after(self) -> int:
        """After how many participants the order of conditions is balanced as far as its design goes."""
        sequences = sequences_of_design(self.experiment.order, len(self.within_block))
        each = self.rounds * self.experiment.sessions
        return sequences // math.gcd(sequences, each)


def seed_of(seed: int, participant: str, index: int) -> int:
    """Return the seed of a trial, below 2**32."""
    return _number(f"{seed}/{participant}/{index}")


def attempt_seed(seed: int, attempt: int) -> int:
    """Return the seed of an attempt at a trial; the first one has that of the trial."""
    return seed if attempt == 0 else _number(f"{seed}/{attempt}")


def _number(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "big")


def load_plan(path: Path, known: Mapping[str, Task] | None = None) -> Plan:
    """Read and check the file of an experiment, with every condition that it asks for.

    Args:
        path: The file.
        known: The tasks that there are, by name; those of the project and of packages unless given.

    Raises:
        ConfigError: Something is wrong; the message names file and key, and what would be right.
    """
    experiment = validate(Experiment, read_yaml(path), str(path))
    known = TASKS if known is None else known
    for number, entry in enumerate(experiment.tasks):
        if entry.name not in known:
            raise ConfigError(
                f"{path}: tasks.{number}.name: {entry.name}: is no task; {known_names(entry.name, known)}"
            )
    plan = Plan(experiment, path, {entry.name: known[entry.name] for entry in experiment.tasks})
    _check_design(plan)
    for task, held in plan.block_conditions:
        for condition in plan.within_block:
            _check_condition(plan, task, {**held, **condition})
    return plan


def _check_design(plan: Plan) -> None:
    if plan.adaptive:
        checked(plan.method, f"{plan.path}: factors.{plan.adaptive}.adaptive")
    experiment, size = plan.experiment, len(plan.within_block)
    if experiment.order == "counterbalanced" and size > MOST_PERMUTED:
        text = f"{size} conditions have {math.factorial(size)} orders; take latin_square"
        raise ConfigError(f"{plan.path}: order: counterbalanced: {text}")
    if experiment.blocks.order == "counterbalanced" and len(plan.block_conditions) > MOST_PERMUTED:
        raise ConfigError(
            f"{plan.path}: blocks.order: counterbalanced: {len(plan.block_conditions)} blocks are too many"
        )
    total = len(plan.block_conditions) * size * plan.rounds * experiment.sessions
    if total > _MOST_TRIALS:
        raise ConfigError(f"{plan.path}: {total} trials of a participant are more than {_MOST_TRIALS}")
    if plan.adaptive and plan.adaptive in plan.restarting:
        text = "the rig would have to be started for every trial"
        raise ConfigError(
            f"{plan.path}: factors.{plan.adaptive}: an adaptive factor needs a key that `set` takes: {text}"
        )
    if plan.adaptive and plan.adaptive in experiment.blocks.factors:
        raise ConfigError(f"{plan.path}: blocks.factors: {plan.adaptive} is adaptive and differs from trial to trial")
    for number, entry in enumerate(experiment.tasks):
        measures = [measure.name for measure in plan.tasks[entry.name].measures]
        wanted = experiment.factors[plan.adaptive].measure if plan.adaptive else ""
        if wanted and wanted not in measures:
            text = f"task {entry.name} has no measure {wanted!r}; {known_names(wanted, measures)}"
            raise ConfigError(f"{plan.path}: factors.{plan.adaptive}.measure, tasks.{number}: {text}")


def _check_condition(plan: Plan, task: str, condition: Condition) -> None:
    """Check the scenario that a condition makes; the error names the levels with which it was wrong."""
    entry = next(entry for entry in plan.experiment.tasks if entry.name == task)
    levels = ", ".join(f"{name} = {level}" for name, level in condition.items())
    origin = f"{plan.path}" + (f" ({levels})" if levels else "")
    try:
        parameters = plan._checked(plan.experiment.tasks.index(entry), entry, plan.of_task(condition))
    except ConfigError as error:
        raise ConfigError(f"{error}" + (f" ({levels})" if levels else "")) from error
    checked_document(plan, task, parameters, plan.settings(condition), 0, origin)


def checked_document(
    plan: Plan, task: str, parameters: Mapping[str, Any], settings: Mapping[str, Any], seed: int, origin: str
) -> dict[str, Any]:
    """Return the scenario of a trial: that of the file, the task's own keys, and over them those of the condition.

    Raises:
        ConfigError: A node would refuse its section; the message names the origin and the key.
    """
    own = plan.tasks[task]
    needed = own.settings(parameters_of(own, parameters), seed)
    document = plan.document({**needed, **settings}, origin)
    check_sections(LoadedScenario(validate(Scenario, document, origin), origin, document))
    return document


def parameters_of(task: Task, values: Mapping[str, Any]) -> Any:
    """Return the parameters of a task as its own model, from plain values that were checked."""
    return task.parameters.model_validate_json(json.dumps(dict(values)))
