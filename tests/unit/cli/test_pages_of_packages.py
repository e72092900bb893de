"""The commands of the project's packages: each answers for help, and the page of its package has its options."""

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

ROOT = Path(__file__).parents[3]
FOLDERS = {row.target.partition(".")[0]: row.package for row in plugins.installed("commands").values()}


def pages_of(folder: str) -> list[str]:
    """Return the pages of a package: its README, and one for each of its parts."""
    own = ROOT / "packages" / folder
    return [path.read_text(encoding="utf-8") for path in (own / "README.md", *sorted(own.glob("docs/*.md")))]


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
def test_a_command_answers_help_and_its_page_names_every_option(words: str) -> None:
    command, folder = FOUND[words]
    done = CliRunner().invoke(app, [*words.split(), "--help"])
    assert done.exit_code == 0 and "Usage" in done.output
    # A package of several commands has a heading or an item of a list for each.
    item = rf"^(?:#+ |- `)telenano {words}(?:\n|`).*?(?=\n(?:#+ |- `telenano)|\Z)"
    pages = pages_of(folder)
    own = [found[0] for page in pages if (found := re.search(item, page, re.DOTALL | re.MULTILINE))]
    part = own[0] if own else "\n".join(page for page in pages if f"telenano {words}" in " ".join(page.split()))
    options = [one for one in command.params if one.param_type_name == "option" and one.name not in ("help", "rig")]
    assert [one.name for one in options if not one.help] == []
    assert {one.opts[0] for one in options if not re.search(rf"`{one.opts[0]}[ /`]", part)} == set()
    # What people did is kept beside the results of computations: `experiment run` has a folder of its own.
    assert all(Path(one.default).parts[0] == "out" for one in options if "--out" in one.opts and one.default)


@pytest.mark.parametrize("folder", sorted(set(FOLDERS.values())))
def test_a_page_has_no_command_or_option_that_is_gone(folder: str) -> None:
    page = "\n\n".join(pages_of(folder))
    there = {words: command for words, (command, of) in FOUND.items() if of == folder}
    headings = re.findall(r"^## telenano (.+)$", page, re.MULTILINE)
    assert [words for words in headings if not any(f"{one} ".startswith(f"{words} ") for one in there)] == []
    options = {flag for command in there.values() for one in command.params for flag in one.opts}
    lists = [part for part in page.split("\n\n") if part.startswith(("Options", "- `--", "- `telenano"))]
    named = {flag for part in lists for flag in re.findall(r"`(--[a-z-]+)", part)}
    assert named and named <= {*options, "--help"}


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
