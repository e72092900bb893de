"""The commands of this package answer for help, and put their results where those of telenano are."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from telenano_experiments.commands import COMMANDS
from typer.testing import CliRunner

from telenano.cli.lazy_commands import load
from telenano.cli.root import app


def with_inner(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    yield path, command
    for name, child in getattr(command, "commands", {}).items():
        yield from with_inner(child, f"{path} {name}")


FOUND = {path: command for name in COMMANDS for path, command in with_inner(load(name), name)}


@pytest.mark.parametrize("path", sorted(FOUND))
def test_every_command_answers_help_and_every_option_has_a_text(path: str) -> None:
    done = CliRunner().invoke(app, [*path.split(), "--help"])
    assert done.exit_code == 0 and "Usage" in done.output
    for parameter in getattr(FOUND[path], "params", []):
        assert getattr(parameter, "help", None), f"{path} {parameter.name} has no help"


def test_the_page_of_the_package_names_every_option() -> None:
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    for path, command in FOUND.items():
        if not getattr(command, "commands", None):
            part = text.partition(f"\n## telenano {path}\n")[2].partition("\n## ")[0]
            options = [one for one in command.params if one.param_type_name == "option"]
            flags = {one.opts[0] for one in options if one.name not in ("help", "rig")}
            assert part and {flag for flag in flags if f"`{flag}" not in part} == set(), path


def test_results_go_below_out_but_what_people_did_is_kept_beside_it() -> None:
    places = {
        path: parameter
        for path, command in FOUND.items()
        for parameter in getattr(command, "params", [])
        if "--out" in parameter.opts
    }
    assert Path(places["benchmark"].default).parts[0] == "out"
    assert "default: experiments/NAME" in places["experiment run"].help
