"""A real stage and deflection behind a Modbus instrument: one request out at a time, and no waiting in a tick.

A tick takes the answer if it is there, and then sends the next request if none is out. The handshake (identify, set up,
retract, read back) is a generator of requests that opening runs to its end, and a reconnection one step a tick.
"""

import errno
import select
import socket
import time
from collections.abc import Callable, Generator
from enum import Enum
from typing import Protocol

from services.afm_node.calibration import InstrumentCalibration
from services.afm_node.driver import DeviceError, DeviceReport
from services.afm_node.modbus_frames import Answer, Conversation, FramingError, Operation
from services.afm_node.register_map import Check, Register, RegisterMap, Setting, agrees
from services.afm_node.safety import SafetyParams
from services.afm_node.step import AfmSample

_MS = 1_000_000
STALE_CYCLES = 3
LOST_NS = 50 * _MS
RETRY_NS = 500 * _MS
# of a step of the handshake: a setting that goes to flash takes long
STEP_NS = 1000 * _MS
_PERIOD_S = 1e-3
_CLOSE_S = 0.1
_SAME_V = 2.0
_READ_BYTES = 4096
EXCEPTIONS = {
    1: "illegal function: the device does not know it",
    2: "illegal address: the device has no such register",
    3: "illegal value",
    4: "device failure; a coupler whose own watchdog has tripped answers this, with its outputs at 0",
    5: "acknowledged, busy",
    6: "busy",
    10: "gateway without a path: the gateway does not reach the device",
    11: "gateway target silent: the gateway does not reach the device",
}
_BUSY = (5, 6)

Handshake = Generator[bytes, Answer, None]


class Line(Protocol):
    """A connection that never waits; each method but `close` raises OSError when it is gone."""

    def ready(self) -> bool:
        """Return whether it is connected by now."""

    def send(self, request: bytes) -> None: ...

    def receive(self) -> bytes:
        """Return what has come, without waiting."""

    def close(self) -> None: ...


class TcpLine:
    """A TCP connection to a device, made without waiting for it."""

    def __init__(self, host: str, port: int) -> None:
        """Begin to connect. Raises OSError for a name that is not known."""
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        # a request is one small segment, and the next one waits for its answer
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        failed = self._socket.connect_ex(address)
        self._connected = failed == 0
        if failed not in (0, errno.EINPROGRESS):
            self._socket.close()
            raise OSError(failed, "cannot connect")

    def ready(self) -> bool:
        """Return whether it is connected by now."""
        if not self._connected and select.select([], [self._socket], [], 0)[1]:
            failed = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if failed:
                raise OSError(failed, errno.errorcode.get(failed, "cannot connect"))
            self._connected = True
        return self._connected

    def send(self, request: bytes) -> None:
        if self._socket.send(request) != len(request):
            raise OSError(errno.EAGAIN, "the device takes no more bytes")

    def receive(self) -> bytes:
        """Return what has come, without waiting."""
        try:
            received = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        if not received:
            raise OSError(errno.ECONNRESET, "the device has closed the connection")
        return received

    def close(self) -> None:
        self._socket.close()


class _Phase(Enum):
    CLOSED = 0
    CONNECTING = 1
    PREPARING = 2
    READY = 3


class ModbusAfm:
    """An `AfmDriver` on a Modbus instrument.

    Parameters: calibration, of this very device; registers, its map; limits of the node's guard; connect and now_ns
    (monotonic), which a test replaces; sleep, for `open`, `retract` and `close` alone.
    Raises DeviceError if calibration, limits and map do not fit together.
    """

    def __init__(
        self,
        calibration: InstrumentCalibration,
        registers: RegisterMap,
        limits: SafetyParams,
        *,
        connect: Callable[[str, int], Line] = TcpLine,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        faults = calibration.check(limits, registers)
        if faults:
            raise DeviceError("; ".join(faults))
        self.exchanges = 0
        self._calibration, self._map = calibration, registers
        self._where = f"{calibration.network.host}:{calibration.network.port}"
        self._limits = limits
        self._connect, self._now_ns, self._sleep = connect, now_ns, sleep
        stage, deflection = calibration.stage, calibration.deflection
        self._output = registers.output.of_channel(stage.dac)
        self._readback = registers.readback.of_channel(stage.dac)
        self._input = registers.input.of_channel(deflection.channel)
        self._line: Line | None = None
        self._conversation = Conversation(calibration.network.device_id)
        self._phase = _Phase.CLOSED
        self._handshake: Handshake | None = None
        self._outstanding = False
        self._requests: list[bytes] = []
        self._words: tuple[int, ...] = ()
        self._target_v = self._sent_v = stage.retract_v
        self._sent_ns = self._cycle_ns = self._answered_ns = self._sampled_ns = 0
        self._retry_ns = 0
        # after a (re)connection the base stays retracted until the guard has it there as well
        self._released = False
        self._opened = False
        self._text = ""
        self._identity = registers.model
        self._readings = calibration.readings(stage.retract_v, deflection.zero_v)
        self._report = DeviceReport("lost", 0.0, True, "the instrument is not open")

    @property
    def safe_position_m(self) -> float:
        return self._calibration.base_m(self._calibration.stage.retract_v)

    @property
    def stage(self) -> None:
        return None

    @property
    def report(self) -> DeviceReport:
        return self._report

    @property
    def identity(self) -> str:
        """Return who the device is, for a person; known once it is open."""
        return self._identity

    @property
    def input_v(self) -> float:
        """Return the voltage of the input in the newest sample [V]."""
        return self._readings.sample.bridge_voltage_v

    @property
    def latency_s(self) -> float:
        """Return what the device is declared to add to the age of a sample: its cycle and a period [s]."""
        return self._map.device_cycle_s + _PERIOD_S

    def open(self) -> None:
        """Connect, identify, set up, retract and take a first sample. Raises DeviceError with what was found."""
        self._opened = True
        self._begin(self._now_ns())
        while self._phase is not _Phase.READY or not self.exchanges:
            if self._phase is _Phase.CLOSED:
                raise DeviceError(self._text)
            self._sleep(_PERIOD_S)
            self._poll(self._now_ns())
        self._judge(self._now_ns())

    def exchange(self, base_m: float) -> AfmSample:
        """Apply a base position [m] and return the newest sample; `report` has its age and state."""
        if not abs(base_m) < float("inf"):
            raise ValueError(f"base position {base_m} m must be finite")
        if not self._opened:
            raise RuntimeError("the instrument is not open: call open() first")
        self._released |= self._phase is _Phase.READY and base_m <= self._limits.retract_position_m
        stage = self._calibration.stage
        self._target_v = self._calibration.voltage_v(base_m) if self._released else stage.retract_v
        now_ns = self._now_ns()
        self._poll(now_ns)
        self._judge(now_ns)
        return self._readings.sample

    def retract(self) -> None:
        """Go to the retract voltage at once, and wait 0.1 s at most for the output to be read back there."""
        if self._phase is not _Phase.READY:
            return
        self._released = False
        stage = self._calibration.stage
        self._target_v = self._sent_v = stage.retract_v
        until_ns, exchanges = self._now_ns() + round(_CLOSE_S * 1e9), self.exchanges
        while self._phase is _Phase.READY and self._now_ns() < until_ns:
            self._poll(self._now_ns())
            # the one that was out when this began says nothing of the retraction
            if self.exchanges >= exchanges + 2 and self._is_retracted(self._readings.sample.base_m):
                return
            self._sleep(_PERIOD_S)

    def close(self) -> None:
        """Retract and disconnect; harmless when already closed."""
        self.retract()
        self._drop(self._now_ns())
        self._opened = False

    def capture_state(self) -> object:
        """Raise TypeError: the state of a live device has no form in a journal."""
        raise TypeError("the state of a real instrument cannot be captured")

    def _begin(self, now_ns: int) -> None:
        self._retry_ns = now_ns + RETRY_NS
        self._conversation = Conversation(self._calibration.network.device_id)
        self._released = self._outstanding = False
        self._requests.clear()
        self.exchanges = 0
        try:
            self._line = self._connect(self._calibration.network.host, self._calibration.network.port)
        except OSError as error:
            self._lose(now_ns, f"cannot be reached: {error.strerror or error}")
            return
        self._phase, self._sent_ns = _Phase.CONNECTING, now_ns

    def _drop(self, now_ns: int) -> None:
        if self._line is not None:
            self._line.close()
        self._line, self._handshake = None, None
        self._phase = _Phase.CLOSED
        self._retry_ns = now_ns + RETRY_NS

    def _lose(self, now_ns: int, text: str) -> None:
        self._text = f"{self._where}: {self._map.model}: {text}"
        self._drop(now_ns)

    def _poll(self, now_ns: int) -> None:
        """Do what can be done now; nothing is raised, a loss is a state."""
        try:
            if self._line is None:
                if self._opened and now_ns >= self._retry_ns:
                    self._begin(now_ns)
                return
            if self._phase is _Phase.CONNECTING:
                self._go_on_connecting(now_ns, self._line)
                return
            answer = self._conversation.answer(self._line.receive()) if self._outstanding else None
            if self._phase is _Phase.PREPARING:
                self._prepare(now_ns, answer)
            else:
                self._cycle(now_ns, answer)
        except FramingError as error:
            self._lose(now_ns, str(error))
        except DeviceError as error:
            self._lose(now_ns, str(error))
        except OSError as error:
            self._lose(now_ns, f"the connection is gone: {error.strerror or error}")

    def _go_on_connecting(self, now_ns: int, line: Line) -> None:
        if line.ready():
            self._phase, self._handshake = _Phase.PREPARING, self._prepared()
            self._send(next(self._handshake), now_ns)
        elif now_ns - self._sent_ns > STEP_NS:
            raise DeviceError("does not answer: check address, cable and firewall")

    def _send(self, request: bytes, now_ns: int) -> None:
        if self._line is not None:
            self._line.send(request)
            self._outstanding, self._sent_ns = True, now_ns

    def _prepare(self, now_ns: int, answer: Answer | None) -> None:
        if answer is None or self._handshake is None:
            if now_ns - self._sent_ns > STEP_NS:
                raise DeviceError("is connected and does not answer requests: is it a Modbus TCP device?")
            return
        self._outstanding = False
        try:
            self._send(self._handshake.send(answer), now_ns)
        except StopIteration:
            self._phase = _Phase.READY
            self._handshake = None
            self._sent_v = self._calibration.stage.retract_v
            self._answered_ns = self._cycle_ns = self._sampled_ns = now_ns
            self._text = (
                f"{self._where}: {self._identity} is ready and retracted, calibration {self._calibration.identity}"
            )
            self._start_cycle(now_ns)

    def _prepared(self) -> Handshake:
        """Identify the device, set it up, retract it; DeviceError says what is wrong with it."""
        for check in self._map.checks:
            found = yield from self._read(check)
            if not agrees(found, check.value):
                raise DeviceError(_mismatch(check, found))
        serial = 0.0
        if self._map.serial is not None:
            serial = yield from self._read(self._map.serial)
            if round(serial) != self._calibration.instrument.serial:
                wanted = self._calibration.instrument.serial
                raise DeviceError(f"serial {serial:.0f} is not that of the calibration, {wanted}")
        self._identity = f"{self._map.model} {serial:.0f}" if serial else self._map.model
        if self._map.firmware is not None:
            firmware = yield from self._read(self._map.firmware)
            self._identity += f", firmware {firmware:.4f}"
        # first of all: whatever the output was at, it leaves the sample
        yield from self._write(self._output, self._calibration.stage.retract_v)
        for setting in self._map.settings:
            channel = self._calibration.deflection.channel
            yield from self._set(setting.model_copy(update={"address": setting.of_channel(channel).address}))
        yield from self._set_watchdog()
        retracted = yield from self._read(self._readback)
        if not self._is_retracted(self._calibration.base_m(retracted)):
            raise DeviceError(f"the output is at {retracted:.4f} V and not at the retract voltage")

    def _set_watchdog(self) -> Generator[bytes, Answer, None]:
        watchdog = self._map.watchdog
        if watchdog is None:
            return
        values = self._calibration.values
        differs = False
        for setting in watchdog.settings:
            found = yield from self._read(setting)
            differs |= not agrees(found, setting.wanted(values))
        enabled = yield from self._read(watchdog.enable)
        if not differs and agrees(enabled, 1.0):
            return
        yield from self._write(watchdog.enable, 0.0)
        for setting in watchdog.settings:
            yield from self._set(setting)
        yield from self._write(watchdog.enable, 1.0)

    def _set(self, setting: Setting) -> Generator[bytes, Answer, None]:
        """Write a setting where it differs, and read it back."""
        wanted = setting.wanted(self._calibration.values)
        found = yield from self._read(setting)
        if agrees(found, wanted):
            return
        yield from self._write(setting, wanted)
        found = yield from self._read(setting)
        if not agrees(found, wanted):
            raise DeviceError(f"{setting.name} was set to {wanted:g} and reads {found:g}")

    def _read(self, register: Register) -> Generator[bytes, Answer, float]:
        answer = yield self._conversation.read(register.address, register.count)
        _require(answer, register, register.count)
        return register.decode(answer.words, self._map.word_order)

    def _write(self, register: Register, value: float) -> Generator[bytes, Answer, None]:
        words = register.encode(value, self._map.word_order)
        answer = yield self._conversation.write(register.address, words)
        _require(answer, register, 0)

    def _cycle(self, now_ns: int, answer: Answer | None) -> None:
        if answer is not None:
            self._outstanding = False
            if answer.exception and answer.exception not in _BUSY:
                reason = EXCEPTIONS.get(answer.exception, f"exception {answer.exception}")
                raise DeviceError(f"{reason} ({self._output.name} = {self._sent_v:.4f} V was sent)")
            self._take(answer, now_ns)
        if now_ns - self._answered_ns > LOST_NS:
            raise DeviceError(f"has been silent for {LOST_NS // _MS} ms")
        if self._outstanding:
            return
        if self._requests:
            self._send(self._request(self._requests.pop(0)), now_ns)
        else:
            self._start_cycle(now_ns)

    def _take(self, answer: Answer, now_ns: int) -> None:
        """Take the words of an answer; with those of the last request of a cycle there is a sample."""
        if answer.exception:
            # busy: the cycle begins anew, and only the age decides
            self._requests.clear()
            self._words = ()
            return
        self._words += answer.words
        if self._requests:
            self._answered_ns = now_ns
            return
        words, self._words = self._words, ()
        output_v, input_v = self._voltages(words)
        self._readings = self._calibration.readings(output_v, input_v)
        self._answered_ns, self._sampled_ns = now_ns, self._cycle_ns
        self.exchanges += 1

    def _voltages(self, words: tuple[int, ...]) -> tuple[float, float]:
        readback, found = self._readback, self._input
        if self._map.exchange == "read_write":
            first, count = self._map.read_span(self._calibration.stage.dac, self._calibration.deflection.channel)
            at_input, at_readback = found.address - first, readback.address - first
        else:
            at_input, at_readback, count = 0, found.count, found.count + readback.count
        if len(words) != count:
            raise DeviceError(f"answered {len(words)} registers, {count} were asked for")
        order = self._map.word_order
        return (
            readback.decode(words[at_readback : at_readback + readback.count], order),
            found.decode(words[at_input : at_input + found.count], order),
        )

    def _start_cycle(self, now_ns: int) -> None:
        stage = self._calibration.stage
        reach = stage.slew_v_per_s * max(now_ns - self._cycle_ns, 0) * 1e-9
        self._sent_v = min(max(self._target_v, self._sent_v - reach), self._sent_v + reach)
        if self._target_v == stage.retract_v and not self._released:
            self._sent_v = stage.retract_v
        self._cycle_ns = now_ns
        self._words = ()
        words = self._output.encode(self._sent_v, self._map.word_order)
        write = Operation(self._output.address, len(words), words)
        reads = [Operation(part.address, part.count) for part in (self._input, self._readback)]
        if self._map.exchange == "feedback":
            self._send(self._conversation.feedback((write, *reads)), now_ns)
        elif self._map.exchange == "read_write":
            span = self._map.read_span(stage.dac, self._calibration.deflection.channel)
            self._send(self._conversation.read_write(Operation(*span), write), now_ns)
        else:
            self._requests = [bytes((index,)) for index in range(len(reads))]
            self._send(self._conversation.write(write.address, words), now_ns)

    def _request(self, which: bytes) -> bytes:
        part = (self._input, self._readback)[which[0]]
        return self._conversation.read(part.address, part.count)

    def _is_retracted(self, base_m: float) -> bool:
        """Return whether the output is at the retract voltage, to two steps of its converter."""
        step_m = _SAME_V * self._map.output_step_v * self._calibration.stage.m_per_v
        return abs(base_m - self.safe_position_m) <= step_m

    def _judge(self, now_ns: int) -> None:
        """Renew the report."""
        age_s = max(now_ns - self._sampled_ns, 0) * 1e-9 if self._sampled_ns else 0.0
        ready = self._phase is _Phase.READY
        # an exchange in the loop's time takes whole periods
        stale_s = STALE_CYCLES * (self._map.device_cycle_s + _PERIOD_S)
        status = DeviceReport("ok" if age_s <= stale_s else "stale", age_s, self._readings.in_range, self._text)
        self._report = status if ready else status._replace(status="lost", force_valid=True)


def _mismatch(check: Check, found: float) -> str:
    as_word = f" (0x{round(found):08X})" if check.type == "uint32" else ""
    hint = f": {check.hint}" if check.hint else ""
    return f"{check.name} reads {found:g}{as_word} and should read {check.value:g}{hint}; nothing was driven"


def _require(answer: Answer, register: Register, count: int) -> None:
    if answer.exception:
        reason = EXCEPTIONS.get(answer.exception, f"exception {answer.exception}")
        raise DeviceError(f"{register.name} (address {register.address}): {reason}")
    if len(answer.words) != count:
        raise DeviceError(f"{register.name} (address {register.address}) came back with {len(answer.words)} registers")
