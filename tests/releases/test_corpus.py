"""What each release wrote opens, is sound, is judged as it was, and is run again by this version.

`make_corpus.py` makes the folder of a version (docs/release.md). Where a later version means to say something else, the
nodes of the older recordings stand in CHANGED with the reason.
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from make_corpus import DEMO, MAP, RELEASES, ROOT
from typer.testing import CliRunner

import telenano
from analysis.rerun import rerun
from proto.nodes import site_of
from recording.reader import Recording
from recording.verify import verify
from services.runtime.bus.address_book import load_site
from telenano.cli.root import app

FOLDERS = sorted(RELEASES.glob("[0-9]*"))
NODES = (
    "controller@master",
    "haptic_node@master",
    pytest.param("controller@slave", marks=pytest.mark.check("runs every step of a node again")),
    pytest.param("afm_node@slave", marks=pytest.mark.check("runs every step of a node again")),
)
# version and node -> why this version computes something else than the one that made the recording
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
DAMAGED = {"cut.mcap": "the file ends within a chunk", "flipped.mcap": "checksum"}

of_each = pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)


def said(*words: str | Path, code: int = 0) -> str:
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Iterator[Path]:
    """Give a copy of a folder that commands may write to."""
    yield shutil.copytree(folder, tmp_path / folder.name)


def test_this_version_has_its_corpus() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert version in [folder.name for folder in FOLDERS]
    for folder in FOLDERS:
        assert sum(path.stat().st_size for path in folder.rglob("*")) < 3_000_000


@pytest.mark.parametrize("path", [DEMO, *(folder / "sound.mcap" for folder in FOLDERS)], ids=lambda p: p.parent.name)
def test_a_recording_opens_and_is_sound(path: Path) -> None:
    assert verify([path]).sound
    session = telenano.open(path)
    for channel, columns in COLUMNS.items():
        table = session.table(channel, "*")
        assert [name for name in columns if name not in table] == [], channel
        assert len(table["time_s"]) > 0
    assert np.isfinite(session.table("afm/state")["tip_force_n.2"]).all()
    assert session.summary["recording"]["complete"]
    assert session.summary["scenario"] == "fig12"
    assert json.loads(said("bag", "info", path, "--json"))["messages"] > 1000


def test_the_demo_is_stable_and_has_the_figures_of_the_paper() -> None:
    summary = telenano.open(DEMO).summary
    assert summary["verdict"] == "stable"
    assert summary["hold_ratio"] == pytest.approx(1.05, abs=0.005)


@of_each
@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_recording_is_read_as_far_as_it_goes_and_named(folder: Path, name: str) -> None:
    found = verify([folder / name])
    assert not found.sound
    assert DAMAGED[name] in json.dumps(json.loads(said("bag", "info", folder / name, "--json"))["damage"])
    assert len(telenano.open(folder / name).table("afm/state")["time_s"]) > 10


@of_each
@pytest.mark.parametrize("node", NODES)
def test_each_node_of_a_release_is_run_again(folder: Path, node: str) -> None:
    found = rerun(Recording(folder / "sound.mcap"), node)
    assert sum(found.compared.values()) > 0
    if (folder.name, node) not in CHANGED:
        assert found.identical, found.verdict()


@of_each
def test_a_recording_is_reported_and_found_by_a_player(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said("report", copy / "sound.mcap", "--out", copy / "report")
    assert json.loads((copy / "report" / "summary.json").read_text())["law"] == ["wave"]
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path))
    # nobody runs here who could listen
    assert "were played, and nobody read them" in said(
        "replay", copy / "sound.mcap", "--nodes", "afm_node", "--wait", "0.1", code=1
    )


@of_each
def test_scenario_and_site_are_valid(copy: Path) -> None:
    said("scenario", "check", copy / "scenario.yaml")
    assert {site_of(key) for key in load_site(copy / "site.yaml").nodes} == {"master", "slave"}


@of_each
@pytest.mark.check("draws every figure")
def test_an_experiment_is_analysed_again(copy: Path) -> None:
    before = (copy / "experiment" / "journal.jsonl").read_bytes()
    said("experiment", "analyse", copy / "experiment")
    assert (copy / "experiment" / "analysis" / "trials.csv").stat().st_size > 0
    assert (copy / "experiment" / "journal.jsonl").read_bytes() == before


@of_each
@pytest.mark.check("compiles a law")
def test_a_map_is_continued_or_refused_in_a_sentence(copy: Path) -> None:
    journal, result = copy / "map" / "journal.jsonl", copy / "map" / "stability.json"
    rows, before = journal.read_text().splitlines(), verdicts(result)
    done = CliRunner().invoke(app, ["study", "stability", *MAP, "--out", str(copy / "map")])
    if done.exit_code:
        assert "journal.jsonl" in done.output
        assert "Traceback" not in done.output
    else:
        # a model of other sources is computed anew beside the old rows
        assert journal.read_text().splitlines()[: len(rows)] == rows
        assert verdicts(result) == before


def verdicts(path: Path) -> list[dict[str, str]]:
    found = [line["verdicts"] for line in json.loads(path.read_text())["lines"]]
    assert [len(each) for each in found] == [2, 2]
    return found


@of_each
@pytest.mark.check("starts a process with a package")
def test_a_law_of_a_package_is_still_a_law(folder: Path, tmp_path: Path) -> None:
    (package,) = folder.glob("telenano-law-of-a-release")
    entries = tomllib.loads((package / "pyproject.toml").read_text())["project"]["entry-points"]
    known = tmp_path / "telenano_law_of_a_release-0.1.0.dist-info"
    known.mkdir()
    (known / "METADATA").write_text("Metadata-Version: 2.1\nName: telenano-law-of-a-release\nVersion: 0.1.0\n")
    lines = (f"[{group}]\n" + "".join(f"{a} = {b}\n" for a, b in names.items()) for group, names in entries.items())
    (known / "entry_points.txt").write_text("\n".join(lines))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (tmp_path, package, ROOT)))}
    command = [sys.executable, "-P", "-m", "telenano", "law", "check", "law_of_a_release"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
