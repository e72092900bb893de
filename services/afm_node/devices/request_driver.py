"""What the drivers of AFM controllers have in common: a conversation that is a generator, and ticks that never wait.

A driver is written as the talk that it has with its controller, from the first question to a cycle that goes on for
ever. A tick gives it the answer that has come and sends the request that it then has. A loss is a state: the connection
is made anew, and the talk begins at its beginning.
"""

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable

from services.afm_node.devices import modbus_line
from services.afm_node.devices.modbus_line import Connect, Line, TcpConnector, go_on_connecting
from services.afm_node.devices.piezo_calibration import ControllerCalibration
from services.afm_node.devices.request_answer import Cut, Incoming, Talk, WireError
from services.afm_node.driver import DeviceError, DeviceReport
from services.afm_node.physics.part import AfmSample
from services.afm_node.safety import SafetyParams

_MS = 1_000_000
STALE_CYCLES = 3
_CLOSE_S, _RECONNECT_S, _POLL_S = 0.1, 0.3, 1e-3


class RequestDriver(ABC):
    """An `AfmDriver` of a controller that answers one request after the other.

    Args:
        calibration: The calibration of this very controller.
        limits: The limits of the node's guard.
        cut: The rule by which messages are cut out of the stream.
        model: What the controller is called.
        attended: Whether a person stands by who retracts the tip when this process dies.
        period_s: The period of the loop [s].
        connect: Connects to the controller; a test replaces it.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: Waits in `open`, `retract` and `close`, and nowhere else.

    Raises:
        DeviceError: Calibration and limits do not fit together.
    """

    state = None
    vibration = None
    simulation = None
    relief = None
    # how long a controller may be silent while it is driven [ns]
    lost_ns = modbus_line.LOST_NS

    def __init__(
        self,
        calibration: ControllerCalibration,
        limits: SafetyParams,
        cut: Cut,
        model: str,
        *,
        attended: bool = False,
        period_s: float = 1e-3,
        connect: Connect | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if faults := calibration.check(limits):
            raise DeviceError("; ".join(faults))
        self.calibration, self._limits, self._attended = calibration, limits, attended
        self._cut, self._model = cut, model
        self._where = f"{calibration.network.host}:{calibration.network.port}"
        self._connect: Connect = TcpConnector() if connect is None else connect
        self._now_ns, self._sleep, self._period_s = now_ns, sleep, period_s
        self._line: Line | None = None
        self._talk: Talk | None = None
        self._incoming = Incoming(cut)
        self._ready = self._opened = self._waiting = False
        # After a (re)connection the tip stays retracted until the guard has it there as well.
        self._released = False
        self._base_m = limits.retract_position_m
        self._begun_ns = self._sent_ns = self._retry_ns = self._sampled_ns = self._ready_ns = 0
        # z that was sent [m], and when [ns]: a sample may show any of those since the tick before it
        self._history: deque[tuple[int, float]] = deque(maxlen=1024)
        # the place at the rig's 0, 0, the one that is wanted, and the one that was sent last, of the controller [m]
        self._centre: tuple[float, float] | None = None
        self._place: tuple[float, float] | None = None
        self._sent_place: tuple[float, float] | None = None
        # answers with a sample, and those of them that were not the one before again
        self.exchanges = self.fresh = 0
        # samples since the tip was found in its safe state, 0 while it is not there
        self._retracted = 0
        self.tick_s = 0.0
        # how often the guard has retracted the tip since it began; None where there is no guard
        self.retractions: int | None = None
        self._values = math.nan, math.nan
        self._text = ""
        self._readings = calibration.readings(calibration.z.retract_m, calibration.deflection.zero)
        self._report = DeviceReport("lost", 0.0, True, "the controller is not open")

    @abstractmethod
    def talk(self) -> Talk:
        """Return the requests from the first question on; `begin_cycles` says when the controller is ready.

        Raises:
            DeviceError: The controller is another one, refuses, or somebody else has moved the tip.
        """

    @property
    @abstractmethod
    def latency_s(self) -> float:
        """Return what the controller is declared to add to the round trip, in the mean [s]."""

    @property
    def stage(self) -> "RequestDriver | None":
        return None if self.calibration.stage is None else self

    @property
    def lateral_force_n(self) -> tuple[float, float]:
        """Return zeros: no controller here has a lateral force among what is read."""
        return 0.0, 0.0

    def move_to(self, x_m: float, y_m: float) -> None:
        """Put the tip over a place of the sample [m]; ValueError where it is not finite or out of reach."""
        stage, centre = self.calibration.stage, self._centre
        if stage is None or centre is None or not max(abs(x_m), abs(y_m)) <= stage.reach_m:
            raise ValueError(f"lateral position {x_m}, {y_m} m must be finite and within the reach of the stage")
        self._place = centre[0] + x_m, centre[1] + y_m

    @property
    def safe_position_m(self) -> float:
        return self.calibration.base_m(self.calibration.z.retract_m)

    @property
    def report(self) -> DeviceReport:
        return self._report

    @property
    def identity(self) -> str:
        """Return who the controller is, for a person; known once it is open."""
        return self._model

    @property
    def heartbeat_s(self) -> float:
        """Return the silence after which the guard retracts [s]; 0 where a person stands by in its place."""
        return 0.0 if self._attended else self.calibration.heartbeat_s

    @property
    def calibration_identity(self) -> str:
        return self.calibration.identity

    def wanted_z_m(self) -> float:
        """Return the z that is to be sent now [m]: that of the safe state until the guard has the tip there as well."""
        return self.calibration.z_m(self._base_m) if self._released else self.calibration.z.retract_m

    def begin_cycles(self, identity: str) -> None:
        """Note that the controller is who it should be, set up and retracted."""
        self._model, self._ready, self._ready_ns = identity, True, self._now_ns()
        self._text = f"{self._where}: {identity} is ready and retracted, calibration {self.calibration.identity}"

    def refuse_without_guard(self) -> None:
        """Raise DeviceError: nothing would retract the tip."""
        raise DeviceError(
            "has no guard in front of it, and would leave the tip where it is when this process dies: run `telenano"
            f" device guard {self.calibration.controller}` beside the controller and give its port, or give --attended"
            " (afm_node.attended: true) while a person stands by who can retract the tip"
        )

    def find_centre(self, x_m: float, y_m: float) -> None:
        """Take the place where the tip is found first [m] as that of the rig's 0, 0, if the file has no other."""
        stage = self.calibration.stage
        if stage is not None and self._centre is None:
            self._centre = x_m if stage.x_m is None else stage.x_m, y_m if stage.y_m is None else stage.y_m
            self._place = self._centre

    def check_z(self, z_m: float, asked_ns: int) -> None:
        """Compare z with all that was sent since two ticks ago; DeviceError where somebody else has moved it."""
        since_ns = asked_ns - round((2.0 * self.tick_s + 4.0 * self._period_s) * 1e9)
        while len(self._history) > 1 and self._history[1][0] < since_ns:
            self._history.popleft()
        sent, tolerance_m = [value_m for _, value_m in self._history], self.calibration.z.tolerance_m
        if not min(sent) - tolerance_m <= z_m <= max(sent) + tolerance_m:
            raise DeviceError(
                f"somebody else has moved the tip: z is {z_m:.6g} m, and {sent[-1]:.6g} m was sent; the tip is"
                " retracted, and stays so until armed"
            )

    def take_sample(self, z_m: float, value: float, sampled_ns: int) -> None:
        """Take a sample of z [m] and the deflection's signal, taken at a time of the monotonic clock [ns]."""
        self.fresh += (z_m, value) != self._values
        self._values = z_m, value
        self._readings = self.calibration.readings(z_m, value)
        self._sampled_ns = sampled_ns
        self.exchanges += 1
        at_m = self._readings.sample.base_m
        is_there = abs(at_m - self.safe_position_m) <= self.calibration.z.tolerance_m
        self._retracted = self._retracted + 1 if is_there else 0

    def open(self) -> None:
        """Connect, identify, set up, retract and take a first sample.

        Raises:
            DeviceError: The controller is absent or another one; the message says what was found.
        """
        if self._opened:
            raise RuntimeError("the controller is already open")
        self._opened = True
        self._begin(self._now_ns())
        while not (self._ready and self.exchanges):
            if self._line is None:
                self._opened = False
                raise DeviceError(self._text)
            self._sleep(_POLL_S)
            self._poll(self._now_ns())
        self._judge(self._now_ns())

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and return the newest sample; `report` has its age and state."""
        if not abs(base_m) < float("inf"):
            raise ValueError(f"base position {base_m} m must be finite")
        if not self._opened:
            raise RuntimeError("the controller is not open: call open() first")
        self._released |= self._ready and base_m <= self._limits.retract_position_m
        self._base_m = base_m
        now_ns = self._now_ns()
        self._poll(now_ns)
        self._judge(now_ns)
        return self._readings.sample

    def retract(self) -> bool:
        """Send the safe position, on a new connection if need be; return whether the tip was found there since.

        Waits 0.1 s at most, and 0.3 s for a new connection.
        """
        if not self._opened:
            return False
        self._released, self._retracted = False, 0
        wait_s = _CLOSE_S
        if not self._ready:
            wait_s = _RECONNECT_S
            self._drop(self._now_ns())
            self._begin(self._now_ns())
        connected, until_ns = self._line, self._now_ns() + round(wait_s * 1e9)
        while self._line is connected is not None and self._now_ns() < until_ns:
            self._poll(self._now_ns())
            # The answer that was under way at the beginning says nothing of the retraction.
            if self._ready and self._retracted >= 2:
                return True
            self._sleep(_POLL_S)
        return False

    def close(self) -> None:
        """Retract and disconnect; harmless when already closed."""
        if self._ready:
            self.retract()
        self._drop(self._now_ns())
        self._opened = False

    def _begin(self, now_ns: int) -> None:
        self._retry_ns = now_ns + modbus_line.RETRY_NS
        self._released = self._ready = self._waiting = False
        self.exchanges = self._retracted = 0
        self._incoming = Incoming(self._cut)
        try:
            self._line = self._connect(self.calibration.network.host, self.calibration.network.port)
        except OSError as error:
            self._lose(now_ns, f"cannot be reached: {error.strerror or error}")
            return
        self._sent_ns = self._begun_ns = now_ns

    def _drop(self, now_ns: int) -> None:
        if self._line is not None:
            self._line.close()
        self._line = self._talk = None
        self._ready = False
        self._retry_ns = now_ns + modbus_line.RETRY_NS

    def _lose(self, now_ns: int, text: str) -> None:
        self._text = f"{self._where}: {self._model}: {text}"
        self._drop(now_ns)

    def _poll(self, now_ns: int) -> None:
        """Do what can be done now; nothing is raised, a loss is a state."""
        try:
            if self._line is None:
                if self._opened and now_ns >= self._retry_ns:
                    self._begin(now_ns)
            elif self._talk is None:
                self._go_on_connecting(now_ns, self._line)
            else:
                self._go_on_talking(now_ns, self._line, self._talk)
        except (WireError, DeviceError) as error:
            self._lose(now_ns, str(error))
        except OSError as error:
            self._lose(now_ns, f"the connection is gone: {error.strerror or error}")

    def _go_on_connecting(self, now_ns: int, line: Line) -> None:
        ready, self._sent_ns = go_on_connecting(line, now_ns, self._begun_ns, self._sent_ns)
        if ready:
            self._talk = self.talk()
            self._send(next(self._talk), now_ns, line)

    def _go_on_talking(self, now_ns: int, line: Line, talk: Talk) -> None:
        if not self._waiting:
            self._send(talk.send(b""), now_ns, line)
            return
        self._incoming.add(line.receive())
        answer = self._incoming.take()
        if answer is None:
            if self._ready and now_ns - self._sent_ns > self.lost_ns:
                raise DeviceError(f"has been silent for {self.lost_ns // _MS} ms")
            if now_ns - self._sent_ns > modbus_line.STEP_NS:
                raise DeviceError(f"is connected and does not answer requests: is it a {self._model}?")
            return
        if self._incoming.pending:
            raise DeviceError("has answered more than it was asked")
        self._send(talk.send(answer), now_ns, line)

    def _send(self, request: bytes | None, now_ns: int, line: Line) -> None:
        self._waiting = request is not None
        if request is not None:
            line.send(request)
            self._sent_ns = now_ns

    def _judge(self, now_ns: int) -> None:
        """Renew the report; the age counts from the oldest moment at which the sample can have been taken."""
        age_s = max(now_ns - self._sampled_ns, 0) * 1e-9 if self._sampled_ns else 0.0
        if not self._ready:
            self._report = DeviceReport("lost", age_s, True, self._text)
            return
        stale_s = STALE_CYCLES * (self.tick_s + 2.0 * self._period_s)
        sample, in_range = self._readings
        status = "ok" if age_s <= stale_s else "stale"
        self._report = DeviceReport(
            "ok" if status == "ok" else "stale", age_s, in_range, self._text, input_v=sample.bridge_voltage_v
        )
