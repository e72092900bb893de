"""The folder of a session: its own parts, and the list of what the other site recorded."""

import json
from pathlib import Path

import pytest

from telenano.recording.session_folder import SessionFolder
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.wire.errors import RecordingError


def test_the_parts_are_in_the_order_of_their_numbers_and_one_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for name in ("session_10.mcap", "session_2.mcap", "session.mcap", "session_x.mcap"):
        RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path, file_name=name)).finish()
    (tmp_path / "session_3.mcap").write_bytes(b"no recording")
    own, (fault,) = SessionFolder(tmp_path).own()
    assert [path.name for path in own] == ["session.mcap", "session_2.mcap", "session_10.mcap"]
    assert "session_3.mcap" in fault
    assert SessionFolder(tmp_path / "none").own() == ((), [])


@pytest.mark.parametrize(
    "text",
    ["", "{}", "[]", '{"files": [7]}', '{"files": ["/etc/passwd"]}', '{"files": ["../a.mcap"]}', '{"files": []}'],
)
def test_a_list_of_files_that_cannot_be_used_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "far.json").write_text(text)
    with pytest.raises(RecordingError, match=r"far\.json: "):
        SessionFolder(tmp_path).far()


def test_a_list_of_files_has_names_without_folders(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is missing: no session of two sites"):
        SessionFolder(tmp_path).far()
    SessionFolder(tmp_path).note_far(["/home/slave/a b/session_3.mcap", "/home/slave/a b/session_4.mcap"])
    assert SessionFolder(tmp_path).far() == ("session_3.mcap", "session_4.mcap")
    assert json.loads((tmp_path / "far.json").read_text()) == {"files": ["session_3.mcap", "session_4.mcap"]}
    SessionFolder(tmp_path / "no such folder").note_far(["session.mcap"])
    assert SessionFolder.parts(["session.mcap"], "x") == ("session.mcap",)
