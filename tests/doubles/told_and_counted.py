"""A check of recordings from outside: what a recording says is lost is what its numbers lack.

    python tests/doubles/told_and_counted.py session.mcap ...

It reads files with the plain libraries `mcap` and `msgpack`, and with nothing of this project:

- The numbers that a channel lacks are those that `recorder/gap` names. They are counted for each process (`run`) of the
  publisher, up to the count that it, or the link that carried it, announced at its end. They begin at 0 if an earlier
  process is in the file, except of consoles and emergency stops, which repeat a command until it is answered. Of a
  process of which only the end was heard, all that it announced is lacking.
- Number and stamp of a record are those of its message, and the stamps of a process do not go back.
- Every command that was answered is in the file, or its answer repeats it.
"""

import io
import struct
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import msgpack
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Metadata
from mcap.stream_reader import StreamReader, get_chunk_data_stream
from zstandard import ZstdError

# A gap is recorded once the late messages that may fill it would have come, and at the next flush [ns].
TOLD_NS = 1_000_000_000
# A stamp that is further from its reception is that of a replay [ns].
LIVE_NS = 30_000_000_000
# In virtual time the delay of sending each message of a turn is drawn, so that their stamps may cross [ns].
CROSSING_NS = 1_000_000
# Heads of a record and of a message in a chunk, and opcodes: the library takes ten times as long for each message.
RECORD, MESSAGE, CHANNEL_RECORD, MESSAGE_RECORD = struct.Struct("<BQ"), struct.Struct("<HIQQ"), 4, 5
Range = tuple[int, int]


class Seen(NamedTuple):
    """A message of a file."""

    channel: Channel
    seq: int
    log_ns: int
    publish_ns: int
    fields: dict[str, Any]


class Process:
    """The messages of one process of a publisher on one channel, by number: time of reception and stamp [ns]."""

    def __init__(self) -> None:
        self.seen: dict[int, tuple[int, int]] = {}
        self.newest = -1
        self.ended = False
        # One more than the last number that is known to have been sent, and when that was told [ns].
        self.sent = self.told_ns = 0

    def add(self, seq: int, log_ns: int, t_ns: int) -> None:
        self.seen.setdefault(seq, (log_ns, t_ns))
        self.newest = max(self.newest, seq)

    @property
    def is_live(self) -> bool:
        return all(abs(log_ns - t_ns) < LIVE_NS for log_ns, t_ns in list(self.seen.values())[:1])

    def lacking(self, *, head: bool) -> Iterator[tuple[Range, int]]:
        """Yield the ranges of numbers that are missing, each with the time at which that was noticed [ns]."""
        numbers = sorted(self.seen)
        if not numbers:
            if self.sent:
                yield (0, self.sent - 1), self.told_ns
            return
        if head and numbers[0] > 0:
            yield (0, numbers[0] - 1), self.seen[numbers[0]][0]
        for before, after in pairwise(numbers):
            if after > before + 1:
                yield (before + 1, after - 1), self.seen[after][0]
        if self.sent > numbers[-1] + 1:
            yield (numbers[-1] + 1, self.sent - 1), self.seen[numbers[-1]][0]


class Stream:
    """A channel: the processes of its publisher, by `run` or, without that key, in their order."""

    def __init__(self) -> None:
        self.counts_heads = True
        self.processes: dict[object, Process] = {}
        self._present: object = None

    @property
    def first(self) -> int:
        """The least number of its first process; 0 if only the end of that was heard."""
        return min(next(iter(self.processes.values())).seen, default=0)

    @property
    def present(self) -> Process | None:
        return self.processes.get(self._present)

    def add(self, one: Seen) -> None:
        seq, t_ns, run = one.fields["seq"], one.fields["t_ns"], one.fields.get("run")
        process = self.present
        if run is not None:
            self._present = run
        elif process is None or (t_ns > process.seen[process.newest][1] and (seq <= process.newest or process.ended)):
            # Without the key, the numbers of a later process are known by their later stamps.
            self._present = -1 - len(self.processes)
        self.processes.setdefault(self._present, Process()).add(seq, one.log_ns, t_ns)

    def end(self, run: int | None, sent: int, told_ns: int, *, own: bool) -> None:
        """Note that the present process, or that of a `run`, has sent a count of messages; `own`: and has ended."""
        if run is not None and run not in self.processes:
            self._present, self.processes[run] = run, Process()
        process = self.present if run is None else self.processes[run]
        if process is not None and not process.ended:
            process.sent, process.ended, process.told_ns = max(process.sent, sent), own, told_ns

    def lacking(self) -> list[tuple[Range, int]]:
        return [
            part
            for place, (run, one) in enumerate(self.processes.items())
            for part in one.lacking(head=place > 0 and self.counts_heads and isinstance(run, int) and run >= 0)
        ]

    def going_back(self) -> Iterator[str]:
        for process in self.processes.values():
            if process.is_live:
                stamps = [(seq, process.seen[seq][1]) for seq in sorted(process.seen)]
                back = [seq for (_, before), (seq, t_ns) in pairwise(stamps) if t_ns < before - CROSSING_NS]
                yield from [f"the stamp of {back[0]} is earlier than that of the number before"] if back else []


class Account:
    """What the messages of a recording amount to: by channel and source, its stream and what is told to be missing."""

    def __init__(self, seen: Iterable[Seen]) -> None:
        self.streams: dict[tuple[str, str], Stream] = defaultdict(Stream)
        self.told: dict[tuple[str, str], list[Range]] = defaultdict(list)
        # Those that are told before the first message of the channel: they may be of an earlier file.
        self.told_before: dict[tuple[str, str], list[Range]] = defaultdict(list)
        self.asked, self.answered = set[str](), dict[str, str]()
        self.faults = list[str]()
        for one in seen:
            self._add(one)

    def _add(self, one: Seen) -> None:
        fields, (topic, src, site) = one.fields, (one.channel.metadata[key] for key in ("topic", "src", "site"))
        if topic == "recorder/gap":
            gap = (fields["first_missing"], fields["last_missing"])
            place = fields["channel_topic"], fields["src"]
            self.told[place].append(gap)
            if place not in self.streams:
                self.told_before[place].append(gap)
        if topic.startswith("recorder/"):
            return
        if (one.seq, one.publish_ns, src) != (fields["seq"] % 2**32, fields["t_ns"], fields["src"]):
            self.faults.append(f"{one.channel.topic} {src}: {one.seq} is recorded as another message")
        self.streams[one.channel.topic, src].add(one)
        self.streams[one.channel.topic, src].counts_heads = not src.startswith(("console", "estop"))
        if topic == "session/control":
            self.asked.add(fields["id"])
        elif topic == "session/event":
            if fields.get("kind") in ("ack", "refused") and fields.get("id") and not _repeats(fields["data"]):
                self.answered[fields["id"]] = src
            for place, run, count in _sent(one, site):
                if place in self.streams:
                    own = place[1] == src
                    self.streams[place].end(run if own else None, count, one.log_ns, own=own)


def lacking(*paths: Path) -> dict[tuple[str, str], int]:
    """Return how many numbers the files of a recording lack, by channel and source; of none without one."""
    account = Account(one for path in paths for one in _read(path)[0])
    counts = {
        place: sum(last + 1 - first for (first, last), _ in stream.lacking())
        for place, stream in account.streams.items()
    }
    return {place: count for place, count in counts.items() if count}


def channels(path: Path) -> set[tuple[str, str]]:
    """Return channel and source of every message of a file."""
    return {(one.channel.topic, one.channel.metadata["src"]) for one in _read(path)[0]}


def told(*paths: Path) -> dict[tuple[str, str], int]:
    """Return how many numbers the files of a recording say to lack, by channel and source."""
    account = Account(one for path in paths for one in _read(path)[0])
    return {place: sum(last + 1 - first for first, last in gaps) for place, gaps in account.told.items()}


def check(path: Path, *, commands: bool = True) -> list[str]:
    """Return a sentence on each fault of a recording; empty if what it tells is what an outsider counts.

    `commands`: whether every answered command has to be there, as in the recording of a rig of this version.
    """
    seen, closed = _read(path)
    account = Account(seen)
    faults, told = account.faults, account.told
    last_ns = max((one.log_ns for one in seen), default=0)
    for place, stream in sorted(account.streams.items()):
        name, lacks = " ".join(place), stream.lacking()
        every = [part for part, _ in lacks]
        # The newest gaps of a file that was not closed may not be recorded yet.
        sure = every if closed else [part for part, noticed_ns in lacks if noticed_ns < last_ns - TOLD_NS]
        faults += [f"{name}: {first} to {last} are missing and not told" for first, last in _more(sure, told[place])]
        # A further file may tell of what was noticed in the one before.
        false = [part for part in _more(told[place], [*every, *account.told_before[place]]) if part[1] >= stream.first]
        faults += [f"{name}: {first} to {last} are told to be missing" for first, last in false]
        faults += [f"{name}: {text}" for text in stream.going_back()]
    if commands:
        unknown = [name for name in account.answered if name not in account.asked]
        faults += [
            f"{account.answered[name]} answered the command {name}, which is not in the file" for name in unknown
        ]
    return [f"{path.name}: {text}" for text in faults]


def _repeats(data: Any) -> bool:
    """Return whether the data of an answer repeat its command, which may not have reached the recorder."""
    texts = (data.get(key) for key in ("command", "target", "giver")) if isinstance(data, dict) else [None]
    return all(isinstance(text, str) for text in texts)


def _sent(one: Seen, site: str) -> Iterator[tuple[tuple[str, str], int | None, int]]:
    """Yield channel and source, process and count of each entry of an end message that came directly."""
    data = one.fields.get("data")
    if one.channel.metadata["via"] != "direct" or not isinstance(data, dict) or data.get("state") != "ended":
        return
    for key, count in data.items():
        if key.startswith("sent."):
            topic, _, source = key.removeprefix("sent.").partition(".")
            src = source or one.fields["src"]
            is_home = src.endswith(f"@{site}")
            if source and is_home:
                # The link has no channel of its own for what a node at this site sends.
                continue
            yield (topic if is_home else f"{topic}@{site}", src), one.fields.get("run"), count


def _more(these: Iterable[Range], those: Iterable[Range]) -> list[Range]:
    """Return the ranges of numbers that are more often in these ranges than in those."""
    steps = Counter[int]()
    for ranges, sign in ((these, 1), (those, -1)):
        for first, last in ranges:
            steps[first] += sign
            steps[last + 1] -= sign
    found, depth, begin = list[Range](), 0, 0
    for at in sorted(steps):
        before, depth = depth, depth + steps[at]
        if before <= 0 < depth:
            begin = at
        elif depth <= 0 < before:
            found.append((begin, at - 1))
    return found


def _read(path: Path) -> tuple[list[Seen], bool]:
    """Return the messages in the order of the file, and whether it was closed; a cut file is read up to the cut."""
    channels, seen, closed = dict[int, Channel](), list[Seen](), False
    with path.open("rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, Metadata):
                    closed = closed or record.name == "end"
                elif isinstance(record, Chunk):
                    data, end = get_chunk_data_stream(record)[0].read(record.uncompressed_size), 0
                    while end < len(data):
                        (opcode, size), start = RECORD.unpack_from(data, end), end + RECORD.size
                        end = start + size
                        if opcode == CHANNEL_RECORD:
                            channel = Channel.read(ReadDataStream(io.BytesIO(data[start:end])))
                            channels[channel.id] = channel
                        elif opcode == MESSAGE_RECORD:
                            number, seq, log_ns, publish_ns = MESSAGE.unpack_from(data, start)
                            fields = msgpack.unpackb(data[start + MESSAGE.size : end], use_list=False)
                            seen.append(Seen(channels[number], seq, log_ns, publish_ns, fields))
        except (McapError, EOFError, ValueError, ZstdError, struct.error):
            return seen, False
    return seen, closed


if __name__ == "__main__":
    found = [text for name in sys.argv[1:] for text in check(Path(name))]
    sys.stdout.write("".join(f"{text}\n" for text in found) or "told is counted\n")
    sys.exit(bool(found))
