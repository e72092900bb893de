"""The driver of a Gwyscope as the AFM of a rig: `set_feedback` sets z at once, `read` gets samples at its tick.

A cycle is two requests: one sends z and is answered with the state of the feedback, the other reads the newest sample.
The server samples at its own tick, 3 ms as shipped; a repeated time stamp is a repeated sample. The server does not
protect the tip: it refuses no value, has no watchdog, and keeps feedback and z when a connection is lost. So the driver
checks range and sign before it sends a message and compares the answer with it, and a guard (`telenano device guard`)
in front of the server retracts the tip when this process is silent.
"""

import math
from collections.abc import Generator
from itertools import pairwise
from typing import Any

from telenano.extend.instruments import DeviceError, SafetyParams
from telenano_devices.controllers.request_answer import Talk
from telenano_devices.controllers.request_driver import RequestDriver
from telenano_devices.gwyscope import gwyscope_wire
from telenano_devices.gwyscope.gwyscope_calibration import GwyscopeCalibration

GUARD_QUESTION = "telenano_guard"
_BUSY = ("scanning_line", "scanning_adaptive", "scanning_script", "ramp_running")
_FEEDBACKS = ("feedback", "feedback_pll", "feedback_amplitude", "feedback_kpfm")
# Number of steps between distinct samples from which the server's tick is measured.
_TICKS = 4
# Largest number of reads for measuring the tick.
_READS = 200
# A server whose samples do not advance for this time does not run its loop.
_CLOCK_STANDS_S = 0.05
_SLOWEST_TICK_S = 1.0
_SHIPPED_TICK_S = 3e-3
# A lateral motion also moves towards a z of its own, which must not disturb the z sent by `set_feedback`: this speed is
# so low that it never gets there.
_Z_SPEED_M_PER_S = 1e-12
_ALWAYS_READ = ("e", "adc1", "adc2")

Answers = Generator[bytes, bytes, dict[str, Any]]


class GwyscopeAfm(RequestDriver[GwyscopeCalibration]):
    """An `AfmDriver` of a Gwyscope server; the arguments are those of `RequestDriver`."""

    def __init__(self, calibration: GwyscopeCalibration, limits: SafetyParams, **options: Any) -> None:
        super().__init__(calibration, limits, gwyscope_wire.cut, "Gwyscope", **options)
        self._stamp_s = -math.inf
        self._stamp_ns = 0
        self._arrived = False

    @property
    def latency_s(self) -> float:
        """Return the latency that the controller adds to the round trip [s]: mean time from a command to its sample.

        The sample after a z comes after two periods and is used for two, 2.5 periods in the mean; and the server
        samples at its tick, half of which passes in the mean. Until the tick is measured, it is that of a server as
        shipped.
        """
        if self.calibration.latency_s is not None:
            return self.calibration.latency_s
        return 2.5 * self._period_s + 0.5 * (self.tick_s or _SHIPPED_TICK_S)

    def talk(self) -> Talk:
        """Return the requests: guard, version and activity, retraction of z, measurement of the tick; then cycles."""
        yield from self._find_guard()
        wanted = {"version": "", "moving": False} | dict.fromkeys(_BUSY, False)
        answer = yield from self._ask("get", **wanted)
        if busy := [name for name in _BUSY if answer.get(name)]:
            raise DeviceError(
                f"is busy ({', '.join(busy)}): end that in its own software first; the rig has not moved the tip, and"
                " it is where that software left it"
            )
        if answer.get("moving"):
            yield from self._ask("stop")
        self._history.clear()
        yield from self._send_z(self.calibration.z.retract_m)
        if self.calibration.stage is not None:
            speed = self.calibration.stage.speed_m_per_s
            yield from self._ask("set_scan", speed=speed, zspeed=_Z_SPEED_M_PER_S)
        # After a loss the tip is moved back to its place, while it is retracted.
        self._sent_place = None
        signal = self.calibration.deflection.signal
        if signal not in _ALWAYS_READ:
            yield from self._ask("set_standby_storage", **{signal: True})
        yield from self._measure_tick()
        self.begin_cycles(f"Gwyscope {answer.get('version', '')}, a sample every {self.tick_s * 1e3:.3g} ms")
        while True:
            yield from self._send_z(self.wanted_z_m())
            if self._place is not None and self._place != self._sent_place:
                yield from self._move(*self._place)
            self._check_place((yield from self._read()))

    def _find_guard(self) -> Generator[bytes, bytes, None]:
        if self._attended:
            return
        reply = yield gwyscope_wire.encode({"todo": GUARD_QUESTION, "heartbeat_s": self.calibration.heartbeat_s})
        answer = _items(reply)
        if answer.get("todo") != GUARD_QUESTION:
            self.refuse_without_guard()
        self.retractions = int(_number(answer, "trips"))

    def _ask(self, todo: str, **items: Any) -> Answers:
        """Send a request and return its answer; raise DeviceError if the server did not carry it out."""
        answer = _items((yield gwyscope_wire.encode({"todo": todo, **items})))
        reported = answer.get("todo")
        if reported != todo:
            raise DeviceError(f"did not carry out {todo}: it answered {reported!r}" + _sent_text(items))
        return answer

    def _send_z(self, z_m: float) -> Generator[bytes, bytes, None]:
        self._history.append((self._now_ns(), z_m))
        answer = yield from self._ask("set_feedback", feedback=False, zpiezo=float(z_m))
        on = [name for name in _FEEDBACKS if answer.get(name)]
        if on:
            raise DeviceError(f"cannot be driven: {', '.join(on)} stays on and controls z; switch it off there")
        found_m = _number(answer, "zpiezo")
        if not abs(found_m - z_m) <= self.calibration.z.tolerance_m:
            raise DeviceError(f"did not set z: {z_m:.6g} m was sent, and it reports {found_m:.6g} m")

    def _move(self, x_m: float, y_m: float) -> Generator[bytes, bytes, None]:
        self._sent_place, self._arrived = (x_m, y_m), False
        yield from self._ask("move_to", xreq=float(x_m), yreq=float(y_m), zreq=float(self._history[-1][1]))

    def _read(self) -> Answers:
        asked_ns = self._now_ns()
        answer = yield from self._ask("read")
        z_m, stamp_s = _number(answer, "z"), _number(answer, "ts")
        value = _number(answer, self.calibration.deflection.signal)
        if stamp_s != self._stamp_s:
            self._stamp_s, self._stamp_ns = stamp_s, asked_ns
            self.check_z(z_m, asked_ns)
            # When it is requested, the sample is at most one tick of the server old.
            self.take_sample(z_m, value, asked_ns - round(self.tick_s * 1e9))
        elif (asked_ns - self._stamp_ns) * 1e-9 > max(_CLOCK_STANDS_S, 4.0 * self.tick_s):
            raise DeviceError(f"its samples stopped at {stamp_s:.3f} s: the server answers, but its loop does not run")
        return answer

    def _check_place(self, answer: dict[str, Any]) -> None:
        """Compare the place with the one sent; raise DeviceError if the tip leaves it after it was reached."""
        stage, x_m, y_m = self.calibration.stage, _number(answer, "x"), _number(answer, "y")
        if self._centre is None:
            self.find_centre(x_m, y_m)
            # Without another place in the file the tip stays where it was found.
            self._sent_place = (x_m, y_m)
        if stage is None or self._sent_place is None:
            return
        off_m = math.hypot(x_m - self._sent_place[0], y_m - self._sent_place[1])
        if off_m <= stage.tolerance_m:
            self._arrived = True
        elif self._arrived:
            raise DeviceError(
                f"another program has moved the tip by {off_m:.3g} m over the sample; it is retracted and stays so"
                " until armed"
            )

    def _measure_tick(self) -> Generator[bytes, bytes, None]:
        """Measure the server's tick from the time stamps of reads; it cannot be resolved below a period of the loop."""
        self.tick_s = 0.0
        stamps: list[float] = []
        for _ in range(_READS):
            answer = yield from self._ask("read")
            stamp_s = _number(answer, "ts")
            if not stamps or stamp_s != stamps[-1]:
                stamps.append(stamp_s)
            if len(stamps) > _TICKS:
                break
        steps = [after - before for before, after in pairwise(stamps)]
        if len(steps) < _TICKS or not 0.0 < min(steps) < _SLOWEST_TICK_S:
            raise DeviceError("answers, but its samples do not advance: start the loop of the server")
        self.tick_s = min(steps)


def _items(frame: bytes) -> dict[str, Any]:
    """Return the texts, numbers and flags of an answer, without its arrays."""
    return {key: value for key, value in gwyscope_wire.decode(frame).items() if isinstance(value, str | int | float)}


def _number(answer: dict[str, Any], name: str) -> float:
    """Return a finite number of an answer by its name; raise DeviceError if the answer has none."""
    value = answer.get(name)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise DeviceError(f"answers {answer.get('todo')} without a number {name}: check the names in the calibration")
    return float(value)


def _sent_text(items: dict[str, Any]) -> str:
    shown = ", ".join(f"{name} = {value}" for name, value in items.items())
    return f" ({shown} was sent)" if shown else ""
