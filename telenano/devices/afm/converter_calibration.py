"""Calibration of an instrument behind converters (`stage.yaml`): volts of stage and deflection in SI units."""

import math
from typing import Literal, NamedTuple

from pydantic import AwareDatetime, Field, model_validator

from telenano.devices.afm.register_map import MapName, RegisterMap
from telenano.extend.instruments import SafetyParams
from telenano.extend.samples import AfmSample
from telenano.settings.config import Settings

LEAST_HEARTBEAT_S = 0.02


class InstrumentIdentity(Settings):
    """The particular device that was calibrated."""

    map: MapName = Field("t7", description="Register map: t7, t8, wago_750, or a file")
    serial: int | None = Field(None, ge=0, description="Serial number; needed where the map has a register for it")


class NetworkCalibration(Settings):
    """The network address of the device."""

    host: str = Field(min_length=1, max_length=255, description="Name or address")
    port: int = Field(502, ge=1, le=65535)
    device_id: int = Field(1, ge=0, le=255, description="Unit behind a gateway; 1 without one")


class StageCalibration(Settings):
    """Voltage of the stage: v = rest_v + x_s / m_per_v, x_s the base towards the sample."""

    dac: int = Field(0, ge=0, le=63, description="Channel of the output")
    m_per_v: float = Field(gt=0.0, le=1e-3, description="Travel towards the sample for a volt [m/V], > 0")
    standard_error_m_per_v: float = Field(0.0, ge=0.0, le=1e-3)
    rest_v: float = Field(ge=-100.0, le=100.0, description="Voltage at x_s = 0 [V]")
    retract_v: float = Field(0.0, ge=-100.0, le=100.0, description="Voltage of the safe state [V]")
    min_v: float = Field(ge=-100.0, le=100.0, description="Least voltage of the output [V]")
    max_v: float = Field(ge=-100.0, le=100.0, description="Greatest voltage of the output [V]")
    slew_v_per_s: float = Field(gt=0.0, le=1e6, description="Fastest change of the voltage [V/s]")
    unsafe_wiring_acknowledged: bool = Field(
        False, description="true: retract_v is not 0 V, so that a loss of power does not retract"
    )

    @model_validator(mode="after")
    def _retracts(self) -> "StageCalibration":
        if not self.min_v <= self.retract_v <= self.max_v:
            raise ValueError(f"retract_v = {self.retract_v} V must lie within {self.min_v} V to {self.max_v} V")
        if self.retract_v != 0.0 and not self.unsafe_wiring_acknowledged:
            raise ValueError(
                f"retract_v = {self.retract_v} V: a device that loses power goes to 0 V and would not retract; wire it "
                "so that 0 V is retracted, or set unsafe_wiring_acknowledged: true"
            )
        return self


class DeflectionCalibration(Settings):
    """Voltage of the deflection: zeta = (v - zero_v) / v_per_m."""

    channel: int = Field(0, ge=0, le=254, description="Channel of the input")
    negative: int = Field(199, ge=0, le=199, description="Negative channel of the input; 199 is ground")
    range_v: float = Field(gt=0.0, le=100.0, description="Range of the input, plus and minus [V]")
    resolution_index: int = Field(0, ge=0, le=12)
    zero_v: float = Field(ge=-100.0, le=100.0, description="Voltage of a free cantilever [V]")
    v_per_m: float = Field(description="Voltage for a metre of deflection away from the sample [V/m], not 0")
    standard_error_v_per_m: float = Field(0.0, ge=0.0)

    @model_validator(mode="after")
    def _scaled(self) -> "DeflectionCalibration":
        if not 1.0 <= abs(self.v_per_m) <= 1e12:
            raise ValueError(f"v_per_m = {self.v_per_m} V/m must be 1 to 1e12 either way")
        return self


class CantileverCalibration(Settings):
    """Spring of the cantilever."""

    stiffness_n_per_m: float = Field(ge=1e-3, le=1e4, description="Spring constant k [N/m]")
    standard_error_n_per_m: float = Field(0.0, ge=0.0, le=1e4)


class Readings(NamedTuple):
    """A sample, and whether the input was within its range; if not, the force is at least that of the sample."""

    sample: AfmSample
    in_range: bool


class InstrumentCalibration(Settings):
    """A calibration file of an instrument."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this file's form")
    instrument: InstrumentIdentity
    calibrated: AwareDatetime = Field(description="Time of the calibration, with time zone")
    network: NetworkCalibration
    stage: StageCalibration
    deflection: DeflectionCalibration
    cantilever: CantileverCalibration
    contact_force_n: float = Field(1e-9, gt=0.0, le=1e-3, description="Repulsive force that counts as contact [N]")
    latency_s: float | None = Field(
        None, ge=0.0, le=1.0, description="Declared latency, as measured on this device [s]; none: that of the map"
    )
    heartbeat_s: float = Field(
        0.05,
        ge=0.0,
        le=1.0,
        description="Silence after which the device's script retracts [s], where the map has one: 0.02 to 1; 0: none",
    )
    watchdog_s: int = Field(1, ge=1, le=60, description="Silence after which the device's own watchdog retracts [s]")

    @model_validator(mode="after")
    def _heartbeat_is_possible(self) -> "InstrumentCalibration":
        if 0.0 < self.heartbeat_s < LEAST_HEARTBEAT_S:
            raise ValueError(
                f"heartbeat_s = {self.heartbeat_s} s must be 0 (none) or {LEAST_HEARTBEAT_S} s and more: the script "
                "looks every 5 ms, and a network has its delays"
            )
        return self

    @property
    def identity(self) -> str:
        """Return the name of this calibration in recordings: map, serial number and date."""
        return f"{self.instrument.map} {self.instrument.serial} {self.calibrated.isoformat()}"

    @property
    def values(self) -> dict[str, float]:
        """Return the values that settings of a register map may refer to, by name."""
        return {
            "range_v": self.deflection.range_v,
            "negative": float(self.deflection.negative),
            "resolution_index": float(self.deflection.resolution_index),
            "retract_v": self.stage.retract_v,
            "watchdog_s": float(self.watchdog_s),
        }

    def voltage_v(self, base_m: float) -> float:
        """Return the voltage of a base position [m], within the output's range."""
        wanted = self.stage.rest_v + base_m / self.stage.m_per_v
        return min(max(wanted, self.stage.min_v), self.stage.max_v)

    def base_m(self, voltage_v: float) -> float:
        return (voltage_v - self.stage.rest_v) * self.stage.m_per_v

    def readings(self, output_v: float, input_v: float) -> Readings:
        """Return the readings of two voltages [V]: base from the output read back, force k zeta from the input."""
        in_range = abs(input_v) < self.deflection.range_v
        zeta = (input_v - self.deflection.zero_v) / self.deflection.v_per_m
        force = self.cantilever.stiffness_n_per_m * zeta
        sample = AfmSample(self.base_m(output_v), zeta, force, input_v, 0.0, False, force > self.contact_force_n, False)
        return Readings(sample, in_range)

    def declared_latency_s(self, registers: RegisterMap, period_s: float) -> float:
        """Return the declared latency of the device [s]: the mean time from a command to the sample that answers it.

        A cycle of the device takes n whole periods of the loop: the sample that answers a command comes after n
        periods, and its mean age when it is used is (n - 1) / 2 more. Later commands replace those that wait meanwhile.

        Args:
            registers: The map of the device.
            period_s: The period of the loop [s].
        """
        if self.latency_s is not None:
            return self.latency_s
        requests = 3 if registers.exchange == "write_then_read" else 1
        periods = requests * math.ceil(registers.device_cycle_s / requests / period_s)
        return (3 * periods - 1) / 2 * period_s

    def check(self, limits: SafetyParams, registers: RegisterMap) -> list[str]:
        """Return the contradictions between this file, the limits of the node and the map, as texts; empty for none."""
        stage, faults = self.stage, []
        for name, position_m in (("base_min_m", limits.base_min_m), ("base_max_m", limits.base_max_m)):
            volts = stage.rest_v + position_m / stage.m_per_v
            if not stage.min_v - 1e-9 <= volts <= stage.max_v + 1e-9:
                faults.append(
                    f"safety.{name} = {position_m} m needs {volts:.3f} V, the output gives {stage.min_v} V to "
                    f"{stage.max_v} V"
                )
        retracted_m = self.base_m(stage.retract_v)
        if retracted_m > limits.retract_position_m + 1e-15:
            faults.append(
                f"stage.retract_v = {stage.retract_v} V is a base of {retracted_m:.3g} m, nearer to the sample than "
                f"safety.retract_position_m = {limits.retract_position_m} m"
            )
        if registers.serial is not None and self.instrument.serial is None:
            faults.append(
                f"instrument.serial is missing: {registers.model} has one, and another device must be refused"
            )
        return faults
