"""An emulated handle: the firmware's core with the compiled motor and the simulated hand, in virtual time.

The plant is that of the simulated driver without its servo: the firmware closes that loop, in counts, once a
millisecond. The drive is a voltage of one millivolt a count.
"""

from datetime import UTC, datetime
from typing import Any

from telenano.devices import HandleAbility, HandleFlag
from telenano.extend.hands import MODE_OFF, MODE_POSITION, DeviceReading, DriveCommand
from telenano.hand import MotorParams
from telenano.sections import HapticConfig
from telenano_devices.handle.firmware import BoardIdentity, BoardSample, FirmwareCore

TICK_US = 1000
_TICK_S = TICK_US * 1e-6
MODEL = "telenano posix"
DEVICE_ID = 0x0102030405060708
M_PER_COUNT = 1e-8
N_PER_COUNT = 1e-4
V_PER_COUNT = 1e-3
# Counts at x = 0 and without a hand; they are not 0, so that a calibration which omits them shows an error.
POSITION_ZERO = 20480
FORCE_ZERO = 8388
# Servo gain that makes the plant a voltage source: in a tick the arm moves at most 40 um, which changes it by 40 uV.
_SOURCE_V_PER_M = 1.0
_SUPPLY_10MV = 4800
_FLAGS = (
    HandleAbility.HAS_POSITION_MODE
    | HandleAbility.HAS_FORCE_SENSOR
    | HandleAbility.SENSES_CURRENT
    | HandleAbility.IS_EMULATED
)
_FORCE_MAX = 2**31 - 1


def drive_n_per_count(motor: MotorParams) -> float:
    """Return the force at the arm of a drive count at rest [N]: K_t V / (R Kp), with K_t = 1/Km."""
    per_volt = 1.0 / (motor.armature_resistance_ohm * motor.speed_gain_rad_per_s_v * motor.screw_m_per_rad)
    return V_PER_COUNT * per_volt


def plant_of(config: HapticConfig) -> Any:
    """Return the opened motor of a configuration as a voltage source, with its hand, without disturbances."""
    source = config.device.model_copy(update={"servo_gain_v_per_m": _SOURCE_V_PER_M})
    plain = HapticConfig(operator=config.operator).model_copy(update={"device": source})
    plant = plain.to_simulated_device()
    plant.open()
    return plant


class EmulatedHandle:
    """A handle in virtual time, which `advance` moves on by one millisecond.

    Args:
        config: The configuration whose device and operator are emulated.
        session: The number of this boot of the device.
    """

    def __init__(self, config: HapticConfig, session: int) -> None:
        self._motor = config.device.to_params()
        self._drive_n = drive_n_per_count(self._motor)
        self._plant = plant_of(config)
        self._gauge_m: float | None = None
        self._load_n = 0.0
        self.time_us = 0
        self.estop_pressed = False
        self.reset(session)

    def reset(self, session: int) -> None:
        """Boot the firmware, as after a power failure; the arm stays where it is."""
        self._drive = self._session_ticks = 0
        identity = BoardIdentity(
            device_id=DEVICE_ID,
            session=session,
            flags=_FLAGS,
            reset_cause=0,
            m_per_count=M_PER_COUNT,
            n_per_count=N_PER_COUNT,
            drive_n_per_count=self._drive_n,
            model=MODEL,
        )
        self.core = FirmwareCore(identity)

    def place(self, position_m: float) -> None:
        """Hold the arm at a gauge [m], towards the sample > 0, until it is driven."""
        self._gauge_m = position_m

    def load(self, force_n: float) -> None:
        """Hang a weight at the sensor [N], towards the sample > 0, until the arm is driven: friction holds it."""
        self._load_n = force_n

    def receive(self, received: bytes) -> None:
        self.core.receive(received)

    def sent(self) -> bytes:
        return self.core.sent()

    def advance(self) -> None:
        """Advance by a millisecond: plant, sample, firmware."""
        self.time_us += TICK_US
        self._session_ticks = self._session_ticks + 1 if self.core.session_runs else 0
        session_s = self._session_ticks * _TICK_S if self._session_ticks else -1.0
        if self.core.mode != MODE_OFF:
            self._gauge_m, self._load_n = None, 0.0
        elif self._gauge_m is not None:
            plant = self._plant.state.plant
            motor = plant.motor._replace(position_m=self._gauge_m, velocity_m_per_s=0.0)
            self._plant.state.plant = plant._replace(motor=motor)
        before_m = self.position_m
        command = DriveCommand(MODE_OFF, 0.0, 0.0)
        if self.core.mode != MODE_OFF:
            volts = self._drive * V_PER_COUNT
            command = DriveCommand(MODE_POSITION, before_m + volts / _SOURCE_V_PER_M, 0.0)
        self._plant.write(command)
        reading = self._plant.read(session_s, _TICK_S)
        flags = HandleFlag.ESTOP_PRESSED if self.estop_pressed else 0
        flags |= HandleFlag.FORCE_SATURATED if reading.operator_force_limited else 0
        flags |= HandleFlag.CURRENT_LIMITED if reading.torque_limited else 0
        if reading.end_stop:
            towards = reading.position_m > 0.5 * (self._motor.position_min_m + self._motor.position_max_m)
            flags |= HandleFlag.AT_MAX if towards else HandleFlag.AT_MIN
        self._drive = self.core.tick(
            BoardSample(
                time_us=self.time_us,
                position=POSITION_ZERO + round(reading.position_m / M_PER_COUNT),
                force=FORCE_ZERO + round((reading.operator_force_n + self._load_n) / N_PER_COUNT),
                sensed_drive=max(-_FORCE_MAX, min(self._sensed_drive(reading), _FORCE_MAX)),
                supply_10mv=_SUPPLY_10MV,
                flags=flags,
            )
        )

    def _sensed_drive(self, reading: DeviceReading) -> int:
        """Return the drive that the board finds by its current sensor: the voltage across the armature [counts]."""
        back_v = reading.velocity_m_per_s / (self._motor.speed_gain_rad_per_s_v * self._motor.screw_m_per_rad)
        return round((reading.motor_voltage_v - back_v) / V_PER_COUNT)

    @property
    def position_m(self) -> float:
        """True position of the arm [m]."""
        return float(self._plant.state.plant.motor.position_m)

    @property
    def drive_v(self) -> float:
        """Voltage of the drive until the next tick [V]."""
        return self._drive * V_PER_COUNT


def calibration_of(config: HapticConfig) -> dict[str, object]:
    """Return the content of a calibration file that fits an emulated handle exactly."""
    motor = config.device.to_params()
    force_n = drive_n_per_count(motor)
    return {
        "schema": 1,
        "device_id": f"{DEVICE_ID:016x}",
        "calibrated": datetime(2026, 1, 1, tzinfo=UTC),
        "position": {"zero_raw": POSITION_ZERO, "m_per_count": M_PER_COUNT},
        "force": {
            "zero_raw": FORCE_ZERO,
            "n_per_count": N_PER_COUNT,
            "saturation_n": config.operator.max_force_n,
        },
        "drive": {
            "n_per_count": force_n,
            "friction_n": motor.friction_torque_n_m / motor.screw_m_per_rad,
        },
        "servo": {"stiffness_n_per_m": motor.servo_gain_v_per_m / V_PER_COUNT * force_n},
        "watchdog_s": 0.02,
        "max_force_n": motor.voltage_limit_v / V_PER_COUNT * force_n,
    }
