"""Lines between two machines whose truth is known: a generator of them, and a session of ten seconds over each.

Both ends of the datagrams are the real ones, with sockets and clocks in virtual time. What the link does with the time
stamps of its questions, and the hand with the ages of its answers, is here as in the nodes, by the same classes.
"""

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import zmq
from telenano_wide_area.doubles.datagram_bench import Pair, Side

from telenano.link.declared_delay import ONE_MACHINE, between_sites
from telenano.link.ping_times import Questions
from telenano.timing import OffsetFilter

MS = 1_000_000
SECOND = 1_000_000_000
HOST_BYTES = 48
# A hand, and a tip, obey what is no older than this beyond what the link says of the line [ns].
FRESH_NS = 50 * MS
QUESTION_BYTES = 170
# A lost packet of TCP is sent again after a round trip and a quarter (RACK, RFC 8985) and this time, in which the
# packets behind it come, and after that one is lost as well, after the other one [ns].
NOTICED_NS = 20 * MS
AGAIN_NS = 200 * MS
Course = Callable[[float], float]


class Piece(NamedTuple):
    """What holds from a time on [s]: a value, reached evenly over over_s [s]."""

    from_s: float
    value: float
    over_s: float = 0.0


def at(pieces: tuple[Piece, ...], now_s: float) -> float:
    """Return the value that pieces have at a time."""
    value = pieces[0].value
    for piece in pieces[1:]:
        if now_s < piece.from_s:
            break
        share = 1.0 if not piece.over_s else min(1.0, (now_s - piece.from_s) / piece.over_s)
        value += share * (piece.value - value)
    return value


class WayOf(NamedTuple):
    """One way of a line: its delay [ms] and rate [Mbit/s, 0: no limit] over time, the room of its queue [bytes].

    jitter: kind and scale [ms]; loss: share; others: traffic of others, from, until [s] and rate [Mbit/s].
    """

    delay_ms: tuple[Piece, ...]
    rate_mbit: tuple[Piece, ...] = (Piece(0.0, 0.0),)
    room_bytes: int = 64_000
    jitter: tuple[str, float] = ("none", 0.0)
    in_order: bool = True
    loss: float = 0.0
    others: tuple[tuple[float, float, float], ...] = ()


class LineOf(NamedTuple):
    """A line: its kind, both ways, samples a second, the drift of the slave's clock, and when it is set and by what.

    set_clock: the time [s] and the step [s] of the slave's clock.
    """

    kind: str
    there: WayOf
    back: WayOf
    hz: int = 250
    drift: float = 0.0
    set_clock: tuple[float, float] | None = None
    seconds: float = 9.0

    @property
    def changes_s(self) -> list[float]:
        """When something of it has changed [s]."""
        ends = [
            piece.from_s + piece.over_s
            for way in (self.there, self.back)
            for piece in (*way.delay_ms[1:], *way.rate_mbit[1:])
        ]
        ends += [edge for way in (self.there, self.back) for other in way.others for edge in other[:2]]
        return sorted(ends)


JITTERS: dict[str, Callable[[random.Random, float], float]] = {
    "none": lambda draw, scale: 0.0,
    "even": lambda draw, scale: draw.uniform(0.0, 2.0 * scale),
    "normal": lambda draw, scale: abs(draw.gauss(0.0, scale)),
    "exponential": lambda draw, scale: draw.expovariate(1.0 / scale),
    "pareto": lambda draw, scale: scale * (draw.paretovariate(3.0) - 1.0),
}


class Way:
    """One way while it runs: a bottleneck with a tail-drop queue, then the delay."""

    def __init__(self, of: WayOf, seed: str) -> None:
        self.of, self.draw = of, random.Random(seed)
        self.free_ns = self.last_ns = self.others_ns = 0
        # Of each datagram when it was sent, and how long it waited [ns].
        self.waits: deque[tuple[int, int]] = deque(maxlen=20_000)

    def queue_ns(self, now_ns: int) -> int:
        """Return what a message that comes now would wait [ns]."""
        self._let_others(now_ns)
        return max(0, self.free_ns - now_ns)

    def waited_ns(self, now_ns: int) -> int:
        """Return the longest that a datagram of the last second waited [ns]."""
        return max((wait for sent, wait in self.waits if now_ns - SECOND <= sent), default=0)

    def base_ns(self, now_ns: int) -> float:
        return at(self.of.delay_ms, now_ns * 1e-9) * MS

    def arrives_ns(self, now_ns: int, size: int, *, lossy: bool = True) -> int | None:
        """Return when a packet of a size that is sent now arrives; None where it is lost."""
        self._let_others(now_ns)
        sent_ns = self._through(now_ns, size)
        lost = sent_ns is None or (lossy and self.draw.random() < self.of.loss)
        if sent_ns is None or lost:
            return None
        kind, scale = self.of.jitter
        self.waits.append((now_ns, sent_ns - now_ns))
        arrives_ns = sent_ns + round(self.base_ns(sent_ns) + JITTERS[kind](self.draw, scale) * MS)
        if self.of.in_order:
            arrives_ns = self.last_ns = max(arrives_ns, self.last_ns)
        return arrives_ns

    def _through(self, now_ns: int, size: int) -> int | None:
        rate = at(self.of.rate_mbit, now_ns * 1e-9) * 125_000.0
        if not rate:
            return now_ns
        begin_ns = max(now_ns, self.free_ns)
        if (begin_ns - now_ns) * 1e-9 * rate + size > self.of.room_bytes:
            return None
        self.free_ns = begin_ns + round(size / rate * 1e9)
        return self.free_ns

    def _let_others(self, now_ns: int) -> None:
        while self.others_ns < now_ns:
            self.others_ns += 2 * MS
            for from_s, until_s, mbit in self.of.others:
                if from_s <= self.others_ns * 1e-9 < until_s:
                    self._through(self.others_ns, round(mbit * 125.0 * 2))


class Wire:
    """Stands for the socket of an end."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self.send = send
        self.waiting: deque[bytes] = deque()

    def sendto(self, datagram: bytes, peer: Any) -> None:
        self.send(datagram)

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        if not self.waiting:
            raise BlockingIOError
        return self.waiting.popleft(), ("127.0.0.1", 5704)

    def fileno(self) -> int:
        return -1

    def close(self) -> None:
        """Close nothing."""


class Seen(NamedTuple):
    """What was said of a line at a time [s], and what was true then.

    round_trip_ms: what the link says, and the least of the line; queues_ms: of each way what was said and what the
    datagrams waited at least for a tenth of a second, and at most; capacities: what is said each way [Mbit/s], and the
    truth, 0 for a line without a limit; queue_intervals_ms, capacity_intervals: of each way the interval that is said,
    None where nothing is, and None for an upper end that nothing bounds.
    """

    at_s: float
    round_trip_ms: float
    true_ms: float
    low_ms: float
    high_ms: float
    queues_ms: tuple[tuple[float | None, float, float], ...]
    capacities: tuple[tuple[float | None, float], ...]
    queue_intervals_ms: tuple[tuple[float, float] | None, ...] = (None, None)
    capacity_intervals: tuple[tuple[float, float | None] | None, ...] = (None, None)


@dataclass
class Session:
    """What was seen of a line in a session: every tenth of a second, and when the hand and the tip were off [ms]."""

    line: LineOf
    seen: list[Seen] = field(default_factory=list)
    hand_off_ms: list[int] = field(default_factory=list)
    tip_off_ms: list[int] = field(default_factory=list)
    told: list[tuple[float, float, float]] = field(default_factory=list)

    def hand_off_in(self, from_s: float, until_s: float) -> int:
        """Return for how long the hand was off in a span [ms]."""
        return sum(from_s * 1e3 <= at_ms < until_s * 1e3 for at_ms in self.hand_off_ms)


class _Run:
    """A session over a line."""

    def __init__(self, line: LineOf, seed: str) -> None:
        self.line, self.session = line, Session(line)
        self.now = 0
        self.events: list[tuple[int, int, Callable[[], None]]] = []
        self.count = 0
        self.there, self.back = Way(line.there, f"{seed} there"), Way(line.back, f"{seed} back")
        self.offset, self.questions, self.between = OffsetFilter(64), Questions(), ONE_MACHINE
        self.master_transit_ns = self.slave_lag_ns = 0
        self.tcp_there_ns = self.tcp_back_ns = 0
        self.draw = random.Random(f"{seed} tcp")
        self.heard_seq, self.answers, self.hand_ns = -1, {}, -SECOND
        self.hand_times: dict[int, int] = {}
        self.tip_hand_ns = -SECOND
        self.ahead_ns = 37 * SECOND

    def after(self, wait_ns: int, do: Callable[[], None]) -> None:
        self.count += 1
        heapq.heappush(self.events, (self.now + max(0, wait_ns), self.count, do))

    # --- clocks ---

    def slave_now(self, at_ns: int) -> int:
        """Return what the slave's clock shows."""
        set_ns = 0
        if self.line.set_clock is not None and at_ns >= self.line.set_clock[0] * 1e9:
            set_ns = round(self.line.set_clock[1] * 1e9)
        return at_ns + self.ahead_ns + round(self.line.drift * at_ns) + set_ns

    def set_clocks(self) -> None:
        for side in (self.pair.master, self.pair.slave):
            elapsed = SECOND + self.now - side.clock.monotonic_ns()
            if elapsed > 0:
                side.clock.advance_ns(elapsed)
        slave = self.pair.slave.clock
        slave.epoch_offset_ns = 10**18 + self.slave_now(self.now) - self.now

    # --- datagrams ---

    def send_over(self, way: Way, to: Callable[[], tuple[Side, Wire]]) -> Callable[[bytes], None]:
        def send(datagram: bytes) -> None:
            arrives_ns = way.arrives_ns(self.now, len(datagram) + HOST_BYTES)
            if arrives_ns is not None:
                self.after(arrives_ns - self.now, lambda: self.arrive(datagram, *to()))

        return send

    def arrive(self, datagram: bytes, side: Side, wire: Wire) -> None:
        wire.waiting.append(datagram)
        self.take(side, signalled=True)

    def take(self, side: Side, *, signalled: bool = False) -> None:
        for received in side.end.receive(signalled=signalled):
            if received.topic != side.incoming:
                continue
            seq = received.message.seq
            if side is self.pair.slave:
                if seq > self.heard_seq:
                    self.heard_seq, self.tip_hand_ns = seq, self.hand_times[seq]
            else:
                self.questions.hear(self.now)
                self.hand_ns = max(self.hand_ns, self.hand_times.get(self.answers.get(seq, -1), -SECOND))

    def sample(self) -> None:
        self.after(SECOND // self.line.hz, self.sample)
        master, slave = self.pair.sides
        self.hand_times[master.seq] = self.now
        master.send()
        self.answers[slave.seq] = self.heard_seq
        slave.send()

    def keep(self) -> None:
        self.after(5 * MS, self.keep)
        for side in self.pair.sides:
            self.take(side)

    def exchange_keys(self) -> None:
        self.after(100 * MS, self.exchange_keys)
        self.pair.slave.hears_key_of(self.pair.master)
        self.pair.master.hears_key_of(self.pair.slave)

    # --- the link's questions ---

    def over_tcp(self, way: Way, before_ns: int, size: int) -> int:
        """Return when a message of TCP arrives: a lost packet is sent again, and what follows waits for it."""
        wait_ns = 0
        while (arrives_ns := way.arrives_ns(self.now, size, lossy=False)) is None or self.draw.random() < way.of.loss:
            round_trip_ns = self.there.base_ns(self.now) + self.back.base_ns(self.now)
            wait_ns += AGAIN_NS if wait_ns else round(1.25 * round_trip_ns) + NOTICED_NS
            if wait_ns > SECOND:
                break
        return max(before_ns, (self.now if arrives_ns is None else arrives_ns) + wait_ns)

    def ask(self) -> None:
        asked_ns = self.now
        self.questions.ask(asked_ns)
        arrives_ns = self.tcp_there_ns = self.over_tcp(self.there, self.tcp_there_ns, QUESTION_BYTES)

        def answer() -> None:
            there_ns = self.slave_now(self.now)
            home_ns = self.tcp_back_ns = self.over_tcp(self.back, self.tcp_back_ns, QUESTION_BYTES)
            self.after(home_ns - self.now, lambda: self.answered(asked_ns, there_ns))

        self.after(arrives_ns - self.now, answer)

    def answered(self, asked_ns: int, there_ns: int) -> None:
        longer = self.offset.record(asked_ns, there_ns, there_ns, self.now)
        self.questions.answer(self.now, in_doubt=self.offset.present.is_in_doubt, is_longer=longer)
        if longer:
            self.declare()

    def declare(self) -> None:
        self.between = between_sites(self.offset)
        self.master_transit_ns = 2 * self.between.transit_ns
        lag_ns = self.between.there_ns + self.between.clock_ahead_ns
        arrives_ns = self.tcp_there_ns = self.over_tcp(self.there, self.tcp_there_ns, QUESTION_BYTES)
        self.after(arrives_ns - self.now, lambda: setattr(self, "slave_lag_ns", lag_ns))

    def report(self) -> None:
        self.after(100 * MS, self.report)
        self.declare()
        if (changed := self.offset.present.take_change(self.now)) is not None:
            self.session.told.append((self.now * 1e-9, changed.before_ns / MS, changed.after_ns / MS))
        self.ask()
        self.look()

    def tick(self) -> None:
        self.after(MS, self.tick)
        if self.questions.take(self.now, 2 * self.between.transit_ns):
            self.ask()
        if self.now >= SECOND:
            at_ms = self.now // MS
            if self.now - self.hand_ns - self.master_transit_ns > FRESH_NS:
                self.session.hand_off_ms.append(at_ms)
            age_ns = self.slave_now(self.now) - self.tip_hand_ns - self.slave_lag_ns
            if abs(age_ns) > FRESH_NS:
                self.session.tip_off_ms.append(at_ms)

    def look(self) -> None:
        known = self.offset.present.round_trip()
        if known is None:
            return
        now_s = self.now * 1e-9
        true_ns = self.there.base_ns(self.now) + self.back.base_ns(self.now)
        ends = self.pair.master.end, self.pair.slave.end
        queues = []
        # A datagram waits in the queue that it tells of, and what was seen of it in that of the other way.
        lag_ns = true_ns + sum(way.waited_ns(self.now) for way in (self.there, self.back))
        for way, end in ((self.there, ends[0]), (self.back, ends[1])):
            said = end.outgoing.line.there_ns
            waits = [wait for sent, wait in way.waits if self.now - lag_ns - 400 * MS <= sent]
            queues.append((None if said is None else said / MS, min(waits, default=0) / MS, max(waits, default=0) / MS))
        capacities = tuple(
            (end.incoming.capacity * 1e-6 or None, at(way.of.rate_mbit, now_s))
            for way, end in ((self.there, ends[1]), (self.back, ends[0]))
        )
        standing = [end.outgoing.line.ways[0] for end in ends]
        within = [None if one is None else (one.low_ns / MS, one.high_ns / MS) for one in standing]
        carried = [end.incoming.measured for end in reversed(ends)]
        bounds = [
            None
            if one is None
            else (one.low_bit_per_s * 1e-6, None if one.high_bit_per_s is None else one.high_bit_per_s * 1e-6)
            for one in carried
        ]
        least_ms, low_ms, high_ms = known.now_ns / MS, known.low_ns / MS, known.high_ns / MS
        self.session.seen.append(
            Seen(
                now_s, least_ms, true_ns / MS, low_ms, high_ms, tuple(queues), capacities, tuple(within), tuple(bounds)
            )
        )

    def run(self) -> Session:
        context: Any = zmq.Context()
        self.pair = Pair(context)
        try:
            wires: dict[str, Wire] = {}
            master, slave = self.pair.sides
            wires["slave"] = Wire(self.send_over(self.back, lambda: (master, wires["master"])))
            wires["master"] = Wire(self.send_over(self.there, lambda: (slave, wires["slave"])))
            for name, side in (("master", master), ("slave", slave)):
                side.end.socket.close()
                side.end.socket = wires[name]  # type: ignore[assignment]
            self.set_clocks()
            for place, do in enumerate((self.exchange_keys, self.sample, self.keep, self.report, self.tick)):
                self.after(place * 100_000, do)
            while self.now < self.line.seconds * SECOND:
                self.now, _, do = heapq.heappop(self.events)
                self.set_clocks()
                do()
        finally:
            self.pair.close()
            context.term()
        return self.session


def run(line: LineOf, seed: str) -> Session:
    """Run a session over a line."""
    return _Run(line, seed).run()


# --- the generator ---

# What one sample takes of the line with what is around it [bit].
SAMPLE_BITS = 8 * 175
# Over a line with a longer round trip than this no law of the rig is asked to go on [ms].
BORNE_MS = 250.0


def _jitter(draw: random.Random, most_ms: float) -> tuple[str, float]:
    kind = draw.choice(["none", "none", "even", "normal", "exponential"])
    return (kind, 0.0 if kind == "none" else draw.uniform(0.05, most_ms))


def _ways(draw: random.Random, there: tuple[Piece, ...], back: tuple[Piece, ...], jitter_ms: float = 1.5) -> Any:
    jitter, loss = _jitter(draw, jitter_ms), draw.choice([0.0, 0.0, 0.0, 0.01, 0.03])
    return {"there": WayOf(there, jitter=jitter, loss=loss), "back": WayOf(back, jitter=jitter, loss=loss)}


def _steps(draw: random.Random, *, returns: bool) -> Any:
    base, at_s = draw.uniform(2.0, 40.0), draw.uniform(2.5, 5.0)
    rises = [draw.uniform(5.0, 60.0), draw.uniform(5.0, 60.0)]
    if draw.random() < 0.3:
        rises[draw.randrange(2)] = 0.0
    if draw.random() < 0.2:
        base, rises = base + 60.0, [-draw.uniform(10.0, 60.0)] * 2
    ways = []
    for rise in rises:
        pieces = [Piece(0.0, base), Piece(at_s, base + rise)]
        if returns:
            pieces.append(Piece(at_s + draw.choice([0.3, 1.5, 3.0]), base))
        ways.append(tuple(pieces))
    return _ways(draw, *ways)


def _ramps(draw: random.Random) -> Any:
    base, at_s, over_s = draw.uniform(5.0, 40.0), draw.uniform(2.0, 4.0), draw.uniform(0.3, 3.0)
    rise = draw.choice([1, 1, -1]) * draw.uniform(3.0, 30.0)
    base += max(0.0, -rise)
    pieces = (Piece(0.0, base), Piece(at_s, base + rise, over_s))
    return _ways(draw, pieces, pieces if draw.random() < 0.5 else (Piece(0.0, base),), 0.5)


def _limited(draw: random.Random, hz: int, course: str) -> Any:
    """Give a line that one or both ways cannot carry what is sent, all the time, or from or up to a time.

    A line that carries less than a third of a megabit per second has no session.
    """
    made = []
    for limits in (True, draw.random() < 0.5):
        demand = hz * SAMPLE_BITS * 1e-6
        narrow = max(0.33, demand * draw.uniform(0.5, 0.9))
        wide = demand * draw.uniform(4.0, 20.0)
        at_s = draw.uniform(2.0, 4.0)
        rates = {
            "always": (Piece(0.0, narrow),),
            "narrows": (Piece(0.0, wide), Piece(at_s, narrow)),
            "widens": (Piece(0.0, narrow), Piece(at_s, wide)),
        }[course if limits else "always"]
        rates = rates if limits else (Piece(0.0, wide),)
        room = round(max(20_000.0, rates[-1].value * 125_000.0 * draw.uniform(0.15, 0.4)))
        delay = (Piece(0.0, draw.uniform(2.0, 40.0)),)
        made.append(WayOf(delay, rates, room, _jitter(draw, 1.0)))
    draw.shuffle(made)
    return {"there": made[0], "back": made[1], "seconds": 11.0}


def _wide(draw: random.Random, hz: int, *, others: bool) -> Any:
    """Give a line that carries what is sent, perhaps with bursts of others that fill it for a while."""
    made = []
    for _ in range(2):
        rate = hz * SAMPLE_BITS * 1e-6 * draw.uniform(2.5, 30.0)
        traffic = []
        if others:
            from_s = draw.uniform(1.0, 3.0)
            for _ in range(draw.randint(1, 3)):
                until_s = from_s + draw.uniform(0.05, 0.4)
                traffic.append((from_s, until_s, rate * draw.uniform(0.6, 2.0)))
                from_s = until_s + draw.uniform(0.3, 1.5)
        delay = (Piece(0.0, draw.uniform(2.0, 40.0)),)
        room = round(max(30_000.0, rate * 125_000.0 * draw.uniform(0.05, 0.3)))
        made.append(WayOf(delay, (Piece(0.0, rate),), room, _jitter(draw, 0.5), others=tuple(traffic)))
    return {"there": made[0], "back": made[1]}


def _varies(draw: random.Random, *, in_order: bool) -> Any:
    kind = draw.choice(["even", "normal", "exponential"])
    delay = (Piece(0.0, draw.uniform(5.0, 40.0)),)
    way = WayOf(delay, jitter=(kind, draw.uniform(2.0, 15.0)), in_order=in_order, loss=draw.choice([0.0, 0.02]))
    return {"there": way, "back": way}


def _set_clock(draw: random.Random) -> Any:
    delay = (Piece(0.0, draw.uniform(5.0, 40.0)),)
    step_s = draw.choice([-1, 1]) * 10 ** draw.uniform(-2.3, 1.0)
    return _ways(draw, delay, delay) | {"set_clock": (draw.uniform(2.0, 5.0), step_s)}


# Each kind, and its share of the lines.
KINDS: dict[str, int] = {
    "step": 6, "step and back": 3, "ramp": 2, "limited": 4, "narrows": 3, "widens": 1, "wide": 2,
    "queue of others": 2, "reorders": 1, "jitters in order": 1, "clock set": 1,
}  # fmt: skip
# Of these the samples fill the line at the end.
LIMITED = ("limited", "narrows")


def draw_line(seed: int) -> LineOf:
    """Return the line of a seed."""
    draw = random.Random(f"line {seed}")
    kind = draw.choices(list(KINDS), list(KINDS.values()))[0]
    hz = draw.choice([500, 1000] if kind in (*LIMITED, "widens") else [125, 250, 500, 1000])
    drift = draw.choice([0.0, draw.uniform(-1e-4, 1e-4)])
    makers: dict[str, Callable[[], Any]] = {
        "step": lambda: _steps(draw, returns=False),
        "step and back": lambda: _steps(draw, returns=True),
        "ramp": lambda: _ramps(draw),
        "limited": lambda: _limited(draw, hz, "always"),
        "narrows": lambda: _limited(draw, hz, "narrows"),
        "widens": lambda: _limited(draw, hz, "widens"),
        "wide": lambda: _wide(draw, hz, others=False),
        "queue of others": lambda: _wide(draw, hz, others=True),
        "reorders": lambda: _varies(draw, in_order=False),
        "jitters in order": lambda: _varies(draw, in_order=True),
        "clock set": lambda: _set_clock(draw),
    }
    return LineOf(kind, hz=hz, drift=drift, **makers[kind]())
