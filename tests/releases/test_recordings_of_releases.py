"""A recording of each release opens, is sound, and is run again by this one.

`make dist` leaves `telenano-VERSION.mcap` in out/dist; whoever makes a release puts it here (docs/release.md). Where a
later release means to say something else, the nodes of the older recordings stand in CHANGED with the reason.
"""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import telenano
from analysis.rerun import rerun
from recording.reader import Recording
from recording.verify import verify
from telenano.cli.root import app

FOLDER = Path(__file__).parent
RECORDINGS = sorted(FOLDER.glob("telenano-*.mcap"))
NODES = (
    "controller@master",
    "haptic_node@master",
    pytest.param("controller@slave", marks=pytest.mark.endurance),
    pytest.param("afm_node@slave", marks=pytest.mark.endurance),
)
# recording and node -> why this release computes something else than the one that made it
CHANGED: dict[tuple[str, str], str] = {}
# in each, whatever is added to a message later
COLUMNS = {
    "afm/state": (
        "time_s",
        "src",
        "t_ns",
        "base_position_m.2",
        "deflection_m",
        "tip_force_n.2",
        "separation_m",
        "mode",
    ),
    "haptic/state": ("time_s", "position_m.2", "operator_force_n.2", "session_s", "mode"),
    "haptic/command": ("time_s", "t_ns"),
    "session/event": ("time_s", "text"),
}


def test_this_version_has_its_recording() -> None:
    version = tomllib.loads((FOLDER.parents[1] / "pyproject.toml").read_text())["project"]["version"]
    assert f"telenano-{version}.mcap" in [path.name for path in RECORDINGS]
    assert all(path.stat().st_size < 2_000_000 for path in RECORDINGS)


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_a_recording_of_a_release_opens_and_is_sound(path: Path) -> None:
    assert verify([path]).sound
    session = telenano.open(path)
    for channel, columns in COLUMNS.items():
        table = session.table(channel, "*")
        assert [name for name in columns if name not in table] == [], channel
        assert len(table["time_s"]) > 0
    tip = session.table("afm/state")
    assert np.isfinite(tip["tip_force_n.2"]).all()
    assert session.summary["recording"]["complete"]
    assert session.summary["scenario"] == "fig12"
    told = CliRunner().invoke(app, ["bag", "info", str(path), "--json"])
    assert told.exit_code == 0
    assert json.loads(told.stdout)["messages"] > 1000


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_each_node_of_a_release_is_run_again(path: Path, node: str) -> None:
    found = rerun(Recording(path), node)
    assert sum(found.compared.values()) > 0
    if (path.stem, node) not in CHANGED:
        assert found.identical, found.verdict()
