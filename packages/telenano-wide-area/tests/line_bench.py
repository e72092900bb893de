"""A line in virtual time: a bottleneck with a queue, our end before it, and perhaps a TCP transfer beside us."""

import itertools
import random
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from telenano_wide_area.datagram.line import Line
from telenano_wide_area.datagram.pacing import SendBudget
from telenano_wide_area.datagram.rate import Delivery, PathEstimate, RateControl

MS = 1_000_000
OFFSET_NS = 37 * 10**9
SEGMENT = 1500


class Tcp:
    """A transfer that always has something to send: one more segment a round trip, half of it at a loss."""

    def __init__(self, line: "Bottleneck") -> None:
        self.line = line
        self.window = 10.0
        self.under_way = 0
        self._cut_ns = 0

    def turn(self, now_ns: int) -> None:
        while self.under_way < int(self.window):
            self.under_way += 1
            if not self.line.offer(now_ns, SEGMENT, self):
                self.under_way -= 1
                if now_ns >= self._cut_ns:
                    self.window, self._cut_ns = max(2.0, self.window / 2), now_ns + 2 * self.line.delay_ns + 100 * MS
                return

    def acknowledged(self) -> None:
        self.under_way -= 1
        self.window += 1.0 / self.window


@dataclass
class Bottleneck:
    """A line of a rate [bytes/s] with a tail-drop queue [bytes], one for all or one for each flow, served by turns."""

    bytes_per_s: float
    limit_bytes: int = 64_000
    delay_ns: int = 20 * MS
    fair: bool = False
    queues: dict[object, deque[tuple[int, int, object]]] = field(default_factory=dict)
    served: dict[object, int] = field(default_factory=dict)
    turn: int = 0
    free_ns: int = 0
    dropped: int = 0

    def offer(self, now_ns: int, size: int, owner: object) -> bool:
        queue = self.queues.setdefault(owner if self.fair else None, deque())
        if sum(entry[1] for entry in queue) + size > self.limit_bytes:
            self.dropped += 1
            return False
        if self.fair and not queue:
            # who comes back has saved up nothing
            self.served[owner] = max(self.served.get(owner, 0), self.turn)
        queue.append((now_ns, size, owner))
        return True

    def delivered(self, until_ns: int) -> list[tuple[int, int, object]]:
        """Return what leaves the line until a time: when it arrives, when it was offered, whose it is."""
        found = []
        while self.free_ns <= until_ns:
            waiting = [key for key, queue in self.queues.items() if queue]
            if not waiting:
                self.free_ns = max(self.free_ns, until_ns)
                break
            key = waiting[0]
            if self.fair:
                # who has had the least of those that wait
                key = min(waiting, key=lambda owner: self.served.get(owner, 0))
            offered_ns, size, owner = self.queues[key].popleft()
            self.turn = self.served.get(key, 0)
            self.served[key] = self.turn + size
            self.free_ns = max(self.free_ns, offered_ns) + round(size / self.bytes_per_s * 1e9)
            found.append((self.free_ns + self.delay_ns, offered_ns, owner))
        return found


@dataclass
class Ending:
    """What became of a run: queue that our datagrams waited in [ms] and our rate [1/s], second by second; the rest.

    `waits_ns` has by the time of sending of each sample that arrived how long it waited.
    """

    queue_ms: list[float]
    rate_hz: list[float]
    control: RateControl
    line: Line
    tcp_bytes: int
    sent_ns: list[int]
    waits_ns: dict[int, int]


Jitter = Callable[[random.Random, float], float]


def normal(sigma_ms: float) -> Jitter:
    """Give delays of a normal distribution, of which the lower half is none."""
    return lambda draw, at_s: abs(draw.gauss(0.0, sigma_ms))


def _no_jitter(draw: random.Random, at_s: float) -> float:
    return 0.0


def even(width_ms: float) -> Jitter:
    """Give delays from nothing to twice a width, each as likely, as the cable of `wide_area_cable.py` does."""
    return lambda draw, at_s: draw.uniform(0.0, 2.0 * width_ms)


def pareto(scale_ms: float) -> Jitter:
    """Give delays that are mostly short and at times many times the scale (exponent 3)."""
    return lambda draw, at_s: scale_ms * (draw.paretovariate(3.0) - 1.0)


def stalls(length_ms: float, each_s: float) -> Jitter:
    """Let a line stand still for a time at regular intervals, as a radio that looks around does, then empty at once."""
    return lambda draw, at_s: max(0.0, length_ms - 1e3 * (at_s % each_s))


class Way:
    """What a line adds to each datagram on its way, after the bottleneck; in order, none overtakes another."""

    def __init__(self, jitter: Jitter, seed: str, *, in_order: bool) -> None:
        self._jitter, self._draw, self._in_order = jitter, random.Random(seed), in_order
        self._last_ns = 0

    def arrives(self, at_ns: int) -> int:
        """Return when it arrives that without jitter would at a time [ns]."""
        at_ns += round(self._jitter(self._draw, at_ns * 1e-9) * MS)
        if self._in_order:
            at_ns = self._last_ns = max(at_ns, self._last_ns)
        return at_ns


def _thirds() -> Iterator[float]:
    """Yield shares of a period that put messages apart: multiples of the golden ratio."""
    return ((0.618 * place) % 1.0 for place in itertools.count(1))


def run(
    line: Bottleneck,
    seconds: float,
    *,
    tcp_from: float | None = None,
    tcp_until: float = 1e9,
    size: int = 174,
    hz: int = 1000,
    drift: float = 0.0,
    jitter: Jitter = _no_jitter,
    in_order: bool = False,
    loss: float = 0.0,
    least_hz: float = 50.0,
    change: Callable[[float, Bottleneck], None] = lambda at_s, line: None,
    seed: int = 1,
    back_ns: int = 20 * MS,
    beside: Sequence[tuple[float, int]] = (),
) -> Ending:
    """Send samples of a size [bytes] over a line, at the rate that the control allows.

    Beside them the messages of nodes cross by TCP: `beside` has the period [s] and the size [bytes] of each.
    """
    next_message_s = [draw_s * period_s for draw_s, (period_s, _) in zip(_thirds(), beside, strict=False)]
    draw = random.Random(seed)
    there_way, back_way = (Way(jitter, f"{seed} {way}", in_order=in_order) for way in ("there", "back"))
    most = 750_000.0
    control, seen_line, delivery, budget = RateControl(most), Line(), Delivery(), SendBudget(most / 125.0, 0)
    tcp = Tcp(line)
    step_ns = 1_000_000_000 // hz
    arriving: deque[tuple[int, int]] = deque()
    heard: tuple[int, int] | None = None
    reports: deque[tuple[int, tuple[int, int, int, int], int, int]] = deque()
    on_way: list[tuple[int, int, object]] = []
    number = arrived = newest = tcp_bytes = 0
    numbers: dict[int, int] = {}
    queue_ms: list[float] = []
    rate_hz: list[float] = []
    waits: list[float] = []
    sent_now = sent_then = 0
    sent_ns: list[int] = []
    waits_ns: dict[int, int] = {}
    next_update = next_second = 0
    for tick in range(int(seconds * hz)):
        now = tick * step_ns
        change(now * 1e-9, line)
        if tcp_from is not None and tcp_from <= now * 1e-9 < tcp_until:
            tcp.turn(now)
        for place, (period_s, message_bytes) in enumerate(beside):
            if now * 1e-9 >= next_message_s[place]:
                next_message_s[place] += period_s
                for first in range(0, message_bytes, SEGMENT):
                    line.offer(now, min(SEGMENT, message_bytes - first), "nodes")
        if budget.left_bytes(now) >= size - 48:
            budget.spend(size - 48)
            numbers[now] = number
            number += 1
            sent_now += 1
            sent_ns.append(now)
            if draw.random() >= loss:
                line.offer(now, size, "us")
        on_way += line.delivered(now)
        still = []
        for at_ns, offered_ns, owner in on_way:
            if at_ns > now:
                still.append((at_ns, offered_ns, owner))
            elif owner is tcp:
                tcp.acknowledged()
                tcp_bytes += SEGMENT
            elif owner == "us":
                arriving.append((there_way.arrives(at_ns), offered_ns))
        on_way = still
        if not in_order:
            arriving = deque(sorted(arriving))
        while arriving and arriving[0][0] <= now:
            at_ns, offered_ns = arriving.popleft()
            arrived += 1
            if numbers[offered_ns] >= newest:
                newest, heard = numbers[offered_ns], (offered_ns, round(at_ns * (1.0 + drift)) + OFFSET_NS)
            del numbers[offered_ns]
            waits_ns[offered_ns] = at_ns - offered_ns - line.delay_ns
            waits.append(waits_ns[offered_ns] / MS)
        if heard is not None:
            # The other end sends as often, and says in each datagram which was the newest that it heard.
            home_ns = back_way.arrives(now + back_ns)
            there = round(now * (1.0 + drift)) + OFFSET_NS
            reports.append((home_ns, (*heard, there, home_ns), newest + 1, arrived))
        if not in_order:
            reports = deque(sorted(reports, key=lambda report: report[0]))
        while reports and reports[0][0] <= now:
            _, exchange, expected, count = reports.popleft()
            seen_line.record(*exchange)
            delivery.record(exchange[1], expected, count)
        if now >= next_update:
            next_update = now + 50 * MS
            rate = delivery.rate(float(size), most)
            if rate is not None and seen_line.there_ns is not None:
                seen = PathEstimate(seen_line.there_ns, *rate, line.delay_ns + back_ns, seen_line.there_variation_ns)
                control.update(now, seen, least_hz * size)
                budget.limit(control.bytes_per_s, float(size), now)
        if now >= next_second:
            next_second = now + 1_000 * MS
            queue_ms.append(max(waits, default=0.0))
            rate_hz.append(sent_now - sent_then)
            waits, sent_then = [], sent_now
    return Ending(queue_ms[1:], rate_hz[1:], control, seen_line, tcp_bytes, sent_ns, waits_ns)
