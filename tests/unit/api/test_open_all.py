"""Many recordings as one table: a row for each hold, with what was set."""

import io
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import telenano
from telenano.testing import hand_recording
from telenano.wire.errors import ConfigError, NoRecordingError

LAWS = ("wave", "virtual_impedance")


@pytest.fixture(scope="module")
def judged(recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a recording of each law in a folder of its own, and with what was judged of it."""
    folder = tmp_path_factory.mktemp("judged")
    for law in LAWS:
        (folder / law).mkdir()
        shutil.copy(recording_of(law).resolve(), folder / law / "session.mcap")
        (folder / law / "summary.json").write_text("{}")
    telenano.open_all(f"{folder}/*")
    return folder


@pytest.fixture
def folder(judged: Path, tmp_path: Path) -> Path:
    """Return a copy of that folder, with a figure and an empty folder."""
    shutil.copytree(judged, tmp_path, dirs_exist_ok=True)
    (tmp_path / "figure.png").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    return tmp_path


@pytest.fixture
def unjudged(folder: Path) -> Path:
    """Return that folder without what was judged."""
    for law in LAWS:
        (folder / law / ".session.mcap.summary").unlink()
    return folder


def test_a_table_has_a_row_for_each_hold_and_what_was_set(folder: Path) -> None:
    frame = telenano.open_all(f"{folder}/*")
    sessions = {law: telenano.open(folder / law) for law in LAWS}
    assert len(frame) == sum(max(1, len(session.holds)) for session in sessions.values())
    for law, session in sessions.items():
        rows = frame[frame["law"] == law]
        assert set(rows["round_trip_ms"]) == {session.conditions.round_trip_ms}
        assert set(rows["session_verdict"]) == {session.verdict}
        held = rows.dropna(subset=["start_s"])
        assert held["start_s"].tolist() == [hold.start_s for hold in session.holds]
        assert held["verdict"].tolist() == [hold.verdict for hold in session.holds]
        assert held["hold"].tolist() == list(range(len(session.holds)))
    # a parameter is that of the law that has it
    assert frame.groupby("law")["force_gain"].count().to_dict() == {"virtual_impedance": 1, "wave": 0}


def test_no_recording_is_in_it_twice(folder: Path) -> None:
    once = telenano.open_all(f"{folder}/*/session.mcap")
    assert len(telenano.open_all(f"{folder}/**")) == len(once)
    (folder / "again.mcap").symlink_to(folder / "wave" / "session.mcap")
    assert len(telenano.open_all(f"{folder}/**")) == len(once)
    assert len(telenano.open_all([folder / law for law in LAWS])) == len(once)
    # two recordings of a folder that are named themselves are two
    shutil.copy(hand_recording(folder / "hand", 50), folder / "wave" / "other.mcap")
    shutil.rmtree(folder / "hand")
    assert set(telenano.open_all(f"{folder}/**")["file"]) == {
        str(folder / name)
        for name in ("again.mcap", "virtual_impedance/session.mcap", "wave/other.mcap", "wave/session.mcap")
    } - {str(folder / "wave" / "session.mcap")}


def test_what_cannot_be_judged_has_a_row_with_the_reason(folder: Path) -> None:
    made = hand_recording(folder / "hand", 50)
    (folder / "bad.mcap").write_bytes(b"no recording")
    (folder / "two").mkdir()
    for name in ("a.mcap", "b.mcap"):
        shutil.copy(made, folder / "two" / name)
    frame = telenano.open_all(f"{folder}/*").set_index("file")
    reasons = frame["session_reason"]
    assert "no scenario attached" in reasons[str(made)]
    assert "bad.mcap" in reasons[str(folder / "bad.mcap")]
    assert "2 recordings" in reasons[str(folder / "two")]
    assert frame.loc[[str(made), str(folder / "bad.mcap")], "session_verdict"].isna().all()
    assert frame["session_verdict"].notna().sum() >= len(LAWS)


def test_columns_are_numbers_whatever_is_in_it(folder: Path) -> None:
    hand_recording(folder / "hand", 50)
    alone = telenano.open_all(f"{folder}/hand")
    many = telenano.open_all(f"{folder}/*")
    assert set(alone) <= set(many)
    assert {str(frame[name].dtype) for frame in (alone, many) for name in ("start_s", "hold_ratio")} == {"float64"}


def test_nothing_found_is_an_error_that_names_the_pattern(tmp_path: Path) -> None:
    with pytest.raises(NoRecordingError, match=r"none\*: no recording \(\.mcap\) and no folder with one"):
        telenano.open_all(f"{tmp_path}/none*")


def test_without_pandas_its_absence_is_named(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ConfigError, match=r"pandas is not installed: pip install"):
        telenano.open_all(f"{folder}/*")


@pytest.mark.check("takes 4 s")
def test_a_bar_counts_the_new_ones_and_is_seen_on_a_terminal_alone(
    unjudged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    shown = []
    for kind in (io.StringIO, Terminal, Terminal):
        stream = kind()
        monkeypatch.setattr(sys, "stderr", stream)
        monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
        telenano.open_all(f"{unjudged}/*")
        shown.append(stream.getvalue())
        if len(shown) == 1:
            for law in LAWS:
                (unjudged / law / ".session.mcap.summary").unlink()
    # of those that are kept there is nothing to wait for
    assert (shown[0], shown[2]) == ("", "")
    assert "0 of 2" in shown[1] and shown[1].endswith("2 of 2\n")


@pytest.mark.check("takes 4 s")
def test_kept_recordings_take_a_small_part_of_the_time(unjudged: Path) -> None:
    def seconds() -> float:
        begin_s = time.perf_counter()
        telenano.open_all(f"{unjudged}/*")
        return time.perf_counter() - begin_s

    hand_recording(unjudged / "hand", 50)
    telenano.open_all(f"{unjudged}/hand")
    shutil.rmtree(unjudged / "hand")
    first_s = seconds()
    assert min(seconds() for _ in range(3)) < 0.2 * first_s
