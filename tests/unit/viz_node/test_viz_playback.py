from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest
from recorder_samples import EPOCH_NS, haptic_state

from services.viz_node import playback as playback_module
from services.viz_node.feed import Feed
from services.viz_node.playback import RecordingPlayback
from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.errors import RecordingError, RefusedError
from telenano.wire.messages import Array
from telenano.wire.topics import TOPICS

MS = 1_000_000


class Time:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def time() -> Time:
    return Time()


@pytest.fixture
def playback(make_file: Callable[..., Path], time: Time) -> RecordingPlayback:
    """40 ms of haptic/state at 1 kHz, which a page has just begun to show."""
    found = RecordingPlayback(Recording(make_file()), time)
    assert list(found.poll(watched=True)) == []
    assert found.take_restart() is True
    return found


def numbers(playback: RecordingPlayback) -> list[int]:
    return [seen.fields["seq"] for seen in playback.poll(watched=True)]


def test_messages_come_at_the_pace_of_the_recording(playback: RecordingPlayback, time: Time) -> None:
    assert numbers(playback) == [0]
    time.now_s += 0.010
    assert numbers(playback) == list(range(1, 11))
    time.now_s += 1.0
    assert numbers(playback) == list(range(11, 40))
    assert playback.about()["playing"] is False


def test_time_stands_still_while_no_page_is_open(make_file: Callable[..., Path], time: Time) -> None:
    playback = RecordingPlayback(Recording(make_file()), time)
    time.now_s += 50.0
    list(playback.poll(watched=False))
    assert playback.position_s == 0.0
    list(playback.poll(watched=True))
    time.now_s += 0.010
    assert numbers(playback) == list(range(11))
    list(playback.poll(watched=False))
    time.now_s += 50.0
    list(playback.poll(watched=True))
    assert playback.position_s == pytest.approx(0.010)
    # the next page gets the curves up to there
    assert numbers(playback) == list(range(11))


def test_pause_holds_the_place_and_rate_changes_the_pace(playback: RecordingPlayback, time: Time) -> None:
    time.now_s += 0.010
    numbers(playback)
    assert playback.transport("pause", 0.0) == "pauses"
    time.now_s += 5.0
    assert numbers(playback) == []
    assert playback.position_s == pytest.approx(0.010)
    playback.transport("play", 0.0)
    playback.transport("rate", 10.0)
    time.now_s += 0.001
    assert numbers(playback) == list(range(11, 21))


def test_after_a_seek_the_page_begins_anew_with_what_led_there(playback: RecordingPlayback, time: Time) -> None:
    assert playback.take_restart() is False
    numbers(playback)
    playback.transport("pause", 0.0)
    assert playback.transport("seek", 0.02) == "at 0.0 s"
    assert playback.take_restart() is True
    assert playback.take_restart() is False
    # paused at 20 ms: the curves up to there are shown
    assert numbers(playback) == list(range(21))
    playback.transport("seek", -7.0)
    assert playback.position_s == 0.0


def test_play_at_the_end_begins_again(playback: RecordingPlayback, time: Time) -> None:
    time.now_s += 9.0
    numbers(playback)
    playback.transport("play", 0.0)
    assert playback.take_restart() is True
    assert numbers(playback) == [0]


@pytest.mark.parametrize(
    ("action", "value", "fault"),
    [("rate", 0.0, "must be between"), ("seek", float("nan"), "finite"), ("eject", 1.0, "unknown")],
)
def test_what_the_transport_cannot_do_is_refused(
    playback: RecordingPlayback, action: str, value: float, fault: str
) -> None:
    with pytest.raises(RefusedError, match=fault):
        playback.transport(action, value)


def test_a_recording_without_anything_to_show_is_named(make_file: Callable[..., Path], time: Time) -> None:
    with pytest.raises(RecordingError, match="none of the topics"):
        RecordingPlayback(Recording(make_file(0)), time)


def test_a_recording_that_has_ended_does_not_play_on_from_where_somebody_looks(
    playback: RecordingPlayback, time: Time
) -> None:
    time.now_s += 1.0
    numbers(playback)
    playback.transport("seek", 0.01)
    time.now_s += 1.0
    assert playback.position_s == pytest.approx(0.01)
    assert playback.about()["playing"] is False
    playback.transport("play", 0.0)
    time.now_s += 0.01
    assert playback.position_s == pytest.approx(0.02)


LINES, LINE_MS = 8, 5
IMAGES_MS = (20, 100)


def scanned(folder: Path) -> Recording:
    """Return 200 ms of a hand, and two images of eight lines each, that begin at 20 ms and at 100 ms."""
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=folder))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    tip = writer.channel("afm/scanline", "afm_node@slave", "slave")
    example = examples(TOPICS["afm/scanline"])["ordinary"]
    rows = [(ms, hand, encode(haptic_state(ms))) for ms in range(200)]
    for image, begin_ms in enumerate(IMAGES_MS):
        for line in range(LINES):
            height = Array.from_numpy(np.full(4, 1e-9 * (10 * image + line), dtype=np.float32))
            for direction in ("trace", "retrace"):
                made = {"line": line, "lines": LINES, "direction": direction, "height_m": height}
                message = msgspec.structs.replace(example, src="afm_node@slave", **made)
                rows.append((begin_ms + LINE_MS * line, tip, encode(message)))
    for number, (ms, channel, payload) in enumerate(sorted(rows, key=lambda row: row[0])):
        writer.write(channel, EPOCH_NS + ms * MS, EPOCH_NS + ms * MS, number, payload)
    writer.finish()
    return Recording(writer.path)


@pytest.mark.parametrize("look_back_ns", [1, 60_000_000_000])
def test_after_a_seek_the_newest_image_before_the_place_is_whole(
    tmp_path: Path, time: Time, monkeypatch: pytest.MonkeyPatch, look_back_ns: int
) -> None:
    monkeypatch.setattr(playback_module, "_LEAD_S", 0.002)
    monkeypatch.setattr(playback_module, "_LOOK_BACK_NS", look_back_ns)
    found = RecordingPlayback(scanned(tmp_path), time)
    list(found.poll(watched=True))
    found.transport("pause", 0.0)

    def lines_at(place_s: float) -> dict[tuple[str, int], float]:
        found.transport("seek", place_s)
        feed = Feed()
        for seen in found.poll(watched=True):
            feed.record(seen)
        snapshot = feed.snapshot()["lines"]
        heights = [(line["direction"], line["line"], line["height"]["data"]) for line in snapshot]
        return {(way, line): float(np.frombuffer(data, "<f4")[0]) for way, line, data in heights}

    def image(number: int, lines: int) -> dict[tuple[str, int], float]:
        ways = ("trace", "retrace")
        return {(way, line): pytest.approx(1e-9 * (10 * number + line)) for way in ways for line in range(lines)}

    # past the scan, long past the second one, back between the two, into the middle of one, and before all
    assert lines_at(0.09) == image(0, LINES)
    assert lines_at(0.19) == image(1, LINES)
    assert lines_at(0.08) == image(0, LINES)
    assert lines_at(0.1 + 1e-3 * (2 * LINE_MS + 1)) == image(1, 3)
    assert lines_at(0.01) == {}
