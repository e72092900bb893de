"""Sessions that differ by their seeds alone, and the tables of results."""

import csv
import io
from typing import Any

import numpy as np
from telenano_studies.repetitions import repetitions, statistics_of
from telenano_studies.table_files import table_files


def scenario(delay_s: float, seed: int) -> dict[str, Any]:
    link = {"seed": seed, "forward": {"delay_s": delay_s}}
    return {"name": f"s{seed}", "delay_node": link, "recorder": {"directory": f"out/seed={seed}"}}


def test_sessions_are_repetitions_where_only_names_and_seeds_differ() -> None:
    scenarios = [scenario(0.01, 0), scenario(0.02, 0), scenario(0.01, 1), scenario(0.02, 7)]
    assert repetitions(scenarios) == [[0, 2], [1, 3]]
    rows = [
        {"session": "a", "verdict": "stable", "hold ratio": 1.0, "link": "lte", "x": None},
        {"session": "b", "verdict": "diverged", "hold ratio": None, "link": "lte", "x": None},
        {"session": "c", "verdict": "stable", "hold ratio": 1.2, "link": "lte", "x": None},
        {"session": "d", "verdict": "stable", "hold ratio": 2.0, "link": "lte", "x": 1.0},
    ]
    found = statistics_of(rows, scenarios)
    key = "delay_node.forward.delay_s"
    assert [(row[key], row["figure"], row["n"], row["mean"]) for row in found] == [
        (0.01, "share that is stable", 2, 1.0),
        (0.01, "hold ratio", 2, 1.1),
        (0.02, "share that is stable", 2, 0.5),
        (0.02, "hold ratio", 1, 2.0),
        (0.02, "x", 1, 1.0),
    ]
    assert statistics_of(rows[:2], scenarios[:2]) == []


def test_a_table_is_the_same_in_every_format(tmp_path: Any) -> None:
    import pyarrow.parquet as pq
    from scipy.io import loadmat

    rows = [{"session": "a", "hold ratio": 1.05, "loop age [ms]": None}, {"session": "b", "hold ratio": 1.1}]
    files = table_files("compare", rows, ("csv", "parquet", "mat"))
    assert list(files) == ["compare.csv", "compare.parquet", "compare.mat"]
    assert [row["hold ratio"] for row in csv.DictReader(io.StringIO(files["compare.csv"].decode()))] == ["1.05", "1.1"]
    assert pq.read_table(io.BytesIO(files["compare.parquet"])).column("hold ratio").to_pylist() == [1.05, 1.1]
    table = loadmat(io.BytesIO(files["compare.mat"]), simplify_cells=True)["table"]
    assert table["hold_ratio"].tolist() == [1.05, 1.1]
    assert list(table["session"]) == ["a", "b"]
    assert np.isnan(table["loop_age_ms"]).all()
