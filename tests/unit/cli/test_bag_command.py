"""The commands on recordings, as a person types them."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from telenano.cli.commands.bag import app
from telenano.cli.output import EXIT_INCOMPLETE, closing_lines, fail_with_summary, print_summary
from telenano.cli.tables import summary_tables
from telenano.recording.reader import Recording
from telenano.testing import invoke
from telenano.testing import run as run_whole
from telenano.wire.errors import ReportError

MakeFile = Callable[..., Path]


def run(*arguments: str | Path, exit_code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert result.exit_code == exit_code, result.output
    return result.stdout


def run_json(*arguments: str | Path, exit_code: int = 0) -> Any:
    return json.loads(run(*arguments, "--json", exit_code=exit_code))


def test_info_and_list(make_file: MakeFile, tmp_path: Path) -> None:
    path = make_file()
    (tmp_path / "broken.mcap").write_bytes(b"no recording")
    assert run_json("info", path)["messages"] == 80
    assert "haptic/state" in run("info", path)
    rows = {Path(row["path"]).name: row for row in run_json("list", tmp_path)["recordings"]}
    assert rows["session.mcap"]["messages"] == 80
    assert "is not an MCAP file" in rows["broken.mcap"]["note"]
    assert "session.mcap" in run("list", tmp_path)
    run("list", tmp_path / "nowhere", exit_code=1)


def test_cat_prints_a_line_a_message(make_file: MakeFile) -> None:
    path = make_file()
    lines = [json.loads(line) for line in run("cat", path, "--nodes", "haptic_node", "--count", "3").splitlines()]
    assert [(line["channel"], line["seq"]) for line in lines] == [("haptic/state", seq) for seq in range(3)]
    late = [json.loads(line) for line in run("cat", path, "--start", "0.0385").splitlines()]
    assert [line["seq"] for line in late] == [39, 39]
    forward = [json.loads(line) for line in run("cat", path, "--topics", "teleop/forward@slave").splitlines()]
    assert [line["message"]["seq"] for line in forward] == list(range(40))
    run("cat", path, "--topics", "teleop/forwrd", exit_code=1)


def test_filter_split_merge_recover_and_diff(make_file: MakeFile, tmp_path: Path) -> None:
    path = make_file()
    assert run_json("filter", path, "--topics", "/state/", "--out", tmp_path / "f.mcap")["messages"] == 40
    parts = run_json("split", path, "--interval", "0.01", "--out", tmp_path / "parts")["parts"]
    assert len(parts) == 4
    run("merge", *(part["path"] for part in parts), "--same-session", "--out", tmp_path / "m.mcap")
    assert len(run_json("info", tmp_path / "m.mcap")["channels"]) == len(run_json("info", path)["channels"])
    path.write_bytes(path.read_bytes()[:2000])
    recovered = run_json("recover", path, "--out", tmp_path / "r.mcap")
    assert recovered["skipped"]
    assert Recording(tmp_path / "r.mcap").closed
    run("recover", path, "--out", tmp_path / "r.mcap", exit_code=2)


def test_verify_gives_its_verdict_as_exit_code(make_file: MakeFile) -> None:
    path = make_file()
    assert run_json("verify", path)["sound"]
    path.write_bytes(path.read_bytes()[:-100])
    assert "end: " in run("verify", path, exit_code=1)


def test_export_names_its_formats(make_file: MakeFile, tmp_path: Path) -> None:
    path = make_file()
    assert run_json("export", path, "--to", "csv", "--out", tmp_path / "csv")["messages"] == 80
    run("export", path, "--to", "xls", "--out", tmp_path / "xls", exit_code=2)


def test_replay_and_record_refuse_what_cannot_be(make_file: MakeFile, tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(f"nodes: {{haptic_node@master: 'ipc://{tmp_path}/h', player@master: 'ipc://{tmp_path}/p'}}\n")
    path = make_file()

    def fails(*arguments: str | Path) -> str:
        result = invoke(arguments)
        assert result.exit_code in (1, 2)
        return result.stderr

    assert "delay_node@slave is not in the site file" in fails("replay", path, "--site-file", site)
    assert "--duration: not with --end" in fails("replay", path, "--end", "1", "--duration", "1")
    unknown = "has no message of node afm_node: known are controller@master, haptic_node@master"
    assert unknown in fails("replay", path, "--site-file", site, "--nodes", "afm_node")
    assert "--quota-policy" in fails("record", "--out", tmp_path / "x.mcap", "--quota-policy", "none")
    site.write_text(f"nodes: {{haptic_node@master: 'ipc://{tmp_path}/h'}}\n")
    assert "player@master is missing" in fails("replay", path, "--site-file", site, "--nodes", "haptic_node")


SUMMARY = {
    "scenario": "fig12",
    "law": ["wave", "passivity"],
    "link_round_trip_ms": 40.0,
    "loop_round_trip_ms": 43.0,
    "hold_ratio": 1.05,
    "verdict": "limit_cycle",
    "recording": {"file": "s.mcap", "complete": True, "missing": [], "lost": 0, "messages": 9},
    "holds": [],
}
PARTS = [{"file": "s.mcap", "pause_s": 0.0}, {"file": "s_1.mcap", "pause_s": 0.3}]
MISSING = ["the disk was full", "7 messages are missing"]


@pytest.mark.parametrize("as_json", [True, False])
def test_a_loss_is_in_the_table_and_in_the_exit_code(capsys: pytest.CaptureFixture[str], as_json: bool) -> None:
    print_summary(SUMMARY, "s", tables=True, as_json=as_json)
    lost = {**SUMMARY["recording"], "complete": False, "missing": MISSING, "lost": 7, "parts": PARTS}
    capsys.readouterr()
    with pytest.raises(typer.Exit) as caught:
        print_summary({**SUMMARY, "recording": lost}, "s", tables=True, as_json=as_json)
    assert caught.value.exit_code == EXIT_INCOMPLETE == 3
    out, err = capsys.readouterr()
    assert err == "telenano: the recording is not whole: the disk was full; 7 messages are missing\n"
    if as_json:
        assert json.loads(out)["recording"]["missing"] == MISSING
    else:
        assert "recording.parts" in out


def test_a_session_ends_in_three_lines_what_happened_the_picture_and_what_to_do_next(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "fig12.png").touch()
    monkeypatch.setattr("sys.argv", ["bin/telenano", "up"])
    print_summary(SUMMARY, str(tmp_path), tables=True, as_json=False)
    lines = capsys.readouterr().out.splitlines()
    print_summary(SUMMARY, str(tmp_path), tables=False, as_json=False)
    assert capsys.readouterr().out.splitlines() == lines[-3:]
    assert len(lines) > 10
    assert lines[-3:] == [
        "fig12 with wave then passivity, 40 ms by the link: limit cycle",
        f"picture: {tmp_path / 'fig12.png'}; all numbers: {tmp_path / 'summary.json'}",
        "next: `bin/telenano view s.mcap` shows it again, `bin/telenano up touch` lets you press",
    ]


def test_the_last_lines_give_the_reason_of_a_verdict_the_paths_as_typed_and_another_thing_to_do_after_a_touch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["bin/telenano", "up"])
    monkeypatch.chdir(tmp_path)
    recording = {**SUMMARY["recording"], "file": str(tmp_path / "out" / "session.mcap")}
    summary = {**SUMMARY, "scenario": "touch", "verdict": "cannot_say", "reason": "no force", "recording": recording}
    happened, picture, further = closing_lines(summary, tmp_path / "out")
    assert "cannot say (no force)" in happened
    assert picture == f"picture: none; all numbers: {Path('out/summary.json')}"
    assert further.startswith("next: `bin/telenano view out/session.mcap` shows it again, ")
    assert "--scenario touch" not in further
    assert "(" not in closing_lines({**summary, "verdict": "stable"}, tmp_path)[0]


@pytest.mark.parametrize(
    ("verdict", "share", "praise"),
    [
        ("stable", 1.0, "; the hand held 1.050 N for each newton at the tip"),
        ("stable", 0.62, "; the hand held 1.050 N for each newton at the tip, in the 62 % of the hold in which both"),
        ("guarded", 0.05, ""),
        ("limit_cycle", 1.0, ""),
        ("no_data", 1.0, ""),
    ],
)
def test_the_last_line_says_what_the_hand_held_only_of_what_was_there(verdict: str, share: float, praise: str) -> None:
    holds = [{"hold_ratio": 1.05, "coupled_share": share}, {"hold_ratio": None, "coupled_share": 0.1}]
    happened = closing_lines({**SUMMARY, "verdict": verdict, "reason": "so", "holds": holds}, Path())[0]
    assert praise in happened
    assert ("the hand held" in happened) is bool(praise)
    assert happened.endswith(praise) or share == 0.62


LET_GO = {"kind": "hand_let_go", "start_s": 1.5, "end_s": 1.54, "reason": "no command within the deadline"}


@pytest.mark.parametrize(
    ("interruptions", "overruns", "is_told"),
    # a twentieth of the steps that the hand took, and a two-hundredth where commands came too late
    [([], 350, False), ([], 351, True), ([LET_GO], 35, False), ([LET_GO], 36, True)],
)
def test_the_end_of_a_session_on_a_machine_without_room_names_the_key_that_helps(
    capsys: pytest.CaptureFixture[str], interruptions: list[dict[str, Any]], overruns: int, is_told: bool
) -> None:
    spent = {"overruns": overruns, "rate_hz": {"haptic/state": 700.0, "afm/state": 690.0}, "duration_s": 10.0}
    print_summary({**SUMMARY, **spent, "interruptions": interruptions}, "s", tables=False, as_json=False)
    if interruptions:
        first, _, rest = capsys.readouterr().err.partition("\n")
        assert first == (
            "telenano: warning: not only the law acted in this session: the hand was let go once, at 1.500 s, for 40 "
            "ms (no command within the deadline)"
        )
        assert ("36 deadlines were missed at 700 Hz" in rest) is is_told
        return
    told = (
        f"telenano: warning: {overruns} deadlines were missed at 700 Hz: the machine is too busy for this "
        "rate: end what else runs there, or give a lower realtime.rate_hz\n"
    )
    assert capsys.readouterr().err == (told if is_told else "")


def test_what_is_missing_is_red() -> None:
    lost = {**SUMMARY["recording"], "complete": False, "missing": MISSING, "lost": 7}
    console = Console(width=100, force_terminal=True, color_system="standard", file=io.StringIO())
    console.print(summary_tables({"recording": lost}, "s"))
    drawn = console.file.getvalue()
    for text in ("no", *MISSING, "7"):
        assert f"\x1b[31m{text}" in drawn
    assert "\x1b[31m9" not in drawn


def test_a_report_that_cannot_be_written_shows_its_summary_all_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    error = ReportError("x/fig12.png: cannot be written: No space left on device", SUMMARY)
    with pytest.raises(typer.Exit) as caught:
        fail_with_summary(error, "s", as_json=False)
    assert caught.value.exit_code == 1
    out, err = capsys.readouterr()
    assert "fig12" in out
    assert err == f"telenano: {error}\n"


def test_the_folder_of_a_session_stands_for_its_recording(recording_of: Callable[[str], Path], tmp_path: Path) -> None:
    (tmp_path / "session.mcap").symlink_to(recording_of("wave").resolve())
    (tmp_path / "summary.json").write_text("{}")
    assert run_whole("bag", "info", tmp_path, "--json") == run_whole("bag", "info", tmp_path / "session.mcap", "--json")
    code, _, err = run_whole("bag", "verify", tmp_path)
    assert code == 0, err
    (tmp_path / "session_2.mcap").symlink_to(recording_of("wave").resolve())
    code, _, err = run_whole("bag", "info", tmp_path)
    assert (code, "has several recordings, give one of session.mcap, session_2.mcap" in " ".join(err.split())) == (
        2,
        True,
    )
