"""Each option of a command has an effect: a valid other value changes the exit code, the output or a file."""

import inspect
import random
from pathlib import Path
from typing import Any

import pytest
from changed_files import touches
from option_effects import (
    ACTS,
    BEFORE,
    COMMANDS,
    COSTLY,
    OF_A_RIG,
    REFUSES,
    SLOW,
    VALUES,
    WITHOUT,
    commands,
    content_of,
    effect_of,
)

from telenano.recording import Selection, filter_recording
from telenano.settings import DEMO_RECORDING

ROOT = Path(__file__).parents[2]
SEED = 93
# Options of changed commands that `make check` tries at most.
MOST_TOUCHED = 12
WHAT_TO_DO = (
    "changes nothing: use it, or give in tests/effects/option_effects.py words in COMMANDS with which it acts, a valid"
    " other value in VALUES or, in WITHOUT, the reason"
)
OPTIONS = [
    (name, option)
    for name, command in commands()
    if name in COMMANDS
    for option in command.params
    if option.param_type_name == "option" and not option.hidden
    if not {option.opts[0], f"{name} {option.opts[0]}"} & WITHOUT.keys()
]


def without_effect(tried: list[tuple[str, Any]], folder: Path) -> list[str]:
    return [f"{name} {option.opts[0]}" for name, option in tried if not effect_of(name, option, folder)]


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(tmp_path / "keys"))


@pytest.mark.endurance("takes 20 min")
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_an_effect(command: str, tmp_path: Path) -> None:
    found = without_effect([row for row in OPTIONS if row[0] == command], tmp_path)
    assert not found, f"{', '.join(found)}: {WHAT_TO_DO}"


def file_of(command: str) -> str:
    """Return where a command is written."""
    code = inspect.unwrap(dict(commands())[command].callback).__code__
    return Path(code.co_filename).relative_to(ROOT).as_posix()


def of_drawn_commands(rows: list[tuple[str, Any]], count: int) -> list[tuple[str, Any]]:
    """Return so many options, those of one command side by side: it is run as it is once for all of them."""
    names = sorted({name for name, _ in rows})
    random.Random(SEED).shuffle(names)
    return [row for name in names for row in rows if row[0] == name][:count]


def drawn() -> list[tuple[str, Any]]:
    """Return as many quick options as a twentieth of all, and some of commands whose file a change touches."""
    cheap = [row for row in OPTIONS if row[0] not in COSTLY]
    some = of_drawn_commands([row for row in cheap if row[0] not in SLOW], len(cheap) // 20)
    touched = [row for row in cheap if row not in some and touches(file_of(row[0]))]
    # A change of many commands has a part of them tried, as it has of keys.
    return [*some, *of_drawn_commands(touched, MOST_TOUCHED)]


@pytest.mark.check("takes 30 s")
@pytest.mark.timeout(1800)
def test_a_twentieth_of_the_options_and_those_that_a_change_touches_have_an_effect(tmp_path: Path) -> None:
    found = without_effect(drawn(), tmp_path)
    assert not found, f"{', '.join(found)}: {WHAT_TO_DO}"


def test_a_small_recording_is_compared_by_its_messages_and_one_that_is_cut_off_by_its_bytes(tmp_path: Path) -> None:
    made, other, cut = (tmp_path / f"{name}.mcap" for name in ("made", "other", "cut"))
    filter_recording(DEMO_RECORDING, made, Selection.of(["link/status"]))
    filter_recording(DEMO_RECORDING, other, Selection.of(["node/health"]))
    cut.write_bytes(made.read_bytes()[:4000])
    _, messages = content_of(made)
    assert {message.channel.topic for message in messages} == {"link/status"}
    assert content_of(other) != content_of(made)
    assert content_of(cut) == cut.read_bytes()


def test_every_command_is_tried_or_has_its_reason() -> None:
    every = {name for name, _ in commands()}
    assert every == COMMANDS.keys() | OF_A_RIG.keys(), (
        "give a row in COMMANDS of tests/effects/option_effects.py, or in OF_A_RIG the reason for none"
    )
    assert not COMMANDS.keys() & OF_A_RIG.keys()


def test_every_row_is_of_a_command_and_an_option_that_is_tried() -> None:
    tried = {(name, option.opts[0]) for name, command in commands() if name in COMMANDS for option in command.params}
    known = COMMANDS.keys() | {f"{name} {option}" for name, option in tried}
    assert known >= ACTS.keys() | BEFORE.keys() | {*COSTLY, *SLOW}
    # A value for options of all commands is that of one which has none of its own.
    general = {option for name, option in tried if f"{name} {option}" not in VALUES}
    assert known | general >= VALUES.keys()
    assert known | {option for _, option in tried} >= REFUSES.keys() | WITHOUT.keys()
