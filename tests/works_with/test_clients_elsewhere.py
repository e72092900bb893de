"""Hands in C and in Node, written from proto/ alone: they read a rig, are commanded by it, and obey and give a stop."""

import errno
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import zmq
import zmq.auth
from foreign_programs import Program, bare_environment, debian_program, node_program
from planted_errors import Numbers, each_error, judge, planted

from telenano.runtime.security.keyring import Keyring
from telenano.signals import run, start
from telenano.testing import numbered
from telenano.testing.conformance.examination import Keys, examine
from telenano.testing.waiting import free_ports
from telenano.wire import HapticState, SessionEvent, encode
from telenano.wire.codec import accept

pytestmark = [pytest.mark.timeout(1800), pytest.mark.endurance]

CLIENTS = Path(__file__).parent / "clients"
POSITION_M = np.array([1.0 / 3.0, -2e-3, 7e-9])
FORCE_N = np.array([-0.1, 0.7, 1.0 / 7.0])
TIP_FORCE_N = np.array([2e-9, -1e-10, 3.3e-9])
# Of what a client says of the rig; `maps.h` and `keys.mjs` add what the libraries of a language lack.
MOST_LINES = 120
# Slower than a rig of its own, so that a machine with other work keeps up.
RATE_HZ = 200
# Rules of clients that arm: a hand is armed by others, and its own stop never expires.
OF_OTHERS = {"quoted clock", "quoted stop", "armed hand"}
ENCRYPTED = {"encryption", "strangers"}


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


class Line(NamedTuple):
    """The endpoints of a client and of the rig that it reads, and the key files of both where they are encrypted."""

    own: str
    rig: str
    key_files: tuple[Path, Path] | None = None

    @classmethod
    def plain(cls, folder: Path) -> "Line":
        return cls(f"ipc://{folder}/own", f"ipc://{folder}/rig")

    @classmethod
    def encrypted(cls, folder: Path) -> "Line":
        """Return endpoints on this machine's network, with a pair of keys for either end in files of a folder."""
        keyring = Keyring(folder / "keys")
        for name in ("hand", "rig"):
            keyring.create(name)
        own, rig = (f"tcp://127.0.0.1:{port}" for port in free_ports(2))
        return cls(own, rig, (keyring.secret_path("hand"), keyring.secret_path("rig")))

    @property
    def keys(self) -> Keys | None:
        """The keys of the rig's end, with the public one of the client."""
        if self.key_files is None:
            return None
        return Keys.of(zmq.auth.load_certificate(self.key_files[0])[0].decode(), self.key_files[1])

    @property
    def environment(self) -> dict[str, str]:
        """The variables that tell a client its key file, and the one key that it lets in."""
        if self.key_files is None:
            return {}
        return {
            "HAND_KEY_FILE": str(self.key_files[0]),
            "RIG_KEY": zmq.auth.load_certificate(self.key_files[1])[0].decode(),
        }


each_line = pytest.mark.parametrize("line_of", [Line.plain, Line.encrypted], ids=["plain", "encrypted"])
each_client = pytest.mark.parametrize("client", [client_in_c, client_in_node])
Made = Callable[[Path], Program]


@contextmanager
def running(client: Program, line: Line, seconds: float, stop_after_s: float) -> Iterator["subprocess.Popen[str]"]:
    """Run a client at its endpoint of a line; yield its process."""
    words = [line.own, line.rig, str(seconds), str(stop_after_s), str(RATE_HZ)]
    environment = {**bare_environment(), **client.environment, **line.environment}
    process = start([*client.command, *words], env=environment, stdout=subprocess.PIPE, text=True)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def presses(state: HapticState) -> bool:
    """Return whether the hand shows a force, as it does for 50 ms after each command."""
    return any(state.motor_force_n)


class Rig:
    """Speaks for the nodes of a rig in the folder of a client, and reads the client."""

    def __init__(self, line: Line) -> None:
        self._endpoint, self._keys = line.rig, line.keys
        self._context = zmq.Context()
        self._reader = self._context.socket(zmq.SUB)
        self._reader.subscribe(b"")
        if self._keys:
            self._reader.curve_serverkey, self._reader.curve_publickey, self._reader.curve_secretkey = self._keys
        self._reader.connect(line.own)
        self._publisher = self._bound()
        self._numbers: dict[str, int] = {}
        self._run = 1
        self.states: list[HapticState] = []
        self.events: list[SessionEvent] = []

    def __enter__(self) -> "Rig":
        return self

    def _bound(self) -> "zmq.Socket[bytes]":
        publisher = self._context.socket(zmq.PUB)
        if self._keys:
            publisher.curve_server, publisher.curve_secretkey = True, self._keys.secret
        free_by_s = time.monotonic() + 10.0
        while True:
            try:
                publisher.bind(self._endpoint)
            except zmq.ZMQError as error:
                # A closed socket leaves its port in a thread of its context, soon and not at once.
                if error.errno != errno.EADDRINUSE or time.monotonic() > free_by_s:
                    raise
                time.sleep(0.01)
            else:
                return publisher

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

    def command(
        self, position_m: Any, force_n: Any, tip_force_n: Any, until: Callable[[HapticState], bool]
    ) -> HapticState:
        """Send states and commands until the newest state of the hand is as wanted or 20 s are over, and return it."""
        end_s = time.monotonic() + 20.0
        while not (self.states and until(self.states[-1])) and time.monotonic() < end_s:
            self.read()
            if self.states:
                newest = self.states[-1]
                self.send("afm/state", "afm_node@slave", tip_force_n=tuple(tip_force_n))
                answered = {"hand_seq": newest.seq, "hand_t_ns": newest.t_ns, "mode": "force"}
                places = {"position_m": tuple(position_m), "force_n": tuple(force_n)}
                self.send("haptic/command", "controller@master", **answered, **places)
            time.sleep(0.005)
        assert self.states, "the client sends nothing"
        return self.states[-1]

    def restart(self) -> None:
        """End the rig and begin another one at the same endpoint."""
        self._publisher.close(linger=0)
        self._publisher = self._bound()
        self._numbers, self._run = {}, self._run + 1


@each_error
@each_client
def test_a_hand_takes_every_number_as_it_was_sent(tmp_path: Path, client: Made, error: str) -> None:
    line = Line.plain(tmp_path)
    with running(client(tmp_path), line, 5.0, 0.0) as process, Rig(line) as rig:
        position_m, force_n, tip_force_n = (
            planted(error, values, unit=1e-3) for values in (POSITION_M, FORCE_N, TIP_FORCE_N)
        )
        state = rig.command(position_m, force_n, tip_force_n, presses)
        printed, _ = process.communicate(timeout=30.0)
    found: Numbers = {
        "position": state.position_m,
        "force": state.motor_force_n,
        "tip force": json.loads(printed)["tip_force_n"],
    }
    judge(error, {"position": POSITION_M, "force": FORCE_N, "tip force": TIP_FORCE_N}, found, rtol=0.0)


@each_line
@each_client
def test_a_hand_finds_a_rig_again_and_obeys_its_stop(
    tmp_path: Path, client: Made, line_of: Callable[[Path], Line]
) -> None:
    line = line_of(tmp_path)
    with running(client(tmp_path), line, 120.0, 0.0), Rig(line) as rig:
        rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, presses)
        rig.restart()
        doubled = tuple(2.0 * FORCE_N)
        found = rig.command(2.0 * POSITION_M, doubled, TIP_FORCE_N, lambda state: state.motor_force_n == doubled)
        assert (found.position_m, found.motor_force_n) == (tuple(2.0 * POSITION_M), tuple(2.0 * FORCE_N))
        # It answers the sample that it was given, and by its own clock it does so at once.
        assert 0 <= found.answered_at_ns - found.answered_t_ns < 500_000_000
        assert not found.estop
        for _ in range(3):
            rig.send("session/control", "console@master", id="s-1", command="estop", target="*", parameters={})
        stopped = rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, lambda state: state.estop)
        assert (stopped.estop, stopped.mode, stopped.motor_force_n) == (True, "off", (0.0, 0.0, 0.0))
        rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, lambda _: len(rig.events) >= 3)
        assert {(event.kind, event.id) for event in rig.events} == {("ack", "s-1")}
        refused = {"id": "a-1", "command": "arm", "target": "haptic_node@master", "parameters": {}}
        rig.send("session/control", "console@master", **refused)
        assert rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, lambda _: len(rig.events) >= 4).armed is False
        assert (rig.events[-1].kind, rig.events[-1].data["latch"]) == ("refused", "s-1")
        rig.send("session/control", "console@master", **refused, node_latch={"haptic_node@master": "s-1"})
        armed = rig.command(POSITION_M, FORCE_N, TIP_FORCE_N, presses)
        assert (armed.armed, armed.estop, armed.motor_force_n) == (True, False, tuple(FORCE_N))


@each_line
@each_client
def test_the_kit_finds_nothing_wrong_in_a_hand_that_gives_a_stop(
    tmp_path: Path, client: Made, line_of: Callable[[Path], Line]
) -> None:
    line = line_of(tmp_path)._replace(rig=f"ipc://{tmp_path}/rig")
    with running(client(tmp_path), line, 12.0, 2.0) as process:
        findings = examine(line.own, line.rig, duration_s=16.0, keys=line.keys)
        printed, _ = process.communicate(timeout=30.0)
    # Pauses are those of a machine with other work.
    assert [found.line() for found in findings if found.outcome == "failed" and found.rule != "rate"] == []
    not_seen = OF_OTHERS if line.keys else OF_OTHERS | ENCRYPTED
    assert {found.rule for found in findings if found.outcome == "not seen"} == not_seen
    assert json.loads(printed)["stop_was_heard"] is True


@pytest.mark.parametrize("name", ["hand_client.c", "hand_client.mjs"])
def test_a_client_is_short(name: str) -> None:
    assert len((CLIENTS / name).read_text(encoding="utf-8").splitlines()) <= MOST_LINES
