"""An experiment on the bus: cues for the participant, trials for recorder and experimenter, and the answers of both."""

import contextlib
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import zmq

from telenano.runtime import AddressBook, Participant
from telenano.wire import VIEW, Array, ConfigError, Scalar
from telenano_lab.experiments.extend import Course
from telenano_lab.experiments.messages import MOST_QUESTIONS, ExperimentAnswer, Question
from telenano_lab.experiments.nodes import EXPERIMENT
from telenano_lab.experiments.types import Trial

# A cue is repeated after this time, for pages that open later.
_REPEAT_S = 0.5
_POLL_MS = 50
_NO_COURSE = Course(np.empty(0), np.empty(0), "none")


class Answer(NamedTuple):
    """An answer of a person at a page.

    Args:
        id: The identifier of the answer.
        cue: The identifier of the displayed cue.
        role: Either participant or experimenter.
        values: The answers by name of the question; `action` and `reason` of an experimenter.
        given_ns: Time of the answer, on the clock of the bus [ns].
        shown_s: Time for which the cue had been displayed [s].
    """

    id: str
    cue: str
    role: str
    values: Mapping[str, Scalar]
    given_ns: int
    shown_s: float


class ExperimentBus:
    """The endpoint of an experiment on a rig, which only one experiment can have at a time."""

    def __init__(self, site_file: Path) -> None:
        """Bind the endpoint of the experiment.

        Raises:
            ConfigError: The site file has no such endpoint; the message gives the missing line.
            EndpointError: Another experiment is running on this rig.
        """
        book = AddressBook.load(site_file)
        if EXPERIMENT not in book.nodes:
            line = f"{EXPERIMENT}: ipc://{{runtime}}/{EXPERIMENT}"
            raise ConfigError(f"{site_file}: nodes.{EXPERIMENT} is missing, an experiment needs it: add `{line}`")
        with contextlib.ExitStack() as opened:
            participant = opened.enter_context(Participant.open(EXPERIMENT, book))
            self._publisher = participant.bind(EXPERIMENT, ends=True)
            self._subscribers = participant.subscribers(book.sources(EXPERIMENT, ["experiment/answer"]))
            self._network = participant.network
            self._open = opened.pop_all()
        # Random, so that answers to the cues of an earlier experiment cannot match those of this one.
        self._sender = os.urandom(6).hex()
        self._issued = 0
        self._cue: dict[str, Any] | None = None
        self._reported_s = 0.0
        self._taken: deque[str] = deque(maxlen=MOST_QUESTIONS)
        self._known: set[tuple[str, ...]] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def cue(
        self,
        stage: str,
        title: str = "",
        text: str = "",
        *,
        remaining_s: float | None = None,
        done: int = 0,
        total: int = 0,
        practice: bool = False,
        labels: Mapping[str, str] | None = None,
        course: Course | None = None,
        questions: Sequence[Question] = (),
        band: float = 0.0,
    ) -> str:
        """Publish what the participant's page shows from now on, and return the identifier of the cue.

        Args:
            stage: Stage of the session, see `ExperimentCue`.
            title: The heading.
            text: The instruction, which must not reveal the condition.
            remaining_s: Time after which the stage ends by itself [s]; None if an answer ends it.
            done: Number of finished trials of the session.
            total: Number of trials of the session.
            practice: Whether this is practice.
            labels: Own words of the page by their use; None for English.
            course: The target to display.
            questions: The questions, all answered at once.
            band: Half the width of the band about the target, in its unit.
        """
        self._issued += 1
        shown = _NO_COURSE if course is None else course
        self._cue = {
            "id": f"{self._sender}-{self._issued}",
            "stage": stage,
            "title": title,
            "text": text,
            "remaining_s": remaining_s,
            "done": done,
            "total": total,
            "practice": practice,
            "labels": dict(labels or {}),
            "quantity": shown.quantity,
            "band": band,
            "times_s": Array.from_numpy(np.asarray(shown.times_s, float)),
            "target": Array.from_numpy(np.asarray(shown.values, float)),
            "questions": tuple(questions),
        }
        self._ends_s = None if remaining_s is None else time.monotonic() + remaining_s
        self._tell()
        return str(self._cue["id"])

    def trial(
        self,
        trial: Trial,
        *,
        state: str,
        attempt: int = 0,
        trials: int = 0,
        text: str = "",
        picture_delay_s: float = 0.0,
    ) -> None:
        """Publish a trial and its condition, for recorder and experimenter.

        Args:
            trial: The trial.
            state: Its state, see `ExperimentTrial`.
            attempt: The number of the attempt, from 0.
            trials: Number of trials of the session.
            text: The state in words.
            picture_delay_s: Delay of the picture on the participant's page [s].
        """
        self._publisher.publish(
            "experiment/trial",
            participant=trial.participant,
            session=trial.session,
            block=trial.block,
            index=trial.index,
            trials=trials,
            attempt=attempt,
            phase=trial.phase,
            task=trial.task,
            condition={key: _scalar(level) for key, level in trial.condition.items()},
            seed=trial.seed,
            state=state,
            text=text,
            picture_delay_s=float(picture_delay_s),
        )

    def answers(self) -> list[Answer]:
        """Return the answers since the last call, each once, and repeat the cue if that is due.

        If a participant answers the same questions of a cue more than once, the first answer counts.
        """
        self._network.process_events()
        new = [answer for message in self._received() if (answer := self._new(message)) is not None]
        if new or time.monotonic() - self._reported_s >= _REPEAT_S:
            self._tell()
        return new

    def wait(
        self, cue: str, timeout_s: float | None = None, idle: Callable[[list[Answer]], object] = lambda answers: None
    ) -> Answer | None:
        """Wait for the participant's answer to a cue.

        Args:
            cue: The identifier of the cue.
            timeout_s: The longest wait [s]; None for no limit.
            idle: Called twenty times a second with all other answers, such as an experimenter's; a true return value
                ends the wait.

        Returns:
            The answer; None after the timeout or if `idle` ended the wait.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while end_s is None or time.monotonic() < end_s:
            zmq.select([subscriber.socket for subscriber in self._subscribers], [], [], _POLL_MS * 1e-3)
            answers = self.answers()
            mine = next((one for one in answers if one.cue == cue and one.role == "participant"), None)
            if idle([one for one in answers if one is not mine]) or mine is not None:
                return mine
        return None

    def close(self) -> None:
        """Publish the last message, and close the endpoint."""
        self._open.close()

    def _received(self) -> list[ExperimentAnswer]:
        messages = [received.message for subscriber in self._subscribers for received in subscriber.receive()]
        return [message for message in messages if isinstance(message, ExperimentAnswer) and message.src == VIEW]

    def _new(self, message: ExperimentAnswer) -> Answer | None:
        """Return a new answer; None if it was received before, or repeats a question that the participant answered."""
        self._taken.append(message.id)
        is_own = message.role == "participant"
        key = (message.cue, *sorted(message.values)) if is_own else (message.id,)
        if key in self._known:
            return None
        self._known.add(key)
        return Answer(message.id, message.cue, message.role, message.values, message.given_ns, message.shown_s)

    def _tell(self) -> None:
        """Publish the current cue with the time that is left and the ids of the answers taken."""
        if self._cue is None:
            return
        self._reported_s = time.monotonic()
        left_s = None if self._ends_s is None else max(0.0, self._ends_s - self._reported_s)
        self._publisher.publish(
            "experiment/cue", **{**self._cue, "remaining_s": left_s, "answered": tuple(dict.fromkeys(self._taken))}
        )


def _scalar(level: Any) -> Scalar:
    return level if isinstance(level, bool | int | float | str) else str(level)
