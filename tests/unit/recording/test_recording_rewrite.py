"""Copies of recordings, their check, and their comparison."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state

from proto import encode
from proto.errors import ConfigError, RecordingError
from recording.channel_filter import Selection
from recording.diff import diff_recordings
from recording.mcap_scan import MAGIC
from recording.messages import RecordedMessage
from recording.reader import Recording
from recording.records import GapRecord
from recording.rewrite import filter_recording, merge_recordings, split_recording
from recording.tolerance import Tolerances
from recording.verify import verify
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig

MakeFile = Callable[..., Path]


def contents(path: Path) -> list[tuple[str, int, int, int, bytes]]:
    return [(m.channel_topic, m.log_ns, m.publish_ns, m.seq, m.payload) for m in Recording(path).messages()]


def states(folder: Path, seqs: list[int], name: str, *, finish: bool = True, gaps: bool = False) -> Path:
    """Write a recording that holds these numbers of haptic/state, one a ms, with or without records of its gaps."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder, file_name=name))
    writer.add_metadata("recording", {"recorder flush_interval_s": "0.2"})
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    last = seqs[0] - 1
    for seq in seqs:
        log_ns = EPOCH_NS + seq * MILLISECOND_NS
        if gaps and seq > last + 1:
            source = "haptic_node@master"
            writer.write_gap(
                log_ns,
                GapRecord(
                    channel_topic="haptic/state",
                    src=source,
                    first_missing=last + 1,
                    last_missing=seq - 1,
                    count=seq - last - 1,
                ),
            )
        writer.write(hand, log_ns, haptic_state(seq).t_ns, seq, encode(haptic_state(seq)))
        last = seq
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
    assert recording.complete
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
    merge_recordings([Path(part.path) for part in reversed(parts)], target)
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
    merge_recordings(paths, target)
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
    assert Recording(target).complete
    with target.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == len(readable)


def test_a_sound_recording_is_sound(make_file: MakeFile) -> None:
    verdict = verify([make_file()])
    assert verdict.sound
    assert verdict.findings == ()
    assert verdict.messages == 80


def test_a_killed_recording_says_where_it_ends(tmp_path: Path) -> None:
    verdict = verify([states(tmp_path, list(range(50)), "a.mcap", finish=False)])
    (finding,) = verdict.findings
    assert (finding.check, finding.level) == ("end", "error")
    assert "ends 0.049000 s after its start" in finding.text
    assert "at most the last 0.2 s" in finding.text
    assert not verdict.sound


@pytest.mark.parametrize(("gaps", "how"), [(True, "the recorder recorded the gap"), (False, "there is no gap record")])
def test_missing_numbers_are_named(tmp_path: Path, gaps: bool, how: str) -> None:
    seqs = [seq for seq in range(50) if seq not in (20, 21, 22, 40)]
    verdict = verify([states(tmp_path, seqs, "a.mcap", gaps=gaps)])
    texts = [finding.text for finding in verdict.findings]
    assert [text.split(":")[0] for text in texts] == [
        "seq 20 to 22 of haptic_node@master (3) missing, 0.023000 s after the start",
        "seq 40 to 40 of haptic_node@master (1) missing, 0.041000 s after the start",
    ]
    assert all(how in text for text in texts)


def test_what_is_missing_between_two_parts_is_named(tmp_path: Path) -> None:
    first = states(tmp_path, list(range(20)), "a.mcap", finish=False)
    second = states(tmp_path, list(range(25, 50)), "b.mcap")
    verdict = verify([second, first])
    texts = [finding.text for finding in verdict.findings if finding.check == "gap"]
    assert texts == ["seq 20 to 24 of haptic_node@master (5) missing between a.mcap and this file, 0.006000 s apart"]


def test_a_flipped_bit_is_found(make_file: MakeFile) -> None:
    path = make_file(compression="none")
    data = bytearray(path.read_bytes())
    place = data.index(encode(haptic_state(17))) + 30
    data[place] ^= 0x10
    path.write_bytes(data)
    checks = {finding.check for finding in verify([path]).findings}
    assert "crc" in checks
    # and what the damaged chunk had is missing
    assert "gap" in checks


def test_a_flipped_bit_in_an_attachment_is_found(make_file: MakeFile) -> None:
    path = make_file()
    data = bytearray(path.read_bytes())
    data[data.index(b"nodes: {}")] ^= 1
    path.write_bytes(data)
    assert any("attachment site.yaml" in finding.text for finding in verify([path]).findings)


def test_messages_that_are_not_what_their_record_says_are_found(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    writer.write(hand, EPOCH_NS, 7, 0, encode(haptic_state(0)))
    writer.write(hand, EPOCH_NS - 10, 8, 1, b"\x81\xa1a\x01")
    writer.finish()
    findings = {(finding.check, finding.level) for finding in verify([writer.path]).findings}
    assert findings == {("schema", "error"), ("order", "warning")}


def test_the_number_of_findings_is_bounded(tmp_path: Path) -> None:
    verdict = verify([states(tmp_path, list(range(0, 2000, 2)), "a.mcap")])
    assert 2 <= len(verdict.findings) <= 10
    assert "more of this kind" in verdict.findings[-1].text


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
    newer = haptic_state(1).model_copy(update={"v": 99})
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
