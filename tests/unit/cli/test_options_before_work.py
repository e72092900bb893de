"""A wrong value of an option is refused before the command begins its work, by the name of the option or the value.

The commands are those of the project and of its packages, with every option that takes a value.
"""

import resource
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_lines import commands, needed
from ended_commands import ended
from typer.testing import CliRunner

from telenano.cli.root import app

WRONG = "no such value"
# The processor's time of a command that is refused, as a multiple of that for a word that is no option [1]; a command
# that has begun goes on.
MOST_RATIO = 20.0
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
    "record --topics": "a pattern, which a channel that comes later may fit",
    "--about": "a sentence",
    "--cite": "a sentence",
    "--dir": "a folder that is written",
    "--ignore": "a field that need not be there",
}
# What a command is given so that it comes to the option: files that the test makes, in place of a recording.
READS = {
    "topic pub": "operator/force '{force_n: [0, 0, -0.5]}'",
    "particles": "image.npy --size 100",
    "calibrate sensitivity": "--curve curve.txt",
    "calibrate stiffness": "--record record.txt --rate 100000 --sensitivity 50",
    "device calibrate stage": "--host 127.0.0.1 --out out/made --output 1 --output 2 --range 1 --stiffness 1"
    " --stiffness-error 0.1",
    "experiment run": "delay_and_law",
    "experiment plan": "delay_and_law --effect 1",
    "sample import": "curve.txt --out out/made.npz",
    "sample info": "curve.txt",
    "curve fit": "curve.txt --model hertz --radius 30 --set stiffness_n_per_m=1 --out out/made.csv",
}
# Commands that are refused for another reason before they look at the option: a folder of an experiment that was run, a
# page or an instrument that answers. One of a small part is no share.
MOST_REFUSED_BEFORE = 0.03


CASES = [
    (words, command, option)
    for words, command in commands()
    for option in command.params
    if option.param_type_name == "option"
    and not option.is_flag
    and not option.hidden
    and not {option.opts[0], " ".join([*words, option.opts[0]])} & ANY.keys()
]


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("HOME", str(tmp_path))
    np.save("image.npy", np.zeros((8, 8)))
    way_nm = np.linspace(0.0, 100.0, 200)
    rows = np.column_stack([way_nm, np.maximum(way_nm - 50.0, 0.0) / 50.0])
    np.savetxt("curve.txt", rows, header="way [nm]\tdeflection [V]", delimiter="\t", comments="")
    np.savetxt("record.txt", np.sin(np.arange(4096.0)))


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
    begun_s = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    assert not isinstance(ended(["scenario", "check", "--nosuch"], 60.0), str)
    most_s = MOST_RATIO * max(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - begun_s, 0.1)
    for words, command, option in cases:
        flag = option.opts[0]
        known = READS.get(" ".join(words))
        asked = [*words, *(shlex.split(known) if known else needed(words, command, [option.name])), flag, WRONG]
        end = ended(asked, most_s)
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
    assert len(refused_before) < max(MOST_REFUSED_BEFORE * len(cases), 3), refused_before


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
