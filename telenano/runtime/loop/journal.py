"""The input journal of a node: the order in which it handled messages and deadlines, published in batches."""

from array import array
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from telenano.timing.clock import TurnClock
from telenano.wire.journal_messages import JournalInput
from telenano.wire.messages import Array
from telenano.wire.node_state import pack
from telenano.wire.received import Received

# The kinds of turns.
DEADLINE = 0
MESSAGE = 1
COMMAND = 2
DEFERRED = 3
# Number of turns in a message: some 80 kB, and below the limit for any number of sources.
_BATCH = 4096
# Most bytes of a state in a message: half of the limit of a message.
_STATE_PIECE = 1 << 19
# Greatest mean rate at which states are published [bytes/s].
_STATE_BYTES_PER_S = 1 << 20


class _Batch(NamedTuple):
    """A complete batch; `state` and `outputs` are those before its first turn.

    The further pieces of a large state are batches without turns.
    """

    first_turn: int
    sources: Iterable[tuple[str, str]]
    outputs: dict[str, int]
    state: bytes
    kind: "array[int]"
    time_ns: "array[int]"
    input: "array[int]"
    number: "array[int]"


class InputJournal:
    """Records the turns of a node, and gives it `clock`, which stands still during a turn.

    Each batch begins with the state of the node and the numbers of its next outputs, so that a re-run can begin at any
    batch: the recorder may connect late, and a recording may be cut. A state too large for one message continues in
    messages without turns, and is captured less often.
    """

    def __init__(self, node: Any, sequence_numbers: Callable[[], dict[str, int]]) -> None:
        """Begin with the initial state of the node, and replace its clock.

        Args:
            node: The node.
            sequence_numbers: Returns the seq of the next message on each topic of the node's bus.
        """
        clock = node.context.clock
        self.clock = TurnClock(clock.now_ns(), clock.epoch_offset_ns)
        self._node = node
        self._sequence_numbers = sequence_numbers
        self._first_turn = 0
        self._next_state_ns = 0
        self._refused: set[str] = set()
        self._complete: deque[_Batch] = deque()
        self._begin()
        node.clock = self.clock

    @property
    def full(self) -> bool:
        """Whether a batch has all its turns."""
        return len(self._kind) >= _BATCH

    def record_turn(self, kind: int) -> None:
        """Record a deadline or a deferred task (`kind`) that was handled at the time of the clock."""
        self._kind.append(kind)
        self._time_ns.append(self.clock.time_ns)
        self._input.append(-1)
        self._number.append(-1)

    def record_message(self, received: Received, *, executed: bool) -> None:
        """Record a message that was handled at its time of reception; `executed`: the node executed its command."""
        message = received.message
        source = (received.topic, message.src)
        place = self._sources.get(source)
        if place is None:
            place = self._sources[source] = len(self._sources)
        self._kind.append(COMMAND if executed else MESSAGE)
        self._time_ns.append(received.received_ns)
        self._input.append(place)
        self._number.append(message.seq)

    def complete(self) -> None:
        """End the batch if it has turns, and begin a new one."""
        if self._kind:
            arrays = (self._kind, self._time_ns, self._input, self._number)
            first = self._first_turn
            self._complete.append(_Batch(first, self._sources, self._outputs, self._state[:_STATE_PIECE], *arrays))
            for begin in range(_STATE_PIECE, len(self._state), _STATE_PIECE):
                piece = self._state[begin : begin + _STATE_PIECE]
                self._complete.append(_Batch(first, (), {}, piece, array("B"), array("q"), array("h"), array("q")))
            self._first_turn += len(self._kind)
            self._begin()

    def end(self) -> None:
        """End the batch, and send all complete batches."""
        self.complete()
        while self.publish():
            pass

    def publish(self) -> bool:
        """Send the next complete batch; return whether there are more."""
        if self._complete:
            batch = self._complete[0]
            arrays = (batch.kind, batch.time_ns, batch.input, batch.number, np.frombuffer(batch.state, dtype=np.uint8))
            kind, time_ns, place, number, state = (Array.from_numpy(np.asarray(column)) for column in arrays)
            self._node.publish(
                "node/journal",
                first_turn=batch.first_turn,
                epoch_offset_ns=self.clock.epoch_offset_ns,
                inputs=tuple(JournalInput(topic=topic, src=src) for topic, src in batch.sources),
                outputs=batch.outputs,
                kind=kind,
                time_ns=time_ns,
                input=place,
                number=number,
                state=state,
            )
            # A batch that could not be sent is sent with the next one.
            self._complete.popleft()
        return bool(self._complete)

    def _begin(self) -> None:
        self._sources: dict[tuple[str, str], int] = {}
        self._kind, self._time_ns = array("B"), array("q")
        self._input, self._number = array("h"), array("q")
        self._outputs = {**self._sequence_numbers(), **self._node.further_outputs()}
        self._state = self._captured()

    def _captured(self) -> bytes:
        """Return the encoded state of the node; empty if it has none, or too soon after a large one."""
        if self.clock.time_ns < self._next_state_ns:
            return b""
        try:
            state = pack(self._node)
        except (AttributeError, TypeError, ValueError, OverflowError) as error:
            if str(error) not in self._refused:
                self._refused.add(str(error))
                text = f"the state of this node was not recorded, so that no re-run can begin here: {error}"
                self._node.event("node", "warning", text)
            return b""
        if len(state) > _STATE_PIECE:
            self._next_state_ns = self.clock.time_ns + len(state) * 10**9 // _STATE_BYTES_PER_S
        return state
