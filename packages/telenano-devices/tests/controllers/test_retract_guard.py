"""The guard in front of a controller, on real sockets whose other ends the test holds itself."""

import socket
import time
from collections.abc import Callable, Iterator

import pytest
from telenano_devices.controllers.request_answer import Incoming
from telenano_devices.controllers.retract_guard import RetractGuard
from telenano_devices.doubles.controller_line import PARAMS, calibration
from telenano_devices.gwyscope import gwyscope_model, gwyscope_wire
from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration
from telenano_devices.gwyscope.gwyscope_driver import GUARD_QUESTION
from telenano_devices.gwyscope.gwyscope_guard import GuardedGwyscope

from telenano.testing import instrument_of

PATIENCE_S = 30.0
HEARTBEAT_S = 0.2


class Wiring:
    """A guard between a rig and a server, both in the hands of the test; nothing moves but in `until`."""

    def __init__(self) -> None:
        document = gwyscope_model.calibration_of(PARAMS.plant.volts_per_m, PARAMS.plant.stiffness_n_per_m)
        self.guarded = GuardedGwyscope(calibration(GwyscopeCalibration, document, heartbeat_s=HEARTBEAT_S))
        afm = instrument_of()
        afm.open()
        self.model = gwyscope_model.GwyscopeModel(afm)
        self.model.respond({"todo": "set_feedback", "feedback": False, "zpiezo": 1.9e-6}, 0)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setblocking(False)
        self._server: socket.socket | None = None
        self._incoming = Incoming(gwyscope_wire.cut)
        self.answers = True
        self.told: list[str] = []
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.where = free.getsockname()
        # the guard's time is that of the test: a machine that is held up says nothing of a rig
        self.now_ns = 10**9
        at = self._listener.getsockname()
        self.guard = RetractGuard(self.guarded, at, self.where, self.told.append, lambda: self.now_ns)
        self.rig: socket.socket | None = None
        self.received = Incoming(gwyscope_wire.cut)

    def until(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, self.told
            self.guard.step()
            self._serve()

    def _serve(self) -> None:
        try:
            if self._server is None:
                self._server = self._listener.accept()[0]
                self._server.setblocking(False)
                self._incoming = Incoming(gwyscope_wire.cut)
            self._incoming.add(self._server.recv(4096))
        except BlockingIOError:
            pass
        while self.answers and self._server is not None and (request := self._incoming.take()) is not None:
            answer = self.model.respond(gwyscope_wire.decode(request), 0)
            self._server.sendall(gwyscope_wire.encode(answer))

    def connect(self) -> None:
        self.rig = socket.create_connection(self.where, timeout=PATIENCE_S)
        self.rig.setblocking(False)
        self.received = Incoming(gwyscope_wire.cut)

    def ask(self, **message: object) -> dict[str, object]:
        assert self.rig is not None
        self.rig.sendall(gwyscope_wire.encode(message))
        found: list[bytes] = []

        def answered() -> bool:
            assert self.rig is not None
            try:
                self.received.add(self.rig.recv(4096))
            except BlockingIOError:
                return False
            answer = self.received.take()
            if answer is not None:
                found.append(answer)
            return bool(found)

        self.until(answered)
        return gwyscope_wire.decode(found[0])

    def close(self) -> None:
        for each in (self.rig, self._server, self._listener):
            if each is not None:
                each.close()


@pytest.fixture
def wiring() -> Iterator[Wiring]:
    found = Wiring()
    yield found
    found.close()
    found.guard.run(lambda: False)


def test_it_retracts_first_passes_on_and_retracts_when_the_rig_leaves(wiring: Wiring) -> None:
    wiring.until(lambda: wiring.model.z_m == 0.0)
    wiring.connect()
    said = {"todo": GUARD_QUESTION, "heartbeat_s": HEARTBEAT_S, "trips": 0}
    assert wiring.ask(todo=GUARD_QUESTION, heartbeat_s=1.0) == said
    assert wiring.ask(todo="get", version="")["version"] == gwyscope_model.VERSION
    wiring.ask(todo="set_feedback", feedback=False, zpiezo=1.9e-6)
    assert wiring.model.z_m == 1.9e-6
    assert wiring.rig is not None
    wiring.rig.close()
    wiring.until(lambda: wiring.model.z_m == 0.0)
    assert wiring.guard.judge.trips == 1
    assert any("the rig's connection has ended while the tip was driven" in text for text in wiring.told)
    wiring.connect()
    assert wiring.ask(todo="read")["z"] == 0.0


def test_it_breaks_the_connection_of_a_rig_that_is_silent_and_retracts(wiring: Wiring) -> None:
    wiring.until(lambda: wiring.model.z_m == 0.0)
    wiring.connect()
    wiring.ask(todo="set_feedback", feedback=False, zpiezo=1.9e-6)
    wiring.now_ns += round(0.99 * HEARTBEAT_S * 1e9)
    for _ in range(5):
        wiring.guard.step()
    assert wiring.guard.judge.trips == 0
    wiring.now_ns += round(0.02 * HEARTBEAT_S * 1e9)
    wiring.until(lambda: wiring.model.z_m == 0.0)
    assert any("the rig was silent for more than 200 ms, and the tip is retracted" in text for text in wiring.told)
    rig = wiring.rig
    assert rig is not None
    rig.settimeout(PATIENCE_S)
    assert rig.recv(1) == b""


def test_a_controller_that_stood_still_is_retracted_as_soon_as_it_answers(wiring: Wiring) -> None:
    wiring.until(lambda: wiring.model.z_m == 0.0)
    wiring.connect()
    wiring.ask(todo="set_feedback", feedback=False, zpiezo=1.9e-6)
    wiring.answers = False
    assert wiring.rig is not None
    wiring.rig.sendall(gwyscope_wire.encode({"todo": "read"}))
    wiring.until(lambda: wiring.guard._owed == "rig")
    wiring.rig.close()
    wiring.until(lambda: wiring.guard.judge.due)
    assert wiring.model.z_m == 1.9e-6
    wiring.answers = True
    wiring.until(lambda: wiring.model.z_m == 0.0)


def test_a_rig_that_sends_garbage_or_does_not_wait_is_put_out(wiring: Wiring) -> None:
    wiring.until(lambda: wiring.model.z_m == 0.0)
    wiring.connect()
    assert wiring.rig is not None
    wiring.rig.sendall(b"GET / HTTP/1.1\r\n\r\n")
    wiring.until(lambda: any("received bytes that are not a request" in text for text in wiring.told))
    wiring.rig.close()
    wiring.connect()
    wiring.answers = False
    wiring.rig.sendall(2 * gwyscope_wire.encode({"todo": "read"}))
    wiring.until(lambda: any("before it had the answer to the last one" in text for text in wiring.told))
