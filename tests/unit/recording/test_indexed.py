"""A recording that is read by its index has what one has that is read from one end to the other."""

import contextlib
import random
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from made_sessions import Made

from telenano.recording.indexed import IndexedRecording
from telenano.recording.messages import RecordedChannel
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.summary_section import channels_in
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.wire.errors import RecordingError

Wanted = Callable[[RecordedChannel], bool]
WANTED: tuple[Wanted | None, ...] = (
    None,
    lambda channel: channel.topic == "afm/state",
    lambda channel: channel.topic == "session/event",
    lambda channel: channel.topic in ("haptic/state", "link/status"),
    lambda channel: False,
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a session in many chunks, with an event in the first and in one of the last."""
    folder = tmp_path_factory.mktemp("indexed")
    whole = Recording(Made(incidents=((0.1, "first"), (7.0, "second"))).write(folder))
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder / "chunks", chunk_size_bytes=8192))
    numbers: dict[RecordedChannel, int] = {}
    for message in whole.select():
        found = message.channel
        if found not in numbers:
            numbers[found] = writer.channel(found.topic, found.src, found.site)
        writer.write(numbers[found], message.log_ns, message.publish_ns, message.seq, message.payload)
    for name, data in whole.attachments.items():
        writer.attach(name, "application/yaml", data, 0)
    writer.add_metadata("recording", {"node": "recorder@master"})
    writer.finish()
    assert len(Recording(writer.path)._layout.blocks) > 50
    return writer.path


def test_every_selection_of_messages_is_the_same(path: Path) -> None:
    whole, indexed = Recording(path), IndexedRecording(path)
    begin_ns, end_ns = whole.span_ns
    middle_ns = (begin_ns + end_ns) // 2
    assert indexed.span_ns == whole.span_ns
    assert indexed.channels == whole.channels
    assert (indexed.attachments, indexed.metadata) == (whole.attachments, whole.metadata)
    for wanted in WANTED:
        for bounds in ((None, None), (middle_ns, None), (middle_ns, middle_ns + 10**9), (end_ns + 1, None)):
            assert list(indexed.select(wanted, *bounds)) == list(whole.select(wanted, *bounds))
        assert indexed.newest_before(middle_ns, wanted) == whole.newest_before(middle_ns, wanted)


def test_chunks_without_what_is_wanted_are_not_unpacked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    indexed, unpacked = IndexedRecording(path), []
    inside = IndexedRecording._content
    monkeypatch.setattr(IndexedRecording, "_content", lambda *given: unpacked.append(given) or inside(*given))
    events = list(indexed.select(lambda channel: channel.topic == "session/event"))
    assert [event.fields()["text"] for event in events if event.src == "launcher@slave"] == ["first", "second"]
    # no more than one for each event
    assert len(unpacked) <= len(events) < len(indexed._layout.blocks)


def damaged(path: Path, folder: Path, place: int, data: bytes) -> Path:
    """Return a copy of a file that has other bytes at a place."""
    copy = Path(shutil.copy(path, folder / "damaged.mcap"))
    with copy.open("r+b") as file:
        file.seek(place)
        file.write(data)
    return copy


@pytest.mark.check("takes 1.0 s")
def test_an_index_of_messages_that_is_wrong_costs_no_message(path: Path, tmp_path: Path) -> None:
    indexed = IndexedRecording(path)
    block = indexed._layout.blocks[20]
    number, place = min(channels_in(indexed._indexes[block.offset]).items())
    for at, data in ((place, b"\x00"), (place + 9 + 6 + 8, struct.pack("<Q", 3)), (place + 9 + 6 + 8, b"\xff" * 8)):
        copy = damaged(path, tmp_path, at, data)
        assert IndexedRecording(copy)._indexes
        for wanted in WANTED:
            assert list(IndexedRecording(copy).select(wanted)) == list(Recording(path).select(wanted))
    assert number > 0


def test_a_damaged_chunk_is_left_out_as_ever(path: Path, tmp_path: Path) -> None:
    block = Recording(path)._layout.blocks[20]
    copy = damaged(path, tmp_path, block.data_start + 30, b"damage")
    found = list(IndexedRecording(copy).select())
    assert found == list(Recording(copy).select())
    assert 0 < len(found) < len(list(Recording(path).select()))


@pytest.mark.parametrize("cut", ["summary", "unfinished"])
def test_a_file_without_a_sound_index_is_read_as_a_whole(path: Path, tmp_path: Path, cut: str) -> None:
    size = path.stat().st_size
    copy = damaged(path, tmp_path, size - 60, b"\x55") if cut == "summary" else Path(tmp_path / "cut.mcap")
    if cut == "unfinished":
        copy.write_bytes(path.read_bytes()[: size // 2])
    indexed = IndexedRecording(copy)
    assert indexed._indexes == {}
    assert list(indexed.select()) == list(Recording(copy).select())
    assert indexed.info() == Recording(copy).info()


def test_the_information_of_a_sound_file_comes_by_its_index(path: Path) -> None:
    info: Any = IndexedRecording(path).info()
    assert (info.basis, info.messages) == ("summary", Recording(path).info().messages)


@pytest.mark.parametrize("opened", [Recording, IndexedRecording])
def test_the_information_shows_each_message_once_in_the_order_of_the_file(path: Path, opened: type[Recording]) -> None:
    seen: list[Any] = []
    assert opened(path).info(seen.append) == opened(path).info()
    assert seen == list(Recording(path).messages())


def test_parts_are_read_as_one(path: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="missing"):
        open_recordings([path, tmp_path / "missing.mcap"], by_index=True)
    assert list(open_recordings([path, path], by_index=True).select()) == list(Recording(path).select())


@pytest.mark.check("takes 1.8 s")
def test_a_forged_index_ends_in_nothing_but_what_a_person_can_read(path: Path, tmp_path: Path) -> None:
    sound = path.read_bytes()
    footer = len(sound) - 8 - 29
    (begin,) = struct.unpack_from("<Q", sound, footer + 9)
    dice = random.Random(7)
    forged = tmp_path / "forged.mcap"
    for _ in range(40):
        data = bytearray(sound)
        for _ in range(dice.choice((1, 2, 8))):
            data[dice.randrange(begin, footer)] = dice.choice((0, 255, dice.randrange(256)))
        struct.pack_into("<I", data, footer + 25, zlib.crc32(bytes(data[begin : footer + 25])))
        forged.write_bytes(data)
        with contextlib.suppress(RecordingError):
            indexed = IndexedRecording(forged)
            assert sum(1 for _ in indexed.select(WANTED[1])) <= 2000
            indexed.newest_before(indexed.span_ns[1])
            assert indexed.info().messages >= 0
