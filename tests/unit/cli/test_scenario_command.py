"""Scenarios and their keys on the command line, and the schemas by which editors complete them."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import scenario_page
import yaml

from telenano.cli import completion
from telenano.launcher.plan import UpRequest, make_plan
from telenano.launcher.scenario_keys import all_keys, scenario_schema, site_schema, value_at
from telenano.settings.config import read_yaml
from telenano.settings.included import SCENARIO_DIRECTORY, SCHEMA_DIRECTORY, SITE_DIRECTORY
from telenano.testing import run
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import SERVICES


@pytest.fixture(scope="module")
def core() -> dict[str, Any]:
    """Return what an installation without packages has: the schema of a scenario, its page, and no entries."""
    program = """
import json, scenario_page
from telenano.settings.plugins import all_installed
from telenano.launcher.scenario_keys import scenario_schema
found = {"schema": scenario_schema(), "page": scenario_page.page(), "installed": all_installed()}
print(json.dumps(found))
"""
    folders = [str(Path(scenario_page.__file__).parent), str(SCHEMA_DIRECTORY.parents[1])]
    environment = {**os.environ, "TELENANO_WITHOUT_PACKAGES": "1", "PYTHONPATH": os.pathsep.join(folders)}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, timeout=120, check=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_an_installation_without_packages_has_nothing_of_them(core: dict[str, Any]) -> None:
    assert core["installed"] == []
    controller = core["schema"]["properties"]["controller"]["properties"]
    assert "wave" in controller["law"]["enum"] and "two_layer" not in controller["law"]["enum"]
    assert "two_layer" not in controller and "two_layer" in scenario_schema()["properties"]["controller"]["properties"]


def test_the_schema_has_every_key_that_the_files_of_the_project_have() -> None:
    names = {key.name for key in all_keys()}
    assert {"name", "duration_s", "controller.law", "controller.wave.filter_s", "delay_node.forward.delay_s"} <= names
    assert {"afm_node.tip_sample.hamaker_j", "haptic_node.device.preset", "recorder.quota_bytes"} <= names
    schema = scenario_schema()
    for path in SCENARIO_DIRECTORY.glob("*.yaml"):
        for section, value in read_yaml(path).items():
            properties = schema["properties"][section].get("properties")
            assert properties is None or set(value) <= set(properties)
    for path in SITE_DIRECTORY.glob("*.yaml"):
        assert set(read_yaml(path)) <= set(site_schema()["properties"])


def test_every_reference_of_a_schema_leads_somewhere() -> None:
    schema = scenario_schema()
    text = json.dumps(schema)
    for name in (part.split('"')[0] for part in text.split('"$ref": "#/$defs/')[1:]):
        assert name in schema["$defs"], name


@pytest.mark.check("takes 0.9 s")
def test_a_key_has_default_range_and_unit() -> None:
    found = {key.name: key for key in all_keys()}["controller.virtual_impedance.force_gain"]
    assert (found.default, found.least, found.most) == (20.0, 0.0, 1e9)
    code, out, _ = run("param", "list", "afm_node.cantilever", "--json")
    rows = json.loads(out)["keys"]
    assert code == 0
    assert rows[0]["key"] == "afm_node.cantilever.stiffness_n_per_m"
    assert all("[" in row["about"] or row["key"].endswith(("quality", "gain", "steps_per_period")) for row in rows)
    assert run("param", "list", "telepathy")[0] == 2


@pytest.mark.check("takes 0.9 s")
def test_the_first_list_of_keys_is_short_and_leads_to_the_others() -> None:
    first = {row["key"] for row in json.loads(run("param", "list", "--json")[1])["keys"]}
    every = {row["key"] for row in json.loads(run("param", "list", "--all", "--json")[1])["keys"]}
    assert first < every == {key.name for key in all_keys()}
    assert len(first) <= 120
    assert {"controller.law", "delay_node.profile", "afm_node.sample.name", "afm_node.rest_distance_m"} <= first
    assert f"{len(every) - len(first)} more: `telenano param list --all`" in run("param", "list")[1]


def test_a_value_is_that_of_the_scenario_or_the_default() -> None:
    assert json.loads(run("param", "get", "afm_node.rest_distance_m", "--json")[1])["value"] == 1e-8
    assert run("param", "get", "controller.wave.filter_s")[1] == "0.02\n"
    code, out, _ = run("param", "get", "controller.law", "--set", "controller.law=smith", "--json")
    assert (code, json.loads(out)["value"]) == (0, "smith")
    code, _, err = run("param", "get", "controller.telepathy")
    assert code == 2
    assert "controller has no key telepathy; known are law, period_s" in err


def test_what_param_dumps_is_a_scenario_that_runs_the_same(tmp_path: Path) -> None:
    path = tmp_path / "full.yaml"
    path.write_text(run("param", "get")[1])
    plan = make_plan(UpRequest(scenario=str(path), out=tmp_path / "out"), tmp_path)
    assert plan.scenario.duration_s == 8.0
    dumped = json.loads(run("param", "get", "--json")[1])
    assert value_at(dumped, "haptic_node.operator.points.0.time_s") == 0.8
    assert value_at(dumped, "delay_node.profile") == "clean"
    with pytest.raises(ConfigError, match="the scenario has no key link"):
        value_at(dumped, "link.x")
    # below a value the keys beside it are those that can be meant
    with pytest.raises(
        ConfigError, match=r"controller\.law is 'virtual_impedance' and has no keys; known are law, period_s"
    ):
        value_at(dumped, "controller.law.period_s")
    with pytest.raises(ConfigError, match=r"name\.x: name has no key x; known are name, "):
        value_at(dumped, "name.x")


def test_a_new_scenario_is_valid_and_names_its_schema(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    assert run("scenario", "new", "mine", "--out", str(path))[0] == 0
    first = path.read_text().splitlines()[0]
    assert first == f"# yaml-language-server: $schema=file://{SCHEMA_DIRECTORY / 'scenario.json'}"
    assert yaml.safe_load(path.read_text())["name"] == "mine"
    code, out, _ = run("scenario", "check", str(path))
    assert (code, out) == (0, f"{path}: valid, 8 s\n")
    assert run("scenario", "new", "mine", "--out", str(path))[0] == 2
    assert run("scenario", "new", "Not Mine", "--out", str(tmp_path / "x.yaml"))[0] == 2


def test_a_wrong_scenario_is_refused_by_key() -> None:
    code, _, err = run("scenario", "check", "fig12", "--set", "controller.wave.filter_s=-1")
    assert code == 2
    assert "controller.wave.filter_s: Input should be greater than or equal to 0 (allowed is from 0 to 1e+06)" in err
    names = [row["scenario"] for row in json.loads(run("scenario", "list", "--json")[1])["scenarios"]]
    assert {"fig12", "touch"} <= set(names)
    assert "duration_s: 8.0" in run("scenario", "show", "fig12")[1]


def test_the_shell_completes_names() -> None:
    assert "fig12" in completion.scenario_names("fi")
    assert completion.topic_names("teleop/f") == ["teleop/forward", "teleop/forward@slave"]
    assert completion.law_names("wave,sm") == ["wave,smith"]
    assert completion.law_names("al") == ["all"]
    # one law, one node: what the command takes
    assert completion.law_name("") == [name for name in completion.law_names("") if name != "all"]
    assert completion.service_names("") == [*SERVICES, "list"]
    assert "controller@slave" in completion.node_names("contr")
    assert completion.scenario_sections("af") == ["afm_node"]


def test_the_shell_completes_keys_of_a_scenario_and_their_values() -> None:
    assert completion.scenario_keys("del") == ["delay_node."]
    assert completion.scenario_keys("delay_node.forward.jitter.d") == ["delay_node.forward.jitter.distribution="]
    assert completion.scenario_keys("delay_node.fo") == ["delay_node.forward."]
    assert completion.scenario_keys("controller.law=w") == ["controller.law=wave"]
    assert completion.scenario_keys("recorder.") != []
    assert completion.scenario_keys("no_such.key") == []


def test_names_of_laws_are_completed_without_importing_one() -> None:
    code = (
        "import sys; from telenano.cli.completion import law_names; law_names('');"
        "print([m for m in ('numpy', 'numba', 'pydantic', 'telenano.extend.laws') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "[]\n"


def test_what_a_topic_is_needs_no_rig() -> None:
    code, out, _ = run("topic", "info", "afm/state", "--json")
    facts = json.loads(out)
    assert code == 0
    assert (facts["message"], facts["declared rate [Hz]"]) == ("AfmState", 1000.0)
    units = {row["field"]: row["unit"] for row in facts["fields"]}
    assert (units["tip_force_n"], units["separation_m"]) == ("N", "m")
    assert run("topic", "info", "afm/stat")[0] == 2


def test_what_is_published_by_hand_is_checked_first() -> None:
    code, _, err = run("topic", "pub", "operator/force", "{force_n: [0, 0, -1]}", "--as", "afm_node@slave")
    assert (code, "afm_node@slave does not publish it, view does" in err) == (2, True)
    code, _, err = run("topic", "pub", "operator/force", "{strength: 1}")
    assert (code, "unknown: strength; missing: force_n" in err) == (2, True)
    code, _, err = run("topic", "pub", "operator/force", "1")
    assert (code, "must be a mapping" in err) == (2, True)


def test_the_nodes_are_listed_with_what_they_publish() -> None:
    code, out, _ = run("node", "list", "--json")
    rows = {row["node"]: row for row in json.loads(out)["nodes"]}
    assert code == 0
    assert rows["afm_node@slave"]["publishes"].startswith("afm/state")


@pytest.mark.parametrize("arguments", [("-h",), ("up", "-h"), ("study", "stability", "-h"), ("bag", "-h")])
def test_h_is_help(arguments: tuple[str, ...]) -> None:
    code, out, _ = run(*arguments)
    assert code == 0
    assert "Usage:" in out
    if arguments == ("-h",):
        assert [line for line in out.splitlines() if line in ("Run:", "Look:", "Study:", "Set up:")]


@pytest.mark.endurance
def test_the_shell_completes_commands_options_and_values() -> None:
    root = Path(__file__).parents[3]
    code = "import sys; sys.argv = ['telenano']; from telenano.cli.app import main; main()"
    for words, expected in (
        ("telenano sce", "scenario"),
        ("telenano up --sweep a --rou", "--round-trip-ms"),
        ("telenano up fi", "fig12"),
        ("telenano topic echo teleop/forward@", "teleop/forward@slave"),
    ):
        environment = {**os.environ, "PYTHONPATH": str(root), "_TELENANO_COMPLETE": "complete_bash"}
        environment |= {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert expected in done.stdout.split(), words
