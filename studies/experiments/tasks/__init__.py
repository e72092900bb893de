"""The tasks that an experiment may name: those of the project, and those of installed packages (`telenano.tasks`)."""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from presets.plugins import load
from proto.errors import ConfigError
from services.runtime.settings.config import validate
from studies.experiments.tasks.base import Measure, Parameters, Task
from studies.experiments.tasks.detect_contact import DETECT_CONTACT
from studies.experiments.tasks.discriminate_stiffness import DISCRIMINATE_STIFFNESS
from studies.experiments.tasks.follow_profile import FOLLOW_PROFILE
from studies.experiments.tasks.push_particle import PUSH_PARTICLE
from studies.experiments.tasks.touch_and_hold import TOUCH_AND_HOLD
from studies.experiments.tasks.track import TRACK

OWN_TASKS: tuple[Task, ...] = (
    TOUCH_AND_HOLD,
    DETECT_CONTACT,
    DISCRIMINATE_STIFFNESS,
    TRACK,
    FOLLOW_PROFILE,
    PUSH_PARTICLE,
)
_METHODS = (
    "duration_s",
    "instruction",
    "target",
    "band",
    "settings",
    "intervals",
    "questions",
    "questions_during",
    "judge",
)


def checked(name: str, value: Any) -> Task:
    """Return the task that an entry of a package is; TypeError or ValueError says what is wrong with it."""
    absent = [method for method in _METHODS if not callable(getattr(value, method, None))]
    if absent:
        raise TypeError(f"a task has {', '.join(absent)} as well: begin with telenano.extend.tasks.Plain")
    if value.name != name:
        raise ValueError(f"calls itself {value.name}")
    if not (isinstance(value.parameters, type) and issubclass(value.parameters, BaseModel)):
        raise TypeError("parameters must be a class of settings, telenano.extend.tasks.Parameters")
    if not value.measures or not all(isinstance(measure, Measure) for measure in value.measures):
        raise TypeError("measures must be a tuple of Measure(name, unit, description)")
    return value  # type: ignore[no-any-return]


INSTALLED = load("tasks", checked, tuple(task.name for task in OWN_TASKS))
TASKS: dict[str, Task] = {task.name: task for task in OWN_TASKS} | INSTALLED.found


def task_named(name: str, parameters: Mapping[str, Any], origin: str, section: str = "") -> tuple[Task, Parameters]:
    """Return a task with its parameters.

    Args:
        name: The name of the task.
        parameters: Its parameters as a file has them.
        origin: The file, for the message of an error.
        section: The key of the parameters in it.

    Raises:
        ConfigError: No such task is there, or a parameter is wrong; the message names file and key.
    """
    if name not in TASKS:
        problem = INSTALLED.problems.get(name, f"{name}: is no task; there are {', '.join(TASKS)}")
        raise ConfigError(f"{origin}: {section + '.' if section else ''}name: {problem}")
    task = TASKS[name]
    return task, validate(task.parameters, dict(parameters), origin, section)
