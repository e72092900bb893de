"""A model of a LabJack T7 with a stage and a deflection: registers, converters, watchdog, and the compiled AFM.

The caller passes the time, so that a test can run it in virtual time; `t7_server` puts it behind a Modbus server.
"""

import random
import re
import struct
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Protocol

from telenano.afm import simulated_afm
from telenano.devices import FeedbackRequest, driver_of
from telenano.extend.instruments import AfmDriver
from telenano.extend.samples import AfmSample
from telenano.sections import AfmConfig
from telenano.wire import ConfigError

SERIAL = 470012345
M_PER_V = 8.0e-8
REST_V = 2.5
RANGE_V = 0.1
_DAC_STEP_V = 5.0 / 4095.0
_DAC_MOST_V = 5.0
_ADC_STEPS = 65536.0
# Exception codes of Modbus.
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3

# Addresses of the registers of a T7, by the names of its documentation.
_DAC0 = 1000
_AIN0 = 0
_AIN0_RANGE = 40000
_WATCHDOG = 61600
_WATCHDOG_S = 61604
_WATCHDOG_DAC0_ENABLE = 61640
_WATCHDOG_DAC0 = 61642
_USER_RAM = 46000
_LUA_RUN = 6000
_LUA_SIZE = 6012
_LUA_SOURCE = 6014
_LUA_SAVE = 6032
_LUA_RUN_DEFAULT = 6100
# Interval at which the script runs.
_SCRIPT_STEP_NS = 5_000_000
# Address, struct format and value at power-up.
_REGISTERS: tuple[tuple[int, str, float], ...] = (
    (_AIN0, ">f", 0.0),
    (_DAC0, ">f", 0.0),
    (4990, ">I", 0),
    (_AIN0_RANGE, ">f", 10.0),
    (41000, ">H", 199),
    (41500, ">H", 0),
    (55000, ">I", 0),
    (55100, ">I", 0x00112233),
    (55124, ">f", -9999.0),
    (60000, ">f", 7.0),
    (60004, ">f", 1.0292),
    (60028, ">I", SERIAL),
    (_WATCHDOG, ">I", 0),
    (_WATCHDOG_S, ">I", 0),
    (61606, ">I", 0),
    (61610, ">I", 0),
    (61620, ">I", 0),
    (_WATCHDOG_DAC0_ENABLE, ">I", 0),
    (_WATCHDOG_DAC0, ">f", 0.0),
    *((address, ">f", 0.0) for address in range(_USER_RAM, _USER_RAM + 12, 2)),
    (_LUA_RUN, ">I", 0),
    (_LUA_SIZE, ">I", 0),
    (_LUA_SAVE, ">I", 0),
    (_LUA_RUN_DEFAULT, ">I", 0),
)
_READ_ONLY = (_AIN0, 55000, 55100, 55124, 60000, 60004, 60028)


class RegisterError(ValueError):
    """An access that the device answers with an exception; `code` is its number."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class BridgePlant(Protocol):
    """The plant behind the converters: a base that moves, and the voltage of a bridge."""

    def exchange(self, base_m: float) -> AfmSample: ...


class BridgedSpring:
    """The spring of the theory of delay, read by the bridge of a cantilever: zeta = F / k.

    Args:
        spring: The opened spring.
        volts_per_n: The voltage of the bridge for a force on the tip [V/N].
    """

    def __init__(self, spring: AfmDriver, volts_per_n: float) -> None:
        self._spring, self._volts_per_n = spring, volts_per_n

    def exchange(self, base_m: float) -> AfmSample:
        sample = self._spring.exchange(base_m)
        return sample._replace(bridge_voltage_v=sample.force_n * self._volts_per_n)


def instrument_of(config: AfmConfig) -> BridgePlant:
    """Return the simulated instrument of a configuration, opened.

    Raises:
        ConfigError: The instrument has no bridge.
    """
    plant = config.to_params().plant
    if config.environment == "tip_sample":
        afm = simulated_afm(config.to_params())
        afm.open()
        return afm
    if config.environment == "spring":
        quiet = {"driver": "simulated", "disturbances": AfmConfig().disturbances}
        spring = driver_of(config.model_copy(update=quiet))
        spring.open()
        return BridgedSpring(spring, plant.volts_per_m / plant.stiffness_n_per_m)
    raise ConfigError(
        f"afm_node.environment: the model of a T7 has tip_sample or spring behind it, not {config.environment}"
    )


class T7Model:
    """The device.

    Args:
        afm: The opened instrument; the output moves its base, and the input reads its bridge voltage.
        noise_v: The standard deviation of a reading [V].
        output_step_v: The step of the output [V], by default that of a converter of 12 bits.
        m_per_v: The travel of the stage for a volt [m/V].
    """

    def __init__(
        self,
        afm: BridgePlant,
        *,
        noise_v: float = 0.0,
        output_step_v: float = _DAC_STEP_V,
        m_per_v: float = M_PER_V,
    ) -> None:
        self._step_v, self._m_per_v = output_step_v, m_per_v
        self._afm, self._noise_v, self._random = afm, noise_v, random.Random(1)
        self._words: dict[int, int] = {}
        self._forms = {address: form for address, form, _ in _REGISTERS}
        # Whether the device swaps the words of a number, as a wrong device does.
        self._word_swapped = False
        self._heard_ns = 0
        self.trips = 0
        self.script = HeartbeatScript(self)
        self.flash_writes = 0
        for address, _, value in _REGISTERS:
            self._put(address, value)
        self._move(0.0)

    @property
    def output_v(self) -> float:
        """Voltage of DAC0 [V]."""
        return self.value(_DAC0)

    def value(self, address: int) -> float:
        """Return the value of the register that begins at an address."""
        form = self._forms[address]
        words = [self._words[address + index] for index in range(struct.calcsize(form) // 2)]
        return float(struct.unpack(form, struct.pack(f">{len(words)}H", *words))[0])

    def pass_time(self, now_ns: int) -> None:
        """Let script and watchdog judge the silence until now_ns [ns]; the watchdog sets DAC0 after whole seconds."""
        self.script.pass_time(now_ns)
        limit_ns = self.value(_WATCHDOG_S) * 1e9
        if self.value(_WATCHDOG) == 1.0 and self._heard_ns and now_ns - self._heard_ns > limit_ns:
            self._heard_ns = 0
            self.trips += 1
            if self.value(_WATCHDOG_DAC0_ENABLE) == 1.0:
                self._move(self.value(_WATCHDOG_DAC0))

    def read(self, address: int, count: int, now_ns: int) -> list[int]:
        """Return registers.

        Raises:
            RegisterError: There is no such register.
        """
        self._hear(now_ns)
        if address <= _AIN0 + 1:
            self._sample()
        wanted = range(address, address + count)
        if not count or any(place not in self._words for place in wanted):
            raise RegisterError(ILLEGAL_ADDRESS)
        words = [self._words[place] for place in wanted]
        return words[::-1] if self._word_swapped and count == 2 else words

    def write(self, address: int, words: Sequence[int], now_ns: int) -> None:
        """Write one quantity.

        Raises:
            RegisterError: There is no such register, or it refuses the value.
        """
        self._hear(now_ns)
        if address == _LUA_SOURCE:
            self.script.load(struct.pack(f">{len(words)}H", *words))
            return
        form = self._forms.get(address)
        if form is None or address in _READ_ONLY or struct.calcsize(form) != 2 * len(words):
            raise RegisterError(ILLEGAL_ADDRESS)
        (value,) = struct.unpack(form, struct.pack(f">{len(words)}H", *words))
        if address == _DAC0:
            self._move(value)
            return
        if address in (_LUA_RUN, _LUA_SIZE, _LUA_SAVE):
            self.script.control(address, value, now_ns)
        if _WATCHDOG < address <= _WATCHDOG_DAC0 + 1 and self.value(_WATCHDOG) == 1.0:
            # The settings of the watchdog may change only while it is off.
            raise RegisterError(ILLEGAL_VALUE)
        self.flash_writes += address >= _WATCHDOG or address in (_LUA_SAVE, _LUA_RUN_DEFAULT)
        self.set_value(address, value)

    def set_value(self, address: int, value: float) -> None:
        """Set a register as the device itself would, without access checks."""
        if address == _DAC0:
            self._move(value)
        else:
            self._put(address, value)

    def feedback(self, request: FeedbackRequest, now_ns: int) -> list[int]:
        """Carry out the frames of function 76 in order; return the registers that were read."""
        answer: list[int] = []
        for address, count, words in request.operations:
            if words:
                self.write(address, words, now_ns)
            else:
                answer += self.read(address, count, now_ns)
        return answer

    def _hear(self, now_ns: int) -> None:
        self.pass_time(now_ns)
        self._heard_ns = now_ns

    def _move(self, volts: float) -> None:
        output_v = round(min(max(volts, 0.0), _DAC_MOST_V) / self._step_v) * self._step_v
        self._put(_DAC0, output_v)
        self._bridge_v = self._afm.exchange((output_v - REST_V) * self._m_per_v).bridge_voltage_v

    def _sample(self) -> None:
        range_v = self.value(_AIN0_RANGE)
        step_v = 2.0 * range_v / _ADC_STEPS
        noisy = self._bridge_v + (self._random.gauss(0.0, self._noise_v) if self._noise_v else 0.0)
        self._put(_AIN0, min(max(round(noisy / step_v) * step_v, -range_v), range_v))

    def _put(self, address: int, value: float) -> None:
        form = self._forms[address]
        packed = struct.pack(form, value if form == ">f" else round(value))
        for index, word in enumerate(struct.unpack(f">{len(packed) // 2}H", packed)):
            self._words[address + index] = word


class HeartbeatScript:
    """The behaviour of the heartbeat script of the maps on the device, at its pace; any other script does nothing.

    As on a device, a script that is cut, or of another size than announced, does not run.
    """

    def __init__(self, model: T7Model) -> None:
        self._model = model
        self._source = b""
        self._saved = b""
        self._stepped_ns: int | None = None
        self._last = self._silent_ms = 0.0
        self._tripped = False
        self._version = 0.0

    @property
    def runs(self) -> bool:
        return self._stepped_ns is not None

    @property
    def saved(self) -> bytes:
        """Return the script that the device runs when it is switched on."""
        return self._saved if self._model.value(_LUA_RUN_DEFAULT) == 1.0 else b""

    def load(self, piece: bytes) -> None:
        self._source += piece

    def control(self, address: int, value: float, now_ns: int) -> None:
        """Act on one of the registers that load and run a script."""
        if address == _LUA_SIZE:
            self._source = b""
        elif address == _LUA_SAVE:
            self._saved = self._source
        elif value == 0.0:
            self._stepped_ns = None
        elif not self.runs and len(self._source) == self._model.value(_LUA_SIZE):
            match = re.search(
                rb"^-- telenano heartbeat.*?^local VERSION = ([0-9]+)$", self._source, re.DOTALL | re.MULTILINE
            )
            if match is not None:
                self._version = float(match[1])
                self._last, self._silent_ms, self._tripped = 0.0, 0.0, False
                self._stepped_ns = now_ns

    def pass_time(self, now_ns: int) -> None:
        """Make the steps that are due until now_ns [ns]."""
        while self._stepped_ns is not None and now_ns - self._stepped_ns >= _SCRIPT_STEP_NS:
            self._stepped_ns += _SCRIPT_STEP_NS
            self._step()

    def _step(self) -> None:
        beat, limit_ms, safe_v, output, _, trips = (self._model.value(_USER_RAM + 2 * number) for number in range(6))
        if beat == 0.0:
            self._silent_ms, self._tripped = 0.0, False
        elif beat != self._last:
            self._silent_ms = 0.0
        else:
            self._silent_ms += _SCRIPT_STEP_NS * 1e-6
        self._last = beat
        if self._silent_ms > limit_ms and not self._tripped:
            self._tripped = True
            self._model.set_value(_USER_RAM + 10, trips + 1.0)
        if self._tripped:
            self._model.set_value(round(output), safe_v)
        self._model.set_value(_USER_RAM + 8, self._version)


def calibration_of(
    volts_per_m: float,
    stiffness_n_per_m: float,
    host: str = "127.0.0.1",
    port: int = 502,
    m_per_v: float = M_PER_V,
) -> dict[str, object]:
    """Return the content of a calibration file that fits the model exactly."""
    return {
        "schema": 1,
        "instrument": {"map": "t7", "serial": SERIAL},
        "calibrated": datetime(2026, 1, 1, tzinfo=UTC),
        "network": {"host": host, "port": port},
        "stage": {
            "m_per_v": m_per_v,
            "rest_v": REST_V,
            "retract_v": 0.0,
            "min_v": 0.0,
            "max_v": _DAC_MOST_V,
            "slew_v_per_s": 25.0,
        },
        "deflection": {"range_v": RANGE_V, "resolution_index": 1, "zero_v": 0.0, "v_per_m": volts_per_m},
        "cantilever": {"stiffness_n_per_m": stiffness_n_per_m},
    }
