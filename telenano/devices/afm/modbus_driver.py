"""The driver of a real stage and deflection behind a Modbus instrument: one request at a time, no waiting in a tick.

A tick takes the answer if it has come, and then sends the next request if none is outstanding. The handshake (identify,
retract, set up, read back) is a generator of requests: `open` runs it to its end, a reconnection one step a tick.
"""

from typing import Any, Self

from telenano.devices.afm import modbus_line
from telenano.devices.afm.converter_calibration import InstrumentCalibration
from telenano.devices.afm.modbus_frames import Answer, Conversation, Operation
from telenano.devices.afm.modbus_handshake import EXCEPTIONS, Handshake, heartbeat_of, is_retracted
from telenano.devices.afm.modbus_line import Line
from telenano.devices.afm.register_map import RegisterMap, read_map
from telenano.devices.afm.tcp_driver import TcpDriver
from telenano.extend.instruments import AfmReport, DeviceError, SafetyParams

_MS = 1_000_000
_BUSY = (5, 6)
_PAUSE_SHARE = 0.8
_MOST_BEATS = 65535


class ModbusAfm(TcpDriver[InstrumentCalibration]):
    """An `AfmDriver` on a Modbus instrument.

    Args:
        calibration: The calibration of this particular device.
        registers: The map of its registers.
        limits: The limits of the node's guard.
        options: Keyword arguments of `TcpDriver`.

    Raises:
        DeviceError: Calibration, limits and map do not fit together.
    """

    stage = None

    def __init__(
        self, calibration: InstrumentCalibration, registers: RegisterMap, limits: SafetyParams, **options: Any
    ) -> None:
        faults = calibration.check(limits, registers)
        if faults:
            raise DeviceError("; ".join(faults))
        stage, deflection = calibration.stage, calibration.deflection
        readings = calibration.readings(stage.retract_v, deflection.zero_v)
        super().__init__(calibration, limits, registers.model, readings, **options)
        self._map = registers
        self._output = registers.output.of_channel(stage.dac)
        self._readback = registers.readback.of_channel(stage.dac)
        self._input = registers.input.of_channel(deflection.channel)
        self._conversation = Conversation(calibration.network.device_id)
        self._outstanding = False
        self._requests: list[bytes] = []
        self._words: tuple[int, ...] = ()
        self._target_v = self._sent_v = stage.retract_v
        self._cycle_ns = self._answered_ns = 0
        # The number of exchanges on this connection when the base was last commanded to retract.
        self._retract_sent_at = 0
        self._identity = registers.model
        self._heart = heartbeat_of(calibration, registers)
        # The process assumes earlier than the limit that the device has retracted, because the heartbeat also takes
        # time to arrive.
        self._pause_ns = round(_PAUSE_SHARE * calibration.heartbeat_s * 1e9)
        self._beat = 0
        self._output_v = stage.retract_v
        self.retractions = None if self._heart is None else 0

    @classmethod
    def of(cls, calibration: InstrumentCalibration, limits: SafetyParams, **options: Any) -> Self:
        """Return the driver with the map of registers that the calibration names: `ModbusAfm.of(calibration, limits)`.

        Raises:
            ConfigError: There is no such map.
            DeviceError: Calibration, limits and map do not fit together.
        """
        return cls(calibration, read_map(calibration.instrument.map), limits, **options)

    @property
    def registers(self) -> RegisterMap:
        """Return the map of the registers."""
        return self._map

    @property
    def safe_position_m(self) -> float:
        return self.calibration.base_m(self.calibration.stage.retract_v)

    @property
    def identity(self) -> str:
        """Return model, serial number and firmware for a person; known once the device is open."""
        return self._identity

    @property
    def heartbeat_s(self) -> float:
        """Return the silence after which the script on the device retracts [s]; 0 if none runs."""
        return 0.0 if self._heart is None else self.calibration.heartbeat_s

    @property
    def input_v(self) -> float:
        """Return the voltage of the input in the newest sample [V]."""
        return self._readings.sample.bridge_voltage_v

    @property
    def late_answers(self) -> int:
        """Return the number of answers skipped on this connection because they belonged to an earlier request."""
        return self._conversation.late

    @property
    def refused_answers(self) -> int:
        """Return the number of answers of another unit or to another function on this connection; all were dropped."""
        return self._conversation.refused

    @property
    def latency_s(self) -> float:
        return self.calibration.declared_latency_s(self._map, self._period_s)

    def _restart(self) -> None:
        self._conversation = Conversation(self.calibration.network.device_id)
        self._outstanding = False
        self._requests.clear()
        self._beat = self._safe_wanted_at = 0

    def _want(self, base_m: float) -> None:
        self._target_v = self.calibration.voltage_v(base_m) if self._released else self.calibration.stage.retract_v

    def _want_safe(self) -> None:
        self._target_v = self._sent_v = self.calibration.stage.retract_v
        self._safe_wanted_at = self.exchanges

    def _is_safe(self) -> bool:
        return self.exchanges >= self._safe_wanted_at + 2 and is_retracted(self.calibration, self._map, self._output_v)

    def _begin_talk(self, now_ns: int, line: Line) -> None:
        self._preparation = Handshake(self.calibration, self._map, self._conversation, self._now_ns)
        self._talk = self._preparation.steps()
        self._send(next(self._talk), now_ns)

    def _continue_exchange(self, now_ns: int, line: Line, talk: Any) -> None:
        answer = self._conversation.answer(line.receive()) if self._outstanding else None
        if self._ready:
            self._cycle(now_ns, answer)
        else:
            self._prepare(now_ns, answer, talk)

    def _send(self, request: bytes, now_ns: int) -> None:
        if self._line is not None:
            self._line.send(request)
            self._outstanding, self._sent_ns = True, now_ns

    def _prepare(self, now_ns: int, answer: Answer | None, talk: Any) -> None:
        if answer is None:
            if now_ns - self._sent_ns > modbus_line.STEP_NS:
                text = "is connected and does not answer requests: is it a Modbus TCP device?"
                raise DeviceError(text + self._conversation.refusals)
            return
        self._outstanding = False
        try:
            self._send(talk.send(answer), now_ns)
        except StopIteration:
            self._talk = None
            self._identity = self._preparation.identity
            if self.retractions is not None:
                self.retractions += self._preparation.trips
            self._sent_v = self.calibration.stage.retract_v
            # The sample from before a loss remains the newest one, and old, until this connection has given another.
            self._answered_ns = self._cycle_ns = now_ns
            self._come_up(self._identity)
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
        """Store the words of an answer; those of the last request of a cycle complete a sample."""
        if answer.exception:
            # The device is busy: the cycle begins again, and only the age of the sample decides about a loss.
            self._requests.clear()
            self._words = ()
            return
        self._words += answer.words
        if self._requests:
            self._answered_ns = now_ns
            return
        words, self._words = self._words, ()
        self._output_v, input_v = self._voltages(words)
        self._readings = self.calibration.readings(self._output_v, input_v)
        self._answered_ns, self._sampled_ns = now_ns, self._cycle_ns
        self.exchanges += 1

    def _voltages(self, words: tuple[int, ...]) -> tuple[float, float]:
        readback, input_raw = self._readback, self._input
        if self._map.exchange == "read_write":
            first, count = self._map.read_span(self.calibration.stage.dac, self.calibration.deflection.channel)
            at_input, at_readback = input_raw.address - first, readback.address - first
        else:
            at_input, at_readback, count = 0, input_raw.count, input_raw.count + readback.count
        order = self._map.word_order
        if self._heart is not None:
            trips, words = words[count:], words[:count]
            if len(trips) == self._heart.trips.count and self._heart.trips.decode(trips, order):
                raise DeviceError("received no heartbeat in time, and its script has retracted the stage")
        if len(words) != count:
            raise DeviceError(f"answered {len(words)} registers, {count} were requested")
        return (
            readback.decode(words[at_readback : at_readback + readback.count], order),
            input_raw.decode(words[at_input : at_input + input_raw.count], order),
        )

    def _start_cycle(self, now_ns: int) -> None:
        stage = self.calibration.stage
        if self._heart is not None and self._beat and now_ns - self._cycle_ns > self._pause_ns:
            raise DeviceError(
                f"had no request for {(now_ns - self._cycle_ns) / _MS:.0f} ms, and its script retracts after "
                f"{self.calibration.heartbeat_s * 1e3:.0f} ms"
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
                # While the guard keeps the base retracted, beat 0 says that nothing drives it: a pause of this process
                # is then harmless, as it is before the loop.
                is_driven = self._sent_v > self.calibration.voltage_v(self._limits.retract_position_m)
                self._beat = self._beat % _MOST_BEATS + 1 if is_driven else 0
                beat = self._heart.beat.encode(float(self._beat), self._map.word_order)
                reads = [Operation(self._heart.beat.address, len(beat), beat), *reads]
                reads.append(Operation(self._heart.trips.address, self._heart.trips.count))
            self._send(self._conversation.feedback((write, *reads)), now_ns)
        elif self._map.exchange == "read_write":
            span = self._map.read_span(stage.dac, self.calibration.deflection.channel)
            self._send(self._conversation.read_write(Operation(*span), write), now_ns)
        else:
            self._requests = [bytes((index,)) for index in range(len(reads))]
            self._send(self._conversation.write(write.address, words), now_ns)

    def _request(self, which: bytes) -> bytes:
        part = (self._input, self._readback)[which[0]]
        return self._conversation.read(part.address, part.count)

    def _judge(self, now_ns: int) -> None:
        age_s = self._age_s(now_ns)
        # In the time of the loop an exchange takes whole periods.
        is_fresh = age_s <= self.STALE_CYCLES * (self._map.device_cycle_s + self._period_s)
        volts = self._output_v, self._readings.sample.bridge_voltage_v
        status = AfmReport("ok" if is_fresh else "stale", age_s, self._readings.in_range, self._text, *volts)
        self._report = status if self._ready else status._replace(status="lost", force_valid=True)
