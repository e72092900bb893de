"""A wire between a driver and an emulated controller in virtual time, optionally with the guard in between."""

from collections.abc import Callable
from typing import Any, TypeVar

from telenano.settings import merge, validate
from telenano.testing import RequestLine, afm_config, instrument_of
from telenano_devices.controllers.retract_guard import SilenceJudge
from telenano_devices.gwyscope import gwyscope_model, gwyscope_wire
from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration
from telenano_devices.gwyscope.gwyscope_driver import GwyscopeAfm
from telenano_devices.gwyscope.gwyscope_guard import GuardedGwyscope
from telenano_devices.nanonis import nanonis_model
from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration
from telenano_devices.nanonis.nanonis_driver import NanonisAfm
from telenano_devices.nanonis.nanonis_guard import GuardedNanonis

PARAMS = afm_config().to_params()
C = TypeVar("C", GwyscopeCalibration, NanonisCalibration)


def calibration(model: type[C], document: dict[str, object], **changes: Any) -> C:
    """Return the calibration of a document, with changes to some keys."""
    return validate(model, merge(document, changes), "controller.yaml")


class ControllerLine(RequestLine):
    """A line to a controller. respond: function that answers a request. judge: guard in between, None for none."""

    def __init__(self, guarded: Any = None) -> None:
        super().__init__()
        self.respond: Callable[[bytes, int], bytes | None] = self.served
        self.guarded = guarded
        self.judge = None if guarded is None else SilenceJudge(guarded)
        self.sent: list[bytes] = []
        self._connected = False
        # The time at which the guard forwards the answer of the controller [ns], 0 if none is outstanding.
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
        # A guard retracts first; only then may a rig connect.
        self.pass_ms(1)

    def served(self, request: bytes, now_ns: int) -> bytes | None:
        return gwyscope_wire.encode(self.model.respond(gwyscope_wire.decode(request), now_ns))

    @property
    def base_m(self) -> float:
        """Return the true position of the base, towards the sample [m]."""
        return float(self.model.z_m - gwyscope_model.REST_M)

    @property
    def is_retracted(self) -> bool:
        return bool(self.model.z_m == 0.0)

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
        answer: bytes | None = self.model.serve(request, now_ns)
        return answer

    @property
    def base_m(self) -> float:
        """Return the true position of the base, towards the sample [m]."""
        return float(0.0 - self.model.z_m)

    @property
    def is_retracted(self) -> bool:
        return bool(self.model.z_m >= 5e-7 - 1e-12)

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
        both: bytes = self._rest + self._controller.model.log.take()
        # The last bytes come with the next piece.
        cut = max(0, len(both) - 5)
        self._rest = both[cut:]
        return both[:cut]

    def close(self) -> None:
        self._rest = b""
