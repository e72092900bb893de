"""How changes and reports come in: the titles of commits, the hooks, and the forms for what a stranger reports."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import commit_title
import pytest
import yaml
from typer.main import get_command

from telenano.cli.lazy_commands import LAZY_COMMANDS
from telenano.cli.root import app

ROOT = Path(__file__).parents[2]
GITHUB = ROOT / ".github"


@pytest.mark.parametrize(
    "message",
    [
        "page: keep Arm within reach after a stop",
        "afm_node: retract\n\nA body. With sentences.",
        "\n# a comment of git\nwide-area: dial out\n",
        "core lines: count them",
        "Merge branch 'page'",
        'Revert "page: keep Arm"',
        "fixup! page: keep Arm",
    ],
)
def test_a_title_with_an_area_is_taken(message: str) -> None:
    assert commit_title.fault_of(message) == ""


@pytest.mark.parametrize(
    ("message", "part"),
    [
        ("", "of the form"),
        ("Keep Arm within reach", "of the form"),
        ("Page: keep Arm", "of the form"),
        ("page:keep Arm", "of the form"),
        ("page: ", "of the form"),
        ("# page: a comment\nno title", "no title"),
        ("page: keep Arm.", "full stop"),
        (f"page: {'x' * 95}", "101 characters"),
    ],
)
def test_another_title_is_refused_with_what_would_be_right(message: str, part: str) -> None:
    assert part in commit_title.fault_of(message)


def hooks() -> dict[str, dict[str, Any]]:
    settings = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    return {hook["id"]: hook for repository in settings["repos"] for hook in repository["hooks"]}


def test_the_hook_of_the_message_is_the_command_that_refuses_it(tmp_path: Path) -> None:
    message = tmp_path / "message"
    words = hooks()["commit-title"]["entry"].replace(".venv/bin/python", sys.executable).split()
    for text, code in (("page: keep Arm", 0), ("Keep Arm", 1)):
        message.write_text(text)
        done = subprocess.run([*words, str(message)], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == code, done.stderr
    assert done.stderr.startswith("commit message: 'Keep Arm' is not of the form `area: what`")


def test_the_hook_of_a_commit_is_the_lint_of_make_test() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert hooks()["lint"]["entry"].split()[::2] == ["make", "lint"]
    assert re.search(r"^lint: .*\n\t\$\(LINT\)$", makefile, re.MULTILINE)
    assert "{ $(LINT); }" in makefile


def test_the_form_of_a_fault_asks_for_what_tells_of_the_machine() -> None:
    form = yaml.safe_load((GITHUB / "ISSUE_TEMPLATE" / "fault.yml").read_text(encoding="utf-8"))
    asked = {part["id"]: part for part in form["body"] if part["type"] != "markdown"}
    assert {"version", "doctor", "recording", "steps"} <= set(asked)
    required = {name for name, part in asked.items() if part.get("validations", {}).get("required")}
    assert {"version", "doctor", "steps"} <= required
    # Every command that a form names is one that there is.
    named = set(re.findall(r"`telenano ([a-z]+)", yaml.safe_dump(form, width=1000)))
    assert {"doctor", "bag"} <= named <= {*get_command(app).commands, *LAZY_COMMANDS}  # type: ignore[attr-defined]


def test_targets_that_the_pull_request_names_are_in_the_makefile() -> None:
    text = (GITHUB / "PULL_REQUEST_TEMPLATE.md").read_text(encoding="utf-8")
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = set(re.findall(r"`make ([a-z-]+)`", text))
    assert {"test", "check"} <= named <= targets
