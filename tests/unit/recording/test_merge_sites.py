"""The recordings of two sites as one, on the clock of the master's, and the folder of a session."""

import json
from pathlib import Path

import msgspec
import pytest

from telenano.recording.reader import Recording
from telenano.recording.session_folder import SessionFolder
from telenano.recording.site_merge import merge_sites, slave_clock
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.errors import RecordingError
from telenano.wire.topics import TOPICS

MS, BEGAN, AHEAD = 1_000_000, 10**18, 2_000_000_000


def write(
    folder: Path,
    node: str,
    rows: list[tuple[str, str, int, int]],
    clocks: tuple[tuple[float, float], ...],
    end: dict[str, str] | None = None,
    closed: bool = True,
) -> Path:
    """Write topic, source, number and time of reception [ns]; the clocks are offset and uncertainty [s]."""
    site = node.partition("@")[2]
    writer = RecordingWriter.create(node, FileSettings(directory=folder, file_name=f"{site}.mcap"))
    writer.add_metadata("recording", {"node": node})
    for topic, src, seq, log_ns in sorted(rows, key=lambda row: row[3]):
        made = msgspec.structs.replace(examples(TOPICS[topic])["ordinary"], src=src, seq=seq, t_ns=log_ns)
        writer.write(writer.channel(topic, src, site), log_ns, log_ns, seq, encode(made))
    for seq, (offset_s, uncertainty_s) in enumerate(clocks):
        status = examples(TOPICS["link/status"])["ordinary"]
        clock = {"valid": True, "offset_s": offset_s, "uncertainty_s": uncertainty_s}
        made = msgspec.structs.replace(status, seq=seq, clock=msgspec.structs.replace(status.clock, **clock))
        channel = writer.channel("link/status", "delay_node@master", site)
        writer.write(channel, BEGAN + 50 * MS + seq, BEGAN, seq, encode(made))
    if closed:
        writer.finish(end)
    else:
        writer.flush()
        writer.abandon()
    return writer.path


def test_each_message_is_there_once_on_the_masters_clock(tmp_path: Path) -> None:
    hand = [("haptic/state", "haptic_node@master", seq, BEGAN + seq * MS) for seq in range(10)]
    both = [("law/status", "controller@slave", seq, BEGAN + seq * MS) for seq in range(3)]
    tip = [("afm/state", "afm_node@slave", seq, BEGAN + AHEAD + seq * MS + MS // 2) for seq in range(10)]
    here = [("law/status", "controller@slave", seq, BEGAN + AHEAD + seq * MS) for seq in range(4)]
    # of the offsets that which is known best counts
    master = write(tmp_path, "recorder@master", hand + both, ((2.7, 1.0), (2.0, 0.001), (1.9, 0.5)))
    slave = write(tmp_path, "recorder@slave", tip + here, ())
    target = tmp_path / "both.mcap"
    result = merge_sites([master, slave], target, same_session=True)
    found = list(Recording(target).messages())
    assert result.messages == len(found) == 10 + 3 + 10 + 4 + 3
    assert [message.log_ns for message in found] == sorted(message.log_ns for message in found)
    states = [(m.topic, m.seq) for m in found if m.topic in ("haptic/state", "afm/state")]
    assert states == [(topic, seq) for seq in range(10) for topic in ("haptic/state", "afm/state")]
    # what the slave sent is what it was, by its own clock
    assert {m.publish_ns - m.log_ns for m in found if m.topic == "afm/state"} == {AHEAD}
    assert Recording(target).metadata["merged"]["slave_clock_ahead_ns"] == str(AHEAD)


def test_a_channel_that_both_have_is_taken_from_the_recorder_near_it(tmp_path: Path) -> None:
    # the master's recorder, over the network, missed some and had them late
    settings = FileSettings(directory=tmp_path, file_name="master.mcap")
    writer = RecordingWriter.create("recorder@master", settings)
    writer.add_metadata("recording", {"node": "recorder@master"})
    channel = writer.channel("afm/state", "afm_node@slave", "slave")
    state = examples(TOPICS["afm/state"])["ordinary"]
    for seq in (1, 3):
        writer.write(channel, BEGAN + 90 * MS, BEGAN, seq, encode(msgspec.structs.replace(state, seq=seq)))
    status = examples(TOPICS["link/status"])["ordinary"]
    clock = msgspec.structs.replace(status.clock, valid=True, offset_s=0.0, uncertainty_s=0.0)
    made = encode(msgspec.structs.replace(status, clock=clock))
    writer.write(writer.channel("link/status", "delay_node@master", "master"), BEGAN, BEGAN, 0, made)
    writer.finish()
    slave = write(
        tmp_path, "recorder@slave", [("afm/state", "afm_node@slave", s, BEGAN + s * MS) for s in range(5)], ()
    )
    target = tmp_path / "both.mcap"
    merge_sites([writer.path, slave], target, same_session=True)
    tips = [message for message in Recording(target).messages() if message.topic == "afm/state"]
    assert [(message.seq, message.log_ns) for message in tips] == [(seq, BEGAN + seq * MS) for seq in range(5)]


@pytest.mark.parametrize("site", ["master", "slave"])
@pytest.mark.parametrize("lacks", ["", "a note", "its end"])
def test_what_the_files_of_a_site_lack_is_said_of_both_together(tmp_path: Path, site: str, lacks: str) -> None:
    def file(node: str, rows: list[tuple[str, str, int, int]], clocks: tuple[tuple[float, float], ...]) -> Path:
        is_it = node.endswith(site)
        end = {"state": "stopped", "note": "this is missing" if is_it and lacks == "a note" else ""}
        return write(tmp_path, node, rows, clocks, end, closed=not (is_it and lacks == "its end"))

    hand = [("haptic/state", "haptic_node@master", seq, BEGAN + seq * MS) for seq in range(3)]
    tip = [("afm/state", "afm_node@slave", seq, BEGAN + seq * MS) for seq in range(3)]
    sources = [file("recorder@master", hand, ((0.0, 0.001),)), file("recorder@slave", tip, ())]
    merge_sites(sources, tmp_path / "both.mcap", same_session=True)
    info = Recording(tmp_path / "both.mcap").info()
    assert info.complete == (not lacks)
    expected = {"": [], "a note": ["this is missing"], "its end": [f"{site}.mcap of the {site}'s site was not closed"]}
    assert [text.partition(":")[0] for text in info.missing] == expected[lacks]


def test_what_cannot_be_joined_is_refused_by_name(tmp_path: Path) -> None:
    master = write(tmp_path, "recorder@master", [("haptic/state", "haptic_node@master", 0, BEGAN)], ())
    slave = write(tmp_path, "recorder@slave", [("afm/state", "afm_node@slave", 0, BEGAN)], ())
    with pytest.raises(RecordingError, match=r"master\.mcap: has no link/status or link/network"):
        slave_clock(Recording(master))
    with pytest.raises(RecordingError, match=r"slave\.mcap of slave, .*master\.mcap of master"):
        merge_sites([slave, master], tmp_path / "x.mcap", same_session=True)
    assert not (tmp_path / "x.mcap").exists()


def test_the_parts_are_in_the_order_of_their_numbers_and_one_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for name in ("session_10.mcap", "session_2.mcap", "session.mcap", "session_x.mcap"):
        RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path, file_name=name)).finish()
    (tmp_path / "session_3.mcap").write_bytes(b"no recording")
    own, (fault,) = SessionFolder(tmp_path).own()
    assert [path.name for path in own] == ["session.mcap", "session_2.mcap", "session_10.mcap"]
    assert "session_3.mcap" in fault


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
