"""A Nanonis controller as a slow AFM of the rig, over its TCP programming interface.

z is set with the z-controller off, float32 and without a ramp of its own, so the guard of the node decides its speed.
Values are averaged and published every Tap, and polled without waiting: a sample is as old as a Tap when it comes.
Where the TCP Logger runs, its frames are read on a port of their own and are newer. Before z is set, the tip is
withdrawn, and limits and safe tip of the controller are set and read back, because nothing in it acts when a connection
is lost.
"""

import math
import struct
from collections.abc import Generator
from typing import Any

from services.afm_node.devices import nanonis_wire
from services.afm_node.devices.modbus_line import Line
from services.afm_node.devices.nanonis_wire import NanonisRefusalError
from services.afm_node.devices.piezo_calibration import ControllerCalibration
from services.afm_node.devices.request_answer import LARGEST_BYTES, Incoming, Talk, WireError
from services.afm_node.devices.request_driver import RequestDriver
from services.afm_node.driver import DeviceError
from services.afm_node.safety import SafetyParams

GUARD_COMMAND = "Telenano.Guard"
_Z_SIGNAL, _X_SIGNAL, _Y_SIGNAL = "Z (m)", "X (m)", "Y (m)"
_OFF, _SAFE_TIP = 1, 5
_STATES = {2: "is on", 3: "holds", 4: "is being switched off", 6: "withdraws"}
# a withdrawal takes the range over the rate; more than this many questions about it are not asked
_MOST_ASKED = 5000
_STATUS_EVERY = 10
# a request and its answer over a network and through the vendor's software
_LOST_NS = 250_000_000
_LOG_HEADER = struct.Struct(">IfQH")
_LOG_LIST, _LOG_DATA = 2, 4
_MOST_CHANNELS = 24

Answers = Generator[bytes, bytes, list[Any]]


class NanonisAfm(RequestDriver):
    """An `AfmDriver` on a Nanonis controller; arguments as of `RequestDriver`."""

    lost_ns = _LOST_NS

    def __init__(self, calibration: ControllerCalibration, limits: SafetyParams, **options: Any) -> None:
        super().__init__(calibration, limits, nanonis_wire.cut, "Nanonis", **options)
        self._indexes: list[int] = []
        self._logger = FrameLog(self._connect, calibration.network.host, calibration.logger_port)

    @property
    def latency_s(self) -> float:
        """Return what the controller adds to the round trip [s]: from a command to its sample, in the mean.

        The answer comes after two periods and is used for two; a value is averaged over a Tap and published after it,
        and waits for half of the next one in the mean.
        """
        if self.calibration.latency_s is not None:
            return self.calibration.latency_s
        return 2.5 * self._period_s + (0.0 if self._logger.port else self.tick_s)

    def talk(self) -> Talk:
        """Return the requests: who it is, tip withdrawn, limits and safe tip; then cycles."""
        if not self._attended:
            yield from self._find_guard()
        names = (yield from self._ask("Signals.NamesGet"))[0]
        wanted = [self.calibration.deflection.signal, _Z_SIGNAL, _X_SIGNAL, _Y_SIGNAL]
        if missing := [name for name in wanted if name not in names]:
            raise DeviceError(f"has no signal {missing[0]!r}: deflection.signal must be one of its names")
        self._indexes = [names.index(name) for name in wanted]
        if (yield from self._ask("Scan.StatusGet"))[0]:
            raise DeviceError("is scanning: end that in its own software first; it was not driven")
        yield from self._withdraw()
        yield from self._protect()
        self.tick_s = float((yield from self._ask("Util.AcqPeriodGet"))[0])
        if self.calibration.stage is not None:
            yield from self._ask("FolMe.SpeedSet", self.calibration.stage.speed_m_per_s, 1)
        self._history.clear()
        yield from self._send_z(self.calibration.z.retract_m)
        self._sent_place = None
        if self.calibration.logger_port is not None:
            yield from self._start_logger()
        source = "frames of its TCP Logger" if self._logger.port else f"values every {self.tick_s * 1e3:.3g} ms"
        self.begin_cycles(f"Nanonis, a slow instrument ({source}; what a hand feels is a model that these correct)")
        count = 0
        while True:
            yield from self._send_z(self.wanted_z_m())
            if self._place is not None and self._place != self._sent_place:
                self._sent_place = self._place
                yield from self._ask("FolMe.XYPosSet", *self._place, 0)
            yield from self._sample()
            count += 1
            if count % _STATUS_EVERY == 0:
                yield from self._check_status()

    def _find_guard(self) -> Generator[bytes, bytes, None]:
        found = yield nanonis_wire.HEADER.pack(GUARD_COMMAND.encode(), 0, 1, 0)
        body = found[nanonis_wire.HEADER.size :]
        # the number of its retractions, and the error block of no error
        if len(body) != 12 or any(body[4:]):
            self.refuse_without_guard()
        self.retractions = int(nanonis_wire.unpack("I", body)[0][0])

    def _ask(self, command: str, *arguments: Any) -> Answers:
        """Send a request and return its values; DeviceError where the controller refuses it."""
        try:
            return nanonis_wire.returned(command, (yield nanonis_wire.request(command, *arguments)))
        except NanonisRefusalError as error:
            raise DeviceError(f"refuses {command}{arguments or ''}: {error}") from None

    def _withdraw(self) -> Generator[bytes, bytes, None]:
        """Switch the z-controller off and go to the upper limit, and wait until that is done."""
        yield from self._ask("ZCtrl.Withdraw", 0, -1)
        for _ in range(_MOST_ASKED):
            status = (yield from self._ask("ZCtrl.StatusGet"))[0]
            if status == _OFF:
                return
            if status == _SAFE_TIP:
                raise DeviceError("its safe tip is triggered still: see why its signal is beyond the threshold")
        raise DeviceError("has not withdrawn the tip: its z-controller is not off after 5000 questions")

    def _protect(self) -> Generator[bytes, bytes, None]:
        """Set the limits of z and the safe tip, and read them back; DeviceError where they are others."""
        z = self.calibration.z
        yield from self._ask("ZCtrl.LimitsEnabledSet", 1)
        yield from self._ask("ZCtrl.LimitsSet", z.max_m, z.min_m)
        high_m, low_m = yield from self._ask("ZCtrl.LimitsGet")
        enabled = (yield from self._ask("ZCtrl.LimitsEnabledGet"))[0]
        if not enabled or abs(high_m - z.max_m) > z.tolerance_m or abs(low_m - z.min_m) > z.tolerance_m:
            raise DeviceError(f"refuses the limits of z: {z.max_m} m and {z.min_m} m were set, {high_m}, {low_m} read")
        # The auto-recovery stays off, because it would switch the controller on again after a withdrawal.
        yield from self._ask("SafeTip.PropsSet", 0, 0, self.calibration.safe_tip)
        yield from self._ask("SafeTip.OnOffSet", 1)
        recovers, _, threshold = yield from self._ask("SafeTip.PropsGet")
        on = (yield from self._ask("SafeTip.OnOffGet"))[0]
        if not on or recovers or not math.isclose(threshold, self.calibration.safe_tip or 0.0, rel_tol=1e-6):
            raise DeviceError(f"refuses the safe tip: on {on}, auto-recovery {recovers}, threshold {threshold:g} read")

    def _send_z(self, z_m: float) -> Generator[bytes, bytes, None]:
        self._history.append((self._now_ns(), z_m))
        yield from self._ask("ZCtrl.ZPosSet", z_m)

    def _sample(self) -> Generator[bytes, bytes, None]:
        if self._logger.port:
            now_ns = self._now_ns()
            frames = self._logger.newest()
            if frames is not None and len(frames) == len(self._indexes):
                self._take(frames, now_ns, 0.0)
            elif self._sampled_ns and now_ns - self._sampled_ns > _LOST_NS:
                raise DeviceError(f"its TCP Logger has sent no frame for {_LOST_NS // 1_000_000} ms")
            return
        asked_ns = self._now_ns()
        values = (yield from self._ask("Signals.ValsGet", self._indexes, 0))[0]
        if len(values) != len(self._indexes):
            raise DeviceError(f"answered {len(values)} values, {len(self._indexes)} were asked for")
        self._take(values, asked_ns, self.tick_s)

    def _take(self, values: list[float], asked_ns: int, old_s: float) -> None:
        """Take values that were old_s [s] old at most when they were asked for."""
        value, z_m, x_m, y_m = values
        # A value may be older than the handshake until a Tap has gone by since then.
        if asked_ns - self._ready_ns > round(3.0 * self.tick_s * 1e9):
            self.check_z(z_m, asked_ns)
        self.find_centre(x_m, y_m)
        self.take_sample(z_m, value, asked_ns - round(old_s * 1e9))

    def _check_status(self) -> Generator[bytes, bytes, None]:
        status = (yield from self._ask("ZCtrl.StatusGet"))[0]
        if status == _SAFE_TIP:
            raise DeviceError("its safe tip was triggered and has withdrawn the tip; it stays retracted until armed")
        if status != _OFF:
            raise DeviceError(
                f"somebody else works with it: its z-controller {_STATES.get(status, f'is in state {status}')}; the tip"
                " is withdrawn, and stays so until armed"
            )

    def _start_logger(self) -> Generator[bytes, bytes, None]:
        yield from self._ask("TCPLog.ChsSet", self._indexes)
        yield from self._ask("TCPLog.OversamplSet", 0)
        self._logger.open()
        yield from self._ask("TCPLog.Start")
        self._logger.port = self.calibration.logger_port or 0


class FrameLog:
    """The frames that a TCP Logger pushes.

    Args:
        connect: Connects to a port.
        host: The address of the controller.
        port: The port of the logger, None for none.
    """

    def __init__(self, connect: Any, host: str, port: int | None) -> None:
        self._connect, self._host, self._wanted = connect, host, port
        # 0 until it was started
        self.port = 0
        self._line: Line | None = None
        self._incoming = Incoming(cut_frame)

    def open(self) -> None:
        """Begin to connect; OSError where that is refused at once."""
        if self._line is not None:
            self._line.close()
        self._incoming = Incoming(cut_frame)
        self._line = self._connect(self._host, self._wanted)

    def newest(self) -> list[float] | None:
        """Return the values of the newest frame that has come, None where there is none; OSError for a lost line."""
        if self._line is None or not self._line.ready():
            return None
        self._incoming.add(self._line.receive())
        found = None
        while (frame := self._incoming.take()) is not None:
            channels, _, _, state = _LOG_HEADER.unpack_from(frame)
            # The first frame is no sample: it lists the signals of the columns.
            if state == _LOG_DATA:
                found = list(struct.unpack_from(f">{channels}f", frame, _LOG_HEADER.size))
        return found


def cut_frame(stream: bytes) -> int:
    """Return the length of the first frame of a TCP Logger; see `request_answer.Cut`."""
    if len(stream) < _LOG_HEADER.size:
        return 0
    channels, _, _, state = _LOG_HEADER.unpack_from(stream)
    if channels > _MOST_CHANNELS or state > 7 or len(stream) > LARGEST_BYTES:
        raise WireError(f"{stream[:18]!r} is not the beginning of a frame of a TCP Logger")
    whole = _LOG_HEADER.size + 4 * int(channels)
    return whole if len(stream) >= whole else 0
