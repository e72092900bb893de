"""The message in which a node says in which order it took its inputs and deadlines."""

from typing import Annotated

from pydantic import FailFast, Field

from telenano.wire.messages import MAX_ITEMS, Array, Count, Counts, Message, Record, Source, Text


class JournalInput(Record):
    """An input of a node: a topic from a source."""

    topic: Text = Field(description="Topic")
    src: Source = Field(description="Publisher, node@site")


class NodeJournal(Message):
    """In which order a node took its inputs and deadlines: what a re-run of the node follows.

    A turn is one message, deadline or deferred task, acted on at one time. The arrays have one element a turn.
    """

    first_turn: Count = Field(description="Number of the first turn, counted from 0 at the start of the node")
    epoch_offset_ns: Annotated[int, Field(ge=-(2**63), le=2**63 - 1)] = Field(
        description="What the node's clock is ahead of its monotonic clock [ns]"
    )
    inputs: Annotated[tuple[JournalInput, ...], FailFast(), Field(max_length=MAX_ITEMS)] = Field(
        description="What `input` counts in, from 0"
    )
    outputs: Counts = Field(description="seq of the next message on each topic of the node, before the first turn")
    kind: Array = Field(
        description="u1: 0 deadline, 1 message, 2 message whose command the node carried out, 3 deferred task"
    )
    time_ns: Array = Field(description="i8: time of the turn on the node's clock [ns]; of a message: its reception")
    input: Array = Field(description="i2: which of `inputs` the message came from; -1 for a deadline or task")
    number: Array = Field(description="i8: seq of the message; -1 for a deadline or task")
    state: Array = Field(
        description="u1: state of the node before the first turn, for the re-run only; empty when it has none. A larger"
        " one goes on in the next messages of this first_turn, which have no turns"
    )
