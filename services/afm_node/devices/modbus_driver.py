"""A real stage and deflection behind a Modbus instrument: one request out at a time, and no waiting in a tick.

A tick takes the answer if it is there, and then sends the next request if none is out. The handshake (identify, set up,
retract, read back) is a generator of requests that opening runs to its end, and a reconnection one step a tick.
"""

import time
from collections.abc import Callable
from enum import Enum

from services.afm_node.devices import modbus_line
from services.afm_node.devices.converter_calibration import InstrumentCalibration
from services.afm_node.devices.modbus_frames import Answer, Conversation, FramingError, Operation
from services.afm_node.devices.modbus_handshake import EXCEPTIONS, Handshake, Steps, heartbeat_of, is_retracted
from services.afm_node.devices.modbus_line import Connect, Line, TcpConnector, go_on_connecting
from services.afm_node.devices.register_map import RegisterMap
from services.afm_node.driver import DeviceError, DeviceReport
from services.afm_node.physics.part import AfmSample
from services.afm_node.safety import SafetyParams

_MS = 1_000_000
STALE_CYCLES = 3
_PERIOD_S = 1e-3
_CLOSE_S, _RECONNECT_S = 0.1, 0.3
_BUSY = (5, 6)
_PAUSE_SHARE = 0.8
_MOST_BEATS = 65535


class _Phase(Enum):
    CLOSED = 0
    CONNECTING = 1
    PREPARING = 2
    READY = 3


class ModbusAfm:
    """An `AfmDriver` on a Modbus instrument.

    Args:
        calibration: The calibration of this very device.
        registers: The map of its registers.
        limits: The limits of the node's guard.
        connect: Connects to the device; a test replaces it.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: Waits in `open`, `retract` and `close`, and nowhere else.

    Raises:
        DeviceError: Calibration, limits and map do not fit together.
    """

    state = None

    def __init__(
        self,
        calibration: InstrumentCalibration,
        registers: RegisterMap,
        limits: SafetyParams,
        *,
        period_s: float = _PERIOD_S,
        connect: Connect | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        faults = calibration.check(limits, registers)
        if faults:
            raise DeviceError("; ".join(faults))
        self.exchanges = 0
        self._period_s = period_s
        self._calibration, self._map = calibration, registers
        self._where = f"{calibration.network.host}:{calibration.network.port}"
        self._limits = limits
        self._connect: Connect = TcpConnector() if connect is None else connect
        self._now_ns, self._sleep = now_ns, sleep
        stage, deflection = calibration.stage, calibration.deflection
        self._output = registers.output.of_channel(stage.dac)
        self._readback = registers.readback.of_channel(stage.dac)
        self._input = registers.input.of_channel(deflection.channel)
        self._line: Line | None = None
        self._conversation = Conversation(calibration.network.device_id)
        self._phase = _Phase.CLOSED
        self._handshake: Steps | None = None
        self._outstanding = False
        self._requests: list[bytes] = []
        self._words: tuple[int, ...] = ()
        self._target_v = self._sent_v = stage.retract_v
        self._sent_ns = self._cycle_ns = self._answered_ns = self._sampled_ns = 0
        self._retry_ns = self._begun_ns = 0
        # after a (re)connection the base stays retracted until the guard has it there as well
        self._released = False
        self._opened = False
        self._text = ""
        self._identity = registers.model
        self._readings = calibration.readings(stage.retract_v, deflection.zero_v)
        self._heart = heartbeat_of(calibration, registers)
        # The process assumes after less than its limit that the device has retracted, because the heartbeat needs time
        # as well.
        self._pause_ns = round(_PAUSE_SHARE * calibration.heartbeat_s * 1e9)
        self._beat = 0
        self._output_v = stage.retract_v
        # how often the script has retracted, None where none runs
        self.retractions: int | None = None if self._heart is None else 0
        self._report = DeviceReport("lost", 0.0, True, "the instrument is not open")

    @property
    def safe_position_m(self) -> float:
        return self._calibration.base_m(self._calibration.stage.retract_v)

    @property
    def stage(self) -> None:
        return None

    @property
    def vibration(self) -> None:
        return None

    @property
    def simulation(self) -> None:
        return None

    @property
    def relief(self) -> None:
        return None

    @property
    def report(self) -> DeviceReport:
        return self._report

    @property
    def identity(self) -> str:
        """Return who the device is, for a person; known once it is open."""
        return self._identity

    @property
    def calibration(self) -> InstrumentCalibration:
        return self._calibration

    @property
    def heartbeat_s(self) -> float:
        """Return the silence after which the script retracts [s]; 0 where none runs."""
        return 0.0 if self._heart is None else self._calibration.heartbeat_s

    @property
    def calibration_identity(self) -> str:
        return self._calibration.identity

    @property
    def input_v(self) -> float:
        """Return the voltage of the input in the newest sample [V]."""
        return self._readings.sample.bridge_voltage_v

    @property
    def late_answers(self) -> int:
        """Return how many answers were skipped on this connection: they were to requests before the one that is out."""
        return self._conversation.late

    @property
    def refused_answers(self) -> int:
        """Return how many answers of another unit or to another function came on this connection: none was taken."""
        return self._conversation.refused

    @property
    def latency_s(self) -> float:
        return self._calibration.declared_latency_s(self._map, self._period_s)

    def open(self) -> None:
        """Connect, identify, set up, retract and take a first sample.

        Raises:
            DeviceError: The device is absent or another one; the message says what was found.
        """
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

    def retract(self) -> bool:
        """Go to the retract voltage at once, on a new connection if need be; return whether it was read back there.

        Waits 0.1 s at most, and 0.3 s for a new connection.
        """
        if not self._opened:
            return False
        self._released = False
        stage = self._calibration.stage
        self._target_v = self._sent_v = stage.retract_v
        wait_s = _CLOSE_S
        if self._phase is not _Phase.READY:
            wait_s = _RECONNECT_S
            self._drop(self._now_ns())
            self._begin(self._now_ns())
        connected = self._line
        until_ns, exchanges = self._now_ns() + round(wait_s * 1e9), self.exchanges
        while self._line is connected is not None and self._now_ns() < until_ns:
            self._poll(self._now_ns())
            # The exchange that was under way at the beginning says nothing of the retraction.
            if self.exchanges >= exchanges + 2 and is_retracted(self._calibration, self._map, self._output_v):
                return True
            self._sleep(_PERIOD_S)
        return False

    def close(self) -> None:
        """Retract and disconnect; harmless when already closed."""
        if self._phase is _Phase.READY:
            self.retract()
        self._drop(self._now_ns())
        self._opened = False

    def _begin(self, now_ns: int) -> None:
        self._retry_ns = now_ns + modbus_line.RETRY_NS
        self._conversation = Conversation(self._calibration.network.device_id)
        self._released = self._outstanding = False
        self._requests.clear()
        self.exchanges = self._beat = 0
        try:
            self._line = self._connect(self._calibration.network.host, self._calibration.network.port)
        except OSError as error:
            self._lose(now_ns, f"cannot be reached: {error.strerror or error}")
            return
        self._phase, self._sent_ns, self._begun_ns = _Phase.CONNECTING, now_ns, now_ns

    def _drop(self, now_ns: int) -> None:
        if self._line is not None:
            self._line.close()
        self._line, self._handshake = None, None
        self._phase = _Phase.CLOSED
        self._retry_ns = now_ns + modbus_line.RETRY_NS

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
        ready, self._sent_ns = go_on_connecting(line, now_ns, self._begun_ns, self._sent_ns)
        if ready:
            self._preparation = Handshake(self._calibration, self._map, self._conversation, self._now_ns)
            self._phase, self._handshake = _Phase.PREPARING, self._preparation.steps()
            self._send(next(self._handshake), now_ns)

    def _send(self, request: bytes, now_ns: int) -> None:
        if self._line is not None:
            self._line.send(request)
            self._outstanding, self._sent_ns = True, now_ns

    def _prepare(self, now_ns: int, answer: Answer | None) -> None:
        if answer is None or self._handshake is None:
            if now_ns - self._sent_ns > modbus_line.STEP_NS:
                text = "is connected and does not answer requests: is it a Modbus TCP device?"
                raise DeviceError(text + self._conversation.refusals)
            return
        self._outstanding = False
        try:
            self._send(self._handshake.send(answer), now_ns)
        except StopIteration:
            self._phase = _Phase.READY
            self._handshake = None
            self._identity = self._preparation.identity
            if self.retractions is not None:
                self.retractions += self._preparation.trips
            self._sent_v = self._calibration.stage.retract_v
            self._answered_ns = self._cycle_ns = self._sampled_ns = now_ns
            self._text = (
                f"{self._where}: {self._identity} is ready and retracted, calibration {self._calibration.identity}"
            )
            self._start_cycle(now_ns)

    def _cycle(self, now_ns: int, answer: Answer | None) -> None:
        if answer is not None:
            self._outstanding = False
            if answer.exception and answer.exception not in _BUSY:
                reason = EXCEPTIONS.get(answer.exception, f"exception {answer.exception}")
                raise DeviceError(f"{reason} ({self._output.name} = {self._sent_v:.4f} V was sent)")
            self._take(answer, now_ns)
        if now_ns - self._answered_ns > modbus_line.LOST_NS:
            raise DeviceError(f"has been silent for {modbus_line.LOST_NS // _MS} ms{self._conversation.refusals}")
        if self._outstanding:
            return
        if self._requests:
            self._send(self._request(self._requests.pop(0)), now_ns)
        else:
            self._start_cycle(now_ns)

    def _take(self, answer: Answer, now_ns: int) -> None:
        """Take the words of an answer; with those of the last request of a cycle there is a sample."""
        if answer.exception:
            # The device is busy: the cycle begins anew, and only the age decides.
            self._requests.clear()
            self._words = ()
            return
        self._words += answer.words
        if self._requests:
            self._answered_ns = now_ns
            return
        words, self._words = self._words, ()
        self._output_v, input_v = self._voltages(words)
        self._readings = self._calibration.readings(self._output_v, input_v)
        self._answered_ns, self._sampled_ns = now_ns, self._cycle_ns
        self.exchanges += 1

    def _voltages(self, words: tuple[int, ...]) -> tuple[float, float]:
        readback, found = self._readback, self._input
        if self._map.exchange == "read_write":
            first, count = self._map.read_span(self._calibration.stage.dac, self._calibration.deflection.channel)
            at_input, at_readback = found.address - first, readback.address - first
        else:
            at_input, at_readback, count = 0, found.count, found.count + readback.count
        order = self._map.word_order
        if self._heart is not None:
            trips, words = words[count:], words[:count]
            if len(trips) == self._heart.trips.count and self._heart.trips.decode(trips, order):
                raise DeviceError("got no beat for too long, and its script has retracted the stage")
        if len(words) != count:
            raise DeviceError(f"answered {len(words)} registers, {count} were asked for")
        return (
            readback.decode(words[at_readback : at_readback + readback.count], order),
            found.decode(words[at_input : at_input + found.count], order),
        )

    def _start_cycle(self, now_ns: int) -> None:
        stage = self._calibration.stage
        if self._heart is not None and self._beat and now_ns - self._cycle_ns > self._pause_ns:
            raise DeviceError(
                f"had no request for {(now_ns - self._cycle_ns) / _MS:.0f} ms, and its script retracts after "
                f"{self._calibration.heartbeat_s * 1e3:.0f} ms"
            )
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
            if self._heart is not None:
                # While the guard keeps the base retracted, nobody drives it, and a pause of this process costs nothing
                # there, as before the loop.
                is_driven = self._sent_v > self._calibration.voltage_v(self._limits.retract_position_m)
                self._beat = self._beat % _MOST_BEATS + 1 if is_driven else 0
                beat = self._heart.beat.encode(float(self._beat), self._map.word_order)
                reads = [Operation(self._heart.beat.address, len(beat), beat), *reads]
                reads.append(Operation(self._heart.trips.address, self._heart.trips.count))
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

    def _judge(self, now_ns: int) -> None:
        """Renew the report."""
        age_s = max(now_ns - self._sampled_ns, 0) * 1e-9 if self._sampled_ns else 0.0
        ready = self._phase is _Phase.READY
        # an exchange in the loop's time takes whole periods
        stale_s = STALE_CYCLES * (self._map.device_cycle_s + self._period_s)
        volts = self._output_v, self._readings.sample.bridge_voltage_v
        status = DeviceReport("ok" if age_s <= stale_s else "stale", age_s, self._readings.in_range, self._text, *volts)
        self._report = status if ready else status._replace(status="lost", force_valid=True)
