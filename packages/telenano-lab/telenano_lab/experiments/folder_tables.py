"""The tables of an experiment's folder, and facts on its making from its file and journal."""

from pathlib import Path
from typing import Any

from telenano.settings import read_yaml, validate
from telenano.wire import ConfigError
from telenano_lab.experiments.experiment_file import Experiment
from telenano_lab.experiments.journal import NAME, read
from telenano_lab.experiments.table import Tables, tidy
from telenano_lab.experiments.tasks import TASKS

FILE = "experiment.yaml"
_ORDERS = {
    "factorial": "that of the full factorial",
    "shuffle": "a shuffle",
    "latin_square": "a Latin square after Williams",
    "counterbalanced": "counterbalanced over participants",
}


def tables_of(folder: Path) -> Tables:
    """Return the tables of an experiment from its journal.

    Raises:
        ConfigError: The folder has no journal, or it cannot be read.
    """
    path = folder / NAME
    if not path.is_file():
        raise ConfigError(f"{folder}: has no {NAME}: name the folder of an experiment that was run")
    return tidy(read(path), describe)


def describe(task: str) -> dict[str, tuple[str, str]]:
    """Return unit and description of each measure of a task; empty if the task is not installed."""
    task_row = TASKS.get(task)
    return {measure.name: (measure.unit, measure.description) for measure in task_row.measures} if task_row else {}


def adaptive_factors(folder: Path) -> dict[str, dict[str, Any]]:
    """Return the settings of the adaptive factors of an experiment, by name."""
    factors = _experiment(folder).factors
    return {name: dict(factor.adaptive) for name, factor in factors.items() if factor.adaptive is not None}


def about_experiment(folder: Path) -> dict[str, Any]:
    """Return facts on an experiment for the methods paragraph."""
    experiment = _experiment(folder)
    records = read(folder / NAME)
    begun: dict[str, Any] = next((record for record in records if record["record"] == "begun"), {})
    simulated = experiment.operator.kind == "simulated"
    kind = "lockstep, in simulated time" if experiment.apparatus == "lockstep" else "a rig of processes"
    return {
        "title": experiment.title or experiment.name,
        "seed": experiment.seed,
        "order": _ORDERS[experiment.order],
        "apparatus": f"{kind}, with {'simulated operators' if simulated else 'people'}, scenario {experiment.scenario}",
        "digest": begun.get("digest", ""),
        "began": begun.get("utc", ""),
    }


def _experiment(folder: Path) -> Experiment:
    path = folder / FILE
    return validate(Experiment, read_yaml(path), str(path))
