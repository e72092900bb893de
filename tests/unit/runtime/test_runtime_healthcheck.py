import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread
from typing import Any

import msgpack
import pytest
import zmq

from telenano.runtime.loop import healthcheck

NODE = "afm_node@slave"
HEALTHY = {"src": NODE, "state": "running", "rate_hz": 1000.0, "uptime_s": 12.0}

# far beyond what is expected
PATIENCE_S = 30.0


def frames(**changes: Any) -> list[bytes]:
    return [b"node/health", msgpack.packb({**HEALTHY, **changes})]


@pytest.fixture
def sockets(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path_factory.mktemp("p")
    monkeypatch.setenv(healthcheck.RUNTIME_DIRECTORY_VARIABLE, str(folder))
    return folder


@pytest.fixture
def publish(sockets: Path) -> Iterator[Any]:
    """Publish frames at the node's socket, over and over, until the test is over."""
    over = Event()
    threads = []

    def run(*messages: list[bytes]) -> None:
        with zmq.Context() as context, context.socket(zmq.PUB) as socket:
            socket.set(zmq.LINGER, 0)
            socket.bind(f"ipc://{sockets}/{NODE}")
            while not over.wait(0.01):
                for message in messages:
                    socket.send_multipart(message)

    def start(*messages: list[bytes]) -> None:
        threads.append(Thread(target=run, args=messages))
        threads[-1].start()

    yield start
    over.set()
    for thread in threads:
        thread.join()


@pytest.mark.parametrize(
    ("state", "code"), [("running", 0), ("ready", 0), ("safe", 0), ("starting", 1), ("stopping", 1)]
)
def test_state_decides(publish: Any, capsys: pytest.CaptureFixture[str], state: str, code: int) -> None:
    publish(frames(state=state))
    assert healthcheck.main([NODE]) == code
    assert capsys.readouterr().out == f"afm_node@slave is {state} at 1000 Hz, up for 12 s\n"


def test_reports_of_other_nodes_do_not_count(publish: Any, capsys: pytest.CaptureFixture[str]) -> None:
    # the link carries those of the other site out of its own socket
    publish(frames(src="controller@master"), frames(state="safe", rate_hz=1))
    assert healthcheck.main([NODE]) == 0
    assert "is safe at 1 Hz" in capsys.readouterr().out


@pytest.mark.parametrize(
    "message",
    [
        [b"node/health"],
        [b"node/health", b""],
        [b"node/health", b"\xc1"],
        [b"node/health", msgpack.packb([1, 2])],
        [b"node/healthier", msgpack.packb(HEALTHY)],
        frames(src="controller@slave"),
        frames(rate_hz="fast"),
        frames(uptime_s=None),
        [b"node/health", msgpack.packb({"src": NODE})],
    ],
)
def test_what_is_no_report_is_passed_over(message: list[bytes]) -> None:
    assert healthcheck.parse_health(message, NODE) is None


def test_report_is_taken() -> None:
    assert healthcheck.parse_health(frames(), NODE) == HEALTHY


def test_silence_is_not_waited_for_longer_than_asked(sockets: Path, capsys: pytest.CaptureFixture[str]) -> None:
    begun = time.monotonic()
    assert healthcheck.main([NODE, "--within", "0.2"]) == 1
    assert 0.2 <= time.monotonic() - begun < PATIENCE_S
    assert capsys.readouterr().out == f"afm_node@slave sent no node/health at ipc://{sockets}/{NODE} within 0.2 s\n"


def test_a_flood_of_other_messages_ends_in_time(publish: Any, capsys: pytest.CaptureFixture[str]) -> None:
    publish(*[frames(src="controller@master")] * 100)
    assert healthcheck.main([NODE, "--within", "0.3"]) == 1
    assert "sent no node/health" in capsys.readouterr().out


def test_environment_names_the_node(
    publish: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    publish(frames())
    monkeypatch.setenv(healthcheck.NODE_VARIABLE, NODE)
    assert healthcheck.main([]) == 0
    assert NODE in capsys.readouterr().out


def test_site_file_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(healthcheck.RUNTIME_DIRECTORY_VARIABLE, "/run/rig")
    file = tmp_path / "site.yaml"
    file.write_text("nodes: {afm_node@slave: 'ipc://{runtime}/tip', controller@slave: 'ipc://{runtime}/c'}")
    assert healthcheck.endpoint_of(NODE, file) == "ipc:///run/rig/tip"
    assert healthcheck.endpoint_of(NODE, None) == f"ipc:///run/rig/{NODE}"


def test_what_cannot_be_asked_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv(healthcheck.RUNTIME_DIRECTORY_VARIABLE, raising=False)
    monkeypatch.delenv(healthcheck.NODE_VARIABLE, raising=False)
    assert healthcheck.main([]) == 2
    assert "give node@site, or set TELENANO_NODE" in capsys.readouterr().out
    assert healthcheck.main([NODE]) == 2
    assert "set TELENANO_RUNTIME_DIR" in capsys.readouterr().out
    with pytest.raises(LookupError):
        healthcheck.endpoint_of(NODE, None)
    file = tmp_path / "site.yaml"
    file.write_text("nodes: {controller@slave: 'ipc:///run/c'}")
    assert healthcheck.main([NODE, "--site-file", str(file)]) == 2
    assert "afm_node@slave is not in the site file" in capsys.readouterr().out
    assert healthcheck.main([NODE, "--site-file", str(tmp_path / "none.yaml")]) == 2
    assert "none.yaml: cannot be read" in capsys.readouterr().out


def test_it_imports_next_to_nothing() -> None:
    # it runs every few seconds beside the loops: models and arrays would cost it five times as much
    code = "import sys, telenano.runtime.loop.healthcheck; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert {"zmq", "msgpack"} <= loaded
    assert not loaded & {"numpy", "pydantic", "telenano.wire", "yaml", "typer", "numba"}
