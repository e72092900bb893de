"""Two machines over CURVE: whose messages arrive, who is refused, how that is reported, and what recovers by itself."""

import contextlib
import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import pytest
import zmq
from network_bench import (
    AFM,
    CONTROLLER,
    LINK,
    PATIENCE_S,
    Machine,
    payload,
    port_of,
    receives_more,
    turns,
    two_machine_book,
    until,
)

from telenano.runtime.bus import socket_monitor
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Subscriber, ZmqBus
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.bus.socket_monitor import (
    CLOSED_IN_HANDSHAKE,
    CONNECTED,
    DISCONNECTED,
    FAILURES,
    PROTOCOL_FAILED,
    Monitor,
    MonitorEvent,
)
from telenano.runtime.security import peer_connections, zap_authenticator
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.security.peer_connections import MessagePermissions, PeerConnections
from telenano.runtime.security.zap_authenticator import _is_of_this_user
from telenano.runtime.wiring import transport
from telenano.runtime.wiring.transport import Transport
from telenano.testing import VirtualClock, free_ports
from telenano.timing.clock import SystemClock
from telenano.wire.codec import WireError
from telenano.wire.errors import ConfigError, EndpointError

OPERATOR = "controller@master"


@pytest.fixture(autouse=True)
def _no_address_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("TELENANO_HOST_MASTER", "TELENANO_HOST_SLAVE", "TELENANO_BIND_ADDRESS"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def world(tmp_path: Path) -> Iterator[Callable[..., list[Machine]]]:
    """Make machines, master and slave and more by name, that know one another unless `strangers`."""
    made: list[Machine] = []

    def make(*names: str, book: AddressBook | None = None, strangers: bool = False) -> list[Machine]:
        book = book or two_machine_book(tmp_path)
        machines = [Machine(name, book, tmp_path) for name in names or ("master", "slave")]
        for one in machines:
            for other in machines:
                if one is not other and book.requires_keys and not strangers:
                    one.knows(other)
        made.extend(machines)
        return machines

    yield make
    for machine in made:
        if hasattr(machine, "network"):
            machine.close()


def join(slave: Machine, *readers: Machine) -> None:
    """Have a slave publish the state of the instrument, and machines subscribe to it."""
    slave.open().bind(AFM)
    for reader in readers:
        reader.open().subscribe({AFM: ["afm/state"]})


@pytest.fixture
def joined(world: Callable[..., list[Machine]]) -> list[Machine]:
    """Give a master that receives the state of the instrument from a slave."""
    master, slave = world()
    join(slave, master)
    until(lambda: master.texts("up") and master.received_from(AFM), master, slave)
    return [master, slave]


@contextlib.contextmanager
def raw_connection(book: AddressBook, node: str = AFM) -> Iterator[socket.socket]:
    with socket.create_connection(("127.0.0.1", port_of(book, node)), timeout=PATIENCE_S) as raw:
        yield raw


def is_closed(raw: socket.socket) -> bool:
    """Return whether the other end has closed a connection, without waiting."""
    raw.setblocking(False)
    try:
        return raw.recv(4096) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


# --- whose messages arrive ---


def test_listed_machines_receive_from_one_another(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    master.open().bind(LINK).subscribe()
    slave.open().bind(AFM, CONTROLLER).subscribe({LINK: ["teleop/forward"]})
    until(
        lambda: master.received_from(AFM) and master.received_from(CONTROLLER) and slave.received_from(OPERATOR),
        master,
        slave,
    )
    endpoint = master.book.network_endpoint(AFM)
    (up,) = [event for event in master.changes if event.data.get("peer") == AFM]
    assert (up.level, up.text) == ("info", f"{AFM} is connected ({endpoint})")
    assert up.data == {"peer": AFM, "endpoint": endpoint, "connection": "up", "gone_s": up.data["gone_s"]}
    assert (master.network.rejected, master.network.last_error) == (slave.network.rejected, "") == ({}, "")
    assert [subscriber.rejected for subscriber in master.subscribers] == [{}, {}]


def test_one_socket_is_plain_nearby_and_locked_afar(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.open().bind(AFM).subscribe({AFM: ["afm/state"]})
    master.open().subscribe({AFM: ["afm/state"]})
    # a program that knows nothing of keys
    plain = master.context.socket(zmq.SUB)
    plain.subscribe(b"")
    plain.connect(slave.book.local_endpoint(AFM))
    try:
        until(lambda: slave.received_from(AFM) and master.received_from(AFM) and plain.poll(0), master, slave)
    finally:
        plain.close()
    assert slave.publishers[AFM].socket.get(zmq.MECHANISM) == zmq.CURVE
    assert slave.subscribers[0].socket.get(zmq.MECHANISM) == zmq.NULL
    assert slave.network.rejected == {}


def test_nodes_with_a_port_alone_are_locked_on_their_own_machine_too(world: Callable[..., list[Machine]]) -> None:
    (port,) = free_ports(1)
    (slave,) = world("slave", book=AddressBook.model_validate({"nodes": {AFM: f"tcp://127.0.0.1:{port}"}}))
    slave.open().bind(AFM).subscribe({AFM: ["afm/state"]})
    until(lambda: slave.received_from(AFM), slave)
    assert slave.publishers[AFM].socket.get(zmq.MECHANISM) == zmq.CURVE
    # what is sent here is accepted here, whatever is in the list
    assert slave.ring.allowed().keys == ()


def test_readers_are_one_to_a_machine_or_one_to_a_node(world: Callable[..., list[Machine]]) -> None:
    master, _ = world()
    plan = {AFM: ["afm/state"], LINK: ["teleop/forward"], CONTROLLER: ["teleop/backward"]}
    master.open().subscribe(plan)
    assert [subscriber.topics for subscriber in master.subscribers] == [
        ["teleop/forward"],
        ["afm/state", "teleop/backward"],
    ]
    master.subscribe(plan, apart=True)
    assert [subscriber.topics for subscriber in master.subscribers[2:]] == list(plan.values())


@pytest.mark.parametrize("host", ["localhost", "[::1]"])
def test_an_address_may_be_a_name_or_of_ipv6(world: Callable[..., list[Machine]], tmp_path: Path, host: str) -> None:
    if host == "[::1]" and not _has_ipv6():
        pytest.skip("this machine has no IPv6 on its loopback interface")
    hosts = {"master": host, "slave": host}
    master, slave = world(book=two_machine_book(tmp_path, machines=hosts))
    join(slave, master)
    until(receives_more(master, AFM), master, slave)
    until(lambda: master.texts("up"), master, slave)
    slave.close()
    until(lambda: master.texts("down"), master)
    slave.open().bind(AFM)
    until(lambda: len(master.texts("up")) == 2, master, slave)


def test_a_name_that_is_known_to_the_library_alone_is_followed_too(
    world: Callable[..., list[Machine]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(AddressBook, "connect_endpoint", AddressBook.endpoint)
    master, slave = world(book=two_machine_book(tmp_path, machines={"master": "localhost", "slave": "localhost"}))
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe()
    until(lambda: master.texts("up", AFM) and master.texts("up", CONTROLLER), master, slave)
    slave.close()
    until(lambda: master.texts("down", AFM) and master.texts("down", CONTROLLER), master)
    slave.open().bind(AFM, CONTROLLER)
    until(lambda: len(master.texts("up")) == 4, master, slave)
    assert len(master.texts("up", AFM)) == 2
    slave.ring.revoke("master")
    until(lambda: master.texts("refused", AFM), master, slave)


def _has_ipv6() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as found:
            found.bind(("::1", 0))
    except OSError:
        return False
    return True


def test_without_a_network_there_is_nothing_to_look_after(tmp_path: Path) -> None:
    book = AddressBook(nodes={node: f"ipc://{tmp_path}/{node}" for node in (AFM, CONTROLLER)})
    with zmq.Context() as context:
        # no key is needed, and the folder of keys not even looked for
        quiet = Transport(context, VirtualClock(), book, "slave", Keyring(tmp_path / "none"))
        publisher = quiet.publisher(AFM)
        subscribers = quiet.subscribers({AFM: ["afm/state"], CONTROLLER: ["teleop/backward"]})
        assert (list(quiet.descriptors), len(subscribers)) == ([], 1)
        assert publisher.socket.get(zmq.HEARTBEAT_IVL) == 0
        bus = ZmqBus(publisher, subscribers, SystemClock(), -1, quiet)
        assert (bus.process_events(), bus.process_events(now=True), bus.rejections()) == ((), (), ({}, ""))
        assert quiet.process_events() == []
        for each in (*subscribers, publisher, quiet):
            each.close()


def test_plain_tcp_is_received_where_locks_are_waived(world: Callable[..., list[Machine]], tmp_path: Path) -> None:
    master, slave = world(book=two_machine_book(tmp_path, insecure=True))
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe()
    until(lambda: master.received_from(AFM) and master.received_from(CONTROLLER), master, slave)
    until(lambda: len(master.texts("up")) == 2, master, slave)
    assert slave.publishers[AFM].socket.get(zmq.MECHANISM) == zmq.NULL
    assert not master.ring.folder.exists()
    with raw_connection(slave.book) as raw:
        raw.sendall(zmtp_greeting(b"PLAIN"))
        until(lambda: slave.network.rejected == {"handshake": 1}, slave)
    slave.close()
    until(lambda: len(master.texts("down")) == 2, master)


def test_a_machine_without_a_key_cannot_take_part(world: Callable[..., list[Machine]]) -> None:
    master, _ = world()
    (master.ring.folder / "master.key_secret").unlink()
    with zmq.Context() as context, pytest.raises(ConfigError, match="`telenano keys new master` creates one"):
        Transport(context, master.clock, master.book, "master", master.ring)


def test_what_cannot_be_bound_is_named(world: Callable[..., list[Machine]], tmp_path: Path) -> None:
    (_, slave) = world()
    slave.open()
    with pytest.raises(EndpointError, match="viz_node@slave is not in the site file, which has afm_node@slave"):
        slave.network.publisher("viz_node@slave")
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", port_of(slave.book, AFM)))
        holder.listen()
        with pytest.raises(
            EndpointError, match=r"afm_node@slave cannot bind tcp://127\.0\.0\.1:\d+: another process has"
        ):
            slave.network.publisher(AFM)
    # neither the socket nor its place nearby is kept
    slave.bind(AFM)


def test_the_local_endpoint_beside_one_with_keys_is_made_again_for_readers_without_keys(
    world: Callable[..., list[Machine]], tmp_path: Path
) -> None:
    plain = two_machine_book(tmp_path)
    nodes = {name: entry.model_dump(exclude_none=True) for name, entry in plain.nodes.items()}
    nodes[AFM]["local"] = f"ipc://{tmp_path}/{AFM}"
    book = AddressBook.model_validate({**plain.model_dump(exclude={"nodes"}, exclude_none=True), "nodes": nodes})
    master, slave = world(book=book)
    join(slave, master)
    with slave.context.socket(zmq.SUB) as early, slave.context.socket(zmq.SUB) as late:
        for reader in (early, late):
            reader.subscribe(b"")
        early.connect(nodes[AFM]["local"])
        until(lambda: early.poll(0) and master.received_from(AFM), master, slave)
        (tmp_path / AFM).unlink()
        [notice] = slave.network.places.look()
        assert notice.state == "made_again"
        late.connect(nodes[AFM]["local"])
        until(lambda: late.poll(0), master, slave)
    assert slave.network.rejected == {}


@pytest.mark.parametrize(
    ("address", "is_ours"),
    [
        (f":{os.geteuid()}:0:1", True),
        (f"localhost:{os.geteuid()}:0:1", True),
        ("localhost:0:5:1", True),
        (f"localhost:{os.geteuid() + 4711}:0:1", False),
        ("::1", False),
        ("::0:0:1", False),
        ("::ffff:0:0", False),
        ("0::0:0:1", False),
        ("127.0.0.1", False),
        ("", False),
    ],
)
def test_only_a_process_of_this_user_on_this_machine_needs_no_key(address: str, is_ours: bool) -> None:
    assert _is_of_this_user(address) == is_ours


# --- who is refused ---


def test_an_unlisted_machine_is_refused_reported_and_let_in_once_listed(world: Callable[..., list[Machine]]) -> None:
    master, slave, laptop = world("master", "slave", "laptop", strangers=True)
    master.knows(slave)
    laptop.knows(slave)
    slave.knows(laptop, ["observe"])
    join(slave, master, laptop)
    until(lambda: master.texts("refused") and laptop.received_from(AFM), master, slave, laptop)
    endpoint = slave.book.network_endpoint(AFM)
    assert master.texts("refused") == [
        f"slave rejects the key of master at {AFM} ({endpoint}): on slave, run "
        f"`telenano keys allow master '{master.key}' --role ...`"
    ]
    assert slave.network.rejected == {"unlisted": 1}
    reported = f"an unknown machine (127.0.0.1) at {AFM}: the key {master.key} is not in the list"
    assert slave.network.last_error == reported
    # it goes on trying, it is reported once, and nobody else receives less
    until(lambda: slave.network.rejected["unlisted"] >= 3, master, slave, laptop)
    until(receives_more(laptop, AFM), master, slave, laptop)
    assert len(master.texts("refused")) == 1
    # both count the same rejections, each in its own time
    until(lambda: master.network.rejected == {"handshake": slave.network.rejected["unlisted"]}, master, slave, laptop)
    assert master.network.last_error == f"{AFM} at {endpoint}: the key was rejected"
    assert (master.received_from(AFM), master.texts("up")) == (0, [])
    assert laptop.network.rejected == {}
    slave.knows(master, ["observe"])
    until(receives_more(master, AFM), master, slave, laptop)
    assert master.texts("up") == [f"{AFM} is connected ({endpoint})"]


def test_a_revoked_key_is_refused_by_name(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.ring.revoke("master")
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe()
    until(lambda: master.texts("refused", AFM) and master.texts("refused", CONTROLLER), master, slave)
    assert slave.network.rejected["revoked"] >= 2
    assert set(slave.network.rejected) == {"revoked"}
    assert f"master (127.0.0.1) at {CONTROLLER}: the key {master.key} was revoked" in (
        slave.network.last_error,
        slave.network.last_error.replace(AFM, CONTROLLER),
    )
    assert master.received == []


def test_another_key_of_the_server_than_the_listed_one_is_no_connection_until_the_new_one_is_listed(
    world: Callable[..., list[Machine]],
) -> None:
    master, slave, laptop = world("master", "slave", "laptop")
    slave.ring.create("slave", replace=True)
    laptop.ring.revoke("slave")
    laptop.knows(slave)
    join(slave, master, laptop)
    until(lambda: master.texts("refused") and laptop.received_from(AFM), master, slave, laptop)
    endpoint = slave.book.network_endpoint(AFM)
    assert master.texts("refused") == [
        f"the handshake with {AFM} ({endpoint}) keeps failing: is the key of slave in {master.ring.allowed_path} the "
        f"one it uses, and is {endpoint} its endpoint?"
    ]
    assert set(slave.network.rejected) == {"handshake"}
    assert slave.network.last_error.startswith(f"a client of {AFM}: ")
    assert set(master.network.rejected) == {"handshake"}
    # both in one go, as a script would
    master.ring.revoke("slave")
    master.knows(slave)
    until(receives_more(master, AFM), master, slave, laptop)


def test_a_new_key_of_the_server_ends_what_the_old_one_began(joined: list[Machine]) -> None:
    master, slave = joined
    old = slave.key
    slave.ring.create("slave", replace=True)
    master.ring.revoke("slave")
    master.knows(slave)
    # the process over there has the old key, which is no longer believed here
    until(lambda: master.texts("down"), master, slave)
    endpoint = slave.book.network_endpoint(AFM)
    assert master.texts("down") == [
        f"the connection to {AFM} ({endpoint}) was closed: the key of slave that it used is no longer allowed"
    ]
    before = master.received_from(AFM)
    until(lambda: master.network.rejected.get("handshake", 0) >= 3, master, slave)
    assert (master.received_from(AFM), slave.key != old) == (before, True)
    slave.close()
    slave.open().bind(AFM)
    until(receives_more(master, AFM), master, slave)


def test_a_server_without_a_listed_key_is_not_connected_to_until_it_has_one(
    world: Callable[..., list[Machine]],
) -> None:
    master, slave = world(strangers=True)
    slave.knows(master)
    join(slave, master)
    until(lambda: master.texts("unreached"), master, slave)
    assert master.texts("unreached") == [
        f"{AFM} is not connected, no valid key of slave is in {master.ring.allowed_path}: "
        "run `telenano keys allow slave KEY --role data`"
    ]
    assert (master.network.rejected, slave.network.rejected, master.received) == ({}, {}, [])
    master.knows(slave)
    until(receives_more(master, AFM), master, slave)


def zmtp_greeting(mechanism: bytes) -> bytes:
    return b"\xff" + bytes(8) + b"\x7f\x03\x01" + mechanism.ljust(20, b"\0") + b"\0" + bytes(31)


@pytest.mark.parametrize(
    ("sent", "counted"),
    [
        pytest.param(zmtp_greeting(b"NULL"), True, id="plain"),
        pytest.param(zmtp_greeting(b"PLAIN"), True, id="password"),
        pytest.param(zmtp_greeting(b"CURVE") + b"\x00\x05hello", True, id="message before handshake"),
        pytest.param(zmtp_greeting(b"CURVE") + b"\x04\xc8\x05HELLO" + bytes(194), True, id="empty handshake"),
        # libzmq closes these too, but reports it as it reports a peer that leaves
        pytest.param(b"GET / HTTP/1.1\r\nHost: afm\r\n\r\n" * 8, False, id="web"),
        pytest.param(bytes(range(256)) * 16, False, id="noise"),
        pytest.param(zmtp_greeting(b"CURVE") + b"\x02" + struct.pack(">Q", 2**62), False, id="endless message"),
        pytest.param(zmtp_greeting(b"CURVE") + b"\x06" + struct.pack(">Q", 2**62), False, id="endless command"),
    ],
)
def test_garbage_on_the_port_is_refused_and_disturbs_nobody(joined: list[Machine], sent: bytes, counted: bool) -> None:
    master, slave = joined
    with raw_connection(slave.book) as raw:
        raw.sendall(sent)
        until(lambda: is_closed(raw), master, slave)
    until(receives_more(master, AFM), master, slave)
    assert not master.texts("down")
    if counted:
        until(lambda: slave.network.rejected == {"handshake": 1}, master, slave)
        assert slave.network.last_error.startswith(f"a client of {AFM}: ")


def test_a_frame_that_no_subscription_needs_closes_the_connection_of_its_sender_alone(
    world: Callable[..., list[Machine]],
) -> None:
    master, slave, laptop = world("master", "slave", "laptop")
    join(slave, master)
    laptop.open()
    until(receives_more(master, AFM), master, slave)
    sender = laptop.context.socket(zmq.XSUB)
    sender.set(zmq.LINGER, 0)
    own = laptop.ring.own("laptop")
    sender.set(zmq.CURVE_PUBLICKEY, own.public)
    sender.set(zmq.CURVE_SECRETKEY, own.secret)
    sender.set(zmq.CURVE_SERVERKEY, slave.key.encode())
    watch = sender.get_monitor_socket(zmq.EVENT_DISCONNECTED)
    sender.connect(slave.book.network_endpoint(AFM))
    try:
        sender.send(b"\x01afm/state")
        until(lambda: sender.poll(0), master, slave)
        sender.send(b"\x01" + bytes(10_000))
        until(lambda: watch.poll(0), master, slave)
    finally:
        sender.close()
        watch.close()
    until(receives_more(master, AFM), master, slave)
    assert not master.texts("down")


def test_a_message_that_nobody_may_send_closes_the_connection_of_its_sender_alone(
    world: Callable[..., list[Machine]],
) -> None:
    master, slave = world()
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe()
    until(lambda: master.received_from(AFM) and master.received_from(CONTROLLER), master, slave)
    until(lambda: len(master.texts("up")) == 2, master, slave)
    slave.publishers[AFM].send("afm/state", bytes(17 << 20))
    until(lambda: master.texts("down"), master, slave)
    assert set(event.data["peer"] for event in master.events if event.data["connection"] == "down") == {AFM}
    until(lambda: len(master.texts("up", AFM)) == 2, master, slave)
    until(receives_more(master, CONTROLLER), master, slave)
    until(receives_more(master, AFM), master, slave)
    tracker = master.subscribers[-1].tracker("teleop/backward", CONTROLLER)
    assert tracker.lost == 0


def test_nobody_is_accepted_while_no_authenticator_is_bound(
    world: Callable[..., list[Machine]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "_HANDSHAKE_MS", 300)
    master, slave = world()
    slave.open().bind(AFM)
    slave.network.close()
    master.open().subscribe({AFM: ["afm/state"]})
    end = time.monotonic() + PATIENCE_S
    while not master.network.rejected.get("handshake"):
        assert time.monotonic() < end
        slave.publishers[AFM].send("afm/state", payload("afm/state", AFM, 0))
        master.turn()
    assert (master.received, master.texts("up")) == ([], [])


# --- who is no longer welcome ---


@pytest.mark.parametrize("bind", ["127.0.0.1", "0.0.0.0", "[::]"])
def test_a_key_revoked_while_it_is_connected_is_cut_off_and_the_others_come_back(
    world: Callable[..., list[Machine]], tmp_path: Path, bind: str
) -> None:
    if bind == "[::]" and not _has_ipv6():
        pytest.skip("this machine has no IPv6 on its loopback interface")
    book = two_machine_book(tmp_path, bind={"slave": bind})
    master, slave, laptop = world("master", "slave", "laptop", book=book)
    # nearby, a program that nothing of this may disturb
    slave.open().bind(AFM).subscribe({AFM: ["afm/state"]})
    master.open().subscribe({AFM: ["afm/state"]})
    laptop.open().subscribe({AFM: ["afm/state"]})
    everybody = (master, slave, laptop)
    until(lambda: all(machine.received_from(AFM) for machine in everybody), *everybody)
    until(lambda: laptop.texts("up") and master.texts("up"), *everybody)
    slave.ring.revoke("laptop")
    until(lambda: laptop.texts("down") and master.texts("down"), *everybody)
    (event,) = slave.events
    endpoint = slave.book.bind_endpoint(AFM)
    assert (event.level, event.text) == (
        "warning",
        f"the key of laptop is no longer allowed: all network connections at {AFM} were closed",
    )
    assert event.data == {"endpoint": endpoint, "connection": "revoked"}
    cut = laptop.received_from(AFM)
    until(receives_more(master, AFM), *everybody)
    until(lambda: laptop.texts("refused"), *everybody)
    assert (laptop.received_from(AFM), len(master.texts("up"))) == (cut, 2)
    # a handshake that was under way when the connections were closed fails with them
    assert {"revoked"} <= set(slave.network.rejected) <= {"revoked", "handshake"}
    assert slave.subscribers[0].tracker("afm/state", AFM).lost == 0
    assert len(slave.events) == 1


def test_a_revocation_is_seen_at_the_next_look_which_every_report_is(joined: list[Machine]) -> None:
    master, slave = joined
    slave.clock.advance_ns(transport._CHECK_NS)
    assert slave.network.process_events() == []
    slave.ring.revoke("master")
    slave.clock.advance_ns(transport._CHECK_NS - 1)
    assert slave.network.process_events() == []
    slave.clock.advance_ns(1)
    assert [event.data["connection"] for event in slave.network.process_events()] == ["revoked"]
    # health is reported twice a second, and looks each time
    assert transport._CHECK_NS < 500_000_000
    until(lambda: master.texts("down"), master, slave)


def test_a_key_taken_off_the_list_is_cut_off_too(joined: list[Machine]) -> None:
    master, slave = joined
    slave.ring.allowed_path.write_text("keys: []\n")
    until(lambda: master.texts("refused"), master, slave)
    assert slave.events[0].text.startswith("the key of a machine removed from the list is no longer allowed: ")
    # The master may give a connection up before the slave has looked at its key.
    assert {"unlisted"} <= set(slave.network.rejected) <= {"unlisted", "handshake"}


def test_a_change_that_concerns_nobody_here_disturbs_nobody(joined: list[Machine]) -> None:
    master, slave = joined
    for ring in (slave.ring, master.ring):
        ring.allow("laptop", zmq.curve_keypair()[0].decode(), ["observe"])
        ring.revoke("laptop")
    slave.knows(master, ["observe"])
    turns(60, master, slave)
    assert (slave.events, len(master.changes)) == ([], 1)


def test_a_machine_that_revokes_the_key_of_another_stops_listening_to_it(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe()
    until(lambda: len(master.texts("up")) == 2, master, slave)
    master.ring.revoke("slave")
    until(lambda: len(master.texts("down")) == 2, master, slave)
    assert all(text.endswith("the key of slave that it used is no longer allowed") for text in master.texts("down"))
    count = len(master.received)
    until(lambda: len(master.texts("unreached")) == 2, master, slave)
    assert (len(master.received), master.subscribers[-1].rejected) == (count, {})
    assert all("no valid key of slave is in" in text for text in master.texts("unreached"))


def test_a_list_that_breaks_is_reported_once_and_changes_nothing(joined: list[Machine]) -> None:
    master, slave = joined
    good = slave.ring.allowed_path.read_text()
    slave.ring.allowed_path.write_text("keys: [")
    until(lambda: slave.events, master, slave)
    turns(60, master, slave)
    (event,) = slave.events
    assert event.level == "error"
    assert event.text.startswith(f"the list of keys was not reloaded: {slave.ring.allowed_path}: is not valid YAML")
    slave.ring.allowed_path.unlink()
    until(lambda: len(slave.events) == 2, master, slave)
    reported = f"the list of keys was not reloaded: {slave.ring.allowed_path}: no longer exists"
    assert slave.events[1].text.startswith(reported)
    slave.ring.allowed_path.write_text(good)
    slave.ring.revoke("master")
    until(lambda: master.texts("refused"), master, slave)


# --- what may be sent ---


def test_a_role_that_a_machine_lacks_is_what_its_messages_are_refused_for(world: Callable[..., list[Machine]]) -> None:
    master, slave = world(strangers=True)
    slave.knows(master)
    master.knows(slave, ["observe"])
    slave.open().bind(AFM)
    master.open().subscribe({AFM: ["afm/state", "session/control"]})
    (_, subscriber) = master.subscribers
    sent = 0

    def command() -> None:
        nonlocal sent
        slave.publishers[AFM].send("session/control", payload("session/control", AFM, sent))
        sent += 1

    def until_received(topic: str) -> None:
        before = len(master.received)
        until(lambda: command() or topic in {r.topic for r in master.received[before:]}, master, slave)

    until(lambda: command() or subscriber.rejected.get("role", 0) >= 5, master, slave)
    assert (master.received, set(subscriber.rejected)) == ([], {"role"})
    assert subscriber.last_error in [
        f"{topic} of {AFM}: the machine slave lacks the role {role}, it has observe"
        for topic, role in (("afm/state", "data"), ("session/control", "control"))
    ]
    master.knows(slave, ["data"])
    until_received("afm/state")
    assert {received.topic for received in master.received} == {"afm/state"}
    refused = subscriber.rejected["role"]
    until(lambda: command() or subscriber.rejected["role"] > refused + 5, master, slave)
    master.knows(slave, ["control", "data"])
    until_received("session/control")
    master.knows(slave, ["control"])
    refused = subscriber.rejected["role"]
    until(lambda: subscriber.rejected["role"] > refused + 5, master, slave)
    assert subscriber.last_error == f"afm/state of {AFM}: the machine slave lacks the role data, it has control"
    until_received("session/control")
    # roles are no reason to end a connection
    assert len(master.texts("up")) == 1
    assert not master.texts("down")


def test_a_machine_sends_for_its_own_nodes(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe({AFM: ["afm/state"], CONTROLLER: ["teleop/backward"]})
    (_, subscriber) = master.subscribers

    def pretend(src: str) -> None:
        slave.publishers[AFM].send("afm/state", payload("afm/state", src, 0))

    until(lambda: pretend("haptic_node@master") or subscriber.rejected.get("source", 0) > 3, master, slave)
    assert subscriber.last_error == "afm/state: the machine slave may not send messages of haptic_node@master"
    assert master.received_from("haptic_node@master") == 0
    # within a machine no wall is claimed
    until(lambda: pretend(CONTROLLER) or "afm/state" in _topics(master, CONTROLLER), master, slave)


def test_a_reader_to_each_node_lets_each_send_for_itself_alone(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.open().bind(AFM)
    master.open().subscribe({AFM: ["afm/state"], CONTROLLER: ["teleop/backward"]}, apart=True)
    rejected = master.subscribers[0].rejected

    def pretend() -> None:
        slave.publishers[AFM].send("afm/state", payload("afm/state", CONTROLLER, 0))

    until(lambda: pretend() or rejected.get("source", 0) > 3, master, slave)
    assert master.received_from(CONTROLLER) == 0
    until(receives_more(master, AFM), master, slave)


def _topics(machine: Machine, src: str) -> set[str]:
    return {received.topic for received in machine.received if received.message.src == src}


def test_the_link_carries_what_comes_from_the_other_site(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    master.open().bind(LINK)
    slave.open().subscribe({LINK: ["teleop/forward"]})
    until(receives_more(slave, OPERATOR), master, slave)
    master.publishers[LINK].send("teleop/forward", payload("teleop/forward", CONTROLLER, 0))
    (_, subscriber) = slave.subscribers
    until(lambda: subscriber.rejected == {"source": 1}, master, slave)
    assert slave.received_from(CONTROLLER) == 0


def test_rights_are_remembered_to_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(peer_connections, "_MAX_PERMITTED", 2)
    permissions = MessagePermissions("master", [LINK], ["data"])
    for number in range(10):
        permissions("teleop/forward", f"node{number}@master")
    assert len(permissions._permitted) == 2
    with pytest.raises(WireError) as caught:
        permissions("session/control", "launcher@master")
    assert caught.value.reason == "role"
    permissions.change(["control"])
    permissions("session/control", "launcher@master")
    for number in (0, 9):
        with pytest.raises(WireError, match="the machine master lacks the role data, it has control"):
            permissions("teleop/forward", f"node{number}@master")
    permissions.change([])
    with pytest.raises(WireError, match="lacks the role control, it has none"):
        permissions("session/control", "launcher@master")


# --- what goes and comes back ---


def test_a_server_that_goes_away_and_comes_back_is_reported(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe()
    until(lambda: len(master.texts("up")) == 2, master, slave)
    master.events.clear()
    slave.close()
    until(lambda: len(master.texts("down")) == 2, master)
    endpoint = master.book.network_endpoint(AFM)
    (down,) = [event for event in master.changes if event.data["peer"] == AFM]
    assert (down.level, down.text) == ("warning", f"the connection to {AFM} ({endpoint}) was lost")
    assert down.data == {"peer": AFM, "endpoint": endpoint, "connection": "down"}
    gone_ns = master.clock.monotonic_ns()
    master.clock.advance_ns(2_000_000_000)
    # the other one stays away
    slave.open().bind(AFM)
    until(receives_more(master, AFM), master, slave)
    (up,) = [event for event in master.events if event.data["connection"] == "up"]
    assert 2.0 <= up.data["gone_s"] <= (master.clock.monotonic_ns() - gone_ns) * 1e-9 + 1.0
    assert up.text == f"{AFM} is connected again after {up.data['gone_s']:.1f} s ({endpoint})"
    assert (up.level, master.texts("up", CONTROLLER)) == ("info", [])


@pytest.mark.parametrize(
    "reported",
    [
        # the connection that libzmq made by itself was ready when this module gave it up for the failure before
        [[(AFM, DISCONNECTED), (AFM, CLOSED_IN_HANDSHAKE), (AFM, CONNECTED)]],
        # and when it gave it up to reconnect to another node of that machine
        [[(CONTROLLER, DISCONNECTED)], [(AFM, DISCONNECTED)], [(AFM, CONNECTED)]],
    ],
    ids=["after a failed handshake", "beside another node"],
)
def test_a_connection_that_was_ready_as_it_was_given_up_is_made_again(
    world: Callable[..., list[Machine]], monkeypatch: pytest.MonkeyPatch, reported: list[list[tuple[str, int]]]
) -> None:
    master, slave = world()
    slave.open().bind(AFM, CONTROLLER)
    master.open().subscribe({AFM: ["afm/state"], CONTROLLER: ["teleop/backward"]})
    until(lambda: master.received_from(AFM) and master.received_from(CONTROLLER), master, slave)
    (peers,) = (one for one in master.network._handlers if isinstance(one, PeerConnections))
    for part in reported:
        found = [MonitorEvent(kind, 0, master.book.endpoint(node, "master")) for node, kind in part]
        with monkeypatch.context() as patch:
            patch.setattr(peers.monitor, "events", lambda found=found: found)
            master.turn()
        # Three quarters of the time until a reconnection.
        turns(38, master, slave)
    for node in (AFM, CONTROLLER):
        until(receives_more(master, node, 100), master, slave)


def test_what_is_not_reached_is_reported_after_5_s_and_every_minute(world: Callable[..., list[Machine]]) -> None:
    master, _ = world()
    master.open().subscribe({AFM: ["afm/state"]})
    began = master.clock.monotonic_ns()
    reported: list[tuple[float, str]] = []
    while master.clock.monotonic_ns() < began + 130e9:
        master.clock.advance_ns(100_000_000)
        now_s = (master.clock.monotonic_ns() - began) * 1e-9
        reported += [(now_s, event.text) for event in master.network.process_events()]
    assert [round(at_s) for at_s, _ in reported] == [5, 65, 125]
    endpoint = master.book.network_endpoint(AFM)
    for at_s, text in reported:
        assert 0.0 <= at_s % 60.0 - 5.0 < 1.0
        assert text == (
            f"{AFM} has not been reached at {endpoint} for {at_s:.0f} s: is slave running, is the address right, does "
            "a firewall block the port?"
        )


def test_who_comes_and_goes_with_a_command_is_not_missed(world: Callable[..., list[Machine]], tmp_path: Path) -> None:
    console = "console@slave"
    book = two_machine_book(tmp_path)
    nodes = {console: book.nodes[AFM]}
    master, slave = world(book=AddressBook.model_validate({"machines": book.machines, "nodes": nodes}))
    master.open().subscribe({console: ["session/event"]})
    for _ in range(200):
        master.clock.advance_ns(transport._CHECK_NS)
        assert master.network.process_events() == []
    slave.open().bind(console)
    until(lambda: master.texts("up") and master.received_from(console), master, slave)
    slave.close()
    until(lambda: master.texts("down"), master)
    assert {event.level for event in master.events} == {"info"}


def test_what_is_reached_but_refuses_is_reminded_of_as_that(world: Callable[..., list[Machine]]) -> None:
    master, slave = world(strangers=True)
    master.knows(slave)
    join(slave, master)
    until(lambda: master.texts("unreached"), master, slave)
    assert master.texts("unreached")[0].endswith(" s: the key was rejected")


def test_a_port_with_another_protocol_is_asked_again_until_the_right_program_is_there(
    world: Callable[..., list[Machine]],
) -> None:
    master, slave = world()
    with socket.create_server(("127.0.0.1", port_of(master.book, AFM))) as wrong:
        master.open().subscribe({AFM: ["afm/state"]})
        for _ in range(2):
            until(lambda: select.select([wrong], (), (), 0)[0], master)
            with wrong.accept()[0] as connection:
                connection.sendall(b"SSH-2.0-OpenSSH_9.2\r\n" * 10)
                until(partial(is_closed, connection), master)
    slave.open().bind(AFM)
    until(receives_more(master, AFM), master, slave)


def test_what_was_sent_before_a_connection_was_lost_is_still_received(joined: list[Machine]) -> None:
    master, slave = joined
    master.clock.advance_ns(transport._CHECK_NS)
    master.network.process_events()
    # more than a reader takes in a turn, and then the end
    last_messages = 3000
    for seq in range(slave.sent, slave.sent + last_messages):
        slave.publishers[AFM].send("afm/state", payload("afm/state", AFM, seq))
    slave.close()
    # a slow reader, who comes to look after the connection before all is taken
    until(lambda: master.clock.advance_ns(3_000_000_000) or master.texts("down"), master)
    assert len(master.received) < last_messages
    until(lambda: master.clock.advance_ns(3_000_000_000) or len(master.received) >= last_messages, master)
    assert master.received[-1].message.seq == slave.sent + last_messages - 1
    assert master.subscribers[-1].tracker("afm/state", AFM).lost == 0


class Cable:
    """A wire between two ports that can be pulled: what is sent then neither arrives nor comes back as an error."""

    def __init__(self, here: int, there: int) -> None:
        self.pulled = threading.Event()
        self._ended = threading.Event()
        self._there = there
        self._listener = socket.create_server(("127.0.0.1", here))
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        ends: dict[socket.socket, socket.socket] = {}
        while not self._ended.is_set():
            watched = [] if self.pulled.is_set() else [self._listener, *ends]
            ready, _, _ = select.select(watched, (), (), 0.02)
            for each in ready:
                self._carry(each, ends)
        for each in (self._listener, *ends):
            each.close()

    def _carry(self, each: socket.socket, ends: dict[socket.socket, socket.socket]) -> None:
        if each is self._listener:
            near, _ = each.accept()
            far = socket.create_connection(("127.0.0.1", self._there))
            ends[near], ends[far] = far, near
        elif each in ends:
            with contextlib.suppress(OSError):
                data = each.recv(65536)
                if data:
                    ends[each].sendall(data)
                    return
            for end in (each, ends.pop(each)):
                ends.pop(end, None)
                end.close()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()


def test_a_pulled_cable_is_noticed_and_what_was_sent_into_it_does_not_come_out_later(
    world: Callable[..., list[Machine]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value_ms in (("_LOOP_SILENCE_MS", 300), ("_READER_SILENCE_MS", 300), ("_HANDSHAKE_MS", 500)):
        monkeypatch.setattr(transport, name, value_ms)
    book = two_machine_book(tmp_path)
    (away,) = free_ports(1)
    cable = Cable(away, port_of(book, AFM))
    nodes = {AFM: {**book.nodes[AFM].model_dump(), "network": f"tcp://127.0.0.1:{away}"}}
    master, slave = world(book=book)
    master.book = AddressBook.model_validate({"nodes": nodes})
    try:
        join(slave, master)
        until(lambda: master.texts("up") and master.received_from(AFM), master, slave)
        cable.pulled.set()
        until(lambda: master.texts("down"), master, slave)
        first_after = slave.sent
        turns(100, master, slave)
        cable.pulled.clear()
        again = slave.sent
        until(lambda: len(master.texts("up")) == 2, master, slave)
        until(receives_more(master, AFM), master, slave)
    finally:
        slave.close()
        cable.close()
    count = [received.message.seq for received in master.received]
    assert not [seq for seq in count if first_after <= seq < again]


# --- the turn of a loop ---


def test_strangers_are_answered_a_few_at_a_time(world: Callable[..., list[Machine]]) -> None:
    _, slave = world()
    slave.open().bind(AFM)
    requests = 3 * zap_authenticator._BATCH + 1
    # a request takes up to 120 us, and the loop has a period of 1 ms
    assert zap_authenticator._BATCH * 120e-6 <= 0.5e-3
    flood = slave.context.socket(zmq.DEALER)
    flood.set(zmq.LINGER, 0)
    flood.connect("inproc://zeromq.zap.01")
    key = bytes(32)
    try:
        for number in range(requests):
            request = [b"", b"1.0", b"%d" % number, AFM.encode(), b"10.0.0.7", b"", b"CURVE", key]
            flood.send_multipart(request)
        counted, has_pending = [], []
        for _ in range(4):
            slave.network.process_events()
            counted.append(slave.network.rejected["unlisted"])
            has_pending.append(slave.network.has_pending)
        assert counted == [
            zap_authenticator._BATCH,
            2 * zap_authenticator._BATCH,
            3 * zap_authenticator._BATCH,
            requests,
        ]
        assert has_pending == [True, True, True, False]
        answers = [flood.recv_multipart(zmq.NOBLOCK) for _ in range(requests)]
        assert answers[-1] == [b"", b"1.0", b"%d" % (requests - 1), b"400", b"unlisted", b"", b""]
        # a request with a mechanism that no endpoint here uses
        flood.send_multipart([b"", b"1.0", b"n", b"", b"10.0.0.7", b"", b"NULL"])
        slave.network.process_events()
        assert flood.recv_multipart(zmq.NOBLOCK)[3] == b"400"
        assert slave.network.rejected == {"unlisted": requests, "handshake": 1}
    finally:
        flood.close()


def test_an_answer_names_the_machine_to_the_socket(world: Callable[..., list[Machine]]) -> None:
    master, slave = world()
    slave.open().bind(AFM)
    with contextlib.closing(slave.context.socket(zmq.DEALER)) as asking:
        asking.connect("inproc://zeromq.zap.01")
        asking.send_multipart(
            [b"", b"1.0", b"7", AFM.encode(), b"10.0.0.7", b"", b"CURVE", zmq.utils.z85.decode(master.key)]
        )
        slave.network.process_events()
        assert asking.recv_multipart(zmq.NOBLOCK) == [b"", b"1.0", b"7", b"200", b"", b"master", b""]
    assert slave.network.rejected == {}


def test_events_of_connections_are_taken_a_few_at_a_time() -> None:
    with zmq.Context() as context, contextlib.closing(context.socket(zmq.PUB)) as server:
        watch = Monitor(server, PROTOCOL_FAILED)
        port = server.bind_to_random_port("tcp://127.0.0.1")
        for _ in range(100):
            with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S) as raw:
                raw.sendall(zmtp_greeting(b"PLAIN"))
                while raw.recv(4096):
                    pass
        total = 0
        end = time.monotonic() + PATIENCE_S
        while total < 100 and time.monotonic() < end:
            taken = watch.events()
            assert len(taken) <= socket_monitor._BATCH
            assert watch.has_pending == (len(taken) == socket_monitor._BATCH)
            total += len(taken)
        assert total == 100
        assert {event.kind for event in taken} == {PROTOCOL_FAILED}
        watch.socket.close()


def test_every_rejected_connection_ends_a_wait_however_often(world: Callable[..., list[Machine]]) -> None:
    """ZeroMQ's descriptors signal changes only: none may be missed, the first one before the first wait included."""
    _, slave = world()
    slave.open()
    clock = SystemClock()
    wake = os.pipe()
    bus = ZmqBus(slave.bind(AFM).publishers[AFM], [], clock, wake[0], slave.network)
    try:
        for number in range(1, 31):
            with raw_connection(slave.book) as raw:
                raw.sendall(zmtp_greeting(b"PLAIN"))
                end = time.monotonic() + PATIENCE_S
                while bus.rejections()[0].get("handshake", 0) < number:
                    bus.wait(clock.monotonic_ns() + round(PATIENCE_S * 1e9))
                    assert time.monotonic() < end, f"connection {number} was not noticed"
                    bus.process_events()
        counts, text = bus.rejections()
        assert (counts, text) == ({"handshake": 30}, f"a client of {AFM}: {FAILURES[PROTOCOL_FAILED]}")
        # and then all is quiet: nothing wakes the loop for nothing
        deadline = clock.monotonic_ns() + 200_000_000
        waits = 0
        while clock.monotonic_ns() < deadline:
            bus.wait(deadline)
            bus.process_events()
            waits += 1
        assert waits <= 3
    finally:
        for end_of_pipe in wake:
            os.close(end_of_pipe)


def test_a_bus_that_has_more_to_process_does_not_wait(tmp_path: Path) -> None:
    class Pending:
        has_pending = True
        rejected: ClassVar[dict[str, int]] = {}
        last_error = ""
        calls = 0

        def __init__(self, descriptor: int) -> None:
            self.descriptors = [descriptor]

        def process_events(self) -> list[Any]:
            self.calls += 1
            self.has_pending = self.calls < 5
            return []

        def close(self) -> None:
            pass

    wake, quiet = os.pipe(), os.pipe()
    clock = SystemClock()
    with zmq.Context() as context:
        handler = Pending(quiet[0])
        publisher = ZmqPublisher(context, clock, AFM, f"ipc://{tmp_path}/a")
        bus = ZmqBus(publisher, [], clock, wake[0], handler)
        try:
            for _ in range(5):
                # would take an hour
                bus.wait(clock.monotonic_ns() + 3_600_000_000_000)
                bus.process_events()
            # quiet now: processed only when its descriptor is ready, or with `now`
            bus.wait(clock.monotonic_ns() + 1_000_000)
            bus.process_events()
            assert handler.calls == 5
            bus.process_events(now=True)
            assert handler.calls == 6
            os.write(quiet[1], b"x")
            bus.wait(clock.monotonic_ns() + 3_600_000_000_000)
            bus.process_events()
            assert handler.calls == 7
        finally:
            publisher.close()
    for end_of_pipe in (*wake, *quiet):
        os.close(end_of_pipe)


@contextlib.contextmanager
def half_open(book: AddressBook, count: int) -> Iterator[list[socket.socket]]:
    """Hold connections open at the AFM's port, as far as it accepts them, on which nothing is ever said."""
    with contextlib.ExitStack() as stack:
        attempts = [stack.enter_context(socket.socket()) for _ in range(count)]
        for attempt in attempts:
            attempt.setblocking(False)
            attempt.connect_ex(("127.0.0.1", port_of(book, AFM)))
        yield attempts


def test_500_half_open_connections_disturb_nobody_who_is_connected_and_keep_no_listed_machine_out(
    world: Callable[..., list[Machine]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "_HANDSHAKE_MS", 300)
    master, slave, laptop = world("master", "slave", "laptop")
    join(slave, master)
    until(lambda: master.received_from(AFM), master, slave)
    with half_open(slave.book, 500):
        until(receives_more(master, AFM), master, slave)
        assert master.texts("down") == []
        laptop.open().subscribe({AFM: ["afm/state"]})
        until(lambda: laptop.received_from(AFM), master, slave, laptop)
        # strangers are ended with the handshake, and counted: as many as the system has accepted ahead of the node
        until(lambda: slave.network.rejected.get("handshake", 0) >= 50, master, slave, laptop)
        assert "the handshake timed out" in slave.network.last_error
    assert master.texts("down") == []
    until(receives_more(master, AFM), master, slave)


def test_the_newest_refusal_is_the_one_that_is_reported(world: Callable[..., list[Machine]]) -> None:
    _, slave = world()
    slave.open()
    clock = SystemClock()
    reader = Subscriber(slave.context, clock, {})
    slave.subscribers.append(reader)
    bus = ZmqBus(slave.bind(AFM).publishers[AFM], [reader], clock, -1, slave.network)
    rejections = slave.network._rejections
    reader.decode_and_track([b"one"], 0)
    assert bus.rejections()[1].startswith("a message has 2 frames")
    rejections.record("unlisted", "somebody at the port")
    assert bus.rejections() == ({"frames": 1, "unlisted": 1}, "somebody at the port")
    assert bus.rejections() == ({"frames": 1, "unlisted": 1}, "somebody at the port")
    reader.decode_and_track([b"one"], 0)
    assert bus.rejections()[1].startswith("a message has 2 frames")


def test_an_end_in_the_middle_of_a_handshake_is_no_hang(world: Callable[..., list[Machine]]) -> None:
    master, slave, laptop = world("master", "slave", "laptop")
    slave.open().bind(AFM, CONTROLLER)
    slave.ring.revoke("laptop")
    for machine in (master, laptop):
        machine.open().subscribe()
    with raw_connection(slave.book), raw_connection(slave.book, CONTROLLER):
        # they ask to be authenticated, and nobody answers
        assert select.select([slave.network._authenticator.socket.fileno()], (), (), PATIENCE_S)[0]
        slave.close()
        for machine in (master, laptop):
            machine.close()
