"""One end of the link between two machines: sends the newest samples as sealed datagrams, and receives the other's.

The end works beside the subscriber that receives the same topics over TCP, and passes arrived samples to it, so that
decoding, the roles of the other machine and the tracking of sequence numbers are the same for both (`reception.py`
chooses between them). The loop of the node calls it like a subscriber; it has no thread, and each call does a bounded
amount of work.
"""

import contextlib
import errno
import socket
from collections import deque
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Literal, cast

import zmq

from telenano.runtime import LinkSide
from telenano.timing import NEVER_NS, OffsetFilter
from telenano.wire import LinkKey, Message, Received
from telenano_wide_area.datagram.agreement import Agreement
from telenano_wide_area.datagram.arrivals import ArrivalRecord
from telenano_wide_area.datagram.body import (
    ASKING_TRAIN,
    CARRIES,
    DATAGRAMS_OF,
    REPORT,
    SHORT_REPORT,
    Body,
    mark,
    parse,
    short_report,
)
from telenano_wide_area.datagram.command_reach import ConnectionWatch
from telenano_wide_area.datagram.full_queue import Measured
from telenano_wide_area.datagram.held_samples import HeldSamples
from telenano_wide_area.datagram.incoming import Incoming
from telenano_wide_area.datagram.outgoing import Outgoing
from telenano_wide_area.datagram.pacing import NETWORK_BYTES, Repeats
from telenano_wide_area.datagram.place import Address, Place
from telenano_wide_area.datagram.rate import Delivery
from telenano_wide_area.datagram.reception import Reception, Way
from telenano_wide_area.datagram.report import network_report
from telenano_wide_area.datagram.sealing import OVERHEAD_BYTES, TAG_BYTES, Opener
from telenano_wide_area.datagram.sparse import SparseSamples, Taken, carried_by_tcp
from telenano_wide_area.relay.path import RelayPath
from telenano_wide_area.sealed import MOST_BYTES, RejectedError
from telenano_wide_area.settings import DatagramSettings

# The number of datagrams after which the node looks at its deadline again, so that a flood cannot hold its loop.
_BATCH = 64
_MAINTAIN_NS = 50_000_000
_REPORT_NS = 500_000_000
# Due work is postponed by up to this time until a turn in which nothing has arrived; there are many such turns if the
# node calls the end in every turn.
_PUT_OFF_NS = 20_000_000
# A process without a turn for this time has stood still.
_STOOD_STILL_NS = 2 * _MAINTAIN_NS
# After that the waiting datagrams say nothing about the line until the process has read them all, for at most this
# time: a process that is slower than this is itself a queue.
_BEHIND_NS = 2_000_000_000
# After this time without an acknowledgement, if the other end receives over TCP, only a few datagrams are sent, to find
# out when they arrive again.
_UNHEARD_NS = 1_000_000_000
# After a silence of this length a process may be behind for up to _BEHIND_NS; its delay then says nothing about the
# route.
_SILENCE_NS = 300_000_000
# Datagrams are considered blocked if none arrives although the other end reports over TCP that it has sent this number
# since the newest.
_BLOCKED = 5
_BETWEEN = {"forward": "from the master to the slave", "backward": "from the slave to the master"}
# The key is offered at this interval while no key is agreed or no datagram arrives under it.
_OFFER_NS = 500_000_000
# The key is offered at this interval once datagrams flow and are answered; before an end is started again, it is
# silent.
_CALM_OFFER_NS = 5_000_000_000
# The window of time stamp exchanges for the clock offset [s].
_CLOCK_WINDOW = 64
# The number of trains that measure the line at the start: several, because a process that stands still makes the line
# seem narrow.
_TRAINS = 9
# The number of these trains that are sent only while the line seems narrow.
_FURTHER_TRAINS = 6
# Below this capacity a line seems narrow and is measured further, because other traffic at the start may have caused it
# [bit/s].
_NARROW = 600_000
# The number of payloads with which a repetition is compared.
_REMEMBERED = 16
_RECEIVE_BUFFER_BYTES = 1 << 20


def _told_of(machine: str, before: Measured, after: Measured) -> str:
    """Return the text of an event: the capacity of the line from a machine now, with its interval, and before."""
    high = "or more" if after.high_bit_per_s is None else f"to {1e-6 * after.high_bit_per_s:.3g}"
    carries = f"{1e-6 * after.bit_per_s:.3g} Mbit/s ({1e-6 * after.low_bit_per_s:.3g} {high})"
    return f"the line from {machine} carries {carries}, and carried {1e-6 * before.bit_per_s:.3g} Mbit/s before"


def _bound_socket(place: Place) -> socket.socket:
    """Return the socket of an end; OSError where it cannot be bound."""
    bound = socket.socket(place.family, socket.SOCK_DGRAM)
    try:
        bound.setblocking(False)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        bound.bind(place.bind)
    except OSError:
        bound.close()
        raise
    return bound


class DatagramEnd:
    """The datagrams of one process."""

    # The loop calls this end in each turn, for its due work.
    shared = True
    topics: Sequence[str] = ()

    def __init__(self, side: LinkSide, place: Place, settings: DatagramSettings) -> None:
        """Open the socket; OSError where it cannot be bound.

        Args:
            side: The process of this end, which receives the same topics over TCP, and the public keys of the other
                end.
            place: The addresses of both ends.
            settings: The settings of the transport.

        Raises:
            OSError: The socket cannot be bound.
        """
        clock, is_master, machine = side.clock, side.is_master, side.machine
        now = clock.monotonic_ns()
        self.side = side
        self.machine = machine
        self.subscriber = subscriber = side.reader
        self.trackers: dict[tuple[str, str], Any] = {}
        self.rejected: dict[str, int] = {}
        self.last_error = ""
        self.drained = True
        self.sockets: list[Any] = []
        self.arrivals = ArrivalRecord()
        # The time at which the next sample of the play-out buffer is due, on the monotonic clock.
        self.due_ns = NEVER_NS
        self.held = HeldSamples() if settings.play_out else None
        self.outgoing = Outgoing(settings, now)
        self.incoming = Incoming(machine)
        self.offset = OffsetFilter(_CLOCK_WINDOW)
        self._clock = clock
        self._place = place
        self._is_master = is_master
        self._offers: list[LinkKey] = []
        self._touch = ConnectionWatch(lambda: side.is_connected, machine, now)
        self._agreement = Agreement(now, is_master=is_master)
        self._peer = place.peer
        self._relay = place.relay
        incoming: Literal["forward", "backward"] = "backward" if is_master else "forward"
        self._incoming = incoming
        topics = [topic for topic in subscriber.topics if topic in DATAGRAMS_OF[incoming]]
        falls_back, peer = settings.transport == "auto", (machine, place.port)
        self._sparse = SparseSamples()
        # The losses of the incoming direction over the last few reports.
        self._losses = Repeats(None)
        # The recent delivery of the incoming direction.
        self._delivered = Delivery()
        self._sent_topics = frozenset(DATAGRAMS_OF["forward" if is_master else "backward"])
        self._recent: deque[bytes] = deque(maxlen=_REMEMBERED)
        # The newest datagram that arrived: its time of sending by the other clock, and its time of arrival.
        self._heard = (0, 0)
        self._turned_ns, self._behind_until_ns = now, 0
        self._silent_until_ns = now - _BEHIND_NS
        self._sent_ns = now
        # The last times at which the other end acknowledged further datagrams: by any way, and by a datagram of its
        # own.
        self._acknowledged_ns = self._answered_ns = now - 2 * _UNHEARD_NS
        # The way in which the other end receives, by its last word over TCP, and the way of this end that was told to
        # it last.
        self._peer_receives: Way = "stream"
        self._offered: Way = "stream"
        self._blocked_since_ns: int | None = None
        self._expected = 0
        self._acknowledged_counts = (0, 0)
        self._maintain_ns = self._report_ns = now
        self._offered_ns = now - _CALM_OFFER_NS
        # The capacity of the line from here as the other end measured it [bit/s], 0 before it has.
        self._known = 0
        # The number of trains still to be sent at the start.
        self._trains = _TRAINS
        self.socket = _bound_socket(place)
        self.descriptor = self.socket.fileno()
        if self._relay is not None:
            self._relay.send = self._send_plain
        subscriber.set_aside("link/key", self._hear_offer)
        subscriber.sift = self._sift
        self._reception = Reception(side, topics, peer, self._tell, falls_back=falls_back, now_ns=now)

    @property
    def receiving(self) -> Way:
        """The transport by which samples are received now."""
        return self._reception.way

    # --- sending ---

    @property
    def acknowledged(self) -> bool:
        """Whether the other end has lately confirmed, by datagram or over TCP, that datagrams arrive there."""
        return self._clock.monotonic_ns() - self._acknowledged_ns < _UNHEARD_NS and self._expected > 0

    def carry(self, topic: str, payload: bytes) -> bytes | None:
        """Send a sample that was just published, if its topic crosses as datagrams.

        Returns:
            The prefix from SPARSE under which the sample is sent over TCP as well; None for most samples.
        """
        if topic not in self._sent_topics:
            return None
        now = self._clock.monotonic_ns()
        # Without acknowledgements, and if the other end receives over TCP, only the signs of life from `maintain` are
        # sent; they show when datagrams arrive again.
        sends = now - self._acknowledged_ns <= _UNHEARD_NS or self._peer_receives == "datagram"
        sends = sends and self._agreement.sealer is not None and self._peer is not None and self._touch.is_kept
        if sends and (samples := self.outgoing.samples(topic, payload, now)):
            self._send(samples, now)
        return self._sparse.takes(topic, len(payload), now)

    def _send(self, samples: bytes, now_ns: int) -> None:
        sealer, peer = self._agreement.sealer, self._peer
        if sealer is None or peer is None:
            return
        sent_ns = now_ns + self._clock.epoch_offset_ns
        if samples and self.outgoing.leaves_report_out(now_ns):
            report = short_report(sent_ns)
        else:
            report = REPORT.pack(sent_ns, *self._heard, *self.arrivals.of_keys)
        datagram = sealer.seal(report + samples)
        try:
            self.socket.sendto(datagram, peer)
        except BlockingIOError:
            self.outgoing.unsent += 1
            return
        except OSError as error:
            # No route, or an interface that is down, is treated like a network that loses everything.
            self.last_error = f"no datagram can be sent to {peer[0]}: {errno.errorcode.get(error.errno or 0, error)}"
            return
        self._sent_ns = now_ns
        self.outgoing.record_sent(len(datagram))

    def _send_plain(self, datagram: bytes, address: Address) -> None:
        with contextlib.suppress(OSError):
            self.socket.sendto(datagram, address)
            self.outgoing.bytes += len(datagram) + NETWORK_BYTES

    # --- receiving ---

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Return the messages of the datagrams that have arrived, checked as the subscriber checks its own."""
        received: list[Received] = []
        now = self._clock.monotonic_ns()
        if now - self._turned_ns > _STOOD_STILL_NS:
            self._behind_until_ns = now + _BEHIND_NS
        self._turned_ns = now
        if signalled or not self.drained:
            waiting = self._take()
            if self.drained:
                self._behind_until_ns = 0
            if waiting and self.held is None:
                received = self.subscriber.take(waiting)
        if self.held is not None and now >= self.held.due_ns:
            now_ns = now + self._clock.epoch_offset_ns
            received = self.subscriber.take([(frames, now_ns) for frames in self.held.released(now)])
        if now >= self._reception.missed_ns:
            self._reception.subscribe_early(now)
        self.due_ns = min(self._reception.missed_ns, NEVER_NS if self.held is None else self.held.due_ns)
        # Arrived messages are returned first, because a report takes half a millisecond.
        if now >= self._maintain_ns + (_PUT_OFF_NS if received else 0):
            self._maintain_ns = now + _MAINTAIN_NS
            self.maintain(now)
        return received

    def pending(self) -> bool:
        """Return whether datagrams were left unread because the last batch was full."""
        return not self.drained

    def input_health(self) -> tuple[()]:
        """Return nothing: the subscriber's sequence statistics include the datagrams."""
        return ()

    def _take(self) -> list[tuple[list[bytes], int]]:
        waiting: list[tuple[list[bytes], int]] = []
        receive, openers = self.socket.recvfrom, self._agreement.openers
        self.drained = False
        for _ in range(_BATCH):
            try:
                datagram, address = receive(MOST_BYTES + 1)
            except BlockingIOError:
                self.drained = True
                break
            except OSError:
                # An ICMP error about an earlier datagram; nothing has arrived with it.
                continue
            now = self._clock.now_ns()
            try:
                if self._relay is not None and datagram[:TAG_BYTES] == self._relay.tag:
                    self._relay.take(datagram, address)
                    continue
                if len(datagram) > MOST_BYTES:
                    raise RejectedError("oversized")
                if len(datagram) < OVERHEAD_BYTES + SHORT_REPORT.size:
                    raise RejectedError("truncated")
                opener = openers.get(datagram[:TAG_BYTES])
                if opener is None:
                    raise RejectedError("unknown_key")
                number, body = opener.open(datagram, now - self._clock.epoch_offset_ns)
                datagram_read = parse(body)
            except RejectedError as error:
                self._refuse(error.cause, address)
                continue
            self._note(opener, number, datagram_read, len(datagram), address, now)
            if not self._touch.is_kept:
                continue
            # The samples are passed on from the oldest, each once.
            for topic, payload in reversed(datagram_read.samples):
                if payload not in self._recent:
                    self._recent.append(payload)
                    waiting.append(([topic, payload], now))
            if self.held is not None:
                offset_ns = self._clock.epoch_offset_ns
                self.held.hold(datagram_read.report.sent_ns, now, offset_ns, (frames for frames, _ in waiting))
                waiting.clear()
        return waiting

    def _refuse(self, cause: str, address: Address) -> None:
        self.rejected[cause] = self.rejected.get(cause, 0) + 1
        self.last_error = f"a datagram from {address[0]} port {address[1]} is refused: {cause}"

    def _note(self, opener: Opener, number: int, body: Body, size: int, address: Address, now_ns: int) -> None:
        """Record the number, report and marks of an authentic datagram of a size [bytes]."""
        report = body.report
        monotonic_ns = now_ns - self._clock.epoch_offset_ns
        is_behind = monotonic_ns < self._behind_until_ns or monotonic_ns - self._turned_ns > _STOOD_STILL_NS
        if self._reception.silence_ns(monotonic_ns) > _SILENCE_NS:
            self._silent_until_ns = monotonic_ns
        self._reception.record(monotonic_ns)
        if opener is not self._agreement.opener:
            return
        self.arrivals.record(number, report.sent_ns, now_ns)
        self.incoming.record(size, now_ns, body.marks, report.sent_ns, number)
        if body.carries:
            self._known = body.carries
        if number == opener.window.newest:
            self._agreement.opened(opener)
            self._delivered.record(now_ns, *self.arrivals.of_keys)
            self._heard = self._heard if is_behind else (report.sent_ns, now_ns)
            if self._relay is None and (self._peer is None or address[:2] != self._peer[:2]):
                self._follow(address)
            if report.heard_sent_ns and report.expected > self._expected:
                self._acknowledge(report.expected, report.arrived, monotonic_ns)
                if monotonic_ns - self._answered_ns > _UNHEARD_NS:
                    # Reports from before and after a time without answers must not be compared.
                    self.outgoing.forget_reports(new_process=False)
                self._answered_ns = monotonic_ns
        if report.heard_sent_ns and not is_behind:
            self.outgoing.record_heard(report, now_ns)
            is_longer = self.offset.record(report.heard_sent_ns, report.heard_ns, report.sent_ns, now_ns)
            if is_longer and monotonic_ns - self._silent_until_ns > _BEHIND_NS:
                there, back = self.offset.present.by_and_by
                is_full = self._delivered.is_of_full_queue() or (back and self._delivered.is_kept_full())
                self.outgoing.record_jump(
                    *self.offset.present.jumped_ns, now_ns, monotonic_ns, back_is_full=is_full, there_by_and_by=there
                )

    def _acknowledge(self, expected: int, arrived: int, now_ns: int) -> None:
        self._expected, self._acknowledged_ns, self._acknowledged_counts = expected, now_ns, (expected, arrived)

    def _follow(self, address: Address) -> None:
        if self._peer is not None:
            text = f"the link's datagrams from {self.machine} now come from {address[0]} port {address[1]}"
            self._tell("info", text)
        self._peer = address

    def _steer(self, relay: RelayPath, now_ns: int) -> None:
        """Send to the address that the relay, or the other end by its answers, gives."""
        relay.maintain(now_ns, self._reception.silence_ns(now_ns))
        if relay.peer != self._peer and relay.peer is not None:
            self._peer = relay.peer
            way = f"directly to {self._peer[0]} port {self._peer[1]}" if relay.is_direct else "through the relay"
            self._tell("info", f"the link's datagrams to {self.machine} go {way}")

    # --- periodic work ---

    def maintain(self, now_ns: int) -> None:
        """Do the due work: exchange keys, send a sign of life, choose the transport to receive by, and report."""
        loss_share = max(self.arrivals.lost / max(1, self.arrivals.settled), self.outgoing.repeats.loss_share)
        notice = self._touch.look(now_ns, arriving=not self._reception.is_silent(now_ns), loss_share=loss_share)
        if notice is not None:
            self._tell(*notice)
        if self._relay is not None:
            self._steer(self._relay, now_ns)
        self._exchange_keys(now_ns)
        if self._agreement.sealer is not None and now_ns - self._sent_ns >= _MAINTAIN_NS:
            self._send(b"", now_ns)
        if not self._reception.is_silent(now_ns):
            self._blocked_since_ns = None
        self._reception.choose(now_ns, self._why_silent())
        self.arrivals.settle(now_ns)
        self._adapt(now_ns)
        if now_ns >= self._report_ns:
            self._report_ns = now_ns + _REPORT_NS
            if self.acknowledged:
                self._send(mark(CARRIES, self.incoming.capacity.to_bytes(8, "big")), now_ns)
            if self._expected:
                self.outgoing.adapt_repeats(*self._acknowledged_counts)
            self._weigh_tcp()
            if self._agreement.peer_public:
                self._publish_report()

    def _publish_report(self) -> None:
        sending = "datagram" if self.acknowledged else "stream"
        ways = {"direction": self._incoming, "receiving": self.receiving, "sending": sending}
        parts = self.offset, self.arrivals, self.outgoing, self.incoming.measured
        report = network_report(ways, *parts) | {"blocked_since_ns": self._blocked_since_ns}
        self.side.report("link/network", **report, refused=dict(self.rejected))

    def _weigh_tcp(self) -> None:
        """Update what TCP can carry in each direction, from what the datagrams show of the line."""
        offset, settled = self.offset.estimate(), self.arrivals.settled
        self._losses.adapt(settled, settled - max(0, self.arrivals.lost))
        round_trip_s = 0.0 if offset is None else offset.round_trip_s
        self._reception.weigh(carried_by_tcp(self.incoming.capacity, self._losses.loss_share, round_trip_s))
        self._sparse.carried = carried_by_tcp(self._known, self.outgoing.repeats.loss_share, round_trip_s)

    def _why_silent(self) -> str:
        """Return a clause on the UDP port for the event that no datagram arrives."""
        if not self._agreement.peer_public:
            return "may be in use by no link there: it has offered no key"
        if self._blocked_since_ns is None:
            return "is blocked on the way"
        since = datetime.fromtimestamp(self._blocked_since_ns // 1_000_000_000, UTC)
        return f"is blocked {_BETWEEN[self._incoming]} since {since:%H:%M:%S} UTC"

    def _adapt(self, now_ns: int) -> None:
        """Adapt sending to the line, answer trains, and report a line that is full or has changed."""
        if now_ns - self._answered_ns < _UNHEARD_NS:
            # Older reports say nothing about the queue now.
            offset, line = self.offset.estimate(), self.outgoing.line
            round_trip_ns = 0 if offset is None else round(offset.round_trip_s * 1e9)
            # The standing queues are part of the round trip and are subtracted.
            self.outgoing.update(now_ns, max(0, round_trip_ns - (line.there_ns or 0) - (line.back_ns or 0)))
        if self.acknowledged:
            seems_narrow = 0 < min(self.incoming.capacity, self._known) < _NARROW
            if self._is_master and self._trains and (self._trains > _FURTHER_TRAINS or seems_narrow):
                self._trains -= self.outgoing.send_train(now_ns, self._send, ASKING_TRAIN)
        if self.incoming.wants_train:
            self.incoming.wants_train = False
            self.outgoing.send_train(now_ns, self._send)
        self.incoming.measure(now_ns)
        if (changed := self.incoming.take_change(now_ns)) is not None:
            self._tell("info", _told_of(self.machine, *changed))
        notice = self.outgoing.report_queue(now_ns, self.machine)
        if notice is not None:
            self._tell(*notice)

    def send_train(self) -> bool:
        """Send a train of datagrams and ask for one, to measure both directions; return whether it was sent.

        Nothing is sent on a line that is full, whose capacity is known.
        """
        if self.outgoing.control.mode != "free":
            return False
        return self.outgoing.send_train(self._clock.monotonic_ns(), self._send, ASKING_TRAIN)

    def _exchange_keys(self, now_ns: int) -> None:
        agreement = self._agreement
        silent = self._reception.is_silent(now_ns)
        changed = agreement.maintain(now_ns, silent=silent)
        offers, self._offers = self._offers, []
        for message in offers if self.side.is_allowed else ():
            try:
                new = agreement.hear(bytes.fromhex(message.public_key), bytes.fromhex(message.answers), now_ns)
            except ValueError as error:
                self._refuse_key(str(error))
                continue
            self._hear_word(message, now_ns)
            if new and agreement.opener is not None:
                self.arrivals.begin(agreement.opener.window)
                self.outgoing.forget_reports(new_process=silent)
                self._expected = 0
                self._reception.begin_keys(now_ns)
            changed = changed or new
        # If no datagram acknowledges, the arrivals are reported over TCP with the key.
        calm = not silent and agreement.sealer is not None and now_ns - self._answered_ns < _OFFER_NS
        changed = changed or self.receiving != self._offered
        if changed or now_ns - self._offered_ns >= (_CALM_OFFER_NS if calm else _OFFER_NS):
            self._offered_ns, self._offered = now_ns, self.receiving
            answers = b"" if self._is_master else agreement.peer_public
            expected, arrived = self.arrivals.of_keys
            self.side.publish(
                "link/key",
                public_key=agreement.public.hex(),
                answers=answers.hex(),
                receiving=self.receiving,
                sent=0 if agreement.sealer is None else agreement.sealer.number,
                arrived=arrived,
                lost=expected - arrived,
                capacity_bit_per_s=self.incoming.capacity,
            )

    def _hear_offer(self, message: Message) -> None:
        # One offer at a time is enough, because offers are repeated.
        self._offers = [cast(LinkKey, message)]

    def _hear_word(self, word: LinkKey, now_ns: int) -> None:
        """Record the other end's report over TCP: its arrivals, and whether its datagrams do not arrive here."""
        if word.receiving is None or word.public_key != self._agreement.peer_public.hex():
            return
        arrived = word.arrived or 0
        expected = arrived + (word.lost or 0)
        self._peer_receives = word.receiving
        self._sparse.alone = word.receiving == "stream"
        self._known = word.capacity_bit_per_s or self._known
        if expected > self._expected:
            self._acknowledge(expected, arrived, now_ns)
        is_blocked = self._reception.is_silent(now_ns) and (word.sent or 0) >= self.arrivals.of_keys[0] + _BLOCKED
        if is_blocked and self._blocked_since_ns is None:
            self._blocked_since_ns = self._reception.arrived_ns + self._clock.epoch_offset_ns
            self._reception.remind(now_ns)

    def take_sparse(self, waiting: Sequence[Taken]) -> list[Received]:
        """Return the messages among the sparse samples from the second TCP connection that bring something new."""
        sifted = [(self._sift(list(frames)), received_ns) for frames, received_ns in waiting]
        return self.subscriber.take([(frames, received_ns) for frames, received_ns in sifted if frames is not None])

    def connect_beside(self, beside: "zmq.Socket[bytes]") -> None:
        """Use the socket of a second connection to the other machine, for its share of the sparse samples."""
        self._reception.connect_beside(beside)

    def _sift(self, frames: list[bytes]) -> list[bytes] | None:
        sifted = self._reception.sift(frames, self._clock.monotonic_ns())
        if sifted is not None and sifted is not frames:
            # Its datagram may still arrive, and is then a repetition.
            self._recent.append(sifted[-1])
        return sifted

    def _refuse_key(self, reason: str) -> None:
        self.rejected["key"] = self.rejected.get("key", 0) + 1
        self.last_error = f"link/key of {self.machine} is refused: {reason}"

    def _tell(self, level: str, text: str) -> None:
        data: Mapping[str, bool | float | str] = {"peer": self.machine, "transport": self.receiving}
        self.side.tell(level, text, data)

    # --- as one that looks after the network ---

    def apply_permissions(self) -> None:
        """Forget the keys if the other machine is no longer allowed, and continue over TCP, which refuses it too."""
        if self.side.is_allowed or not self._agreement.peer_public:
            return
        now = self._clock.monotonic_ns()
        self._agreement.forget(now)
        self._reception.forget()
        self._expected = 0
        self._tell("warning", f"the link's datagrams with {self.machine} have ended: its key is no longer allowed")

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
