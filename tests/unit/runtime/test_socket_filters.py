"""How many connections an endpoint accepts: tokens in virtual time, and filters on real sockets."""

import contextlib
import select
import socket
from collections.abc import Iterator

import pytest

from services.runtime.security import socket_filters
from services.runtime.security.socket_filters import BURST, PER_S, AcceptLimiter, Admission, syn_filter

S = 1_000_000_000
KNOWN, STRANGER = "127.0.0.2", "127.0.0.3"


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as found:
        yield found


def port_of(listener: socket.socket) -> int:
    return listener.getsockname()[1]


def watching(listener: socket.socket, *known: str) -> AcceptLimiter:
    limiter = AcceptLimiter(known, 0)
    limiter.watch(listener.fileno(), port_of(listener))
    return limiter


@contextlib.contextmanager
def attempt(listener: socket.socket, source: str) -> Iterator[socket.socket]:
    with socket.socket(listener.family) as client:
        client.setblocking(False)
        client.bind((source, 0))
        client.connect_ex(listener.getsockname()[:2])
        yield client


def is_accepted(listener: socket.socket, source: str) -> bool:
    """Return whether a connection from an address is there at once; on this machine it is, or it is not at all."""
    with attempt(listener, source) as client:
        accepted = bool(select.select((), (client,), (), 0)[1])
        if accepted:
            listener.accept()[0].close()
        return accepted


def test_a_burst_is_accepted_then_known_machines_then_nobody(listener: socket.socket) -> None:
    limiter = watching(listener, KNOWN)
    assert (limiter.admission, limiter.calm) == (Admission.EVERYBODY, True)
    limiter.count(int(BURST) - 1, 0)
    assert (limiter.admission, limiter.calm) == (Admission.EVERYBODY, False)
    assert is_accepted(listener, STRANGER)
    limiter.count(1, 0)
    assert limiter.admission is Admission.KNOWN_MACHINES
    assert (is_accepted(listener, KNOWN), is_accepted(listener, STRANGER)) == (True, False)
    limiter.count(int(BURST), 0)
    assert limiter.admission is Admission.NOBODY
    assert (is_accepted(listener, KNOWN), is_accepted(listener, STRANGER)) == (False, False)
    limiter.close()


def test_what_is_accepted_over_time_is_what_was_allowed(listener: socket.socket) -> None:
    limiter = watching(listener)
    accepted = 0
    for tick in range(1000):
        # a stranger that asks as often as he can
        count = 5 if limiter.admission is Admission.EVERYBODY else 0
        accepted += count
        limiter.count(count, tick * S // 100)
    assert accepted <= BURST + 10.0 * PER_S + 5
    assert accepted >= BURST + 9.0 * PER_S
    limiter.close()


def test_debts_are_bounded_so_that_a_flood_has_an_end(listener: socket.socket) -> None:
    limiter = watching(listener, KNOWN)
    for _ in range(2):
        limiter.count(100_000, 0)
    assert limiter.admission is Admission.NOBODY
    soon = round((BURST + 1.5) / PER_S * S)
    limiter.count(0, soon)
    assert limiter.admission is Admission.EVERYBODY
    assert is_accepted(listener, STRANGER)
    assert not limiter.calm
    limiter.count(0, soon + round(BURST / PER_S * S))
    assert limiter.calm
    limiter.close()


def test_machines_of_the_site_file_come_before_others_after_a_flood(listener: socket.socket) -> None:
    limiter = watching(listener, KNOWN)
    # all of it strangers: those that were accepted when only known machines should be were under way
    limiter.count(int(BURST) + 15, 0)
    limiter.count(0, S // 10)
    assert limiter.admission is Admission.KNOWN_MACHINES
    assert (is_accepted(listener, KNOWN), is_accepted(listener, STRANGER)) == (True, False)
    limiter.close()


def test_connections_that_exist_are_left_alone(listener: socket.socket) -> None:
    limiter = watching(listener, KNOWN)
    with attempt(listener, STRANGER) as before:
        old, _ = listener.accept()
        limiter.count(int(BURST), 0)
        with attempt(listener, KNOWN) as client:
            # this one inherits the filter of its listener
            new, _ = listener.accept()
            limiter.count(int(BURST), 0)
            for here, there in ((old, before), (new, client)):
                here.sendall(b"answer")
                there.setblocking(True)
                there.sendall(b"question")
                assert (there.recv(6), here.recv(8)) == (b"answer", b"question")
                here.close()
    limiter.close()


def test_the_limit_ends_with_the_limiter_and_the_port_with_its_owner(listener: socket.socket) -> None:
    limiter = watching(listener)
    limiter.count(int(BURST), 0)
    assert not is_accepted(listener, STRANGER)
    port = port_of(listener)
    limiter.close()
    listener.close()
    with socket.create_server(("127.0.0.1", port)) as again:
        limiter.watch(again.fileno(), port)
        assert is_accepted(again, STRANGER)
        # the debt is kept
        limiter.count(0, 0)
        assert not is_accepted(again, STRANGER)
        limiter.close()


def test_a_descriptor_that_is_no_listener_of_the_port_is_left_alone(listener: socket.socket) -> None:
    limiter = AcceptLimiter((), 0)
    with socket.socket() as other, contextlib.closing(limiter):
        closed = socket.socket()
        number = closed.fileno()
        closed.close()
        for descriptor, port in (
            (number, port_of(listener)),
            (other.fileno(), port_of(listener)),
            (listener.fileno(), port_of(listener) + 1),
        ):
            limiter.watch(descriptor, port)
            limiter.count(1000, 0)
            assert is_accepted(listener, STRANGER)


def test_addresses_of_ipv6_are_told_apart_too() -> None:
    try:
        listener = socket.create_server(("::", 0), family=socket.AF_INET6, dualstack_ipv6=True)
    except OSError:
        pytest.skip("this machine has no IPv6")
    with listener:
        for known, source, accepted in (
            (("::1", "2001:db8::7"), "::1", True),
            (("2001:db8::7", "::1"), "::1", True),
            (("2001:db8::7", "::2"), "::1", False),
            (("127.0.0.1",), "::1", False),
        ):
            limiter = watching(listener, *known)
            limiter.count(int(BURST), 0)
            with socket.socket(socket.AF_INET6) as client:
                client.setblocking(False)
                client.bind((source, 0))
                client.connect_ex(("::1", port_of(listener)))
                assert bool(select.select((), (client,), (), 0)[1]) is accepted
            # an IPv4 client of the same socket
            with socket.socket() as client:
                client.setblocking(False)
                client.connect_ex(("127.0.0.1", port_of(listener)))
                assert bool(select.select((), (client,), (), 0)[1]) is ("127.0.0.1" in known)
            limiter.close()


def test_no_jump_of_the_longest_filter_is_too_far() -> None:
    many = [f"2001:db8::{number:x}" for number in range(1000)] + [f"10.0.{number}.1" for number in range(200)]
    limiter = AcceptLimiter(many, 0)
    program = list(syn_filter(limiter._addresses))
    assert max(max(step.if_true, step.if_false) for step in program) < 256
    assert len(limiter._addresses) == socket_filters._MOST_ADDRESSES
