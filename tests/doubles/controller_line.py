"""A connection between a driver and an emulated controller in virtual time, with the guard in between if wanted."""

from collections.abc import Callable
from operator import methodcaller
from typing import Any, NamedTuple, TypeVar

import pytest
from telenano_afm_controllers import gwyscope_model, gwyscope_wire, nanonis_model
from telenano_afm_controllers.calibration import GwyscopeCalibration, NanonisCalibration
from telenano_afm_controllers.gwyscope_driver import GwyscopeAfm
from telenano_afm_controllers.gwyscope_guard import GuardedGwyscope
from telenano_afm_controllers.nanonis_driver import NanonisAfm
from telenano_afm_controllers.nanonis_guard import GuardedNanonis
from telenano_afm_controllers.retract_guard import SilenceJudge

from telenano.settings import merge, validate
from telenano.testing import InstrumentRig, RequestLine, afm_config, afm_node, instrument_of
from telenano.wire import ConfigError

NEAR_M = -70e-9
PARAMS = afm_config().to_params()
RETRACTED_M = PARAMS.safety.retract_position_m
C = TypeVar("C", GwyscopeCalibration, NanonisCalibration)


def calibration(model: type[C], document: dict[str, object], **changes: Any) -> C:
    return validate(model, merge(document, changes), "controller.yaml")


class ControllerLine(RequestLine):
    """A line to a controller. respond: its answer to a request. judge: the guard in between, None for none."""

    def __init__(self, guarded: Any = None) -> None:
        super().__init__()
        self.respond: Callable[[bytes, int], bytes | None] = self.served
        self.guarded = guarded
        self.judge = None if guarded is None else SilenceJudge(guarded)
        self.sent: list[bytes] = []
        self._connected = False
        # when the guard has passed the answer of the controller on, 0 where none is owed
        self._owed_ns = 0

    def connect(self, host: str, port: int) -> Any:
        if self.judge is not None and self.judge.due:
            raise OSError(111, "Connection refused")
        super().connect(host, port)
        self._connected = True
        return self

    def send(self, request: bytes) -> None:
        if not self._connected or not self.reachable:
            raise OSError(104, "Connection reset by peer")
        own = None if self.judge is None else self.judge.hear(request, self.now_ns)
        self.sent.append(request)
        answer = own if own is not None or not self.running else self.respond(request, self.now_ns)
        if answer is not None:
            self._owed_ns = self.answer(answer)

    def receive(self) -> bytes:
        if not self._connected:
            raise OSError(104, "Connection reset by peer")
        return super().receive()

    def close(self) -> None:
        self._connected = False

    def mend(self) -> None:
        self.reachable = self.running = self.accepting = True
        self.latency_ms = 0.0
        self.respond = self.served
        self.to_host = lambda sent: sent

    def served(self, request: bytes, now_ns: int) -> bytes | None:
        """Return the answer of the emulated controller to a request."""
        raise NotImplementedError

    def guard(self) -> None:
        if (judge := self.judge) is None:
            return
        if self._owed_ns and self.now_ns >= self._owed_ns:
            self._owed_ns = 0
            judge.passed_back(self.now_ns)
        if judge.judge(self.now_ns, connected=self._connected):
            self._connected = False
        if judge.due and self.reachable and self.running:
            answer = self.respond(self.guarded.retraction(), self.now_ns)
            if answer is not None:
                judge.take(answer)


class Gwyscope(ControllerLine):
    """A Gwyscope and its driver."""

    def __init__(
        self, *, tick_s: float = 3e-3, guarded: bool = True, attended: bool = False, config: Any = None, **changes: Any
    ) -> None:
        document = gwyscope_model.calibration_of(PARAMS.plant.volts_per_m, PARAMS.plant.stiffness_n_per_m)
        self.calibration = calibration(GwyscopeCalibration, document, **changes)
        super().__init__(GuardedGwyscope(self.calibration) if guarded else None)
        afm = instrument_of() if config is None else config
        afm.open()
        self.model = gwyscope_model.GwyscopeModel(afm, tick_s=tick_s, now_ns=self.now_ns)
        self.driver = GwyscopeAfm(self.calibration, PARAMS.safety, attended=attended, **self.clock)
        # a guard retracts first, and then lets a rig in
        self.pass_ms(1)

    def served(self, request: bytes, now_ns: int) -> bytes | None:
        return gwyscope_wire.encode(self.model.respond(gwyscope_wire.decode(request), now_ns))

    @property
    def base_m(self) -> float:
        """Return where the base really is, towards the sample [m]."""
        return self.model.z_m - gwyscope_model.REST_M

    @property
    def is_retracted(self) -> bool:
        return self.model.z_m == 0.0

    def mend(self) -> None:
        super().mend()
        self.model.stands = False
        self.model.values["scanning_line"] = False


class Nanonis(ControllerLine):
    """A Nanonis controller and its driver."""

    def __init__(
        self, *, tap_s: float = 20e-3, guarded: bool = True, attended: bool = False, afm: Any = None, **changes: Any
    ) -> None:
        document = nanonis_model.calibration_of(PARAMS.plant.volts_per_m, PARAMS.plant.stiffness_n_per_m)
        self.calibration = calibration(NanonisCalibration, document, **changes)
        super().__init__(GuardedNanonis(self.calibration) if guarded else None)
        afm = instrument_of() if afm is None else afm
        afm.open()
        self.model = nanonis_model.NanonisModel(afm, tap_s=tap_s, now_ns=self.now_ns)
        self.driver = NanonisAfm(self.calibration, PARAMS.safety, attended=attended, **self.clock)
        self.pass_ms(1)

    def connect(self, host: str, port: int) -> Any:
        if port == nanonis_model.LOG_PORT:
            return LogLine(self)
        return super().connect(host, port)

    def served(self, request: bytes, now_ns: int) -> bytes | None:
        return self.model.serve(request, now_ns)

    @property
    def base_m(self) -> float:
        """Return where the base really is, towards the sample [m]."""
        return 0.0 - self.model.z_m

    @property
    def is_retracted(self) -> bool:
        return self.model.z_m >= 5e-7 - 1e-12

    def mend(self) -> None:
        super().mend()
        self.model.locked = ""


class LogLine:
    """The connection to the TCP Logger of an emulated Nanonis, whose frames come in pieces."""

    resolved = True

    def __init__(self, controller: Nanonis) -> None:
        self._controller, self._rest = controller, b""

    def ready(self) -> bool:
        return True

    def send(self, request: bytes) -> None:
        raise AssertionError("nothing is sent to a logger")

    def receive(self) -> bytes:
        if not self._controller.running:
            return b""
        both = self._rest + self._controller.model.log.take()
        # the end of what is there comes with the next
        cut = max(0, len(both) - 5)
        self._rest = both[cut:]
        return both[:cut]

    def close(self) -> None:
        self._rest = b""


# --- faults of any controller's server or connection


def kill(line: ControllerLine) -> None:
    line.reachable = False


def stop(line: ControllerLine) -> None:
    line.running = False


def interrupt(line: ControllerLine) -> None:
    line.close()


def swallow(line: ControllerLine) -> None:
    line.close()
    line.accepting = False


def answer_twice(line: ControllerLine) -> None:
    line.to_host = lambda sent: sent + sent


class ControllerRig(InstrumentRig):
    def arm_and_follow_to(self, x_s_m: float) -> list[float]:
        """Arm, and follow to a place; give where the base was after each tick, towards the sample [m]."""
        self.control("arm", place="hand")
        bases = [self.line.base_m]
        while abs(bases[-1] - x_s_m) > 1e-12:
            self.tick(1, x_s_m)
            bases.append(self.line.base_m)
            assert len(bases) < 500, bases[-3:]
        return bases


class Fault(NamedTuple):
    """A row of a table of faults.

    begin, end: how it comes and goes; text: of the event; status: of driver and bus; at_ms: by when the base is
    retracted at the latest, None where it cannot be while the fault lasts; retracts: whether and why the guard does;
    moves: the base goes elsewhere.
    """

    begin: Callable[[Any], None]
    text: str = ""
    status: str = "lost"
    duration_ms: int = 90
    at_ms: int | None = 5
    retracts: str = "device_lost"
    end: Callable[[Any], None] = methodcaller("mend")
    moves: bool = False


def walk(rig: ControllerRig, fault: Fault, place: tuple[float, float] = (0.0, 0.0)) -> None:
    """Have a fault come and go while a rig follows near the sample, and see that the tip is retracted after it."""
    line = rig.line
    events: list[str] = []
    retracted_ms = None

    def tick() -> Any:
        rig.tick(1, NEAR_M, place)
        events.extend(event.text for event in rig.bench.take("session/event"))
        return rig.bench.take("afm/state")[-1]

    rig.bench.take("session/event")
    fault.begin(line)
    states, bases = [], []
    for count in range(fault.duration_ms):
        states.append(tick())
        bases.append(line.base_m)
        if retracted_ms is None and line.is_retracted:
            retracted_ms = count + 1
    # driver and bus
    assert fault.status in {state.device for state in states} or line.driver.report.status == fault.status
    assert sum(fault.text in text for text in events) == 1 or not fault.text, events
    if fault.retracts:
        assert any(f"the AFM is in mode retracting: {fault.retracts}" in text for text in events)
        assert states[-1].mode in ("retracting", "retracted")
    else:
        assert {state.mode for state in states} == {"follow"}
    # device: the tip, whatever its host knows of it
    if fault.at_ms is not None:
        assert retracted_ms is not None
        assert retracted_ms <= fault.at_ms
    elif fault.retracts == "force_invalid":
        assert line.base_m <= RETRACTED_M + 1e-15
    elif not fault.moves:
        assert bases == [pytest.approx(NEAR_M, abs=1e-12)] * len(bases)
    # and on it goes: with the tip retracted, until armed
    fault.end(line)
    states = []
    while not states or states[-1].device != "ok":
        states.append(tick())
        assert len(states) < 1500, events[-3:]
    if not fault.retracts:
        assert {state.mode for state in states} == {"follow"}
        return
    states += [tick() for _ in range(80)]
    assert line.base_m <= RETRACTED_M + 1e-12
    assert (states[-1].mode, states[-1].device) == ("retracted", "ok")


def refuses_to_start(bench: Any, line: Any, begin: Callable[[Any], None], text: str) -> None:
    """Have a node begin with what is wrong from the start, and see that it says so and publishes nothing."""
    begin(line)
    with pytest.raises(ConfigError, match=text):
        afm_node(bench, line.driver)
    assert bench.sent == []
