"""The sessions of a sweep: their names, their options, and the command of a package that compares them."""

import json
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from telenano.cli import lazy_commands, sweep
from telenano.cli.options import table_formats
from telenano.cli.root import app
from telenano.cli.sweep import KEPT_NAME, Kept, points_of, run_sweep, without_sweep
from telenano.testing import run_apart
from telenano.virtual.request import SimulateRequest
from telenano.wire.errors import ConfigError, RigError

RUNNER = CliRunner()


def test_a_sweep_is_every_combination_of_its_values() -> None:
    points = points_of(["round_trip_ms=0,40", "controller.law=wave,smith"])
    assert [point.name for point in points] == [
        "round_trip_ms=0, law=wave", "round_trip_ms=0, law=smith",
        "round_trip_ms=40, law=wave", "round_trip_ms=40, law=smith",
    ]  # fmt: skip
    assert points[3].options == ("--round-trip-ms", "40", "--set", "controller.law=smith")


def test_a_command_with_a_seed_of_its_own_is_given_it() -> None:
    points = points_of(["seed=3,4"], seed_option="--seed")
    assert [point.options for point in points] == [("--seed", "3"), ("--seed", "4")]
    request = SimulateRequest(scenario="fig12", settings=("controller.law=wave",))
    asked = points[1].asked_of(request, Path("out"))
    assert (asked.seed, asked.settings, asked.out) == (4, ("controller.law=wave",), Path("out/seed=4"))
    words = ["telenano", "simulate", "fig12", "--seeds", "2", "--json", "--no-report", "--out", "x"]
    assert without_sweep(words, "simulate") == ["fig12", "--no-report"]


@pytest.mark.parametrize("seed", ["x", "1.5"])
def test_a_seed_that_is_no_whole_number_is_refused(tmp_path: Path, seed: str) -> None:
    done = RUNNER.invoke(app, ["simulate", "fig12", "--out", str(tmp_path / "out"), "--sweep", f"seed=1,{seed}"])
    assert done.exit_code == 2
    assert f"--seed = {seed}: is not a whole number" in done.stderr


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
    words = ["telenano", "simulate", "fig12", "--no-report", "--format", "svg", "--seeds", "2", "--style=paper"]
    assert without_sweep(words, "simulate") == ["fig12", "--no-report"]


class Sessions:
    """Stands in for the commands of sessions: notes each, and leaves a recording, or fails where it is told to."""

    def __init__(self) -> None:
        self.commands: list[list[str]] = []
        self.failing: set[str] = set()

    def __call__(self, command: list[str], **options: Any) -> dict[str, Any]:
        self.commands.append(command)
        folder = Path(command[command.index("--out") + 1])
        if folder.name in self.failing:
            raise RigError("the rig failed")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "session.mcap").touch()
        return {"verdict": "stable"}

    def names(self) -> list[str]:
        names = [Path(command[command.index("--out") + 1]).name for command in self.commands]
        self.commands.clear()
        return names


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> Sessions:
    ran = Sessions()
    monkeypatch.setattr(sweep, "run_session", ran)
    return ran


POINTS = points_of(["controller.law=wave,smith,passivity"])
SETTINGS = {point.name: "same" for point in POINTS}


def test_a_failure_is_named_and_a_second_start_goes_on_with_what_is_left(tmp_path: Path, sessions: Sessions) -> None:
    sessions.failing = {"law=smith"}
    with pytest.raises(RigError, match="the session law=smith failed: the rig failed"):
        run_sweep(POINTS, ["--no-view"], tmp_path, Kept(tmp_path), SETTINGS)
    assert sessions.commands[0][3:] == [
        "up", "--no-view", "--set", "controller.law=wave", "--out", str(tmp_path / "law=wave"), "--json",
    ]  # fmt: skip
    assert sessions.names() == ["law=wave", "law=smith"]
    sessions.failing = set()
    folders = run_sweep(POINTS, ["--no-view"], tmp_path, Kept(tmp_path), SETTINGS)
    # What was begun and is not done is replaced; nothing else is.
    assert ["--overwrite" in command for command in sessions.commands] == [True, False]
    assert sessions.names() == ["law=smith", "law=passivity"]
    assert folders == [tmp_path / point.name for point in POINTS]
    run_sweep(POINTS, ["--no-view"], tmp_path, Kept(tmp_path), SETTINGS)
    assert sessions.names() == []


def test_a_session_of_other_settings_or_without_its_recording_is_not_taken_for_done(
    tmp_path: Path, sessions: Sessions
) -> None:
    run_sweep(POINTS, [], tmp_path, Kept(tmp_path), SETTINGS)
    sessions.names()
    (tmp_path / "law=smith" / "session.mcap").unlink()
    run_sweep(POINTS, [], tmp_path, Kept(tmp_path), SETTINGS | {"law=wave": "other"})
    assert ["--overwrite" in command for command in sessions.commands] == [False, False]
    assert sessions.names() == ["law=wave", "law=smith"]


def test_a_line_that_was_cut_short_counts_as_none(tmp_path: Path, sessions: Sessions) -> None:
    run_sweep(POINTS, [], tmp_path, Kept(tmp_path), SETTINGS)
    path = tmp_path / KEPT_NAME
    path.write_text(path.read_text()[:-20])
    sessions.names()
    run_sweep(POINTS, [], tmp_path, Kept(tmp_path), SETTINGS)
    assert sessions.names() == ["law=passivity"]


def test_as_many_sessions_run_at_a_time_as_there_are_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = threading.Barrier(3, timeout=20.0)

    def run(command: list[str], **options: Any) -> dict[str, Any]:
        at_once.wait()
        return {}

    monkeypatch.setattr(sweep, "run_session", run)
    run_sweep(POINTS, [], tmp_path, Kept(tmp_path), SETTINGS, jobs=3)


def test_an_interruption_ends_the_running_session_and_begins_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    begun: list[str] = []
    ended: list[bool] = []

    def run(command: list[str], progress: Callable[[float], object], **options: Any) -> dict[str, Any]:
        begun.append(Path(command[command.index("--out") + 1]).name)
        if len(begun) == 1:
            return {}
        # The kernel may give the signal to any thread.
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        try:
            for _ in range(2000):
                progress(0.0)
                time.sleep(0.01)
        except KeyboardInterrupt:
            ended.append(True)
            raise
        return {}

    monkeypatch.setattr(sweep, "run_session", run)
    # Background processes of a shell ignore this signal, and so do their children, this process among them.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with pytest.raises(KeyboardInterrupt):
        run_sweep(POINTS, [], tmp_path, Kept(tmp_path), SETTINGS)
    assert (begun, ended) == (["law=wave", "law=smith"], [True])
    assert "1 of 3 sessions are done and kept" in capsys.readouterr().err
    kept = Kept(tmp_path)
    assert [kept.is_partial(point.name) for point in POINTS] == [False, True, False]


@pytest.mark.check("records two short sessions")
def test_a_batch_is_recorded_first_and_its_figures_are_drawn_by_one_command(tmp_path: Path) -> None:
    fast = ("--duration", "0.2", "--set", "realtime.rate_hz=250", "--no-report")
    done = run_apart("simulate", *fast, "--seeds", "2", "--jobs", "2", "--out", tmp_path, "--json")
    assert (done.returncode, len(json.loads(done.stdout)["sessions"])) == (0, 2), done.stderr
    assert not list(tmp_path.rglob("fig12.png"))
    done = run_apart("report", tmp_path, "--jobs", "2", "--json")
    assert (done.returncode, len(json.loads(done.stdout)["sessions"])) == (0, 2), done.stderr
    assert sorted(path.parent.name for path in tmp_path.rglob("fig12.png")) == ["seed=0", "seed=1"]
    done = run_apart("simulate", *fast, "--set", "controller.law=wave", "--seeds", "3", "--out", tmp_path)
    assert (done.returncode, "exists already" in done.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--sweep", "controller.law=wave"), "gives one session"),
        (("--seeds", "2", "--table", "csv,xlsx"), "name one or more of csv, parquet, mat"),
    ],
)
def test_what_a_sweep_cannot_compare_is_refused_before_its_first_session(
    tmp_path: Path, words: tuple[str, ...], reason: str
) -> None:
    done = RUNNER.invoke(app, ["up", "--scenario", "fig12", "--no-view", "--out", str(tmp_path / "out"), *words])
    assert done.exit_code == 2
    assert reason in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_sweep_without_the_package_that_compares_is_refused_with_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lazy_commands, "package_commands", dict)
    arguments = ["up", "--scenario", "fig12", "--no-view", "--out", str(tmp_path / "out"), "--seeds", "2"]
    done = RUNNER.invoke(app, arguments)
    assert done.exit_code == 2
    assert "the command 'compare' is in the package telenano-lab" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("text", ["", "xlsx", "csv,xlsx"])
def test_a_table_of_an_unknown_kind_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="name one or more of csv, parquet, mat"):
        table_formats(text)
