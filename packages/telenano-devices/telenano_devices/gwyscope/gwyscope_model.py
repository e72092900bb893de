"""A model of a Gwyscope server with the simulated instrument behind it: its answers, and its actions at each tick.

It follows the behaviour of the server (4.1.19, see `gwyscope_wire`): z of `set_feedback` acts at once, everything else
at the tick, which moves, regulates and samples. It refuses no value, ends on an item of a wrong type, keeps feedback
and z when a connection is lost, and sets z to 0 on its command to end. It lacks ramps, paths of a scan, streams and
generators, and answers these requests with "unknown". Two assumptions: a motion under way moves z to its own target of
z, and a feedback is an integral of the error. The caller passes the time, so that a test can run it in virtual time.
"""

import math
import random
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from telenano.extend.instruments import AfmDriver

VERSION = "4.1.19 (telenano's emulator)"
TICK_S = 3e-3
PORT = 51000
REST_M = 2.0e-6
CENTRE_M = 5.0e-5
RANGE_V = 10.0
_Z_MOST_M = 1.0e-5
_XY_MOST_M = 1.0e-4
_NS = 1_000_000_000
# The type of each item that is read from a request; another type ends the server.
_TYPES: dict[str, dict[str, Any]] = {
    "read": {},
    "stop": {},
    "set_feedback": dict.fromkeys(("feedback", "feedback_pll", "feedback_amplitude", "feedback_kpfm"), bool)
    | {"zpiezo": float},
    "move_to": dict.fromkeys(("xreq", "yreq", "zreq"), float),
    "set_scan": dict.fromkeys(("speed", "zspeed", "delay", "xslope", "yslope", "xsloperef", "ysloperef"), float)
    | {"subtract_slope": bool},
    "set": dict.fromkeys(("pid_p", "pid_i", "pid_d", "pid_setpoint"), float) | {"oversampling": int},
    "set_standby_storage": dict.fromkeys(("in1", "in2", "in3", "in4"), bool),
}
_FLAGS = ("moving", "scanning_line", "scanning_adaptive", "scanning_script", "ramp_running")


class AssertionOfTheServerError(Exception):
    """An item of a wrong type was read, which ends the server's process; feedback and z stay as they are."""


class GwyscopeModel:
    """The server.

    Args:
        afm: The opened instrument; z moves its base, and adc1 reads its bridge voltage.
        tick_s: The tick of the server [s].
        noise_v: The standard deviation of a sample of adc1 [V].
        now_ns: The time at which the server begins [ns].
    """

    def __init__(self, afm: AfmDriver, *, tick_s: float = TICK_S, noise_v: float = 0.0, now_ns: int = 0) -> None:
        self._afm, self._noise_v, self._random = afm, noise_v, random.Random(1)
        self._tick_ns = round(tick_s * _NS)
        self._begun_ns = self._ticked_ns = now_ns
        self.x_m = self.y_m = CENTRE_M
        self.z_m = 0.0
        self._target: tuple[float, float, float] | None = None
        self.values: dict[str, Any] = {
            **{name: False for name in _FLAGS},
            **dict.fromkeys(_TYPES["set_feedback"], False),
            **dict.fromkeys(_TYPES["set_standby_storage"], False),
            **dict.fromkeys(_TYPES["set_scan"], 0.0),
            **dict.fromkeys(_TYPES["set"], 0.0),
            "version": VERSION,
            "oversampling": 0,
            "subtract_slope": False,
            "speed": 1e-7,
            "zspeed": 5e-6,
        }
        self.stands = False
        self._bridge_v = 0.0
        self._move_z(0.0)
        self._sample: dict[str, float] = {}
        self._measure()

    def pass_time(self, now_ns: int) -> None:
        """Make the ticks that are due until now_ns [ns]; a server whose loop stands skips them."""
        while now_ns - self._ticked_ns >= self._tick_ns:
            self._ticked_ns += self._tick_ns
            if not self.stands:
                self._tick()

    def respond(self, message: Mapping[str, Any], now_ns: int) -> dict[str, Any]:
        """Return the answer to a request.

        Raises:
            AssertionOfTheServerError: An item has a type that the server does not expect.
        """
        self.pass_time(now_ns)
        todo = message.get("todo")
        if todo is None:
            return {"todo": "failed, no todo"}
        if todo == "get":
            return {"todo": todo} | {name: self._value(name) for name in message if name in self.values}
        types = _TYPES.get(todo)
        if types is None:
            return {"todo": "unknown"}
        for name, kind in types.items():
            if name in message and type(message[name]) is not kind:
                raise AssertionOfTheServerError(f"{todo}: {name} is a {type(message[name]).__name__}")
        if todo == "read":
            shown = [name for name in _TYPES["set_standby_storage"] if self.values[name]]
            return {"todo": todo} | self._sample | dict.fromkeys(shown, 0.0)
        if todo == "stop":
            self._target = None
            return {"todo": todo}
        self.values.update({name: message[name] for name in types if name in message})
        if todo == "set_feedback" and "zpiezo" in message and not self.values["feedback"]:
            self._move_z(message["zpiezo"])
        if todo == "move_to":
            self._target = tuple(message.get(name, 0.0) for name in types)
        echo = {name: self.values[name] for name in types if name in self.values}
        if todo == "set_feedback":
            echo["zpiezo"] = self.z_m
        return {"todo": todo} | echo

    def end(self) -> None:
        """Set z to 0, as the server does on its command to end."""
        self._move_z(0.0)

    def _value(self, name: str) -> Any:
        return self._target is not None if name == "moving" else self.values[name]

    def _tick(self) -> None:
        self._afm_elapses()
        if self._target is not None:
            self._continue(*self._target)
        if self.values["feedback"]:
            # The error is in volts, its integral in metres.
            error_v = self.values["pid_setpoint"] - self._bridge_v
            self._move_z(self.z_m + self.values["pid_i"] * error_v * self._tick_ns / _NS)
        self._measure()

    def _continue(self, x_m: float, y_m: float, z_m: float) -> None:
        tick_s = self._tick_ns / _NS
        reach_m, z_reach_m = self.values["speed"] * tick_s, self.values["zspeed"] * tick_s
        way_m = math.hypot(x_m - self.x_m, y_m - self.y_m)
        share = 1.0 if way_m <= reach_m else reach_m / way_m
        self.x_m += (x_m - self.x_m) * share
        self.y_m += (y_m - self.y_m) * share
        self._place()
        step_m = min(max(z_m - self.z_m, -z_reach_m), z_reach_m)
        self._move_z(self.z_m + step_m)
        if share == 1.0 and abs(z_m - self.z_m) <= 1e-12:
            self._target = None

    def _place(self) -> None:
        if self._afm.stage is not None:
            self._afm.stage.move_to(*(min(max(p, 0.0), _XY_MOST_M) - CENTRE_M for p in (self.x_m, self.y_m)))

    def _move_z(self, z_m: float) -> None:
        self.z_m = min(max(z_m, 0.0), _Z_MOST_M)
        self._bridge_v = self._afm.exchange(self.z_m - REST_M).bridge_voltage_v

    def _measure(self) -> None:
        self._bridge_v = self._afm.exchange(self.z_m - REST_M).bridge_voltage_v
        noisy = self._bridge_v + (self._random.gauss(0.0, self._noise_v) if self._noise_v else 0.0)
        adc1_v = min(max(noisy, -RANGE_V), RANGE_V)
        self._sample = {
            "x": self.x_m,
            "y": self.y_m,
            "z": self.z_m,
            "e": adc1_v - self.values["pid_setpoint"],
            "ts": (self._ticked_ns - self._begun_ns) / _NS,
            "adc1": adc1_v,
            "adc2": 0.0,
        }

    def _afm_elapses(self) -> None:
        if self._afm.simulation is not None:
            self._afm.simulation.elapse(self._tick_ns / _NS)
            while self._afm.simulation.settle():
                pass


def calibration_of(
    volts_per_m: float, stiffness_n_per_m: float, host: str = "127.0.0.1", port: int = PORT
) -> dict[str, object]:
    """Return the content of a calibration file that fits the model exactly."""
    return {
        "schema": 1,
        "controller": "gwyscope",
        "calibrated": datetime(2026, 1, 1, tzinfo=UTC),
        "network": {"host": host, "port": port},
        "z": {"towards_sample": 1, "rest_m": REST_M, "retract_m": 0.0, "min_m": 0.0, "max_m": _Z_MOST_M},
        "stage": {"reach_m": CENTRE_M},
        "deflection": {"signal": "adc1", "zero": 0.0, "per_m": volts_per_m, "limit": RANGE_V},
        "cantilever": {"stiffness_n_per_m": stiffness_n_per_m},
    }
