"""A bus that compares the messages that a node publishes in a re-run with its recorded ones."""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import msgspec

from telenano.analysis.forwarded import ForwardedMessage, compare_forwarded
from telenano.recording.field_differences import Tolerances
from telenano.recording.messages import RecordedMessage
from telenano.rerun.rerun_inputs import NOT_COMPARED, RecordedNode, start_ns
from telenano.runtime.bus.publisher import version_of
from telenano.timing.clock import TurnClock
from telenano.wire import Message, compose
from telenano.wire.codec import fields_of
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.nodes import site_of
from telenano.wire.received import Received
from telenano.wire.topics import output_name


class DifferenceError(Exception):
    """A message of the re-run differs from the recorded one; `facts` are fields of `RerunResult`."""

    def __init__(self, **facts: Any) -> None:
        super().__init__(facts["difference"])
        self.facts = facts


class RerunBus:
    """A bus that compares each message that a node publishes with the recorded one of the same number."""

    def __init__(
        self,
        key: str,
        clock: TurnClock,
        recorded: RecordedNode,
        tolerances: Tolerances,
        take: Callable[[str, Message], None],
    ) -> None:
        self.numbers: dict[str, int] = {}
        self.compared: dict[str, int] = {}
        self.first_seq: dict[str, int] = {}
        self._forwarded: dict[str, list[ForwardedMessage]] = {}
        self._key = key
        self._clock = clock
        self._recorded = recorded
        self._tolerances = tolerances
        self._take = take

    def publish(self, topic: str, **fields: Any) -> Message:
        """Compare a message of the node with the recorded one; raise DifferenceError if it differs."""
        return self.publish_as(self._key, topic, fields)

    def publish_as(self, src: str, topic: str, fields: Mapping[str, Any]) -> Message:
        """Compare a message of one of the node's endpoints; raise DifferenceError if it differs.

        Its time of sending, `t_ns`, and its process, `run`, are copied from the recorded message, and so not compared.
        """
        name = output_name(topic, src)
        seq = self.numbers.get(name, 0)
        self.numbers[name] = seq + 1
        recorded = None if topic in NOT_COMPARED else self._recorded.output(name, seq, self._clock.time_ns)
        t_ns = self._clock.time_ns if recorded is None else recorded.publish_ns
        run = None if recorded is None else recorded.run
        header = {"seq": seq, "t_ns": t_ns, "src": src, "v": version_of(topic), "run": run}
        message, payload = compose(topic, {**header, **fields})
        if recorded is not None:
            self._compare(message, payload, recorded)
            self.compared[name] = self.compared.get(name, 0) + 1
            self.first_seq.setdefault(name, seq)
            self._take(topic, message)
        return message

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Keep a forwarded message for the comparison at the end."""
        self.numbers[endpoint] = self.numbers.get(endpoint, 0) + 1
        self._forwarded.setdefault(endpoint, []).append(ForwardedMessage(topic, payload, self._clock.time_ns))

    def compare_forwarded(self) -> dict[str, Any]:
        """Compare the forwarded messages in their order; return the facts of the first difference, {} without one."""
        for endpoint, sent in self._forwarded.items():
            differences = compare_forwarded(sent, self._recorded.forwarded.get(endpoint, ()))
            for topic, count in differences.compared.items():
                name = f"{topic}@{site_of(endpoint)}"
                self.compared[name], self.first_seq[name] = count, differences.first_seq[topic]
            if differences.difference:
                message = sent[differences.place]
                text = f"forwarded at {endpoint}: {differences.difference}"
                return self._difference(
                    message.topic, message.number[0], message.time_ns, differences.field, text
                ).facts
        return {}

    def receive(self) -> Iterator[Received]:
        """Return no messages, because the re-run passes them to the node itself."""
        return iter(())

    def wait(self, deadline_ns: int) -> None:
        """Return at once, because the re-run sets the time."""

    def check_counts(self, batch: NodeJournal) -> None:
        """Raise DifferenceError if the node has not sent as many messages as its journal counts before this batch."""
        for topic in sorted({*self.numbers, *batch.outputs}):
            if topic.partition("@")[0] in NOT_COMPARED:
                continue
            sent, expected = self.numbers.get(topic, 0), batch.outputs.get(topic, 0)
            if sent != expected:
                text = f"the node sends {sent} messages up to here, its journal counts {expected}"
                raise self._difference(topic, min(sent, expected), start_ns(batch), "", text)

    def _compare(self, message: Message, payload: bytes, recorded: RecordedMessage) -> None:
        if payload == recorded.payload:
            return
        topic, published, kept = recorded.topic, fields_of(message), fields_of(recorded.decode())
        difference = self._tolerances.on(topic).first_difference(published, kept, _keys_added_since(message, kept))
        if difference is not None:
            text = f"re-run {difference.text} recorded"
            raise self._difference(topic, message.seq, recorded.publish_ns, difference.field, text)

    def _difference(self, topic: str, seq: int, t_ns: int, field: str, text: str) -> DifferenceError:
        time_s = (t_ns - self._recorded.start_ns) * 1e-9
        place = f"{topic}, seq {seq}, {time_s:.6f} s after the start"
        return DifferenceError(difference=f"{place}: {text}", topic=topic, seq=seq, time_s=time_s, field=field)


class RerunOutlet:
    """A further endpoint of a node, at which it publishes and forwards messages of others."""

    def __init__(self, bus: RerunBus, endpoint: str) -> None:
        self.node = endpoint
        self._bus = bus

    def publish(self, topic: str, **fields: Any) -> Message:
        """Compare a message of the endpoint, see `RerunBus.publish_as`."""
        return self._bus.publish_as(self.node, topic, fields)

    def send(self, topic: str, payload: bytes) -> None:
        """Keep a forwarded message for the comparison."""
        self._bus.forward(self.node, topic, payload)

    def sequence_numbers(self) -> dict[str, int]:
        """Return no numbers, because the bus of the re-run counts them."""
        return {}


def _keys_added_since(message: Message, kept: Mapping[str, Any]) -> set[str]:
    """Return the keys that may differ from an older recording: optional keys that it lacks, and a higher version."""
    optional = [field.name for field in msgspec.structs.fields(type(message)) if not field.required]
    since = {key for key in optional if kept[key] is None}
    return since | {"v"} if message.v > kept["v"] else since
