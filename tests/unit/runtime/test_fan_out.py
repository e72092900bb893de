"""One reader of a node for many observers: what they receive, what the node notices, and when they do without."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq
from recorder_samples import haptic_state

from services.fan_out.__main__ import serve
from telenano.launcher.fan_out import endpoints_of, fan_out
from telenano.launcher.plan import UpRequest, make_plan
from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.local_endpoint import fan_out_endpoint, is_bound
from telenano.runtime.wiring.observer import Observer
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import encode

WAIT_MS = 20_000
HAND = "haptic_node@master"


@pytest.fixture
def context() -> Iterator["zmq.Context[zmq.Socket[bytes]]"]:
    made: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    yield made
    made.destroy(linger=0)


def subscriber(context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str, topic: bytes) -> "zmq.Socket[bytes]":
    socket = context.socket(zmq.SUB)
    socket.subscribe(topic)
    socket.connect(fan_out_endpoint(endpoint))
    return socket


def test_a_node_sends_once_what_many_read_and_nothing_that_nobody_reads(
    tmp_path: Path, context: "zmq.Context[zmq.Socket[bytes]]"
) -> None:
    endpoint = f"ipc://{tmp_path}/node"
    node = context.socket(zmq.XPUB)
    # Each subscription is seen, also one that the node has already.
    node.set(zmq.XPUB_VERBOSE, 1)
    node.bind(endpoint)
    own = zmq.Context()
    serve(own, endpoint)
    readers = [subscriber(context, endpoint, b"haptic/state") for _ in range(5)]
    assert node.poll(WAIT_MS)
    assert node.recv() == b"\x01haptic/state"
    # The five connect one after the other; a message is repeated until all of them have one.
    waiting, end_s = set(readers), time.monotonic() + WAIT_MS / 1e3
    while waiting and time.monotonic() < end_s:
        for topic in (b"afm/state", b"haptic/state"):
            node.send_multipart([topic, b"payload"])
        waiting = {reader for reader in waiting if not reader.poll(20)}
    assert not waiting
    for reader in readers:
        assert reader.recv_multipart() == [b"haptic/state", b"payload"]
    assert not node.poll(50), "a second subscription reached the node"
    for reader in readers:
        reader.close(0)
    assert node.poll(WAIT_MS)
    assert node.recv() == b"\x00haptic/state"
    own.term()
    node.close(0)


@pytest.fixture
def base(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "r"
    folder.mkdir(mode=0o700)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(folder))
    return folder


@pytest.mark.parametrize("shared", [True, False])
def test_an_observer_reads_by_it_where_it_is_and_else_at_the_node(
    base: Path, context: "zmq.Context[zmq.Socket[bytes]]", shared: bool
) -> None:
    book = AddressBook.load(DEFAULT_SITE_FILE)
    endpoint = book.local_endpoint(HAND) or ""
    node = context.socket(zmq.XPUB)
    node.set(zmq.XPUB_VERBOSE, 1)
    node.bind(endpoint)
    own = zmq.Context()
    if shared:
        serve(own, endpoint)
        assert is_bound(fan_out_endpoint(endpoint))
    observers = [Observer(book, ["haptic/state"]) for _ in range(2)]
    subscriptions = 0
    for _ in range(1 if shared else 2):
        assert node.poll(WAIT_MS)
        subscriptions += node.recv() == b"\x01haptic/state"
    received: dict[int, str] = {}
    number, end_s = 0, time.monotonic() + WAIT_MS / 1e3
    while len(received) < 2 and time.monotonic() < end_s:
        node.send_multipart([b"haptic/state", encode(haptic_state(number))])
        number += 1
        for place, observer in enumerate(observers):
            for found in observer.listen(0.02):
                received[place] = found.name
    assert received == {0: "haptic/state", 1: "haptic/state"}
    assert subscriptions == (1 if shared else 2)
    assert not node.poll(50)
    for observer in observers:
        observer.close()
    own.term()
    node.close(0)


@pytest.mark.parametrize("patience_s", [2.0, 0.0], ids=["ended", "killed"])
def test_a_rig_has_the_process_while_it_runs_and_leaves_nothing(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, patience_s: float
) -> None:
    # a process that has no processor for so long is killed, and cannot remove its sockets by itself
    monkeypatch.setattr("telenano.launcher.fan_out._STOP_S", patience_s)
    plan = make_plan(UpRequest(scenario="fig12", out=tmp_path / "out"), tmp_path)
    first = fan_out_endpoint(endpoints_of(plan)[0])
    with fan_out(plan):
        end_s = time.monotonic() + WAIT_MS / 1e3
        while not is_bound(first) and time.monotonic() < end_s:
            time.sleep(0.02)
        assert is_bound(first)
    assert list(base.iterdir()) == []


def test_it_ends_with_a_launcher_that_is_killed(base: Path) -> None:
    read, write = os.pipe()
    command = [sys.executable, "-m", "services.fan_out", f"ipc://{base}/node"]
    process = subprocess.Popen(command, stdin=read)
    os.close(read)
    os.close(write)
    assert process.wait(WAIT_MS / 1e3) == 0
    assert list(base.iterdir()) == []


def test_one_that_cannot_bind_leaves_the_rig_alone(base: Path, tmp_path: Path) -> None:
    base.chmod(0o500)
    plan = make_plan(UpRequest(scenario="fig12", out=tmp_path / "out"), tmp_path)
    with fan_out(plan):
        pass
    base.chmod(0o700)


def test_rigs_whose_nodes_run_elsewhere_have_none(base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subprocess, "Popen", lambda *given, **named: pytest.fail("a process was started"))
    for request in (UpRequest(scenario="fig12", attach=True), UpRequest(scenario="fig12", site="master")):
        with fan_out(make_plan(request, tmp_path / "out")):
            pass
