"""The worked example of recorded-maps.md (telenano-lab): it runs as printed, and a bilateral session feels it."""

import json
import os
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.afm_files.force_map import write_map
from telenano_lab.afm_files.map_files import MapOptions, import_map
from typer.testing import CliRunner

from telenano.cli.root import app
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.virtual import record_session

PAGE = Path(__file__).resolve().parents[2] / "packages" / "telenano-lab" / "docs" / "recorded-maps.md"
# measured files are not part of the project; those of afmformats' own tests are public
MEASURED = Path(os.environ.get("TELENANO_MEASURED", Path(__file__).resolve().parents[3] / "shared" / "data"))
EXAMPLE = r"# Recorded maps.*?```python\n(.*?)```\s+```sh\n(.*?)```.*?```text\n(.*?)```"


@pytest.fixture
def example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run the example of the document but for the rig; return its arrays, its last command, and what was printed."""
    found = re.search(EXAMPLE, PAGE.read_text("utf-8"), re.DOTALL)
    assert found is not None
    monkeypatch.chdir(tmp_path)
    made: dict[str, Any] = {}
    exec(found[1], made)
    *commands, up = found[2].splitlines()
    for line in commands:
        result = CliRunner().invoke(app, shlex.split(line)[1:])
        assert result.exit_code == 0, result.output
    stated = dict(line.split() for line in found[3].splitlines())
    for name, value in stated.items():
        shown = re.search(rf"{name}[^-\w]+([-0-9.e]+)", result.output)
        assert shown is not None and float(shown[1]) == pytest.approx(float(value), rel=1e-4, abs=0), name
    return made, shlex.split(up)


@pytest.mark.check("takes 2.3 s")
def test_a_bilateral_session_feels_the_curves_of_the_file(example: Any, tmp_path: Path) -> None:
    made, up = example
    assert up[:3] == ["telenano", "up", "fig12"]
    path = record_session(tmp_path, 1, [up[4]], 2.0)
    recording = Recording(path)
    read: dict[str, list[Any]] = {
        topic: [found.decode() for found in recording.messages((topic,))]
        for topic in ("session/event", "afm/state", "haptic/command")
    }
    said = " ".join(event.text for event in read["session/event"])
    assert re.search(r"map\.npz \([0-9a-f]{16}\): force \[N\], 9 x 9 x 451 points", said)
    states = read["afm/state"]
    # the hand of Fig. 12 stays in the middle of the map
    z = 10e-9 + np.array([state.base_position_m[2] for state in states])
    felt = np.array([state.tip_force_n[2] for state in states])
    down, up_ = (np.interp(z, made["z"], made["value"][4, 4, :, branch]) for branch in (0, 1))
    # a cubic through even points differs from straight lines between them where the file bends: in its jumps alone
    jumps = np.min([np.abs(z - edge) for edge in (0.5e-9, 4e-9, 6e-9)], axis=0) < 0.3e-9
    error = np.minimum(np.abs(felt - down), np.abs(felt - up_))
    assert error[~jumps].max() < 1e-14
    assert felt.max() > 1e-9
    assert np.count_nonzero(~jumps) > 1000
    # the master feels what the slave felt
    assert max(abs(command.force_n[2]) for command in read["haptic/command"]) > 0.1
    # the journal has the state of the branch
    assert rerun(recording, "afm_node@slave").identical


def test_the_document_says_what_json_says(example: Any) -> None:
    result = CliRunner().invoke(app, ["sample", "info", "map.npz", "--json"])
    found = json.loads(result.stdout)
    assert found["branches"] == ["approach", "retract"]
    assert found["points"] == [9, 9, 451]
    assert sys.float_info.max > found["loop_closed_m"][1] > found["contact_m"][1]


@pytest.mark.check("takes 1.8 s")
def test_a_session_feels_a_frequency_shift_until_it_leaves_the_branch(tmp_path: Path) -> None:
    z = np.linspace(0.0, 12e-9, 601)
    # the minimum of -30 Hz is 2 nm above the bottom
    shift = -30.0 * (z / 2e-9) * np.exp(1.0 - z / 2e-9)
    place = {"x": np.zeros(1), "y": np.zeros(1), "z": z, "length_unit": "m"}
    np.savez(tmp_path / "shift.npz", value=shift[None, None], unit="Hz", **place)
    feel = {
        "channel": "frequency_shift", "unit": "Hz", "table": [[-2.0, 0.0], [-28.0, 3e-9]], "tolerance": 0.1,
        "slope_limit_n_per_unit": 1e-9,
    }  # fmt: skip
    settings = [f"afm_node.sample.map={tmp_path / 'shift.npz'}", f"afm_node.feel={json.dumps(feel)}"]
    recording = Recording(record_session(tmp_path, 1, settings, 1.6))
    states = [found.decode() for found in recording.messages(("afm/state",))]
    height = 10e-9 + np.array([state.base_position_m[2] for state in states])
    assert np.abs([state.felt_value for state in states] - np.interp(height, z, shift)).max() < 0.01
    on_branch = [state for state in states if state.felt_clamp == "" and state.mode == "follow"]
    assert len(on_branch) > 100
    for state in on_branch:
        assert state.felt_channel == "frequency_shift"
        assert state.tip_force_n[2] == pytest.approx((-state.felt_value - 2.0) / 26.0 * 3e-9, rel=1e-6, abs=1e-15)
    texts = " ".join(found.decode().text for found in recording.messages(("session/event",)))
    assert "has left the branch of feel.table: the tip retracts" in texts
    assert states[-1].mode in ("retracting", "retracted")
    assert rerun(recording, "afm_node@slave").identical


def own_curves(path: Path) -> list[list[tuple[Any, Any]]]:
    """Return of each curve of a file, approach and retract: height over the common lowest point [m], force [N]."""
    afmformats = pytest.importorskip("afmformats")
    found, lows = [], []
    for curve in afmformats.load_data(path):
        segment = np.asarray(curve["segment"]).astype(int)
        height, force = (np.asarray(curve[name]) for name in ("height (measured)", "force"))
        ways = [np.flatnonzero(segment == number) for number in (segment[0], segment[-1])]
        zero = min(height[way].min() for way in ways)
        lows.append(max(height[way].min() for way in ways) - zero)
        ways = [way[np.argsort(height[way], kind="stable")] for way in ways]
        far = force[ways[0]][-(len(ways[0]) // 10) :].mean()
        found.append([(height[way] - zero, force[way] - far) for way in ways])
    return [[(height - max(lows), force) for height, force in ways] for ways in found]


@pytest.mark.endurance
def test_a_bilateral_session_feels_the_curves_of_a_public_file(tmp_path: Path) -> None:
    path = MEASURED / "fmt-jpk-fd_map2x2_extracted.jpk-force-map"
    if not path.exists():
        pytest.skip(f"{path.name} is not in {MEASURED} (TELENANO_MEASURED)")
    curves = own_curves(path)
    write_map(tmp_path / "map.npz", import_map(path, MapOptions({}, points=2000)).map)
    rest_m = 100e-9
    settings = [f"afm_node.sample.map={tmp_path / 'map.npz'}", f"afm_node.rest_distance_m={rest_m}"]
    recording = Recording(record_session(tmp_path, 1, settings, 3.0))
    states = [found.decode() for found in recording.messages(("afm/state",))]
    z = rest_m + np.array([state.base_position_m[2] for state in states])
    felt = np.array([state.tip_force_n[2] for state in states])
    # the hand stays in the middle of four places, which is the mean of their curves
    down, up = (np.mean([np.interp(z, *ways[branch]) for ways in curves], axis=0) for branch in (0, 1))
    turn = int(np.argmin(z))
    error = np.abs(felt - down)[:turn][felt[:turn] > 50e-12]
    assert len(error) > 200 and felt.max() > 1e-9
    # a single curve has 5 pN of noise from point to point
    assert np.sqrt(np.mean(error**2)) < 5e-12
    assert error.max() < 3e-11
    # on the way back the tip passes over from one branch of the file to the other
    back = felt[turn:]
    assert (back < np.maximum(down, up)[turn:] + 3e-11).all()
    assert (back > np.minimum(down, up)[turn:] - 3e-11).all()
    commands = [found.decode() for found in recording.messages(("haptic/command",))]
    assert max(abs(command.force_n[2]) for command in commands) > 0.05
    assert rerun(recording, "afm_node@slave").identical
