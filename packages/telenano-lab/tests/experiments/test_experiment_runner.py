"""Running an experiment: whatever interrupts it, each trial is done once, and the conditions stay what was planned."""

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from experiment_bench import Bench, plan_of
from telenano_lab.experiments.desk import Desk
from telenano_lab.experiments.journal import Journal
from telenano_lab.experiments.people import People
from telenano_lab.experiments.plan import Plan
from telenano_lab.experiments.runner import Runner, progress_of, remaining
from telenano_lab.experiments.summary import state_of

from telenano.wire import ConfigError, RigError


class Killed(BaseException):
    """What a kill -9 is: nothing runs after it."""


def run(plan: Plan, bench: Bench, desk: Desk | None = None, participants: Any = None) -> str:
    folder = plan.path.parent
    with Journal(folder / "journal.jsonl") as journal:
        runner = Runner(plan, journal, People(folder), bench, desk or bench.desk)
        runner.begin()
        return runner.run(participants or list(remaining(plan, journal.records))).reason


def trials_in(folder: Path) -> list[dict[str, Any]]:
    with Journal(folder / "journal.jsonl") as journal:
        return [record for record in journal.records if record["record"] == "trial"]


def facts(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: value for key, value in row.items() if key not in ("utc", "started_utc")} for row in rows]


def test_all_trials_of_all_participants_are_done_in_their_order(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, repetitions=2, practice={"trials": 1})
    assert run(plan, Bench(plan)) == ""
    rows = trials_in(tmp_path)
    assert [(row["participant"], row["index"]) for row in rows] == [(p, i) for p in ("P01", "P02") for i in range(13)]
    assert all(row["status"] == "done" and row["final"] for row in rows)
    assert rows[0]["phase"] == "practice" and rows[1]["phase"] == "main"
    assert rows[1]["verified"]["law"] == rows[1]["condition"]["law"]
    with Journal(tmp_path / "journal.jsonl") as journal:
        assert journal.records[-1]["record"] == "ended"
        records = journal.records
    assert state_of(plan, records)["trials_left"] == 0
    after = [place + 1 for place, record in enumerate(records) if record["record"] == "trial"][:13]
    states = [state_of(plan, records[:end])["participants"][0]["state"] for end in (0, *after, len(records))]
    assert states == ["to do", *(f"half done: {count} of 13 trials" for count in range(1, 14)), "done"]


@pytest.mark.parametrize("at", [0, 1, 5, 6, 11])
def test_a_kill_at_any_trial_loses_none_and_doubles_none(tmp_path: Path, at: int) -> None:
    plan = plan_of(tmp_path)
    whole = tmp_path / "whole"
    whole.mkdir()
    reference = plan_of(whole)
    run(reference, Bench(reference))

    class Dying(Bench):
        def take(self, course: Any) -> Any:
            if len(self.taken) == at:
                raise Killed
            return super().take(course)

    with pytest.raises(Killed):
        run(plan, Dying(plan))
    path = tmp_path / "journal.jsonl"
    # the kill may as well come in the middle of a write
    path.write_bytes(path.read_bytes() + b'{"record": "tri')
    assert run(plan, Bench(plan)) == ""
    rows = trials_in(tmp_path)
    assert Counter((row["participant"], row["index"]) for row in rows) == Counter(
        (participant, index) for participant in ("P01", "P02") for index in range(6)
    )
    # the same as if nothing had happened, seeds and measures included
    assert facts(rows) == facts(trials_in(whole))
    with Journal(path) as journal:
        assert [record["index"] for record in journal.of("interrupted")] == [at % 6]


@pytest.mark.parametrize(
    ("again", "order"), [("at_once", [0, 1, 1, 2, 3, 4, 5]), ("end_of_block", [0, 1, 2, 3, 4, 5, 1])]
)
def test_a_disturbed_trial_is_marked_and_repeated_by_rule(tmp_path: Path, again: str, order: list[int]) -> None:
    plan = plan_of(tmp_path, disturbed={"again": again}, participants=1)
    bench = Bench(plan)
    bench.disturbed["P01", 1, 0] = "the instrument stood still for 80 ms at 1.20 s"
    assert run(plan, bench) == ""
    rows = trials_in(tmp_path)
    assert [row["index"] for row in rows] == order
    first, second = (row for row in rows if row["index"] == 1)
    assert (first["status"], first["final"], first["attempt"]) == ("disturbed", False, 0)
    assert first["disturbance"] == "the instrument stood still for 80 ms at 1.20 s"
    assert (second["status"], second["final"], second["attempt"]) == ("done", True, 1)
    assert second["seed"] != first["seed"]
    assert second["condition"] == first["condition"]


def test_a_trial_that_stays_disturbed_is_given_up_after_its_attempts(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, disturbed={"most_attempts": 2}, participants=1)
    bench = Bench(plan)
    bench.disturbed |= {("P01", 4, attempt): "again" for attempt in range(9)}
    assert run(plan, bench) == ""
    mine = [row for row in trials_in(tmp_path) if row["index"] == 4]
    assert [(row["attempt"], row["status"], row["final"]) for row in mine] == [
        (0, "disturbed", False),
        (1, "disturbed", True),
    ]


def test_attempts_disturbed_in_a_row_stop_the_run_and_resume_goes_on(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, stop={"disturbed_in_a_row": 2}, participants=1)
    bench = Bench(plan)
    bench.disturbed |= {("P01", index, 0): "a stall" for index in (1, 2)}
    assert run(plan, bench).startswith("2 attempts in a row were disturbed")
    assert len(trials_in(tmp_path)) == 3
    assert run(plan, Bench(plan)) == ""
    rows = trials_in(tmp_path)
    assert sorted(row["index"] for row in rows if row["final"]) == list(range(6))


def test_a_session_that_is_too_long_ends_after_a_trial(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, stop={"session_s": 1e-9}, participants=1)
    assert "are the most" in run(plan, Bench(plan))
    assert trials_in(tmp_path) == []


def test_another_experiment_does_not_go_on_in_the_same_folder(tmp_path: Path) -> None:
    plan = plan_of(tmp_path)
    run(plan, Bench(plan), participants=["P01"])
    changed = plan_of(tmp_path, seed=6)
    with pytest.raises(ConfigError, match="is another experiment than the one in"):
        run(changed, Bench(changed))


def test_a_person_needs_consent_and_does_one_session_at_a_time(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, operator={"kind": "person"}, participants=1, sessions=2)
    assert run(plan, Bench(plan)) == "P01 did not agree to take part"
    assert trials_in(tmp_path) == []
    People(tmp_path).change("P01", consent=True)
    assert run(plan, Bench(plan)) == ""
    assert {row["session"] for row in trials_in(tmp_path)} == {1}
    assert run(plan, Bench(plan)) == ""
    assert len(trials_in(tmp_path)) == 12


class Person(Desk):
    """A person and an experimenter who does something after the second trial."""

    def __init__(self, plan: Plan, action: str) -> None:
        super().__init__(plan)
        self.wanted = action
        self.asked: list[str] = []

    def consent(self, participant: str) -> bool:
        return True

    def instruct(self, trial: Any) -> None:
        self.asked.append(f"instruct {trial.task}")

    def over(self, trial: Any, attempt: int, outcome: Any) -> None:
        if trial.index == 1 and attempt == 0:
            self.action, self.reason = self.wanted, "a phone rang"

    def instrument(self, name: str, trial: Any) -> dict[str, float]:
        self.asked.append(name)
        return {"effort": 40.0}

    def rest(self, duration_s: float) -> bool:
        self.asked.append(f"rest {duration_s:g}")
        return True


ASKING = {"operator": {"kind": "person"}, "participants": 1, "tasks": ["tiny", "other"]}


def test_instruments_rests_and_instructions_come_where_the_file_says(tmp_path: Path) -> None:
    ask = [{"instrument": "nasa_tlx", "after": "block"}, {"instrument": "comfort", "after": "session"}]
    own = {
        "comfort": [
            {"name": "ease", "text": "How easy was it?"},
            {"name": "law", "text": "Which?", "options": ["a", "b"]},
        ]
    }
    plan = plan_of(
        tmp_path,
        ask=ask,
        questionnaires=own,
        breaks={"every_trials": 4, "duration_s": 9, "between_blocks_s": 20},
        **ASKING,
    )
    desk = Person(plan, "")
    assert run(plan, Bench(plan), desk) == ""
    first, second = (task for task in desk.asked if task.startswith("instruct"))
    assert desk.asked == [first, "rest 9", "nasa_tlx", "rest 20", second, "rest 9", "nasa_tlx", "comfort"]
    with Journal(tmp_path / "journal.jsonl") as journal:
        asked = list(journal.of("asked"))
        assert [(row["instrument"], row["block"], row["trial"]) for row in asked] == [
            ("nasa_tlx", 0, -1),
            ("nasa_tlx", 1, -1),
            ("comfort", 1, -1),
        ]
        assert asked[0]["items"] == {"effort": 40.0}
        assert len(list(journal.of("break"))) == 3


@pytest.mark.parametrize("action", ["stop", "exclude"])
def test_the_experimenter_ends_a_session(tmp_path: Path, action: str) -> None:
    plan = plan_of(tmp_path, **ASKING)
    reason = run(plan, Bench(plan), Person(plan, action))
    assert reason == {"stop": "a phone rang", "exclude": "P01 was excluded"}[action]
    assert len(trials_in(tmp_path)) == 2
    with Journal(tmp_path / "journal.jsonl") as journal:
        assert progress_of(journal.records, "P01").excluded == ("a phone rang" if action == "exclude" else "")
        assert bool(remaining(plan, journal.records)) == (action == "stop")
    assert People(tmp_path).known["P01"].excluded == ("a phone rang" if action == "exclude" else "")


def test_a_rig_that_fails_leaves_what_was_done(tmp_path: Path) -> None:
    class Failing(Bench):
        def take(self, course: Any) -> Any:
            if len(self.taken) == 3:
                raise RigError("the rig has ended")
            return super().take(course)

    plan = plan_of(tmp_path, participants=1)
    with pytest.raises(RigError):
        run(plan, Failing(plan))
    assert run(plan, Bench(plan)) == ""
    assert [row["index"] for row in trials_in(tmp_path)] == list(range(6))


METHOD = {
    "method": "staircase",
    "start": 2.0,
    "steps": [0.5, 0.25],
    "low": 0.0,
    "high": 4.0,
    "reversals": 6,
    "discarded": 2,
}


@pytest.mark.parametrize("killed_after", [None, 1, 12])
def test_an_adaptive_method_goes_on_from_the_journal(tmp_path: Path, killed_after: int | None) -> None:
    factors = {"law": ["wave", "passivity"], "task.level": {"adaptive": METHOD}}
    plan = plan_of(tmp_path, factors=factors, participants=1)

    class Dying(Bench):
        def take(self, course: Any) -> Any:
            if len(self.taken) == killed_after:
                raise Killed
            return super().take(course)

    if killed_after is not None:
        with pytest.raises(Killed):
            run(plan, Dying(plan))
    assert run(plan, Bench(plan)) == ""
    rows = trials_in(tmp_path)
    assert len(rows) < len(plan.trials("P01"))
    for law in ("wave", "passivity"):
        levels = [row["condition"]["task.level"] for row in rows if row["condition"]["law"] == law]
        assert levels[0] == 2.0
        # a participant who is right above 1 is followed there
        assert min(levels[4:]) >= 0.5 and max(levels[4:]) <= 1.75
        assert len(levels) >= 8


def test_a_simulated_participant_rates_within_the_scales(tmp_path: Path) -> None:
    own = {
        "comfort": [
            {"name": "ease", "text": "How easy was it?"},
            {"name": "side", "text": "Which?", "options": ["a", "b"]},
        ]
    }
    asked = [{"instrument": "comfort", "after": "trial"}, {"instrument": "nasa_tlx", "after": "session"}]
    plan = plan_of(tmp_path, ask=asked, questionnaires=own, participants=1)
    assert run(plan, Bench(plan)) == ""
    with Journal(tmp_path / "journal.jsonl") as journal:
        rows = list(journal.of("asked"))
    assert [(row["instrument"], row["trial"]) for row in rows] == [
        *(("comfort", i) for i in range(6)),
        ("nasa_tlx", -1),
    ]
    assert all(1.0 <= row["items"]["ease"] <= 7.0 and row["items"]["side"] in ("a", "b") for row in rows[:6])
    assert len(rows[-1]["items"]) == 6 and all(0.0 <= value <= 100.0 for value in rows[-1]["items"].values())


UNTIL: dict[str, Any] = {"tiny": {"measure": "correct", "last": 3, "at_least": 2 / 3}}
LEARNER: dict[str, Any] = {"participants": 1, "factors": {"law": ["wave", "passivity"]}}


class Learner(Bench):
    """A participant who is right in the practice trials of some indices only; nothing is known of `unknown`."""

    right: tuple[int, ...] = ()
    unknown: tuple[int, ...] = ()

    def run(self, trial: Any, attempt: int) -> Any:
        outcome = super().run(trial, attempt)
        correct = None if trial.index in self.unknown else trial.index in self.right
        return outcome._replace(measures={**outcome.measures, "correct": correct})


@pytest.mark.parametrize(
    ("right", "unknown", "used"),
    [((0, 1, 2), (), 3), ((0, 3, 4), (), 5), ((2, 3), (4,), 4), ((0, 2), (1,), 8), ((1, 3), (2,), 8), ((), (), 8)],
)
def test_practice_ends_at_its_criterion_or_after_its_trials(
    tmp_path: Path, right: tuple[int, ...], unknown: tuple[int, ...], used: int
) -> None:
    plan = plan_of(tmp_path, practice={"trials": 8, "until": UNTIL}, **LEARNER)
    bench = Learner(plan)
    bench.right, bench.unknown = right, unknown
    assert run(plan, bench) == ""
    rows = trials_in(tmp_path)
    assert [row["index"] for row in rows] == [*range(used), 8, 9]
    with Journal(tmp_path / "journal.jsonl") as journal:
        (record,) = journal.of("practice")
        assert (record["trials"], record["met"], record["task"]) == (used, bool(used < 8), "tiny")
        assert journal.records[-1]["record"] == "ended" and remaining(plan, journal.records) == {}


def test_who_misses_the_criterion_is_excluded_where_the_file_says_so_and_can_be_taken_back(tmp_path: Path) -> None:
    practice = {"trials": 4, "until": UNTIL, "missed": "exclude"}
    plan = plan_of(tmp_path, practice=practice, **LEARNER)
    text = "did not meet the criterion of tiny in 4 practice trials"
    assert run(plan, Learner(plan)) == f"P01 was excluded: {text}"
    assert [row["phase"] for row in trials_in(tmp_path)] == ["practice"] * 4
    assert People(tmp_path).known["P01"].excluded == text
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.write("included", participant="P01", reason="")
    assert run(plan, Learner(plan)) == ""
    assert [row["phase"] for row in trials_in(tmp_path)] == ["practice"] * 4 + ["main"] * 2


def test_after_one_who_misses_the_criterion_the_next_begins(tmp_path: Path) -> None:
    class Mixed(Learner):
        """Of whom the first participant is never right and the others always are."""

        def run(self, trial: Any, attempt: int) -> Any:
            self.right = () if trial.participant == "P01" else tuple(range(100))
            return super().run(trial, attempt)

    practice = {"trials": 4, "until": UNTIL, "missed": "exclude"}
    plan = plan_of(tmp_path, practice=practice, **{**LEARNER, "participants": 2})
    assert run(plan, Mixed(plan)) == ""
    rows = [(row["participant"], row["phase"]) for row in trials_in(tmp_path)]
    assert rows == [("P01", "practice")] * 4 + [("P02", "practice")] * 3 + [("P02", "main")] * 2
    with Journal(tmp_path / "journal.jsonl") as journal:
        assert remaining(plan, journal.records) == {}


def test_the_last_practice_trials_are_the_last_in_time_and_not_by_number(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, practice={"trials": 4, "until": UNTIL}, **LEARNER)
    bench = Learner(plan)
    # trial 0 is done again after 1, 2 and 3, so the last three are 2, 3 and 0, of which two are right
    bench.disturbed["P01", 0, 0] = "a stall"
    bench.right = (0, 3)
    assert run(plan, bench) == ""
    with Journal(tmp_path / "journal.jsonl") as journal:
        assert [record["met"] for record in journal.of("practice")] == [True]


@pytest.mark.parametrize("killed_after", [1, 3, 4])
def test_a_practice_that_was_interrupted_ends_where_it_would_have(tmp_path: Path, killed_after: int) -> None:
    plan = plan_of(tmp_path, practice={"trials": 8, "until": UNTIL}, **LEARNER)

    class Dying(Learner):
        def take(self, course: Any) -> Any:
            if len(self.taken) == killed_after:
                raise Killed
            return super().take(course)

    dying, whole = Dying(plan), Learner(plan)
    dying.right = whole.right = (1, 2)
    with pytest.raises(Killed):
        run(plan, dying)
    assert run(plan, whole) == ""
    assert [row["index"] for row in trials_in(tmp_path)] == [0, 1, 2, 8, 9]


@pytest.mark.parametrize(
    ("until", "text"),
    [
        (
            {"tiny": {"measure": "corect", "at_least": 1}},
            "practice.until.tiny.measure: task tiny has no measure 'corect'",
        ),
        ({"tiney": {"measure": "correct", "at_least": 1}}, "practice.until: tiney is not a task of this file"),
        ({"tiny": {"measure": "correct"}}, "give either at_least or at_most"),
        ({"tiny": {"measure": "correct", "last": 9, "at_least": 1}}, "until.tiny.last: 9 trials are more than the 8"),
    ],
)
def test_a_criterion_that_cannot_be_met_is_named(tmp_path: Path, until: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        plan_of(tmp_path, practice={"trials": 8, "until": until})
