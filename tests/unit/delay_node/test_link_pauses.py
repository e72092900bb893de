"""What the link reports goes out a piece in each pause of the loop, and at once where nothing ticks."""

from pathlib import Path
from typing import Any

import pytest

from services.delay_node.config import parse_settings
from services.delay_node.node import DelayNode
from services.runtime.loop.journal import StateSnapshot
from services.runtime.loop.node_state import restore

MS = 1_000_000
ZERO = (0.0, 0.0, 0.0)
SIGNAL: dict[str, Any] = {
    "law": "wave",
    "active": True,
    "position_m": ZERO,
    "velocity_m_per_s": ZERO,
    "wave_sqrt_w": None,
    "energy_j": None,
    "hand_seq": 1,
    "hand_t_ns": 1,
    "force_n": ZERO,
    "separation_m": 0.0,
    "separation_valid": False,
    "in_contact": False,
}


class Endpoint:
    """An endpoint at a site: keeps what the link publishes of its own, with the time."""

    def __init__(self, bench: Any, sent: list[tuple[str, int]]) -> None:
        self._bench, self._sent = bench, sent

    def send(self, topic: str, payload: bytes) -> None:
        """Send on what others published."""

    def publish(self, topic: str, **fields: Any) -> Any:
        self._sent.append((topic, self._bench.clock.monotonic_ns()))

    def sequence_numbers(self) -> dict[str, int]:
        return {}


class Link:
    def __init__(self, bench_of: Any) -> None:
        self.bench = bench_of("delay_node@master")
        # of both endpoints and of the link itself, in the order of sending
        self.sent: list[tuple[str, int]] = []
        outlets = (Endpoint(self.bench, self.sent), Endpoint(self.bench, self.sent))
        self.node = DelayNode(self.bench.context, parse_settings({}), *outlets, Path())
        self.node.publish = self.noted
        self.snapshot = StateSnapshot(self.node)

    def noted(self, topic: str, **fields: Any) -> Any:
        self.sent.append((topic, self.bench.clock.monotonic_ns()))

    def tick(self) -> None:
        """Let a tick come back, and time pass until the next one."""
        self.node.on_message(self.bench.received("teleop/backward", "controller@slave", **SIGNAL))
        self.pass_time(MS)

    def pass_time(self, duration_ns: int) -> None:
        clock = self.bench.clock
        end_ns = clock.monotonic_ns() + duration_ns
        while (due_ns := min(self.node.deadline_ns(), self.node.quiet_work.due_ns)) < end_ns:
            clock.advance_ns(max(0, due_ns - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())
        clock.advance_ns(end_ns - clock.monotonic_ns())


@pytest.fixture
def link(bench_of: Any) -> Link:
    return Link(bench_of)


REPORT = ["link/status", "link/delay", "link/delay", "link/delay", "clock/ping"]


def test_without_ticks_the_whole_report_goes_out_ten_times_a_second(link: Link) -> None:
    begun_ns = link.bench.clock.monotonic_ns()
    link.pass_time(250 * MS)
    assert link.sent == [(topic, begun_ns + at * MS) for at in (100, 200) for topic in REPORT]


def test_in_a_loop_each_piece_has_a_pause_of_its_own(link: Link) -> None:
    begun_ns = link.bench.clock.monotonic_ns()
    for _ in range(210):
        link.tick()
    times: dict[int, list[str]] = {}
    for topic, t_ns in link.sent:
        times.setdefault(t_ns - begun_ns, []).append(topic)
    # never in the turn of a tick, and always as long after it
    assert {t_ns % MS for t_ns in times} == {link.node.pause_after_ns}
    # the forward delay is declared at both sites
    assert {tuple(topics) for topics in times.values()} == {
        ("link/fates",), ("link/status",), ("link/delay", "link/delay"), ("link/delay",), ("clock/ping",)
    }  # fmt: skip
    reports = [topic for topic, _ in link.sent if topic != "link/fates"]
    assert reports == REPORT * 2
    # a row of fates for every message, 32 or more at a time, and those of a report
    assert 6 <= [topic for topic, _ in link.sent].count("link/fates") <= 9


def test_where_the_ticks_end_the_rest_of_a_report_waits_for_20_ms(link: Link) -> None:
    begun_ns = link.bench.clock.monotonic_ns()
    for _ in range(101):
        link.tick()
    sent = len(link.sent)
    link.pass_time(50 * MS)
    late = link.sent[sent:]
    assert late[-1][0] == "clock/ping"
    assert {t_ns - begun_ns for _, t_ns in late} == {120 * MS}


def test_a_link_that_is_restored_within_a_report_goes_on_with_its_pieces(link: Link, bench_of: Any) -> None:
    for _ in range(102):
        link.tick()
    state = link.snapshot.capture()
    assert state
    other = Link(bench_of)
    restore(other.node, state)
    other.bench.clock.advance_ns(link.bench.clock.monotonic_ns() - other.bench.clock.monotonic_ns())
    sent = len(link.sent)
    for _ in range(20):
        link.tick()
        other.tick()
    assert [topic for topic, _ in link.sent[sent:] if topic != "link/fates"]
    assert other.sent == link.sent[sent:]
