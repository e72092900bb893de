"""Sessions over one another: names, table, figure."""

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.comparison import Drawn, compare, compare_figures, names_of, rows_of, sessions_in

from telenano.testing import invoke


@pytest.fixture(scope="module")
def compared(recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    folder = tmp_path_factory.mktemp("compare")
    for name, law in (("a", "wave"), ("b", "position_force")):
        (folder / name).mkdir()
        shutil.copy(recording_of(law), folder / name / "session.mcap")
    out = folder / "out"
    arguments = ["compare", str(folder / "a"), str(folder / "b" / "session.mcap"), "--out", str(out)]
    result = invoke([*arguments, "--format", "png,svg", "--json"])
    assert result.exit_code == 0, result.stderr
    return out, json.loads(result.stdout)


@pytest.mark.endurance
def test_the_table_has_a_row_for_each_session_with_units_in_its_heads(compared: tuple[Path, Any]) -> None:
    out, document = compared
    rows = document["sessions"]
    assert [row["session"] for row in rows] == ["a", "b"]
    assert [row["law"] for row in rows] == ["wave", "position_force"]
    # parameters that only one of the laws has are what distinguishes them
    assert rows[0]["impedance_n_s_per_m"] == 100.0
    assert rows[1]["impedance_n_s_per_m"] is None
    with (out / "compare.csv").open() as file:
        table = list(csv.DictReader(file))
    assert [row["law"] for row in table] == ["wave", "position_force"]
    assert "round trip of the loop [ms]" in table[0]
    assert set(json.loads((out / "compare.json").read_text())) == {"a", "b"}


@pytest.mark.endurance
def test_the_figure_is_written_in_every_format_with_every_session(compared: tuple[Path, Any]) -> None:
    out, _ = compared
    assert (out / "compare.png").stat().st_size > 20_000
    text = (out / "compare.svg").read_text()
    assert all(word in text for word in ("a: ", "b: ", "(a)", "(c)", "(d)", "distance h (nm)"))


@pytest.mark.check("starts two processes")
def test_sessions_that_are_judged_side_by_side_give_the_same_rows(recording_of: Callable[[str], Path]) -> None:
    paths = [recording_of("wave"), recording_of("virtual_impedance")]
    alone, together = (compare(paths, jobs=jobs) for jobs in (1, 2))
    assert rows_of(alone) == rows_of(together)
    assert [one.summary for one in alone] == [one.summary for one in together]
    for one, other in zip(alone, together, strict=True):
        for curve, again in zip(Drawn.of(one).curves, Drawn.of(other).curves, strict=True):
            np.testing.assert_array_equal(curve, again)


def test_one_session_and_a_folder_without_one_are_refused(tmp_path: Path) -> None:
    assert invoke(["compare", "a.mcap"]).exit_code == 2
    done = invoke(["compare", str(tmp_path), str(tmp_path)])
    assert done.exit_code == 2
    assert "has no session.mcap in it" in done.output


def test_the_results_of_a_sweep_beside_its_sessions_are_no_sessions(tmp_path: Path) -> None:
    """`compare out/delay/*` gives the figure and the tables of the sweep with its folders."""
    (tmp_path / "round_trip_ms=0").mkdir()
    for name in ("compare.csv", "compare.json", "compare.png", "session.mcap", "sessions.jsonl"):
        (tmp_path / name).touch()
    assert [path.name for path in sessions_in(sorted(tmp_path.glob("*")))] == ["round_trip_ms=0", "session.mcap"]


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["out/delay/0", "out/delay/40"], ["0", "40"]),
        (["out/a/session.mcap", "out/b/session.mcap"], ["a", "b"]),
        (["x/one.mcap", "y/two.mcap"], ["one", "two"]),
        (["x/out/k=1", "y/out/k=1"], ["x", "y"]),
    ],
)
def test_a_session_has_the_shortest_name_that_distinguishes_it(paths: list[str], names: list[str]) -> None:
    assert names_of(list(map(Path, paths))) == names


def test_a_session_that_is_given_twice_has_a_number() -> None:
    assert names_of([Path("a.mcap"), Path("a.mcap")])[0] != names_of([Path("a.mcap"), Path("a.mcap")])[1]


def test_the_distance_ends_where_no_force_is_left(recording_of: Callable[[str], Path]) -> None:
    sessions = compare([recording_of("wave"), recording_of("virtual_impedance")])
    [figure] = compare_figures(sessions)
    panel = figure.axes[3]
    low, high = panel.get_xlim()
    for one in sessions:
        path = one.session.series().tip_path()
        felt_nm = 1e9 * path.separation_m[np.abs(path.force_n) > 0.02 * np.nanmax(np.abs(path.force_n))]
        assert low < felt_nm.min() and felt_nm.max() < high
    # Nothing happens before the hand pushes, 0.8 s after the begin.
    assert 0.3 < figure.axes[0].get_xlim()[0] < 0.8
    # The approach begins 10 nm away, and its first half has no force.
    assert max(1e9 * one.session.series().tip_path().separation_m.max() for one in sessions) > 1.5 * high
