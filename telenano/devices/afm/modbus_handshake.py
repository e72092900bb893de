"""The handshake with a Modbus instrument before it is driven: identity, retraction, settings, watchdog, heartbeat."""

import struct
from collections.abc import Callable, Generator

from telenano.devices.afm.converter_calibration import InstrumentCalibration
from telenano.devices.afm.modbus_frames import Answer, Conversation
from telenano.devices.afm.register_map import Check, Heartbeat, Register, RegisterMap, Setting, agrees
from telenano.extend.instruments import DeviceError

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
_SAME_V = 2.0
_MS = 1_000_000
_SIGN_OF_LIFE_NS = 100 * _MS
_LUA_STOP_NS = 600 * _MS
_LUA_START_NS = 3000 * _MS
_PIECE_BYTES = 200

Steps = Generator[bytes, Answer, None]


class Handshake:
    """The requests of a handshake, one at a time; it raises DeviceError, with the fault, for an unfit device.

    Args:
        calibration: The calibration of this particular device.
        registers: The map of its registers.
        conversation: The framing of the requests.
        now_ns: The monotonic clock [ns].
    """

    def __init__(
        self,
        calibration: InstrumentCalibration,
        registers: RegisterMap,
        conversation: Conversation,
        now_ns: Callable[[], int],
    ) -> None:
        self._now_ns = now_ns
        self.identity = registers.model
        self._calibration, self._map, self._conversation = calibration, registers, conversation
        # Number of retractions by the script since it was last asked.
        self.trips = 0
        self._output = registers.output.of_channel(calibration.stage.dac)
        self._readback = registers.readback.of_channel(calibration.stage.dac)

    def steps(self) -> Steps:
        """Identify the device, retract it, set it up, and check that it is retracted.

        Each request is yielded and its answer sent in.

        Raises:
            DeviceError: The device is another one, refuses a request, or is not retracted.
        """
        for check in self._map.checks:
            actual = yield from self._read(check)
            if not agrees(actual, check.value):
                raise DeviceError(_mismatch(check, actual))
        serial = 0.0
        if self._map.serial is not None:
            serial = yield from self._read(self._map.serial)
            if round(serial) != self._calibration.instrument.serial:
                wanted = self._calibration.instrument.serial
                raise DeviceError(f"serial {serial:.0f} is not that of the calibration, {wanted}")
        self.identity = f"{self._map.model} {serial:.0f}" if serial else self._map.model
        if self._map.firmware is not None:
            firmware = yield from self._read(self._map.firmware)
            self.identity += f", firmware {firmware:.4f}"
        # Retract the output first, from any voltage.
        yield from self._write(self._output, self._calibration.stage.retract_v)
        for setting in self._map.settings:
            channel = self._calibration.deflection.channel
            yield from self._set(setting.model_copy(update={"address": setting.of_channel(channel).address}))
        yield from self._set_watchdog()
        yield from self._set_heartbeat()
        retracted = yield from self._read(self._readback)
        if not is_retracted(self._calibration, self._map, retracted):
            raise DeviceError(f"the output is at {retracted:.4f} V and not at the retract voltage")

    def _set_watchdog(self) -> Generator[bytes, Answer, None]:
        watchdog = self._map.watchdog
        if watchdog is None:
            return
        values = self._calibration.values
        differs = False
        for setting in watchdog.settings:
            actual = yield from self._read(setting)
            differs |= not agrees(actual, setting.wanted(values))
        enabled = yield from self._read(watchdog.enable)
        if not differs and agrees(enabled, 1.0):
            return
        yield from self._write(watchdog.enable, 0.0)
        for setting in watchdog.settings:
            yield from self._set(setting)
        yield from self._write(watchdog.enable, 1.0)

    def _set_heartbeat(self) -> Generator[bytes, Answer, None]:
        """Make the script run on the device, loading it unless it runs already; it is idle until the first beat."""
        heart = heartbeat_of(self._calibration, self._map)
        if heart is None:
            return
        wanted = (
            (heart.beat, 0.0),
            (heart.limit_ms, 1e3 * self._calibration.heartbeat_s),
            (heart.safe_v, self._calibration.stage.retract_v),
            (heart.output, float(self._output.address)),
            (heart.trips, 0.0),
        )
        reading = yield from self._read(heart.trips)
        # Memory that was never written may hold any value.
        self.trips = int(reading) if 0.0 <= reading < 1e6 else 0
        for register, value in wanted:
            yield from self._write(register, value)
        runs = yield from self._runs(heart, _SIGN_OF_LIFE_NS)
        if not runs:
            yield from self._load(heart)
            runs = yield from self._runs(heart, _LUA_START_NS)
        if not runs:
            raise DeviceError(
                f"the script {heart.script} was loaded and does not run; look at it with the maker's program, or set "
                "heartbeat_s: 0, and a tip whose host dies stays where it is for "
                f"{self._calibration.watchdog_s} s or more"
            )

    def _runs(self, heart: Heartbeat, patience_ns: int) -> Generator[bytes, Answer, bool]:
        """Return whether the script writes its version within patience_ns [ns].

        The register is cleared first, because the RAM keeps the version of a script that has ended.
        """
        yield from self._write(heart.running, 0.0)
        until_ns = self._now_ns() + patience_ns
        while self._now_ns() < until_ns:
            running = yield from self._read(heart.running)
            if agrees(running, heart.version):
                return True
        return False

    def _load(self, heart: Heartbeat) -> Generator[bytes, Answer, None]:
        """Stop any script, write this one, run it, and save it to run when the device is next switched on."""
        for _ in range(2):
            # A script needs time to end, and only the second stop frees its memory.
            yield from self._write(heart.run, 0.0)
            until_ns = self._now_ns() + _LUA_STOP_NS
            while self._now_ns() < until_ns:
                yield from self._read(heart.run)
        source = heart.source_bytes
        yield from self._write(heart.source_size, float(len(source)))
        for first in range(0, len(source), _PIECE_BYTES):
            piece = source[first : first + _PIECE_BYTES]
            answer = yield self._conversation.write(heart.source.address, struct.unpack(f">{len(piece) // 2}H", piece))
            _require(answer, heart.source, 0)
        for register in (heart.run, heart.save, heart.run_at_power_up):
            yield from self._write(register, 1.0)

    def _set(self, setting: Setting) -> Generator[bytes, Answer, None]:
        """Write a setting if it differs, and read it back."""
        wanted = setting.wanted(self._calibration.values)
        actual = yield from self._read(setting)
        if agrees(actual, wanted):
            return
        yield from self._write(setting, wanted)
        actual = yield from self._read(setting)
        if not agrees(actual, wanted):
            raise DeviceError(f"{setting.name} was set to {wanted:g} and reads {actual:g}")

    def _read(self, register: Register) -> Generator[bytes, Answer, float]:
        answer = yield self._conversation.read(register.address, register.count)
        _require(answer, register, register.count)
        return register.decode(answer.words, self._map.word_order)

    def _write(self, register: Register, value: float) -> Generator[bytes, Answer, None]:
        words = register.encode(value, self._map.word_order)
        answer = yield self._conversation.write(register.address, words)
        _require(answer, register, 0)


def heartbeat_of(calibration: InstrumentCalibration, registers: RegisterMap) -> Heartbeat | None:
    """Return the heartbeat of the map, or None if it has none or the calibration switches it off."""
    return registers.heartbeat if calibration.heartbeat_s > 0.0 else None


def is_retracted(calibration: InstrumentCalibration, registers: RegisterMap, output_v: float) -> bool:
    """Return whether an output [V] is at the retract voltage, within two steps of its converter."""
    return abs(output_v - calibration.stage.retract_v) <= _SAME_V * registers.output_step_v


def _mismatch(check: Check, reading: float) -> str:
    as_word = f" (0x{round(reading):08X})" if check.type == "uint32" else ""
    hint = f": {check.hint}" if check.hint else ""
    return f"{check.name} reads {reading:g}{as_word} and should read {check.value:g}{hint}; nothing was driven"


def _require(answer: Answer, register: Register, count: int) -> None:
    if answer.exception:
        reason = EXCEPTIONS.get(answer.exception, f"exception {answer.exception}")
        raise DeviceError(f"{register.name} (address {register.address}): {reason}")
    if len(answer.words) != count:
        raise DeviceError(f"{register.name} (address {register.address}) came back with {len(answer.words)} registers")
