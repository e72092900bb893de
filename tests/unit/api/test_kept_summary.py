"""What was judged of a recording is kept beside it, and counts for nothing else than it was judged of."""

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import telenano
from telenano.analysis import Session, kept_summary, session_judge
from telenano.analysis.kept_summary import KeptSummary, source_changed, source_digest
from telenano.wire.errors import RecordingError

# The share of its longer tests that is in `make check` where the change touches none of these folders.
pytestmark = pytest.mark.drawn(0.4, "telenano/api/", "telenano/analysis/")


@pytest.fixture
def recording(recording_of: Callable[[str], Path], tmp_path: Path) -> Path:
    path = tmp_path / "session.mcap"
    shutil.copy(recording_of("wave").resolve(), path)
    return path


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the names of the recordings that are judged from now on."""
    names: list[str] = []
    summary = session_judge.summary_of

    def counted(session: Session, source: Any, *further: Any) -> dict[str, Any]:
        names.append(source.path.name)
        return summary(session, source, *further)

    monkeypatch.setattr(session_judge, "summary_of", counted)
    return names


def all_of(session: telenano.RecordedSession) -> tuple[Any, ...]:
    return (
        session.summary, session.conditions, session.holds, session.verdict, session.reason,
        session.measured_round_trip_ms, session.start_ns,
    )  # fmt: skip


def test_a_recording_is_judged_once(recording: Path, judged: list[str]) -> None:
    first = telenano.open(recording)
    assert not first.is_judged
    found = all_of(first)
    again = telenano.open(recording)
    assert again.is_judged
    assert all_of(again) == found
    assert judged == ["session.mcap"]
    # nothing else was left there, and no other program takes it for a recording
    assert {path.name for path in recording.parent.iterdir()} == {"session.mcap", ".session.mcap.summary"}
    assert telenano.open(recording.parent).verdict == found[3]


@pytest.mark.check("takes 3 s")
def test_what_is_kept_is_read_in_a_small_part_of_the_time(recording: Path) -> None:
    def seconds() -> float:
        begin_s = time.perf_counter()
        assert telenano.open(recording).verdict
        return time.perf_counter() - begin_s

    kept_summary.judge_digest()
    telenano.open(recording).table("afm/state")
    first_s = seconds()
    assert min(seconds() for _ in range(3)) < 0.1 * first_s


def flipped(path: Path) -> None:
    """Change a byte in the middle of a file, and set its time back."""
    before = path.stat()
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


@pytest.mark.check("judges a recording twice")
def test_a_changed_byte_of_the_recording_is_judged_again(recording: Path, judged: list[str]) -> None:
    whole = telenano.open(recording).summary
    flipped(recording)
    damaged = telenano.open(recording)
    assert not damaged.is_judged
    assert damaged.summary["recording"] != whole["recording"]
    assert judged == ["session.mcap"] * 2


@pytest.mark.check("judges a recording twice")
def test_a_recording_that_changes_while_it_is_open_is_not_kept(recording: Path, judged: list[str]) -> None:
    opened = telenano.open(recording)
    flipped(recording)
    try:
        assert opened.verdict
    except RecordingError:
        pytest.skip("the damaged file cannot be read at all")
    assert not KeptSummary([recording]).path.exists()
    whole = telenano.open(recording)
    assert whole.summary
    flipped(recording)
    # what is kept now is that of other bytes than these
    assert not telenano.open(recording).is_judged


@pytest.mark.check("takes 8 s")
@pytest.mark.parametrize(
    "damage",
    [
        pytest.param(lambda content: b"", id="empty"),
        pytest.param(lambda content: content[: len(content) // 2], id="cut off"),
        pytest.param(lambda content: content.replace(b"1.0", b"7.0"), id="another number"),
        pytest.param(lambda content: content + b" ", id="longer"),
        pytest.param(lambda content: b"\xff\x00" * 1000, id="no text"),
        pytest.param(lambda content: bytes(kept_summary.MOST_BYTES + 1), id="too large"),
    ],
)
def test_what_is_damaged_is_judged_again(recording: Path, judged: list[str], damage: Callable[[bytes], bytes]) -> None:
    found = all_of(telenano.open(recording))
    kept = KeptSummary([recording]).path
    content = kept.read_bytes()
    assert damage(content) != content
    kept.write_bytes(damage(content))
    assert all_of(telenano.open(recording)) == found
    assert judged == ["session.mcap"] * 2
    assert kept.read_bytes() == content


@pytest.mark.check("takes 3 s")
@pytest.mark.parametrize("place", ["folder", "link", "pipe"])
def test_what_is_no_file_is_not_read(recording: Path, place: str) -> None:
    kept = KeptSummary([recording]).path
    if place == "folder":
        kept.mkdir()
    elif place == "link":
        kept.symlink_to("/dev/zero")
    else:
        os.mkfifo(kept)
    assert telenano.open(recording).verdict


@pytest.mark.check("judges a recording twice")
def test_another_judge_judges_again(recording: Path, judged: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    assert telenano.open(recording).verdict
    monkeypatch.setattr(kept_summary, "judge_digest", lambda: "another")
    assert telenano.open(recording).verdict
    assert judged == ["session.mcap"] * 2


def test_other_options_are_another_summary(recording: Path) -> None:
    first = KeptSummary([recording], {"same_session": True})
    assert first.read() is None
    first.write({"a": 1})
    assert KeptSummary([recording], {"same_session": True}).read() == {"a": 1}
    assert KeptSummary([recording], {"same_session": False}).read() is None
    assert KeptSummary([recording]).read() is None


def test_any_edit_of_the_source_is_another_judge(tmp_path: Path) -> None:
    library = tmp_path / "library"
    (library / "room").mkdir(parents=True)
    (library / "room" / "a.py").write_text("x = 1\n")
    (library / "networks.yaml").write_text("lte: 1\n")
    digests = [source_digest(library)]

    def edit(name: str, text: str) -> None:
        (library / name).write_text(text)
        digests.append(source_digest(library))

    edit("room/a.py", "x = 2\n")
    edit("networks.yaml", "lte: 2\n")
    edit("room/b.py", "")
    (library / "room" / "b.py").rename(library / "room" / "c.py")
    digests.append(source_digest(library))
    assert None not in digests and len(set(digests)) == len(digests)
    before = source_digest(library)
    edit("room/notes.pyc", "no source")
    assert digests[-1] == before
    assert source_digest(tmp_path / "none") is None


def test_a_process_whose_source_was_changed_keeps_nothing(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = tmp_path / "library"
    library.mkdir()
    source = library / "a.py"
    source.write_text("x = 1\n")
    loaded_ns = max(source.stat().st_ctime_ns, source.stat().st_mtime_ns)
    assert not source_changed([source], loaded_ns)
    monkeypatch.setattr(kept_summary, "_LIBRARY", library)
    monkeypatch.setattr(kept_summary, "_LOADED_NS", loaded_ns)
    kept = KeptSummary([recording])
    assert kept.read() is None
    # so that the clock of the file system has moved on
    while source.stat().st_ctime_ns <= loaded_ns:
        source.write_text("x = 2\n")
    os.utime(source, ns=(1, 1))
    assert source_changed([source], loaded_ns)
    kept.write({"a": 1})
    assert not kept.path.exists()


@pytest.mark.check("judges a recording twice")
def test_a_folder_that_cannot_be_written_keeps_nothing(
    recording: Path, judged: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(kept_summary, "write_whole", refused)
    assert [telenano.open(recording).verdict for _ in range(2)]
    assert judged == ["session.mcap"] * 2
    assert not KeptSummary([recording]).path.exists()


def test_a_recording_that_was_moved_with_what_is_kept_names_its_new_place(recording: Path, judged: list[str]) -> None:
    assert telenano.open(recording).verdict
    moved = recording.parent.rename(recording.parent.with_name("moved"))
    found = telenano.open(moved).summary
    assert found["recording"]["file"] == str(moved / "session.mcap")
    assert judged == ["session.mcap"]


@pytest.mark.check("judges a recording twice")
def test_the_recording_of_the_library_is_not_written_beside() -> None:
    from telenano.settings import DEMO_RECORDING

    assert telenano.open(DEMO_RECORDING).verdict == "stable"
    assert not KeptSummary([DEMO_RECORDING]).path.exists()


@pytest.mark.check("takes 2 s")
def test_what_was_read_before_is_no_part_of_the_account(recording: Path) -> None:
    flipped(recording)
    first = telenano.open(recording)
    for channel in first.channels:
        first.table(channel, "*")
    before = first.summary
    KeptSummary([recording]).path.unlink()
    assert telenano.open(recording).summary == before
