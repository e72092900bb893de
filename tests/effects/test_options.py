"""Each option of a command has an effect: a valid other value changes the exit code, the output or a file."""

import random
from pathlib import Path
from typing import Any

import pytest
from option_effects import COMMANDS, OF_A_RIG, WITHOUT, commands, effect_of

SEED = 93
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


@pytest.mark.endurance("takes 20 min")
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_an_effect(command: str, tmp_path: Path) -> None:
    found = without_effect([row for row in OPTIONS if row[0] == command], tmp_path)
    assert not found, f"{', '.join(found)}: {WHAT_TO_DO}"


@pytest.mark.check("takes 20 s")
def test_a_twentieth_of_the_options_has_an_effect(tmp_path: Path) -> None:
    found = without_effect(random.Random(SEED).sample(OPTIONS, len(OPTIONS) // 20), tmp_path)
    assert not found, f"{', '.join(found)}: {WHAT_TO_DO}"


def test_every_command_with_known_words_is_a_command() -> None:
    assert {name for name, _ in commands()} >= COMMANDS.keys() | OF_A_RIG.keys()
