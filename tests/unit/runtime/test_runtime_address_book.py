"""Who connects to whom: readers reach the other site through the link alone."""

import socket
from pathlib import Path
from typing import Any

import pytest

from telenano.runtime.bus.address_book import AddressBook, NodeEntry, is_relayed, may_carry
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.settings.config import read_yaml, validate
from telenano.wire.errors import ConfigError, EndpointError
from telenano.wire.nodes import site_of
from telenano.wire.topics import OWN_TOPICS
from telenano.wire.topics import OWN_TOPICS as TOPICS

TWO_SITES = Path(__file__).resolve().parents[3] / "telenano" / "settings" / "sites" / "two_sites.yaml"
NODES = (
    "haptic_node@master",
    "controller@master",
    "delay_node@master",
    "launcher@master",
    "recorder@master",
    "delay_node@slave",
    "controller@slave",
    "afm_node@slave",
)


def book(*nodes: str, **more: Any) -> AddressBook:
    return AddressBook(nodes={node: f"ipc://{{runtime}}/{node}" for node in nodes or NODES}, **more)


@pytest.fixture(autouse=True)
def _no_address_of_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("TELENANO_HOST_MASTER", "TELENANO_HOST_SLAVE", "TELENANO_BIND_ADDRESS", "TELENANO_RELAY"):
        monkeypatch.delenv(name, raising=False)


def error_of(nodes: dict[str, Any], **more: object) -> str:
    with pytest.raises(ConfigError) as caught:
        validate(AddressBook, {"nodes": nodes, **more}, "site.yaml")
    return str(caught.value)


def test_a_reader_connects_to_its_own_site() -> None:
    plan = book().sources("controller@master", ["haptic/state", "teleop/backward"])
    assert plan == {"haptic_node@master": ["haptic/state"], "delay_node@master": ["teleop/backward"]}
    plan = book().sources("controller@slave", ["afm/state", "teleop/forward", "session/control"])
    assert plan == {"afm_node@slave": ["afm/state"], "delay_node@slave": ["teleop/forward", "session/control"]}


def test_nobody_connects_to_the_other_site_or_to_itself() -> None:
    rig = book()
    for reader in NODES:
        for publisher in rig.sources(reader, list(TOPICS)):
            assert site_of(publisher) == site_of(reader)
            assert publisher != reader


def test_what_does_not_cross_the_link_is_not_expected_on_the_other_side() -> None:
    assert book().sources("controller@slave", ["haptic/state", "haptic/command", "teleop/backward"]) == {}
    assert book().sources("controller@master", ["afm/state", "afm/command", "afm/scanline"]) == {}


def test_commands_go_forward_and_events_come_back() -> None:
    rig = book()
    assert rig.sources("afm_node@slave", ["session/control"]) == {"delay_node@slave": ["session/control"]}
    # The link brings emergency stops of the other site.
    senders = ("delay_node@master", "launcher@master")
    assert rig.sources("haptic_node@master", ["session/control"]) == {node: ["session/control"] for node in senders}
    sources = rig.sources("launcher@master", ["session/event"])
    assert sources == {n: ["session/event"] for n in NODES if site_of(n) == "master" and n != "launcher@master"}
    assert "delay_node@master" not in rig.sources("controller@slave", ["session/event"])


def test_a_rig_without_link_or_without_the_publisher() -> None:
    assert book("controller@master", "controller@slave").sources("controller@master", ["teleop/backward"]) == {}
    assert book("controller@master", "delay_node@master").sources("controller@master", ["teleop/backward"]) == {}
    assert book("controller@master").sources("controller@master", ["haptic/state"]) == {}


def test_the_link_reads_at_each_site_what_crosses_to_the_other() -> None:
    rig = book()
    forward, backward = rig.bridged_from("master"), rig.bridged_from("slave")
    assert forward == {
        "controller@master": ["teleop/forward"],
        "launcher@master": ["session/control"],
    }
    assert backward == {
        "controller@slave": ["teleop/backward", "law/status", "link/network", "session/event", "node/health"],
        "afm_node@slave": ["session/event", "node/health"],
    }


def test_an_observer_connects_to_every_node_for_all_that_it_may_send() -> None:
    observed = book().observed()
    assert set(observed) == set(NODES)
    # packages add topics that other tests of this process may have named
    assert [topic for topic in observed["afm_node@slave"] if topic in OWN_TOPICS] == [
        "afm/state",
        "afm/scanline",
        "afm/program",
        "clock/pong",
        "session/event",
        "node/health",
        "node/journal",
    ]
    assert observed["delay_node@slave"] == [
        "link/delay",
        "link/key",
        "link/network",
        "clock/ping",
        "session/event",
        "node/health",
        "teleop/forward",
        "session/control",
    ]
    assert "teleop/backward" in observed["delay_node@master"]


def test_the_runtime_folder_is_named_or_private(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/rig")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert book().endpoint("afm_node@slave") == "ipc:///run/rig/afm_node@slave"
    monkeypatch.delenv("TELENANO_RUNTIME_DIR")
    assert runtime_directory() == Path("/run/user/7/telenano")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("os.getuid", lambda: 1234)
    assert runtime_directory() == tmp_path / "telenano-1234"


def test_an_unknown_node_is_named_with_those_there_are() -> None:
    with pytest.raises(KeyError, match="viz_node@master is not in the site file, which has afm_node@slave, controller"):
        book().endpoint("viz_node@master")


@pytest.mark.parametrize(
    "endpoint", ["tcp://127.0.0.1:5501", "tcp://127.9.8.7:1", "tcp://localhost:65535", "tcp://[::1]:80", "ipc:///a/b"]
)
def test_endpoints_on_this_machine_pass(endpoint: str) -> None:
    assert AddressBook(nodes={"afm_node@slave": endpoint}).endpoint("afm_node@slave") == endpoint


@pytest.mark.parametrize(
    "endpoint",
    ["tcp://127.0.0.1:5501", "tcp://192.168.1.7:5501", "tcp://afm.example.org:5501", "tcp://[fe80::1]:5501"],
)
def test_tcp_is_locked_unless_that_is_waived_even_on_this_machine(endpoint: str) -> None:
    rig = AddressBook(nodes={"afm_node@slave": endpoint})
    assert (rig.spans_machines, rig.requires_keys) == (True, True)
    assert rig.endpoint("afm_node@slave") == rig.network_endpoint("afm_node@slave") == endpoint
    assert rig.local_endpoint("afm_node@slave") is None
    rig = AddressBook(nodes={"afm_node@slave": endpoint}, insecure=True)
    assert (rig.spans_machines, rig.requires_keys) == (True, False)


def test_ipc_alone_needs_no_key() -> None:
    rig = book()
    assert (rig.spans_machines, rig.requires_keys) == (False, False)
    assert {rig.network_endpoint(node) for node in NODES} == {rig.bind_endpoint(node) for node in NODES} == {None}


@pytest.mark.parametrize(
    "endpoint",
    [
        "",
        "afm",
        "udp://127.0.0.1:5501",
        "tcp://127.0.0.1",
        "tcp://127.0.0.1:0",
        "tcp://127.0.0.1:65536",
        "tcp://127.0.0.1:123456789",
        "tcp://127.0.0.1:five",
        "tcp://127.0.0.1:5501\n",
        "tcp://127.0.0.1:٥٥٠١",
        "tcp://*:5501",
        "tcp://:5501",
    ],
)
@pytest.mark.parametrize("insecure", [False, True])
def test_what_is_no_endpoint_is_named(endpoint: str, insecure: bool) -> None:
    text = error_of({"afm_node@slave": endpoint}, insecure=insecure)
    assert "nodes.afm_node@slave" in text
    assert "neither ipc:///absolute/path nor tcp://host:port (1-65535)" in text


def test_an_ipc_path_is_absolute_and_fits_a_socket(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "needs an absolute path" in error_of({"afm_node@slave": "ipc://afm"})
    exact = "/" + "a" * 106
    assert AddressBook(nodes={"afm_node@slave": f"ipc://{exact}"})
    assert "longer than the 107 bytes" in error_of({"afm_node@slave": f"ipc://{exact}a"})
    # bytes count, not letters
    assert "longer than the 107 bytes" in error_of({"afm_node@slave": "ipc:///" + "Å" * 54})
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/" + "deep/" * 20)
    assert "longer than the 107 bytes" in error_of({"afm_node@slave": "ipc://{runtime}/afm"})


def test_two_nodes_cannot_share_an_endpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    text = error_of({"afm_node@slave": "tcp://127.0.0.1:5501", "controller@slave": "tcp://127.0.0.1:5501"})
    assert "nodes.controller@slave: tcp://127.0.0.1:5501 is already the endpoint of afm_node@slave" in text
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/rig")
    assert "already" in error_of({"afm_node@slave": "ipc://{runtime}/a", "controller@slave": "ipc:///run/rig/a"})


@pytest.mark.parametrize("node", ["afm_node", "afm_node@", "@slave", "AFM@slave", "afm node@slave", "a@b@c"])
def test_a_wrong_node_name_is_refused(node: str) -> None:
    text = error_of({node: "tcp://127.0.0.1:5501"})
    assert text.startswith(f"site.yaml: nodes.{node}")
    assert "pattern" in text


def test_an_unknown_key_lists_the_known_ones() -> None:
    assert (
        error_of({}, secure=True) == "site.yaml: secure: unknown key, did you mean insecure? "
        "Known are machines, bind, nodes, link, relay, insecure"
    )
    with pytest.raises(ConfigError, match=r"site\.yaml: nodes: is missing"):
        validate(AddressBook, {}, "site.yaml")


# --- two machines ---


def two_sites() -> AddressBook:
    return validate(AddressBook, read_yaml(TWO_SITES), str(TWO_SITES))


def test_two_sites_are_locked_and_the_link_runs_at_the_operators() -> None:
    rig = two_sites()
    assert rig.requires_keys
    assert {node: rig.machine_of(node) for node in rig.nodes if node.startswith("delay_node")} == {
        "delay_node@master": "master",
        "delay_node@slave": "master",
    }
    others = [node for node in rig.nodes if not node.startswith("delay_node")]
    assert {rig.machine_of(node) == site_of(node) for node in others} == {True}


def test_two_sites_are_reached_nearby_over_ipc_and_from_afar_over_tcp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/rig")
    monkeypatch.setenv("TELENANO_HOST_MASTER", "10.0.0.1")
    monkeypatch.setenv("TELENANO_HOST_SLAVE", "10.0.0.2")
    rig = two_sites()
    near = {node: rig.endpoint(node, rig.machine_of(node)) for node in rig.nodes}
    assert near == {node: f"ipc:///run/rig/{node}" for node in rig.nodes}
    # a machine that is not named is that of the node
    assert near == {node: rig.endpoint(node) for node in rig.nodes}
    afar = {
        "delay_node@slave": "tcp://10.0.0.1:5704",
        "controller@slave": "tcp://10.0.0.2:5711",
        "afm_node@slave": "tcp://10.0.0.2:5712",
        "recorder@slave": "tcp://10.0.0.2:5713",
        "launcher@slave": "tcp://10.0.0.2:5714",
    }
    assert {node: rig.network_endpoint(node) for node in rig.nodes if rig.network_endpoint(node)} == afar
    other = {"master": "slave", "slave": "master"}
    assert {node: rig.endpoint(node, other[rig.machine_of(node)]) for node in afar} == afar


def test_two_sites_reach_one_another_where_there_is_a_port_alone() -> None:
    rig = two_sites()
    for node in rig.nodes:
        for reader in ("master", "slave"):
            assert rig.reaches(reader, node) == (
                reader == rig.machine_of(node) or rig.network_endpoint(node) is not None
            ), (reader, node)
        assert rig.reaches(None, node)
    assert not rig.reaches("slave", "haptic_node@master")
    assert not rig.reaches("master", "console@slave")
    assert not rig.reaches("laptop", "controller@master")
    assert rig.reaches("laptop", "afm_node@slave")


def test_two_sites_are_one_rig_to_those_who_read_and_bridge() -> None:
    rig = two_sites()
    assert rig.sources("controller@slave", ["afm/state", "teleop/forward"]) == {
        "afm_node@slave": ["afm/state"],
        "delay_node@slave": ["teleop/forward"],
    }
    assert rig.sources("afm_node@slave", ["session/control"]) == {
        node: ["session/control"] for node in ("delay_node@slave", "launcher@slave", "console@slave")
    }
    assert rig.sources("controller@master", ["teleop/backward"]) == {"delay_node@master": ["teleop/backward"]}
    # the link, on the operator's machine, cannot reach a console that has no port there
    assert set(rig.bridged_from("slave")) == {"controller@slave", "afm_node@slave", "recorder@slave", "launcher@slave"}
    assert set(rig.bridged_from("master")) == {"controller@master", "launcher@master", "console@master"}


def test_two_sites_are_observed_as_far_as_a_machine_reaches() -> None:
    rig = two_sites()
    assert set(rig.observed("master")) == set(rig.nodes) - {"console@slave"}
    assert set(rig.observed("slave")) == {node for node in rig.nodes if site_of(node) == "slave"}
    assert set(rig.observed("slave", ["master"])) == set()
    assert set(rig.observed("master", ["master"])) == {node for node in rig.nodes if site_of(node) == "master"}
    assert set(rig.observed()) == set(rig.nodes)
    assert rig.observed("master")["afm_node@slave"] == rig.published_by("afm_node@slave")


def test_an_address_comes_from_the_file_the_environment_or_both(monkeypatch: pytest.MonkeyPatch) -> None:
    hosts = {"slave": "afm.lab"}
    rig = AddressBook(machines=hosts, nodes={"afm_node@slave": "tcp://{slave}:5712"})
    assert rig.network_endpoint("afm_node@slave") == "tcp://afm.lab:5712"
    monkeypatch.setenv("TELENANO_HOST_SLAVE", "")
    assert rig.network_endpoint("afm_node@slave") == "tcp://afm.lab:5712"
    monkeypatch.setenv("TELENANO_HOST_SLAVE", "[fe80::2]")
    assert rig.network_endpoint("afm_node@slave") == "tcp://[fe80::2]:5712"
    # what is no machine of the file is none of the environment either
    monkeypatch.setenv("TELENANO_HOST_LAPTOP", "10.0.0.3")
    assert error_of({"afm_node@slave": "tcp://{laptop}:5712"}, machines=hosts) == (
        "site.yaml: nodes.afm_node@slave: tcp://{laptop}:5712: {laptop} is not in `machines`, which has slave"
    )
    assert error_of({"afm_node@slave": "tcp://{slave}:5712"}).endswith("is not in `machines`, which has none")


def test_a_wrong_address_of_the_environment_is_seen_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_HOST_SLAVE", "fe80::2")
    text = error_of({"afm_node@slave": "tcp://{slave}:5712"}, machines={"slave": "10.0.0.2"})
    assert text.startswith("site.yaml: nodes.afm_node@slave: tcp://fe80::2:5712 is neither ipc:///absolute/path nor")


@pytest.mark.parametrize("address", ["fe80::2", "::1", "fd00:1::2", "2001:db8::7"])
def test_an_ipv6_address_without_brackets_is_refused_with_the_remedy(address: str) -> None:
    text = error_of({"afm_node@slave": "tcp://{slave}:5712"}, machines={"slave": address})
    assert text.endswith(
        f"; write an IPv6 address in brackets, in `machines` and in the environment too: tcp://[{address}]:5712"
    )
    assert AddressBook(machines={"slave": f"[{address}]"}, nodes={"afm_node@slave": "tcp://{slave}:5712"})
    # of anything else it is not said
    assert "brackets" not in error_of({"afm_node@slave": "tcp://a b:5712"})


def test_what_a_node_binds_is_its_address_or_the_one_named_for_that(monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = {"afm_node@slave": "tcp://{slave}:5712", "delay_node@slave": "tcp://{master}:5704"}
    hosts = {"master": "10.0.0.1", "slave": "[fe80::2]"}
    rig = AddressBook(machines=hosts, nodes=nodes)
    assert [rig.bind_endpoint(node) for node in nodes] == ["tcp://[fe80::2]:5712", "tcp://10.0.0.1:5704"]
    rig = AddressBook(machines=hosts, nodes=nodes, bind={"slave": "[::]"})
    assert [rig.bind_endpoint(node) for node in nodes] == ["tcp://[::]:5712", "tcp://10.0.0.1:5704"]
    monkeypatch.setenv("TELENANO_BIND_ADDRESS", "0.0.0.0")
    assert [rig.bind_endpoint(node) for node in nodes] == ["tcp://0.0.0.0:5712", "tcp://0.0.0.0:5704"]
    # readers go on to use the address
    assert rig.endpoint("delay_node@slave", "slave") == "tcp://10.0.0.1:5704"


def test_an_address_to_bind_is_of_a_machine_with_nodes() -> None:
    text = error_of({"afm_node@slave": "tcp://10.0.0.2:5712"}, bind={"slvae": "0.0.0.0"})
    assert text == "site.yaml: bind.slvae: no node runs on this machine"


NAMES = {"afm.lab": "10.1.2.3"}


@pytest.fixture
def _names(monkeypatch: pytest.MonkeyPatch) -> None:
    def look_up(host: str, port: object, family: int) -> list[Any]:
        assert family == socket.AF_INET
        if host not in NAMES:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return [(family, 0, 0, "", (NAMES[host], 0))]

    monkeypatch.setattr(socket, "getaddrinfo", look_up)


@pytest.mark.usefixtures("_names")
def test_a_name_is_looked_up_where_it_is_bound_and_where_it_is_connected_to() -> None:
    rig = AddressBook(nodes={"afm_node@slave": "tcp://afm.lab:5712", "controller@slave": "tcp://[::1]:5711"})
    assert rig.bind_endpoint("afm_node@slave") == "tcp://10.1.2.3:5712"
    assert rig.connect_endpoint("afm_node@slave", "master") == "tcp://10.1.2.3:5712"
    assert rig.connect_endpoint("controller@slave", "master") == "tcp://[::1]:5711"


@pytest.mark.usefixtures("_names")
def test_a_name_that_is_not_known_here_cannot_be_bound_but_may_be_known_later_to_a_reader() -> None:
    rig = AddressBook(nodes={"afm_node@slave": "tcp://afm.elsewhere:5712"})
    with pytest.raises(EndpointError) as caught:
        rig.bind_endpoint("afm_node@slave")
    assert str(caught.value) == (
        "afm_node@slave cannot bind afm.elsewhere: the name cannot be resolved (Name or service not known): give an "
        "address, or TELENANO_BIND_ADDRESS=0.0.0.0 to bind every interface"
    )
    assert rig.connect_endpoint("afm_node@slave", "master") == "tcp://afm.elsewhere:5712"
    # bound elsewhere, the name need not be known
    assert rig.model_copy(update={"bind": {"slave": "0.0.0.0"}}).bind_endpoint("afm_node@slave") == "tcp://0.0.0.0:5712"


def test_an_entry_has_two_forms() -> None:
    short = validate(AddressBook, {"nodes": {"afm_node@slave": "tcp://10.0.0.2:5712"}}, "site.yaml")
    full = validate(AddressBook, {"nodes": {"afm_node@slave": {"network": "tcp://10.0.0.2:5712"}}}, "site.yaml")
    made = AddressBook(nodes={"afm_node@slave": NodeEntry(network="tcp://10.0.0.2:5712")})
    assert short == full == made
    assert AddressBook.model_validate_json(full.model_dump_json()) == full


def test_a_node_may_run_on_a_third_machine() -> None:
    nodes = {"recorder@master": {"network": "tcp://{archive}:5705", "machine": "archive"}, "afm_node@slave": "ipc:///a"}
    rig = validate(AddressBook, {"machines": {"archive": "10.0.0.9"}, "nodes": nodes}, "site.yaml")
    assert rig.machine_of("recorder@master") == "archive"
    # nobody on that machine reaches a node that has no port
    assert rig.sources("recorder@master", ["afm/state"]) == {}
    assert rig.endpoint("recorder@master", "master") == "tcp://10.0.0.9:5705"


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ({}, ": local, network or both are needed"),
        ({"local": "tcp://10.0.0.2:1"}, ": local: tcp://10.0.0.2:1 is not of the form ipc:///absolute/path"),
        ({"network": "ipc:///a"}, ": network: ipc:///a is not of the form tcp://host:port"),
        ({"network": "tcp://a:1", "machine": "A B"}, ".machine: String should match pattern"),
        ({"netwrk": "tcp://a:1"}, ".netwrk: unknown key"),
        (7, ": Input should be an object, got 7"),
        ("afm", ": is neither ipc:///absolute/path nor tcp://host:port (1-65535), got 'afm'"),
    ],
)
def test_a_wrong_entry_is_named(entry: object, text: str) -> None:
    assert error_of({"afm_node@slave": entry}).startswith(f"site.yaml: nodes.afm_node@slave{text}")


def test_a_wrong_name_of_a_machine_is_named() -> None:
    assert error_of({}, machines={"Slave": "10.0.0.2"}).startswith("site.yaml: machines.Slave")


@pytest.mark.parametrize(
    ("node", "src", "may"),
    [
        ("afm_node@slave", "afm_node@slave", True),
        ("afm_node@slave", "controller@slave", False),
        ("afm_node@slave", "controller@master", False),
        ("delay_node@slave", "delay_node@slave", True),
        ("delay_node@slave", "delay_node@master", True),
        ("delay_node@slave", "controller@master", True),
        ("delay_node@slave", "controller@slave", False),
        ("delay_node@master", "controller@slave", True),
        ("delay_node@master", "launcher@master", False),
    ],
)
def test_a_socket_carries_its_node_and_that_of_the_link_the_other_site(node: str, src: str, may: bool) -> None:
    assert may_carry(node, src) is may


RELAYED = {
    "haptic_node@master": "ipc:///h",
    "delay_node@slave": {"local": "ipc:///l", "network": "tcp://{master}:5704"},
    "afm_node@slave": {"local": "ipc:///a", "network": "tcp://10.0.0.2:5712"},
}


def test_with_a_relay_every_tcp_endpoint_is_one_of_this_machine() -> None:
    rig = AddressBook.model_validate({"machines": {"master": "10.0.0.1"}, "nodes": RELAYED, "relay": "relay.org:5750"})
    assert rig.requires_keys
    assert [rig.network_endpoint(node) for node in RELAYED] == [
        None,
        "tcp://127.77.0.1:5704",
        "tcp://127.77.0.2:5712",
    ]
    # Nodes bind elsewhere, so that both sites can be tried on one machine.
    assert rig.bind_endpoint("afm_node@slave") == "tcp://127.0.0.1:5712"
    assert rig.connect_endpoint("afm_node@slave", "master") == "tcp://127.77.0.2:5712"
    assert rig.connect_endpoint("afm_node@slave", "slave") == "ipc:///a"
    assert is_relayed("tcp://127.77.0.2:5712")
    assert not is_relayed("tcp://127.0.0.1:5712")


def test_a_relay_may_be_named_by_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RELAY", "198.51.100.7:5750")
    assert AddressBook.model_validate({"nodes": {"afm_node@slave": "tcp://10.0.0.2:5712"}}).relay == "198.51.100.7:5750"
    given = {"nodes": {"afm_node@slave": "tcp://10.0.0.2:5712"}, "relay": "[2001:db8::7]:5750"}
    assert AddressBook.model_validate(given).relay == "[2001:db8::7]:5750"
    monkeypatch.setenv("TELENANO_RELAY", "nonsense")
    assert "relay: nonsense is not of the form host:port" in error_of({"afm_node@slave": "tcp://10.0.0.2:5712"})


@pytest.mark.parametrize("relay", ["relay", "relay:0", "relay:70000", "2001:db8::7:5750", "relay:x", ""])
def test_a_relay_that_is_none_is_refused(relay: str) -> None:
    assert "relay" in error_of({"afm_node@slave": "tcp://10.0.0.2:5712"}, relay=relay)


def test_a_relay_carries_nothing_that_is_not_encrypted() -> None:
    text = error_of({"afm_node@slave": "tcp://10.0.0.2:5712"}, relay="relay:5750", insecure=True)
    assert "remove `insecure: true`" in text
