"""Sessions that differ by their seeds alone, and the tables of results."""

import csv
import io
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.repetitions import CONFIDENCE, held_of, repetitions, share, statistic, statistics_of
from telenano_lab.studies.table_files import table_files

from telenano.analysis import wilson


def test_the_statistic_of_numbers_is_that_of_student() -> None:
    found = statistic([1.0, 2.0, 3.0, 4.0])
    # t of three degrees of freedom at 97.5 %: 3.182446
    half = 3.182446305 * found.deviation / 2.0 if found.deviation else 0.0
    assert (found.n, found.mean) == (4, 2.5)
    assert found.deviation == pytest.approx((5.0 / 3.0) ** 0.5, rel=1e-12)
    assert (found.low, found.high) == pytest.approx((2.5 - half, 2.5 + half), rel=1e-8)
    assert statistic([7.0]) == (1, 7.0, None, None, None)


def test_the_interval_covers_the_mean_in_95_of_100_draws() -> None:
    random = np.random.default_rng(1)
    draws = random.normal(3.0, 2.0, (2000, 6))
    inside = [found.low <= 3.0 <= found.high for found in map(statistic, draws.tolist()) if found.low is not None]
    assert 0.935 <= sum(inside) / 2000 <= 0.965
    assert CONFIDENCE == 0.95


def test_a_share_has_an_interval_within_0_and_1() -> None:
    # Wilson, of 8 of 10: 0.4901625, 0.9433178
    assert share(8, 10)[1::2] == (0.8, pytest.approx(0.4901625, rel=1e-6))
    assert share(8, 10).high == pytest.approx(0.9433178, rel=1e-6)
    assert share(10, 10).high == 1.0
    assert 0.69 < (share(10, 10).low or 0.0) < 0.73


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


def test_a_run_that_no_verdict_describes_was_run_and_not_held() -> None:
    for verdict in ("cannot_say", "guarded", "no_data", "contact_lost", "diverged", "limit_cycle"):
        found = held_of(["stable", verdict, "stable", verdict])
        assert (found.runs, found.held, found.share) == (4, 2, 0.5), verdict
        assert (found.low, found.high) == wilson(2, 4)
    assert held_of([]).share == 0.0
