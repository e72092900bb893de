"""Run the trials of an experiment on an apparatus, and write each outcome to the journal.

The remaining work follows from the plan and the journal alone, so a run that was interrupted anywhere continues with
its current trial. An attempt counts once its outcome is in the journal; no trial is lost or done twice.
"""

import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from telenano.wire import ConfigError
from telenano_lab.experiments.apparatus.base import Apparatus
from telenano_lab.experiments.desk import Desk, Place
from telenano_lab.experiments.journal import NAME, Journal, Record
from telenano_lab.experiments.people import People, Person
from telenano_lab.experiments.plan import Plan, attempt_seed, seed_of
from telenano_lab.experiments.psychophysics.methods import Method, replay
from telenano_lab.experiments.types import Trial, TrialOutcome

_PACKAGES = ("telenano", "numpy", "numba", "scipy")
# Fields of a trial in the journal that decide whether it is over; the tables use other fields as well.
_OUTCOME = ("index", "attempt", "status", "final")


class RunEnd(NamedTuple):
    """The reason why a run ended before its plan was done; empty if it was done."""

    reason: str


class Progress(NamedTuple):
    """The progress of one participant.

    Args:
        outcomes: The records of the attempts at each trial, by index.
        sessions: The numbers of the finished sessions.
        erased: Whether the participant's data were erased.
        excluded: Reason why the participant does not continue; empty otherwise.
    """

    outcomes: Mapping[int, list[Record]]
    sessions: frozenset[int]
    erased: bool
    excluded: str

    def finished(self, trial: Trial) -> bool:
        """Return whether a trial needs no further attempt."""
        return any(record["final"] for record in self.outcomes.get(trial.index, ()))


def progress_of(records: Iterable[Record], participant: str) -> Progress:
    """Fold the records of a journal into the progress of a participant.

    Raises:
        ConfigError: A record does not say whether its trial is over; the message names the trial and the participant.
    """
    outcomes: dict[int, list[Record]] = {}
    sessions: set[int] = set()
    erased, excluded = False, ""
    for record in records:
        if record.get("participant") != participant:
            continue
        kind = record["record"]
        if kind == "trial":
            if missing := [name for name in _OUTCOME if name not in record]:
                lacks = " and no ".join(f"`{name}`" for name in missing)
                text = f"{NAME}: a trial of {participant} at {record.get('utc', 'an unknown time')} has no {lacks}"
                raise ConfigError(f"{text}: restore it from a backup")
            outcomes.setdefault(record["index"], []).append(record)
        elif kind == "session_over":
            sessions.add(record["session"])
        elif kind == "erased":
            erased = True
        elif kind in ("excluded", "included"):
            excluded = record.get("reason", "") if kind == "excluded" else ""
    return Progress(outcomes, frozenset(sessions), erased, excluded)


def still_open(plan: Plan, trials: Sequence[Trial], progress: Progress) -> list[Trial]:
    """Return the unfinished trials, without those of a practice whose criterion is met."""
    met: dict[int, bool] = {}
    for trial in trials:
        if trial.phase == "practice" and trial.block not in met:
            met[trial.block] = practised_enough(plan, trial, trials, progress)
    return [trial for trial in trials if not progress.finished(trial) and not met.get(trial.block)]


def practised_enough(plan: Plan, trial: Trial, trials: Sequence[Trial], progress: Progress) -> bool:
    """Return whether the practice of a trial meets the criterion of its task; False without a criterion."""
    criterion = plan.experiment.practice.until.get(trial.task)
    if criterion is None:
        return False
    mine = [one.index for one in trials if one.block == trial.block and one.session == trial.session]
    done = [record for index in mine for record in progress.outcomes.get(index, ()) if record["status"] == "done"]
    # A disturbed trial is repeated at the end of the block, after trials with a higher index.
    done.sort(key=lambda record: (record["utc"], record["attempt"]))
    return criterion.is_met([record["measures"].get(criterion.measure) for record in done])


class Tracks:
    """The adaptive tracks of one participant, one for each combination of the other factors."""

    def __init__(self, plan: Plan, participant: str) -> None:
        self._plan, self._participant = plan, participant

    def method(self, trial: Trial, progress: Progress) -> Method:
        """Return the state of the method before a trial, from the answers in the journal."""
        plan = self._plan
        cell = self._cell(trial.task, trial.condition)
        answers = []
        for records in progress.outcomes.values():
            for record in records:
                mine = record["phase"] == "main" and self._cell(record["task"], record["condition"]) == cell
                if mine and record["status"] == "done":
                    correct = record["measures"].get(plan.experiment.factors[plan.adaptive].measure)
                    if correct is not None:
                        answers.append((record["utc"], record["condition"][plan.adaptive], bool(correct)))
        seed = seed_of(plan.experiment.seed, self._participant + cell, 0)
        origin = ((float(level), correct) for _, level, correct in sorted(answers))
        return replay(plan.method, seed, origin)

    def _cell(self, task: str, condition: Mapping[str, Any]) -> str:
        others = {name: level for name, level in condition.items() if name != self._plan.adaptive}
        return f"{task} {sorted(others.items())}"


class Runner:
    """Runs an experiment.

    Args:
        plan: The experiment.
        journal: The journal, open.
        people: The participants.
        apparatus: The apparatus of the trials.
        desk: Communicates with participant and experimenter.
        show: Called with a line about each event.
    """

    def __init__(
        self,
        plan: Plan,
        journal: Journal,
        people: People,
        apparatus: Apparatus,
        desk: Desk,
        show: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.plan, self.journal, self.people = plan, journal, people
        self.apparatus, self.desk, self._show = apparatus, desk, show
        self._disturbed = 0
        self._begun_s = 0.0
        self._instructed = ""

    def begin(self) -> None:
        """Record that a run begins; ConfigError if the experiment's file has changed since its first run."""
        begun = next(self.journal.of("begun"), None)
        if begun is not None and begun["digest"] != self.plan.digest:
            text = f"{self.plan.path} is another experiment than the one in {self.journal.path}"
            raise ConfigError(f"{text}: it was changed since; run it in a folder of its own")
        self._note_interrupted()
        facts = {
            "digest": self.plan.digest,
            "name": self.plan.experiment.name,
            "seed": self.plan.experiment.seed,
            "apparatus": self.plan.experiment.apparatus,
            "versions": versions(),
        }
        self.journal.write("begun" if begun is None else "resumed", **facts)

    def _note_interrupted(self) -> None:
        trying = None
        for record in self.journal.of("trying", "trial", "interrupted"):
            trying = record if record["record"] == "trying" else None
        if trying is not None:
            facts = {key: trying[key] for key in ("participant", "index", "attempt")}
            self.journal.write("interrupted", **facts)
            self._show(f"trial {trying['index']} of {trying['participant']} was interrupted and is done again")

    def run(self, participants: Sequence[str]) -> RunEnd:
        """Run the sessions of the participants, of a person only the next one.

        Raises:
            ConfigError: A participant may not take part.
            RigError: The apparatus cannot continue; everything until then is in the journal.
        """
        is_person, ended = self.plan.experiment.operator.kind == "person", ""
        for participant in participants:
            progress = progress_of(self.journal.records, participant)
            if progress.erased or progress.excluded:
                self._show(f"{participant} is left out: {progress.excluded or 'the data were erased'}")
                continue
            trials = self.plan.trials(participant)
            for session in range(1, self.plan.experiment.sessions + 1):
                mine = [trial for trial in trials if trial.session == session]
                if session in progress.sessions:
                    continue
                reason = ended = self._session(participant, session, mine)
                if reason:
                    self.journal.write("stopped", participant=participant, reason=reason)
                    # A participant who missed the criterion of a practice does not stop the next one.
                    if progress_of(self.journal.records, participant).excluded and self.desk.action != "exclude":
                        break
                    return RunEnd(reason)
                if is_person:
                    break
        if not remaining(self.plan, self.journal.records):
            self.journal.write("ended")
        return RunEnd(ended)

    def _session(self, participant: str, session: int, trials: list[Trial]) -> str:
        """Run a session; return the reason why it ended before its plan did, or an empty string."""
        self.journal.write("participant", participant=participant, session=session)
        self._begun_s, self._disturbed, self._instructed = time.monotonic(), 0, ""
        last: Trial | None = None
        in_block = 0
        if not self._agrees(participant, trials):
            return f"{participant} did not agree to take part"
        while True:
            progress = progress_of(self.journal.records, participant)
            trial = self._next(trials, progress)
            if reason := self._practised(trials, progress, trial):
                if last is not None:
                    self.desk.finish()
                return reason
            if last is not None and (trial is None or trial.block != last.block):
                self._ask("block", last)
            if trial is None:
                break
            if last is not None:
                in_block = in_block + 1 if trial.block == last.block else 0
                self._rest(participant, last, trial, in_block)
            if reason := self._stop_rule(participant):
                return reason
            outcome, last = self._attempt(trial, trials, progress), trial
            if reason := self._after(trial, outcome):
                return reason
        if last is not None:
            self._ask("session", last)
            self.desk.finish()
        self.journal.write("session_over", participant=participant, session=session)
        return ""

    def _practised(self, trials: Sequence[Trial], progress: Progress, following: Trial | None) -> str:
        """Record the end of each practice with a criterion; return a reason if the session ends, else ""."""
        practice = self.plan.experiment.practice
        noted = {(r["participant"], r["session"], r["block"]) for r in self.journal.of("practice")}
        for trial in trials:
            key = (trial.participant, trial.session, trial.block)
            is_over = following is None or trial.block < following.block
            if trial.phase != "practice" or trial.task not in practice.until or key in noted or not is_over:
                continue
            noted.add(key)
            met = practised_enough(self.plan, trial, trials, progress)
            used = sum(progress.finished(one) for one in trials if one.block == trial.block)
            text = f"{'met' if met else 'did not meet'} the criterion of {trial.task} in {used} practice trials"
            is_out = not met and practice.missed == "exclude"
            if is_out:
                self.people.change(trial.participant, excluded=text)
                self.journal.write("excluded", participant=trial.participant, reason=text)
            # This record comes last, so that a run killed before it excludes again.
            names = dict(zip(("participant", "session", "block"), key, strict=True))
            self.journal.write("practice", **names, task=trial.task, trials=used, met=met)
            self._show(f"{trial.participant} {text}")
            if is_out:
                return f"{trial.participant} was excluded: {text}"
        return ""

    def _agrees(self, participant: str, trials: Sequence[Trial]) -> bool:
        """Return whether a participant takes part: a simulated one does; a person consents once, on paper or page."""
        if self.plan.experiment.operator.kind == "simulated":
            self.people.change(participant, simulated=True)
            return True
        if self.people.known.get(participant, Person()).consent:
            return True
        self.apparatus.prepare(trials[0])
        if self.desk.consent(participant):
            self.people.change(participant, consent=True)
            return True
        return False

    def _next(self, trials: Sequence[Trial], progress: Progress) -> Trial | None:
        """Return the next trial, with the level that an adaptive method chooses; None if all are done."""
        open_ones = still_open(self.plan, trials, progress)
        at_end = self.plan.experiment.disturbed.again == "end_of_block"
        while open_ones:
            block = open_ones[0].block
            of_block = [trial for trial in open_ones if trial.block == block]
            tries = {trial.index: len(progress.outcomes.get(trial.index, ())) if at_end else 0 for trial in of_block}
            trial = min(of_block, key=lambda one: (tries[one.index], one.index))
            if not self.plan.adaptive:
                return trial
            level = Tracks(self.plan, trial.participant).method(trial, progress).next()
            if level is not None:
                return self.plan.with_level(trial, level)
            # The method has ended and needs no more trials of this kind.
            open_ones = [one for one in open_ones if not _same_cell(one, trial)]
        return None

    def _attempt(self, trial: Trial, trials: Sequence[Trial], progress: Progress) -> TrialOutcome:
        attempt = len(progress.outcomes.get(trial.index, ()))
        done = sum(progress.finished(one) for one in trials)
        total = done + len(still_open(self.plan, trials, progress))
        self.desk.place = Place(done, total)
        self._lead(trial)
        self.journal.write("trying", participant=trial.participant, index=trial.index, attempt=attempt)
        tried = trial._replace(seed=attempt_seed(trial.seed, attempt))
        outcome = self.apparatus.run(tried, attempt)
        if self.desk.action == "disturbed":
            outcome = outcome._replace(status="disturbed")
        enough = attempt + 1 >= self.plan.experiment.disturbed.most_attempts
        is_final = outcome.status == "done" or (outcome.status == "disturbed" and enough) or self.desk.action == "skip"
        self.journal.write("trial", **tried._asdict(), attempt=attempt, final=is_final, **outcome._asdict())
        self.desk.over(tried, attempt, outcome)
        self._show(_line(trial, attempt, done + 1, total, outcome))
        return outcome

    def _lead(self, trial: Trial) -> None:
        """Show a person the instruction of a task before its first trial."""
        if self._instructed != trial.task:
            self._instructed = trial.task
            self.apparatus.prepare(trial)
            self.desk.instruct(trial)

    def _after(self, trial: Trial, outcome: TrialOutcome) -> str:
        """Carry out the experimenter's request after a trial; return a reason if the run ends, else an empty string."""
        action, reason = self.desk.action, self.desk.reason
        self._disturbed = self._disturbed + 1 if outcome.status == "disturbed" else 0
        if action == "exclude":
            self.people.change(trial.participant, excluded=reason or "by the experimenter")
            self.journal.write("excluded", participant=trial.participant, reason=reason or "by the experimenter")
            return f"{trial.participant} was excluded"
        if action == "stop":
            return reason or "the experimenter ended the session"
        if action == "pause":
            self.desk.pause()
        self.desk.action = "" if self.desk.action in ("skip", "disturbed", "pause", "resume") else self.desk.action
        if outcome.status == "done":
            self._ask("trial", trial)
        return ""

    def _stop_rule(self, participant: str) -> str:
        rules = self.plan.experiment.stop
        if self._disturbed >= rules.disturbed_in_a_row:
            return f"{self._disturbed} attempts in a row were disturbed: find out why, and resume"
        spent_s = time.monotonic() - self._begun_s
        if rules.session_s is not None and spent_s >= rules.session_s:
            return f"the session of {participant} has lasted {spent_s:.0f} s, and {rules.session_s:g} s are the most"
        return ""

    def _rest(self, participant: str, last: Trial, following: Trial, in_block: int) -> None:
        breaks = self.plan.experiment.breaks
        if last.block != following.block:
            duration_s = breaks.between_blocks_s
        else:
            is_due = breaks.every_trials is not None and in_block % breaks.every_trials == 0
            duration_s = breaks.duration_s if is_due else 0.0
        begun_s = time.monotonic()
        if duration_s > 0.0 and self.desk.rest(duration_s):
            self.journal.write("break", participant=participant, duration_s=time.monotonic() - begun_s)

    def _ask(self, after: str, trial: Trial) -> None:
        for asked in self.plan.experiment.ask:
            if asked.after == after and (items := self.desk.instrument(asked.instrument, trial)) is not None:
                self.journal.write(
                    "asked",
                    participant=trial.participant,
                    session=trial.session,
                    block=trial.block,
                    trial=trial.index if after == "trial" else -1,
                    instrument=asked.instrument,
                    items=dict(items),
                )


def remaining(plan: Plan, records: Sequence[Record]) -> dict[str, int]:
    """Return the number of unfinished trials of each participant who has unfinished trials or sessions."""
    left = {}
    for participant in plan.experiment.pseudonyms:
        progress = progress_of(records, participant)
        if progress.erased or progress.excluded:
            continue
        trials = plan.trials(participant)
        by_session = ([one for one in trials if one.session == n + 1] for n in range(plan.experiment.sessions))
        count = sum(
            len(still_open(plan, mine, progress))
            for mine in by_session
            if mine and mine[0].session not in progress.sessions
        )
        if count or len(progress.sessions) < plan.experiment.sessions:
            left[participant] = count
    return left


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that compute the results."""
    return {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}


def _same_cell(one: Trial, other: Trial) -> bool:
    return (one.task, one.condition, one.block) == (other.task, other.condition, other.block)


def _line(trial: Trial, attempt: int, number: int, total: int, outcome: TrialOutcome) -> str:
    levels = ", ".join(f"{name} = {level}" for name, level in trial.condition.items())
    again = f", attempt {attempt + 1}" if attempt else ""
    what = outcome.status if not outcome.disturbance else f"{outcome.status}: {outcome.disturbance}"
    return f"{trial.participant} {number}/{total} {trial.phase} {trial.task} ({levels}){again}: {what}"


def folder_plan(folder: Path) -> Path:
    """Return the file of the experiment in a folder; ConfigError if there is none."""
    path = folder / "experiment.yaml"
    if not path.is_file():
        raise ConfigError(f"{folder}: has no experiment.yaml: it is not a folder of `telenano experiment run`")
    return path
