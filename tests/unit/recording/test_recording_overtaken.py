"""A file in which messages stand behind later ones of their publisher is read in the order of sending."""

import random
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, teleop_forward

from proto import encode
from recording.reader import Recording
from recording.verify import verify
from recording.writer import FileSettings, RecordingWriter

HAND = ("haptic/state", "haptic_node@master", "master")
LINK = ("teleop/forward", "controller@master", "slave")
# number and time of sending [ms] of each message, in the order of the file
Rows = Sequence[tuple[int, int]]


def write(folder: Path, rows: Rows, channel: tuple[str, str, str] = HAND, flush_every: int = 7) -> Path:
    """Write messages a millisecond apart, in chunks of a few."""
    writer = RecordingWriter.create(NODE, FileSettings(directory=folder))
    number, make = writer.channel(*channel), haptic_state if channel is HAND else teleop_forward
    base = make(0)
    for place, (seq, ms) in enumerate(rows):
        t_ns = EPOCH_NS + ms * MILLISECOND_NS
        writer.write(
            number,
            EPOCH_NS + place * MILLISECOND_NS,
            t_ns,
            seq,
            encode(base.model_copy(update={"seq": seq, "t_ns": t_ns})),
        )
        if place % flush_every == 0:
            writer.flush()
    writer.finish()
    return writer.path


def read(path: Path) -> list[int]:
    recording = Recording(path)
    found = list(recording.messages())
    times = [message.log_ns for message in found]
    assert times == sorted(times)
    assert all(message.fields()["seq"] == message.seq for message in found)
    return [message.seq for message in found]


def sent(*numbers: int) -> Rows:
    return [(number, number) for number in numbers]


@pytest.mark.parametrize(
    ("rows", "expected", "moved"),
    [
        # single messages, and then the batch that begins before them
        (sent(*range(4454, 4460), 4453, 4460, 4461), list(range(4453, 4462)), 1),
        # a publisher that stood still for two seconds, and the batch of before that behind what it sent then
        (
            [*sent(*range(20)), *((seq, seq + 2000) for seq in range(32, 45)), *sent(*range(20, 32)), (45, 2045)],
            list(range(46)),
            12,
        ),
        # the batch has some of them twice: a copy stays where it is
        (sent(0, 1, 5, 6, 4, 5, 3, 7), [0, 1, 3, 4, 5, 6, 5, 7], 2),
        # started again, and then its first batch
        ([*sent(0, 1, 2), (2, 1002), (3, 1003), (0, 1000), (1, 1001), (4, 1004)], [0, 1, 2, 0, 1, 2, 3, 4], 2),
    ],
)
def test_what_stands_behind_later_messages_is_read_before_them(
    tmp_path: Path, rows: Rows, expected: list[int], moved: int
) -> None:
    path = write(tmp_path, rows)
    assert [message.seq for message in Recording(path).raw()] == [seq for seq, _ in rows]
    assert read(path) == expected
    assert Recording(path).overtaken == moved
    verdict = verify([path])
    assert [finding.text for finding in verdict.findings if finding.check == "order"] == [
        f"{moved} messages stand behind later ones of their publisher; they are read in the order of sending"
    ]


@pytest.mark.parametrize(
    "rows",
    [
        # a player that was set back: to what it has played, before that, and again and again
        sent(*range(3000, 5000), *range(3500, 5500)),
        sent(*range(3000, 5000), *range(1000, 1500)),
        sent(*range(2000), *range(2000), *range(2000)),
        sent(*range(9000, 12000), *range(2000, 8000)),
    ],
)
def test_a_replay_that_was_set_back_is_read_as_it_is(tmp_path: Path, rows: Rows) -> None:
    assert read(write(tmp_path, rows, flush_every=100)) == [seq for seq, _ in rows]


def test_what_the_link_let_overtake_one_another_is_read_as_it_was_received(tmp_path: Path) -> None:
    rows = sent(0, 2, 1, 4, 3)
    assert read(write(tmp_path, rows, LINK)) == [0, 2, 1, 4, 3]


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 2**32), st.integers(1, 1600))
def test_whatever_order_a_batch_leaves_is_undone(
    tmp_path_factory: pytest.TempPathFactory, seed: int, size: int
) -> None:
    """Some messages of each batch were written one by one before the rest of it, each from its own moment on."""
    draw, rows, seq = random.Random(seed), [], 0
    for _ in range(4):
        batch = range(seq, seq + draw.randint(1, size))
        first = draw.randint(batch.start, batch.stop)
        rows += sent(*range(first, batch.stop), *range(batch.start, first))
        seq = batch.stop
    assert read(write(tmp_path_factory.mktemp("batches"), rows, flush_every=50)) == list(range(seq))


def test_a_part_of_the_time_and_the_newest_of_each_channel_are_those_of_the_order_of_sending(tmp_path: Path) -> None:
    path = write(tmp_path, sent(0, 1, 2, 6, 7, 8, 3, 4, 5, 9), flush_every=2)
    recording = Recording(path)
    whole = list(recording.messages())
    assert [message.seq for message in whole] == list(range(10))
    for first in range(12):
        for after in range(first, 12):
            start_ns, end_ns = EPOCH_NS + first * MILLISECOND_NS, EPOCH_NS + after * MILLISECOND_NS
            expected = [message for message in whole if start_ns <= message.log_ns < end_ns]
            assert list(recording.messages(start_ns=start_ns, end_ns=end_ns)) == expected
    for time_ms in range(1, 12):
        before_ns = EPOCH_NS + time_ms * MILLISECOND_NS
        (newest,) = recording.newest_before(before_ns).values()
        assert newest == max(message for message in whole if message.log_ns < before_ns)
