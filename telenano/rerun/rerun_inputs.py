"""The data of one node in a recording: its journal turn by turn, its inputs, and its outputs by number."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, cast

import numpy as np
import numpy.typing as npt

from telenano.analysis.forwarded import ForwardedMessage
from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.reader import Recording
from telenano.recording.records import REJECTED_TOPIC, RejectedRecord
from telenano.runtime.loop.journal import COMMAND, MESSAGE
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.nodes import LINK, endpoints_of, name_of, site_of
from telenano.wire.topics import output_name

Integers = npt.NDArray[np.int64]
JOURNAL = "node/journal"
# Topics that are not compared, because the loop around the node also publishes on them, with the same numbering.
NOT_COMPARED = (JOURNAL, "node/health", "session/event", "link/key", "link/network")


class Turn(NamedTuple):
    """A row of the journal; for a deadline or a deferred task, topic and source are empty and seq is -1."""

    kind: int
    time_ns: int
    topic: str
    src: str
    seq: int


class RecordedNode:
    """The recorded inputs and outputs of one node, by number."""

    def __init__(self, recording: Recording, key: str, batches: Sequence[NodeJournal]) -> None:
        self.path, self.key = recording.path, key
        self.start_ns = recording.span_ns[0]
        self.outputs: dict[tuple[str, int], list[RecordedMessage]] = {}
        # The forwarded messages by endpoint.
        self.forwarded: dict[str, list[ForwardedMessage]] = {}
        self._inputs: dict[tuple[str, str, int], list[RecordedMessage]] = {}
        self._repeated_ns = _repeated_ns(batches)
        # Times at which the recorder first and last received from a topic and source [ns].
        self._first_received_ns: dict[tuple[str, str], int] = {}
        self._last_received_ns: dict[tuple[str, str], int] = {}
        sources = {(source.topic, source.src) for batch in batches for source in batch.inputs}
        endpoints, is_link = endpoints_of(key), name_of(key) == LINK

        def is_input(channel: RecordedChannel) -> bool:
            # The link is connected to the publishers of both sites.
            received = channel.via == "direct" if is_link else channel.site == site_of(key)
            return received and (channel.topic, channel.src) in sources

        def is_output(channel: RecordedChannel) -> bool:
            return channel.src in endpoints and channel.via == "direct" and channel.topic not in NOT_COMPARED

        def is_forwarded(channel: RecordedChannel) -> bool:
            return is_link and (channel.via == "link" or channel.topic == REJECTED_TOPIC)

        inputs, outputs, forwarded = (
            {channel for channel in recording.channels if wanted(channel)}
            for wanted in (is_input, is_output, is_forwarded)
        )
        for message in recording.select((inputs | outputs | forwarded).__contains__):
            channel = message.channel
            if channel in inputs:
                self._inputs.setdefault((channel.topic, channel.src, message.seq), []).append(message)
                self._first_received_ns.setdefault((channel.topic, channel.src), message.log_ns)
                self._last_received_ns[channel.topic, channel.src] = message.log_ns
            if channel in outputs:
                self.outputs.setdefault((output_name(channel.topic, message.src), message.seq), []).append(message)
            if channel in forwarded:
                self._add_forwarded(message)

    def _add_forwarded(self, message: RecordedMessage) -> None:
        endpoint, topic, payload = f"{LINK}@{message.site}", message.topic, message.payload
        if topic == REJECTED_TOPIC:
            # Flipped bits have destroyed the header of this message.
            rejected = cast(RejectedRecord, message.decode())
            if name_of(rejected.publisher) != LINK or len(rejected.frames) != 2:
                return
            endpoint, (frame, payload) = rejected.publisher, rejected.frames
            topic = frame.decode(errors="replace")
        self.forwarded.setdefault(endpoint, []).append(ForwardedMessage(topic, payload, message.log_ns))

    def input(self, turn: Turn) -> RecordedMessage | None:
        """Return the message of a turn, None if it is not recorded.

        Of several with the same number, from before and after a restart, it is the nearest in time, unless that is
        nearer to another turn: each console begins with number 0, and the recorder may not have heard all of them.
        """
        key = (turn.topic, turn.src, turn.seq)
        inputs = self._inputs.get(key, ())
        nearest = min(inputs, key=lambda message: abs(message.log_ns - turn.time_ns), default=None)
        if nearest is None:
            return None
        apart_ns = abs(nearest.log_ns - turn.time_ns)
        is_of_another = any(abs(nearest.log_ns - time_ns) < apart_ns for time_ns in self._repeated_ns.get(key, ()))
        return None if is_of_another else nearest

    def payload(self, topic: str, src: str, seq: int, arrived_ns: int, size_bytes: int) -> bytes:
        """Return the bytes of an input; `size_bytes` zeros if it is not in the recording."""
        message = self.input(Turn(MESSAGE, arrived_ns, topic, src, seq))
        return bytes(size_bytes) if message is None else message.payload

    def output(self, name: str, seq: int, time_ns: int) -> RecordedMessage | None:
        """Return the recorded output with a name and number; of several the nearest in time, None if there is none."""
        outputs = self.outputs.get((name, seq), ())
        if len(outputs) == 1:
            return outputs[0]
        return min(outputs, key=lambda message: abs(message.publish_ns - time_ns), default=None)

    def missing(self, batch: NodeJournal) -> str:
        """Return the first missing input of a batch as text; empty if all are recorded."""
        missing_part = next(self._missing(batch), None)
        return "" if missing_part is None else f"{missing_part.topic}, seq {missing_part.seq} of {missing_part.src}"

    def has_ended(self, turn: Turn) -> bool:
        """Return whether the recording has messages of the source of a turn, and all of them from before that turn."""
        last_ns = self._last_received_ns.get((turn.topic, turn.src))
        return last_ns is not None and last_ns < turn.time_ns

    def is_early(self, batch: NodeJournal) -> bool:
        """Return whether a batch lacks an input from before the recorder was connected to its publisher."""
        missing = ((turn.time_ns, self._first_received_ns.get((turn.topic, turn.src))) for turn in self._missing(batch))
        return any(first_ns is not None and time_ns < first_ns for time_ns, first_ns in missing)

    def _missing(self, batch: NodeJournal) -> Iterator[Turn]:
        return (turn for turn in turns_of(batch) if turn.src and self.input(turn) is None)


def _repeated_ns(batches: Sequence[NodeJournal]) -> dict[tuple[str, str, int], list[int]]:
    """Return the times [ns] of the turns whose message has a number that its source used more than once."""
    of_source: dict[tuple[str, str], list[tuple[Integers, Integers]]] = {}
    for batch in batches:
        places, numbers, times_ns = (column.to_numpy() for column in (batch.input, batch.number, batch.time_ns))
        for place, source in enumerate(batch.inputs):
            own = places == place
            of_source.setdefault((source.topic, source.src), []).append((numbers[own], times_ns[own]))
    found: dict[tuple[str, str, int], list[int]] = {}
    for (topic, src), parts in of_source.items():
        numbers, times_ns = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(numbers, kind="stable")
        values, first, counts = np.unique(numbers[order], return_index=True, return_counts=True)
        for seq, begin, count in zip(*(column[counts > 1].tolist() for column in (values, first, counts)), strict=True):
            found[topic, src, seq] = times_ns[order[begin : begin + count]].tolist()
    return found


def start_ns(batch: NodeJournal) -> int:
    """Return the time of the first turn of a batch [ns]."""
    return int(batch.time_ns.to_numpy()[0])


def turns_of(batch: NodeJournal) -> Iterator[Turn]:
    """Yield the turns of a batch, in their order."""
    arrays = (batch.kind, batch.time_ns, batch.input, batch.number)
    for kind, time_ns, place, seq in zip(*(array.to_numpy().tolist() for array in arrays), strict=True):
        source = batch.inputs[place] if kind in (MESSAGE, COMMAND) else None
        yield Turn(kind, time_ns, source.topic if source else "", source.src if source else "", seq)
