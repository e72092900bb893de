"""The driver of a Nanonis controller as a slow AFM of the rig, over its TCP programming interface.

The driver sets z with the z-controller off, as float32 and without a ramp in the controller, so the guard of the node
decides its speed. The controller averages and publishes values every Tap, and the driver polls them without waiting: a
sample is up to a Tap old when it comes. With a TCP Logger, the driver reads its newer frames on a port of their own.
Before it sets z, it withdraws the tip, sets limits and safe tip of the controller, and reads them back, because the
controller does nothing by itself when a connection is lost.
"""

import math
import struct
from collections import deque
from collections.abc import Generator, Mapping
from typing import Any

import numpy as np

from telenano.devices import Line
from telenano.extend.instruments import DeviceError, OwnImage, OwnLine, SafetyParams
from telenano_devices.controllers.request_answer import LARGEST_BYTES, Incoming, Talk, WireError
from telenano_devices.controllers.request_driver import RequestDriver
from telenano_devices.nanonis import nanonis_wire
from telenano_devices.nanonis.nanonis_calibration import NanonisCalibration
from telenano_devices.nanonis.nanonis_wire import NanonisRefusalError

GUARD_COMMAND = "Telenano.Guard"
# The names of the signals of the scanner.
_Z_SIGNAL = "Z (m)"
_X_SIGNAL = "X (m)"
_Y_SIGNAL = "Y (m)"
# States of the z-controller that the driver acts on.
_OFF = 1
_ON = 2
_SAFE_TIP = 5
_STATES = {1: "is off", 2: "is on", 3: "holds", 4: "is being switched off", 6: "withdraws"}
# Largest number of questions for the end of a withdrawal, which takes the range over the rate.
_MOST_ASKED = 5000
_STATUS_EVERY = 10
# After an approach z is at rest when it moves by less than _REST_M over this number of looks.
_RESTS = 6
_REST_M = 2e-9
# Largest distance of the signal of a tip at rest from the set-point, as a share of it.
_NEAR_SHARE = 0.25
# Least time between two looks, and between two requests for lines of an image.
_LOOK_NS = 50_000_000
# Time limit of a request and its answer over a network and through the vendor's software.
_LOST_NS = 250_000_000
_LONGEST_TAP_S = 10.0
_SHIPPED_TAP_S = 20e-3
_LOG_HEADER = struct.Struct(">IfQH")
# State of the TCP Logger in a frame of samples.
_LOG_DATA = 4
# Largest number of signals in a frame of the TCP Logger.
_MOST_CHANNELS = 24
# Largest number of reads in a tick; a stream without an end after them is given up for this tick.
_MOST_RECEIVED = 64

Answers = Generator[bytes, bytes, list[Any]]


class NanonisAfm(RequestDriver[NanonisCalibration]):
    """An `AfmDriver` of a Nanonis controller; the arguments are those of `RequestDriver`."""

    lost_ns = _LOST_NS

    def __init__(self, calibration: NanonisCalibration, limits: SafetyParams, **options: Any) -> None:
        super().__init__(calibration, limits, nanonis_wire.cut, "Nanonis", **options)
        self._indexes: list[int] = []
        self._channels: dict[str, float] = {}
        # The wanted image, the image that was taken, its lines that `take_line` has not returned yet, and whether a
        # scan of this rig runs in the controller.
        self._image: OwnImage | None = None
        self._taken: OwnImage | None = None
        self._lines: deque[OwnLine] = deque()
        self._scans = False
        self._watched = 0
        self._logger = FrameLog(self._connect, calibration.network.host, calibration.logger_port)

    @property
    def latency_s(self) -> float:
        """Return the latency that the controller adds to the round trip [s]: mean time from a command to its sample.

        The answer comes after two periods and is used for two. A value is averaged over a Tap and published after it,
        and its publication is half a Tap old in the mean: together one Tap. Until the Tap is known, it is that of a
        controller as shipped, or zero if the file names a TCP Logger.
        """
        if self.calibration.latency_s is not None:
            return self.calibration.latency_s
        tap_s = self.tick_s or (0.0 if self.calibration.logger_port else _SHIPPED_TAP_S)
        return 2.5 * self._period_s + (0.0 if self._logger.port else tap_s)

    @property
    def channels(self) -> Mapping[str, float]:
        """Return the channels measured besides the deflection, by the names of the calibration, in SI units."""
        return self._channels

    @property
    def own_scan(self) -> "NanonisAfm":
        return self

    def want_image(self, image: OwnImage | None) -> None:
        """Begin an image, or continue it; None ends it and withdraws the tip."""
        if image is None or self._image is None:
            self._lines.clear()
            self._taken = None
        self._image = image

    def retract(self) -> bool:
        """End an image under way, and go to the safe position; see `TcpDriver.retract`."""
        self.want_image(None)
        return super().retract()

    def take_line(self) -> OwnLine | None:
        """Return the next complete line of the image, each once; None if there is none."""
        return self._lines.popleft() if self._lines else None

    def talk(self) -> Talk:
        """Return the requests: guard, signals, withdrawal of the tip, limits and safe tip; then cycles."""
        if not self._attended:
            yield from self._find_guard()
        names = (yield from self._ask("Signals.NamesGet"))[0]
        felt = self.calibration.channels
        wanted = [self.calibration.deflection.signal, _Z_SIGNAL, _X_SIGNAL, _Y_SIGNAL]
        wanted += [channel.signal for channel in felt.values()]
        if missing := [name for name in wanted if name not in names]:
            key = "deflection.signal" if missing[0] == wanted[0] else "the signal of each of channels"
            raise DeviceError(f"has no signal {missing[0]!r}: {key} must be one of its names")
        self._indexes = [names.index(name) for name in wanted]
        if self._scans:
            # A scan of this rig may have continued while the connection was lost.
            yield from self._ask("Scan.Action", 1, 1)
            self._scans = False
        if (yield from self._ask("Scan.StatusGet"))[0]:
            raise DeviceError("is scanning: end that in its own software first; it was not driven")
        yield from self._withdraw()
        yield from self._protect()
        self.tick_s = float((yield from self._ask("Util.AcqPeriodGet"))[0])
        if not 0.0 < self.tick_s <= _LONGEST_TAP_S:
            raise DeviceError(f"averages its values over {self.tick_s} s: set its Tap to {_LONGEST_TAP_S:g} s at most")
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
            if self._image is not None and self._image != self._taken:
                yield from self._take_image(self._image)
                continue
            yield from self._send_z(self.wanted_z_m())
            if self._place is not None and self._place != self._sent_place:
                self._sent_place = self._place
                yield from self._ask("FolMe.XYPosSet", *self._place, 0)
            yield from self._sample()
            count += 1
            if count % _STATUS_EVERY == 0:
                yield from self._check_status()

    def _find_guard(self) -> Generator[bytes, bytes, None]:
        answer = yield nanonis_wire.HEADER.pack(GUARD_COMMAND.encode(), 0, 1, 0)
        body = answer[nanonis_wire.HEADER.size :]
        # The answer is the number of its retractions and an error block without an error.
        if len(body) != 12 or any(body[4:]):
            self.refuse_without_guard()
        self.retractions = int(nanonis_wire.unpack("I", body)[0][0])

    def _ask(self, command: str, *arguments: Any) -> Answers:
        """Send a request and return the values of its answer; raise DeviceError if the controller refuses it."""
        try:
            return nanonis_wire.returned(command, (yield nanonis_wire.request(command, *arguments)))
        except NanonisRefusalError as error:
            raise DeviceError(f"refuses {command}{arguments or ''}: {error}") from None

    def _withdraw(self) -> Generator[bytes, bytes, None]:
        """Switch the z-controller off, withdraw to the upper limit, and wait until that is done.

        Raises:
            DeviceError: The safe tip is triggered, or the withdrawal does not end.
        """
        yield from self._ask("ZCtrl.Withdraw", 0, -1)
        for _ in range(_MOST_ASKED):
            status = (yield from self._ask("ZCtrl.StatusGet"))[0]
            if status == _OFF:
                return
            if status == _SAFE_TIP:
                raise DeviceError("its safe tip is still triggered: find out why its signal is beyond the threshold")
        raise DeviceError("has not withdrawn the tip: its z-controller is still on after 5000 requests")

    def _protect(self) -> Generator[bytes, bytes, None]:
        """Set limits of z, tip lift and safe tip, and read them back; raise DeviceError if they differ."""
        z = self.calibration.z
        yield from self._ask("ZCtrl.LimitsEnabledSet", 1)
        yield from self._ask("ZCtrl.LimitsSet", z.max_m, z.min_m)
        high_m, low_m = yield from self._ask("ZCtrl.LimitsGet")
        enabled = (yield from self._ask("ZCtrl.LimitsEnabledGet"))[0]
        if not enabled or abs(high_m - z.max_m) > z.tolerance_m or abs(low_m - z.min_m) > z.tolerance_m:
            raise DeviceError(f"kept other limits of z: {z.max_m}, {z.min_m} m were sent, {high_m}, {low_m} m read")
        yield from self._ask("ZCtrl.TipLiftSet", self.calibration.tip_lift_m)
        lift_m = (yield from self._ask("ZCtrl.TipLiftGet"))[0]
        if abs(lift_m - self.calibration.tip_lift_m) > z.tolerance_m:
            raise DeviceError(f"refuses a tip lift of {self.calibration.tip_lift_m:g} m: {lift_m:g} m was read")
        # The auto-recovery stays off, because it would switch the controller on again after a withdrawal.
        yield from self._ask("SafeTip.PropsSet", 0, 0, self.calibration.safe_tip)
        yield from self._ask("SafeTip.OnOffSet", 1)
        recovers, _, threshold = yield from self._ask("SafeTip.PropsGet")
        on = (yield from self._ask("SafeTip.OnOffGet"))[0]
        if not on or recovers or not math.isclose(threshold, self.calibration.safe_tip, rel_tol=1e-6):
            raise DeviceError(f"refuses the safe tip: on {on}, auto-recovery {recovers}, threshold {threshold:g} read")

    def _send_z(self, z_m: float) -> Generator[bytes, bytes, None]:
        self._history.append((self._now_ns(), z_m))
        yield from self._ask("ZCtrl.ZPosSet", z_m)

    def _take_image(self, wanted: OwnImage) -> Generator[bytes, bytes, None]:
        """Let the controller approach with its z-controller and scan; keep the lines, and withdraw at any end."""
        own = self.calibration
        volts = own.deflection.per_m * wanted.setpoint_n / own.cantilever.stiffness_n_per_m
        yield from self._ask("ZCtrl.SetpntSet", own.deflection.zero + volts)
        yield from self._ask("ZCtrl.OnOffSet", 1)
        past: deque[tuple[float, float]] = deque(maxlen=_RESTS)
        looked_ns = self._now_ns()
        while self._image == wanted and not _rests(past, own.deflection.zero + volts, abs(volts)):
            yield from self._watch_image()
            if self._now_ns() - looked_ns >= _LOOK_NS:
                looked_ns = self._now_ns()
                past.append(self._values)
        if self._image == wanted:
            yield from self._scan(wanted)
        if self._scans:
            yield from self._ask("Scan.Action", 1, 1)
            self._scans = False
        yield from self._withdraw()
        self._history.clear()
        yield from self._send_z(self.wanted_z_m())
        # The scan has moved the tip over the sample, so its place is sent again.
        self._sent_place, self._ready_ns, self._taken = None, self._now_ns(), wanted

    def _scan(self, wanted: OwnImage) -> Generator[bytes, bytes, None]:
        centre = self._centre or (0.0, 0.0)
        channel = self._indexes[1]
        sides = wanted.width_m, wanted.depth_m
        yield from self._ask("Scan.FrameSet", centre[0] + wanted.x_m, centre[1] + wanted.y_m, *sides, 0.0)
        yield from self._ask("Scan.BufferSet", [channel], wanted.pixels, wanted.lines)
        _, pixels, lines = yield from self._ask("Scan.BufferGet")
        if (pixels, lines) != (wanted.pixels, wanted.lines):
            raise DeviceError(f"takes {pixels} x {lines} pixels where {wanted.pixels} x {wanted.lines} were requested")
        speed = wanted.width_m / wanted.line_s
        yield from self._ask("Scan.SpeedSet", speed, speed, wanted.line_s, wanted.line_s, 2, 1.0)
        yield from self._ask("Scan.Action", 0, 1)
        self._scans, taken = True, 0
        every_ns = max(_LOOK_NS, round(wanted.line_s * 1e9))
        grabbed_ns = self._now_ns()
        while self._image == wanted and taken < 2 * wanted.lines:
            yield from self._watch_image()
            if self._now_ns() - grabbed_ns < every_ns:
                continue
            grabbed_ns = self._now_ns()
            # Check first for the cause of an ended scan, because its frames are then missing.
            yield from self._check_status(_ON)
            runs = (yield from self._ask("Scan.StatusGet"))[0]
            frames = []
            for forward in (1, 0):
                name, frame, _ = yield from self._ask("Scan.FrameDataGrab", channel, forward)
                if name != _Z_SIGNAL or frame.shape != (lines, pixels):
                    raise DeviceError(f"returned {name!r} of {frame.shape}, {_Z_SIGNAL!r} of {lines, pixels} was due")
                frames.append(frame)
            while taken < 2 * lines and np.isfinite(row := frames[taken % 2][taken // 2]).all():
                # A height counts away from the sample, so it is minus the base.
                height_m = np.array([0.0 - self.calibration.base_m(float(z_m)) for z_m in row])
                self._lines.append(OwnLine(taken // 2, taken % 2 == 1, height_m))
                taken += 1
            if not runs and taken < 2 * lines:
                raise DeviceError("somebody has stopped the scan; the tip is withdrawn, and stays so until armed")

    def _watch_image(self) -> Generator[bytes, bytes, None]:
        """Take a sample while the controller regulates, and check its state from time to time."""
        yield from self._sample(is_own=False)
        self._watched += 1
        if self._watched % _STATUS_EVERY == 0:
            yield from self._check_status(_ON)

    def _sample(self, *, is_own: bool = True) -> Generator[bytes, bytes, None]:
        if self._logger.port:
            now_ns = self._now_ns()
            frames = self._logger.newest()
            if frames is not None and len(frames) == len(self._indexes):
                self._take(frames, now_ns, 0.0, is_own=is_own)
            elif self._sampled_ns and now_ns - self._sampled_ns > _LOST_NS:
                raise DeviceError(f"its TCP Logger has sent no frame for {_LOST_NS // 1_000_000} ms")
            return
        asked_ns = self._now_ns()
        values = (yield from self._ask("Signals.ValsGet", self._indexes, 0))[0]
        if len(values) != len(self._indexes):
            raise DeviceError(f"answered {len(values)} values, {len(self._indexes)} were requested")
        self._take(values, asked_ns, self.tick_s, is_own=is_own)

    def _take(self, values: list[float], asked_ns: int, old_s: float, *, is_own: bool) -> None:
        """Store values that were at most old_s [s] old when requested; is_own: z has to be one that was sent."""
        value, z_m, x_m, y_m, *further = values
        channels = self.calibration.channels.items()
        self._channels = {name: each.si * reading for (name, each), reading in zip(channels, further, strict=True)}
        # Soon after the handshake a value may be older than it, so z is not compared yet.
        if is_own and asked_ns - self._ready_ns > round(3.0 * self.tick_s * 1e9):
            self.check_z(z_m, asked_ns)
        self.find_centre(x_m, y_m)
        self.take_sample(z_m, value, asked_ns - round(old_s * 1e9))

    def _check_status(self, wanted: int = _OFF) -> Generator[bytes, bytes, None]:
        status = (yield from self._ask("ZCtrl.StatusGet"))[0]
        if status == _SAFE_TIP:
            raise DeviceError("its safe tip was triggered and has withdrawn the tip; it stays retracted until armed")
        if status != wanted:
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


def _rests(past: deque[tuple[float, float]], setpoint: float, size: float) -> bool:
    """Return whether, over the last looks (z [m], signal), z stands still and the signal is near the set-point."""
    if len(past) < _RESTS:
        return False
    heights, values = zip(*past, strict=True)
    stands = bool(max(heights) - min(heights) <= _REST_M)
    return stands and bool(abs(sum(values) / _RESTS - setpoint) <= _NEAR_SHARE * size)


class FrameLog:
    """Receives the frames that a TCP Logger pushes.

    Args:
        connect: The function that connects to a host and port.
        host: The address of the controller.
        port: The port of the logger, None for none.
    """

    def __init__(self, connect: Any, host: str, port: int | None) -> None:
        self._connect, self._host, self._wanted = connect, host, port
        # The port of the started logger, 0 before.
        self.port = 0
        self._line: Line | None = None
        self._incoming = Incoming(cut_frame)
        # Number of the newest frame.
        self._number = -1

    def open(self) -> None:
        """Begin to connect; raise OSError if the connection is refused at once."""
        if self._line is not None:
            self._line.close()
        self._incoming, self._number = Incoming(cut_frame), -1
        self._line = self._connect(self._host, self._wanted)

    def newest(self) -> list[float] | None:
        """Return the values of the newest frame that has come, or None; raise OSError if the line is lost."""
        if self._line is None or not self._line.ready():
            return None
        newest_reading = None
        # Delayed frames come together, and the last of them is the newest.
        for _ in range(_MOST_RECEIVED):
            received = self._line.receive()
            self._incoming.add(received)
            while (frame := self._incoming.take()) is not None:
                channels, _, number, state = _LOG_HEADER.unpack_from(frame)
                # The first frame is no sample: it lists the signals of the columns. A repeated frame is none either.
                if state == _LOG_DATA and number > self._number:
                    self._number = number
                    newest_reading = list(struct.unpack_from(f">{channels}f", frame, _LOG_HEADER.size))
            if not received:
                return newest_reading
        return None


def cut_frame(stream: bytes) -> int:
    """Return the length of the first frame of a TCP Logger; see `request_answer.Cut`."""
    if len(stream) < _LOG_HEADER.size:
        return 0
    channels, _, _, state = _LOG_HEADER.unpack_from(stream)
    if channels > _MOST_CHANNELS or state > 7 or len(stream) > LARGEST_BYTES:
        raise WireError(f"{stream[:18]!r} is not the beginning of a frame of a TCP Logger")
    whole = _LOG_HEADER.size + 4 * int(channels)
    return whole if len(stream) >= whole else 0
