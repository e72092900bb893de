"""What laws make of a drift in z: a row for each law and drift, the same whoever runs it, and a felt stiffness."""

import json
from pathlib import Path

import pytest
from telenano_lab.experiments.drift_study import DriftRun, rows_of, runs_of

from telenano.testing import invoke


def test_each_law_has_a_row_without_drift_two_that_stand_and_one_for_each_time() -> None:
    runs = runs_of(["wave", "passivity"], "clean", [10.0, 50.0], [5.0, 60.0], 3)
    assert len(runs) == 2 * (1 + 2 * (2 + 2 * 3))
    assert len({run.key for run in runs}) == len(runs)
    still = runs[0]
    assert still.cell.disturbances == ()
    assert dict(runs[1].cell.disturbances)["drift.speed_m_per_s"] == pytest.approx(1e-11, rel=1e-12, abs=0)
    assert isinstance(still, DriftRun)


@pytest.mark.check("runs a law under drifts in lockstep")
def test_the_command_prints_what_a_law_feels_under_each_drift(tmp_path: Path) -> None:
    words = ["study", "drift", "--law", "wave", "--speed", "200", "--time-constant", "5", "--seeds", "2"]
    result = invoke([*words, "--workers", "1", "--out", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.stderr
    rows = {row["drift"]: row for row in json.loads(result.stdout)["rows"]}
    assert list(rows) == ["none", "to the sample", "from it", "wanders"]
    assert [row["runs"] for row in rows.values()] == [1, 1, 1, 2]
    assert rows["none"]["stable"] == 1
    assert 0.2 < rows["none"]["felt"] < 1.2
    # 200 pm/s are 3.6 nm over the run, which a hand feels
    assert rows["to the sample"]["parted_mm"] != rows["none"]["parted_mm"]
    assert rows["wanders"]["felt_least"] != rows["wanders"]["felt_most"]
    refused = invoke([*words[:-4], "--speed", "-1", "--out", str(tmp_path / "no")])
    assert refused.exit_code != 0
    assert "--speed" in refused.stderr


def test_no_run_is_a_group_of_its_own() -> None:
    assert rows_of([]) == []
