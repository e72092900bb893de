"""The door for transports: what a site file may ask for, with packages and without, and one of a stranger."""

import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from network_bench import AFM, CONTROLLER, LINK, Machine, payload, turns, two_machine_book

from telenano.launcher.plan import UpRequest, make_plan
from telenano.launcher.run import line_check_of
from telenano.launcher.site_node import SiteNode
from telenano.launcher.supervisor import Supervisor
from telenano.runtime.bus import transports
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.wiring.link_transports import LinkEnds, LinkSide
from telenano.runtime.wiring.participant import Participant
from telenano.settings import TWO_SITES_FILE, plugins
from telenano.settings.known_packages import KNOWN_PACKAGES
from telenano.testing import NodeBench, describe_package, free_ports
from telenano.wire.errors import ConfigError, RefusedError

PACKAGE = KNOWN_PACKAGES["transport datagram"]
ASKED: dict[str, dict[str, Any]] = {
    "link.transport": {"link": {"transport": "datagram"}},
    "link.budget_kbit_per_s": {"link": {"transport": "auto", "budget_kbit_per_s": 3000}},
    "link.direct": {"link": {"direct": False}},
    "link.port": {"link": {"transport": "stream", "port": 5799}},
    "relay": {"relay": "198.51.100.7:5750"},
}
CONTROL: dict[str, Any] = {
    "id": "a-1", "target": "launcher@slave", "parameters": {"recording.file": "session.mcap"}, "validity_s": 1.0,
    "node_t_ns": None, "node_latch": None,
}  # fmt: skip
NEEDS_NOTHING: list[dict[str, Any]] = [
    {},
    {"link": {}},
    {"link": {"transport": "auto"}},
    {"link": {"transport": "stream"}},
]


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have no package installed."""
    monkeypatch.setenv("TELENANO_WITHOUT_PACKAGES", "1")
    monkeypatch.setattr(plugins, "_problems", {})
    plugins._installed.cache_clear()
    yield
    plugins._installed.cache_clear()


def site_file(folder: Path, more: dict[str, Any]) -> Path:
    """Write a site file of two machines."""
    nodes = {"controller@slave": "tcp://127.0.0.1:5711", "delay_node@slave": "tcp://127.0.0.1:5704"}
    path = folder / "site.yaml"
    path.write_text(json.dumps({"nodes": nodes, **more}), encoding="utf-8")
    return path


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("key", ASKED)
def test_what_needs_the_package_is_refused_without_it_in_one_sentence(tmp_path: Path, key: str) -> None:
    path = site_file(tmp_path, ASKED[key])
    with pytest.raises(ConfigError) as refused:
        AddressBook.load(path)
    said = str(refused.value)
    assert said.startswith(f"{path}: {key}: ") and PACKAGE in said and "\n" not in said


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("more", NEEDS_NOTHING)
def test_what_tcp_alone_can_do_needs_no_package_and_looks_for_none(
    tmp_path: Path, more: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transports, "named", lambda name: pytest.fail(f"{name} is looked for"))
    assert AddressBook.load(site_file(tmp_path, more)).link.transport in ("auto", "stream")
    AddressBook.load(TWO_SITES_FILE)


@pytest.mark.parametrize("key", ASKED)
def test_with_the_package_every_documented_key_is_read(tmp_path: Path, key: str) -> None:
    AddressBook.load(site_file(tmp_path, ASKED[key]))


@pytest.mark.parametrize(
    ("link", "words"),
    [
        ({"port": 0}, ("link.port", "1", "got 0")),
        ({"repeat": 2}, ("link.repeat", "unknown key", "repeats")),
        ({"play_out": "yes"}, ("link.play_out", "boolean")),
        ({"transport": "datagrams"}, ("link.transport", "no such transport 'datagrams'", "datagram")),
        ({"transport": "Datagram"}, ("link.transport", "'Datagram'")),
        # names of methods of the model are no more than keys that are wrong
        ({"model_dump": 1}, ("link.model_dump", "unknown key")),
        ({"read": 1}, ("link.read", "unknown key")),
    ],
)
def test_a_key_that_is_wrong_is_named_with_its_file(
    tmp_path: Path, link: dict[str, Any], words: tuple[str, ...]
) -> None:
    path = site_file(tmp_path, {"link": link})
    with pytest.raises(ConfigError) as refused:
        AddressBook.load(path)
    assert all(word in str(refused.value) for word in (str(path), *words))


def test_a_rig_on_one_machine_may_say_what_it_likes_of_a_link_between_two(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transports, "named", lambda name: pytest.fail(f"{name} is looked for"))
    path = tmp_path / "site.yaml"
    path.write_text(json.dumps({"nodes": {"controller@slave": "ipc:///tmp/c"}, "relay": "198.51.100.7:5750"}))
    AddressBook.load(path)


class Log(StructuredLog):
    """Keeps what is said."""

    def __init__(self) -> None:
        super().__init__("test")
        self.said: list[str] = []

    def write(self, level: str, text: str, **data: Any) -> None:
        self.said.append(f"{level}: {text}")


def joined(book: AddressBook, folder: Path) -> tuple[Machine, Machine]:
    """Return two machines that know one another, each with what it says and hears of the link."""
    master, slave = (Machine(name, book, folder) for name in ("master", "slave"))
    master.knows(slave)
    slave.knows(master)
    master.open().bind(LINK).subscribe({AFM: ["afm/state"], CONTROLLER: ["teleop/backward"]})
    slave.open().bind(CONTROLLER, AFM).subscribe({LINK: ["teleop/forward"]})
    return master, slave


def ends_of(machine: Machine, key: str, log: Log) -> LinkEnds:
    """Open the end of a machine."""
    parts = {"key": key, "book": machine.book, "clock": machine.clock, "log": log, "network": machine.network}
    publisher = next(iter(machine.publishers.values()))
    return Participant(**parts, wake_descriptor=-1).link_ends(publisher, publisher, machine.subscribers)


@pytest.fixture
def radio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install the transport of a stranger, as pip does."""
    site = tmp_path / "site"
    describe_package(site, "telenano_my_radio", {"transports": {"my_radio": "radio_transport:MY_RADIO"}})
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setattr(plugins, "_problems", {})
    plugins._installed.cache_clear()
    yield site
    plugins._installed.cache_clear()


@pytest.mark.usefixtures("radio")
def test_a_transport_of_a_stranger_carries_the_samples_both_ways(tmp_path: Path) -> None:
    (port,) = free_ports(1)
    book = two_machine_book(tmp_path, link={"transport": "my_radio", "port": port})
    master, slave = joined(book, tmp_path / "keys")
    log = Log()
    try:
        ends = [ends_of(master, "delay_node@master", log), ends_of(slave, CONTROLLER, log)]
        assert log.said == []
        master.publishers[LINK].send("teleop/forward", payload("teleop/forward", "controller@master", 7))
        slave.publishers[CONTROLLER].send("teleop/backward", payload("teleop/backward", CONTROLLER, 8))
        found = [received.message for end in ends for received in end.readers[0].receive()]
        assert [(message.src, message.seq) for message in found] == [(CONTROLLER, 8), ("controller@master", 7)]
        # what is no sample, or of a node that this machine may not be, is refused as over TCP
        slave.publishers[CONTROLLER].carry("teleop/backward", payload("teleop/backward", "controller@master", 9))
        assert list(ends[0].readers[0].receive()) == []
        assert master.subscribers[-1].rejected or master.subscribers[0].rejected
        turns(3, master, slave)
    finally:
        master.close()
        slave.close()


def test_each_side_knows_the_other_machine_and_the_endpoint_of_the_link(tmp_path: Path) -> None:
    book = two_machine_book(tmp_path)
    found = []
    for machine in joined(book, tmp_path / "keys"):
        key, publisher = next(iter(machine.publishers.items()))
        side: Any = LinkSide.of(key, machine.network, publisher, publisher, machine.subscribers)
        found.append((side.is_master, side.machine, side.endpoint, side.is_allowed))
        machine.close()
    master, slave = book.bind_endpoint(LINK), book.connect_endpoint(LINK, "slave")
    assert found == [(True, "slave", master, True), (False, "master", slave, True)]


@pytest.mark.usefixtures("radio")
def test_keys_of_a_stranger_are_checked_and_theirs_alone(tmp_path: Path) -> None:
    AddressBook.load(site_file(tmp_path, {"link": {"transport": "my_radio", "port": 5799}}))
    for link, words in (
        ({"transport": "my_radio"}, "link.port: is missing"),
        ({"transport": "my_radio", "port": 5799, "repeats": 1}, "link.repeats: unknown key"),
    ):
        with pytest.raises(ConfigError, match=words):
            AddressBook.load(site_file(tmp_path, {"link": link}))
    relayed = {"link": {"transport": "my_radio", "port": 5799}, "relay": "198.51.100.7:5750"}
    with pytest.raises(ConfigError, match="relay: the transport 'my_radio' cannot use a relay"):
        AddressBook.load(site_file(tmp_path, relayed))


@pytest.mark.usefixtures("radio")
def test_an_end_that_cannot_be_opened_leaves_everything_to_tcp_and_says_so(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        book = two_machine_book(tmp_path, link={"transport": "my_radio", "port": other.getsockname()[1]})
        master, slave = joined(book, tmp_path / "keys")
        log = Log()
        try:
            assert ends_of(master, "delay_node@master", log) == LinkEnds()
            assert master.publishers[LINK].carry is None
            (said,) = log.said
            assert "Address already in use" in said and said.endswith("everything crosses over TCP")
        finally:
            master.close()
            slave.close()


@pytest.mark.usefixtures("alone")
def test_without_the_package_each_end_says_once_that_everything_crosses_over_tcp(tmp_path: Path) -> None:
    master, slave = joined(two_machine_book(tmp_path), tmp_path / "keys")
    try:
        for machine, key in ((master, "delay_node@master"), (slave, CONTROLLER)):
            log = Log()
            assert ends_of(machine, key, log) == LinkEnds()
            (said,) = log.said
            assert PACKAGE in said and said.endswith("everything crosses over TCP")
    finally:
        master.close()
        slave.close()


def plan_of(folder: Path, *settings: str) -> Any:
    request = UpRequest(scenario="fig12", out=folder / "out", site="master", settings=settings)
    return make_plan(request, folder / "out")


def test_a_session_of_two_sites_fetches_and_measures_where_it_can_and_else_has_everything_cross(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert plan_of(tmp_path).fetches and line_check_of(plan_of(tmp_path))(time.monotonic_ns) is not None
    monkeypatch.setenv("TELENANO_WITHOUT_PACKAGES", "1")
    plugins._installed.cache_clear()
    try:
        assert not plan_of(tmp_path).fetches and line_check_of(plan_of(tmp_path))(time.monotonic_ns) is None
        with pytest.raises(ConfigError, match=f"recorder.far: .*{PACKAGE}"):
            plan_of(tmp_path, "recorder.far=fetch")
    finally:
        monkeypatch.undo()
        plugins._installed.cache_clear()


def test_a_site_without_a_sender_says_which_package_has_one(bench_of: type[NodeBench], tmp_path: Path) -> None:
    bench = bench_of("launcher@slave")
    site = SiteNode(bench.context, Supervisor(bench.clock, (), NoProcesses()), tmp_path)
    asked = bench.make("session/control", "console@master", command="set", **CONTROL)
    with pytest.raises(RefusedError, match=f"sending a recording is in the package {PACKAGE}: "):
        site.on_control(asked)
    site.on_deadline(bench.clock.monotonic_ns())
    site.make_safe()


class NoProcesses:
    """A supervisor of nothing."""

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments, **named: {}
