"""The common base of drivers of AFM controllers, whose conversation is a generator.

A driver is written as its talk with the controller, from the first question to an endless cycle. A tick sends the
answer that has come into the generator, and the request that it yields to the controller.
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
# Greatest speed towards the sample, as a multiple of that of the guard: its steps and those of a cycle do not coincide.
_SLEW = 2.0
# Longest time between two values of z for which the base catches up [ns], so that a pause ends with no jump.
_CYCLE_NS = 8 * _MS


K = TypeVar("K", bound=ControllerCalibration)


class RequestDriver(TcpDriver[K]):
    """An `AfmDriver` of a controller that answers one request after the other.

    Args:
        calibration: The calibration of this particular controller.
        limits: The limits of the node's guard.
        cut: The function that finds the length of a message in the stream.
        model: The name of the model of the controller.
        attended: Whether a person stands by to retract the tip if this process dies.
        options: Keyword arguments of `TcpDriver`.

    Raises:
        DeviceError: Calibration and limits do not fit together.
    """

    kind = "controller"
    # The longest silence of a controller while it is driven [ns].
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
        # Times [ns] and values [m] of z that were sent: a sample may show any of those since the tick before it.
        self._history: deque[tuple[int, float]] = deque(maxlen=1024)
        # Places in the controller's coordinates [m]: at the rig's 0, 0; the wanted one; and the one sent last.
        self._centre: tuple[float, float] | None = None
        self._place: tuple[float, float] | None = None
        self._sent_place: tuple[float, float] | None = None
        # Number of exchanges whose values differ from the ones before.
        self.fresh = 0
        # Number of samples since the tip was found in its safe state, 0 while it is elsewhere.
        self._retracted = 0
        self.tick_s = 0.0
        self._values = math.nan, math.nan

    @abstractmethod
    def talk(self) -> Talk:
        """Return the generator of requests; it calls `begin_cycles` when the controller is ready.

        Raises:
            DeviceError: The controller is another one, refuses, or somebody else has moved the tip.
        """

    @property
    def stage(self) -> "RequestDriver[K] | None":
        return None if self.calibration.stage is None else self

    @property
    def lateral_force_n(self) -> tuple[float, float]:
        """Return zeros [N], because no controller here reports a lateral force."""
        return 0.0, 0.0

    def move_to(self, x_m: float, y_m: float) -> None:
        """Move the tip over a place of the sample [m]; raise ValueError if the place is not finite or out of reach."""
        stage, centre = self.calibration.stage, self._centre
        if stage is None or centre is None or not max(abs(x_m), abs(y_m)) <= stage.reach_m:
            raise ValueError(f"lateral position {x_m}, {y_m} m must be finite and within the reach of the stage")
        self._place = centre[0] + x_m, centre[1] + y_m

    @property
    def safe_position_m(self) -> float:
        return self.calibration.base_m(self.calibration.z.retract_m)

    @property
    def heartbeat_s(self) -> float:
        """Return the silence after which the guard retracts [s]; 0 if a person stands by instead of a guard."""
        return 0.0 if self._attended else self.calibration.heartbeat_s

    def wanted_z_m(self) -> float:
        """Return the z to send now [m]: that of the safe state until the node's guard has retracted the tip too.

        Towards the sample it goes on from the z sent last, no faster than twice as fast as the guard lets the base go,
        whoever commands it: a tip that is found further away than its driver is asked to be does not jump.
        """
        if not self._released:
            return self.calibration.z.retract_m
        wanted_m, towards = self.calibration.z_m(self._base_m), self.calibration.z.towards_sample
        if not self._history:
            return self.calibration.z.retract_m
        sent_ns, sent_m = self._history[-1]
        reach_m = _SLEW * self._limits.base_speed_m_per_s * min(max(self._now_ns() - sent_ns, 0), _CYCLE_NS) * 1e-9
        return wanted_m if towards * (wanted_m - sent_m) <= reach_m else sent_m + towards * reach_m

    def begin_cycles(self, identity: str) -> None:
        """Mark the controller as identified, set up and retracted, so that cycles may begin."""
        self._model, self._ready_ns = identity, self._now_ns()
        self._come_up(identity)

    def refuse_without_guard(self) -> None:
        """Raise DeviceError, because nothing would retract the tip if this process died."""
        raise DeviceError(
            "has no guard in front of it, and would leave the tip where it is when this process dies: run `telenano"
            f" device guard {self.calibration.controller}` beside the controller and give its port, or give --attended"
            " (afm_node.attended: true) while a person stands by who can retract the tip"
        )

    def find_centre(self, x_m: float, y_m: float) -> None:
        """Set the place of the rig's 0, 0 from the calibration file or, without one, to the first place found [m]."""
        stage = self.calibration.stage
        if stage is not None and self._centre is None:
            self._centre = x_m if stage.x_m is None else stage.x_m, y_m if stage.y_m is None else stage.y_m
            self._place = self._centre

    def check_z(self, z_m: float, asked_ns: int) -> None:
        """Compare a reported z [m] with every z that was sent since two ticks before asked_ns [ns].

        Raises:
            DeviceError: Somebody else has moved the tip, or the driver has recorded no z that it sent.
        """
        since_ns = asked_ns - round((2.0 * self.tick_s + 4.0 * self._period_s) * 1e9)
        while len(self._history) > 1 and self._history[1][0] < since_ns:
            self._history.popleft()
        sent, tolerance_m = [value_m for _, value_m in self._history], self.calibration.z.tolerance_m
        if not sent:
            raise DeviceError(
                "compares z with the values that were sent, and has none: its talk appends each z to `_history` first"
            )
        if not min(sent) - tolerance_m <= z_m <= max(sent) + tolerance_m:
            raise DeviceError(
                f"another program has moved the tip: z is {z_m:.6g} m, and {sent[-1]:.6g} m was sent; the tip is"
                " retracted, and stays so until armed"
            )

    def take_sample(self, z_m: float, value: float, sampled_ns: int) -> None:
        """Store a sample of z [m] and the deflection's signal, taken at a time of the monotonic clock [ns].

        Raises:
            DeviceError: One of the values is not finite.
        """
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
