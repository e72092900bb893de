"""Sessions over one another: names, table, figure; and the sessions of a sweep."""

import csv
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from analysis.compare import names_of, recordings_of, sessions_in
from proto.errors import ConfigError, RigError
from telenano.cli import sweep
from telenano.cli.root import app
from telenano.cli.sweep import points_of, run_sweep, without_sweep

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def compared(recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    folder = tmp_path_factory.mktemp("compare")
    for name, law in (("a", "wave"), ("b", "position_force")):
        (folder / name).mkdir()
        shutil.copy(recording_of(f"fig12_{law}"), folder / name / "session.mcap")
    out = folder / "out"
    arguments = ["compare", str(folder / "a"), str(folder / "b" / "session.mcap"), "--out", str(out)]
    result = RUNNER.invoke(app, [*arguments, "--format", "png,svg", "--json"])
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
    assert all(word in text for word in ("a: ", "b: ", "(a)", "(c)", "tip-sample distance h (nm)"))


def test_one_session_and_a_folder_without_one_are_refused(tmp_path: Path) -> None:
    assert RUNNER.invoke(app, ["compare", "a.mcap"]).exit_code == 2
    with pytest.raises(ConfigError, match=r"has no session\.mcap in it"):
        recordings_of(tmp_path)


def test_the_results_of_a_sweep_beside_its_sessions_are_no_sessions(tmp_path: Path) -> None:
    """`compare out/delay/*` gives the figure and the tables of the sweep with its folders."""
    (tmp_path / "round_trip_ms=0").mkdir()
    for name in ("compare.csv", "compare.json", "compare.png", "session.mcap"):
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


def test_a_sweep_is_every_combination_of_its_values() -> None:
    points = points_of(["round_trip_ms=0,40", "controller.law=wave,smith"])
    assert [point.name for point in points] == [
        "round_trip_ms=0, law=wave", "round_trip_ms=0, law=smith",
        "round_trip_ms=40, law=wave", "round_trip_ms=40, law=smith",
    ]  # fmt: skip
    assert points[3].options == ("--round-trip-ms", "40", "--set", "controller.law=smith")


@pytest.mark.parametrize(
    ("sweep_text", "reason"),
    [
        ("roundtrip=1,2", "roundtrip=1,2: no key of a scenario; did you mean round_trip_ms?"),
        ("round_trip_ms=1,fast", "--round-trip-ms = fast: is not a number of milliseconds"),
        ("controller.law=wave,waves", "waves"),
    ],
)
def test_a_wrong_value_is_found_before_the_first_session(tmp_path: Path, sweep_text: str, reason: str) -> None:
    arguments = ["up", "--scenario", "fig12", "--no-view", "--out", str(tmp_path / "out"), "--sweep", sweep_text]
    done = RUNNER.invoke(app, arguments)
    assert done.exit_code == 2
    assert reason in done.stderr
    assert "1/2" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_seed_is_that_of_everything_in_a_session_that_is_random() -> None:
    [_, point] = points_of(["seed=0,1"])
    assert point.name == "seed=1"
    assert point.options == (
        "--set", "delay_node.seed=1", "--set", "haptic_node.disturbances.seed=1",
        "--set", "afm_node.disturbances.seed=1",
    )  # fmt: skip


@pytest.mark.parametrize("text", ["round_trip_ms", "=1,2", "a.b=", "a.b=1,,2"])
def test_a_sweep_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="is not of the form KEY=V1,V2"):
        points_of([text])
    with pytest.raises(ConfigError, match="same values"):
        points_of(["a.b=1,1"])
    with pytest.raises(ConfigError, match="more than 100"):
        points_of([f"a.b={','.join(map(str, range(101)))}"])
    with pytest.raises(ConfigError, match=r"roundtrip=10,20: no key of a scenario; did you mean round_trip_ms\?"):
        points_of(["roundtrip=10,20"])
    assert [point.name for point in points_of(["duration_s=1,2"])] == ["duration_s=1", "duration_s=2"]


def test_each_session_has_the_options_of_the_sweep_but_its_own() -> None:
    words = [
        "telenano",
        "up",
        "--scenario",
        "fig12",
        "--sweep",
        "a.b=1,2",
        "--out=x",
        "--sweep=c=1",
        "--seeds",
        "3",
        "--table=mat",
        "--no-view",
        "--json",
    ]
    assert without_sweep(words) == ["--scenario", "fig12", "--no-view"]


def test_the_sessions_run_one_after_the_other_and_a_failure_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commands: list[list[str]] = []

    def run(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        failed = "smith" in " ".join(command)
        return subprocess.CompletedProcess(command, int(failed), "", "telenano: the rig failed" if failed else "")

    monkeypatch.setattr(sweep, "run_session", run)
    shown: list[str] = []
    with pytest.raises(RigError, match="the session law=smith failed: telenano: the rig failed"):
        run_sweep(points_of(["controller.law=wave,smith,passivity"]), ["--no-view"], tmp_path, shown.append)
    assert shown == ["1/3: law=wave", "2/3: law=smith"]
    assert commands[0][3:] == [
        "up", "--no-view", "--set", "controller.law=wave", "--out", str(tmp_path / "law=wave"), "--json",
    ]  # fmt: skip
