"""Models shared by all messages under the same settings: a server of finite throughput, its queue, and slots."""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from telenano.link.random_streams import Draw
from telenano.settings.link_settings import Queue

Item = TypeVar("Item")
# Most slots that are drawn one by one for a message; a longer pause is skipped, because it would block the link.
_LONGEST_WALK = 20_000


class Passage(NamedTuple):
    """Times of a message's passage through a server [ns]."""

    leave_ns: int  # leaves the queue; from here on nothing can drop it
    finish_ns: int  # last byte sent


class Server(Protocol):
    """Server that sends one message after the other; `is_instant` is True if this takes no time."""

    is_instant: bool
    state: Any

    def passage(self, ready_ns: int, size_bytes: int) -> Passage:
        """Return the passage of the next message without sending it."""

    def send(self, ready_ns: int, size_bytes: int) -> int:
        """Send the next message; return the time at which its last byte is sent [ns]."""

    def wait_until(self, free_ns: int) -> None:
        """Start no transmission before `free_ns` [ns], because an earlier server is still sending."""


class RateServer:
    """Sends at a constant rate: start = max(ready, free), finish = start + size/rate."""

    __slots__ = ("_ns_per_byte", "_overhead_bytes", "is_instant", "state")

    def __init__(self, rate_bytes_per_s: float, overhead_bytes: int) -> None:
        self._ns_per_byte = 1e9 / rate_bytes_per_s
        self._overhead_bytes = overhead_bytes
        self.is_instant = self._ns_per_byte == 0.0
        # Time at which the server has sent everything [ns].
        self.state = 0

    def passage(self, ready_ns: int, size_bytes: int) -> Passage:
        start_ns = max(ready_ns, self.state)
        return Passage(start_ns, start_ns + round((size_bytes + self._overhead_bytes) * self._ns_per_byte))

    def send(self, ready_ns: int, size_bytes: int) -> int:
        self.state = self.passage(ready_ns, size_bytes).finish_ns
        return self.state

    def wait_until(self, free_ns: int) -> None:
        self.state = max(self.state, free_ns)


class DeliveryState(NamedTuple):
    """Origin of the trace [ns], number of the current opportunity, and its remaining capacity.

    The capacity is a size [bytes], or without a byte limit a number of messages (0 or 1).
    """

    origin_ns: int
    opportunity: int
    left: int


class DeliveryServer:
    """Sends at recorded opportunities with a fixed number of bytes each; unused capacity is lost.

    The trace repeats with its last time as the period. A message that exceeds the remaining capacity continues at the
    next opportunity and is delivered with its last byte. Without a byte limit each opportunity carries one message.
    """

    __slots__ = ("_bytes", "_times_ns", "state")
    is_instant = False

    def __init__(self, times_ns: Sequence[int], bytes_per_opportunity: int | None, origin_ns: int) -> None:
        self._times_ns = times_ns
        self._bytes = bytes_per_opportunity
        self.state = DeliveryState(origin_ns, 0, bytes_per_opportunity or 1)

    def passage(self, ready_ns: int, size_bytes: int) -> Passage:
        finish_ns = self._time_ns(self._seek(ready_ns, size_bytes)[0])
        return Passage(finish_ns, finish_ns)

    def send(self, ready_ns: int, size_bytes: int) -> int:
        index, left = self._seek(ready_ns, size_bytes)
        self.state = DeliveryState(self.state.origin_ns, index, left)
        return self._time_ns(index)

    def wait_until(self, free_ns: int) -> None:
        self.send(free_ns, 0)

    def _seek(self, ready_ns: int, size_bytes: int) -> tuple[int, int]:
        """Return the number of the last opportunity that a message needs, and the capacity that then remains."""
        _, index, left = self.state
        earliest = self._first_from(ready_ns)
        if earliest > index:
            index, left = earliest, self._bytes or 1
        if self._bytes is None:
            need = min(size_bytes, 1)
            return (index, left - need) if left >= need else (index + 1, 1 - need)
        if size_bytes > left:
            further = -(-(size_bytes - left) // self._bytes)
            index, left = index + further, left + further * self._bytes
        return index, left - size_bytes

    def _first_from(self, ready_ns: int) -> int:
        # The last opportunity belongs to the cycle that it ends, so a cycle is (0, period]; the first also includes 0.
        period_ns, elapsed_ns = self._times_ns[-1], max(0, ready_ns - self.state.origin_ns)
        cycle = max(0, elapsed_ns - 1) // period_ns
        return cycle * len(self._times_ns) + bisect_left(self._times_ns, elapsed_ns - cycle * period_ns)

    def _time_ns(self, index: int) -> int:
        cycle, place = divmod(index, len(self._times_ns))
        return self.state.origin_ns + cycle * self._times_ns[-1] + self._times_ns[place]


class Waiting(NamedTuple, Generic[Item]):
    """A message in the queue."""

    ready_ns: int
    size_bytes: int
    topic: str
    reliable: bool
    order: int  # of arrival
    item: Item


class QueueState(NamedTuple):
    """Time at which everything that has left the queue is sent [ns], and the state of the server."""

    free_ns: int
    server: Any


class ServedQueue(Generic[Item]):
    """A first-in first-out queue before a server, with limits on the waiting messages and a drop policy.

    The message that the server is sending has left the queue. Reliable messages may exceed the limits and are never
    dropped.
    """

    def __init__(self, limits: Queue, server: Server, draw: Draw) -> None:
        self._limits = limits
        self._server = server
        self.is_instant = server.is_instant  # it holds what waits for the end of an outage, and nothing else
        self._draw = draw
        self._waiting: deque[Waiting[Item]] = deque()
        self._bytes = 0
        self.leave_ns: int | None = None  # when the foremost message leaves the queue
        self.free_ns = 0  # when the last byte of all that has left the queue is sent

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def state(self) -> QueueState:
        """The state without the waiting messages, whose items the queue cannot encode."""
        return QueueState(self.free_ns, self._server.state)

    @state.setter
    def state(self, state: QueueState) -> None:
        self.free_ns, self._server.state = state

    @property
    def waiting(self) -> Sequence[Waiting[Item]]:
        return tuple(self._waiting)

    def refill(self, waiting: Iterable[Waiting[Item]]) -> None:
        """Replace the waiting messages by these, regardless of the limits."""
        self._waiting = deque(waiting)
        self._bytes = sum(entry.size_bytes for entry in self._waiting)
        self._update_leave_time()

    def is_open(self, ready_ns: int) -> bool:
        """Return whether a message that is ready at this time [ns] passes at once without changing the queue."""
        return self.is_instant and not self._waiting and self.free_ns <= ready_ns

    def holds_before(self, topic: str, order: int) -> bool:
        """Return whether a message of a topic waits that arrived before the message with this order of arrival."""
        return any(entry.topic == topic and entry.order < order for entry in self._waiting)

    def wait_until(self, free_ns: int) -> None:
        self.free_ns = max(self.free_ns, free_ns)
        self._server.wait_until(free_ns)
        self._update_leave_time()

    def push(self, entry: Waiting[Item]) -> list[Item]:
        """Add a message; return the items that were dropped, which may include its own."""
        dropped: list[Item] = []
        while not entry.reliable and not self._has_room(entry):
            victim = self._victim(entry)
            if victim is None:
                return [*dropped, entry.item]
            dropped.append(self._remove(victim))
        self._waiting.append(entry)
        self._bytes += entry.size_bytes
        if len(self._waiting) == 1:
            self._update_leave_time()
        return dropped

    def pop(self) -> tuple[Item, int]:
        """Send the foremost message; return its item and the time at which its last byte is sent [ns]."""
        entry = self._waiting.popleft()
        self._bytes -= entry.size_bytes
        self.free_ns = self._server.send(entry.ready_ns, entry.size_bytes)
        self._update_leave_time()
        return entry.item, self.free_ns

    def _update_leave_time(self) -> None:
        head = self._waiting[0] if self._waiting else None
        self.leave_ns = None if head is None else self._server.passage(head.ready_ns, head.size_bytes).leave_ns

    def _has_room(self, entry: Waiting[Item]) -> bool:
        # A message that the idle server takes at once does not wait, so it passes even a queue of length 0.
        if not self._waiting and self._server.passage(entry.ready_ns, entry.size_bytes).leave_ns <= entry.ready_ns:
            return True
        most, most_bytes = self._limits.limit_messages, self._limits.limit_bytes
        return (most is None or len(self._waiting) < most) and (
            most_bytes is None or self._bytes + entry.size_bytes <= most_bytes
        )

    def _victim(self, arriving: Waiting[Item]) -> int | None:
        """Return the index of the message to drop; None for the arriving one."""
        most_bytes = self._limits.limit_bytes
        if self._limits.drop == "tail" or (most_bytes is not None and arriving.size_bytes > most_bytes):
            return None
        topic = arriving.topic if self._limits.drop == "same_topic" else None
        at_risk = ((n, entry) for n, entry in enumerate(self._waiting) if not entry.reliable)
        places = (n for n, entry in at_risk if topic is None or entry.topic == topic)
        if self._limits.drop == "random":
            # The arriving message is one of the candidates.
            all_places = [*places, None]
            return all_places[int(self._draw() * len(all_places))]
        return next(places, None)

    def _remove(self, place: int) -> Item:
        entry = self._waiting[place]
        del self._waiting[place]
        self._bytes -= entry.size_bytes
        self._update_leave_time()
        return entry.item


class SlotState(NamedTuple):
    """Times of the slots drawn so far [ns], and the number of messages and bytes in each, by its time."""

    times_ns: list[int]
    messages: dict[int, int]
    size_bytes: dict[int, int]


class SlotGate:
    """Slots at random intervals, uniform between the shortest and the longest; each has a limited capacity.

    A message that would be released at t leaves with the first slot at or after t that has room. A message larger than
    a whole slot gets a slot of its own.
    """

    def __init__(
        self,
        interval_ns: tuple[int, int],
        max_messages: int | None,
        max_bytes: int | None,
        origin_ns: int,
        draw: Draw,
    ) -> None:
        self._shortest_ns, longest_ns = interval_ns
        self._spread_ns = longest_ns - self._shortest_ns
        self._max_messages = max_messages
        self._max_bytes = max_bytes
        self._draw = draw
        self.state = SlotState([origin_ns], {}, {})

    def slot_ns(self, now_ns: int, release_ns: int, size_bytes: int) -> int:
        """Reserve room in a slot; no later call may request a time before `now_ns`.

        Returns:
            The time of the slot [ns], >= release_ns.
        """
        if len(self.state.times_ns) > 512 and self.state.times_ns[256] < now_ns:
            self._forget(now_ns)
        interval_ns = self._shortest_ns + self._spread_ns // 2
        if release_ns - self.state.times_ns[-1] > _LONGEST_WALK * interval_ns:
            # After a long pause, draw one slot at random within the last interval before the release.
            self.state.times_ns.append(release_ns - int(self._draw() * interval_ns))
        place = bisect_left(self.state.times_ns, release_ns)
        while self._is_full(time_ns := self._slot(place), release_ns, size_bytes):
            place += 1
        self.state.messages[time_ns] = self.state.messages.get(time_ns, 0) + 1
        self.state.size_bytes[time_ns] = self.state.size_bytes.get(time_ns, 0) + size_bytes
        return time_ns

    def _is_full(self, time_ns: int, release_ns: int, size_bytes: int) -> bool:
        if time_ns < release_ns:
            return True
        messages = self.state.messages.get(time_ns, 0)
        return (self._max_messages is not None and messages >= self._max_messages) or (
            self._max_bytes is not None
            and messages > 0
            and self.state.size_bytes[time_ns] + size_bytes > self._max_bytes
        )

    def _slot(self, place: int) -> int:
        while len(self.state.times_ns) <= place:
            self.state.times_ns.append(
                self.state.times_ns[-1] + self._shortest_ns + int(self._draw() * self._spread_ns)
            )
        return self.state.times_ns[place]

    def _forget(self, now_ns: int) -> None:
        # Keep the last slot, because the next one is drawn from it.
        past = min(bisect_left(self.state.times_ns, now_ns), len(self.state.times_ns) - 1)
        for time_ns in self.state.times_ns[:past]:
            self.state.messages.pop(time_ns, None)
            self.state.size_bytes.pop(time_ns, None)
        del self.state.times_ns[:past]
