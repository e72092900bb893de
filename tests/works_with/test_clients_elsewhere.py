"""Hands in C and in Node, written from proto/ alone: they read a rig, are commanded by it, and obey and give a stop."""

import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zmq
from foreign_programs import Program, bare_environment, debian_program, node_program
from planted_errors import Numbers, each_error, judge, planted

from telenano.signals import run, start
from telenano.testing import numbered
from telenano.testing.conformance.examination import examine
from telenano.wire import HapticState, SessionEvent, encode
from telenano.wire.codec import accept

pytestmark = [pytest.mark.timeout(1800), pytest.mark.endurance]

CLIENTS = Path(__file__).parent / "clients"
POSITION_M = np.array([1.0 / 3.0, -2e-3, 7e-9])
FORCE_N = np.array([-0.1, 0.7, 1.0 / 7.0])
TIP_FORCE_N = np.array([2e-9, -1e-10, 3.3e-9])
# C has to say how a map is written and searched, which Node brings along.
MOST_LINES = {"hand_client.c": 150, "hand_client.mjs": 120}
# Slower than a rig of its own, so that a machine with other work keeps up.
RATE_HZ = 200
# Rules of encrypted endpoints, and of clients that arm: a hand is armed by others, and its own stop never expires.
OF_OTHERS = {"encryption", "strangers", "quoted clock", "quoted stop", "armed hand"}


def client_in_c(folder: Path) -> Program:
    """Compile the client with the libraries of Debian."""
    if shutil.which("gcc") is None:
        pytest.skip("needs gcc")
    libraries = debian_program("", "libzmq3-dev", "libmsgpack-dev")
    found = next(libraries.folder.glob("usr/lib/*/libzmq.so")).parent
    words = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{libraries.folder / 'usr/include'}", f"-L{found}"]
    # Libraries that the machine lacks are found beside those that the client names.
    unresolved = "-Wl,--unresolved-symbols=ignore-in-shared-libs"
    made = folder / "hand_client"
    words += [str(CLIENTS / "hand_client.c"), "-o", str(made), "-lzmq", "-lmsgpackc", unresolved]
    done = run(["gcc", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return libraries._replace(command=(str(made),))


def client_in_node(folder: Path) -> Program:
    node = node_program("zeromq@6.8.0", "@msgpack/msgpack@3.1.3")
    return node._replace(command=(*node.command, str(CLIENTS / "hand_client.mjs"))).having(CLIENT_PACKAGES=node.folder)


each_client = pytest.mark.parametrize("client", [client_in_c, client_in_node])
Made = Callable[[Path], Program]


@contextmanager
def running(client: Program, folder: Path, seconds: float, stop_after_s: float) -> Iterator["subprocess.Popen[str]"]:
    """Run a client that binds `own` in the folder and reads `rig` there; yield its process once it has bound."""
    words = [f"ipc://{folder}/own", f"ipc://{folder}/rig", str(seconds), str(stop_after_s), str(RATE_HZ)]
    environment = {**bare_environment(), **client.environment}
    process = start([*client.command, *words], env=environment, stdout=subprocess.PIPE, text=True)
    try:
        deadline_s = time.monotonic() + 30.0
        while not (folder / "own").exists():
            assert process.poll() is None and time.monotonic() < deadline_s, "the client has not bound its endpoint"
            time.sleep(0.01)
        yield process
    finally:
        process.kill()
        process.communicate()


class Rig:
    """Speaks for the nodes of a rig in the folder of a client, and reads the client."""

    def __init__(self, folder: Path) -> None:
        self._endpoint = f"ipc://{folder}/rig"
        self._context = zmq.Context()
        self._reader = self._context.socket(zmq.SUB)
        self._reader.subscribe(b"")
        self._reader.connect(f"ipc://{folder}/own")
        self._publisher = self._context.socket(zmq.PUB)
        self._publisher.bind(self._endpoint)
        self._numbers: dict[str, int] = {}
        self._run = 1
        self.states: list[HapticState] = []
        self.events: list[SessionEvent] = []

    def __enter__(self) -> "Rig":
        return self

    def __exit__(self, *_: object) -> None:
        self._context.destroy(linger=0)

    def send(self, topic: str, src: str, **fields: Any) -> None:
        seq = self._numbers[topic] = self._numbers.get(topic, -1) + 1
        header = {"src": src, "t_ns": time.time_ns(), "run": self._run}
        self._publisher.send_multipart([topic.encode(), encode(numbered(topic, seq, **header, **fields))])

    def read(self) -> None:
        while self._reader.poll(0):
            topic, payload = self._reader.recv_multipart()
            message = accept(topic.decode(), payload)
            if isinstance(message, HapticState):
                self.states.append(message)
            elif isinstance(message, SessionEvent):
                self.events.append(message)

    def command(self, position_m: Any, force_n: Any, tip_force_n: Any, seconds: float) -> HapticState:
        """Send states and commands for a while, and return the newest state of the hand."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.read()
            if self.states:
                newest = self.states[-1]
                self.send("afm/state", "afm_node@slave", tip_force_n=tuple(tip_force_n))
                answered = {"hand_seq": newest.seq, "hand_t_ns": newest.t_ns, "mode": "force"}
                places = {"position_m": tuple(position_m), "force_n": tuple(force_n)}
                self.send("haptic/command", "controller@master", **answered, **places)
            time.sleep(0.005)
        return self.states[-1]

    def restart(self) -> None:
        """End the rig and begin another one at the same endpoint."""
        self._publisher.close(linger=0)
        self._publisher = self._context.socket(zmq.PUB)
        self._publisher.bind(self._endpoint)
        self._numbers, self._run = {}, self._run + 1


@each_error
@each_client
def test_a_hand_takes_every_number_as_it_was_sent(tmp_path: Path, client: Made, error: str) -> None:
    with running(client(tmp_path), tmp_path, 3.0, 0.0) as process, Rig(tmp_path) as rig:
        position_m, force_n, tip_force_n = (
            planted(error, values, unit=1e-3) for values in (POSITION_M, FORCE_N, TIP_FORCE_N)
        )
        state = rig.command(position_m, force_n, tip_force_n, seconds=1.5)
        printed, _ = process.communicate(timeout=30.0)
    found: Numbers = {
        "position": state.position_m,
        "force": state.motor_force_n,
        "tip force": json.loads(printed)["tip_force_n"],
    }
    judge(error, {"position": POSITION_M, "force": FORCE_N, "tip force": TIP_FORCE_N}, found, rtol=0.0)


@each_client
def test_a_hand_finds_a_rig_again_and_obeys_its_stop(tmp_path: Path, client: Made) -> None:
    with running(client(tmp_path), tmp_path, 6.0, 0.0), Rig(tmp_path) as rig:
        rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, seconds=1.0)
        rig.restart()
        found = rig.command(2.0 * POSITION_M, 2.0 * FORCE_N, TIP_FORCE_N, seconds=1.5)
        assert (found.position_m, found.motor_force_n) == (tuple(2.0 * POSITION_M), tuple(2.0 * FORCE_N))
        # It answers the sample that it was given, and by its own clock it does so at once.
        assert 0 <= found.answered_at_ns - found.answered_t_ns < 500_000_000
        assert not found.estop
        for _ in range(3):
            rig.send("session/control", "console@master", id="s-1", command="estop", target="*", parameters={})
        stopped = rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, seconds=0.5)
        assert (stopped.estop, stopped.mode, stopped.motor_force_n) == (True, "off", (0.0, 0.0, 0.0))
        assert {(event.kind, event.id) for event in rig.events} == {("ack", "s-1")}
        refused = {"id": "a-1", "command": "arm", "target": "haptic_node@master", "parameters": {}}
        rig.send("session/control", "console@master", **refused)
        assert rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, seconds=0.3).armed is False
        assert (rig.events[-1].kind, rig.events[-1].data["latch"]) == ("refused", "s-1")
        rig.send("session/control", "console@master", **refused, node_latch={"haptic_node@master": "s-1"})
        armed = rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, seconds=0.5)
        assert (armed.armed, armed.estop, armed.motor_force_n) == (True, False, tuple(FORCE_N))


@each_client
def test_the_kit_finds_nothing_wrong_in_a_hand_that_gives_a_stop(tmp_path: Path, client: Made) -> None:
    with running(client(tmp_path), tmp_path, 8.0, 2.0) as process:
        findings = examine(f"ipc://{tmp_path}/own", f"ipc://{tmp_path}/rig", duration_s=9.0)
        printed, _ = process.communicate(timeout=30.0)
    # Pauses are those of a machine with other work.
    assert [found.line() for found in findings if found.outcome == "failed" and found.rule != "rate"] == []
    assert {found.rule for found in findings if found.outcome == "not seen"} == OF_OTHERS
    assert json.loads(printed)["stop_was_heard"] is True


@pytest.mark.parametrize("name", MOST_LINES)
def test_a_client_is_short(name: str) -> None:
    assert len((CLIENTS / name).read_text(encoding="utf-8").splitlines()) <= MOST_LINES[name]
