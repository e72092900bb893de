"""The plan of an experiment: one YAML file, and the list of trials of each participant that follows from it."""

import hashlib
import itertools
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from telenano.launcher import check_files, check_sections
from telenano.settings import LoadedScenario, anchored, find_scenario, flatten, merge, nested, read_yaml, validate
from telenano.wire import ConfigError, Scalar, known_names
from telenano_lab.experiments.experiment_file import DELAYS, IN_BRACES, Experiment, Picture, TaskEntry
from telenano_lab.experiments.extend import Task
from telenano_lab.experiments.operators import Profile
from telenano_lab.experiments.orders import (
    MOST_PERMUTED,
    Balance,
    OrderKind,
    balance,
    sequence,
    sequences_of_design,
)
from telenano_lab.experiments.psychophysics.methods import checked, extreme_levels, most_trials
from telenano_lab.experiments.tasks import INSTALLED, TASKS
from telenano_lab.experiments.types import Trial

# Short names of factors, and the keys that they set.
SHORT_NAMES = {"law": "controller.law", "network": "delay_node.profile"}
_OF_TASK = "task."
# Delay of the participant's picture, apart from that of the force [s]; it is no key of a scenario.
PICTURE_DELAY = "picture.delay_s"
# Keys that a running rig accepts by `set`, by section; all others need a restart.
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
        """Digest of the content, 16 hex digits: two files of equal content are the same experiment."""
        return hashlib.sha256(self.experiment.model_dump_json().encode()).hexdigest()[:16]

    @cached_property
    def scenario(self) -> dict[str, Any]:
        """The base scenario of every trial, with absolute file names."""
        path = self.scenario_file
        try:
            return anchored(read_yaml(path), Path(os.path.realpath(path)).parent)
        except ConfigError as error:
            raise ConfigError(f"{self.path}: scenario: {error}") from error

    @cached_property
    def scenario_file(self) -> Path:
        """The file of the base scenario: one beside the plan comes before a known name."""
        beside = self.path.parent / self.experiment.scenario
        try:
            # `Path.is_file` raises for a name that is too long.
            return beside if os.path.isfile(beside) else find_scenario(self.experiment.scenario)  # noqa: PTH113
        except ConfigError as error:
            raise ConfigError(f"{self.path}: scenario: {error}") from error

    @property
    def each_condition(self) -> Iterator[tuple[str, Condition]]:
        """Each task with each of its conditions, block by block."""
        for task, held in self.block_conditions:
            for condition in self.within_block:
                yield task, {**held, **condition}

    def extremes(self, condition: Condition) -> list[Condition]:
        """Return a condition with the least and the greatest level of the adaptive factor; as it is without one."""
        if not self.adaptive:
            return [condition]
        return [{**condition, self.adaptive: level} for level in extreme_levels(self.method)]

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """The parameters of each task, checked, without those that are factors."""
        return {entry.name: self._checked(number, entry, {}) for number, entry in enumerate(self.experiment.tasks)}

    def _checked(self, number: int, entry: TaskEntry, changed: Mapping[str, Any]) -> dict[str, Any]:
        model = self.tasks[entry.name].parameters
        parameters = validate(model, {**entry.parameters, **changed}, str(self.path), f"tasks.{number}.parameters")
        return dict(parameters.model_dump(mode="json"))

    @property
    def adaptive(self) -> str:
        """The name of the adaptive factor; empty if there is none."""
        return next((name for name, factor in self.experiment.factors.items() if factor.adaptive is not None), "")

    @property
    def method(self) -> dict[str, Any]:
        """The settings of the adaptive method; empty if there is none."""
        return dict(self.experiment.factors[self.adaptive].adaptive or {}) if self.adaptive else {}

    @cached_property
    def block_factors(self) -> tuple[str, ...]:
        """The factors that are constant within a block: those that the file names, and those that need a restart."""
        held = set(self.experiment.blocks.factors) | set(self.restarting)
        return tuple(name for name in self.experiment.factors if name in held)

    @cached_property
    def restarting(self) -> tuple[str, ...]:
        """The factors with a key that a running rig does not accept."""
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
        """Return the dotted keys that a level of a factor sets; none for a parameter of the task."""
        factor = self.experiment.factors[name]
        if isinstance(factor.levels, dict):
            return dict(factor.levels[str(level)])
        key = factor.key or SHORT_NAMES.get(name, name)
        if key in DELAYS:
            if isinstance(level, bool | str):
                raise ConfigError(
                    f"{self.path}: factors.{name}: {level!r} is not a number; write it without a unit, in ms"
                )
            one_way_s = float(level) * DELAYS[key]
            return {"delay_node.forward.delay_s": one_way_s, "delay_node.backward.delay_s": one_way_s}
        return {} if key.startswith(_OF_TASK) else {key: level}

    def of_task(self, condition: Mapping[str, Scalar]) -> dict[str, Any]:
        """Return the parameters of the task that a condition sets."""
        keys = {name: self.experiment.factors[name].key or name for name in condition}
        return {key.removeprefix(_OF_TASK): condition[n] for n, key in keys.items() if key.startswith(_OF_TASK)}

    def settings(self, condition: Mapping[str, Scalar]) -> dict[str, Any]:
        """Return the dotted keys and values of a condition."""
        values = dict(flatten(nested(self.experiment.settings, f"{self.path}: settings")))
        for name, level in condition.items():
            values |= self.keys(name, level)
        return values

    def conditions(self, names: Sequence[str]) -> list[Condition]:
        """Return all combinations of the levels of some factors."""
        levels = [self.experiment.factors[name].names for name in names]
        return [dict(zip(names, levels_chosen, strict=True)) for levels_chosen in itertools.product(*levels)]

    @cached_property
    def block_conditions(self) -> list[tuple[str, Condition]]:
        """The blocks of a session in the order of the file: the task and the levels that are constant."""
        held = self.conditions(self.block_factors)
        return [(task.name, condition) for task in self.experiment.tasks for condition in held]

    @cached_property
    def within_block(self) -> list[Condition]:
        """The conditions within a block, in the order of the file."""
        return self.conditions(self.trial_factors)

    def number(self, trial: Trial) -> int:
        """Return the number of a trial's condition, from 1: by blocks in the order of the file, then within them.

        The level that an adaptive method chooses does not matter.
        """
        held = {name: trial.condition[name] for name in self.block_factors}
        within = {name: trial.condition[name] for name in self.trial_factors}
        block = self.block_conditions.index((trial.task, held))
        return 1 + block * len(self.within_block) + self.within_block.index(within)

    @property
    def rounds(self) -> int:
        """The number of repetitions of each condition in a block; with an adaptive method, the greatest number."""
        return most_trials(self.method) if self.adaptive else self.experiment.repetitions

    def sequences(self, number: int, session: int) -> list[tuple[int, ...]]:
        """Return the order of conditions in each repetition of a block, for the participant with that number."""
        first = (number * self.experiment.sessions + session - 1) * self.rounds
        return [
            self._sequence(self.experiment.order, self.within_block, first + r, "within") for r in range(self.rounds)
        ]

    def _sequence(self, kind: OrderKind, things: Sequence[Any], number: int, what: str) -> tuple[int, ...]:
        return sequence(kind, len(things), number, f"{self.experiment.seed}/{what}")

    def trials(self, participant: str) -> list[Trial]:
        """Return the trials of a participant, in their order over all sessions."""
        number = self.experiment.pseudonyms.index(participant)
        planned: list[Trial] = []
        for session in range(1, self.experiment.sessions + 1):
            planned += self._session(participant, number, session, len(planned))
        return planned

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
            # A person at the page is the hand of a simulated device.
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
        """The number of participants after which the order of conditions is balanced as far as its design goes."""
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


def load_plan(path: Path, tasks: Mapping[str, Task] | None = None) -> Plan:
    """Read and check the file of an experiment, with all of its conditions.

    Args:
        path: The file.
        tasks: The available tasks by name; None for those of the project and of packages.

    Raises:
        ConfigError: Something is wrong; the message names file and key, and what would be right.
    """
    experiment = validate(Experiment, read_yaml(path), str(path))
    tasks = TASKS if tasks is None else tasks
    for number, entry in enumerate(experiment.tasks):
        if entry.name not in tasks:
            absent = f"{entry.name}: is not a task; {known_names(entry.name, tasks)}"
            raise ConfigError(f"{path}: tasks.{number}.name: {INSTALLED.problems.get(entry.name, absent)}")
    plan = Plan(experiment, path, {entry.name: tasks[entry.name] for entry in experiment.tasks})
    _check_design(plan)
    _check_words(plan)
    if plan.experiment.operator.kind == "simulated":
        validate(Profile, dict(plan.experiment.operator.profile), str(path), "operator.profile")
    scenario = plan.scenario
    for task, condition in plan.each_condition:
        for extreme in plan.extremes(condition):
            _check_condition(plan, task, extreme, scenario)
    _check_overridden(plan)
    return plan


def check_files_of(plan: Plan) -> None:
    """Raise ConfigError for the first file that a trial would read and that is not there, or cannot be used.

    A plan is read without these files too, because a run is analysed on other machines than that of the rig.
    """
    for task, condition in plan.each_condition:
        origin = _origin(plan, condition)
        parameters = {**plan.parameters[task], **plan.of_task(condition)}
        document = checked_document(plan, task, parameters, plan.settings(condition), 0, origin)
        check_files(LoadedScenario.of(document, origin))


def _check_words(plan: Plan) -> None:
    """Raise ConfigError for words of a question that a task does not ask, or with a wrong number of options."""
    for number, entry in enumerate(plan.experiment.tasks):
        task, words = plan.tasks[entry.name], plan.experiment.words.tasks.get(entry.name)
        if words is None:
            continue
        parameters = parameters_of(task, plan._checked(number, entry, {}))
        for name in IN_BRACES.findall(words.instruction):
            if name not in (known := task.parameters.model_fields):
                text = f"{{{name}}} is not a parameter of the task; {known_names(name, known)}"
                raise ConfigError(f"{plan.path}: words.tasks.{entry.name}.instruction: {text}")
        asked = {one.name: one for one in (*task.questions(parameters), *task.questions_during(parameters))}
        for name, own in words.questions.items():
            where = f"{plan.path}: words.tasks.{entry.name}.questions.{name}"
            if name not in asked:
                raise ConfigError(f"{where}: is not asked by the task; {known_names(name, asked)}")
            options = asked[name].options
            if own.options and len(own.options) != len(options):
                raise ConfigError(f"{where}.options: has {len(own.options)} words for {', '.join(options) or 'none'}")


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
        criterion = experiment.practice.until.get(entry.name)
        if criterion is not None and criterion.measure not in measures:
            text = f"task {entry.name} has no measure {criterion.measure!r}; {known_names(criterion.measure, measures)}"
            raise ConfigError(f"{plan.path}: practice.until.{entry.name}.measure: {text}")


def _check_condition(plan: Plan, task: str, condition: Condition, scenario: Mapping[str, Any]) -> None:
    """Check the scenario of a condition; an error names the levels that cause it."""
    entry = next(entry for entry in plan.experiment.tasks if entry.name == task)
    levels, origin = _levels_of(condition), _origin(plan, condition)
    try:
        parameters = plan._checked(plan.experiment.tasks.index(entry), entry, plan.of_task(condition))
    except ConfigError as error:
        raise ConfigError(f"{error}" + (f" ({levels})" if levels else "")) from error
    settings = plan.settings(condition)
    if PICTURE_DELAY in settings:
        validate(Picture, {"delay_s": settings[PICTURE_DELAY]}, origin, "picture")
    try:
        checked_document(plan, task, parameters, settings, 0, origin)
    except ConfigError as error:
        if complaints := _of_scenario(plan, scenario, _complaints(error, origin)):
            raise ConfigError(complaints) from error
        raise


def _check_overridden(plan: Plan) -> None:
    """Check the values of `settings` that factors replace in every trial: each as it is without these factors.

    No condition has such a value, so the check of the conditions does not see it. Without a factor, other keys may no
    longer go together; only what is wrong with the value itself counts.
    """
    own, conditions = (
        plan.settings({}),
        [(task, plan.extremes(condition)[0]) for task, condition in plan.each_condition],
    )
    replaced = [{key for item in condition.items() for key in plan.keys(*item)} for _, condition in conditions]
    task, first = conditions[0]
    parameters = {**plan.parameters[task], **plan.of_task(first)}
    for key in own:
        if not all(key in keys for keys in replaced):
            continue
        settings = plan.settings({name: level for name, level in first.items() if key not in plan.keys(name, level)})
        origin = f"{plan.path}: settings"
        if key == PICTURE_DELAY:
            validate(Picture, {"delay_s": own[key]}, origin, "picture")
        try:
            checked_document(plan, task, parameters, settings, 0, origin)
        except ConfigError as error:
            about = (f"{key}:", f"{key}.")
            if of_key := [line for line in sorted(_complaints(error, origin)) if line.startswith(about)]:
                raise ConfigError("\n".join(f"{origin}: {line}" for line in of_key)) from error


def _of_scenario(plan: Plan, scenario: Mapping[str, Any], complaints: set[str]) -> str:
    """Return the errors of the base scenario if they explain the complaints about a condition; otherwise "".

    Such an error names the scenario file, because the plan has no such key.
    """
    origin = f"{plan.path}: scenario: {plan.scenario_file}"
    try:
        check_sections(LoadedScenario.of(dict(scenario), origin))
    except ConfigError as error:
        return str(error) if complaints >= _complaints(error, origin) else ""
    return ""


def _complaints(error: ConfigError, origin: str) -> set[str]:
    """Return the lines of an error, one per key, without the name of the file."""
    return {line.removeprefix(f"{origin}: ") for line in str(error).splitlines()}


def _levels_of(condition: Condition) -> str:
    return ", ".join(f"{name} = {level}" for name, level in condition.items())


def _origin(plan: Plan, condition: Condition) -> str:
    """Return the file of a plan and the levels of a condition, as an error names them."""
    levels = _levels_of(condition)
    return f"{plan.path}" + (f" ({levels})" if levels else "")


def checked_document(
    plan: Plan, task: str, parameters: Mapping[str, Any], settings: Mapping[str, Any], seed: int, origin: str
) -> dict[str, Any]:
    """Return the scenario of a trial: that of the file, overridden by the task's keys, and these by the condition's.

    Raises:
        ConfigError: A node would refuse its section; the message names the origin and the key.
    """
    own = plan.tasks[task]
    needed = own.settings(parameters_of(own, parameters), seed)
    document = plan.document({**needed, **settings}, origin)
    check_sections(LoadedScenario.of(document, origin))
    return document


def parameters_of(task: Task, values: Mapping[str, Any]) -> Any:
    """Return checked plain values as the task's own parameter model."""
    return task.parameters.model_validate_json(json.dumps(dict(values)))
