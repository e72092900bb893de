"""Messages of the link between two machines: its keys, pieces of recordings, and the state of the network."""

from typing import Annotated, ClassVar, Literal

from telenano.wire.messages import Array, Count, Counts, LinkClock, Message, about
from telenano.wire.ranges import DurationS


class LinkKey(Message):
    """Public key of one end of the link between two machines, for the keys of its datagrams, and counts of datagrams.

    Each end sends it over TCP, so that the other one learns how many of its datagrams arrive even if none comes back.
    """

    public_key: Annotated[str, about("Ephemeral X25519 key of this end, in hexadecimal", pattern=r"^[0-9a-f]{64}$")]
    answers: Annotated[
        str, about("Key of the other end to which this key is the answer; empty = none", pattern=r"^([0-9a-f]{64})?$")
    ]
    receiving: Annotated[
        Literal["datagram", "stream"] | None, about("How this end receives the samples of the other one now")
    ] = None
    sent: Annotated[Count | None, about("Datagrams that this end has sent under its present keys")] = None
    arrived: Annotated[Count | None, about("Datagrams that arrived here under the present keys")] = None
    lost: Annotated[Count | None, about("Datagrams to this end that have not arrived although a newer one has")] = None
    capacity_bit_per_s: Annotated[
        Count | None, about("Capacity of the line to this end, as this end measured it [bit/s]; 0 = not known")
    ] = None


class RecordingPiece(Message):
    """A piece of a recording of the other site, sent on request (ADR 0075)."""

    file: Annotated[str, about("Name of the file, without any folder", max_length=255)]
    size_bytes: Annotated[Count, about("Size of the file when the piece was read [bytes]")]
    head_sha256: Annotated[str, about("Digest of the first 1024 bytes, which identify the file", max_length=64)]
    offset_bytes: Annotated[Count, about("Offset of the piece in the file [bytes]")]
    sha256: Annotated[str, about("Digest of the piece", max_length=64)]
    data: Annotated[Array, about("u1: the piece, empty at the end of the file")]


class LinkNetwork(Message):
    """Effect of the network between two machines on the datagrams of one direction, as their receiver saw it.

    The arrays have one element a datagram, in the order in which its fate became known. They are the ground truth of a
    real network, as link/fates is that of an injected one. One-way delays have the uncertainty of `clock`.
    """

    # After this time a datagram that a newer one overtook counts as lost; if it still arrives it counts as late [ns].
    SETTLE_NS: ClassVar[int] = 1_000_000_000

    direction: Annotated[Literal["forward", "backward"], about("forward: from the master to the slave")]
    receiving: Annotated[Literal["datagram", "stream"], about("How this direction is received now")]
    sending: Annotated[Literal["datagram", "stream"], about("Whether the other end acknowledges datagrams from here")]
    sent: Annotated[Count, about("Datagrams sent to this end since its start, as far as those that arrived show")]
    arrived: Annotated[Count, about("Datagrams that arrived and authenticated")]
    late: Annotated[Count, about("Arrived datagrams that a newer one had overtaken")]
    lost: Annotated[Count, about("Datagrams that a newer one had overtaken for a second, and that never arrived")]
    refused: Annotated[Counts, about("Datagrams refused since the start, by cause")]
    repeats: Annotated[Count, about("Older samples that each datagram sent from here repeats now")]
    unsent: Annotated[Count, about("Samples not sent from here as a datagram because the send budget was used up")]
    sent_bytes: Annotated[Count, about("Sent from here since the start [bytes], network headers included")]
    delay_valid: Annotated[bool, about("The clocks were compared and a datagram arrived since the last report")]
    delay_min_s: Annotated[DurationS, about("Least one-way delay since the last report [s]")]
    delay_mean_s: Annotated[DurationS, about("Mean one-way delay since the last report [s]")]
    delay_max_s: Annotated[DurationS, about("Greatest one-way delay since the last report [s]")]
    clock: Annotated[LinkClock, about("Other end's clock minus this end's clock")]
    number: Annotated[Array, about("i8: number of the datagram, counted from 0 by its sender")]
    arrived_ns: Annotated[Array, about("i8: time of arrival on this end's clock [ns]; 0 when lost")]
    delay_ns: Annotated[Array, about("i8: one-way delay [ns]; 0 when lost")]
    lost_flag: Annotated[Array, about("u1: 1 lost, 0 arrived")]
    settled: Annotated[
        Count | None, about("Datagrams of which it is known whether they arrived, `lost` ones included")
    ] = None
    queue_s: Annotated[
        DurationS | None,
        about(
            "Longest standing queue in front of the line of this direction since the last report [s], stated 0.4 s "
            "later, because a longer route looks alike at first; absent until it is known"
        ),
    ] = None
    capacity_bit_per_s: Annotated[
        Count | None,
        about(
            "Capacity of the line of this direction [bit/s], measured by a train of datagrams, or by the sender while "
            "the line is full; absent until it is known"
        ),
    ] = None
    line: Annotated[
        Literal["free", "full", "shared"] | None,
        about(
            "State of the line over which this end sends: free; full, it sends no more than is delivered; shared, "
            "sending less does not lower the delay, which other traffic or jitter causes, and losses limit the rate"
        ),
    ] = None
    limit_bit_per_s: Annotated[
        Count | None, about("Present limit of the rate at which this end sends [bit/s], network headers included")
    ] = None
    blocked_since_ns: Annotated[
        Count | None,
        about(
            "Arrival of the newest datagram on this end's clock [ns], if the other end reports that it still sends "
            "but none arrives; absent while datagrams arrive, and if the other end sends none"
        ),
    ] = None
    queue_low_s: Annotated[
        DurationS | None, about("Lower end of the interval of queue_s [s]; absent where queue_s is")
    ] = None
    queue_high_s: Annotated[
        DurationS | None, about("Upper end of the interval of queue_s [s]; absent where queue_s is")
    ] = None
    capacity_low_bit_per_s: Annotated[
        Count | None, about("Lower end of the interval of capacity_bit_per_s [bit/s]; absent where that is")
    ] = None
    capacity_high_bit_per_s: Annotated[
        Count | None,
        about(
            "Upper end of the interval of capacity_bit_per_s [bit/s]; absent where that is, and where a train was too "
            "fast to bound it"
        ),
    ] = None
