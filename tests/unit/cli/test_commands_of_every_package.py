"""The commands of the project's packages: each answers for help, and explains its options."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import command_page
import pytest
from typer.testing import CliRunner

from telenano.cli.lazy_commands import load_row, package_commands
from telenano.cli.root import app
from telenano.settings import plugins

FOLDERS = {row.target.partition(".")[0]: row.package for row in plugins.installed("commands").values()}


def with_inner(path: tuple[str, ...], command: Any, folder: str) -> Iterator[tuple[str, tuple[Any, str]]]:
    inner = getattr(command, "commands", None)
    if not inner:
        yield " ".join(path), (command, folder)
    for name, child in (inner or {}).items():
        yield from with_inner((*path, name), child, folder)


FOUND = dict(
    found
    for path, row in package_commands().items()
    if row.entry
    for found in with_inner(path, load_row(path[-1], row, path), FOLDERS[row.module.partition(".")[0]])
)


@pytest.mark.parametrize("words", sorted(FOUND))
def test_a_command_answers_help_and_each_of_its_options_says_what_it_does(words: str) -> None:
    command, _ = FOUND[words]
    done = CliRunner().invoke(app, [*words.split(), "--help"])
    assert done.exit_code == 0 and "Usage" in done.output
    options = [one for one in command.params if one.param_type_name == "option" and one.name not in ("help", "rig")]
    assert [one.name for one in options if not one.help] == []
    # What people did is kept beside the results of computations: `experiment run` has a folder of its own.
    assert all(Path(one.default).parts[0] == "out" for one in options if "--out" in one.opts and one.default)


def test_a_length_at_the_instrument_is_in_nanometres_in_every_command() -> None:
    core = {path.removeprefix("telenano "): command for path, command in command_page.commands().items()}
    found = {**core, **{words: command for words, (command, _) in FOUND.items()}}
    metres = {
        f"{words} {one.opts[0]}"
        for words, command in found.items()
        for one in getattr(command, "params", [])
        if re.search(r"\[(m|um|mm|m/s|m/V)\]", getattr(one, "help", None) or "")
    }
    # the arm of a handle moves by centimetres; what a file or a function of a person's own has is in SI
    of_the_hand, of_own = {"device calibrate handle --gauge"}, ("--pattern", "--sample")
    assert {name for name in metres if not name.endswith(of_own)} == of_the_hand
    assert {name for name in metres if name.endswith("--pattern")}
