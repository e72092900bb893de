"""The commands in the code blocks of README and docs: each is one that there is, with options that it takes."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from documented_lines import RULES, differing, lines, makes, pictures, rule_of, runner_of
from typer.testing import CliRunner

from telenano.cli.lazy_commands import load
from telenano.cli.model_options import validated
from telenano.cli.root import app
from telenano.console.send_commands import parse_parameters
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.runtime.wiring.observer import known_name
from telenano.sections.program_requests import requested
from telenano.settings.link_settings import LinkSettings, profile_changes
from telenano.settings.network_profiles import PROFILES

ROOT = Path(__file__).parents[3]
# what a page runs the command by, besides its own name
RUNNERS = ("docker", "docker-compose", "sudo")


def documented() -> Iterator[tuple[str, list[str]]]:
    """Return the arguments of each command line with `telenano`, and where it is."""
    for line in lines():
        if line.language not in ("python", "matlab"):
            yield from ((Path(line.page).name, found) for found in arguments_in(line.text))
    # the last cell of each row of the map of the paper
    for text in re.findall(r"`(telenano [^`]+)` \|$", (ROOT / "docs" / "paper.md").read_text(), re.MULTILINE):
        yield from (("paper.md", found) for found in arguments_in(text))


def arguments_in(line: str) -> Iterator[list[str]]:
    for part in re.split(r"&&|\|", line):
        if "telenano" not in part:
            continue
        words = shlex.split(part, comments=True)
        names = [place for place, word in enumerate(words) if Path(word).name == "telenano"]
        if names and (names[0] == 0 or words[0] in RUNNERS) and words[names[-1] + 1 :]:
            yield words[names[-1] + 1 :]


# names of packages of the reader's own, and what takes their place here
PLACEHOLDERS = {
    "$(cat out/line/way.json)": "{order: link}",
    "$(cat out/line/way_back.json)": "{delay_s: 0.01}",
    "my_law": "position_force",
    "{kind: my_hand, tremor_n: 0.1}": "{kind: force_profile}",
    "program=my_circle": "program=curve",
    "my_circle.radius_m": "curve.load_n",
    "two_sites.yaml": "two_sites",
}


def known_here(words: list[str]) -> list[str]:
    found = []
    for word in words:
        for name, own in PLACEHOLDERS.items():
            word = word if words[0] == "new" else word.replace(name, own)
        found.append(word)
    return found


COMMANDS = [(page, known_here(arguments)) for page, arguments in documented()]


def context_of(arguments: list[str]) -> Any:
    """Return the context of the command that is named, with its options read; a usage error if they are wrong."""
    command, context, rest = load(arguments[0]), None, arguments[1:]
    while True:
        context = command.make_context(command.name or arguments[0], list(rest), parent=context)
        left = [*context._protected_args, *context.args]
        if not hasattr(command, "commands") or (command.invoke_without_command and not left):
            return context
        _, command, rest = command.resolve_command(context, left)
        assert command is not None


def plan_of(options: dict[str, Any], folder: Path) -> Plan:
    """Return what `telenano up` would run; ConfigError names what is wrong."""
    given = {name: getattr(options[name], "value", options[name]) for name in UpRequest.model_fields if name in options}
    given["scenario"] = given.get("scenario") or options.get("experiment")
    given = {name: value for name, value in given.items() if value is not None}
    return make_plan(validated(UpRequest, {**given, "out": folder}), folder)


def check_settings(target: str, words: list[str], folder: Path) -> None:
    """Check what is set while a rig runs as a key of the scenario; ConfigError names what is wrong."""
    parameters = parse_parameters(words)
    if target == "afm_node" and "program" in parameters:
        requested(parameters)
        return
    settings = [f"{target}.{key}={value}" for key, value in parameters.items()]
    make_plan(UpRequest(scenario="fig12", out=folder, settings=tuple(settings)), folder)


def test_the_pages_have_commands_of_every_kind() -> None:
    assert len(COMMANDS) > 50
    assert {"up", "session", "link", "study", "bag", "replay", "report", "keys", "topic", "status", "doctor"} <= {
        arguments[0] for _, arguments in COMMANDS
    }


@pytest.mark.parametrize(("page", "arguments"), COMMANDS, ids=[f"{p}: {' '.join(a)}" for p, a in COMMANDS])
def test_a_documented_command_is_one_that_there_is(
    page: str, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the map of a page is made by the line before
    monkeypatch.setattr("telenano.sections.afm_section.AfmConfig.to_over_map", lambda config: None)
    context = context_of(arguments)
    options, path = context.params, context.command_path
    if path == "up":
        plan = plan_of(options, tmp_path)
        # what a page shows does what it says: nothing in it is overridden by something else
        assert plan.warning == ""
    elif path == "session" and options["command"] == "set":
        check_settings(options["target"], options["parameters"], tmp_path)
    elif path == "link set":
        check_settings("delay_node", options["settings"], tmp_path)
    elif path.startswith("topic") and "topic" in options:
        known_name(options["topic"])


def test_every_line_of_every_block_is_run_by_a_test_or_says_why_not() -> None:
    assert len(lines()) > 200
    assert [f"{line.page}: {line.text}" for line in lines() if not runner_of(line)] == []
    used = {rule_of(line) for line in lines()}
    assert [rule for rule in RULES if rule not in used] == []


def test_the_tests_that_run_the_lines_exist() -> None:
    there = {
        f"{path.name}::{name}"
        for folder in ("tests", "packages")
        for path in (ROOT / folder).rglob("test_*.py")
        for name in re.findall(r"^def (test_\w+)\(", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert {rule.test for rule in RULES if rule.test} <= there


@pytest.mark.check("takes 1.6 s")
def test_a_picture_of_the_gallery_is_what_its_command_makes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All others take longer, or a rig: tests/stack/test_pictures.py."""
    (picture,) = [one for one in pictures() if one.path == "pictures/dots.png"]
    (line,) = [one for one in lines() if one.page == picture.page and makes(one, picture.origin)]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    result = CliRunner().invoke(app, line.words)
    assert result.exit_code == 0, result.output
    assert differing(tmp_path / picture.origin, (ROOT / picture.page).parent / picture.path) < 0.01, (
        "run `make pictures`"
    )


def link_of(plan: Plan) -> LinkSettings:
    return plan.loaded.section("delay_node", LinkSettings)


@pytest.mark.parametrize("name", sorted(PROFILES))
def test_a_profile_of_a_known_scenario_has_the_delay_that_it_is_named_for(name: str, tmp_path: Path) -> None:
    options = context_of(["up", "--scenario", "fig12", "--set", f"delay_node.profile={name}"]).params
    plan = plan_of(options, tmp_path)
    assert profile_changes(link_of(plan)) == {}
    for way in ("forward", "backward"):
        expected = PROFILES[name].settings.get(way, {}).get("delay_s", 0.0)
        assert getattr(link_of(plan), way).delay_s == expected
