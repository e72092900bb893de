"""SIGINT and SIGTERM at random times: a command with a result leaves it whole, named as a part, or not at all.

The table has every command that writes a result; six of them run in `make test`, all of them in `make endurance`.
"""

import json
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import pytest
from interruptions import Ended, as_at_a_terminal, environment, files_below, interrupted

from telenano.cli.exit_codes import EXIT_INTERRUPTED, EXIT_TERMINATED
from telenano.sections.surface_files import read_surface

CODES = {signal.SIGINT: EXIT_INTERRUPTED, signal.SIGTERM: EXIT_TERMINATED}


class Recipe(NamedTuple):
    """A command with its options; {out} is its result, and where there is none it prints one."""

    arguments: str
    in_make_test: bool = False


RECIPES = {
    "scan": Recipe("scan --pixels 32 --lines 32 --out {out}", True),
    "curve": Recipe("curve --model dynamic --points 100 --out {out}"),
    "sample": Recipe("sample --out {out}"),
    "reproduce": Recipe("reproduce models --out {out}"),
    "study stability": Recipe(
        "study stability --law wave --environment spring --stiffness 10 --delay 0:80:20 --workers 2 --out {out}",
        True,
    ),
    "study transparency": Recipe("study transparency --law position_force --delay 0 --out {out}"),
    "study advise": Recipe("study advise --delay 40 --seeds 1 --workers 2 --out {out}"),
    "study promises": Recipe("study promises --law passivity --seeds 1 --workers 2 --out {out}"),
    "study push": Recipe("study push --law passivity --delay 50 --loss 0 --seeds 2 --workers 2 --out {out}"),
    "study drift": Recipe("study drift --law passivity --speed 10 --time-constant 5 --seeds 1 --workers 2 --out {out}"),
    "study gallery": Recipe("study gallery --out {out}"),
    "benchmark": Recipe("benchmark --quick --law wave --workers 2 --out {out}"),
    "assemble": Recipe(
        "assemble --pattern line --count 1 --afm sample.particles.places=[[2e-7,0.0]] --afm sample.size_m=2.5e-6"
        " --out {out}"
    ),
    "report": Recipe("report {recording} --out {out}", True),
    "compare": Recipe("compare {recording} {other} --out {out}"),
    "bag export": Recipe("bag export {recording} --to hdf5 --out {out}", True),
    "bag filter": Recipe("bag filter {recording} --out {out}.mcap"),
    "bag merge": Recipe("bag merge {parts} --out {out}.mcap", True),
    "bag split": Recipe("bag split {recording} --interval 1 --out {out}"),
    "bag recover": Recipe("bag recover {recording} --out {out}.mcap"),
    "bag plot": Recipe("bag plot {recording} afm/state.tip_force_n.2 --out {out}.png"),
    "scenario new": Recipe("scenario new mine --out {out}.yaml"),
    "experiment new": Recipe("experiment new mine --out {out}.yaml"),
    "new": Recipe("new law mine --out {out}"),
}
# the formats of an export are written by different libraries
VARIANTS = (
    *(f"bag export {{recording}} --to {kind} --out {{out}}" for kind in ("csv", "parquet", "mcap-json")),
    "scan --mode contact --pixels 32 --lines 32 --out {out}",
)
# why a command with --out is not in the table
ELSEWHERE = {
    "up": "a session ends with its recording, figure and summary: tests/stack/test_fig12.py",
    "simulate": "its nodes stop in order and the file is completed: tests/unit/virtual/test_virtual_session.py",
    "experiment publish": "renames a folder when it is whole: test_experiment_publish.py",
    "experiment run": "each trial is in the journal when it is over: test_experiment_runner.py",
    "experiment analyse": "reads a journal, and writes all at once at the end by `results_in`",
    "record": "a recorder completes its file: tests/stack/test_running_rig.py",
    "link fit": "computes for seconds, and then writes a few files at once by `results_in`",
    "link picture": "computes for seconds, and then writes a few files at once by `results_in`",
    "link probe": "listens to a running rig for a time, and then writes a few files at once by `results_in`",
    "study network": "reads a folder, and writes a few files at once at the end by `results_in`",
    "study validate": "runs a rig for each cell: tests/unit/launcher/test_child_session.py",
    "sample import": "reads a file of another maker, and writes one file at the end by `atomic_file`",
    "curve fit": "fits for a moment, and writes three files at once at the end by `results_in`",
    "particles": "reads an image, and writes one file at the end by `atomic_file`",
    "bag recalibrate": "copies as `bag filter` does, and needs a recording of real devices",
    "budget": "reads a recording, and writes two files at once at the end by `results_in`",
    "device accept": "takes a motion of a minute, and writes all at once at the end by `results_in`",
    "device trial": "asks a person at a real device, and writes one file at the end by `atomic_file`",
    "device calibrate handle": "asks a person at a real device, and writes one file at the end by `atomic_file`",
    "device calibrate stage": "asks a person at a real device, and writes one file at the end by `atomic_file`",
}
_COMMANDS_WITH_RESULTS = """
from telenano.cli.lazy_commands import LAZY_COMMANDS, load, load_row, package_commands

def walk(path, command):
    for name, child in getattr(command, "commands", {}).items():
        yield from walk((*path, name), child)
    if any("--out" in parameter.opts for parameter in command.params):
        yield " ".join(path)

for name in LAZY_COMMANDS:
    print(*walk((name,), load(name)), sep="\\n")
for path, row in package_commands().items():
    print(*walk(path, load_row(path[-1], row, path)), sep="\\n")
"""


@pytest.mark.check("takes 1.2 s")
def test_every_command_with_a_result_is_in_the_table() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _COMMANDS_WITH_RESULTS], capture_output=True, text=True, env=environment(), check=True
    )
    known = set(RECIPES) | set(ELSEWHERE)
    assert set(done.stdout.split("\n")) - {""} == known


@pytest.fixture
def with_recordings(
    recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], str]:
    """Put the paths of recordings into a template, which keeps the place of its output."""

    def fill(template: str) -> str:
        recording, other = recording_of("wave"), recording_of("position_force")
        parts = tmp_path_factory.mktemp("parts") / "of"
        if "{parts}" in template:
            words = ["bag", "split", str(recording), "--interval", "2", "--out", str(parts)]
            subprocess.run(
                [sys.executable, "-m", "telenano", *words], env=environment(), check=True, capture_output=True
            )
        names = " ".join(map(str, sorted(parts.glob("*.mcap"))))
        return template.format(out="{out}", recording=recording, other=other, parts=names)

    return fill


def words_of(template: str, out: Path) -> list[str]:
    return template.format(out=out).split()


def check_end(ended: Ended, number: signal.Signals, template: str, folder: Path) -> None:
    """Assert that a command which was interrupted said so, and left nothing or what says that it is a part."""
    said = (template, number, ended)
    assert "Traceback" not in ended.stderr + ended.stdout, said
    if ended.code == 0:
        return
    # at the very end a signal has nothing to interrupt, and ends the process as any other
    assert ended.code in (CODES[number], -number), said
    if ended.code == -number:
        return
    assert "interrupted" in ended.stderr, said
    left = files_below(folder)
    assert not [name for name in left if name.endswith(".part")], said
    if template.startswith("scan") and left:
        assert left == ["out/scan.gsf", "out/scan.gwy", "out/scan.nxs", "out/scan.png"], said
        image = (folder / "out" / "scan.gsf").read_bytes()
        rows = read_surface(folder / "out" / "scan.gsf").height_m.shape[0]
        wanted = int(template.split()[template.split().index("--lines") + 1])
        assert (f"Partial = {rows} of {wanted} lines".encode() in image) == (rows < wanted), said
        assert b"partial: " in (folder / "out" / "scan.png").read_bytes() or rows == wanted, said


def whole_run(template: str, folder: Path) -> float:
    """Run a command to its end and return how long it took [s]."""
    begun_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "telenano", *words_of(template, folder / "out")], cwd=folder, env=environment(),
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    # 3: the recordings are short, and lack a little
    assert done.returncode in (0, 3), (template, done.stdout, done.stderr)
    return time.monotonic() - begun_s


def try_signals(template: str, tmp_path: Path, seed: str, signals: Sequence[signal.Signals], longest_s: float) -> None:
    """Interrupt a command at random times, each time with the folder as the last one left it, and run it to its end."""
    draw = random.Random(seed)
    again = tmp_path / "again"
    again.mkdir()
    found: list[list[str]] = []
    for number in signals:
        ended = interrupted(
            words_of(template, again / "out"), again, number, draw.uniform(0.0, longest_s), group=draw.random() < 0.5
        )
        check_end(ended, number, template, again)
        if files_below(again) and not template.startswith("scan"):
            # whole, as the name says, and some commands overwrite nothing
            found.append(files_below(again))
            shutil.rmtree(again)
            again.mkdir()
    whole_run(template, again)
    assert found.count(files_below(again)) == len(found), found
    assert not [name for name in files_below(again) if ".part" in name]


IN_MAKE_TEST = [name for name, recipe in RECIPES.items() if recipe.in_make_test]


@pytest.mark.check("takes 22.1 s")
@pytest.mark.drawn(0.2)
@pytest.mark.parametrize("name", IN_MAKE_TEST)
def test_a_command_interrupted_at_a_random_time_leaves_nothing_half_and_runs_again(
    name: str, with_recordings: Callable[[str], str], tmp_path: Path
) -> None:
    # one after the other gets either; the endurance run sends both to each
    signals = [(signal.SIGINT, signal.SIGTERM)[IN_MAKE_TEST.index(name) % 2]]
    try_signals(with_recordings(RECIPES[name].arguments), tmp_path, name, signals, 3.0)


@pytest.mark.endurance
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("template", [*(recipe.arguments for recipe in RECIPES.values()), *VARIANTS])
def test_each_command_interrupted_at_many_random_times_runs_again(
    template: str, with_recordings: Callable[[str], str], tmp_path: Path
) -> None:
    template = with_recordings(template)
    first = tmp_path / "first"
    first.mkdir()
    seconds = whole_run(template, first)
    try_signals(template, tmp_path, template, (signal.SIGINT, signal.SIGTERM) * 5, 1.1 * seconds)
    assert files_below(first) == files_below(tmp_path / "again")


@pytest.mark.check("takes 6.8 s")
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.endurance)])
def test_an_image_that_is_ended_keeps_its_lines_and_says_so(number: signal.Signals, tmp_path: Path) -> None:
    # so long that it never ends by itself; the first lines come a second or two after the imports
    words = ["scan", "--mode", "contact", "--sample", "flat", "--size", "1000", "--pixels", "64", "--lines", "4000",
             "--json", "--out", "out"]  # fmt: skip
    for delay_s in (4.0, 12.0, 36.0):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        ended = interrupted(words, tmp_path, number, delay_s)
        assert ended.code == CODES[number], ended
        # an image of one line is no map that could be read again
        if files_below(tmp_path) and (document := json.loads(ended.stdout))["lines"] > 1:
            break
    assert document["partial"] == f"{document['lines']} of 4000 lines"
    assert f"interrupted: {document['partial']} are kept" in ended.stderr
    assert files_below(tmp_path) == ["out/scan.gsf", "out/scan.gwy", "out/scan.nxs", "out/scan.png"]
    kept = read_surface(tmp_path / "out" / "scan.gwy", "Height (partial")
    assert kept.height_m.shape == (document["lines"], 64)
    assert kept.depth_m == pytest.approx(kept.width_m * document["lines"] / 4000, rel=1e-6)


_SLOW = pytest.mark.endurance
# a signal after the last line or point, while the first file is written
_WHILE_WRITING = """
import os, signal, sys
import telenano_lab.microscopy.force_curve as curves, telenano_lab.microscopy.simulated_image as images
from telenano_lab.microscopy import image_files
import numpy as np

def with_signals(write):
    def signalled(*given):
        for _ in range({signals}):
            os.kill(os.getpid(), signal.{name})
        return write(*given)
    return signalled

def taken(config, keys, progress):
    heights = np.zeros((keys["scan.lines"], keys["scan.pixels"]))
    progress(len(heights), len(heights))
    lines = images.LiveImage(*[heights] * 7, width_m=1e-7, depth_m=1e-7)
    return images.SimulatedImage(lines, heights)

images.take_image = taken
image_files.write_gsf = with_signals(image_files.write_gsf)
curves.write_hdf5 = with_signals(curves.write_hdf5)
from telenano.cli.app import main
main()
"""


def written_under_a_signal(command: str, name: str, folder: Path, signals: int) -> Ended:
    program = _WHILE_WRITING.format(name=name, signals=signals)
    done = subprocess.run(
        [sys.executable, "-c", program, *command.split(), "--out", "out"], cwd=folder, env=environment(),
        capture_output=True, text=True, check=False, preexec_fn=as_at_a_terminal,
    )  # fmt: skip
    return Ended(done.returncode, done.stdout, done.stderr)


@pytest.mark.check("runs a command in a process of its own")
@pytest.mark.parametrize(
    ("command", "name", "files", "words"),
    [
        ("scan --pixels 4 --lines 4", "SIGTERM", "scan.gsf scan.gwy scan.nxs scan.png", "all lines are kept"),
        pytest.param(
            "curve --points 20", "SIGINT", "curve.h5 curve.png", "out is complete", marks=[pytest.mark.endurance]
        ),
    ],
)
def test_a_signal_while_the_files_are_written_loses_nothing(
    command: str, name: str, files: str, words: str, tmp_path: Path
) -> None:
    ended = written_under_a_signal(command, name, tmp_path, 1)
    assert files_below(tmp_path) == [f"out/{file}" for file in files.split()], ended
    assert ended.code == CODES[signal.Signals[name]]
    assert words in ended.stderr


@pytest.mark.endurance
def test_a_second_signal_while_the_files_are_written_gives_up_and_says_what_is_lost(tmp_path: Path) -> None:
    ended = written_under_a_signal("scan --pixels 4 --lines 4", "SIGINT", tmp_path, 2)
    assert (ended.code, files_below(tmp_path)) == (EXIT_INTERRUPTED, [])
    assert ended.stderr.endswith("telenano: interrupted; out was not written\n")


@pytest.mark.check("takes 6 s")
@pytest.mark.drawn(0.0, "telenano/cli/", "telenano/files/", "telenano/signals/")
def test_what_a_killed_process_left_does_not_stand_in_the_way_and_goes(
    with_recordings: Callable[[str], str], tmp_path: Path
) -> None:
    recipe = with_recordings(RECIPES["bag export"].arguments)
    whole, folder = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    folder.mkdir()
    seconds = whole_run(recipe, whole)
    for share in (0.9, 0.6):
        ended = interrupted(words_of(recipe, folder / "out"), folder, signal.SIGKILL, share * seconds)
        assert ended.code in (0, -signal.SIGKILL), ended
        # the name is there only with the whole result, which a process may have written before it was killed
        if files_below(folder) == ["out"]:
            assert (folder / "out").stat().st_size == (whole / "out").stat().st_size
            (folder / "out").unlink()
    whole_run(recipe, folder)
    assert files_below(folder) == ["out"]
    assert (folder / "out").stat().st_size == (whole / "out").stat().st_size
