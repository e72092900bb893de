"""Summaries of an experiment: trials, time and balance before it is run, and its progress."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from telenano_lab.experiments.journal import Record
from telenano_lab.experiments.plan import Plan, changes_while_running, parameters_of
from telenano_lab.experiments.runner import progress_of, remaining
from telenano_lab.experiments.types import Trial

# A rig needs this time between two trials.
_BETWEEN_S = 5.0
# A rig needs this time to start.
_START_S = 15.0
# Countdown before each trial of a person.
_COUNTDOWN_S = 3.0


def summary_of(plan: Plan) -> dict[str, Any]:
    """Return a summary of an experiment: counts, times [s], where each factor varies, and the balance of its order.

    Times of an adaptive method are those of its longest run.
    """
    experiment = plan.experiment
    trials = plan.trials(experiment.pseudonyms[0])
    balance = plan.balance()
    people = len(experiment.pseudonyms)
    is_live = experiment.apparatus == "live"
    moving = sum(_duration_s(plan, trial) for trial in trials)
    breaks = _breaks_s(plan, trials) if experiment.operator.kind == "person" else 0.0
    each_s = moving + breaks + (_around_s(plan, trials) if is_live else 0.0)
    doubts = []
    if plan.complete_after > 1 and people % plan.complete_after:
        whole = f"a multiple of {plan.complete_after}"
        doubts.append(f"the order is balanced over {whole} participants, and there are {people}")
    return {
        "name": experiment.name,
        "apparatus": experiment.apparatus,
        "operator": experiment.operator.kind,
        "participants": people,
        "sessions": experiment.sessions,
        "tasks": [entry.name for entry in experiment.tasks],
        "conditions": len(plan.block_conditions) * len(plan.within_block),
        "blocks": [{"task": task, **condition} for task, condition in plan.block_conditions],
        "factors_of_blocks": list(plan.block_factors),
        "factors_of_trials": [*plan.trial_factors, *([plan.adaptive] if plan.adaptive else [])],
        "factors_that_start_the_rig": list(plan.restarting),
        "trials_of_a_participant": len(trials),
        "trials": people * len(trials),
        "session_s": round(each_s / experiment.sessions, 1),
        "total_s": round(people * each_s, 1),
        "order": experiment.order,
        "balanced_over_places": balance.over_places,
        "balanced_for_carry_over": balance.over_carry,
        "complete_after_participants": plan.complete_after,
        "doubts": doubts,
    }


def _duration_s(plan: Plan, trial: Trial) -> float:
    task = plan.tasks[trial.task]
    return float(task.duration_s(parameters_of(task, trial.task_parameters)))


def _around_s(plan: Plan, trials: Sequence[Trial]) -> float:
    """Return the time on a rig apart from the trials themselves [s]."""
    intervals, starts = 0, 0
    before: object = None
    for trial in trials:
        task = plan.tasks[trial.task]
        parameters = parameters_of(task, trial.task_parameters)
        for interval in task.intervals(parameters, trial.seed):
            settings = {**task.settings(parameters, trial.seed), **interval.settings, **trial.settings}
            kept = (trial.session, {key: value for key, value in settings.items() if not changes_while_running(key)})
            intervals, starts, before = intervals + 1, starts + (kept != before), kept
    countdown_s = _COUNTDOWN_S * len(trials) if plan.experiment.operator.kind == "person" else 0.0
    return intervals * _BETWEEN_S + starts * _START_S + countdown_s


def _breaks_s(plan: Plan, trials: Sequence[Trial]) -> float:
    breaks = plan.experiment.breaks
    blocks = Counter((trial.session, trial.block) for trial in trials)
    within = sum((count - 1) // breaks.every_trials for count in blocks.values()) if breaks.every_trials else 0
    return within * breaks.duration_s + max(0, len(blocks) - plan.experiment.sessions) * breaks.between_blocks_s


def state_of(plan: Plan, records: Sequence[Record]) -> dict[str, Any]:
    """Return the progress of an experiment, from its journal."""
    left = remaining(plan, records)
    rows = []
    for participant in plan.experiment.pseudonyms:
        progress = progress_of(records, participant)
        attempts = [record for outcomes in progress.outcomes.values() for record in outcomes]
        kinds = Counter(record["status"] for record in attempts)
        done = sum(any(record["final"] for record in outcomes) for outcomes in progress.outcomes.values())
        rows.append(
            {
                "participant": participant,
                "done": done,
                "left": left.get(participant, 0),
                "disturbed": kinds["disturbed"],
                "aborted": kinds["aborted"],
                "sessions": len(progress.sessions),
                "state": _state(progress.erased, progress.excluded, done, left.get(participant)),
            }
        )
    last = records[-1] if records else {}
    return {
        "name": plan.experiment.name,
        "trials_done": sum(row["done"] for row in rows),
        "trials_left": sum(row["left"] for row in rows),
        "ended": any(record["record"] == "ended" for record in records) and not left,
        "last": f"{last.get('record', 'nothing')} at {last.get('utc', '')}",
        "stopped": last.get("reason", "") if last.get("record") == "stopped" else "",
        "participants": rows,
    }


def _state(erased: bool, excluded: str, done: int, left: int | None) -> str:
    if erased:
        return "erased"
    if excluded:
        return f"excluded: {excluded}"
    if left is None:
        return "done"
    return f"half done: {done} of {done + left} trials" if done else "to do"
