"""The message in which a node reports the order of its inputs and deadlines, for a re-run from a recording."""

from typing import Annotated

from telenano.wire.messages import MAX_ITEMS, Array, Count, Counts, Message, Record, Source, Text, about


class JournalInput(Record):
    """An input of a node: a topic from a source."""

    topic: Annotated[Text, about("Topic")]
    src: Annotated[Source, about("Publisher, node@site")]


class NodeJournal(Message):
    """Order in which a node took its inputs and deadlines, which a re-run of the node follows.

    A turn is one message, deadline or deferred task, acted on at one time. The arrays have one element a turn.
    """

    first_turn: Annotated[Count, about("Number of the first turn, counted from 0 at the start of the node")]
    epoch_offset_ns: Annotated[int, about("Node's clock minus its monotonic clock [ns]", ge=-(2**63), le=2**63 - 1)]
    inputs: Annotated[
        tuple[JournalInput, ...], about("Table to which `input` is the index, from 0", max_length=MAX_ITEMS)
    ]
    outputs: Annotated[Counts, about("seq of the next message on each topic of the node, before the first turn")]
    kind: Annotated[
        Array, about("u1: 0 deadline, 1 message, 2 message whose command the node carried out, 3 deferred task")
    ]
    time_ns: Annotated[Array, about("i8: time of the turn on the node's clock [ns]; of a message: its reception")]
    input: Annotated[Array, about("i2: index in `inputs` of the source of the message; -1 for a deadline or task")]
    number: Annotated[Array, about("i8: seq of the message; -1 for a deadline or task")]
    state: Annotated[
        Array,
        about(
            "u1: state of the node before the first turn, for the re-run only; empty when it has none. A state too "
            "large for one message continues in the next ones of this first_turn, which have no turns"
        ),
    ]
