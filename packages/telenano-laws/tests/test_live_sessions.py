"""A live session of a law is a row of a table, and what went wrong is a sentence."""

from pathlib import Path
from typing import Any

import pytest
from telenano_laws import live_sessions

from telenano.wire import RigError

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
    """Takes the place of `telenano up`: notes the command, and answers with a summary, or fails with a reason."""

    def __init__(self, summary: dict[str, Any], reason: str = "") -> None:
        self.summary, self.reason = summary, reason
        self.commands: list[list[str]] = []

    def __call__(self, command: list[str], **options: Any) -> dict[str, Any]:
        self.commands.append(command)
        if self.reason:
            raise RigError(self.reason)
        return self.summary


def test_a_row_has_the_holds_in_which_the_hand_pressed_and_the_blow() -> None:
    row = live_sessions.row("wave", "clean", "sim", SUMMARY)
    assert row == "| wave | clean | sim | stable | 1.000, – | 5.25 | at rest |"


def test_each_law_runs_over_each_line_with_its_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    up = Started(SUMMARY)
    monkeypatch.setattr(live_sessions, "run_session", up)
    live_sessions.main([str(tmp_path), "wave", "--device", "sim", "--rate", "250"])
    assert [command[command.index("--out") + 1] for command in up.commands] == [
        str(tmp_path / f"wave-{line}-sim") for line in live_sessions.LINES
    ]
    assert {"controller.law=wave", "delay_node.seed=3", "realtime.rate_hz=250"} < set(up.commands[0])
    rows = (tmp_path / "sessions.md").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 2 + len(live_sessions.LINES)


def test_a_session_that_does_not_run_ends_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.setattr(live_sessions, "run_session", Started({}, "no room"))
    with pytest.raises(SystemExit, match="4"):
        live_sessions.main([str(tmp_path), "wave", "--device", "sim"])
    assert "no room" in capsys.readouterr().err


class Silent:
    """A device that has started and never answers."""

    def __init__(self, command: list[str], stderr: Any, **options: Any) -> None:
        stderr.write(b"no room for it")
        self.ended = False

    def __enter__(self) -> "Silent":
        return self

    def __exit__(self, *error: object) -> None:
        assert self.ended

    def poll(self) -> None:
        return None

    def terminate(self) -> None:
        self.ended = True


def test_a_device_that_never_answers_ends_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_sessions, "start", Silent)
    monkeypatch.setattr(live_sessions, "_READY_S", 0.05)
    with (
        pytest.raises(RigError, match="the emulated Inverse3 did not start: no room for it"),
        live_sessions.emulated_inverse3("fig12"),
    ):
        pass
