"""Communication of an experiment: with nobody, with recorder and experimenter, or with a person at the page."""

import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from telenano_lab.experiments.bus import Answer, ExperimentBus
from telenano_lab.experiments.extend import TrialData
from telenano_lab.experiments.messages import Question
from telenano_lab.experiments.operators import SimulatedParticipant
from telenano_lab.experiments.plan import PICTURE_DELAY, Plan, parameters_of
from telenano_lab.experiments.types import Trial, TrialOutcome

Answers = tuple[Mapping[str, Any], ...]
_COUNTDOWN_S = 3.0
_NOW = ("stop", "exclude", "skip", "disturbed")


class AbortedError(Exception):
    """A trial that the experimenter ended early; the text is the reason."""


class Place(NamedTuple):
    """Progress of a participant in the session: numbers of finished trials and of all trials."""

    done: int = 0
    total: int = 0


class Desk:
    """A desk that tells and asks nobody. `action` is the experimenter's request to the session, or empty."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.action, self.reason = "", ""
        self.place = Place()

    def attach(self, site_file: Path) -> None:
        """Connect to a rig that has come up."""

    def detach(self) -> None:
        """Disconnect from a rig that is about to end."""

    def consent(self, participant: str) -> bool:
        """Return whether a participant agrees to take part; the caller skips those who have agreed before."""
        return False

    def instruct(self, trial: Trial) -> None:
        """Show the participant the instruction of a trial's task and wait until it is read."""

    def begin(self, trial: Trial, attempt: int, *, first: bool) -> None:
        """Count down to a trial and show it; `first` is True for the first of its intervals."""

    def during(self, elapsed_s: float) -> Sequence[Mapping[str, Any]]:
        """Return new answers, each with name, value and given_ns; raise AbortedError to end the trial."""
        return ()

    def over(self, trial: Trial, attempt: int, outcome: TrialOutcome) -> None:
        """Report the outcome of a trial."""

    def ask(self, trial: Trial, questions: tuple[Question, ...], data: TrialData) -> Answers:
        """Ask a task's questions after a trial; return the answers, each with name, value and time_s."""
        return ()

    def instrument(self, name: str, trial: Trial) -> Mapping[str, Any] | None:
        """Return the answers to a questionnaire by item, None if there are none; here a simulated participant rates."""
        hand, draw = (
            SimulatedParticipant(self.plan.experiment.operator.profile, trial.seed),
            random.Random(f"{name} {trial.seed}"),
        )
        return {
            question.name: draw.choice(question.options)
            if question.options
            else hand.rate(question.least, question.most, question.step, draw)
            for question in self.plan.experiment.instruments[name]
        }

    def rest(self, duration_s: float) -> bool:
        """Rest for a time [s]; return whether a person did."""
        return False

    def pause(self) -> None:
        """Wait until the experimenter continues."""

    def finish(self) -> None:
        """Tell the participant that the session is over."""


class BusDesk(Desk):
    """Tells recorder and experimenter of each trial; a simulated participant is not asked."""

    bus: ExperimentBus | None = None
    site_file: Path | None = None

    def attach(self, site_file: Path) -> None:
        self.bus, self.site_file = ExperimentBus(site_file), site_file

    def detach(self) -> None:
        if self.bus is not None:
            self.bus.close()
            self.bus = None

    def begin(self, trial: Trial, attempt: int, *, first: bool) -> None:
        self._tell(trial, attempt, "running", "")

    def during(self, elapsed_s: float) -> Sequence[Mapping[str, Any]]:
        answers = self._taken([] if self.bus is None else self.bus.answers())
        if self.action in _NOW:
            raise AbortedError(self.reason or self.action)
        return answers

    def over(self, trial: Trial, attempt: int, outcome: TrialOutcome) -> None:
        self._tell(trial, attempt, "skipped" if self.action == "skip" else outcome.status, outcome.disturbance)

    def _tell(self, trial: Trial, attempt: int, state: str, text: str) -> None:
        if self.bus is not None:
            delay_s = float(trial.settings.get(PICTURE_DELAY, 0.0))
            total = self.place.total
            self.bus.trial(trial, state=state, attempt=attempt, trials=total, text=text[:1000], picture_delay_s=delay_s)

    def _taken(self, answers: Sequence[Answer]) -> list[Mapping[str, Any]]:
        """Return the participant's answers, and note the experimenter's requests."""
        for answer in answers:
            if answer.role == "experimenter" and isinstance(wanted := answer.values.get("action"), str):
                self.action = "" if wanted == "resume" else wanted
                self.reason = str(answer.values.get("reason", ""))[:200]
        return [
            {"name": name, "value": value, "given_ns": answer.given_ns}
            for answer in answers
            if answer.role == "participant"
            for name, value in answer.values.items()
        ]


class PersonDesk(BusDesk):
    """Guides a person at the page through a session, in the words of the experiment."""

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.words = plan.experiment.words
        # For each question, maps the displayed options to the task's own.
        self._meanings: dict[str, dict[Any, str]] = {}

    def consent(self, participant: str) -> bool:
        words = self.words
        asked = words.consent_choice
        answer = self._wait("consent", words.consent_title, words.consent, questions=(asked,))
        return answer is not None and answer.values.get(asked.name) == words.agree

    def instruct(self, trial: Trial) -> None:
        self._wait("instruction", *self._instructions(trial), practice=trial.phase == "practice")

    def begin(self, trial: Trial, attempt: int, *, first: bool) -> None:
        bus, task = self._bus(), self.plan.tasks[trial.task]
        parameters = parameters_of(task, trial.task_parameters)
        title, text = self._instructions(trial)
        shown: dict[str, Any] = {"done": self.place.done, "total": self.place.total, "labels": self.words.labels}
        shown |= {"practice": trial.phase == "practice"}
        if first:
            cue = bus.cue("countdown", title, remaining_s=_COUNTDOWN_S, **shown)
            bus.wait(cue, _COUNTDOWN_S, self._idle)
        bus.cue(
            "trial",
            title,
            text,
            remaining_s=task.intervals(parameters, trial.seed)[0].duration_s,
            course=task.target(parameters, trial.seed),
            questions=self._asked(trial, task.questions_during(parameters)),
            band=task.band(parameters),
            **shown,
        )
        super().begin(trial, attempt, first=first)

    def ask(self, trial: Trial, questions: tuple[Question, ...], data: TrialData) -> Answers:
        end_s = float(data.haptic["time_s"][-1]) if len(data.haptic["time_s"]) else 0.0
        answer = self._wait("question", self._instructions(trial)[0], "", questions=self._asked(trial, questions))
        if answer is None:
            return ()
        time_s = end_s + answer.shown_s
        return tuple(
            {"name": name, "value": self._meant(name, value), "time_s": time_s} for name, value in answer.values.items()
        )

    def instrument(self, name: str, trial: Trial) -> Mapping[str, Any] | None:
        answer = self._wait("question", self.words.questions, "", questions=self.plan.experiment.instruments[name])
        return None if answer is None else dict(answer.values)

    def rest(self, duration_s: float) -> bool:
        self._wait("rest", self.words.rest, "", remaining_s=duration_s)
        return True

    def pause(self) -> None:
        self._wait("pause", self.words.pause, "", answered=False)

    def finish(self) -> None:
        # Progress is not sent: a bar that is not full would suggest that something is left.
        self._bus().cue("end", self.words.end, self.words.end_text, labels=self.words.labels)

    def during(self, elapsed_s: float) -> Sequence[Mapping[str, Any]]:
        answers = super().during(elapsed_s)
        return [{**answer, "value": self._meant(answer["name"], answer["value"])} for answer in answers]

    def _instructions(self, trial: Trial) -> tuple[str, str]:
        """Return heading and instruction of a trial's task."""
        task, words = self.plan.tasks[trial.task], self.words.tasks.get(trial.task)
        parameters = parameters_of(task, trial.task_parameters)
        if words is None or not words.instruction:
            return (words.title if words else "") or task.title, task.instruction(parameters)
        text = words.instruction
        for name, value in parameters.model_dump().items():
            text = text.replace(f"{{{name}}}", f"{value:g}" if isinstance(value, float) else str(value))
        return words.title or task.title, text

    def _asked(self, trial: Trial, questions: tuple[Question, ...]) -> tuple[Question, ...]:
        """Return a task's questions in the words of the experiment, and remember how to translate the answers."""
        asked = tuple(self.words.of(trial.task, question) for question in questions)
        for shown, question in zip(asked, questions, strict=True):
            self._meanings[question.name] = dict(zip(shown.options, question.options, strict=False))
        return asked

    def _meant(self, name: str, value: Any) -> Any:
        return self._meanings.get(name, {}).get(value, value)

    def _bus(self) -> ExperimentBus:
        assert self.bus is not None, "the rig of a person's session has come up"
        return self.bus

    def _idle(self, answers: list[Answer]) -> bool:
        self._taken(answers)
        return self.action in _NOW

    def _wait(
        self,
        stage: str,
        title: str,
        text: str,
        *,
        remaining_s: float | None = None,
        answered: bool = True,
        **shown: Any,
    ) -> Answer | None:
        bus = self._bus()
        place, labels = self.place, self.words.labels
        cue = bus.cue(
            stage, title, text, remaining_s=remaining_s, done=place.done, total=place.total, labels=labels, **shown
        )

        def is_over(answers: list[Answer]) -> bool:
            return self._idle(answers) or (not answered and self.action != "pause")

        return bus.wait(cue, remaining_s, is_over)
