"""Messages of a recording are the same however the chunks that may have them are found, and whatever is damaged."""

import contextlib
import random
import shutil
import struct
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from made_sessions import Made
from mcap.opcode import Opcode
from mcap.reader import make_reader

from telenano.recording import reader
from telenano.recording.messages import RecordedChannel
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.wire.errors import RecordingError

# The share of its longer tests that is in `make check` where the change touches none of these folders.
pytestmark = pytest.mark.drawn(0.5, "telenano/recording/")

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
    folder = tmp_path_factory.mktemp("chunks")
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


def walked(path: Path) -> Recording:
    """Return a recording no chunk of which is left out."""
    recording = Recording(path)
    recording._layout.is_index_sound = False
    return recording


def records(path: Path) -> list[tuple[int, int]]:
    """Return opcode and place of each record outside of the chunks of a sound file."""
    data, place, found = path.read_bytes(), 8, []
    while place < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, place)
        found.append((opcode, place))
        place += 9 + length
    return found


def messages_by_mcap(path: Path) -> Counter[tuple[str, int, int, int, bytes]]:
    """Return the messages as the reader of the package `mcap` has them."""
    with path.open("rb") as file:
        return Counter(
            (channel.topic, message.log_time, message.publish_time, message.sequence, message.data)
            for _, channel, message in make_reader(file).iter_messages()
        )


@pytest.mark.check("takes 2 s")
def test_every_selection_of_messages_is_that_of_a_walk(path: Path) -> None:
    whole, found = walked(path), Recording(path)
    begin_ns, end_ns = whole.span_ns
    middle_ns = (begin_ns + end_ns) // 2
    for wanted in WANTED:
        for bounds in ((None, None), (middle_ns, None), (middle_ns, middle_ns + 10**9), (end_ns + 1, None)):
            assert list(found.select(wanted, *bounds)) == list(whole.select(wanted, *bounds))
        assert found.newest_before(middle_ns, wanted) == whole.newest_before(middle_ns, wanted)
    assert list(found.raw()) == list(whole.raw())
    assert found.info() == whole.info()


def test_the_reader_of_the_package_has_the_same_messages(path: Path) -> None:
    rows = ((one.channel_topic, one.log_ns, one.publish_ns, one.seq, one.payload) for one in Recording(path).messages())
    assert Counter(rows) == messages_by_mcap(path)


def test_a_file_is_opened_once_whatever_is_read_of_it(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []
    inside = reader.open_regular
    monkeypatch.setattr(reader, "open_regular", lambda one: opened.append(one) or inside(one))
    recording = open_recordings([path])
    recording.info()
    recording.columns("afm/state", ("t_ns",))
    assert recording.channels
    assert opened == [path]


def test_a_file_that_another_one_replaces_is_read_on(path: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copy(path, tmp_path / "session.mcap"))
    recording = Recording(copy)
    (tmp_path / "other").write_bytes(b"no recording")
    (tmp_path / "other").replace(copy)
    assert list(recording.messages()) == list(Recording(path).messages())


def test_chunks_without_what_is_wanted_are_not_unpacked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording, unpacked = Recording(path), []
    inside = Recording._content
    monkeypatch.setattr(Recording, "_content", lambda *given: unpacked.append(given) or inside(*given))
    events = list(recording.select(lambda channel: channel.topic == "session/event"))
    assert [event.fields()["text"] for event in events if event.src == "launcher@slave"] == ["first", "second"]
    # no more than one for each event
    assert len(unpacked) <= len(events) < len(recording._layout.blocks)


def damaged(path: Path, folder: Path, place: int, data: bytes) -> Path:
    """Return a copy of a file that has other bytes at a place."""
    copy = Path(shutil.copy(path, folder / "damaged.mcap"))
    with copy.open("r+b") as file:
        file.seek(place)
        file.write(data)
    return copy


@pytest.mark.check("takes 3 s")
def test_an_index_of_messages_that_is_wrong_costs_no_message(path: Path, tmp_path: Path) -> None:
    dice = random.Random(11)
    indexes = [place for opcode, place in records(path) if opcode == Opcode.MESSAGE_INDEX]
    recording = Recording(path)
    whole = {wanted: list(recording.select(wanted)) for wanted in WANTED}
    for case in range(24):
        place = dice.choice(indexes)
        # its number, its size, a place that it names, and that of a whole entry
        offset, new = dice.choice(
            (
                (9, struct.pack("<H", dice.choice((0, 1, 2, 60_000)))),
                (11, struct.pack("<I", dice.randrange(0, 200, 16))),
                (9 + 6 + 8, struct.pack("<Q", dice.choice((3, 2**63, 2**64 - 1, dice.randrange(9000))))),
                (9 + 6, dice.randbytes(16)),
                (0, b"\x00"),
            )
        )
        copy = damaged(path, tmp_path, place + offset, new)
        for wanted in WANTED:
            assert list(Recording(copy).select(wanted)) == whole[wanted], (case, place, offset, new)


def test_a_damaged_chunk_is_left_out(path: Path, tmp_path: Path) -> None:
    block = Recording(path)._layout.blocks[20]
    copy = damaged(path, tmp_path, block.data_start + 30, b"damage")
    found = list(Recording(copy).select())
    assert found == list(walked(copy).select())
    assert 0 < len(found) < len(list(Recording(path).select()))


@pytest.mark.parametrize("cut", ["summary", "unfinished"])
def test_a_file_without_a_sound_summary_is_read_as_a_whole(path: Path, tmp_path: Path, cut: str) -> None:
    size = path.stat().st_size
    copy = damaged(path, tmp_path, size - 60, b"\x55") if cut == "summary" else Path(tmp_path / "cut.mcap")
    if cut == "unfinished":
        copy.write_bytes(path.read_bytes()[: size // 2])
    found, whole = Recording(copy), walked(copy)
    assert not found._layout.is_index_sound
    assert list(found.select()) == list(whole.select())
    assert found.info() == whole.info()


def test_a_recording_that_is_being_written_is_read_as_far_as_it_is(path: Path, tmp_path: Path) -> None:
    source = Recording(path)
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path, chunk_size_bytes=8192))
    numbers: dict[RecordedChannel, int] = {}
    written = []
    for message in source.select():
        found = message.channel
        if found not in numbers:
            numbers[found] = writer.channel(found.topic, found.src, found.site)
        writer.write(numbers[found], message.log_ns, message.publish_ns, message.seq, message.payload)
        written.append(message[1:])
        if len(written) % 1500 == 0:
            writer.flush()
            assert [one[1:] for one in Recording(writer.path).select()] == written
    writer.finish()
    assert [one[1:] for one in Recording(writer.path).select()] == written


def test_the_information_shows_each_message_once_in_the_order_of_the_file(path: Path) -> None:
    seen: list[Any] = []
    assert Recording(path).info(seen.append) == Recording(path).info()
    assert seen == list(Recording(path).messages())


def test_parts_are_read_as_one(path: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="missing"):
        open_recordings([path, tmp_path / "missing.mcap"])
    assert list(open_recordings([path, path]).select()) == list(Recording(path).select())


@pytest.mark.check("takes 1.8 s")
def test_a_forged_summary_ends_in_nothing_but_what_a_person_can_read(path: Path, tmp_path: Path) -> None:
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
            found = Recording(forged)
            assert sum(1 for _ in found.select(WANTED[1])) <= 2000
            found.newest_before(found.span_ns[1])
            assert found.info().messages >= 0
