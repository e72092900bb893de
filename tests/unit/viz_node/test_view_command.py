"""`telenano view`: its addresses, its end, and the emergency stop of a page that it serves."""

import signal
import socket
import stat
import subprocess
import sys
import tempfile
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import msgpack
import pytest
import typer
import zmq

from services.viz_node.command import _serve_again, view
from services.viz_node.commander import RigCommander, forms
from services.viz_node.requests import PROTOCOL
from telenano.console.emergency_stop import LocalRig
from telenano.runtime.bus.local_endpoint import estop_endpoint
from telenano.runtime.loop.healthcheck import endpoint_of, receive_health
from telenano.serving.config import ViewConfig
from telenano.serving.serve import COMMAND_VARIABLE, Tls, announced, bind, check_exposure, page_folder
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire.errors import ConfigError, RecordingError, TelenanoError
from telenano.wire.nodes import DEVICES, PAGE


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    # a socket's path is short by law, pytest's folders are not
    with tempfile.TemporaryDirectory(prefix="tnv-") as folder:
        monkeypatch.setenv("TELENANO_RUNTIME_DIR", folder)
        monkeypatch.delenv("TELENANO_RIG", raising=False)
        yield Path(folder)


def needs_page() -> None:
    pytest.importorskip("uvicorn")
    if page_folder() is None:
        pytest.skip("the page has not been built: make page")


def test_tokens_are_shown_on_a_terminal_and_nowhere_else(monkeypatch: pytest.MonkeyPatch, runtime: Path) -> None:
    addresses = {"operator": "http://127.0.0.1:8650/#secret-1", "observer": "http://127.0.0.1:8650/#secret-2"}
    shown: list[str] = []
    with announced(addresses, shown.append):
        file = runtime / "view-8650.addresses"
        assert shown == [
            "view: http://127.0.0.1:8650/",
            "the address needs a token, written to no pipe and no log: `telenano view --addresses` prints it, "
            f"and only you can read it in the file {file}",
        ]
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert file.read_text().splitlines() == [f"{name}: {address}" for name, address in addresses.items()]
    assert list(runtime.iterdir()) == []
    shown.clear()
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    with announced(addresses, shown.append):
        assert shown == [f"{name}: {address}" for name, address in addresses.items()]
        # for who asks in another terminal
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert list(runtime.iterdir()) == []
    shown.clear()
    # The terminal of a container is its log.
    monkeypatch.setenv(COMMAND_VARIABLE, "docker compose exec viz_node telenano view --addresses")
    with announced(addresses, shown.append):
        assert "secret" not in "".join(shown)
        assert "`docker compose exec viz_node telenano view --addresses` prints it" in shown[1]


# where the page is served, as the command line leaves it
_NO_OPTIONS: dict[str, Any] = dict.fromkeys(ViewConfig.model_fields)


def test_the_addresses_of_the_pages_that_run_are_printed_to_who_asks(
    runtime: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit):
        view(**_NO_OPTIONS, addresses=True)
    assert "you serve no page on this machine" in capsys.readouterr().err
    shown: list[str] = []
    with bind(port=0) as bound:
        port = bound.getsockname()[1]
        addresses = {"operator": f"http://127.0.0.1:{port}/#secret-1", "observer": f"http://127.0.0.1:{port}/#secret-2"}
        with announced(addresses, shown.append):
            # what a server that was killed leaves behind is of no use
            (runtime / "view-1.addresses").write_text("operator: http://127.0.0.1:1/#old\n")
            (runtime / "view-1.addresses").chmod(0o600)
            view(**_NO_OPTIONS, addresses=True)
            assert capsys.readouterr().out.splitlines() == [f"{name}: {found}" for name, found in addresses.items()]
    # the output of the server itself says how to get there, and has no token
    assert "telenano view --addresses" in shown[1]
    assert "secret" not in "".join(shown)


def test_a_view_that_something_unforeseen_ends_begins_anew_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    served: list[int] = []

    def serve_once() -> None:
        served.append(len(served))
        if len(served) == 1:
            raise OverflowError("int too large")

    _serve_again(serve_once)
    assert served == [0, 1]
    said = capsys.readouterr().err
    assert "the view has ended: OverflowError: int too large; it is started again in 0.1 s" in said


def test_a_view_of_a_broken_recording_ends_with_a_sentence() -> None:
    def unreadable() -> None:
        raise RecordingError("a.mcap: cannot be read")

    with pytest.raises(RecordingError, match=r"the view has ended: a\.mcap: cannot be read"):
        _serve_again(unreadable)


class Device:
    """What a device of a rig is to an emergency stop: an inlet, and answers."""

    def __init__(self, node: str, endpoint: str, stack: ExitStack) -> None:
        context = stack.enter_context(zmq.Context[zmq.Socket[bytes]]())
        self.stopped = threading.Event()
        self._node = node
        inlet, answers = context.socket(zmq.SUB), context.socket(zmq.PUB)
        for opened in (inlet, answers):
            opened.set(zmq.LINGER, 0)
            stack.callback(opened.close)
        inlet.bind(estop_endpoint(endpoint))
        answers.bind(endpoint)
        inlet.subscribe(b"session/control")
        self._over = False
        running = threading.Thread(target=self._run, args=(inlet, answers))
        running.start()
        stack.callback(running.join)
        stack.callback(setattr, self, "_over", True)

    def _run(self, inlet: "zmq.Socket[bytes]", answers: "zmq.Socket[bytes]") -> None:
        while not self._over:
            if not inlet.poll(20):
                continue
            control = msgpack.unpackb(inlet.recv_multipart()[-1])
            self.stopped.set()
            event = {"src": self._node, "id": control["id"], "kind": "ack", "text": "latched"}
            answers.send_multipart([b"session/event", msgpack.packb(event)])


@pytest.mark.check("takes 1.5 s")
def test_the_emergency_stop_of_an_open_page_works_while_strangers_hold_every_descriptor(runtime: Path) -> None:
    needs_page()
    client = pytest.importorskip("websockets.sync.client")
    endpoints = LocalRig.read(DEFAULT_SITE_FILE).endpoints
    with ExitStack() as stack:
        devices = [Device(node, endpoints[node], stack) for node in DEVICES]
        shell = 'ulimit -n 256; exec "$@"'
        command = ["bash", "-c", shell, "-", sys.executable, "-m", "telenano", "view", "--port", "0"]
        view = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(view.terminate)
        assert view.stdout is not None
        base, file = (view.stdout.readline().split()[-1] for _ in range(2))
        address = next(line for line in Path(file).read_text().splitlines() if line.startswith("operator"))
        host = base.removeprefix("http://").rstrip("/")
        page = stack.enter_context(client.connect(f"ws://{host}/bus", origin=f"http://{host}"))
        page.send(msgpack.packb({"k": "hello", "token": address.partition("#")[2], "protocol": PROTOCOL}))
        # the page is open
        assert msgpack.unpackb(page.recv(timeout=60.0))["k"] == "snapshot"
        name, _, port = host.partition(":")
        for _ in range(296):
            stack.enter_context(socket.create_connection((name, int(port)), timeout=60.0))
        page.send(msgpack.packb({"k": "estop", "id": "stop"}))
        answer: dict[str, Any] = {}
        while answer.get("k") != "answer":
            answer = msgpack.unpackb(page.recv(timeout=60.0))
        assert answer["ok"] is True, answer["text"]
        assert all(device.stopped.is_set() for device in devices)
        assert all(f"{node}: latched" in answer["text"] for node in DEVICES)


@contextmanager
def ended(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    """Run a command that does not end by itself, and kill it where the test fails."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.check("takes 2.3 s")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGINT, 0)])
def test_the_view_of_a_rig_has_the_health_of_a_node_and_ends_in_order(
    runtime: Path, number: signal.Signals, code: int
) -> None:
    needs_page()
    command = [sys.executable, "-m", "telenano", "view", "--port", "0"]
    with ended(command) as view:
        assert view.stdout is not None
        file = [view.stdout.readline().split()[-1] for _ in range(2)][1]
        health = receive_health(endpoint_of(PAGE, DEFAULT_SITE_FILE), PAGE, 60.0)
        # a second one has the page, and no endpoint for its health
        with ended(command) as second:
            assert second.stdout is not None
            base = second.stdout.readline().split()[-1]
            with urllib.request.urlopen(base, timeout=60.0) as answer:
                assert b"<title>telenano" in answer.read()
            second.send_signal(number)
            assert second.wait(60.0) == code
        view.send_signal(number)
        assert view.wait(60.0) == code
    assert health is not None
    assert (health["state"], health["pid"]) == ("ready", view.pid)
    assert not Path(file).exists()


def test_a_stop_needs_no_site_file_when_it_comes(runtime: Path, tmp_path: Path) -> None:
    file = tmp_path / "site.yaml"
    file.write_text(DEFAULT_SITE_FILE.read_text())
    endpoints = LocalRig.read(file).endpoints
    with ExitStack() as stack:
        devices = [Device(node, endpoints[node], stack) for node in DEVICES]
        commander = RigCommander(file)
        file.unlink()
        assert {kind for kind, _ in commander.estop("").values()} == {"ack"}
        assert all(device.stopped.is_set() for device in devices)


def test_a_port_that_is_taken_is_named_and_the_usual_one_replaced() -> None:
    with bind(port=0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(TelenanoError, match=f"127.0.0.1:{port}"):
            bind(port=port)


def test_nothing_leaves_this_machine_in_the_clear(tmp_path: Path) -> None:
    check_exposure("127.0.0.1", None)
    with pytest.raises(ConfigError, match="--certificate"):
        check_exposure("0.0.0.0", None)
    with pytest.raises(ConfigError, match="is not a file"):
        check_exposure("0.0.0.0", Tls(tmp_path / "absent.pem", tmp_path / "absent.key"))


def test_the_forms_are_the_schemas_of_the_nodes() -> None:
    found = forms()
    assert "wave" in found["laws"]
    assert "lte" in found["profiles"]
    assert "force_gain" in str(found["controller"])
    assert "delay_s" in str(found["delay_node"])
    assert "setpoint_n" in str(found["afm_node"])
