"""`telenano simulate`: what it leaves, what it prints, and what it refuses."""

import json
from pathlib import Path

import pytest

from telenano.testing import run

FAST = ("--duration", "0.6", "--set", "realtime.rate_hz=250")


def test_a_session_leaves_what_up_leaves(tmp_path: Path) -> None:
    code, out, _ = run("simulate", "fig12", *FAST, "--seed", 2, "--out", tmp_path, "--json")
    assert code == 0
    summary = json.loads(out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert summary["recording"]["complete"]
    assert {path.name for path in tmp_path.iterdir()} >= {"session.mcap", "summary.json", "fig12.png", "scenario.yaml"}
    code, out, _ = run("report", tmp_path / "session.mcap", "--out", tmp_path / "again", "--json")
    assert (code, json.loads(out)["verdict"]) == (0, summary["verdict"])
    code, out, _ = run("bag", "info", tmp_path / "session.mcap", "--json")
    assert code == 0
    assert json.loads(out)["messages"] == summary["recording"]["messages"]
    code, _, _ = run("bag", "verify", tmp_path / "session.mcap")
    assert code == 0


def test_a_folder_with_a_session_is_kept_unless_it_may_be_replaced(tmp_path: Path) -> None:
    command = ("simulate", "fig12", *FAST, "--no-report", "--out", tmp_path)
    assert run(*command)[0] == 0
    code, _, err = run(*command)
    assert code == 2
    assert "exists already" in err
    assert run(*command, "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("option", "value", "more"),
    [("--table", "parquet", ()), ("--format", "svg", ("--no-report",)), ("--style", "paper", ("--no-report",))],
)
def test_an_option_that_nothing_would_use_is_refused(
    option: str, value: str, more: tuple[str, ...], tmp_path: Path
) -> None:
    code, _, err = run("simulate", "fig12", *FAST, option, value, *more, "--out", tmp_path / "session")
    assert (code, (tmp_path / "session").exists()) == (2, False)
    assert f"{option}: not with" in " ".join(err.split())


def test_a_wrong_key_and_a_wrong_command_are_refused_with_a_sentence(tmp_path: Path) -> None:
    for words, text in (
        (("--set", "controller.lawe=wave"), "lawe"),
        (("--at", "1 jump controller"), "no such command"),
        (("--seed", "-1"), "--seed"),
    ):
        code, _, err = run("simulate", "fig12", *words, "--out", tmp_path / "out")
        assert (code, text in err) == (2, True), err
    assert not list(tmp_path.rglob("*.mcap"))
