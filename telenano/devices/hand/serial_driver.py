"""The driver of a real handle: handle protocol 1 over a serial port, without waiting in a tick.

A tick writes one COMMAND and takes the bytes that have come; the answer to the command comes in the next tick or the
one after. `read` returns the newest sample, and the report its age. After a loss the driver begins again with identity,
limits and position.
"""

import contextlib
import math
import time
from collections.abc import Callable
from enum import Enum

from telenano.devices.hand import wire
from telenano.devices.hand.calibration import HandleCalibration
from telenano.devices.hand.port import OpenPort, Port, SerialPort
from telenano.devices.hand.sample_clock import RecentMinimum, SampleClock
from telenano.extend.hands import (
    MODE_FORCE,
    MODE_NAMES,
    MODE_OFF,
    MODE_POSITION,
    Capabilities,
    DeviceError,
    DeviceReading,
    DriveCommand,
    HapticReport,
    Status,
)
from telenano.sections.hand_section import LimitsConfig
from telenano.wire.errors import cause

_MS = 1_000_000
ASK_EVERY_NS = 100 * _MS
# A board that resets when its port is opened may spend two seconds in its boot loader.
HANDSHAKE_NS = 3000 * _MS
STALE_NS = 5 * _MS
LOST_NS = 50 * _MS
RETRY_NS = 500 * _MS
_NOTICE_NS = 1000 * _MS
_MOST_DROPPED = 50
_PERIOD_S = 1e-3
_SLOW_PERIODS = 2
_BITS_A_BYTE = 10
_COMMAND_BYTES = 20
_STATE_BYTES = 40
_SENT_KEPT = 256


class _Phase(Enum):
    CLOSED = 0
    ASKING = 1
    CONFIGURING = 2
    READY = 3


class SerialHandle:
    """A `HapticDevice` on a serial port.

    Args:
        path: The path of the port.
        baud: The rate of the port [baud].
        calibration: The calibration of this particular device; None to identify it only.
        limits: The limits, which the device also enforces itself.
        period_s: The period of the loop [s].
        open_port: The function that opens the port; a test replaces it.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: The function that waits; `open`, `identify` and `listen` call it.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        calibration: HandleCalibration | None,
        limits: LimitsConfig,
        *,
        period_s: float = _PERIOD_S,
        open_port: OpenPort = SerialPort,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.path = path
        self._period_s = period_s
        self.hello: wire.HandleHello | None = None
        # Number of the last session that was ready; it changes with each boot of the device.
        self._session: int | None = None
        self.state: wire.HandleState | None = None
        # Frame counters: dropped because the port was full, missing from the sequence, left out without a new sample.
        self.dropped = 0
        self.missed = 0
        self.repeated = 0
        self.reader = wire.FrameReader()
        self._modes: tuple[int, ...] = (MODE_OFF,)
        self._baud = baud
        self._calibration = calibration
        self._limits = None if calibration is None else calibration.device_limits(limits)
        self._open_port, self._now_ns, self._sleep = open_port, now_ns, sleep
        self._port: Port | None = None
        self._phase = _Phase.CLOSED
        self._clock = SampleClock()
        self._round_trips = RecentMinimum()
        # Half of the least round trip estimates the transit of a sample to the host, which one-way stamps cannot give.
        self._round_trip_ns = 0
        self._sent_at_ns = [0] * _SENT_KEPT
        self._seq = 0
        self._nonce = 0
        self._phase_began_ns = self._sent_ns = self._received_ns = self._sampled_ns = 0
        self._retry_ns = 0
        self._awaited_seq = -1
        # Whether the device has told its state since the port was opened, and that it was stopped meanwhile.
        self._has_told = self._was_stopped = False
        self._dropped_in_a_row = 0
        self._session_runs = False
        self._slow_since_ns = self._noticed_ns = 0
        self._errors_noticed = 0
        self._text = ""
        self._report = HapticReport("lost", 0.0, False, "the handle is not open")
        # The position has not been measured yet; it is not used before there is a sample.
        self._reading = DeviceReading(
            position_m=0.0,
            velocity_m_per_s=0.0,
            operator_force_n=0.0,
            operator_force_limited=False,
            motor_force_n=0.0,
            motor_voltage_v=0.0,
            end_stop=False,
            voltage_limited=False,
            torque_limited=False,
        )

    @property
    def capabilities(self) -> Capabilities:
        """Return the capabilities from the device's own report and the calibration; raise DeviceError before `open`."""
        if self.hello is None or self._calibration is None or self._limits is None:
            raise DeviceError(f"{self.path}: what the handle can do is known once it is open")
        flags, calibration = self.hello.flags, self._calibration
        ends = sorted(map(calibration.position_m, (self._limits.travel_min, self._limits.travel_max)))
        measured = flags & wire.HandleAbility.HAS_FORCE_SENSOR
        return Capabilities(
            max_force_n=min(calibration.max_force_n, calibration.force.saturation_n),
            max_stiffness_n_per_m=calibration.servo.stiffness_n_per_m,
            max_damping_n_s_per_m=calibration.servo.damping_n_s_per_m,
            workspace_min_m=ends[0],
            workspace_max_m=ends[1],
            modes=modes_of(self.hello),
            identity=self.hello.identity,
            force_source="sensor"
            if measured
            else "estimate"
            if flags & wire.HandleAbility.FORCE_IS_ESTIMATED
            else "none",
            latency_s=self._latency_s(calibration),
            calibration=calibration.identity,
        )

    def _latency_s(self, calibration: HandleCalibration) -> float:
        """Return the latency of the calibration [s], or else that of the protocol.

        A command waits for the device's next millisecond, and a sample for the next command, which asks for it: in all
        one period of the loop, for any phase between the two clocks. The device's servo holds its drive for a
        millisecond, which adds half of one in the mean; a simulated servo is continuous. The answer is read at the next
        tick, or after as many ticks as its bytes take.
        """
        if calibration.latency_s is not None:
            return calibration.latency_s
        on_line_s = (_COMMAND_BYTES + _STATE_BYTES) * _BITS_A_BYTE / self._baud
        return 0.5 * _PERIOD_S + self._period_s * (1.0 + math.ceil(on_line_s / self._period_s))

    @property
    def report(self) -> HapticReport:
        return self._report

    def open(self) -> None:
        """Connect and wait for the first sample, 3 s at most.

        Raises:
            DeviceError: The device is absent or another one; the message gives the one found and the one expected.
        """
        self._connect(self._now_ns())
        while self._phase is not _Phase.READY:
            self._sleep(_PERIOD_S)
            self._poll(self._now_ns())
            if self._phase is _Phase.CLOSED:
                raise DeviceError(self._text)
        self._judge(self._now_ns())

    def identify(self) -> wire.HandleHello:
        """Connect and return the device's HELLO (identity and abilities), without configuring it.

        Raises:
            DeviceError: No device answers.
        """
        self._connect(self._now_ns())
        while self.hello is None:
            self._sleep(_PERIOD_S)
            self._poll(self._now_ns())
            if self._phase is _Phase.CLOSED:
                raise DeviceError(self._text)
        return self.hello

    def listen(self, duration_s: float) -> list[wire.HandleState]:
        """Return the samples that an identified device sends unasked within duration_s [s]; no command is sent."""
        states: list[wire.HandleState] = []
        end_ns = self._now_ns() + round(duration_s * 1e9)
        while self._port is not None and self._now_ns() < end_ns:
            self._sleep(_PERIOD_S)
            states += [
                answer for answer in self.reader.answers(self._port.read()) if isinstance(answer, wire.HandleState)
            ]
        return states

    def close(self) -> None:
        """Switch the drive off until the next session and release the port; harmless when already closed."""
        self.make_safe()
        self._disconnect(self._now_ns())

    def make_safe(self) -> None:
        """Send STOP; if it does not arrive, the device's own watchdog switches the drive off."""
        if self._port is not None and self.hello is not None:
            # Errors are ignored: without a cable the watchdog has switched the drive off.
            with contextlib.suppress(Exception):
                self._port.write(wire.encode_stop(self._next_seq(), self.hello.session))

    def write(self, command: DriveCommand) -> None:
        """Send the command of this period if the device is ready; raise DeviceError for a mode that it lacks."""
        if self._phase is not _Phase.READY:
            return
        if command.mode not in self._modes:
            raise DeviceError(
                f"the handle at {self.path} cannot be driven in mode {MODE_NAMES.get(command.mode, command.mode)}"
            )
        self._send_command(command)

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        """Take the bytes that have come and return the newest sample; if the handle is lost, the last one again."""
        self._session_runs = session_time_s >= 0.0
        now_ns = self._now_ns()
        self._poll(now_ns)
        self._judge(now_ns)
        return self._reading

    def _connect(self, now_ns: int) -> None:
        self._port = self._open_port(self.path, self._baud)
        self.reader.reset()
        self.hello = None
        self._has_told, self._awaited_seq = False, -1
        self._clock, self._round_trips = SampleClock(), RecentMinimum()
        self._dropped_in_a_row = 0
        self._nonce = (self._nonce * 75 + 74 + now_ns) & 0xFFFF
        self._enter(_Phase.ASKING, now_ns)

    def _disconnect(self, now_ns: int) -> None:
        if self._port is not None:
            self._port.close()
        self._port = None
        self._phase = _Phase.CLOSED
        self._retry_ns = now_ns + RETRY_NS

    def _lose(self, now_ns: int, text: str) -> None:
        self._text = text
        self._disconnect(now_ns)

    def _enter(self, phase: _Phase, now_ns: int) -> None:
        self._phase, self._phase_began_ns = phase, now_ns
        self._sent_ns = now_ns - ASK_EVERY_NS

    def _poll(self, now_ns: int) -> None:
        """Take the bytes that have come and advance the phase; a loss is a state, and nothing is raised."""
        try:
            if self._port is None:
                if now_ns >= self._retry_ns:
                    self._retry_ns = now_ns + RETRY_NS
                    self._connect(now_ns)
                return
            received = self._port.read()
            for answer in self.reader.answers(received):
                self._on_answer(answer, now_ns)
                if self._port is None:
                    return
            if self._phase is _Phase.READY:
                if now_ns - self._received_ns > LOST_NS:
                    more = f", but for {self.repeated} frames with nothing new" if self.repeated else ""
                    self._lose(now_ns, f"{self.path}: the handle has been silent for {LOST_NS // _MS} ms{more}")
                elif (late_ns := self._unanswered_ns(now_ns)) > LOST_NS:
                    self._lose(now_ns, f"{self.path}: the handle answers commands of {late_ns / _MS:.0f} ms ago")
            else:
                self._continue_handshake(now_ns)
        except Exception as error:  # noqa: BLE001
            self._lose(now_ns, cause(error))

    def _continue_handshake(self, now_ns: int) -> None:
        if now_ns - self._phase_began_ns > HANDSHAKE_NS:
            what = "nothing answers" if self.hello is None else "the handle does not take its limits"
            bad = sum(self.reader.errors.values())
            self._lose(
                now_ns,
                f"{self.path}: {what} in handle protocol {wire.MAJOR} at {self._baud} baud for 3 s ({bad} bad frames): "
                "check device, firmware and baud rate",
            )
        elif now_ns - self._sent_ns >= ASK_EVERY_NS:
            self._sent_ns = now_ns
            if self.hello is None:
                self._send(wire.encode_ask(self._next_seq(), self._nonce))
            elif self._limits is not None and self._has_told:
                # The limits end a stop that the device has kept, so it has to be heard before.
                self._send(wire.encode_config(self._next_seq(), self.hello.session, self._limits))

    def _on_answer(self, answer: wire.Answer, now_ns: int) -> None:
        if isinstance(answer, wire.HandleHello):
            self._on_hello(answer, now_ns)
        elif isinstance(answer, wire.HandleState):
            self._on_state(answer, now_ns)
        elif isinstance(answer, wire.ConfigAnswer):
            self._on_configured(answer)
        elif answer.severity >= wire.SEVERITY_FATAL:
            self._lose(now_ns, f"{self.path}: the handle reports fault {answer.code}: {answer.text}")
        else:
            self._text = f"{self.path}: the handle reports fault {answer.code}: {answer.text}"

    def _on_hello(self, hello: wire.HandleHello, now_ns: int) -> None:
        if self._phase is not _Phase.ASKING or hello.nonce != self._nonce:
            return
        fault = refusal(hello, self._calibration, self._period_s)
        if fault:
            self._lose(now_ns, f"{self.path}: {fault}")
            return
        self.hello, self._modes = hello, modes_of(hello)
        self._enter(_Phase.CONFIGURING, now_ns)

    def _on_configured(self, answer: wire.ConfigAnswer) -> None:
        """Send the command `off`, with which every session begins; the sample answering it makes the device ready."""
        if self._phase is not _Phase.CONFIGURING or self.hello is None or answer.session != self.hello.session:
            return
        if answer.limits == self._limits:
            self._send_command(DriveCommand(MODE_OFF, 0.0, 0.0))
            self._awaited_seq = (self._seq - 1) & 0xFFFF

    def _on_state(self, state: wire.HandleState, now_ns: int) -> None:
        if self.hello is None:
            return
        if state.session != self.hello.session:
            # The reboot is reported with this loss, and not again when the device is ready.
            self._session = state.session
            self._lose(now_ns, f"{self.path}: {reset_text(self.hello.session, state.session)}")
            return
        if self._phase is _Phase.READY and self.state is not None and not _is_newer(state, self.state):
            # A repeated or out-of-order frame is no sign of life. A second frame of the same sample was counted as
            # missing by its number, which is corrected here.
            self.repeated += 1
            self.missed -= state.time_us == self.state.time_us and state.seq != self.state.seq
            return
        self._received_ns = now_ns
        if self._phase is _Phase.CONFIGURING:
            self._has_told = True
            self._was_stopped |= bool(state.flags & wire.HandleFlag.ESTOP_PRESSED)
            if not (state.flags & wire.HandleFlag.IS_CONFIGURED and state.command_seq == self._awaited_seq):
                return
            self._phase = _Phase.READY
            self._text = f"{self.path}: {self.hello.identity} is ready"
            # A board that was silent while it booted shows its new session here first, in its HELLO.
            if self._session not in (None, self.hello.session):
                self._text += f"; {reset_text(self._session, self.hello.session)}"
            self._session = self.hello.session
            if self._calibration is not None:
                self._text += f", calibration {self._calibration.identity}"
        elif self.state is not None:
            self.missed += (state.seq - self.state.seq - 1) & 0xFFFF
        if self.state is None or state.command_seq != self.state.command_seq:
            round_trip_ns = now_ns - self._sent_at_ns[state.command_seq % _SENT_KEPT]
            self._round_trip_ns = self._round_trips.least(round_trip_ns, now_ns)
        self.state = state
        self._sampled_ns = self._clock.host_ns(state.time_us, now_ns)
        if self._calibration is not None:
            self._reading = reading_of(state, self._calibration)

    def _unanswered_ns(self, now_ns: int) -> int:
        """Return the age [ns] of the oldest command that the newest sample does not acknowledge; 0 without one."""
        if self.state is None or (unanswered := (self.state.command_seq + 1) & 0xFFFF) == self._seq:
            return 0
        return now_ns - self._sent_at_ns[unanswered % _SENT_KEPT]

    def _judge(self, now_ns: int) -> None:
        """Renew the report."""
        age_s = (now_ns - self._sampled_ns + self._round_trip_ns // 2) * 1e-9 if self.state is not None else 0.0
        flags = self.state.flags if self.state is not None else 0
        status: Status = "ok"
        if self._phase is not _Phase.READY:
            status = "lost"
        elif self.state is not None and self.state.watchdog_tripped:
            status = "lost"
            self._text = f"{self.path}: the handle got no command for its watchdog's time and is off until it gets one"
        elif now_ns - self._received_ns > STALE_NS:
            status = "stale"
        self._notice(now_ns, age_s, status)
        counts = counts_of(self.state) if self.state is not None else {}
        stopped = self._was_stopped or bool(flags & wire.HandleFlag.ESTOP_PRESSED)
        self._report, self._was_stopped = HapticReport(status, age_s, stopped, self._text, counts), False

    def _notice(self, now_ns: int, age_s: float, status: Status) -> None:
        """Report lasting faults: samples that stay old (once), and bad frames (at most once a second)."""
        if age_s <= _SLOW_PERIODS * self._period_s or status == "lost":
            self._slow_since_ns = 0
        elif self._slow_since_ns == 0:
            self._slow_since_ns = now_ns
        elif self._slow_since_ns > 0 and now_ns - self._slow_since_ns > _NOTICE_NS:
            # The delay is not reported again until the samples are fresh again.
            self._slow_since_ns = -1
            self._text = (
                f"{self.path}: the samples of the handle have been {age_s * 1e3:.1f} ms old for a second: "
                "`telenano doctor` looks at the latency timer of the adapter; a hub or a busy machine does this too"
            )
        errors = sum(self.reader.errors.values())
        if errors > self._errors_noticed and now_ns - self._noticed_ns > _NOTICE_NS and status != "lost":
            self._errors_noticed, self._noticed_ns = errors, now_ns
            counted = ", ".join(f"{count} {kind}" for kind, count in self.reader.errors.items() if count)
            self._text = f"{self.path}: bad frames were dropped: {counted}"

    def _send_command(self, command: DriveCommand) -> None:
        if self.hello is None or self._calibration is None:
            return
        flags = wire.SESSION_RUNS if self._session_runs else 0
        position = self._calibration.position_raw(command.position_reference_m) if command.mode == MODE_POSITION else 0
        force = self._calibration.drive_raw(command.force_reference_n) if command.mode == MODE_FORCE else 0
        self._sent_at_ns[self._seq % _SENT_KEPT] = self._now_ns()
        frame = wire.encode_command(self._next_seq(), self.hello.session, flags, command.mode, position, force)
        try:
            self._send(frame)
        except Exception as error:  # noqa: BLE001
            self._lose(self._now_ns(), cause(error))

    def _send(self, frame: bytes) -> None:
        if self._port is None:
            return
        if self._port.write(frame):
            self._dropped_in_a_row = 0
            return
        self.dropped += 1
        self._dropped_in_a_row += 1
        if self._dropped_in_a_row >= _MOST_DROPPED:
            raise DeviceError(f"{self.path}: the handle takes no bytes: {_MOST_DROPPED} commands in a row were dropped")

    def _next_seq(self) -> int:
        seq, self._seq = self._seq, (self._seq + 1) & 0xFFFF
        return seq


def modes_of(hello: wire.HandleHello) -> tuple[int, ...]:
    """Return the modes of a device; every device has mode off."""
    bits = ((MODE_POSITION, wire.HandleAbility.HAS_POSITION_MODE), (MODE_FORCE, wire.HandleAbility.HAS_FORCE_MODE))
    return (MODE_OFF, *(mode for mode, bit in bits if hello.flags & bit))


def reset_text(before: int | None, session: int) -> str:
    """Return the message about a device that was reset, with the numbers of its sessions."""
    return f"the handle was reset: session {session}, not {before}"


def refusal(hello: wire.HandleHello, calibration: HandleCalibration | None, period_s: float) -> str:
    """Return why a device must not be driven with a calibration; empty if it may."""
    if not hello.is_understood:
        return f"the handle speaks protocol {hello.major}.{hello.minor}, {wire.MAJOR} is needed: flash its firmware"
    if calibration is None:
        return ""
    identity = f"{hello.device_id:016x}"
    if identity != calibration.device_id:
        return f"the handle is {identity}, and the calibration is that of {calibration.device_id}"
    if hello.max_rate_hz < round(1.0 / period_s):
        return f"the handle takes {hello.max_rate_hz} commands a second, {round(1.0 / period_s)} are needed"
    return ""


def _is_newer(state: wire.HandleState, before: wire.HandleState) -> bool:
    """Return whether `state` was taken and sent after `before`, by the device's number and time, which both wrap."""
    ahead, later_us = (state.seq - before.seq) & 0xFFFF, (state.time_us - before.time_us) & 0xFFFFFFFF
    return 0 < ahead < 1 << 15 and 0 < later_us < 1 << 31


def counts_of(state: wire.HandleState) -> dict[str, int]:
    """Return the raw counts of a sample, by the keys of haptic/state."""
    return {
        "position_raw": state.position,
        "velocity_raw": state.velocity_per_s,
        "operator_force_raw": state.force,
        "drive_raw": state.drive,
    }


def reading_of(state: wire.HandleState, calibration: HandleCalibration) -> DeviceReading:
    """Return a sample in SI units; motor_voltage_v is 0, because the protocol does not transmit it."""
    force_n = calibration.operator_force_n(state.force)
    saturated = bool(state.flags & wire.HandleFlag.FORCE_SATURATED) or abs(force_n) >= calibration.force.saturation_n
    return DeviceReading(
        position_m=calibration.position_m(state.position),
        velocity_m_per_s=calibration.velocity_m_per_s(state.velocity_per_s),
        operator_force_n=force_n,
        operator_force_limited=saturated,
        motor_force_n=calibration.drive_force_n(state.drive),
        motor_voltage_v=0.0,
        end_stop=bool(state.flags & (wire.HandleFlag.AT_MIN | wire.HandleFlag.AT_MAX)),
        voltage_limited=bool(state.flags & wire.HandleFlag.VOLTAGE_LIMITED),
        torque_limited=bool(state.flags & wire.HandleFlag.CURRENT_LIMITED),
    )
