"""What a node has published lately, in one message: the way to a recorder beside it, which takes everything.

The bus itself is unchanged: each message is sent at once on its own topic to whoever subscribes to that. A node of the
loop keeps a copy of it for some milliseconds and sends these copies together on `node/batch`, in the order of sending,
each with its time, topic frame and payload as they were. A recorder on the same machine takes them in the place of the
messages, so that the loop pays once for ten.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import msgpack
import msgspec

from proto.codec import WireError

BATCH_TOPIC = "node/batch"
BATCH_FRAME = BATCH_TOPIC.encode()
_VERSION = 1
# The limit is far above what a publisher keeps, and a small part of what would fit into the longest frame.
MOST_COPIES = 4096
_Int64 = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]


class SentCopy(NamedTuple):
    """When a message was sent, on the monotonic clock of the machine [ns], and its two frames."""

    sent_ns: _Int64
    topic: bytes
    payload: bytes


class Batch(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Copies in the order of sending; `last`: the publisher closes, and sends no further batch."""

    v: int
    sent: Annotated[list[SentCopy], msgspec.Meta(max_length=MOST_COPIES)]
    last: bool


_decode = msgspec.msgpack.Decoder(Batch).decode


def pack_batch(sent: Sequence[SentCopy], *, last: bool = False) -> bytes:
    """Return the msgpack bytes of a batch."""
    payload: bytes = msgpack.packb({"v": _VERSION, "sent": sent, "last": last})
    return payload


def read_batch(payload: bytes) -> Batch:
    """Return a batch; WireError (`newer_version`, `malformed`) for anything else. The copies are as they came."""
    # Every key is needed and no other is known, so that one which comes twice shows in their number.
    if (count := _keys_of(payload)) > len(Batch.__struct_fields__):
        raise WireError("malformed", f"{BATCH_TOPIC} has {count} keys, a key twice or one that is not known")
    try:
        batch = _decode(payload)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise WireError("malformed", f"{BATCH_TOPIC} is not a batch of messages: {error}") from error
    if batch.v != _VERSION:
        raise WireError("newer_version", f"{BATCH_TOPIC} has version {batch.v}, {_VERSION} is known")
    return batch


def _keys_of(payload: bytes) -> int:
    """Return how many keys the map has that a payload begins with; 0 where it begins with something else."""
    head = payload[0] if payload else 0
    if head & 0xF0 == 0x80:
        return head & 0x0F
    size = {0xDE: 2, 0xDF: 4}.get(head, 0)
    return int.from_bytes(payload[1 : 1 + size])
