"""What the drivers of AFM controllers have in common: a conversation that is a generator.

A driver is written as the talk that it has with its controller, from the first question to a cycle that continues for
ever. A tick gives it the answer that has come and sends the request that it then has.
"""

import math
from abc import abstractmethod
from collections import deque
from typing import Any, TypeVar

from telenano.devices import Line, TcpDriver
from telenano.extend.instruments import AfmReport, DeviceError, SafetyParams
from telenano_devices.controllers.piezo_calibration import ControllerCalibration
from telenano_devices.controllers.request_answer import Cut, Incoming, Talk

_MS = 1_000_000


K = TypeVar("K", bound=ControllerCalibration)


class RequestDriver(TcpDriver[K]):
    """An `AfmDriver` of a controller that answers one request after the other.

    Args:
        calibration: The calibration of this very controller.
        limits: The limits of the node's guard.
        cut: The rule by which messages are cut out of the stream.
        model: What the controller is called.
        attended: Whether a person stands by who retracts the tip when this process dies.
        options: Those of `TcpDriver`.

    Raises:
        DeviceError: Calibration and limits do not fit together.
    """

    kind = "controller"
    # how long a controller may be silent while it is driven [ns]
    lost_ns = TcpDriver.LOST_NS

    def __init__(
        self,
        calibration: K,
        limits: SafetyParams,
        cut: Cut,
        model: str,
        *,
        attended: bool = False,
        **options: Any,
    ) -> None:
        if faults := calibration.check(limits):
            raise DeviceError("; ".join(faults))
        readings = calibration.readings(calibration.z.retract_m, calibration.deflection.zero)
        super().__init__(calibration, limits, model, readings, **options)
        self._attended, self._cut = attended, cut
        self._incoming = Incoming(cut)
        self._waiting = False
        self._base_m = limits.retract_position_m
        self._ready_ns = 0
        # z that was sent [m], and when [ns]: a sample may show any of those since the tick before it
        self._history: deque[tuple[int, float]] = deque(maxlen=1024)
        # the place at the rig's 0, 0, the one that is wanted, and the one that was sent last, of the controller [m]
        self._centre: tuple[float, float] | None = None
        self._place: tuple[float, float] | None = None
        self._sent_place: tuple[float, float] | None = None
        # those of the exchanges that were not the one before again
        self.fresh = 0
        # samples since the tip was found in its safe state, 0 while it is not there
        self._retracted = 0
        self.tick_s = 0.0
        self._values = math.nan, math.nan

    @abstractmethod
    def talk(self) -> Talk:
        """Return the requests from the first question on; `begin_cycles` says when the controller is ready.

        Raises:
            DeviceError: The controller is another one, refuses, or somebody else has moved the tip.
        """

    @property
    def stage(self) -> "RequestDriver[K] | None":
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
    def heartbeat_s(self) -> float:
        """Return the silence after which the guard retracts [s]; 0 where a person stands by in its place."""
        return 0.0 if self._attended else self.calibration.heartbeat_s

    def wanted_z_m(self) -> float:
        """Return the z that is to be sent now [m]: that of the safe state until the guard has the tip there as well."""
        return self.calibration.z_m(self._base_m) if self._released else self.calibration.z.retract_m

    def begin_cycles(self, identity: str) -> None:
        """Note that the controller is who it should be, set up and retracted."""
        self._model, self._ready_ns = identity, self._now_ns()
        self._come_up(identity)

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
        """Compare z with all that was sent since two ticks ago.

        Raises:
            DeviceError: Somebody else has moved it, or the driver has noted nothing that it sent.
        """
        since_ns = asked_ns - round((2.0 * self.tick_s + 4.0 * self._period_s) * 1e9)
        while len(self._history) > 1 and self._history[1][0] < since_ns:
            self._history.popleft()
        sent, tolerance_m = [value_m for _, value_m in self._history], self.calibration.z.tolerance_m
        if not sent:
            raise DeviceError(
                "compares z with what was sent, and notes none: its talk appends each z to `_history` first"
            )
        if not min(sent) - tolerance_m <= z_m <= max(sent) + tolerance_m:
            raise DeviceError(
                f"somebody else has moved the tip: z is {z_m:.6g} m, and {sent[-1]:.6g} m was sent; the tip is"
                " retracted, and stays so until armed"
            )

    def take_sample(self, z_m: float, value: float, sampled_ns: int) -> None:
        """Take a sample of z [m] and the deflection's signal, taken at a time of the monotonic clock [ns]."""
        if not (math.isfinite(z_m) and math.isfinite(value)):
            raise DeviceError(f"answered with a value that is not a number: z = {z_m} m, a signal of {value}")
        self.fresh += (z_m, value) != self._values
        self._values = z_m, value
        self._readings = self.calibration.readings(z_m, value)
        self._sampled_ns = sampled_ns
        self.exchanges += 1
        at_m = self._readings.sample.base_m
        is_there = abs(at_m - self.safe_position_m) <= self.calibration.z.tolerance_m
        self._retracted = self._retracted + 1 if is_there else 0

    def _restart(self) -> None:
        self._waiting, self._retracted = False, 0
        self._incoming = Incoming(self._cut)

    def _begin_talk(self, now_ns: int, line: Line) -> None:
        self._talk = self.talk()
        self._send(next(self._talk), now_ns, line)

    def _want(self, base_m: float) -> None:
        self._base_m = base_m

    def _want_safe(self) -> None:
        self._retracted = 0

    def _is_safe(self) -> bool:
        return self._ready and self._retracted >= 2

    def _continue_exchange(self, now_ns: int, line: Line, talk: Any) -> None:
        if not self._waiting:
            self._send(talk.send(b""), now_ns, line)
            return
        self._incoming.add(line.receive())
        answer = self._incoming.take()
        if answer is None:
            if self._ready and now_ns - self._sent_ns > self.lost_ns:
                raise DeviceError(f"has been silent for {self.lost_ns // _MS} ms")
            if now_ns - self._sent_ns > self.STEP_NS:
                raise DeviceError(f"is connected and does not answer requests: is it a {self._model}?")
            return
        if self._incoming.pending:
            raise DeviceError("has sent more answers than there were requests")
        self._send(talk.send(answer), now_ns, line)

    def _send(self, request: bytes | None, now_ns: int, line: Line) -> None:
        self._waiting = request is not None
        if request is not None:
            line.send(request)
            self._sent_ns = now_ns

    def _judge(self, now_ns: int) -> None:
        age_s = self._age_s(now_ns)
        if not self._ready:
            self._report = AfmReport("lost", age_s, True, self._text)
            return
        is_fresh = age_s <= self.STALE_CYCLES * (self.tick_s + 2.0 * self._period_s)
        sample, in_range = self._readings
        self._report = AfmReport(
            "ok" if is_fresh else "stale", age_s, in_range, self._text, input_v=sample.bridge_voltage_v
        )
