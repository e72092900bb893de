"""Differences between two recordings, channel by channel and message by message."""

from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel

from telenano.recording import RecordedChannel, RecordedMessage, Recording, Selection, Tolerances


class ChannelDifference(BaseModel):
    """Differences in one channel: the messages in each file, the number of differing pairs, the first difference."""

    channel: str
    src: str
    left: int
    right: int
    only_left: int
    only_right: int
    different: int
    first: str


class RecordingDifference(BaseModel):
    """Differences of two recordings; `same` is true if every message of each is in the other."""

    same: bool
    left: str
    right: str
    channels: tuple[ChannelDifference, ...]


Key = tuple[int, int]
Side = dict[RecordedChannel, dict[Key, RecordedMessage]]


def diff_recordings(
    left: Path,
    right: Path,
    tolerances: Tolerances | None = None,
    ignore: Iterable[str] = (),
    selection: Selection | None = None,
) -> RecordingDifference:
    """Compare two recordings by channel, publisher and `seq` of the messages; times of reception are ignored.

    Args:
        left: One recording.
        right: The other recording.
        tolerances: The tolerances by field; None compares exactly.
        ignore: Top-level fields that are left out, such as t_ns.
        selection: The part of the recordings that is compared; None is all of it.

    Raises:
        RecordingError: A file is not a recording, or neither has a channel that is selected.
    """
    allowed, skipped = tolerances or Tolerances(), tuple(ignore)
    chosen, recordings = selection or Selection(), [Recording(path) for path in (left, right)]
    chosen.demand_some_of(left, [channel for recording in recordings for channel in recording.channels])
    sides = [_side(recording, chosen) for recording in recordings]
    rows = [
        _compare(channel, sides[0].get(channel, {}), sides[1].get(channel, {}), allowed, skipped)
        for channel in dict.fromkeys((*sides[0], *sides[1]))
    ]
    same = all(row.only_left == row.only_right == row.different == 0 for row in rows)
    return RecordingDifference(same=same, left=str(left), right=str(right), channels=tuple(rows))


def _side(recording: Recording, selection: Selection) -> Side:
    messages: Side = {}
    for message in recording.select(selection):
        channel = messages.setdefault(message.channel, {})
        # A restarted publisher repeats its numbers.
        repetition = 0
        while (message.seq, repetition) in channel:
            repetition += 1
        channel[message.seq, repetition] = message
    return messages


def _compare(
    channel: RecordedChannel,
    left: dict[Key, RecordedMessage],
    right: dict[Key, RecordedMessage],
    tolerances: Tolerances,
    ignore: Iterable[str],
) -> ChannelDifference:
    different, first = 0, ""
    tolerances = tolerances.on(channel.topic)
    for key in left.keys() & right.keys():
        if left[key].payload == right[key].payload:
            continue
        difference = tolerances.first_difference(left[key].fields(), right[key].fields(), ignore)
        if difference is not None:
            different += 1
    for key in sorted(left.keys() & right.keys()) if different else ():
        difference = tolerances.first_difference(left[key].fields(), right[key].fields(), ignore)
        if difference is not None:
            first = f"seq {key[0]}: {difference.text}"
            break
    return ChannelDifference(
        channel=channel.channel_topic,
        src=channel.src,
        left=len(left),
        right=len(right),
        only_left=len(left.keys() - right.keys()),
        only_right=len(right.keys() - left.keys()),
        different=different,
        first=first,
    )
