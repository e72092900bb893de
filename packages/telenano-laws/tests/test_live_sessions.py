"""A live session of a law is a row of a table, and what went wrong is a sentence."""

import json
from pathlib import Path
from typing import Any

import pytest
from telenano_laws import live_sessions

SUMMARY = {
    "verdict": "stable",
    "reason": "at rest",
    "holds": [
        {"hand_force_n": 1.0, "hold_ratio": 1.0, "facts": [{"kind": "struck", "value": 5.25}]},
        {"hand_force_n": 2.0, "hold_ratio": None, "facts": []},
        {"hand_force_n": 0.0, "hold_ratio": 9.0, "facts": []},
    ],
}


class Started:
    """Takes the place of `telenano up`: notes the command, and answers with a text."""

    def __init__(self, stdout: str, stderr: str = "") -> None:
        self.stdout, self.stderr = stdout, stderr
        self.commands: list[list[str]] = []

    def __call__(self, command: list[str], **options: Any) -> "Started":
        self.commands.append(command)
        return self


def test_a_row_has_the_holds_in_which_the_hand_pressed_and_the_blow() -> None:
    row = live_sessions.row("wave", "clean", "sim", SUMMARY)
    assert row == "| wave | clean | sim | stable | 1.000, – | 5.25 | at rest |"


def test_each_law_runs_over_each_line_with_its_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    up = Started(json.dumps(SUMMARY))
    monkeypatch.setattr(live_sessions, "run", up)
    live_sessions.main([str(tmp_path), "wave", "--device", "sim", "--rate", "250"])
    assert [command[command.index("--out") + 1] for command in up.commands] == [
        str(tmp_path / f"wave-{line}-sim") for line in live_sessions.LINES
    ]
    assert {"controller.law=wave", "delay_node.seed=3", "realtime.rate_hz=250"} < set(up.commands[0])
    rows = (tmp_path / "sessions.md").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 2 + len(live_sessions.LINES)


@pytest.mark.parametrize(
    ("stdout", "stderr", "text"),
    [("", "no room", "no room"), (json.dumps({"error": "port taken"}), "", "port taken")],
)
def test_a_session_that_does_not_run_ends_with_its_reason(
    stdout: str, stderr: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr(live_sessions, "run", Started(stdout, stderr))
    with pytest.raises(SystemExit, match="4"):
        live_sessions.main([str(tmp_path), "wave", "--device", "sim"])
    assert text in capsys.readouterr().err
