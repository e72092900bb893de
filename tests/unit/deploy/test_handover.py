"""What a session in a container leaves in ./out: its files, under the names that they have there, as its owner's."""

import errno
import importlib.util
import io
import json
import os
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[3]
SUMMARY = {"verdict": "stable", "recording": {"complete": True}}


@pytest.fixture
def handover(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    specification = importlib.util.spec_from_file_location("handover", ROOT / "deploy" / "handover.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    for name in ("RECORDINGS", "OUT", "RUNTIME"):
        folder = tmp_path / name.lower()
        folder.mkdir()
        monkeypatch.setattr(module, name, folder)
    return module


@pytest.fixture
def writer(handover: Any) -> Iterator[socket.socket]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        served = threading.Thread(target=handover.write, args=(theirs, handover.OUT))
        served.start()
        yield ours
        ours.close()
        served.join(10.0)
        assert not served.is_alive()


def session(handover: Any, name: str = "fig12-1", parts: tuple[str, ...] = ("session_3.mcap",)) -> Path:
    """Write what `telenano up` leaves, with a recording of the recorder in one or several parts."""
    folder: Path = handover.RECORDINGS / "sessions" / name
    (folder / "logs").mkdir(parents=True)
    (folder / "logs" / "launcher.log").write_text("begun")
    for part in parts:
        (handover.RECORDINGS / part).write_bytes(part.encode() * 1000)
    recording = {**SUMMARY["recording"], "file": str(handover.RECORDINGS / parts[0])}  # type: ignore[dict-item]
    if len(parts) > 1:
        recording["parts"] = [{"file": part} for part in parts]
    (folder / "summary.json").write_text(json.dumps({**SUMMARY, "recording": recording}, indent=2) + "\n")
    return folder


def test_a_session_has_its_recording_in_its_folder_and_its_summary_names_it_there(
    handover: Any, writer: socket.socket
) -> None:
    folder = session(handover)
    # another recording, which begins as this one's name does
    (handover.RECORDINGS / "session_30.mcap").write_bytes(b"another")
    names = handover.hand_over(folder, writer)
    out = handover.OUT / "fig12-1"
    assert sorted(names) == ["logs/launcher.log", "session.mcap", "summary.json"]
    assert sorted(str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()) == sorted(names)
    assert (out / "session.mcap").read_bytes() == b"session_3.mcap" * 1000
    summary = json.loads((out / "summary.json").read_text())
    assert summary == {**SUMMARY, "recording": {"complete": True, "file": "out/fig12-1/session.mcap"}}


def test_a_recording_in_parts_keeps_their_order(handover: Any, writer: socket.socket) -> None:
    handover.hand_over(session(handover, parts=("session_9.mcap", "session_10.mcap")), writer)
    out = handover.OUT / "fig12-1"
    assert (out / "session.mcap").read_bytes().startswith(b"session_9")
    assert (out / "session_1.mcap").read_bytes().startswith(b"session_10")


def test_output_names_files_as_they_are_called_on_the_machine(handover: Any) -> None:
    folder = session(handover)
    recordings = handover.RECORDINGS
    line = f"view {recordings}/session_3.mcap {recordings}/session_30.mcap: {folder}/fig12.png\n"
    expected = f"view out/fig12-1/session.mcap {recordings}/session_30.mcap: out/fig12-1/fig12.png\n"
    assert handover.in_out(line, [folder]) == expected
    # the command runs in the folder of recordings, and shortens what lies in it
    assert handover.in_out(line.replace(f"{recordings}/", ""), [folder]) == (
        "view out/fig12-1/session.mcap session_30.mcap: out/fig12-1/fig12.png\n"
    )


def test_a_folder_that_cannot_be_written_is_an_error_with_its_reason(handover: Any, writer: socket.socket) -> None:
    folder = session(handover)
    (handover.OUT / folder.name).write_text("a file in the way")
    with pytest.raises(OSError, match=r"File exists|Not a directory"):
        handover.hand_over(folder, writer)
    # the writer serves the next session all the same
    assert handover.hand_over(session(handover, "fig12-2"), writer)


def test_a_writer_that_has_ended_is_an_error(handover: Any) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    theirs.close()
    with ours, pytest.raises(OSError, match=r"Broken pipe|has ended"):
        handover.hand_over(session(handover), ours)


@pytest.mark.parametrize("name", ["../stolen", "/tmp/stolen", "a/../../stolen"])
def test_no_file_is_written_elsewhere_nor_over_another(handover: Any, tmp_path: Path, name: str) -> None:
    source = tmp_path / "source"
    source.write_text("x")
    with source.open("rb") as file, pytest.raises(OSError, match="is not in the folder"):
        handover.write_one(file, handover.OUT, Path(name))
    (handover.OUT / "kept").write_text("mine")
    with source.open("rb") as file, pytest.raises(FileExistsError):
        handover.write_one(file, handover.OUT, Path("kept"))
    assert (handover.OUT / "kept").read_text() == "mine"


class FullDisk(io.BytesIO):
    """A source after whose first bytes there is no room left."""

    def read(self, size: int | None = -1) -> bytes:
        if self.tell():
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().read(3)


def test_a_file_for_which_there_is_no_room_is_not_left_half(handover: Any) -> None:
    with pytest.raises(OSError, match="No space left"):
        handover.write_one(FullDisk(b"recording"), handover.OUT, Path("fig12-1/session.mcap"))
    assert list((handover.OUT / "fig12-1").iterdir()) == []


@pytest.mark.parametrize("text", ["", '{"recording": ', '{"recording": {}}', "[]", '{"recording": {"file": 3}}'])
def test_a_half_written_summary_is_handed_over_as_it_is(handover: Any, writer: socket.socket, text: str) -> None:
    folder = session(handover)
    (folder / "summary.json").write_text(text)
    assert handover.in_out(f"{folder}/x\n", [folder]) == "out/fig12-1/x\n"
    assert handover.hand_over(folder, writer) == ["logs/launcher.log", "summary.json"]
    assert (handover.OUT / "fig12-1" / "summary.json").read_text() == text


def test_results_belong_to_who_has_out_else_to_who_has_the_project(handover: Any, tmp_path: Path) -> None:
    out, project = tmp_path / "out", tmp_path / "compose.yaml"
    project.touch()
    if os.geteuid() != 0:
        assert handover.owner_of_results(out, project) == (os.getuid(), out.stat().st_gid)
        return
    assert handover.owner_of_results(out, project) == (0, 0)
    # a folder that the engine made, in the project of a user
    os.chown(project, 12345, 12346)
    assert handover.owner_of_results(out, project) == (12345, 12346)
    assert (out.stat().st_uid, out.stat().st_gid) == (12345, 12346)
    # a folder that is somebody's stays that, whoever has the project
    os.chown(out, 12347, 12348)
    assert handover.owner_of_results(out, project) == (12347, 12348)
    assert (out.stat().st_uid, out.stat().st_gid) == (12347, 12348)


LEAVES = """
import json, pathlib, sys
recordings = pathlib.Path({recordings!r})
folder = recordings / "sessions" / "fig12-7"
folder.mkdir(parents=True)
(recordings / "session_7.mcap").write_bytes(b"mcap")
recording = {{"file": str(recordings / "session_7.mcap")}}
(folder / "summary.json").write_text(json.dumps({{"recording": recording}}))
print("the recording is", recordings / "session_7.mcap")
print("next: `telenano view", recordings / "session_7.mcap")
sys.exit(3)
"""


def test_a_session_keeps_its_exit_code_and_ends_with_its_files_and_the_page(
    handover: Any, writer: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    script = tmp_path / "entrypoint.py"
    script.write_text(LEAVES.format(recordings=str(handover.RECORDINGS)))
    monkeypatch.setattr(handover, "ENTRYPOINT", script)
    # of an earlier session, which is there already
    session(handover, "fig12-earlier")
    (handover.RUNTIME / "view-8650.addresses").write_text("operator: http://127.0.0.1:8650/#token\nobserver: x\n")
    assert handover.run_session(["telenano", "up"], writer) == 3
    assert capsys.readouterr().out.splitlines() == [
        "the recording is out/fig12-7/session.mcap",
        "./out/fig12-7 has summary.json, session.mcap",
        f"page: http://127.0.0.1:8650/; `{handover.ADDRESSES}` prints the address with its token",
        handover.NEXT,
    ]
    assert [path.name for path in handover.OUT.iterdir()] == ["fig12-7"]


def test_a_session_whose_files_cannot_be_handed_over_says_where_they_are_and_fails(
    handover: Any, writer: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    script = tmp_path / "entrypoint.py"
    script.write_text(LEAVES.format(recordings=str(handover.RECORDINGS)).replace("sys.exit(3)", ""))
    monkeypatch.setattr(handover, "ENTRYPOINT", script)
    (handover.OUT / "fig12-7").write_text("a file in the way")
    assert handover.run_session(["telenano", "up"], writer) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("./out/fig12-7 cannot be written: ")
    assert "in the volume of recordings, in sessions/fig12-7" in lines[1]
    assert lines[2] == "page: none is served; the log of viz_node says why"


def test_the_end_of_the_container_reaches_the_session_whose_report_is_still_handed_over(
    handover: Any, writer: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    script = tmp_path / "entrypoint.py"
    waits = "import os, signal\nsignal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})\n"
    asks = "os.kill(os.getppid(), signal.SIGTERM)\nassert signal.sigtimedwait({signal.SIGTERM}, 30.0)\n"
    script.write_text(f"{waits}{asks}{LEAVES.format(recordings=str(handover.RECORDINGS))}")
    monkeypatch.setattr(handover, "ENTRYPOINT", script)
    assert handover.run_session(["telenano", "up"], writer) == 3
    assert "./out/fig12-7 has summary.json, session.mcap" in capsys.readouterr().out


def test_any_other_command_takes_the_place_of_the_entry_point(handover: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    run: list[list[str]] = []

    def become(command: list[str]) -> None:
        run.append(command)
        raise SystemExit(0)

    monkeypatch.setattr(handover, "become_user", lambda: None)
    monkeypatch.setattr(handover.children, "become", become)
    with pytest.raises(SystemExit):
        handover.main(["telenano", "bag", "info", "x.mcap"])
    assert run == [[sys.executable, "/opt/entrypoint.py", "telenano", "bag", "info", "x.mcap"]]
