"""A recording as a document: what a page draws of it is what is in it, at every width."""

import math
import os
import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forged_files import copied, wide_index
from made_sessions import Made

from services.viz_node import document as document_module
from services.viz_node import level_cache
from services.viz_node.document import RecordingDocument
from services.viz_node.level_cache import LevelCache
from services.viz_node.levels import Levels
from services.viz_node.streams import STREAMS
from telenano.recording.reader import Recording
from telenano.wire.errors import RefusedError

FORCE = [column.name for column in STREAMS[2].columns].index("force")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Return eight seconds of a session in which the tip is drawn to the sample for a moment."""
    made = Made(tip_n=lambda time_s: -1.25 if 1.0 <= time_s < 1.01 else math.sin(time_s))
    folder = tmp_path_factory.mktemp("document")
    return Recording(copied(made.write(folder), folder / "chunks.mcap"))


@pytest.fixture(scope="module")
def document(whole: Recording) -> RecordingDocument:
    found = RecordingDocument(whole)
    found.wait()
    return found


@pytest.fixture(scope="module")
def forces_n(whole: Recording) -> Any:
    return whole.columns("afm/state", ("tip_force_n.2",))["tip_force_n.2"].astype(np.float64)


def samples(part: Any, name: str) -> tuple[Any, Any]:
    """Return times [s] and columns of what a page is sent."""
    stream = part["streams"][name]
    numbers = np.frombuffer(stream["data"], "<f4").reshape(-1, stream["n"]).astype(np.float64)
    return stream["t0"] + numbers[0], numbers[1:]


def test_no_spike_disappears_however_wide_a_span_is(document: RecordingDocument, forces_n: Any) -> None:
    length_s = document.about()["length_s"]
    for spans in (1, 7, 100, 4000):
        # longer than what is read from the file
        _, values = samples(document.part(-10.0, length_s + 10.0, spans), "tip")
        found = (np.nanmin(values[FORCE]), np.nanmax(values[FORCE]))
        assert found == pytest.approx((forces_n.min(), forces_n.max()), rel=1e-6)


def test_a_short_part_has_every_sample(document: RecordingDocument, forces_n: Any) -> None:
    length_s = document.about()["length_s"]
    part = document.part(0.0, length_s, 0)
    times, values = samples(part, "tip")
    assert part["width_s"] == 0.0
    assert np.all(np.diff(times) >= 0.0)
    # both ends may cut off what was sent before the recorder began and after it ended
    assert len(times) == pytest.approx(len(forces_n), abs=20)
    assert set(values[FORCE]) <= set(forces_n.astype("<f4").astype(np.float64))


def test_what_cannot_be_a_part_is_refused_in_words(document: RecordingDocument) -> None:
    with pytest.raises(RefusedError, match="not a part of a recording"):
        document.part(2.0, 1.0, 100)
    with pytest.raises(RefusedError, match="choose a shorter part"):
        document.part(0.0, 1e4, 0)


def test_levels_of_an_hour_are_bounded_and_keep_a_single_sample() -> None:
    levels = Levels(3600.0)
    times = np.arange(0.0, 3600.0, 0.1)
    values = np.zeros((8, times.size))
    values[2, 12345] = 7.0
    levels.add("tip", times, values)
    found_s, found, width_s = levels.between("tip", 0.0, 3600.0, 500)
    assert found_s.size <= 2 * 501
    assert width_s >= 3600.0 / 501
    at_s = found_s[int(np.argmax(found[2]))]
    assert abs(at_s - times[12345]) <= width_s
    assert found[2].max() == 7.0
    # a column without a number in a span has none there
    values[:] = math.nan
    empty = Levels(10.0)
    empty.add("tip", times[:100], values[:, :100])
    assert empty.between("tip", 0.0, 10.0, 10)[0].size == 0


def test_a_part_before_the_first_message_has_no_samples(document: RecordingDocument) -> None:
    streams = document.part(-2.0, -1.0, 0)["streams"]
    assert all(stream["n"] == 0 for stream in streams.values())


@pytest.mark.check("reads a long recording")
@pytest.mark.parametrize("first_ns", [0, 2**63])
def test_no_piece_is_made_for_a_time_that_is_only_stated_and_each_chunk_is_read_once(
    whole: Recording, tmp_path: Path, first_ns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "wide.mcap"
    path.write_bytes(wide_index(whole.path.read_bytes(), first_ns, 2**64 - 2))
    read: list[int] = []
    inside = Recording._content
    monkeypatch.setattr(Recording, "_content", lambda *given: read.append(given[2].offset) or inside(*given))
    documents = [RecordingDocument(Recording(each)) for each in (whole.path, path)]
    counts = []
    for document in documents:
        read.clear()
        document.wait()
        counts.append(len(read))
        assert len(document._pieces) <= len(whole._layout.blocks)
    assert counts[1] <= 3 * counts[0]
    streams = [found.part(-1.0, 1e12, 10)["streams"] for found in documents]
    assert all(streams[0][name]["n"] > 0 and streams[1][name]["n"] > 0 for name in ("hand", "tip"))


def test_what_goes_wrong_in_the_judgement_is_said_and_the_curves_stay(whole: Recording) -> None:
    def broken() -> dict[str, Any]:
        raise RefusedError("no programme ran")

    document = RecordingDocument(whole, broken)
    document.wait()
    about = document.about()
    assert (about["read"], about["fault"]) == (1.0, "no programme ran")
    assert document.part(0.0, about["length_s"] + 5.0, 10)["streams"]["tip"]["n"] > 0


def test_a_long_recording_has_an_outline_before_it_is_read(whole: Recording) -> None:
    document = RecordingDocument(whole)
    document._outline()
    length_s = document._length_s
    times, _ = samples(document.part(-2.0, length_s + 2.0, 100), "tip")
    # from one end to the other, although the most of it has not been read
    assert times[0] < 0.5 * length_s
    assert times[-1] > 0.8 * length_s


def filled(kept: Any = None, judge: Any = None, recording: Any = None) -> RecordingDocument:
    """Return a document of an hour-long kind, which may be kept, that was read."""
    found = RecordingDocument(recording, judge, kept)
    found._kept = kept
    found.wait()
    return found


def unread() -> dict[str, Any]:
    raise AssertionError("what was kept was read again")


@pytest.mark.check("takes 1.4 s")
def test_what_was_read_is_kept_and_a_damaged_or_stale_file_of_it_is_ignored(whole: Recording, tmp_path: Path) -> None:
    source = Path(shutil.copy(whole.path, tmp_path / "session.mcap"))
    recording, cache = Recording(source), LevelCache([source], tmp_path / "cache")
    first = filled(cache, lambda: {"summary": {"verdict": "stable"}}, recording)
    (file,) = (tmp_path / "cache").glob("*.levels")
    length_s = first.about()["length_s"]
    again = filled(cache, unread, recording)
    assert again.about() == first.about()
    assert again.about()["summary"] == {"verdict": "stable"}
    assert again.part(-1.0, length_s, 50) == first.part(-1.0, length_s, 50)
    # a damaged file, half a file and one of something else are as if they were not there
    sound = file.read_bytes()
    for wrong in (sound[:100] + bytes([sound[100] ^ 1]) + sound[101:], sound[: len(sound) // 2], b"", b"other"):
        file.write_bytes(wrong)
        read = filled(cache, lambda: {"summary": None}, recording)
        assert read.about()["summary"] is None
        assert read.part(-1.0, length_s, 50) == first.part(-1.0, length_s, 50)
        file.write_bytes(sound)
    # and so is what was kept of the recording before it was changed
    os.utime(source, ns=(1, 1))
    assert filled(cache, lambda: {"summary": "new"}, recording).about()["summary"] == "new"
    assert cache.load(Levels(2.0 * length_s)) is None


@pytest.mark.check("takes 0.9 s")
def test_a_cache_that_cannot_be_written_or_grows_too_large_is_no_hindrance(
    whole: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    assert filled(LevelCache([whole.path], tmp_path / "file" / "cache"), dict, whole).about()["read"] == 1.0
    folder = tmp_path / "cache"
    monkeypatch.setattr(level_cache, "_MOST_TOGETHER", 1)
    for n in range(3):
        source = Path(shutil.copy(whole.path, tmp_path / f"session{n}.mcap"))
        os.utime(source, ns=(n, n))
        filled(LevelCache([source], folder), dict, whole)
        assert len(list(folder.glob("*.levels"))) == 1


def test_a_part_that_is_asked_for_is_whole_before_the_rest_is_read(whole: Recording, forces_n: Any) -> None:
    document = RecordingDocument(whole)
    # as if the thread that reads everything had not come to it yet
    document._thread = threading.Thread()
    times, values = samples(document.part(4.1, 7.9, 100), "tip")
    assert document.about()["read"] < 0.9
    assert times[0] < 4.3
    assert times[-1] > 7.7
    all_times, all_values = samples(document.part(0.0, document.about()["length_s"], 0), "tip")
    inside = (all_times > 4.2) & (all_times < 7.8)
    assert np.nanmax(values[FORCE]) >= all_values[FORCE][inside].max() * (1.0 - 1e-6)


def test_the_loss_of_the_link_does_not_depend_on_the_pieces(whole: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = []
    for piece_s in (0.35, 100.0):
        monkeypatch.setattr(document_module, "_PIECE_S", piece_s)
        parts.append(filled(recording=whole).part(-1.0, 20.0, 500)["streams"])
    assert parts[0] == parts[1]


def test_a_verdict_that_was_kept_is_there_before_all_is_read_and_judged(whole: Recording) -> None:
    may_judge = threading.Event()

    def judge() -> dict[str, Any]:
        assert may_judge.wait(60.0)
        return {"summary": {"verdict": "stable"}, "phases": [{"kind": "apart", "from_s": 0.0, "to_s": 1.0}]}

    found = RecordingDocument(whole, judge, judged_before=lambda: {"summary": {"verdict": "stable"}})
    try:
        while "summary" not in (about := found.about()):
            pass
        assert about["summary"] == {"verdict": "stable"}
        assert about["read"] < 1.0
        assert "phases" not in about
    finally:
        may_judge.set()
    found.wait()
    assert found.about()["read"] == 1.0
    assert found.about()["phases"]
