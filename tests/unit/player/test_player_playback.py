"""Positions, bounds and the state at a position, without a socket or a clock."""

from collections.abc import Callable
from pathlib import Path

import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, sample

from services.player.playback import Playback, PlaybackClock, Span
from telenano.recording.channel_filter import ALL, Selection
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.writer import RecordingWriter
from telenano.wire import encode
from telenano.wire.errors import RecordingError

MakeFile = Callable[..., Path]


@pytest.fixture
def events(tmp_path: Path) -> Path:
    """A recording of 100 states, one a ms, in chunks of 10, with a slow topic once and events at 30 and 60 ms."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    link = writer.channel("link/status", "delay_node@master", "master")
    event = writer.channel("session/event", "afm_node@slave", "slave")
    for seq in range(100):
        log_ns = EPOCH_NS + seq * MILLISECOND_NS
        writer.write(hand, log_ns, log_ns, seq, encode(haptic_state(seq)))
        if seq == 5:
            writer.write(link, log_ns, log_ns, 0, encode(sample("link/status", 0, src="delay_node@master")))
        if seq in (30, 60):
            writer.write(event, log_ns, log_ns, seq, encode(sample("session/event", seq, src="afm_node@slave")))
        if seq % 10 == 9:
            writer.flush()
    writer.finish()
    return writer.path


def played(playback: Playback) -> list[int]:
    found = []
    while playback.peek() is not None:
        found.append(playback.pop().seq)
    return found


def hands(path: Path, start_s: float = 0.0, end_s: float | None = None) -> Playback:
    return Playback(Recording(path), Selection.of(["haptic/state"]), Span(start_s, end_s))


def test_everything_is_played_once_in_order(make_file: MakeFile) -> None:
    path = make_file()
    playback = Playback(Recording(path), ALL, Span())
    played = [(each.channel_topic, each.seq) for each in iter(lambda: playback.peek() and playback.pop(), None)]
    assert played == [(message.channel_topic, message.seq) for message in Recording(path).messages()]
    with pytest.raises(RecordingError, match="there is no message after"):
        playback.pop()


def test_start_and_end_bound_what_is_played(events: Path) -> None:
    assert played(hands(events, start_s=0.020, end_s=0.030)) == list(range(20, 30))
    with pytest.raises(RecordingError, match=r"is 0\.099 s long"):
        hands(events, start_s=1.0)
    with pytest.raises(RecordingError, match="there is nothing from"):
        hands(events, start_s=0.05, end_s=0.02)


@pytest.mark.parametrize("place", [0, 1, 37, 50, 99])
def test_a_seek_leads_to_any_place_and_on_from_there(events: Path, place: int) -> None:
    playback = hands(events)
    played(playback)
    state = playback.seek(playback.at(place * 1e-3))
    assert [message.seq for message in state] == ([place - 1] if place else [])
    assert played(playback) == list(range(place, 100))


def test_a_seek_beyond_the_recording_stays_within(events: Path) -> None:
    playback = hands(events)
    playback.seek(playback.at(-5.0))
    assert playback.time_s == 0.0
    playback.seek(playback.at(5.0))
    assert played(playback) == [99]


def test_the_state_at_a_position_reaches_back_to_slow_topics_and_leaves_events_out(events: Path) -> None:
    playback = Playback(Recording(events), ALL, Span())
    state = playback.seek(playback.at(0.0955))
    assert [(message.topic, message.seq) for message in state] == [("link/status", 0), ("haptic/state", 95)]
    assert playback.seek(playback.at(0.0035))[0].topic == "haptic/state"


def test_the_state_is_found_in_a_killed_file_too(make_file: MakeFile) -> None:
    recording = Recording(make_file(finish=False))
    state = recording.newest_before(EPOCH_NS + 25 * MILLISECOND_NS)
    assert sorted((channel.topic, message.seq) for channel, message in state.items()) == [
        ("haptic/state", 24),
        ("teleop/forward", 24),
    ]
    assert [m.seq for m in recording.messages(["haptic/state"], EPOCH_NS + 25 * MILLISECOND_NS)] == list(range(25, 40))


def test_the_next_event_is_found_from_anywhere(events: Path) -> None:
    playback = hands(events)
    times = []
    while (found := playback.next_event_ns()) is not None:
        times.append(round((found - playback.origin_ns) / MILLISECOND_NS))
        playback.seek(found)
    assert times == [30, 60]


def test_loop_points_can_be_moved_while_playing(events: Path) -> None:
    playback = hands(events)
    for _ in range(30):
        playback.pop()
    playback.limit(start_ns=playback.at(0.010))
    playback.limit(end_ns=playback.at(0.040))
    assert played(playback) == list(range(30, 40))
    playback.rewind()
    assert played(playback) == list(range(10, 40))
    with pytest.raises(RecordingError, match="must come after its start"):
        playback.limit(end_ns=playback.at(0.005))


def test_nothing_chosen_is_an_error(events: Path) -> None:
    with pytest.raises(RecordingError, match="none of the messages"):
        Playback(Recording(events), Selection.of(["afm/*"]), Span())


def test_time_is_mapped_by_the_rate_and_goes_on_from_where_it_was() -> None:
    playback_clock = PlaybackClock(1000, 50_000, 1.0, paused=False)
    assert playback_clock.due_ns(50_100) == 1100
    playback_clock.change(1100, 50_100, rate=2.0)
    assert playback_clock.due_ns(50_300) == 1200
    playback_clock.change(1200, 50_300, paused=True)
    assert playback_clock.due_ns(50_300) is None
    playback_clock.change(9000, 50_300, paused=False)
    assert playback_clock.due_ns(50_500) == 9100
    playback_clock.change(9100, 50_500, rate=0.0)
    assert playback_clock.due_ns(99_999_999) == 9100
