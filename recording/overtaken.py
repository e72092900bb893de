"""Messages that stand in a file behind later ones of their publisher, and the places where they belong.

What one publisher sends on one topic reaches a recorder at the publisher's site on one connection, in the order of its
numbers. A file may have it in another order all the same: a recorder that is given single messages and then a batch
that begins before them writes what was sent first behind what was sent last. A lower number with an earlier or equal
time of sending is such a message; with a later one it is the first of a publisher that was started again.

Messages that overtook one another on the link are none of these: there the order of reception is the measurement.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.opcode import Opcode

from recording.mcap_scan import MESSAGE_HEAD, records_of

# the messages between an overtaken one and its place were all in one batch, which has 64 KiB of payload and one message
# at most, and no payload is shorter than the 40 bytes of its header: 1640 messages
_WINDOW = 2048
# Messages that a player repeats after it was set back are not overtaken messages, see proto/sequence.py.
_REWIND_RUN, _REWIND_NS = 8, 1_000_000_000
# A file with more than this was not written by a recorder, and the rest stays where it is.
_MOST_MOVED = 100_000
_UNKNOWN = (-1, -1)


class Place(NamedTuple):
    """Where a message is: offset of its block in the file, and of its record in the block."""

    block: int
    at: int


class Stamp(NamedTuple):
    """Number, time of sending [ns] and place of a message."""

    seq: int
    t_ns: int
    place: Place


@dataclass
class BlockOrder:
    """What is different in one block: places that are left out, and what comes before others."""

    left_out: set[int] = field(default_factory=set)
    before: dict[int, list[Place]] = field(default_factory=dict)


class _Stream:
    """The messages of one channel of one process so far: the newest, and as many before it as can be overtaken."""

    def __init__(self) -> None:
        # The window is in the order of the numbers, and each has the place in the file at which it is read.
        self.window: deque[tuple[Stamp, Place]] = deque(maxlen=_WINDOW)
        # It stays true until a message of this process leaves the window.
        self.whole = True
        # old messages in a row
        self.old: list[Stamp] = []

    def append(self, stamp: Stamp) -> None:
        self.whole = self.whole and len(self.window) < _WINDOW
        self.window.append((stamp, stamp.place))

    def restart(self, stamps: Iterable[Stamp]) -> None:
        self.window.clear()
        self.whole, self.old = True, []
        for stamp in stamps:
            self.append(stamp)

    @property
    def newest(self) -> Stamp | None:
        return self.window[-1][0] if self.window else None

    def place_old(self) -> Iterator[tuple[Stamp, Place]]:
        """Yield the old messages with the places before which they belong; what has none stays where it is."""
        old, self.old = self.old, []
        if not old:
            return
        numbers = [stamp.seq for stamp, _ in self.window]
        if _is_rewind(old, numbers, newest_ns=self.window[-1][0].t_ns):
            self.restart(old)
            return
        entries = list(self.window)
        for stamp in old:
            index = bisect_left(numbers, stamp.seq)
            if index == len(entries) or numbers[index] == stamp.seq or (index == 0 and not self.whole):
                continue
            before_ns = entries[index - 1][0].t_ns if index else stamp.t_ns
            if before_ns <= stamp.t_ns <= entries[index][0].t_ns:
                anchor = entries[index][1]
                numbers.insert(index, stamp.seq)
                entries.insert(index, (stamp, anchor))
                yield stamp, anchor
        self.window = deque(entries, maxlen=_WINDOW)


def _is_rewind(old: Sequence[Stamp], numbers: Sequence[int], *, newest_ns: int) -> bool:
    """Return whether there is a run of old messages that were received before, or are far before all of the window.

    A batch that begins before the window ends at it or in it. `numbers` are in the window, in order, and newest_ns [ns]
    is when the newest of them was sent.
    """
    known, run, previous = set(numbers), 0, -1
    joins = any(stamp.seq == numbers[0] - 1 for stamp in old)
    for stamp in old:
        repeats = stamp.seq in known or (stamp.seq < numbers[0] and not joins)
        counts = repeats and newest_ns - stamp.t_ns > _REWIND_NS
        run = 0 if not counts else run + 1 if stamp.seq == previous + 1 else 1
        previous = stamp.seq
        if run >= _REWIND_RUN:
            return True
    return False


class OvertakenFinder:
    """Finds the overtaken messages of a file in one pass over the heads of its messages.

    Only a channel that was seen to have old messages needs more than its newest number: `suspects` has those channels,
    by their number in the file, after `scan` was given every block, and `place` is then given every block again.
    """

    def __init__(self) -> None:
        self.suspects: set[int] = set()
        # number and time of sending [ns] of the newest message; None for a channel that is not looked at
        self._newest: dict[int, tuple[int, int] | None] = {}
        self._streams: dict[int, _Stream] = {}
        self._moved: dict[Place, list[tuple[int, Place]]] = {}
        self._count = 0

    def scan(self, content: bytes, is_numbered: Callable[[int], bool]) -> Iterator[tuple[int, int, int]]:
        """Look for old messages in a block; yield what else is in it, as `records_of` does.

        Args:
            content: The bytes of the block.
            is_numbered: Whether a channel has the numbers of one publisher in the order of sending.
        """
        newest, head = self._newest, MESSAGE_HEAD.unpack_from
        for opcode, start, end in records_of(content):
            if opcode != Opcode.MESSAGE:
                yield opcode, start, end
                continue
            channel, seq, _, t_ns = head(content, start)
            last = newest.get(channel, _UNKNOWN)
            if last is _UNKNOWN:
                newest[channel] = (seq, t_ns) if is_numbered(channel) else None
            elif last is not None:
                if seq > last[0] or t_ns > last[1]:
                    newest[channel] = seq, t_ns
                else:
                    self.suspects.add(channel)

    def place(self, block: int, content: bytes) -> None:
        """Find the places of the old messages among those of a block, which is at this offset."""
        for opcode, start, _ in records_of(content):
            if opcode == Opcode.MESSAGE:
                channel, seq, _, t_ns = MESSAGE_HEAD.unpack_from(content, start)
                if channel in self.suspects:
                    self._add(self._streams.setdefault(channel, _Stream()), Stamp(seq, t_ns, Place(block, start)))

    def finish(self) -> dict[int, BlockOrder]:
        """Return what is different, by the offset of the block."""
        blocks: dict[int, BlockOrder] = {}
        for stream in self._streams.values():
            self._settle(stream)
        for before, moved in self._moved.items():
            blocks.setdefault(before.block, BlockOrder()).before[before.at] = [place for _, place in sorted(moved)]
            for _, place in moved:
                blocks.setdefault(place.block, BlockOrder()).left_out.add(place.at)
        return blocks

    def _add(self, stream: _Stream, stamp: Stamp) -> None:
        newest = stream.newest
        if newest is None or (stamp.seq > newest.seq and not stream.old):
            stream.append(stamp)
        elif stamp.seq <= newest.seq and stamp.t_ns <= newest.t_ns:
            stream.old.append(stamp)
            if len(stream.old) > _WINDOW:
                # a player that was set back
                stream.restart(stream.old)
        elif stream.old:
            self._settle(stream)
            self._add(stream, stamp)
        else:
            stream.restart((stamp,))

    def _settle(self, stream: _Stream) -> None:
        for stamp, before in stream.place_old():
            if self._count < _MOST_MOVED:
                self._count += 1
                self._moved.setdefault(before, []).append((stamp.seq, stamp.place))
