"""`telenano experiment analyse` as a user calls it, on the folder of an experiment."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from experiment_tables import demo
from typer.testing import CliRunner

from presets import find_experiment
from telenano.cli.root import app

pytest.importorskip("statsmodels")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of an experiment that was run."""
    shutil.copy(find_experiment("delay_and_law"), tmp_path / "experiment.yaml")
    begun = {"record": "begun", "utc": "2026-11-22T09:00:00.000+00:00", "digest": "0123456789abcdef"}
    lines = [json.dumps(record) for record in (begun, *demo(2))]
    # a record that was being written when its writer was killed
    (tmp_path / "journal.jsonl").write_text("\n".join([*lines, '{"record": "tri']))
    return tmp_path


def run(*words: str) -> Any:
    return CliRunner().invoke(app, ["experiment", "analyse", *words])


def test_it_prints_the_effect_and_leaves_a_page_beside_the_journal(folder: Path) -> None:
    done = run(str(folder), "--measure", "time_s", "--test", "anova")
    assert done.exit_code == 0, done.output
    assert "delay_ms" in done.stdout and "4 participants completed 72 trials" in done.stdout
    assert f"page: {folder}/analysis/experiment.html" in done.stdout.replace("\n", "")
    page = (folder / "analysis" / "experiment.html").read_text()
    assert "0123456789abcdef" in page and "latin square" in page.lower() and "trials.parquet" in page
    assert (folder / "analysis" / "touch_and_hold_time_s.png").stat().st_size > 5000


def test_json_has_the_slope_that_the_experiment_was_made_with(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "elsewhere"
    done = run(str(folder), "--measure", "time_s", "--out", str(out), "--json")
    assert done.exit_code == 0, done.output
    (slope,) = json.loads(done.stdout)["slopes"]
    assert slope["factor"] == "delay_ms" and slope["low"] < 0.02 < slope["high"]
    assert json.loads((out / "experiment.json").read_text())["slopes"] == [slope]
    assert not (folder / "analysis").exists()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--test", "t"), "--test t: must be mixed or anova"),
        (("--measure", "tine_s"), "measure tine_s: known are"),
        (("--correction", "holms"), "correction holms: known are"),
        (("--format", "gif"), "--format gif"),
    ],
)
def test_what_is_wrong_is_named_and_nothing_is_written(folder: Path, words: tuple[str, ...], text: str) -> None:
    done = run(str(folder), *words)
    assert done.exit_code == 2 and text in done.output
    assert not (folder / "analysis").exists()


def test_a_folder_without_a_journal_is_named(tmp_path: Path) -> None:
    done = run(str(tmp_path))
    assert done.exit_code == 2 and "has no journal.jsonl: name the folder of an experiment that was run" in done.output
