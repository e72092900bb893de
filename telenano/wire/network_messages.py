"""The messages of the link between two machines: its keys, and what the network did."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from telenano.wire.messages import Array, Count, Counts, LinkClock, Message, _Extended
from telenano.wire.ranges import DurationS


class LinkKey(_Extended):
    """The public key of one end of the link between two machines, for the keys of its datagrams, and what it received.

    It crosses over TCP both ways, so that each end knows what arrives of its datagrams where none comes back.
    """

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = dict.fromkeys(
        ("receiving", "sent", "arrived", "lost", "capacity_bit_per_s"), 2
    )

    public_key: str = Field(pattern=r"^[0-9a-f]{64}$", description="Ephemeral X25519 key of this end, in hexadecimal")
    answers: str = Field(
        pattern=r"^([0-9a-f]{64})?$", description="Key of the other end that it is the answer to; empty = none"
    )
    receiving: Literal["datagram", "stream"] | None = Field(
        default=None, description="How this end receives the samples of the other one now"
    )
    sent: Count | None = Field(default=None, description="Datagrams that this end has sent under its present keys")
    arrived: Count | None = Field(default=None, description="Datagrams that arrived here under the present keys")
    lost: Count | None = Field(
        default=None, description="Datagrams sent to here before the newest of those, which have not arrived"
    )
    capacity_bit_per_s: Count | None = Field(
        default=None, description="What this end has measured of the line to here [bit/s]; 0 = not known"
    )


class RecordingPiece(Message):
    """A piece of a recording of the other site, sent on request (ADR 0075)."""

    file: str = Field(max_length=255, description="Name of the file, without any folder")
    size_bytes: Count = Field(description="Size of the file when the piece was read [bytes]")
    head_sha256: str = Field(max_length=64, description="Digest of the first 1024 bytes, which identify the file")
    offset_bytes: Count = Field(description="Place of the piece in the file [bytes]")
    sha256: str = Field(max_length=64, description="Digest of the piece")
    data: Array = Field(description="u1: the piece, empty at the end of the file")


class LinkNetwork(_Extended):
    """What the network between two machines did to the datagrams of one direction, as their receiver saw it.

    The arrays have one element a datagram, in the order in which its fate was known: the ground truth of a real
    network, as link/fates is that of an injected one. One-way delays rest on `clock`, and are as uncertain.
    """

    version: ClassVar[int] = 2
    additions: ClassVar[Mapping[str, int]] = dict.fromkeys(
        ("settled", "queue_s", "capacity_bit_per_s", "line", "limit_bit_per_s", "blocked_since_ns"), 2
    )

    direction: Literal["forward", "backward"] = Field(description="forward: from the master to the slave")
    receiving: Literal["datagram", "stream"] = Field(description="How this direction is received now")
    sending: Literal["datagram", "stream"] = Field(description="Whether the other end acknowledges datagrams from here")
    sent: Count = Field(description="Datagrams sent to this end since its start, as far as those that arrived show")
    arrived: Count = Field(description="Datagrams that arrived and authenticated")
    late: Count = Field(description="Of those that arrived, how many a newer one had overtaken")
    lost: Count = Field(description="Datagrams that a newer one had overtaken for a second, and that never arrived")
    refused: Counts = Field(description="Datagrams refused since the start, by cause")
    repeats: Count = Field(description="Older samples that each datagram sent from here repeats now")
    unsent: Count = Field(description="Samples not sent from here as a datagram because the send budget was used up")
    sent_bytes: Count = Field(description="Sent from here since the start [bytes], network headers included")
    delay_valid: bool = Field(description="The clocks were compared and a datagram arrived since the last report")
    delay_min_s: DurationS = Field(description="Least one-way delay since the last report [s]")
    delay_mean_s: DurationS = Field(description="Mean one-way delay since the last report [s]")
    delay_max_s: DurationS = Field(description="Greatest one-way delay since the last report [s]")
    clock: LinkClock = Field(description="What the other end's clock is ahead of this one's")
    number: Array = Field(description="i8: number of the datagram, counted from 0 by its sender")
    arrived_ns: Array = Field(description="i8: when it arrived, on this end's clock [ns]; 0 when lost")
    delay_ns: Array = Field(description="i8: one-way delay [ns]; 0 when lost")
    lost_flag: Array = Field(description="u1: 1 lost, 0 arrived")
    settled: Count | None = Field(
        default=None, description="Datagrams of which it is known whether they arrived; `lost` is a share of these"
    )
    queue_s: DurationS | None = Field(
        default=None,
        description="Longest queue that stood before the line of this direction since the last report [s]; absent until"
        " it is known",
    )
    capacity_bit_per_s: Count | None = Field(
        default=None,
        description="What the line of this direction carries [bit/s], by a train of datagrams, or by its sender while"
        " it is full; absent until it is known",
    )
    line: Literal["free", "full", "shared"] | None = Field(
        default=None,
        description="Line that this end sends over: free; full, it sends no more than is delivered; shared, sending"
        " less does not lower the delay, which others or jitter keep, and losses limit what is sent",
    )
    limit_bit_per_s: Count | None = Field(
        default=None, description="Most that this end sends now [bit/s], network headers included"
    )
    blocked_since_ns: Count | None = Field(
        default=None,
        description="Arrival of the newest datagram, on this end's clock, where the other end says that it sends on and"
        " none arrives [ns]; absent while datagrams arrive, and where the other end sends none",
    )
