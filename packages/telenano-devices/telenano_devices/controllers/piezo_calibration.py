"""Calibration of an AFM controller that takes z in metres; the calibration of each driver is a subclass."""

from typing import Literal, Self

from pydantic import AwareDatetime, Field, model_validator

from telenano.afm import ChannelName
from telenano.devices import CantileverCalibration, Readings
from telenano.extend.instruments import SafetyParams
from telenano.extend.samples import AfmSample
from telenano.settings import Settings

_REACH_M = 1e-3


class ControllerAddress(Settings):
    """The network address of the controller, or of the guard in front of it."""

    host: str = Field(min_length=1, max_length=255, description="Name or address")
    port: int = Field(ge=1, le=65535)


class PiezoCalibration(Settings):
    """The z piezo: z = rest_m + towards_sample x_s, x_s the base towards the sample."""

    towards_sample: Literal[-1, 1] = Field(
        description="1: a greater z of the controller is nearer to the sample; -1: further away. It has no default:"
        " the controller's own settings decide it, and a wrong one drives the tip into the sample"
    )
    rest_m: float = Field(ge=-_REACH_M, le=_REACH_M, description="z of the controller at x_s = 0 [m]")
    retract_m: float = Field(ge=-_REACH_M, le=_REACH_M, description="z of the safe state [m]")
    min_m: float = Field(ge=-_REACH_M, le=_REACH_M, description="Least z that may be sent [m]")
    max_m: float = Field(ge=-_REACH_M, le=_REACH_M, description="Greatest z that may be sent [m]")
    tolerance_m: float = Field(
        1e-9,
        gt=0.0,
        le=1e-6,
        description="Difference from the value sent above which somebody else has moved the tip [m]",
    )
    unsafe_wiring_acknowledged: bool = Field(
        False, description="true: you know that the piezo does not go to retract_m when the controller ends"
    )

    @model_validator(mode="after")
    def _retracts(self) -> "PiezoCalibration":
        if not self.min_m <= self.retract_m <= self.max_m:
            raise ValueError(f"retract_m = {self.retract_m} m must lie within {self.min_m} m to {self.max_m} m")
        if self.towards_sample * (self.rest_m - self.retract_m) <= 0.0:
            raise ValueError(
                f"retract_m = {self.retract_m} m is not further from the sample than rest_m = {self.rest_m} m: with"
                f" towards_sample = {self.towards_sample} it must be {'less' if self.towards_sample > 0 else 'greater'}"
            )
        return self


class StageCentre(Settings):
    """The lateral stage: place of the controller at the middle of the sample, and its speed."""

    x_m: float | None = Field(
        None,
        ge=-_REACH_M,
        le=_REACH_M,
        description="x of the controller at the rig's x = 0 [m]; none: where the stage is first found",
    )
    y_m: float | None = Field(
        None,
        ge=-_REACH_M,
        le=_REACH_M,
        description="y of the controller at the rig's y = 0 [m]; none: where the stage is first found",
    )
    reach_m: float = Field(gt=0.0, le=_REACH_M, description="Reach either way of that place [m]")
    speed_m_per_s: float = Field(5e-5, gt=0.0, le=1.0, description="Speed that is set for motions [m/s]")
    tolerance_m: float = Field(
        5e-9, gt=0.0, le=1e-6, description="Difference at rest above which somebody else has moved the tip [m]"
    )


class SignalCalibration(Settings):
    """The deflection: zeta = (value - zero) / per_m, in the unit of the controller's signal."""

    signal: str = Field(
        min_length=1, max_length=100, description="Name of the signal at the controller, such as adc1 or in3"
    )
    zero: float = Field(ge=-1e6, le=1e6, description="Value of a free cantilever")
    per_m: float = Field(description="Change for a metre of deflection away from the sample, not 0")
    limit: float = Field(gt=0.0, le=1e6, description="Greatest value either way at which it is not saturated")

    @model_validator(mode="after")
    def _scaled(self) -> "SignalCalibration":
        if not 1e-3 <= abs(self.per_m) <= 1e15:
            raise ValueError(f"per_m = {self.per_m} must be 1e-3 to 1e15 either way")
        return self


class ChannelSignal(Settings):
    """A signal of the controller that is felt by `afm_node.feel`, or shown beside the force."""

    signal: str = Field(
        min_length=1, max_length=100, description="Name of the signal at the controller, such as Current (A)"
    )
    si: float = Field(1.0, description="Unit of the signal in the SI unit of the channel (Hz, A, m, rad); not 0")

    @model_validator(mode="after")
    def _scaled(self) -> "ChannelSignal":
        if not 1e-15 <= abs(self.si) <= 1e15:
            raise ValueError(f"si = {self.si} must be 1e-15 to 1e15 either way")
        return self


class ControllerCalibration(Settings):
    """A calibration file of a controller; `controller` is the name of its driver."""

    schema_version: Literal[1] = Field(alias="schema", description="Version of this file's form")
    controller: str = Field(min_length=1, max_length=32, description="Name of the driver")
    calibrated: AwareDatetime = Field(description="Time of the calibration, with time zone")
    network: ControllerAddress
    z: PiezoCalibration
    stage: StageCentre | None = Field(None, description="None: the tip moves along z only")
    deflection: SignalCalibration
    cantilever: CantileverCalibration
    channels: dict[ChannelName, ChannelSignal] = Field(
        default={}, description="Signals besides the deflection: frequency_shift, current, amplitude, phase"
    )
    contact_force_n: float = Field(1e-9, gt=0.0, le=1e-3, description="Repulsive force that counts as contact [N]")
    latency_s: float | None = Field(None, ge=0.0, le=1.0, description="Latency as measured [s]; none: as declared")
    heartbeat_s: float = Field(
        0.05, ge=0.02, le=1.0, description="Silence of the rig after which the guard retracts [s], 0.02 to 1"
    )

    @property
    def identity(self) -> str:
        """Return the name of this calibration in recordings: driver, host and date."""
        return f"{self.controller} {self.network.host} {self.calibrated.isoformat()}"

    def reached_at(self, host: str | None, port: int | None) -> Self:
        """Return the same calibration with another host or port; None keeps the present one."""
        own = {key: value for key, value in (("host", host), ("port", port)) if value is not None}
        return self.model_copy(update={"network": self.network.model_copy(update=own)})

    def z_m(self, base_m: float) -> float:
        """Return the z of the controller for a base position x_s [m], within its range."""
        return min(max(self.z.rest_m + self.z.towards_sample * base_m, self.z.min_m), self.z.max_m)

    def base_m(self, z_m: float) -> float:
        return self.z.towards_sample * (z_m - self.z.rest_m)

    def drives(self, z_m: float) -> bool:
        """Return whether a z [m] is nearer to the sample than the safe state; NaN counts as nearer."""
        return not self.base_m(z_m) <= self.base_m(self.z.retract_m) + self.z.tolerance_m

    def readings(self, z_m: float, value: float) -> Readings:
        """Return the readings of z [m] and of the deflection's signal: base, and force k zeta."""
        zeta = (value - self.deflection.zero) / self.deflection.per_m
        force = self.cantilever.stiffness_n_per_m * zeta
        contact = force > self.contact_force_n
        sample = AfmSample(self.base_m(z_m), zeta, force, value, 0.0, False, contact, False)
        return Readings(sample, abs(value) < self.deflection.limit)

    def check(self, limits: SafetyParams) -> list[str]:
        """Return the contradictions between this file and the limits of the node, as texts; empty for none."""
        faults = []
        for name, position_m in (("base_min_m", limits.base_min_m), ("base_max_m", limits.base_max_m)):
            z_m = self.z.rest_m + self.z.towards_sample * position_m
            if not self.z.min_m - 1e-15 <= z_m <= self.z.max_m + 1e-15:
                faults.append(
                    f"safety.{name} = {position_m} m needs z = {z_m:.4g} m, the file allows {self.z.min_m} m to"
                    f" {self.z.max_m} m"
                )
        if self.base_m(self.z.retract_m) > limits.retract_position_m + 1e-15:
            faults.append(
                f"z.retract_m = {self.z.retract_m} m is a base of {self.base_m(self.z.retract_m):.3g} m, nearer to the"
                f" sample than safety.retract_position_m = {limits.retract_position_m} m"
            )
        return faults
