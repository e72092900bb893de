"""A wrong value of an option is refused before the command begins its work, by the name of the option or the value.

The commands are those of the project and of its packages, with every option that takes a value.
"""

import contextlib
import math
import os
import resource
import select
import shlex
import shutil
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from telenano.cli.root import app
from telenano.settings import DEMO_RECORDING

WRONG = "no such value"
# A command that is refused is done in a fraction of this time of the processor; one that has begun goes on [s].
MOST_S = 2.0
# What a command is given beside the option that is tried, where it needs more than recordings and folders.
WORDS = {
    "up": "--scenario fig12",
    "session": "mark",
    "topic echo": "afm/state",
    "topic hz": "afm/state",
    "link set": "delay_s=0.01",
    "link profile": "5g",
    "link udp": "127.0.0.1:5000 127.0.0.1:5001",
    "record": "--out out",
    "scenario check": "fig12",
    "scenario new": "fig12",
    "law balance": "wave",
    "law by-line": "--scenario fig12",
    "new": "law my_law",
    "bag export": f"{DEMO_RECORDING} --out out/made --to mcap-json",
    "bag rerun": f"{DEMO_RECORDING} --node controller@master",
    "device probe": "simulated_impedance",
    "device trial": "haply",
    "push": "--from 0,0 --to 100,0",
    "study stability": "--environment spring --law wave --out out/made",
}
# Options that take any text, name a file that the command writes, or need what is not here, with the reason.
ANY = {
    "--out": "a folder or file that is written",
    "--name": "a name that a person chooses",
    "--note": "a sentence",
    "--reason": "a sentence",
    "--namespace": "a name that a person chooses",
    "--independent-stop": "a sentence",
    "--device-id": "a name that a person chooses",
    "--link": "a path that is written",
    "--calibration": "a file that an emulator writes",
    "--fast-path": "a file that an emulator writes",
    "--exclude": "a pattern, which need not fit",
    "--port": "a device that is opened when a person has answered",
    "--field": "a field is looked for in what a rig sends",
    "--host": "an address is looked up by the system",
    "--dir": "a folder that is written",
    "--ignore": "a field that need not be there",
}
# Commands that are refused for another reason before they look at the option: files of other makers, experiments.
MOST_REFUSED_BEFORE = 0.25


def commands() -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words of each command and the command."""

    def below(group: Any, words: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Any]]:
        context = typer.Context(group)
        for name in group.list_commands(context):
            _, command, _ = group.resolve_command(context, [name])
            if hasattr(command, "commands"):
                yield from below(command, (*words, name))
            else:
                yield (*words, name), command

    yield from below(typer.main.get_command(app), ())


def filled(words: tuple[str, ...], command: Any, left_out: str) -> list[str]:
    """Return what a command must have besides the option that is tried."""
    if given := WORDS.get(" ".join(words)):
        return given.split()
    found = []
    for parameter in command.params:
        if parameter.required and parameter.name != left_out:
            is_option = parameter.param_type_name == "option"
            value = "out/made" if parameter.name == "out" else "1" if is_option else str(DEMO_RECORDING)
            found += [parameter.opts[0], value] if is_option else [value]
    return found


CASES = [
    (words, command, option)
    for words, command in commands()
    for option in command.params
    if option.param_type_name == "option" and not option.is_flag and not option.hidden and option.opts[0] not in ANY
]


def ended(words: list[str], most_s: float) -> tuple[int, str] | None:
    """Run a command in a child; return its exit code and output, or None if it takes more than a time.

    The time is that of the processor; on the clock it has ten times as much, for a command that waits takes none of the
    processor. A forked child has all modules already, and can be killed in the middle of compiled code.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(time.process_time() + most_s), resource.RLIM_INFINITY))
        result = CliRunner().invoke(app, words)
        os.write(writer, f"{result.exit_code}\n{result.output}".encode()[:60_000])
        os._exit(0)
    os.close(writer)
    try:
        with os.fdopen(reader, "rb") as pipe:
            readable, _, _ = select.select([pipe], [], [], 10.0 * most_s)
            text = pipe.read().decode() if readable else ""
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
    code, _, output = text.partition("\n")
    return (int(code), output) if code else None


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("HOME", str(tmp_path))


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "every",
    [
        pytest.param(8, marks=pytest.mark.check("tries an eighth of the options")),
        pytest.param(1, marks=pytest.mark.endurance("tries every option of every command")),
    ],
)
def test_a_wrong_value_is_refused_by_its_option_before_work_begins(every: int) -> None:
    assert len({words for words, _, _ in CASES}) > 60 and len(CASES) > 300
    cases = CASES[::every]
    wrong, refused_before = [], []
    for words, command, option in cases:
        flag = option.opts[0]
        asked = [*words, *filled(words, command, option.name), flag, WRONG]
        if (end := ended(asked, MOST_S)) is None:
            wrong.append(f"{' '.join(asked)}: the command has begun")
            continue
        code, output = end
        is_named = flag.lstrip("-") in output or WRONG in output
        if code and not is_named:
            refused_before.append(f"{' '.join(asked)}: {output}")
        elif not code or (Path.cwd() / "out" / "made").exists():
            wrong.append(f"{' '.join(asked)}: {code}, {output[-200:]}")
            shutil.rmtree("out", ignore_errors=True)
    assert not wrong, "\n".join(wrong)
    assert len(refused_before) < MOST_REFUSED_BEFORE * len(cases), refused_before


PATHS = [
    pytest.param(words, command, parameter, id=f"{' '.join(words)} {parameter.opts[0]}")
    for words, command in commands()
    for parameter in command.params
    if parameter.type_descriptor.annotation is Path
]


@pytest.mark.parametrize(("words", "command", "parameter"), PATHS)
def test_an_empty_path_is_refused_and_not_taken_for_the_current_folder(
    words: tuple[str, ...], command: Any, parameter: Any, tmp_path: Path
) -> None:
    is_option = parameter.param_type_name == "option"
    # A path that is no option is the first or the last of those that a command has.
    before = [str(DEMO_RECORDING) for each in command.params if each.param_type_name == "argument"]
    place = (
        [each.name for each in command.params if each.param_type_name == "argument"].index(parameter.name)
        if (not is_option)
        else 0
    )
    asked = [*words, f"{parameter.opts[0]}="] if is_option else [*words, *before[:place], ""]
    result = CliRunner().invoke(app, asked)
    assert result.exit_code == 2
    assert "is empty" in result.output or "missing" in result.output, result.output
    assert list(tmp_path.iterdir()) == []


def test_a_command_that_is_printed_can_be_pasted(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["scenario", "new", "mine", "--out", "no; such.yaml"])
    shown = result.output.partition("next: ")[2]
    assert shlex.split(shown.replace(" && ", " ")) == [
        *("telenano", "scenario", "check", "no; such.yaml"),
        *("telenano", "up", "--scenario", "no; such.yaml"),
    ]
    assert CliRunner().invoke(app, ["scenario", "check", "no; such.yaml"]).exit_code == 0
