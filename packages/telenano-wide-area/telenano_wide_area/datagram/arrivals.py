"""Record of a real network: for each datagram of one direction whether it arrived, when, and with which delay."""

from array import array
from collections import deque
from typing import NamedTuple

from telenano.wire import LinkNetwork
from telenano_wide_area.datagram.replay_window import WINDOW, ReplayWindow

# The most rows kept for one report: some seconds of the busiest direction.
MOST_ROWS = 4096


class Fates(NamedTuple):
    """The fate of each datagram, in the order in which it became known; columns, because there are a thousand a second.

    `raw_ns` is the time of arrival minus that of sending, by two clocks; both times are 0 for a lost datagram.
    """

    number: "array[int]"
    arrived_ns: "array[int]"
    raw_ns: "array[int]"
    lost: "array[int]"

    def add(self, number: int, arrived_ns: int, raw_ns: int, lost: int) -> None:
        self.number.append(number)
        self.arrived_ns.append(arrived_ns)
        self.raw_ns.append(raw_ns)
        self.lost.append(lost)


def no_fates() -> Fates:
    """Return columns without rows."""
    return Fates(array("q"), array("q"), array("q"), array("B"))


class ArrivalRecord:
    """Counts of one direction at its receiving end, across changes of keys."""

    def __init__(self) -> None:
        self.arrived = 0
        self.late = 0
        self.lost = 0
        self._fates = no_fates()
        # The number of datagrams under earlier keys.
        self._base = 0
        self._window = ReplayWindow()
        self._settled = 0
        # The number of the first datagram that arrived under the present keys; earlier ones were sent before this end
        # had these keys.
        self._first = 0
        self._arrived_of_keys = 0
        # The number of arrivals whose sequence numbers are not settled yet.
        self._unsettled = 0
        self._newest_at: deque[tuple[int, int]] = deque()

    @property
    def sent(self) -> int:
        """The number of datagrams that the other end has sent, as far as the newest arrival shows it."""
        return self._base + self._window.newest + 1 - self._first if self._arrived_of_keys else self._base

    @property
    def settled(self) -> int:
        """The number of datagrams that are known to have arrived or to be lost; `lost` counts some of these."""
        return self._base + max(0, self._settled - self._first) if self._arrived_of_keys else self._base

    @property
    def of_keys(self) -> tuple[int, int]:
        """The numbers of datagrams sent and arrived since the keys changed."""
        return self._window.newest + 1, self._arrived_of_keys

    def begin(self, window: ReplayWindow) -> None:
        """Continue under new keys, whose accepted numbers are in `window`; open numbers of the old keys are lost."""
        if self._arrived_of_keys:
            self._settle_up_to(self._window.newest + 1)
        self._base = self.sent
        self._window, self._settled, self._arrived_of_keys, self._unsettled = window, 0, 0, 0
        self._newest_at.clear()

    def record(self, number: int, sent_ns: int, arrived_ns: int) -> None:
        """Record a datagram that was opened, so that its number is in the window of the present keys."""
        if not self._arrived_of_keys:
            self._first = self._settled = number
        self.arrived += 1
        self._arrived_of_keys += 1
        self.late += number < self._window.newest
        if number < self._first:
            self._first = number
        elif number < self._settled:
            self.lost -= 1
        self._unsettled += number >= self._settled
        self._keep(number, arrived_ns, arrived_ns - sent_ns, 0)

    def settle(self, now_ns: int) -> None:
        """Count as lost the datagrams that newer ones overtook longer ago than LinkNetwork.SETTLE_NS."""
        self._newest_at.append((now_ns, self._window.newest))
        while self._newest_at and now_ns - self._newest_at[0][0] >= LinkNetwork.SETTLE_NS:
            _, newest = self._newest_at.popleft()
            self._settle_up_to(newest + 1)

    def take_fates(self) -> Fates:
        """Return the fates that became known since the last call, at most MOST_ROWS."""
        fates, self._fates = self._fates, no_fates()
        return fates

    def _settle_up_to(self, end: int) -> None:
        oldest = self._window.newest - WINDOW + 1
        if self._settled < oldest:
            self._pass_over(min(end, oldest))
        for number in range(self._settled, end):
            if self._window.has(number):
                self._unsettled -= 1
            else:
                self.lost += 1
                self._keep(number, 0, 0, 1)
        self._settled = max(self._settled, end)

    def _pass_over(self, end: int) -> None:
        """Settle numbers that have left the window, however many; only the count of arrivals among them is known."""
        newest = self._window.newest
        within = sum(map(self._window.has, range(newest - WINDOW + 1, newest + 1)))
        arrived = max(0, self._unsettled - within)
        self.lost += end - self._settled - arrived
        self._unsettled = within
        if not arrived:
            room = MOST_ROWS - len(self._fates.number)
            for number in range(self._settled, min(end, self._settled + room)):
                self._keep(number, 0, 0, 1)
        self._settled = end

    def _keep(self, number: int, arrived_ns: int, raw_ns: int, lost: int) -> None:
        if len(self._fates.number) < MOST_ROWS:
            self._fates.add(self._base + number, arrived_ns, raw_ns, lost)
