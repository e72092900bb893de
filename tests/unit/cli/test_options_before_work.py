"""A wrong value of an option is refused before the command begins its work, by the name of the option or the value.

The commands are those of the project and of its packages, with every option that takes a value.
"""

import shlex
import shutil
from pathlib import Path

import pytest
from command_lines import commands, needed
from ended_commands import ended
from typer.testing import CliRunner

from telenano.cli.root import app

WRONG = "no such value"
# A command that is refused is done in a fraction of this time of the processor; one that has begun goes on [s].
MOST_S = 2.0
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


CASES = [
    (words, command, option)
    for words, command in commands()
    for option in command.params
    if option.param_type_name == "option" and not option.is_flag and not option.hidden and option.opts[0] not in ANY
]


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
        asked = [*words, *needed(words, command, [option.name]), flag, WRONG]
        end = ended(asked, MOST_S)
        if isinstance(end, str):
            wrong.append(f"{' '.join(asked)}: the command has begun")
            continue
        code, output = end.code, end.output
        is_named = flag.lstrip("-") in output or WRONG in output
        if code and not is_named:
            refused_before.append(f"{' '.join(asked)}: {output}")
        elif not code or (Path.cwd() / "out" / "made").exists():
            wrong.append(f"{' '.join(asked)}: {code}, {output[-200:]}")
            shutil.rmtree("out", ignore_errors=True)
    assert not wrong, "\n".join(wrong)
    assert len(refused_before) < MOST_REFUSED_BEFORE * len(cases), refused_before


@pytest.mark.parametrize(
    "name", ["no; such.yaml", "-x y.yaml", "it's.yaml", "$(id) `id`.yaml", "a  b\t.yaml", "--out.yaml"]
)
def test_a_command_that_is_printed_can_be_pasted(name: str) -> None:
    result = CliRunner().invoke(app, ["scenario", "new", "mine", f"--out={name}"])
    shown = shlex.split(result.output.partition("next: ")[2].replace(" && ", " "))
    file = shown[3]
    assert shown == ["telenano", "scenario", "check", file, "telenano", "up", file]
    assert Path(file) == Path(name)
    assert CliRunner().invoke(app, shown[1:4]).exit_code == 0
