"""Who connects to whom: readers reach the other site through the link alone."""

from pathlib import Path
from typing import Any

import pytest

from proto import TOPICS
from services.runtime.config import validate
from services.runtime.errors import ConfigError
from services.runtime.site import SiteBook, runtime_directory, site_of

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


def book(*nodes: str, **more: Any) -> SiteBook:
    return SiteBook(nodes={node: f"ipc://{{runtime}}/{node}" for node in nodes or NODES}, **more)


def error_of(nodes: dict[str, str], **more: object) -> str:
    with pytest.raises(ConfigError) as caught:
        validate(SiteBook, {"nodes": nodes, **more}, "site.yaml")
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


def test_what_does_not_cross_the_link_is_not_to_be_heard_on_the_other_side() -> None:
    assert book().sources("controller@slave", ["haptic/state", "haptic/command", "teleop/backward"]) == {}
    assert book().sources("controller@master", ["afm/state", "afm/command", "afm/scanline"]) == {}


def test_commands_go_forward_and_events_come_back() -> None:
    rig = book()
    assert rig.sources("afm_node@slave", ["session/control"]) == {"delay_node@slave": ["session/control"]}
    assert rig.sources("haptic_node@master", ["session/control"]) == {"launcher@master": ["session/control"]}
    heard = rig.sources("launcher@master", ["session/event"])
    assert heard == {n: ["session/event"] for n in NODES if site_of(n) == "master" and n != "launcher@master"}
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
        "controller@slave": ["teleop/backward", "law/status", "session/event", "node/health"],
        "afm_node@slave": ["session/event", "node/health"],
    }


def test_an_observer_connects_to_every_node_for_all_that_it_may_send() -> None:
    observed = book().observed()
    assert set(observed) == set(NODES)
    assert observed["afm_node@slave"] == ["afm/state", "afm/scanline", "clock/pong", "session/event", "node/health"]
    assert observed["delay_node@slave"] == [
        "link/status",
        "link/fates",
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
    with pytest.raises(KeyError, match="viz_node@master is not in the site file, it has afm_node@slave, controller"):
        book().endpoint("viz_node@master")


@pytest.mark.parametrize(
    "endpoint", ["tcp://127.0.0.1:5501", "tcp://127.9.8.7:1", "tcp://localhost:65535", "tcp://[::1]:80", "ipc:///a/b"]
)
def test_endpoints_on_this_machine_pass(endpoint: str) -> None:
    assert SiteBook(nodes={"afm_node@slave": endpoint}).endpoint("afm_node@slave") == endpoint


@pytest.mark.parametrize(
    "endpoint", ["tcp://192.168.1.7:5501", "tcp://0.0.0.0:5501", "tcp://afm.example.org:5501", "tcp://[fe80::1]:5501"]
)
def test_plain_tcp_beyond_loopback_needs_a_word(endpoint: str) -> None:
    text = error_of({"afm_node@slave": endpoint})
    assert text == (
        f"site.yaml: nodes.afm_node@slave: {endpoint} is plain tcp beyond loopback, which needs insecure: true"
    )
    assert SiteBook(nodes={"afm_node@slave": endpoint}, insecure=True).endpoint("afm_node@slave") == endpoint


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
    assert SiteBook(nodes={"afm_node@slave": f"ipc://{exact}"})
    assert "longer than the 107 bytes" in error_of({"afm_node@slave": f"ipc://{exact}a"})
    # bytes count, not letters
    assert "longer than the 107 bytes" in error_of({"afm_node@slave": "ipc:///" + "Å" * 54})
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/" + "deep/" * 20)
    assert "longer than the 107 bytes" in error_of({"afm_node@slave": "ipc://{runtime}/afm"})


def test_two_nodes_cannot_share_an_endpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    text = error_of({"afm_node@slave": "tcp://127.0.0.1:5501", "controller@slave": "tcp://127.0.0.1:5501"})
    assert "nodes.controller@slave: tcp://127.0.0.1:5501 is the endpoint of afm_node@slave already" in text
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", "/run/rig")
    assert "already" in error_of({"afm_node@slave": "ipc://{runtime}/a", "controller@slave": "ipc:///run/rig/a"})


@pytest.mark.parametrize("node", ["afm_node", "afm_node@", "@slave", "AFM@slave", "afm node@slave", "a@b@c"])
def test_a_wrong_node_name_is_refused(node: str) -> None:
    text = error_of({node: "tcp://127.0.0.1:5501"})
    assert text.startswith(f"site.yaml: nodes.{node}")
    assert "pattern" in text


def test_an_unknown_key_lists_the_known_ones() -> None:
    assert error_of({}, secure=True) == "site.yaml: secure: unknown key, known are nodes, insecure"
    with pytest.raises(ConfigError, match=r"site\.yaml: nodes: is missing"):
        validate(SiteBook, {}, "site.yaml")
