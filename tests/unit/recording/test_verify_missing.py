"""What `verify` calls missing: numbers within a file, at the end of a publisher and between two files; no more."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgpack import packb
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, sample

from telenano.recording.messages import RecordedMessage
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GAP_TOPIC, GapRecord
from telenano.recording.verify import Finding, Verdict, _Check, verify
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.ends import end_data

HAND, AFM, LINK = "haptic_node@master", "afm_node@slave", "delay_node@master"
SECOND_NS = 1000 * MILLISECOND_NS


class File:
    """A recording that is written message by message, a millisecond apart."""

    def __init__(self, folder: Path, begin_ns: int = EPOCH_NS, **settings: Any) -> None:
        self.writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder, **settings))
        self.now_ns = begin_ns
        self._channels: dict[tuple[str, str, str], int] = {}

    def write(
        self, seq: int, topic: str = "haptic/state", src: str = HAND, site: str = "", t_ns: int = 0, **fields: Any
    ) -> None:
        """Write a message, stamped as it is written unless told otherwise."""
        self.now_ns += MILLISECOND_NS
        at = topic, src, site or src.partition("@")[2]
        if at not in self._channels:
            self._channels[at] = self.writer.channel(*at)
        t_ns = t_ns or self.now_ns
        message = sample(topic, seq, src=src, t_ns=t_ns, **fields)
        self.writer.write(self._channels[at], self.now_ns, t_ns, seq, encode(message))

    def end(self, sent: dict[str, int], src: str = HAND, seq: int = 0, site: str = "", **forwarded: Any) -> None:
        """Write the last message of a publisher."""
        data = end_data(sent, forwarded.get("forwarded"))
        self.write(seq, "session/event", src, site, kind="node", level="info", data=data)

    def gap(self, first: int, last: int, topic: str = "haptic/state", src: str = HAND) -> None:
        record = GapRecord(channel_topic=topic, src=src, first_missing=first, last_missing=last, count=last - first + 1)
        self.writer.write_gap(self.now_ns, record)

    def close(self) -> Path:
        self.writer.finish()
        return self.writer.path


@pytest.fixture
def make(tmp_path: Path) -> Callable[..., File]:
    return lambda **settings: File(tmp_path, **settings)


def gaps(verdict: Verdict) -> list[Finding]:
    return [finding for finding in verdict.findings if finding.check == "gap"]


def faults(paths: list[Path]) -> list[str]:
    """Return what the check of the parts of a session finds, apart from what is no fault."""
    return [one.text for one in verify(paths, same_session=True).findings if one.level != "info"]


def numbers(verdict: Verdict) -> list[str]:
    """Return what of each gap is missing, as `3 to 4 (2)`."""
    return [
        f"{first} to {last} {count}"
        for first, last, count in (
            (words[1], words[3], next(word for word in words if word.startswith("(") and word.endswith(")")))
            for words in (finding.text.split() for finding in gaps(verdict))
        )
    ]


def written(make: Callable[..., File], seqs: list[int], **settings: Any) -> Path:
    file = make(**settings)
    for seq in seqs:
        file.write(seq)
    return file.close()


def test_a_recording_with_every_number_is_sound(make: Callable[..., File]) -> None:
    verdict = verify([written(make, list(range(7, 20)))])
    assert (verdict.sound, verdict.messages, verdict.findings) == (True, 13, ())


def test_one_missing_message_is_named_with_its_number_time_and_publisher(make: Callable[..., File]) -> None:
    verdict = verify([written(make, [0, 1, 3, 4])])
    assert not verdict.sound
    (gap,) = verdict.findings
    assert (gap.check, gap.level, gap.channel) == ("gap", "warning", "haptic/state")
    # the message behind the gap is the third of those a millisecond apart
    assert gap.text == f"seq 2 to 2 of {HAND} (1) missing, 0.002000 s after the start: there is no gap record"


def test_a_gap_that_the_recorder_saw_is_told_from_one_that_it_did_not(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.gap(1, 3)
    file.write(4)
    file.write(6)
    texts = [finding.text for finding in verify([file.close()]).findings]
    assert len(texts) == 2
    assert "seq 1 to 3" in texts[0]
    assert texts[0].endswith("the recorder recorded the gap")
    assert "seq 5 to 5" in texts[1]
    assert texts[1].endswith("there is no gap record")


def test_a_gap_record_without_a_message_after_it_is_missing_at_the_end(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.gap(1, 4)
    file.write(0, "afm/state", AFM)
    (gap,) = verify([file.close()]).findings
    assert Recording(file.writer.path).info().lost == 4
    assert gap.text.startswith(f"seq 1 to 4 of {HAND} (4) missing, at the end of what it sent, ")
    assert gap.text.endswith("the recorder recorded the gap")
    # one that does not follow what is there says nothing of the end
    other = make()
    other.write(0)
    other.gap(3, 4)
    assert verify([other.close()]).findings == ()


# Both are read in the order of the file, whether or not a link lay between.
OVERTAKEN_AT = {"publisher": ("haptic/state", HAND, ""), "link": ("teleop/forward", "controller@master", "slave")}


@pytest.mark.parametrize("at", OVERTAKEN_AT.values(), ids=OVERTAKEN_AT)
@pytest.mark.parametrize("late", [2, 3, 4])
def test_a_message_that_was_overtaken_is_not_missing_wherever_in_its_gap_it_belongs(
    make: Callable[..., File], late: int, at: tuple[str, str, str]
) -> None:
    file = make()
    file.write(0, *at)
    file.write(1, *at)
    sent_ns = file.now_ns + MILLISECOND_NS // 2
    file.write(5, *at)
    file.write(late, *at, t_ns=sent_ns)
    expected = {2: ["3 to 4 (2)"], 3: ["2 to 2 (1)", "4 to 4 (1)"], 4: ["2 to 3 (2)"]}
    assert numbers(verify([file.close()])) == expected[late]


@pytest.mark.parametrize("at", OVERTAKEN_AT.values(), ids=OVERTAKEN_AT)
def test_when_all_of_a_gap_has_arrived_late_nothing_is_missing(
    make: Callable[..., File], at: tuple[str, str, str]
) -> None:
    file = make()
    file.write(0, *at)
    sent_ns = file.now_ns
    file.write(4, *at)
    file.write(6, *at)
    for seq in (2, 1, 3, 5):
        file.write(seq, *at, t_ns=sent_ns + seq)
    assert gaps(verify([file.close()])) == []


def test_what_a_publisher_sent_last_is_missing_by_its_own_count(make: Callable[..., File]) -> None:
    file = make()
    for seq in range(3):
        file.write(seq)
    file.end({"haptic/state": 5, "session/event": 1})
    (gap,) = verify([file.close()]).findings
    assert gap.text.startswith(f"seq 3 to 4 of {HAND} (2) missing, at the end of what it sent, 0.003000 s")
    assert gap.level == "warning"
    # with all that it counts there is nothing to say
    whole = make()
    for seq in range(5):
        whole.write(seq)
    whole.end({"haptic/state": 5, "session/event": 1})
    assert verify([whole.close()]).findings == ()


def test_the_end_counts_where_it_follows_another_event_of_its_publisher(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.write(0, "session/event", kind="node", level="info")
    file.end({"haptic/state": 3, "session/event": 2}, seq=1)
    assert numbers(verify([file.close()])) == ["1 to 2 (2)"]


def test_the_end_of_another_publisher_says_nothing_of_this_one(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.write(0, "haptic/state", "haptic_node@slave")
    file.end({"haptic/state": 9, "session/event": 1}, src="haptic_node@slave")
    found = verify([file.close()]).findings
    assert [(gap.channel, gap.text.split(" missing")[0]) for gap in found] == [
        ("haptic/state", "seq 1 to 8 of haptic_node@slave (8)")
    ]


def test_what_was_received_behind_the_link_is_counted_by_the_link_that_sent_it_on(make: Callable[..., File]) -> None:
    file = make()
    for seq in range(3):
        file.write(seq, "teleop/forward", "controller@master")
        if seq < 2:
            file.write(seq, "teleop/forward", "controller@master", "slave")
    # the controller's own count is of its own endpoint
    file.end({"teleop/forward": 3, "session/event": 1}, src="controller@master")
    assert verify([file.close()]).findings == ()
    late = make()
    late.write(0, "teleop/forward", "controller@master", "slave")
    late.end({"session/event": 1}, src="delay_node@slave", forwarded={("teleop/forward", "controller@master"): 3})
    (gap,) = verify([late.close()]).findings
    # what a link has taken over and lost at its end is no experiment
    assert (gap.level, gap.text.split(",")[0]) == ("warning", "seq 1 to 2 of controller@master (2) missing")


def test_what_an_impaired_link_dropped_is_information_and_no_fault(make: Callable[..., File]) -> None:
    file = make()
    file.write(0, "teleop/forward", "controller@master", "slave")
    file.write(2, "teleop/forward", "controller@master", "slave")
    verdict = verify([file.close()])
    assert verdict.sound
    assert [finding.level for finding in verdict.findings] == ["info"]
    assert numbers(verdict) == ["1 to 1 (1)"]
    info = Recording(file.writer.path).info()
    assert (info.lost, info.missing) == (0, ())


def test_a_publisher_that_began_again_has_lost_nothing(make: Callable[..., File]) -> None:
    file = make()
    for seq in (0, 1, 2, 0, 1):
        file.write(seq)
    verdict = verify([file.close()])
    assert verdict.sound
    assert [finding.text for finding in verdict.findings] == [f"{HAND} was restarted before seq 0"]


@pytest.mark.parametrize("begin", [2, 9])
def test_a_publisher_that_ended_and_began_again_has_lost_nothing(make: Callable[..., File], begin: int) -> None:
    file = make()
    file.write(0)
    file.write(1)
    file.end({"haptic/state": 2, "session/event": 1})
    file.write(begin)
    file.write(begin + 1)
    texts = [finding.text for finding in verify([file.close()]).findings]
    assert texts == [f"{HAND} was restarted before seq {begin}"]


def test_a_message_from_before_the_end_that_comes_after_it_is_no_new_beginning(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    sent_ns = file.now_ns + MILLISECOND_NS // 2
    file.write(3)
    file.end({"haptic/state": 4, "session/event": 1})
    file.write(1, t_ns=sent_ns)
    file.write(2, t_ns=sent_ns + 1)
    assert gaps(verify([file.close()])) == []


def test_a_message_that_was_recorded_twice_is_no_new_beginning(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.write(1)
    file.write(1, t_ns=file.now_ns)
    file.write(2)
    newest_ns = file.now_ns
    file.end({"haptic/state": 3, "session/event": 1})
    file.write(2, t_ns=newest_ns)
    assert gaps(verify([file.close()])) == []


def test_a_message_that_the_first_one_overtook_on_the_link_is_no_new_beginning(make: Callable[..., File]) -> None:
    file = make()
    file.write(1, *OVERTAKEN_AT["link"])
    file.write(0, *OVERTAKEN_AT["link"], t_ns=file.now_ns - 1)
    assert gaps(verify([file.close()])) == []


def test_a_gap_before_a_new_beginning_is_not_missing_at_the_end_of_it(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.gap(1, 3)
    file.write(0)
    assert [finding.text for finding in gaps(verify([file.close()]))] == [f"{HAND} was restarted before seq 0"]
    assert Recording(file.writer.path).info().missing == ()


def test_what_was_noted_in_a_recording_while_it_was_written_is_an_error_of_it(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.writer.finish({"note": "the quota of 65536 bytes is used up; 60 messages were removed"})
    verdict = verify([file.writer.path])
    assert not verdict.sound
    assert [(note.check, note.level, note.text) for note in verdict.findings] == [
        ("end", "error", "the quota of 65536 bytes is used up"),
        ("end", "error", "60 messages were removed"),
    ]
    noted = ("the quota of 65536 bytes is used up", "60 messages were removed")
    assert Recording(file.writer.path).info().missing == noted


def test_two_files_of_one_recording_are_joined_without_a_word(make: Callable[..., File]) -> None:
    first = written(make, [0, 1, 2])
    second = written(make, [3, 4], begin_ns=EPOCH_NS + SECOND_NS)
    for paths in ([first, second], [second, first]):
        assert verify(paths, same_session=True) == Verdict(sound=True, messages=5, findings=())


@pytest.mark.parametrize(("begin", "missing"), [(4, "3 to 3 (1)"), (5, "3 to 4 (2)"), (12, "3 to 11 (9)")])
def test_what_is_missing_between_two_files_is_named_down_to_one_message(
    make: Callable[..., File], begin: int, missing: str
) -> None:
    first = written(make, [0, 1, 2])
    second = written(make, [begin, begin + 1], begin_ns=EPOCH_NS + SECOND_NS)
    verdict = verify([second, first], same_session=True)
    assert not verdict.sound
    assert numbers(verdict) == [missing]
    (gap,) = verdict.findings
    assert (gap.file, gap.level, gap.channel) == (str(second), "warning", "haptic/state")
    assert gap.text.endswith(f"missing between {first.name} and this file, 0.998000 s apart")


def test_between_two_files_a_publisher_that_ended_or_began_again_has_lost_nothing(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    file.end({"haptic/state": 1, "session/event": 1})
    first = file.close()
    after_end = written(make, [9], begin_ns=EPOCH_NS + SECOND_NS)
    assert faults([first, after_end]) == []
    again = written(make, [0, 1], begin_ns=EPOCH_NS + 2 * SECOND_NS)
    assert faults([written(make, [5, 6]), again]) == []


def test_a_publisher_of_which_one_file_has_the_first_message_alone_has_not_ended_in_it(
    make: Callable[..., File],
) -> None:
    second = written(make, [3], begin_ns=EPOCH_NS + SECOND_NS)
    assert numbers(verify([written(make, [0]), second], same_session=True)) == ["1 to 2 (2)"]


def test_messages_that_follow_one_another_are_judged_by_their_headers(
    make: Callable[..., File], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = make()
    for seq in range(50):
        file.write(seq)
    file.end({"haptic/state": 50, "session/event": 1})
    looked_at: list[tuple[str, int]] = []
    check = _Check._check_message

    def counted(own: _Check, message: RecordedMessage, stream: Any, last_ns: int) -> int:
        looked_at.append((message.topic, message.seq))
        return check(own, message, stream, last_ns)

    monkeypatch.setattr(_Check, "_check_message", counted)
    assert verify([file.close()]).messages == 51
    # the first of a publisher and its last one are looked at more closely, whatever the ones between are
    assert looked_at == [("haptic/state", 0), ("session/event", 0)]


def test_an_end_is_looked_at_though_it_follows_another_event(make: Callable[..., File]) -> None:
    file = make()
    for seq in range(3):
        file.write(seq, "session/event", kind="node", level="info")
    file.write(0)
    file.end({"haptic/state": 2, "session/event": 4}, seq=3)
    assert numbers(verify([file.close()])) == ["1 to 1 (1)"]


@pytest.mark.parametrize(
    ("payload", "fault"),
    [(b"\xc1", "not msgpack"), (packb({"first_missing": "all"}), "channel_topic"), (packb([1]), "not a msgpack map")],
    ids=["garbage", "other fields", "no map"],
)
def test_a_gap_record_that_cannot_be_read_is_an_error_of_the_file(
    make: Callable[..., File], payload: bytes, fault: str
) -> None:
    file = make()
    file.write(0)
    file.gap(1, 1)
    file.writer.write(file.writer._own_channels[GAP_TOPIC], file.now_ns, file.now_ns, 1, payload)
    file.write(2)
    found = verify([file.close()]).findings
    assert [(finding.check, finding.level) for finding in found] == [("schema", "error"), ("gap", "warning")]
    assert found[0].text.startswith("recorder/gap, seq 1: ") and fault in found[0].text
    assert found[1].text.endswith("the recorder recorded the gap")


def test_what_is_wrong_with_the_index_is_an_error_of_a_sound_file_only(
    make: Callable[..., File], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(make, [0, 1])
    monkeypatch.setattr(Recording, "index_faults", lambda recording, messages: [f"the summary has not {messages}"])
    assert [(found.check, found.level, found.text) for found in verify([path]).findings] == [
        ("index", "error", "the summary has not 2; other readers may fail on it")
    ]


def test_a_file_that_was_not_closed_says_what_a_kill_may_have_taken(make: Callable[..., File]) -> None:
    file = make()
    file.writer.add_metadata("recording", {"recorder flush_interval_s": "0.2"})
    file.write(0)
    file.write(1)
    file.writer.flush()
    file.writer._stream.close()
    verdict = verify([file.writer.path])
    assert not verdict.sound
    ends = [finding for finding in verdict.findings if finding.check == "end"]
    assert [finding.level for finding in ends] == ["error"] * len(ends)
    assert any("it ends 0.001000 s after its start" in finding.text for finding in ends)
    assert any("since its last flush (0.2 s)" in finding.text for finding in ends)
    # of a file that was cut off, or of a full disk, nobody can promise how much it was
    assert any("any amount" in finding.text and "at most" not in finding.text for finding in ends)


def test_a_record_that_contradicts_its_message_is_named_with_what_differs(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    channel = file._channels["haptic/state", HAND, "master"]
    t_ns = file.now_ns + MILLISECOND_NS
    payload = encode(sample("haptic/state", 7, src="haptic_node@slave", t_ns=t_ns + 5))
    file.writer.write(channel, t_ns, t_ns, 1, payload)
    found = [finding for finding in verify([file.close()]).findings if finding.check == "schema"]
    assert [(finding.level, finding.text) for finding in found] == [
        ("error", "seq 1: seq, t_ns, src in the record and in the message differ")
    ]


def test_a_payload_that_is_no_message_is_an_error_and_five_of_a_kind_are_enough(make: Callable[..., File]) -> None:
    file = make()
    file.write(0)
    channel = file._channels["haptic/state", HAND, "master"]
    for seq in range(1, 9):
        file.writer.write(channel, file.now_ns + seq, file.now_ns + seq, seq, b"\xc1")
    verdict = verify([file.close()])
    assert not verdict.sound
    found = [finding for finding in verdict.findings if finding.check == "schema"]
    assert len(found) == 6
    assert all(finding.level == "error" and "haptic/state" in finding.text for finding in found[:5])
    assert found[5].text == "more of this kind: only the first 5 are reported"


def test_messages_of_several_channels_are_out_of_order_by_the_latest_time_before_them(
    make: Callable[..., File],
) -> None:
    file = make()
    for at_ms, src in ((9, HAND), (3, AFM), (6, LINK)):
        topic = {HAND: "haptic/state", AFM: "afm/state", LINK: "link/status"}[src]
        file.now_ns = EPOCH_NS + at_ms * MILLISECOND_NS
        file.write(0, topic, src)
    texts = [finding.text for finding in verify([file.close()]).findings if finding.check == "order"]
    assert texts == ["seq 0 is out of order by 0.006000 s", "seq 0 is out of order by 0.003000 s"]


def test_a_damaged_file_and_one_without_its_index_are_errors(make: Callable[..., File]) -> None:
    path = written(make, list(range(50)), compression="none")
    content = bytearray(path.read_bytes())
    content[len(content) // 3] ^= 0xFF
    path.write_bytes(bytes(content))
    verdict = verify([path])
    assert not verdict.sound
    assert [finding.level for finding in verdict.findings if finding.check == "crc"][:1] == ["error"]
    assert not [finding for finding in verdict.findings if finding.check == "index"]
    assert Recording(path).closed
