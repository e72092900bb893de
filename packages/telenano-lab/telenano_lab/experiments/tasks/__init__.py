"""The tasks that an experiment can name: those of the project, and those of installed packages (`telenano.tasks`)."""

from typing import Any

from pydantic import BaseModel

from telenano.settings import load
from telenano_lab.experiments.extend import Measure, Task
from telenano_lab.experiments.tasks.detect_contact import DETECT_CONTACT
from telenano_lab.experiments.tasks.discriminate_stiffness import DISCRIMINATE_STIFFNESS
from telenano_lab.experiments.tasks.follow_profile import FOLLOW_PROFILE
from telenano_lab.experiments.tasks.push_particle import PUSH_PARTICLE
from telenano_lab.experiments.tasks.touch_and_hold import TOUCH_AND_HOLD
from telenano_lab.experiments.tasks.track import TRACK

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
    """Return the task of a package's entry point; TypeError or ValueError names its fault."""
    absent = [method for method in _METHODS if not callable(getattr(value, method, None))]
    if absent:
        raise TypeError(f"a task has {', '.join(absent)} as well: begin with telenano_lab.experiments.extend.Plain")
    if value.name != name:
        raise ValueError(f"is registered under another name than its own, {value.name}")
    if not (isinstance(value.parameters, type) and issubclass(value.parameters, BaseModel)):
        raise TypeError("parameters must be a class of settings, telenano_lab.experiments.extend.Parameters")
    if not value.measures or not all(isinstance(measure, Measure) for measure in value.measures):
        raise TypeError("measures must be a tuple of Measure(name, unit, description)")
    return value  # type: ignore[no-any-return]


INSTALLED = load("tasks", checked, tuple(task.name for task in OWN_TASKS))
TASKS: dict[str, Task] = {task.name: task for task in OWN_TASKS} | INSTALLED.found
