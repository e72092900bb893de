"""Calibration of a serial handle (`handle.yaml`): the conversion of raw counts of one device to SI units."""

from typing import Annotated, Literal

from pydantic import AwareDatetime, Field, model_validator

from telenano.devices.hand import wire
from telenano.sections.hand_section import LimitsConfig
from telenano.settings.config import Settings

_COUNT_LIMIT = 2**31 - 1
_Q16 = 65536.0
# Margin of the device's speed limit: a reference at the guard's limit arrives with the jitter of two clocks.
_SPEED_MARGIN = 1.2

RawCount = Annotated[int, Field(ge=-_COUNT_LIMIT, le=_COUNT_LIMIT)]
StandardError = Annotated[float, Field(ge=0.0, le=1.0, description="Standard error of the factor, same unit")]


def _not_zero(name: str, value: float) -> None:
    if value == 0.0:
        raise ValueError(f"{name} must not be 0: every position or force would be")


class PositionCalibration(Settings):
    """x = (raw - zero_raw) m_per_count, towards the sample > 0."""

    zero_raw: RawCount = Field(description="Count where the arm starts, x = 0")
    m_per_count: float = Field(ge=-1e-2, le=1e-2, description="Travel of a count [m], < 0 if it counts away")
    standard_error_m_per_count: StandardError = 0.0

    @model_validator(mode="after")
    def _scaled(self) -> "PositionCalibration":
        _not_zero("m_per_count", self.m_per_count)
        return self


class ForceCalibration(Settings):
    """F = (raw - zero_raw) n_per_count, of the operator on the arm, towards the sample > 0."""

    zero_raw: RawCount = Field(description="Count without a hand")
    n_per_count: float = Field(ge=-1e3, le=1e3, description="Force of a count [N]")
    standard_error_n_per_count: StandardError = 0.0
    saturation_n: float = Field(gt=0.0, le=1e3, description="Force beyond which the sensor saturates [N]")

    @model_validator(mode="after")
    def _scaled(self) -> "ForceCalibration":
        _not_zero("n_per_count", self.n_per_count)
        return self


class DriveCalibration(Settings):
    """Force of the drive on the arm, F = raw n_per_count, in the direction in which the position counts."""

    n_per_count: float = Field(gt=0.0, le=1e3, description="Force of a drive count at rest [N]")
    friction_n: float = Field(default=0.0, ge=0.0, le=1e5, description="Coulomb friction at the arm [N]")


class ServoCalibration(Settings):
    """Position servo in the device: drive force = stiffness (reference - x) - damping v."""

    stiffness_n_per_m: float = Field(gt=0.0, le=1e9, description="Proportional gain at the arm [N/m]")
    damping_n_s_per_m: float = Field(default=0.0, ge=0.0, le=1e7, description="Gain of the velocity [N s/m]")


class HandleCalibration(Settings):
    """A calibration file of a handle."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this file's form")
    device_id: str = Field(
        pattern=r"^[0-9a-f]{16}$", description="Device that it belongs to, as `device probe` shows it"
    )
    calibrated: AwareDatetime = Field(description="Time of the calibration, with time zone")
    position: PositionCalibration
    force: ForceCalibration
    drive: DriveCalibration
    servo: ServoCalibration
    latency_s: float | None = Field(
        None, ge=0.0, le=1.0, description="Declared latency, as measured on this device [s]; none: that of the protocol"
    )
    watchdog_s: float = Field(0.02, ge=0.005, le=0.1, description="Silence after which the device is off [s]")
    max_force_n: float = Field(gt=0.0, le=1e5, description="Greatest force that the device gives its drive [N]")

    @model_validator(mode="after")
    def _fits_the_device(self) -> "HandleCalibration":
        for name, value in (("servo.stiffness_n_per_m", self._gain_q16), ("max_force_n", self._max_drive)):
            if not 0.5 <= value <= _COUNT_LIMIT:
                raise ValueError(f"{name} is {value:.3g} in the counts of the device, 1 to {_COUNT_LIMIT} are possible")
        return self

    @property
    def identity(self) -> str:
        """Return the name of this calibration in recordings: device and date."""
        return f"{self.device_id} {self.calibrated.isoformat()}"

    @property
    def _gain_q16(self) -> float:
        return self.servo.stiffness_n_per_m * abs(self.position.m_per_count) / self.drive.n_per_count * _Q16

    @property
    def _max_drive(self) -> float:
        return self.max_force_n / self.drive.n_per_count

    def position_m(self, raw: int) -> float:
        return (raw - self.position.zero_raw) * self.position.m_per_count

    def velocity_m_per_s(self, raw_per_s: int) -> float:
        return raw_per_s * self.position.m_per_count

    def operator_force_n(self, raw: int) -> float:
        return (raw - self.force.zero_raw) * self.force.n_per_count

    def drive_force_n(self, raw: int) -> float:
        """Return the force of the drive [N], towards the sample > 0."""
        return raw * self.drive.n_per_count * (1.0 if self.position.m_per_count > 0.0 else -1.0)

    def position_raw(self, position_m: float) -> int:
        return _count(self.position.zero_raw + position_m / self.position.m_per_count)

    def drive_raw(self, force_n: float) -> int:
        """Return the drive count of a force [N] towards the sample."""
        return _count(force_n / self.drive_force_n(1))

    def device_limits(self, limits: LimitsConfig) -> wire.Limits:
        """Return the limits that the device itself enforces, in its counts: those of the guard and this calibration."""
        ends = sorted((self.position_raw(limits.position_min_m), self.position_raw(limits.position_max_m)))
        per_m = 1.0 / abs(self.position.m_per_count)
        damping = self.servo.damping_n_s_per_m * abs(self.position.m_per_count) / self.drive.n_per_count
        return wire.Limits(
            watchdog_ms=round(self.watchdog_s * 1e3),
            travel_min=ends[0],
            travel_max=ends[1],
            max_speed_per_s=max(1, _count(_SPEED_MARGIN * limits.max_speed_m_per_s * per_m)),
            max_drive=max(1, _count(self._max_drive)),
            servo_gain_q16=max(1, _count(self._gain_q16)),
            servo_damping_q16=_count(damping * _Q16),
        )


def _count(value: float) -> int:
    return round(min(max(value, -_COUNT_LIMIT), _COUNT_LIMIT))
