"""The programs of examples/ that have a rig, run as their heads say."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from documented_lines import differing
from live_examples import BESIDE_A_RIG, WITH_A_RIG, assert_printed
from PIL import Image
from stack_rig import ROOT, Rig, judged

EXAMPLES = ROOT / "examples"


def coloured(picture: Path) -> float:
    """Return the share of the pixels with a colour, which in these pictures only lines of a plot have."""
    shades = np.asarray(Image.open(picture).convert("RGB"), dtype=int)
    return float(np.mean(np.ptp(shades, axis=2) > 60))


def run(name: str, folder: Path, rig: Rig) -> str:
    """Run a program as a reader does, and return what it prints."""
    command = [sys.executable, f"examples/{name}.py", str(folder)]
    environment = {**rig.environment, "MPLBACKEND": "agg"}
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.endurance
def test_programs_beside_a_rig_print_its_forces_and_draw_them(rig: Rig, tmp_path: Path) -> None:
    rig.start(scenario="examples/pressing.yaml")
    rig.wait_until(rig.running, "the session")
    rig.wait_until(lambda: rig.session_s() > 0.0, "the programme of the hand")
    printed = {name: run(name, tmp_path, rig) for name in BESIDE_A_RIG}
    code, summary, err = rig.stop()
    assert code in (0, 3), err
    for name, text in printed.items():
        assert all(int(count) > 0 for count in re.findall(r"messages (\d+)", text)), text
        assert coloured(tmp_path / f"{name}.png") > 0.0
    # Where the machine held the rig up, the tip may have been away.
    if judged(summary, "the examples beside a rig"):
        for name, text in printed.items():
            assert_printed(text, BESIDE_A_RIG[name])
            # It began at another moment of the hand's four seconds, so its lines stand elsewhere and are about as long.
            made, shipped = coloured(tmp_path / f"{name}.png"), coloured(EXAMPLES / f"{name}.png")
            assert 0.5 * shipped < made < 2.0 * shipped, name


def test_programs_beside_no_rig_say_so(rig: Rig, tmp_path: Path) -> None:
    for name in BESIDE_A_RIG:
        command = [sys.executable, f"examples/{name}.py", str(tmp_path)]
        done = subprocess.run(command, env=rig.environment, cwd=ROOT, capture_output=True, text=True, timeout=60)
        assert done.returncode != 0
        assert "no rig of this" in done.stderr


@pytest.mark.drawn(0.0, "examples/", "telenano/extend/")
@pytest.mark.parametrize("name", WITH_A_RIG)
def test_a_program_with_a_rig_of_its_own_prints_its_forces_and_draws_them(name: str, rig: Rig, tmp_path: Path) -> None:
    printed = run(name, tmp_path, rig)
    assert (tmp_path / f"{name}.png").exists()
    summary = json.loads((tmp_path / name / "summary.json").read_text(encoding="utf-8"))
    if judged(summary, f"the example {name}"):
        assert_printed(printed, WITH_A_RIG[name])
        assert differing(tmp_path / f"{name}.png", EXAMPLES / f"{name}.png") < 0.02
