"""Commands in a folder whose files have the names of the project's own modules, and of libraries."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from stack_rig import Rig

NAMES = ("recording", "numpy", "proto", "presets", "services", "analysis", "studies", "socket", "pickle", "yaml", "zmq")
PLAN = {
    "name": "short",
    "scenario": "fig12",
    "seed": 3,
    "participants": 1,
    "tasks": [{"name": "touch_and_hold", "parameters": {"hold_s": 0.3, "limit_s": 3.0, "force_n": 20e-9}}],
    "factors": {"law": ["wave", "passivity"]},
    "order": "latin_square",
    "disturbed": {"stall_s": 0.5, "most_attempts": 9},
    "stop": {"disturbed_in_a_row": 9},
}
TELENANO = Path(sys.executable).parent / "telenano"


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    folder = tmp_path / "notes"
    folder.mkdir()
    for name in NAMES:
        (folder / f"{name}.py").write_text("raise SystemExit('a file of the folder was run')\n")
    for name in ("services", "proto", "analysis"):
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("raise SystemExit('a file of the folder was run')\n")
    return folder


def said(folder: Path, environment: dict[str, str], *words: str) -> str:
    done = subprocess.run(
        [str(TELENANO), *words], cwd=folder, env=environment, capture_output=True, text=True, timeout=150, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a file of the folder was run" not in done.stdout + done.stderr
    return done.stdout


@pytest.mark.drawn(0.0, "telenano/launcher/", "telenano/signals/")
def test_a_rig_runs_among_files_of_any_name(rig: Rig, foreign: Path) -> None:
    words = ("up", "--scenario", "fig12", "--out", "out", "--set", "duration_s=3", "--json", "--headless")
    summary = json.loads(said(foreign, rig.environment, *words))
    assert summary["verdict"]
    assert "usage" in said(foreign, rig.environment, "node", "recorder", "--help").lower()


@pytest.mark.endurance
def test_scans_studies_and_experiments_run_among_files_of_any_name(rig: Rig, foreign: Path) -> None:
    said(foreign, rig.environment, "scan", "--out", "scan", "--pixels", "16", "--lines", "8")
    stability = ("study", "stability", "--environment", "spring", "--law", "wave", "--delay", "0,10")
    said(foreign, rig.environment, *stability, "--workers", "2", "--out", "study")
    (foreign / "plan.yaml").write_text(yaml.safe_dump(PLAN, sort_keys=False))
    # at a rate at which the rig leaves something of the machine to what judges its trials
    slower = {**rig.environment, "TELENANO__REALTIME__RATE_HZ": "250"}
    said(foreign, slower, "experiment", "run", "plan.yaml", "--out", "experiment")
