"""An image and a curve by a running rig that are ended by a signal: the tip withdraws, and what there is is kept."""

import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from stack_rig import Rig

from telenano.sections.surface_files import read_surface

pytestmark = pytest.mark.stack
SCAN = ("scan", "--live", "--json", "--pixels", "16", "--size", "60", "--lines")


def begin(rig: Rig, *arguments: str) -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    return subprocess.Popen(
        rig.command(*arguments), env=rig.environment, stdout=pipe, stderr=pipe, text=True,
        # what a shell has in the background ignores SIGINT, and its children with it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip


def is_away(rig: Rig) -> bool:
    state = rig.newest("afm/state")
    return str(getattr(state, "mode", "")) == "retracted"


def states_of_programs(rig: Rig) -> list[str]:
    return [str(getattr(message.decode(), "state", "")) for message in rig.recording().messages("afm/program")]


@pytest.mark.endurance
def test_a_live_image_that_is_ended_keeps_its_lines_and_the_instrument_does_not_scan_on(
    rig: Rig, tmp_path: Path
) -> None:
    rig.start(scenario="image")
    rig.wait_until(rig.running, "the session")
    out = tmp_path / "scan"
    before = len(rig.recording().messages("afm/scanline"))
    # The signal comes long before the last line.
    scan = begin(rig, *SCAN, "120", "--size", "120", "--out", str(out))
    rig.wait_until(lambda: len(rig.recording().messages("afm/scanline")) > before + 5, "the first lines")
    os.kill(scan.pid, signal.SIGTERM)
    stdout, stderr = scan.communicate(timeout=60.0)
    assert scan.returncode == 143, stderr
    document = json.loads(stdout)
    assert document["state"] == "ended"
    assert document["lines"] >= 2
    assert document["partial"] == f"{document['lines']} of 120 lines"
    assert f"interrupted: {document['partial']} are kept" in stderr
    assert sorted(path.name for path in out.iterdir()) == ["scan.gsf", "scan.gwy", "scan.nxs", "scan.png"]
    assert read_surface(out / "scan.gsf").height_m.shape == (document["lines"], 16)
    rig.wait_until(lambda: states_of_programs(rig)[-1] == "ended", "the end of the program in the recording")
    rig.wait_until(lambda: is_away(rig), "a retracted tip")
    rig.stop()


@pytest.mark.endurance
def test_after_an_image_that_was_ended_the_next_is_not_refused_and_a_curve_is_ended_likewise(
    rig: Rig, tmp_path: Path
) -> None:
    rig.start(scenario="image")
    rig.wait_until(rig.running, "the session")
    before = len(rig.recording().messages("afm/scanline"))
    scan = begin(rig, *SCAN, "60", "--out", str(tmp_path / "scan"))
    rig.wait_until(lambda: len(rig.recording().messages("afm/scanline")) > before + 5, "the first lines")
    os.kill(scan.pid, signal.SIGTERM)
    scan.communicate(timeout=60.0)
    done = rig.telenano(*SCAN, "2", "--out", str(tmp_path / "whole"), patience_s=90.0)
    assert done.returncode == 0, done.stderr
    assert "partial" not in json.loads(done.stdout)
    before = len(states_of_programs(rig))
    curve = begin(rig, "curve", "--live", "--json", "--speed", "1", "--out", str(tmp_path / "curve"))
    rig.wait_until(lambda: "running" in states_of_programs(rig)[before:], "the curve")
    os.kill(curve.pid, signal.SIGINT)
    stdout, stderr = curve.communicate(timeout=60.0)
    assert (curve.returncode, list(json.loads(stdout))) == (130, ["error"]), stderr
    assert not (tmp_path / "curve").exists()
    rig.wait_until(lambda: states_of_programs(rig)[-1] == "ended", "the end of the program in the recording")
    rig.wait_until(lambda: is_away(rig), "a retracted tip")
    rig.stop()
