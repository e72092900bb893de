"""What `telenano doctor` says of the link's datagrams."""

import socket
from typing import Any

import pytest

from services.runtime.bus.address_book import AddressBook
from telenano.doctor.datagrams import Route, check_datagrams, judged_route


@pytest.fixture(autouse=True)
def _no_address_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("TELENANO_HOST_MASTER", "TELENANO_HOST_SLAVE", "TELENANO_BIND_ADDRESS"):
        monkeypatch.delenv(name, raising=False)


def book(port: int, **link: Any) -> AddressBook:
    nodes = {"delay_node@slave": f"tcp://{{master}}:{port}", "controller@slave": "tcp://{slave}:5711"}
    machines = {"master": "127.0.0.1", "slave": "127.0.0.2"}
    return AddressBook.model_validate({"machines": machines, "nodes": nodes, "link": link})


def test_the_masters_port_is_tried() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as holder:
        holder.bind(("127.0.0.1", 0))
        port = holder.getsockname()[1]
        (found,) = check_datagrams(book(port), "master")
        assert (found.level, found.found) == ("warning", f"UDP port {port} is in use")
        # the slave's end needs no port of its own
        assert not any("in use" in found.found for found in check_datagrams(book(port), "slave"))
    (found,) = check_datagrams(book(port), "master")
    assert found.level == "ok"
    (found,) = check_datagrams(book(port, transport="stream"), "master")
    assert "over TCP" in found.found
    assert check_datagrams(book(port), "desk") == []


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (found,) = check_datagrams(book(5704), "slave")
    assert found.level == "warning"
    assert "cryptography" in found.found


def test_split_packets_and_a_router_are_said() -> None:
    assert judged_route(Route("10.0.0.1", 1500), "10.0.0.2", "10.0.0.1") == []
    mtu, nat = judged_route(Route("192.168.1.5", 1100), "10.0.0.2", "10.0.0.1")
    assert (mtu.name, nat.name) == ("datagrams: MTU", "datagrams: NAT")
    assert "1100" in mtu.found
    assert "192.168.1.5" in nat.found
