"""Copies of recordings, their check, and their comparison."""

import random
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample
from telenano_lab.studies.recording_diff import diff_recordings

from telenano.recording.channel_filter import Selection
from telenano.recording.field_differences import Tolerances
from telenano.recording.mcap_scan import MAGIC
from telenano.recording.messages import RecordedMessage
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.rewrite import filter_recording, merge_recordings, split_recording
from telenano.recording.verify import verify
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.ends import end_data
from telenano.wire.errors import ConfigError, RecordingError

MakeFile = Callable[..., Path]


def contents(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    return [(m.channel_topic, m.log_ns, m.publish_ns, m.seq, m.payload) for m in Recording(path).messages()]


def states(folder: Path, seqs: list[int], name: str, *, finish: bool = True) -> Path:
    """Write a recording that holds these numbers of haptic/state, one a ms."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder, file_name=name))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in seqs:
        writer.write(hand, EPOCH_NS + seq * MILLISECOND_NS, haptic_state(seq).t_ns, seq, encode(haptic_state(seq)))
    writer.flush()
    if finish:
        writer.finish()
    else:
        writer._stream.close()
    return writer.path


def test_a_filter_keeps_bytes_channels_schemas_and_attachments(make_file: MakeFile, tmp_path: Path) -> None:
    source, target = make_file(), tmp_path / "new" / "some.mcap"
    filter_recording(source, target, Selection.of(["haptic/state"]), start_s=0.010, end_s=0.0201)
    expected = [row for row in contents(source) if row[0] == "haptic/state"][10:21]
    assert contents(target) == expected
    recording = Recording(target)
    assert recording.closed
    assert recording.attachments == Recording(source).attachments
    assert recording.metadata == Recording(source).metadata
    assert recording.channels == Recording(source).channels[:1]
    with target.open("rb") as file:
        found = [(schema and schema.name, channel.topic) for schema, channel, _ in make_reader(file).iter_messages()]
    assert set(found) == {("HapticState", "haptic/state")}


def test_nothing_is_overwritten_and_nothing_half_made_stays(make_file: MakeFile, tmp_path: Path) -> None:
    source, target = make_file(), tmp_path / "taken.mcap"
    target.write_bytes(b"mine")
    with pytest.raises(RecordingError, match="already exists"):
        filter_recording(source, target)
    assert target.read_bytes() == b"mine"
    with pytest.raises(RecordingError, match="cannot be created"):
        filter_recording(source, Path("/proc/none.mcap"))


def test_a_split_and_a_merge_give_the_recording_back(make_file: MakeFile, tmp_path: Path) -> None:
    source = make_file()
    parts = split_recording(source, tmp_path / "parts", interval_s=0.015)
    assert [part.messages for part in parts] == [30, 30, 20]
    target = tmp_path / "merged.mcap"
    merge_recordings([Path(part.path) for part in reversed(parts)], target, same_session=True)
    assert contents(target) == contents(source)
    assert Recording(target).attachments == Recording(source).attachments
    assert diff_recordings(source, target).same


def test_a_split_by_size_bounds_the_payload(make_file: MakeFile, tmp_path: Path) -> None:
    source = make_file()
    parts = split_recording(source, tmp_path / "parts", size_bytes=5000)
    sizes = [sum(len(row[4]) for row in contents(Path(part.path))) for part in parts]
    assert max(sizes) < 6000
    assert sum(part.messages for part in parts) == 80
    for wrong in ({}, {"interval_s": 1.0, "size_bytes": 1}, {"interval_s": 0.0}, {"size_bytes": 0}):
        with pytest.raises(ConfigError):
            split_recording(source, tmp_path / "none", **wrong)


def test_what_two_recordings_attach_under_one_name_is_kept_apart(tmp_path: Path) -> None:
    paths = []
    for name, data in (("a.mcap", b"one"), ("b.mcap", b"two"), ("c.mcap", b"one")):
        writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path, file_name=name))
        writer.attach("site.yaml", "application/yaml", data, 0)
        writer.finish()
        paths.append(writer.path)
    target = tmp_path / "all.mcap"
    merge_recordings(paths, target, same_session=True)
    assert Recording(target).attachments == {"site.yaml": b"one", "b/site.yaml": b"two"}


@pytest.mark.parametrize("seed", range(10))
def test_what_a_cut_leaves_is_recovered_and_reported(make_file: MakeFile, tmp_path: Path, seed: int) -> None:
    source = make_file()
    data = source.read_bytes()
    cut = random.Random(seed).randrange(len(MAGIC) + 1, len(data))
    source.write_bytes(data[:cut])
    readable = contents(source)
    target = tmp_path / "recovered.mcap"
    copied = filter_recording(source, target)
    assert contents(target) == readable
    assert copied.messages == len(readable)
    assert Recording(target).closed
    with target.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == len(readable)


def with_end(folder: Path, seqs: list[int], sent: int, name: str = "a.mcap", *, via: str = "direct") -> Path:
    """Write a recording of some numbers of haptic/state that ends with the last message of their publisher."""
    src = "haptic_node@master" if via == "direct" else "delay_node@slave"
    site = "master" if via == "direct" else "slave"
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder, file_name=name))
    hand = writer.channel("haptic/state", "haptic_node@master", site)
    events = writer.channel("session/event", src, site)
    for seq in seqs:
        log_ns = EPOCH_NS + seq * MILLISECOND_NS
        writer.write(hand, log_ns, haptic_state(seq).t_ns, seq, encode(haptic_state(seq)))
    sent_on = {("haptic/state", "haptic_node@master"): sent}
    own, others = ({"haptic/state": sent}, {}) if via == "direct" else ({}, sent_on)
    event = sample("session/event", sent, src=src, kind="node", data=end_data(own, others))
    writer.write(events, event.t_ns, event.t_ns, event.seq, encode(event))
    writer.finish({"state": "stopped", "note": ""})
    return writer.path


@pytest.mark.parametrize("via", ["direct", "link"])
def test_what_is_missing_at_the_end_is_named(tmp_path: Path, via: str) -> None:
    path = with_end(tmp_path, list(range(20)), 25, via=via)
    (finding,) = [found for found in verify([path]).findings if found.check == "gap"]
    assert finding.level == "warning"
    assert finding.text.startswith("seq 20 to 24 of haptic_node@master (5) missing, at the end of what it sent")
    info = Recording(path).info()
    assert (info.complete, info.lost, info.channels[0].lost) == (False, 5, 5)
    assert "5 messages of haptic_node@master on haptic/state" in info.missing[0]


def test_a_process_that_follows_one_that_has_ended_has_lost_nothing(tmp_path: Path) -> None:
    first = with_end(tmp_path, list(range(3)), 3)
    second = states(tmp_path, list(range(6, 9)), "b.mcap")
    merged = tmp_path / "merged.mcap"
    merge_recordings([first, second], merged, same_session=True)
    assert verify([merged]).sound
    assert Recording(merged).info().complete
    # nor between two parts
    assert verify([first, second], same_session=True).sound


def test_parts_are_joined_and_what_is_missing_between_them_is_named(tmp_path: Path) -> None:
    first = states(tmp_path, list(range(20)), "a.mcap", finish=False)
    second = states(tmp_path, list(range(25, 50)), "b.mcap")
    joined = open_recordings([second, first], same_session=True)
    assert [message.seq for message in joined.messages(["haptic/state"])] == [*range(20), *range(25, 50)]
    info = joined.info()
    assert (info.path, info.messages, info.lost, info.closed, info.complete) == (str(first), 45, 5, False, False)
    assert [(Path(part.path).name, part.messages, part.closed) for part in info.parts] == [
        ("a.mcap", 20, False),
        ("b.mcap", 25, True),
    ]
    assert info.parts[1].pause_s == pytest.approx(6e-3, rel=1e-9, abs=0)
    assert info.missing == (
        "a.mcap was not closed: it ends 0.019 s after its start, the rest is missing",
        "nothing was recorded for 0.006 s between a.mcap and b.mcap",
        "5 messages of haptic_node@master on haptic/state are missing",
    )


def test_the_lag_of_the_recorder_is_that_of_messages_at_its_own_site(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    writer.add_metadata("recording", {"node": NODE})
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    # the clock of the other site is an hour ahead
    tip = writer.channel("afm/state", "afm_node@slave", "slave")
    for seq in range(100):
        sent_ns = EPOCH_NS + seq * MILLISECOND_NS
        writer.write(hand, sent_ns + seq * 10_000, sent_ns, seq, encode(haptic_state(seq)))
        writer.write(tip, sent_ns, sent_ns + 3600 * 10**9, seq, encode(sample("afm/state", seq)))
    writer.finish()
    lag = Recording(writer.path).info().recorder_lag
    assert lag is not None
    assert (lag.p50_s, lag.max_s) == (pytest.approx(495e-6, rel=1e-9, abs=0), pytest.approx(990e-6, rel=1e-9, abs=0))


def test_a_flipped_bit_in_an_attachment_is_found(make_file: MakeFile) -> None:
    path = make_file()
    data = bytearray(path.read_bytes())
    data[data.index(b"nodes: {}")] ^= 1
    path.write_bytes(data)
    assert any("attachment site.yaml" in finding.text for finding in verify([path]).findings)


def test_a_difference_is_counted_and_the_first_one_named(tmp_path: Path) -> None:
    left = states(tmp_path, list(range(50)), "a.mcap")
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path, file_name="b.mcap"))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(10, 60):
        change = {"motor_force_n": (0.0, 0.0, 1e-12)} if seq in (30, 31) else {}
        message = haptic_state(seq, **change)
        writer.write(hand, EPOCH_NS, message.t_ns, seq, encode(message))
    writer.finish()
    found = diff_recordings(left, writer.path)
    (row,) = found.channels
    assert not found.same
    assert (row.left, row.right, row.only_left, row.only_right, row.different) == (50, 50, 10, 10, 2)
    assert row.first.startswith("seq 30: motor_force_n.2: ")
    (row,) = diff_recordings(left, writer.path, Tolerances({"motor_force_n": 1e-11})).channels
    assert row.different == 0
    (row,) = diff_recordings(left, writer.path, ignore=["motor_force_n"]).channels
    assert row.different == 0


def foreign(path: Path) -> Path:
    """Write an MCAP file of somebody else: JSON, no metadata, no schema."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/odom", "json", 0)
        for number in range(5):
            writer.add_message(channel, log_time=number, data=b'{"x": 1}', publish_time=number, sequence=number)
        writer.finish()
    return path


def test_a_foreign_file_can_be_copied_and_checked_and_is_not_understood(tmp_path: Path) -> None:
    path = foreign(tmp_path / "odom.mcap")
    filter_recording(path, tmp_path / "copy.mcap", Selection.of(["/odo.*/"]))
    assert contents(tmp_path / "copy.mcap") == contents(path)
    assert verify([path]).sound
    message: RecordedMessage = next(Recording(path).messages())
    with pytest.raises(RecordingError, match="unknown topic"):
        message.decode()


def test_a_message_of_a_newer_version_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    newer = msgspec.structs.replace(haptic_state(1), v=99)
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    for message in (haptic_state(0), newer, haptic_state(2)):
        writer.write(hand, EPOCH_NS, message.t_ns, message.seq, encode(message))
    writer.finish()
    (finding,) = [found for found in verify([writer.path]).findings if found.check == "schema"]
    assert "schema version 99" in finding.text
    assert "newer than version" in finding.text
    assert len(contents(writer.path)) == 3


@pytest.mark.parametrize("seed", range(150))
def test_no_damage_ends_in_anything_but_a_clear_error(make_file: MakeFile, tmp_path: Path, seed: int) -> None:
    path = make_file(compression=("zstd", "none", "lz4")[seed % 3])
    dice = random.Random(seed)
    data = bytearray(path.read_bytes())
    for _ in range(dice.choice((1, 3, 20))):
        place = dice.randrange(len(data))
        action = dice.randrange(4)
        if action == 0:
            data[place] = dice.randrange(256)
        elif action == 1:
            del data[place : place + dice.randrange(1, 200)]
        elif action == 2:
            data[place:place] = dice.randbytes(dice.randrange(1, 50))
        else:
            # a length field turned huge is the worst that a bit can do
            data[place : place + 8] = (2 ** dice.randrange(20, 64) - 1).to_bytes(8, "little")
        if not data:
            break
    path.write_bytes(data)
    try:
        verdict = verify([path])
        copied = filter_recording(path, tmp_path / "copy.mcap")
        assert copied.messages == len(contents(path))
        assert verdict.messages == copied.messages
        assert contents(tmp_path / "copy.mcap") == contents(path)
        Recording(path).newest_before(EPOCH_NS + 20 * MILLISECOND_NS)
    except RecordingError as error:
        assert str(path) in str(error)
