"""The plan of an experiment: the trials that follow from its file, and what is said of a wrong one."""

import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from experiment_bench import plan_of
from telenano_lab.experiments.plan import attempt_seed, check_files_of, load_plan
from telenano_lab.experiments.plans import FOLDER, find_experiment
from telenano_lab.experiments.summary import summary_of
from telenano_lab.experiments.tasks import INSTALLED

from telenano.settings import find_scenario
from telenano.wire import ConfigError


def test_every_condition_comes_as_often_as_the_file_says(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, repetitions=3)
    for participant in ("P01", "P02"):
        trials = plan.trials(participant)
        assert [trial.index for trial in trials] == list(range(18))
        counts = Counter((trial.condition["law"], trial.condition["round_trip_ms"]) for trial in trials)
        assert len(counts) == 6 and set(counts.values()) == {3}
    assert plan.trials("P01") == plan.trials("P01")
    assert [t.condition for t in plan.trials("P01")] != [t.condition for t in plan.trials("P02")]
    seeds = [trial.seed for name in ("P01", "P02") for trial in plan.trials(name)]
    assert len(set(seeds)) == 36


def test_a_level_becomes_the_keys_that_it_means(tmp_path: Path) -> None:
    levels = {"soft": {"controller.wave.damping_n_s_per_m": 40.0}, "firm": {"controller.wave.damping_n_s_per_m": 80.0}}
    factors = {"law": ["wave"], "delay_ms": [20], "grip": {"levels": levels}, "task.length_s": [1.0, 3.0]}
    plan = plan_of(tmp_path, factors=factors, settings={"controller": {"wave": {"mass_kg": 2.5}}}, order="factorial")
    first = plan.trials("P01")[0]
    assert first.condition == {"law": "wave", "delay_ms": 20, "grip": "soft", "task.length_s": 1.0}
    assert first.settings == {
        "controller.wave.mass_kg": 2.5,
        "controller.law": "wave",
        "delay_node.forward.delay_s": 0.02,
        "delay_node.backward.delay_s": 0.02,
        "controller.wave.damping_n_s_per_m": 40.0,
    }
    assert first.task_parameters["length_s"] == 1.0
    assert {trial.task_parameters["length_s"] for trial in plan.trials("P01")} == {1.0, 3.0}


def test_a_key_that_a_running_rig_does_not_take_is_held_for_a_block(tmp_path: Path) -> None:
    factors = {"afm_node.cantilever.stiffness_n_per_m": [0.1, 1.0], "law": ["wave", "passivity"]}
    plan = plan_of(tmp_path, factors=factors, repetitions=2)
    assert plan.restarting == plan.block_factors == ("afm_node.cantilever.stiffness_n_per_m",)
    trials = plan.trials("P01")
    held = [trial.condition["afm_node.cantilever.stiffness_n_per_m"] for trial in trials]
    assert len(set(held[:4])) == len(set(held[4:])) == 1 and held[0] != held[4]
    assert [trial.block for trial in trials] == [0] * 4 + [1] * 4
    assert summary_of(plan)["factors_that_start_the_rig"] == ["afm_node.cantilever.stiffness_n_per_m"]


def test_tasks_and_practice_have_blocks_of_their_own(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, tasks=["tiny", "other"], practice={"trials": 2}, sessions=2)
    trials = plan.trials("P02")
    assert len(trials) == 2 * (2 * 6 + 2 * 2)
    for session in (1, 2):
        mine = [trial for trial in trials if trial.session == session]
        blocks = {trial.block: (trial.phase, trial.task) for trial in mine}
        assert sorted(blocks) == [0, 1, 2, 3]
        assert [blocks[block][0] for block in sorted(blocks)] == ["practice", "main"] * 2
        assert blocks[0][1] == blocks[1][1] != blocks[2][1] == blocks[3][1]


def test_a_latin_square_is_balanced_over_the_participants_that_check_names(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, order="latin_square", participants=6, repetitions=1)
    assert plan.complete_after == 6
    assert plan.balance().over_places and plan.balance().over_carry
    assert not summary_of(plan)["doubts"]
    few = plan_of(tmp_path, order="latin_square", participants=4)
    assert not few.balance().over_carry
    assert summary_of(few)["doubts"] == ["the order is balanced over a multiple of 6 participants, and there are 4"]


def test_practice_of_an_adaptive_factor_and_its_longest_run(tmp_path: Path) -> None:
    method = {"method": "staircase", "start": 2.0, "steps": [0.5], "low": 0.0, "high": 4.0, "trials": 30}
    plan = plan_of(tmp_path, factors={"law": ["wave", "passivity"], "task.level": {"adaptive": method}})
    assert plan.adaptive == "task.level"
    assert len(plan.trials("P01")) == 60
    chosen = plan.with_level(plan.trials("P01")[0], 1.25)
    assert chosen.condition["task.level"] == 1.25
    assert chosen.task_parameters["level"] == 1.25


def test_an_attempt_has_a_seed_of_its_own() -> None:
    assert attempt_seed(7, 0) == 7
    assert len({attempt_seed(7, attempt) for attempt in range(5)}) == 5


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"factor": {}}, "experiment.yaml: factor: unknown key"),
    ({"factors": {"law": ["waves"]}}, r"experiment.yaml \(law = waves\): controller.law"),
    (
        {"factors": {"controller.wave.mas_kg": [1.0]}},
        r"\(controller.wave.mas_kg = 1.0\): controller.wave.mas_kg: unknown",
    ),
    ({"factors": {"network": ["marsnet"]}}, "delay_node.profile: unknown profile 'marsnet'"),
    ({"factors": {"law": []}}, "factors.law: levels: at least one is needed"),
    ({"factors": {"law": ["wave", "wave"]}}, "factors.law: levels: each value may appear once"),
    ({"factors": {"law": 3}}, "factors.law: Input should be"),
    ({"factors": {"law": {"levels": "wave"}}}, "factors.law.levels: levels must be a list of values"),
    ({"factors": {"delay_ms": [1], "round_trip_ms": [2]}}, "round_trip_ms and delay_ms are the same delay"),
    (
        {"factors": {"round_trip_ms": ["0ms", "60ms"]}},
        "factors.round_trip_ms: '0ms' is not a number; write it without a unit",
    ),
    ({"factors": {"delay_ms": [10, "a"]}}, "factors.delay_ms: 'a' is not a number"),
    ({"factors": {"round_trip_ms": [True]}}, "factors.round_trip_ms: True is not a number"),
    ({"tasks": ["tinny"]}, "experiment.yaml: tasks.0.name: tinny: is not a task; .*tiny"),
    (
        {"tasks": [{"name": "tiny", "parameters": {"length_s": -1.0}}]},
        "tasks.0.parameters.length_s: Input should be greater",
    ),
    ({"factors": {"task.lenght_s": [1.0]}}, r"tasks.0.parameters.lenght_s: unknown key.*\(task.lenght_s = 1.0\)"),
    ({"participants": ["Anna"]}, "'Anna' is not a pseudonym: it must be P and a number"),
    ({"participants": ["P01", "P01"]}, "participants: each may appear once"),
    ({"participants": ["P01", "P1"]}, "P01 and P1 have one number"),
    ({"pseudonym": "Miller"}, "pseudonym: String should match pattern"),
    ({"blocks": {"factors": ["lawn"]}}, "blocks.factors: lawn is not a factor; .*law"),
    ({"order": "counterbalanced"}, "order: counterbalanced: 6 conditions have 720 orders; take latin_square"),
    ({"scenario": "fig99"}, "unknown scenario 'fig99'"),
    ({"ask": [{"instrument": "tlx"}]}, "ask: tlx is not an instrument; .*nasa_tlx"),
    ({"seed": -1}, "seed: Input should be greater than or equal to 0"),
    ({"factors": {"task.level": {"adaptive": {"method": "guess"}}}}, "factors.task.level.adaptive"),
]


@pytest.mark.parametrize(("changes", "complaint"), WRONG)
def test_a_wrong_file_is_refused_with_file_and_key(tmp_path: Path, changes: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        plan_of(tmp_path, **changes)


BESIDE = {
    "broken.yaml": "name: [",
    "list.yaml": "[1]",
    "unknown_key.yaml": "name: mine\ndescription: mine\nduration_s: 1.0\ncontroler: {law: wave}\n",
}
TRACE = "delay_node.forward.delay_trace.file"
# What a plan can name that there is not, and what is said after the name of its file and levels.
UNKNOWN: list[tuple[dict[str, Any], str]] = [
    *(({"scenario": name}, "scenario: ") for name in ("fig!2", "nosuch.yaml", "a\0b", "", "session.mcap", "folder")),
    *(({"scenario": "x" * 300 + end}, "scenario: ") for end in ("", ".yaml")),
    *(({"scenario": name}, rf"scenario: .*{name}: ") for name in ("broken.yaml", "list.yaml")),
    (
        {"scenario": "unknown_key.yaml"},
        r"scenario: .*unknown_key.yaml: controler: unknown key, did you mean controller",
    ),
    ({"settings": {"controler.law": "wave"}}, "controler: unknown key, did you mean controller"),
    ({"settings": {"delay_node.profile": "marsnet"}}, "delay_node.profile: unknown profile 'marsnet'"),
    ({"settings": {"haptic_node.driver": "nosuch"}}, "haptic_node.driver: "),
    ({"settings": {"picture.delay": 0.1}}, "picture: unknown key"),
    # Factors replace these in every trial.
    ({"settings": {"controller.law": "wav"}}, "settings: controller.law: "),
    ({"settings": {"delay_node.forward.delay_s": "late"}}, "settings: delay_node.forward.delay_s: "),
    (
        {"settings": {"picture.delay_s": 10.0}, "factors": {"picture.delay_s": [0.0, 0.1]}},
        "settings: picture.delay_s: ",
    ),
    (
        {
            "settings": {"afm_node.sample.name": 3},
            "factors": {"place": {"levels": {"a": {"afm_node.sample.name": "flat"}}}},
        },
        "settings: afm_node.sample.name: ",
    ),
    ({"factors": {"picture.delay_s": ["late"]}}, "picture.delay_s: "),
    ({"factors": {"picture.delay_s": [10.0]}}, "picture.delay_s: "),
    # The levels of a method are those of its trials, and so the least and the greatest of them have to be possible.
    *(
        ({"factors": {name: {"adaptive": {"method": "constant", "levels": levels, "repetitions": 3}}}}, complaint)
        for name, levels, complaint in (
            ("picture.delay_s", [0.1, 10.0], r"picture\.delay_s: "),
            ("picture.delay_s", [-0.1, 1.0], r"picture\.delay_s: "),
            ("delay_ms", [-20.0, 20.0], r"delay_node\.(for|back)ward\.delay_s: "),
            ("haptic_node.operator.forse_n", [0.5, 1.0], r"haptic_node\.operator"),
        )
    ),
    (
        {
            "factors": {
                "picture.delay_s": {"adaptive": {"method": "staircase", "start": 1, "low": 0, "high": 12, "steps": [1]}}
            }
        },
        r"picture\.delay_s: ",
    ),
    ({"factors": {"grip": {"key": "controler.law", "levels": ["wave"]}}}, "controler: unknown key"),
    ({"factors": {"grip": {"levels": {"soft": {"controler.law": "wave"}}}}}, "controler: unknown key"),
    ({"factors": {"grip": {"key": "task.lenght_s", "levels": [1.0]}}}, "tasks.0.parameters.lenght_s: unknown key"),
    ({"operator": {"kind": "simulated", "profile": {"reaction_s": 0.1}}}, "operator.profile.reaction_s: unknown key"),
    ({"operator": {"kind": "simulated", "profile": {"rating": "high"}}}, "operator.profile.rating: "),
    ({"operator": {"kind": "nobody"}}, "operator.kind: "),
    ({"tasks": ["tinny"]}, "tasks.0.name: tinny: is not a task; did you mean tiny"),
    ({"tasks": [{"name": "tiny", "parameters": {"lenght_s": 1.0}}]}, "tasks.0.parameters.lenght_s: unknown key"),
    ({"practice": {"trials": 5, "until": {"tinny": {"measure": "time_s", "at_most": 1.0}}}}, "practice.until: tinny "),
    ({"practice": {"trials": 5, "until": {"tiny": {"measure": "times", "at_most": 1.0}}}}, "practice.until.tiny.meas"),
    ({"words": {"tasks": {"tinny": {}}}}, "words.tasks: tinny is not a task of this file"),
    ({"words": {"tasks": {"tiny": {"questions": {"why": {"text": "?"}}}}}}, "words.tasks.tiny.questions.why: "),
    ({"words": {"tasks": {"tiny": {"instruction": "{lenght_s} s"}}}}, r"words.tasks.tiny.instruction: \{lenght_s\} is"),
    ({"words": {"trial": "{numbr} of {total}"}}, r"words: trial: \{numbr\} has no value here; did you mean number"),
    ({"ask": [{"instrument": "tlx"}]}, "ask: tlx is not an instrument"),
    ({"blocks": {"factors": ["lawn"]}}, "blocks.factors: lawn is not a factor"),
    ({"apparatus": "rig"}, "apparatus: "),
]


@pytest.mark.parametrize(("changes", "complaint"), UNKNOWN)
def test_what_a_plan_names_and_there_is_not_is_said_with_its_file_and_key(
    tmp_path: Path, changes: dict[str, Any], complaint: str
) -> None:
    for name, text in BESIDE.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "folder").mkdir()
    with pytest.raises(ConfigError) as refused:
        plan_of(tmp_path, **changes)
    for line in str(refused.value).splitlines():
        assert re.match(rf"{re.escape(str(tmp_path / 'experiment.yaml'))}( \(.*?\))?: {complaint}", line), line


def test_a_value_that_factors_replace_need_not_go_together_with_others(tmp_path: Path) -> None:
    operator = "haptic_node.operator"
    pressed = {f"{operator}.kind": "force_profile", f"{operator}.points": [{"time_s": 0.1, "force_n": 1.0}]}
    led = {f"{operator}.kind": "impedance", f"{operator}.path": [{"time_s": 0.1, "position_m": 1e-3}]}
    factors = {"law": ["wave"], "hand": {"levels": {"pressed": pressed, "led": led}}}
    # Without a level of the factor this kind of hand has the points of the scenario, and no path.
    settings = {f"{operator}.kind": "impedance", "controller.law": "passivity"}
    plan = plan_of(tmp_path, factors=factors, settings=settings)
    assert {trial.settings[f"{operator}.kind"] for trial in plan.trials("P01")} == {"force_profile", "impedance"}


@pytest.mark.parametrize(
    ("key", "value"), [("afm_node.sample.name", "nosuch.gwy"), (TRACE, "nosuch.txt"), ("afm_node.sample.map", "no.npz")]
)
def test_a_file_that_a_trial_reads_and_that_is_not_there_is_said_before_the_first_trial(
    tmp_path: Path, key: str, value: str
) -> None:
    plan = plan_of(tmp_path, factors={"law": ["wave"], "place": {"levels": {"here": {key: value}}}})
    section = key.removesuffix(".file")
    with pytest.raises(ConfigError, match=rf"experiment.yaml \(.*place = here.*\): {section}") as refused:
        check_files_of(plan)
    assert value in str(refused.value)


@pytest.mark.parametrize("find", [find_scenario, find_experiment])
@pytest.mark.parametrize("name", ["x" * 300, "fig!2"])
def test_a_name_that_no_file_can_have_is_refused_with_those_that_are_known(find: Any, name: str) -> None:
    with pytest.raises(ConfigError, match=r"unknown .*(k|K)nown are"):
        find(name)


def test_a_name_in_braces_stands_for_a_parameter_of_the_task(tmp_path: Path) -> None:
    words = {"trial": "{number}/{total}", "tasks": {"tiny": {"instruction": "Hold it for {length_s} s {} {1}."}}}
    assert plan_of(tmp_path, words=words).experiment.words.labels["trial"] == "{number}/{total}"


def test_why_a_task_of_a_package_cannot_be_used_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = "press of the package lab-tasks 0.1 cannot be used: a task has judge as well"
    monkeypatch.setitem(INSTALLED.problems, "press", problem)
    with pytest.raises(ConfigError, match=f"experiment.yaml: tasks.0.name: {problem}"):
        plan_of(tmp_path, tasks=["press"])


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_experiments_that_come_with_the_project_are_sound(path: Path) -> None:
    plan = load_plan(path)
    assert plan.experiment.name == path.stem
    assert summary_of(plan)["trials"] > 0


def test_a_person_at_the_page_is_the_hand_of_a_simulated_device(tmp_path: Path) -> None:
    person = plan_of(tmp_path, operator={"kind": "person"})
    assert person.document({}, "")["haptic_node"]["operator"] == {"kind": "interactive"}
    assert "operator" not in person.document({"haptic_node.driver": "haply"}, "")["haptic_node"] or (
        person.document({"haptic_node.driver": "haply"}, "")["haptic_node"]["operator"]["kind"] != "interactive"
    )
    simulated = plan_of(tmp_path)
    assert simulated.document({}, "")["haptic_node"]["operator"]["kind"] == "force_profile"


def test_the_delay_of_the_picture_is_no_key_of_the_scenario(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, factors={"picture.delay_s": [0.0, 0.2], "round_trip_ms": [0, 40]})
    trial = next(t for t in plan.trials("P01") if t.condition["picture.delay_s"] == 0.2)
    assert trial.settings["picture.delay_s"] == 0.2
    assert "picture" not in plan.document(trial.settings, "")
    assert plan.restarting == ()
