"""What the guide to recordings names, exists."""

import re
from pathlib import Path

import typer
from typer.main import get_command

from services.player.command import replay
from services.player.node import SETTERS
from services.recorder.command import record
from services.recorder.node import ACTIONS
from telenano.cli.commands.bag import app
from telenano.cli.commands.simulate import simulate

ROOT = Path(__file__).resolve().parents[3]
GUIDE = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")
# of `telenano up` and `telenano session`, which have a guide of their own
# options of other commands; --kbit-per-s is of `bag fetch`, which a package has
ELSEWHERE = {"--set", "--without", "--target", "--scenario", "--help", "--kbit-per-s"}


def options() -> set[str]:
    commands = typer.Typer()
    commands.command()(replay)
    commands.command()(record)
    commands.command()(simulate)
    commands.add_typer(app, name="bag")
    root = get_command(commands)
    found = set(ELSEWHERE)
    for command in (*root.commands.values(), *root.commands["bag"].commands.values()):
        found |= {name for parameter in command.params for name in parameter.opts}
    return found


def test_every_option_in_the_guide_exists() -> None:
    named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", GUIDE))
    assert named - options() == set()
    assert {"--nodes", "--split-size", "--to"} <= named


def test_every_command_on_recordings_is_in_the_guide() -> None:
    commands = get_command(app).commands
    assert {name for name in commands if name not in GUIDE} == set()


def test_every_parameter_is_in_the_guide_and_none_is_made_up() -> None:
    assert set(re.findall(r"player\.[a-z_]+(?==|`)", GUIDE)) - {"player.md"} == set(SETTERS)
    assert set(re.findall(r"record\.(?:split|status)", GUIDE)) == set(ACTIONS)
