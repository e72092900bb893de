"""What a revocation closes: its endpoint, once, and no other; and an endpoint that cannot be bound again."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zmq
from network_bench import AFM, CONTROLLER, PATIENCE_S, Machine, two_machine_book, until

from telenano.runtime.bus.socket_monitor import CLOSED_IN_HANDSHAKE, CONNECTED
from telenano.runtime.security import zap_authenticator
from telenano.runtime.security.zap_authenticator import BoundEndpoint, ZapAuthenticator


@pytest.fixture
def machines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Machine, Machine]]:
    for name in ("TELENANO_HOST_MASTER", "TELENANO_HOST_SLAVE", "TELENANO_BIND_ADDRESS"):
        monkeypatch.delenv(name, raising=False)
    book = two_machine_book(tmp_path)
    master, slave = Machine("master", book, tmp_path), Machine("slave", book, tmp_path)
    for one, other in ((master, slave), (slave, master)):
        one.knows(other)
        one.open()
    yield master, slave
    for machine in (master, slave):
        machine.close()


def handshake(
    authenticator: ZapAuthenticator,
    context: "zmq.Context[zmq.Socket[bytes]]",
    client: Machine,
    server: Machine,
    answer: Callable[[], Any],
) -> str:
    """Return how the first handshake of a client ends at a socket that an authenticator has prepared."""
    publisher = context.socket(zmq.PUB)
    authenticator.prepare(publisher, AFM)
    subscriber = context.socket(zmq.SUB)
    events = subscriber.get_monitor_socket(CONNECTED)
    subscriber.set(zmq.CURVE_PUBLICKEY, client.ring.own(client.name).public)
    subscriber.set(zmq.CURVE_SECRETKEY, client.ring.own(client.name).secret)
    subscriber.set(zmq.CURVE_SERVERKEY, server.ring.own(server.name).public)
    try:
        port = publisher.bind_to_random_port("tcp://127.0.0.1")
        subscriber.connect(f"tcp://127.0.0.1:{port}")
        end_s = time.monotonic() + PATIENCE_S
        while not events.poll(5):
            assert time.monotonic() < end_s
            # where nobody answers for the key, it is the server that closes the connection
            if any(event.kind == CLOSED_IN_HANDSHAKE for event in authenticator._monitors[AFM].events()):
                return "refused"
            answer()
        return "accepted"
    finally:
        subscriber.disable_monitor()
        authenticator.abandon(AFM)
        for socket in (events, subscriber, publisher):
            socket.close(0)


class PlainSocket:
    """A socket that notes what is done to it; while it is stubborn, somebody else has its port when it is let go."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.stubborn = False

    def unbind(self, endpoint: str) -> None:
        self.calls.append(f"unbind {endpoint}")

    def bind(self, endpoint: str) -> None:
        self.calls.append(f"bind {endpoint}")
        if self.stubborn:
            raise zmq.ZMQError(zmq.EADDRINUSE)


def endpoint_of(machine: Machine, node: str, port: int) -> tuple[BoundEndpoint, PlainSocket]:
    """Return an endpoint of a machine's authenticator on a socket that does nothing."""
    socket = PlainSocket()
    quiet = SimpleNamespace(events=list, has_pending=False, socket=None)
    publisher = SimpleNamespace(socket=socket, node=node)
    bound = BoundEndpoint(publisher, quiet, f"tcp://127.0.0.1:{port}")
    machine.network._authenticator.endpoints.append(bound)
    return bound, socket


def test_the_end_of_a_process_waits_for_no_answer_that_a_client_has_not_read(machines: tuple[Machine, Machine]) -> None:
    for machine in machines:
        socket = machine.network._authenticator.socket
        assert socket is not None
        assert socket.get(zmq.LINGER) == 0


def test_a_revocation_closes_its_endpoint_once_and_no_other(machines: tuple[Machine, Machine]) -> None:
    master, slave = machines
    authenticator = slave.network._authenticator
    first, first_socket = endpoint_of(slave, AFM, 1)
    other, other_socket = endpoint_of(slave, CONTROLLER, 2)
    stranger = zmq.curve_keypair()[0].decode()
    first.accepted.update({master.key, stranger})
    other.accepted.add(master.key)
    try:
        authenticator.apply_permissions()
        assert first_socket.calls == ["unbind tcp://127.0.0.1:1", "bind tcp://127.0.0.1:1"]
        assert other_socket.calls == []
        (event,) = authenticator.take_events()
        assert (event.level, event.data) == ("warning", {"endpoint": first.endpoint, "connection": "revoked"})
        assert (first.unbound, first.attempts) == (False, 0)
        # whoever comes back is asked for the key again, so what was accepted before counts no longer
        assert (first.accepted, other.accepted) == (set(), {master.key})
        authenticator.apply_permissions()
        assert len(first_socket.calls) == 2
        assert authenticator.take_events() == []
    finally:
        authenticator.endpoints.clear()


def test_an_endpoint_that_cannot_be_bound_again_is_reported_and_retried_without_holding_the_loop(
    machines: tuple[Machine, Machine], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zap_authenticator, "_FAST_REBINDS", 3)
    authenticator = machines[1].network._authenticator
    bound, socket = endpoint_of(machines[1], AFM, 1)
    socket.stubborn = True
    try:
        bound.accepted.add(zmq.curve_keypair()[0].decode())
        authenticator.apply_permissions()
        assert [authenticator.process_events() for _ in range(4)] == [True, False, False, False]
        texts = [event.text for event in authenticator.take_events()]
        assert len(texts) == 2
        assert texts[1] == (
            f"{AFM} cannot bind tcp://127.0.0.1:1 again: Address already in use; retrying twice a second"
        )
        # a client that was being answered when the endpoint was unbound, and is revoked in his turn
        bound.accepted.add(zmq.curve_keypair()[0].decode())
        authenticator.apply_permissions()
        socket.stubborn = False
        assert not authenticator.process_events()
        authenticator.process_events()
        assert [call.split()[0] for call in socket.calls] == ["unbind"] + ["bind"] * 7
        assert bound.unbound is False
    finally:
        authenticator.endpoints.clear()


def test_a_machine_that_came_back_after_a_revocation_of_another_is_left_alone_by_the_next_change(
    machines: tuple[Machine, Machine],
) -> None:
    master, slave = machines
    slave.bind(AFM)
    master.subscribe({AFM: ["afm/state"]})
    until(lambda: master.texts("up"), master, slave)
    bound = slave.network._authenticator.endpoints[0]
    laptop = zmq.curve_keypair()[0].decode()
    slave.ring.allow("laptop", laptop, ["observe"])
    bound.accepted.add(laptop)
    slave.ring.revoke("laptop")
    until(lambda: slave.texts("revoked") and len(master.texts("up")) == 2, master, slave)
    assert bound.accepted == {master.key}
    # a change of the list that concerns nobody here
    slave.ring.allow("another", zmq.curve_keypair()[0].decode(), ["observe"])
    for _ in range(60):
        master.turn()
        slave.turn()
    assert (len(slave.texts("revoked")), len(master.texts("down"))) == (1, 1)


def test_a_turn_that_leaves_events_of_connections_says_so_because_no_descriptor_will(
    machines: tuple[Machine, Machine],
) -> None:
    authenticator = machines[1].network._authenticator
    bound, _ = endpoint_of(machines[1], AFM, 1)
    try:
        assert not authenticator.process_events()
        bound.monitor.has_pending = True
        assert authenticator.process_events()
    finally:
        authenticator.endpoints.clear()
