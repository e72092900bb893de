"""How a person is led through a session: what is shown and asked, in order, and that none of it is the condition."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from experiment_bench import TASKS, Bench, plan_of
from telenano_lab.experiments.bus import Answer
from telenano_lab.experiments.desk import PersonDesk
from telenano_lab.experiments.extend import choice
from telenano_lab.experiments.journal import Journal
from telenano_lab.experiments.messages import Question
from telenano_lab.experiments.people import People
from test_experiment_runner import run, trials_in

from telenano.wire import ConfigError


class Bus:
    """A page that answers at once, and an experimenter who presses a button at a stage."""

    def __init__(self, press: dict[str, str] | None = None, consent: str = "yes") -> None:
        self.cues: list[dict[str, Any]] = []
        self.trials: list[dict[str, Any]] = []
        self.press, self.consent = press or {}, consent
        self.during: list[Answer] = []

    def cue(self, stage: str, title: str = "", text: str = "", **shown: Any) -> str:
        self.cues.append({"stage": stage, "title": title, "text": text, **shown})
        return f"c{len(self.cues)}"

    def trial(self, trial: Any, **facts: Any) -> None:
        self.trials.append({"condition": dict(trial.condition), **facts})

    def answers(self) -> list[Answer]:
        found, self.during = self.during, []
        return [*found, *self._pressed("trial")]

    def wait(
        self, cue: str, timeout_s: float | None = None, idle: Callable[..., Any] = lambda a: None
    ) -> Answer | None:
        shown = self.cues[-1]
        if idle(self._pressed(shown["stage"])):
            return None
        if shown["stage"] == "pause":
            # the experimenter goes on after a while
            assert idle([Answer("r", cue, "experimenter", {"action": "resume", "reason": ""}, 0, 1.0)])
            return None
        values = {q.name: q.options[0] if q.options else q.most for q in shown.get("questions", ())}
        if shown["stage"] == "consent":
            values = {"consent": self.consent}
        return None if timeout_s is not None else Answer("a", cue, "participant", values, 0, 1.5)

    def close(self) -> None:
        """Nothing is open."""

    def _pressed(self, stage: str) -> list[Answer]:
        action = self.press.pop(stage, "")
        return [Answer("e", "", "experimenter", {"action": action, "reason": "a remark"}, 0, 0.0)] if action else []


class Page(Bench):
    """An apparatus that shows its trials."""

    def take(self, course: Any) -> Any:
        self.desk.begin(course.trial, course.attempt, first=course.interval == 0)
        self.desk.during(0.1)
        return super().take(course)


def session(tmp_path: Path, bus: Bus, **changes: Any) -> tuple[str, Any]:
    fields = {"participants": 1, "factors": {"law": ["wave", "passivity"]}, "operator": {"kind": "person"}}
    plan = plan_of(tmp_path, {**TASKS, "asking": Asking()}, **{**fields, **changes})
    desk = PersonDesk(plan)
    desk.bus = bus  # type: ignore[assignment]
    return run(plan, Page(plan, desk)), plan


def test_a_session_from_consent_to_thanks(tmp_path: Path) -> None:
    bus = Bus()
    ask = [{"instrument": "nasa_tlx", "after": "block"}]
    assert session(tmp_path, bus, practice={"trials": 1}, ask=ask, breaks={"between_blocks_s": 0.1})[0] == ""
    stages = [cue["stage"] for cue in bus.cues]
    trial = ["countdown", "trial"]
    assert stages == ["consent", "instruction", *trial, "question", "rest", *trial, *trial, "question", "end"]
    assert [cue["practice"] for cue in bus.cues if cue["stage"] == "trial"] == [True, False, False]
    assert [(cue["done"], cue["total"]) for cue in bus.cues if cue["stage"] == "trial"] == [(0, 3), (1, 3), (2, 3)]
    assert People(tmp_path).known["P01"].consent
    with Journal(tmp_path / "journal.jsonl") as journal:
        assert [len(record["items"]) for record in journal.of("asked")] == [6, 6]


def test_who_is_excluded_after_practice_is_thanked_as_well(tmp_path: Path) -> None:
    bus = Bus()
    until = {"tiny": {"measure": "correct", "last": 2, "at_least": 1}}
    reason, _ = session(tmp_path, bus, practice={"trials": 2, "until": until, "missed": "exclude"})
    assert reason == "P01 was excluded: did not meet the criterion of tiny in 2 practice trials"
    trial = ["countdown", "trial"]
    assert [cue["stage"] for cue in bus.cues] == ["consent", "instruction", *trial, *trial, "end"]
    # a bar that is not full would say that something is left
    assert not bus.cues[-1].get("total")


def test_nothing_that_is_shown_tells_of_the_condition(tmp_path: Path) -> None:
    bus = Bus()
    factors = {"law": ["wave", "passivity"], "delay_ms": [12.5, 77.25]}
    session(tmp_path, bus, factors=factors)
    shown = json.dumps([{key: str(value) for key, value in cue.items()} for cue in bus.cues])
    assert not [word for word in ("wave", "passivity", "12.5", "77.25", "0.0125", "delay", "law") if word in shown]
    assert {trial["condition"]["law"] for trial in bus.trials} == {"wave", "passivity"}
    assert [trial["state"] for trial in bus.trials] == ["running", "done"] * 4


def test_the_delay_of_the_picture_goes_with_the_trial(tmp_path: Path) -> None:
    bus = Bus()
    session(tmp_path, bus, factors={"picture.delay_s": [0.0, 0.25]}, order="factorial")
    assert [trial["picture_delay_s"] for trial in bus.trials] == [0.0, 0.0, 0.25, 0.25]


def test_who_does_not_agree_is_asked_nothing_more(tmp_path: Path) -> None:
    bus = Bus(consent="no")
    assert session(tmp_path, bus)[0] == "P01 did not agree to take part"
    assert [cue["stage"] for cue in bus.cues] == ["consent"]
    assert trials_in(tmp_path) == []


@pytest.mark.parametrize(
    ("press", "rows", "reason"),
    [
        ({"trial": "disturbed"}, [("disturbed", False), ("done", True), ("done", True)], ""),
        ({"trial": "skip"}, [("aborted", True), ("done", True)], ""),
        ({"trial": "pause"}, [("done", True), ("done", True)], ""),
        ({"trial": "stop"}, [("aborted", False)], "a remark"),
        ({"trial": "exclude"}, [("aborted", False)], "P01 was excluded"),
    ],
)
def test_the_buttons_of_the_experimenter(
    tmp_path: Path, press: dict[str, str], rows: list[tuple[str, bool]], reason: str
) -> None:
    bus = Bus(dict(press))
    found, _ = session(tmp_path, bus, disturbed={"again": "at_once"})
    assert found == reason
    assert [(row["status"], row["final"]) for row in trials_in(tmp_path)] == rows
    assert ("pause" in [cue["stage"] for cue in bus.cues]) == (press == {"trial": "pause"})


def test_a_button_during_a_trial_is_an_answer_with_its_time(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, operator={"kind": "person"}, participants=1)
    desk, bus = PersonDesk(plan), Bus()
    desk.bus = bus  # type: ignore[assignment]
    bus.during = [Answer("a", "c1", "participant", {"contact": True}, 12_345, 0.4)]
    assert desk.during(0.1) == [{"name": "contact", "value": True, "given_ns": 12_345}]


class Asking(type(TASKS["tiny"])):  # type: ignore[misc]
    """A task that asks in its trials and after them."""

    name = "asking"

    def questions(self, p: Any) -> tuple[Question, ...]:
        return (choice("answer", "Which one was stiffer?", ("first", "second")),)

    def questions_during(self, p: Any) -> tuple[Question, ...]:
        return (choice("contact", "Press at the touch", ("I feel it",)),)


WORDS: dict[str, Any] = {
    "language": "de",
    "consent_title": "Einverständnis",
    "consent": "Sie nehmen freiwillig teil.",
    "consent_question": "Möchten Sie teilnehmen?",
    "agree": "ja",
    "disagree": "nein",
    "questions": "Einige Fragen",
    "rest": "Pause",
    "end": "Vielen Dank",
    "end_text": "Die Sitzung ist zu Ende.",
    "end_rest": "Weiter",
    "trial": "{number} von {total}",
    "tasks": {
        "asking": {
            "title": "Zwei Federn",
            "instruction": "Drücken Sie zweimal, je {length_s} Sekunden.",
            "questions": {"answer": {"text": "Welche war steifer?", "options": ["die erste", "die zweite"]}},
        }
    },
}


def words_session(tmp_path: Path, bus: Bus, words: dict[str, Any]) -> tuple[str, Any]:
    task = {"name": "asking", "parameters": {"length_s": 2.5}}
    ask = [{"instrument": "nasa_tlx", "after": "session"}]
    return session(tmp_path, bus, words=words, tasks=[task], factors={"law": ["wave"]}, ask=ask)


def test_a_session_is_in_the_words_of_the_experiment_and_its_answers_mean_what_they_do_in_english(
    tmp_path: Path,
) -> None:
    bus = Bus(consent="ja")
    assert words_session(tmp_path, bus, WORDS)[0] == ""
    told = {cue["stage"]: cue for cue in bus.cues}
    assert (told["consent"]["title"], told["consent"]["text"]) == ("Einverständnis", "Sie nehmen freiwillig teil.")
    assert told["consent"]["questions"][0].options == ("ja", "nein")
    assert told["instruction"]["title"] == "Zwei Federn"
    assert told["instruction"]["text"] == "Drücken Sie zweimal, je 2.5 Sekunden."
    assert (told["end"]["title"], told["end"]["text"]) == ("Vielen Dank", "Die Sitzung ist zu Ende.")
    asked = [cue for cue in bus.cues if cue["stage"] == "question"]
    assert [(cue["title"], cue["questions"][0].text) for cue in asked] == [
        ("Zwei Federn", "Welche war steifer?"), ("Einige Fragen", "How mentally demanding was the task?")
    ]  # fmt: skip
    assert {tuple(cue["labels"].items()) for cue in bus.cues} == {
        (("language", "de"), ("end_rest", "Weiter"), ("trial", "{number} von {total}"))
    }
    # The page gave the first word, and the table has the task's own.
    (trial,) = trials_in(tmp_path)
    assert [(answer["name"], answer["value"]) for answer in trial["answers"]] == [("answer", "first")]


def test_the_word_that_declines_declines(tmp_path: Path) -> None:
    assert words_session(tmp_path, Bus(consent="nein"), WORDS)[0] == "P01 did not agree to take part"


def test_an_answer_during_a_trial_means_what_it_does_in_english(tmp_path: Path) -> None:
    words = {"tasks": {"asking": {"questions": {"contact": {"options": ["Ich fühle es"]}}}}}
    known = {"asking": Asking()}
    plan = plan_of(tmp_path, known, tasks=["asking"], factors={"law": ["wave"]}, words=words)
    desk, bus = PersonDesk(plan), Bus()
    desk.bus = bus  # type: ignore[assignment]
    desk.begin(plan.trials("P01")[0], 0, first=False)
    assert bus.cues[-1]["questions"][0].options == ("Ich fühle es",)
    bus.during = [Answer("a", "c1", "participant", {"contact": "Ich fühle es"}, 7, 0.5)]
    assert desk.during(0.5) == [{"name": "contact", "value": "I feel it", "given_ns": 7}]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"tasks": {"askin": {}}}, "words.tasks: askin is not a task of this file; did you mean asking."),
        ({"agree": "no"}, "words.agree and words.disagree are the same word"),
        ({"language": "deutsch bitte"}, "words.language"),
        ({"consent": "x" * 1025}, "words.consent"),
        ({"tasks": {"asking": {"questions": {"answr": {}}}}},
         r"words.tasks.asking.questions.answr: is not asked by the task; did you mean answer. Known are answer"),
        ({"tasks": {"asking": {"questions": {"answer": {"options": ["nur eine"]}}}}},
         r"questions.answer.options: has 1 words for first, second"),
    ],
)  # fmt: skip
def test_words_that_fit_nothing_are_refused_with_their_key(tmp_path: Path, words: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        words_session(tmp_path, Bus(), words)
