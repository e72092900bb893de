"""A model of a Nanonis controller and its TCP interface, with the simulated instrument behind it.

It follows the public clients and documentation (see `nanonis_wire`). Assumptions: a period of the real-time engine of
1 ms, values averaged and published every Tap of 20 ms, a z-controller that is an integral of the error, a `wait` that
is answered at once with the present values, and a safe tip that withdraws at the withdraw rate. z grows away from the
sample. As with the instrument, nothing happens when a connection is lost. The caller passes the time, so that a test
can run it in virtual time.
"""

import math
import struct
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from telenano.extend.instruments import AfmDriver
from telenano.extend.samples import AfmSample
from telenano_devices.controllers.request_answer import WireError
from telenano_devices.nanonis import nanonis_wire

PORTS = (6501, 6502, 6503, 6504)
LOG_PORT = 6590
TAP_S = 20e-3
STEP_NS = 1_000_000
# The indices of signals.
DEFLECTION = 8
Z = 30
X = 31
Y = 32
# Indices of the signals of channels besides the deflection, by the names of `felt`, in SI units.
CHANNELS = {"current": 40, "frequency_shift": 76, "amplitude": 77, "phase": 78}
RANGE_V = 10.0
_STEP_S = STEP_NS * 1e-9
_Z_MOST_M = 1.0e-6
# Force of the safe tip, above the limit of the node's guard, which acts first.
_SAFE_TIP_N = 384e-9
_XY_MOST_M = 5.0e-5
_NAMES = [f"Input {index + 1} (V)" for index in range(128)]
for _index, _name in ((DEFLECTION, "Deflection (V)"), (Z, "Z (m)"), (X, "X (m)"), (Y, "Y (m)")):
    _NAMES[_index] = _name
for _channel, _name in (
    ("current", "Current (A)"),
    ("frequency_shift", "OC M1 Freq. Shift (Hz)"),
    ("amplitude", "OC M1 Amplitude (m)"),
    ("phase", "OC M1 Phase (rad)"),
):
    _NAMES[CHANNELS[_channel]] = _name
OFF, ON, HOLD, SWITCHING_OFF, SAFE_TIP, WITHDRAWING = range(1, 7)
_LOG_HEADER = struct.Struct(">IfQH")
# The states of the TCP Logger. A first frame, which lists the signals, comes with _LOG_STARTS.
_LOG_STARTS = 2
_LOG_IDLE = 1
_LOG_RUNS = 4
# Largest number of frames that wait for a reader.
_MOST_LOGGED = 4096


class CommandRefusedError(Exception):
    """The controller refuses a command, which it answers with an error block."""


class NanonisModel:
    """The controller.

    Args:
        afm: The opened instrument.
        tap_s: The period with which values are published [s].
        now_ns: The time at which the controller begins [ns].
    """

    def __init__(self, afm: AfmDriver, *, tap_s: float = TAP_S, now_ns: int = 0) -> None:
        self._afm = afm
        self._stepped_ns, self._published_ns = now_ns, now_ns
        self.z_m, self.x_m, self.y_m = _Z_MOST_M, 0.0, 0.0
        self._target: tuple[float, float] | None = None
        self.status = OFF
        self._off_at_ns = 0
        self.trips = 0
        self._values: dict[str, list[Any]] = {
            "ZCtrl.Setpnt": [5e-3],
            "ZCtrl.Gain": [4.8e-8, 1e-3, 4.8e-5],
            "ZCtrl.LimitsEnabled": [0],
            "ZCtrl.Limits": [_Z_MOST_M, -_Z_MOST_M],
            "ZCtrl.TipLift": [0.0],
            "ZCtrl.SwitchOffDelay": [0.0],
            "ZCtrl.WithdrawRate": [1e-4],
            "FolMe.Speed": [2e-6, 1],
            "Scan.Frame": [0.0, 0.0, 1e-7, 1e-7, 0.0],
            "Scan.Buffer": [[Z, DEFLECTION], 64, 64],
            "Scan.Speed": [1e-7, 1e-7, 0.256, 0.256, 1, 1.0],
            "SafeTip.Props": [0, 0, 5.0],
            "Util.AcqPeriod": [tap_s],
        }
        self.safe_tip = False
        self.locked = ""
        self._scan: Scan | None = None
        self._sum_v, self._count = 0.0, 0
        self.log = Logger()
        self._bridge_v = 0.0
        # Base position that the external input adds, towards the sample [m].
        self._external_m = 0.0
        self._move_z(self.z_m)
        self._published = self._now_values()

    def pass_time(self, now_ns: int) -> None:
        """Make the steps of the real-time engine until now_ns [ns]."""
        while now_ns - self._stepped_ns >= STEP_NS:
            self._stepped_ns += STEP_NS
            self._step()

    def serve(self, frame: bytes, now_ns: int) -> bytes | None:
        """Return the answer to a request, or None if the request wants none."""
        self.pass_time(now_ns)
        asked = nanonis_wire.parse_request(frame)
        spelt = nanonis_wire.known(asked.command)
        lower = asked.command.lower()
        if spelt is None:
            module = asked.command.partition(".")[0]
            text = f"Error in command: {lower}: Cannot access the {module} module. \nPlease make sure it is running."
            answer = nanonis_wire.answer(asked.command, b"", text)
        else:
            layout, returns = nanonis_wire.COMMANDS[spelt]
            try:
                arguments, end = nanonis_wire.unpack(layout, asked.body)
                if end != len(asked.body):
                    raise CommandRefusedError("the body is longer than its arguments")
                values = self.respond(spelt, arguments)
                answer = nanonis_wire.answer(asked.command, nanonis_wire.pack(returns, values))
            except (CommandRefusedError, WireError) as error:
                # The return arguments are present, as zeros.
                answer = nanonis_wire.answer(asked.command, _zeros(returns), f"Error in command: {lower}: {error}")
        return answer if asked.answers else None

    def respond(self, command: str, arguments: list[Any]) -> list[Any]:
        """Carry out a command and return its values.

        Raises:
            CommandRefusedError: The controller refuses it.
        """
        if self.locked and not command.endswith("Get"):
            raise CommandRefusedError(self.locked)
        act: Callable[..., list[Any] | None] | None = getattr(self, "_" + command.replace(".", "_").lower(), None)
        if act is not None:
            return act(*arguments) or []
        name, kind = command[:-3], command[-3:]
        if kind == "Get":
            return list(self._values[name])
        self._values[name] = list(arguments)
        return []

    def _signals_namesget(self) -> list[Any]:
        return [_NAMES]

    def _signals_valget(self, index: int, wait: int) -> list[Any]:
        return self._signals_valsget([index], wait)[0]  # type: ignore[no-any-return]

    def _signals_valsget(self, indexes: list[int], wait: int) -> list[Any]:
        values = self._now_values() if wait else self._published
        if not all(0 <= index < len(_NAMES) for index in indexes):
            raise CommandRefusedError("The signal index is out of range.")
        return [[values.get(index, 0.0) for index in indexes]]

    def _signals_rangeget(self, index: int) -> list[Any]:
        most = {Z: _Z_MOST_M, X: _XY_MOST_M, Y: _XY_MOST_M}.get(index, RANGE_V)
        return [most, -most]

    def _zctrl_onoffset(self, on: int) -> None:
        if on:
            self.status = ON
        elif self.status in (ON, HOLD):
            self.status = SWITCHING_OFF
            self._off_at_ns = self._stepped_ns + round((2e-3 + self._values["ZCtrl.SwitchOffDelay"][0]) * 1e9)

    def _zctrl_onoffget(self) -> list[Any]:
        return [int(self.status in (ON, HOLD, SWITCHING_OFF))]

    def _zctrl_statusget(self) -> list[Any]:
        return [self.status]

    def _zctrl_zposset(self, z_m: float) -> None:
        if self.status not in (OFF, SAFE_TIP):
            raise CommandRefusedError("The Z-Controller must be off to set the Z position.")
        if self.status == SAFE_TIP and z_m < self.z_m:
            raise CommandRefusedError("The Safe Tip has been triggered.")
        self._move_z(z_m)

    def _zctrl_zposget(self) -> list[Any]:
        return [self.z_m]

    def _zctrl_limitsset(self, high_m: float, low_m: float) -> None:
        if not self._values["ZCtrl.LimitsEnabled"][0]:
            raise CommandRefusedError(
                "The limits cannot be applied because the limitation of the Z position is not enabled yet"
            )
        self._values["ZCtrl.Limits"] = [min(high_m, _Z_MOST_M), max(low_m, -_Z_MOST_M)]

    def _zctrl_withdraw(self, wait: int, timeout_ms: int) -> None:
        self._scan = None
        self._target = None
        self.status = WITHDRAWING

    def _folme_xyposset(self, x_m: float, y_m: float, wait: int) -> None:
        self._target = min(max(x_m, -_XY_MOST_M), _XY_MOST_M), min(max(y_m, -_XY_MOST_M), _XY_MOST_M)

    def _folme_xyposget(self, wait: int) -> list[Any]:
        return [self.x_m, self.y_m]

    def _folme_stop(self) -> None:
        self._target = None

    def _piezo_rangeget(self) -> list[Any]:
        return [2 * _XY_MOST_M, 2 * _XY_MOST_M, 2 * _Z_MOST_M]

    def _safetip_onoffset(self, mode: int) -> None:
        # On and off are set as 1 and 2, but read as 1 and 0.
        self.safe_tip = self.safe_tip if mode == 0 else mode == 1

    def _safetip_onoffget(self) -> list[Any]:
        return [int(self.safe_tip)]

    def _safetip_signalget(self) -> list[Any]:
        return [self._bridge_v]

    def _scan_bufferset(self, channels: list[int], pixels: int, lines: int) -> None:
        if not channels or not all(0 <= channel < len(_NAMES) for channel in channels):
            raise CommandRefusedError("The channels are out of range.")
        # Pixels are rounded down to packets of 16.
        self._values["Scan.Buffer"] = [channels, max(16, pixels // 16 * 16), min(max(lines, 1), 4096)]

    def _scan_action(self, action: int, up: int) -> None:
        if action == 0:
            channels, pixels, lines = self._values["Scan.Buffer"]
            speed = self._values["Scan.Speed"]
            self._scan = Scan(channels, pixels, lines, speed[2], speed[3], up=bool(up))
        elif self._scan is not None:
            self._scan.running = action == 3 or (self._scan.running and action not in (1, 2))

    def _scan_statusget(self) -> list[Any]:
        return [int(self._scan is not None and self._scan.running)]

    def _scan_framedatagrab(self, channel: int, forward: int) -> list[Any]:
        if self._scan is None or channel not in self._scan.frames:
            raise CommandRefusedError("There is no data of this channel.")
        return [_NAMES[channel], self._scan.frames[channel][0 if forward else 1], int(self._scan.up)]

    def _tcplog_chsset(self, channels: list[int]) -> None:
        self.log.channels = list(channels)

    def _tcplog_oversamplset(self, oversampling: int) -> None:
        self.log.oversampling = min(max(oversampling, 0), 1000)

    def _tcplog_start(self) -> None:
        self.log.start()

    def _tcplog_stop(self) -> None:
        self.log.state = _LOG_IDLE

    def _tcplog_statusget(self) -> list[Any]:
        return [self.log.state]

    def _step(self) -> None:
        if self._afm.simulation is not None:
            self._afm.simulation.elapse(_STEP_S)
            while self._afm.simulation.settle():
                pass
        self._move_over_sample()
        rate_m = self._values["ZCtrl.WithdrawRate"][0] * _STEP_S
        high_m = self._high_m()
        if self.status == SWITCHING_OFF and self._stepped_ns >= self._off_at_ns:
            self.status = OFF
            self._move_z(self.z_m + self._values["ZCtrl.TipLift"][0])
        if self.status in (WITHDRAWING, SAFE_TIP):
            self._move_z(min(self.z_m + rate_m, high_m))
            if self.z_m >= high_m and self.status == WITHDRAWING:
                self.status = OFF
        elif self.status in (ON, SWITCHING_OFF):
            error_v = self._values["ZCtrl.Setpnt"][0] - self._bridge_v
            self._move_z(self.z_m - self._values["ZCtrl.Gain"][2] * _STEP_S * error_v)
        else:
            self._move_z(self.z_m)
        if self.safe_tip and abs(self._bridge_v) > self._values["SafeTip.Props"][2] and self.status != SAFE_TIP:
            self.status, self._scan, self._target = SAFE_TIP, None, None
            self.trips += 1
        self._sum_v, self._count = self._sum_v + self._bridge_v, self._count + 1
        now = self._now_values()
        self.log.step(now)
        if (self._stepped_ns - self._published_ns) * 1e-9 >= self._values["Util.AcqPeriod"][0]:
            self._published = now | {DEFLECTION: self._sum_v / self._count}
            self._published_ns, self._sum_v, self._count = self._stepped_ns, 0.0, 0

    def _move_over_sample(self) -> None:
        if self._scan is not None and self._scan.running:
            dx, dy = self._scan.step(self._values["Scan.Frame"], self._now_values())
            self.x_m, self.y_m = dx, dy
        elif self._target is not None:
            reach_m = self._values["FolMe.Speed"][0] * _STEP_S
            way_m = math.hypot(self._target[0] - self.x_m, self._target[1] - self.y_m)
            share = 1.0 if way_m <= reach_m else reach_m / way_m
            if share == 1.0:
                (self.x_m, self.y_m), self._target = self._target, None
            else:
                self.x_m += (self._target[0] - self.x_m) * share
                self.y_m += (self._target[1] - self.y_m) * share
        if self._afm.stage is not None:
            self._afm.stage.move_to(self.x_m, self.y_m)

    def _high_m(self) -> float:
        return float(self._values["ZCtrl.Limits"][0]) if self._values["ZCtrl.LimitsEnabled"][0] else _Z_MOST_M

    def _move_z(self, z_m: float) -> None:
        low_m = self._values["ZCtrl.Limits"][1] if self._values["ZCtrl.LimitsEnabled"][0] else -_Z_MOST_M
        self.z_m = min(max(z_m, low_m), self._high_m())
        self._exchange()

    def _exchange(self) -> AfmSample:
        sample = self._afm.exchange(self._external_m - self.z_m)
        self._bridge_v = sample.bridge_voltage_v
        return sample

    def drive_external(self, base_m: float) -> AfmSample:
        """Add a base position [m] to that of the z piezo, as the external input does at once; return the sample."""
        self._external_m = base_m
        return self._exchange()

    def _now_values(self) -> dict[int, float]:
        measured = {CHANNELS[name]: value for name, value in getattr(self._afm, "channels", {}).items()}
        return {DEFLECTION: self._bridge_v, Z: self.z_m, X: self.x_m, Y: self.y_m} | measured


class ExternalInput:
    """The external input of a controller and the output of its deflection, as the plant behind the converters of a T7.

    Args:
        model: The controller.
    """

    def __init__(self, model: NanonisModel) -> None:
        self._model = model

    def exchange(self, base_m: float) -> AfmSample:
        return self._model.drive_external(base_m)


class Scan:
    """An image under way: its frames by channel, shape (2, lines, pixels), forward and backward; NaN where not scanned.

    Args:
        channels: The recorded channels.
        pixels: The number of pixels of a line.
        lines: The number of lines.
        forward_s: The time of a line forward [s].
        backward_s: The time of a line backward [s].
        up: Whether the scan goes upwards from the lower edge.
    """

    def __init__(
        self, channels: list[int], pixels: int, lines: int, forward_s: float, backward_s: float, *, up: bool
    ) -> None:
        self.frames = {channel: np.full((2, lines, pixels), np.nan, np.float32) for channel in channels}
        self._pixels, self._lines, self.up, self.running = pixels, lines, up, True
        self._line_s = max(forward_s, _STEP_S), max(backward_s, _STEP_S)
        self._line, self._way, self._elapsed_s = 0, 0, 0.0

    def step(self, frame: list[float], values: dict[int, float]) -> tuple[float, float]:
        """Record the values at the present pixel, advance by a step, and return x and y of the tip [m]."""
        share = min(self._elapsed_s / self._line_s[self._way], 1.0)
        along = share if self._way == 0 else 1.0 - share
        pixel = min(int(along * self._pixels), self._pixels - 1)
        row = self._line if self.up else self._lines - 1 - self._line
        for channel, kept in self.frames.items():
            kept[self._way, row, pixel] = values.get(channel, 0.0)
        self._elapsed_s += _STEP_S
        if self._elapsed_s >= self._line_s[self._way]:
            self._elapsed_s, self._way = 0.0, 1 - self._way
            self._line += self._way == 0
            self.running = self._line < self._lines
        centre_x, centre_y, width, height, angle = frame
        dx, dy = (along - 0.5) * width, ((row + 0.5) / self._lines - 0.5) * height
        turn = math.radians(angle)
        return (
            centre_x + dx * math.cos(turn) + dy * math.sin(turn),
            centre_y - dx * math.sin(turn) + dy * math.cos(turn),
        )


class Logger:
    """The TCP Logger: frames of some signals, pushed on a port of their own."""

    def __init__(self) -> None:
        self.channels: list[int] = []
        self.oversampling = 0
        self.state = _LOG_IDLE
        self._counter = self._skipped = 0
        self._frames: list[bytes] = []

    def start(self) -> None:
        """Begin; the first frame lists the signals of the columns."""
        self.state, self._counter, self._skipped = _LOG_RUNS, 0, 0
        self._frames = [self._frame(_LOG_STARTS, [float(channel) for channel in self.channels])]

    def step(self, values: dict[int, float]) -> None:
        """Append a frame if one is due; the oldest unread frames are dropped."""
        if self.state != _LOG_RUNS:
            return
        self._skipped += 1
        if self._skipped >= max(self.oversampling, 1):
            self._skipped = 0
            self._frames.append(self._frame(_LOG_RUNS, [values.get(channel, 0.0) for channel in self.channels]))
            self._counter += 1
            del self._frames[:-_MOST_LOGGED]

    def take(self) -> bytes:
        """Return the frames since the last call."""
        data, self._frames = b"".join(self._frames), []
        return data

    def _frame(self, state: int, values: list[float]) -> bytes:
        header = _LOG_HEADER.pack(len(values), float(self.oversampling), self._counter, state)
        return header + struct.pack(f">{len(values)}f", *values)


def _zeros(layout: str) -> bytes:
    empty: dict[str, Any] = {"s": "", "S": [], "M": np.zeros((0, 0))}
    values = [empty.get(letter, [] if letter[0] == "n" else 0) for letter in layout.split()]
    return nanonis_wire.pack(layout, values)


def calibration_of(
    volts_per_m: float, stiffness_n_per_m: float, host: str = "127.0.0.1", port: int = PORTS[0]
) -> dict[str, object]:
    """Return the content of a calibration file that fits the model exactly."""
    return {
        "schema": 1,
        "controller": "nanonis",
        "calibrated": datetime(2026, 1, 1, tzinfo=UTC),
        "network": {"host": host, "port": port},
        "z": {
            "towards_sample": -1,
            "rest_m": 0.0,
            "retract_m": 5.0e-7,
            "min_m": -4.0e-7,
            "max_m": 5.0e-7,
        },
        "stage": {"reach_m": 4.0e-5},
        "deflection": {"signal": "Deflection (V)", "zero": 0.0, "per_m": volts_per_m, "limit": RANGE_V},
        "cantilever": {"stiffness_n_per_m": stiffness_n_per_m},
        "safe_tip": _SAFE_TIP_N * volts_per_m / stiffness_n_per_m,
    }
