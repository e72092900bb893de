"""Configuration of devices of impedance type: their coupling, and the simulated one."""

from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from telenano.extend.hands import MODE_OFF, MODE_POSITION, Capabilities, DeviceError
from telenano.sections import LateralPath
from telenano.settings import Settings
from telenano_devices.impedance.coupled import CoupledParams, LateralHand
from telenano_devices.impedance.coupling import (
    STABLE_MARGIN,
    CouplingSettings,
    least_mass_kg,
    passive_stiffness_n_per_m,
    stable_stiffness_n_per_m,
)

# Least time from zero to the greatest force [s], by default.
_FULL_FORCE_S = 0.01
# A change of the force [N] under which any hand, a spring of some 1000 N/m at most, moves by 1 mm or more.
_FROZEN_N = 1.0


class Bounds(NamedTuple):
    """The coupling with its two bounds [N/m], the least moving mass that it needs [kg], and the mass of the device.

    verdict: `passive` below the passive bound, else `stable` up to the stable bound over its margin if the mass of the
    device suffices, else `unproven`. mass_kg: 0.0 if it is not declared.
    """

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    passive_n_per_m: float
    stable_n_per_m: float
    margin: float
    least_mass_kg: float
    mass_kg: float
    verdict: Literal["passive", "stable", "unproven"]

    def sentence(self) -> str:
        """Return a sentence about the coupling and its bounds for a person."""
        return (
            f"coupling K = {self.stiffness_n_per_m:.4g} N/m, B = {self.damping_n_s_per_m:.4g} N s/m: {self.verdict};"
            f" passive up to {self.passive_n_per_m:.4g} N/m, stable up to {self.stable_n_per_m:.4g} N/m"
            f" ({self.stable_n_per_m / self.margin:.4g} N/m with a margin of {self.margin:g}) for a moving"
            f" mass above {self.least_mass_kg:.3g} kg, and {_mass(self.mass_kg)}"
        )


def _mass(mass_kg: float) -> str:
    return f"the device declares {mass_kg:.3g} kg" if mass_kg > 0.0 else "the device declares none"


class CouplingConfig(Settings):
    """Section `haptic_node.coupling`: the spring and damper between the law's reference and an impedance device."""

    stiffness_n_per_m: float | None = Field(
        default=None,
        ge=0.0,
        le=1e6,
        description="K along the paper's axis [N/m]; none: the stable bound divided by the margin, and no more than "
        "the device declares",
    )
    damping_n_s_per_m: float | None = Field(
        default=None, ge=0.0, le=1e4, description="B [N s/m]; none: half of the value that the device declares"
    )
    lateral_stiffness_n_per_m: float = Field(
        default=0.0, ge=0.0, le=1e6, description="K of the lateral axes, towards the lateral reference [N/m]"
    )
    lateral_damping_n_s_per_m: float | None = Field(
        default=None, ge=0.0, le=1e4, description="B of the lateral axes [N s/m]; none: a tenth of B"
    )
    margin: float = Field(
        default=STABLE_MARGIN, ge=1.0, le=100.0, description="Margin of the default K below the stable bound"
    )
    max_force_n: float | None = Field(
        default=None,
        ge=1e-3,
        le=1e3,
        description="Greatest force on the hand [N]; none: the value that the device declares",
    )
    max_slew_n_per_s: float | None = Field(
        default=None,
        ge=1e-3,
        le=1e6,
        description="Fastest change of the force [N/s]; none: the greatest force in 10 ms",
    )
    velocity_filter_hz: float = Field(
        default=200.0, ge=0.0, le=1e5, description="Low-pass of the velocity in the damper [Hz]; 0 for none"
    )
    needs_deadman: bool | None = Field(
        default=None, description="Whether a button has to be held; none: where the device has one for it"
    )
    silence_s: float = Field(
        default=0.05, ge=1e-3, le=0.05, description="Silence of node or device after which there is no force [s]"
    )
    deadman_age_s: float = Field(
        default=0.1,
        ge=0.02,
        le=1.0,
        description="Greatest age at which a report of the button counts [s]; grips report at some 50 Hz",
    )
    rest_s: float = Field(
        default=0.2, ge=0.0, le=10.0, description="Time for which the hand has to be at rest before there is force [s]"
    )
    rest_m: float = Field(
        default=2e-3, ge=1e-6, le=0.1, description="Greatest motion of a hand that counts as at rest [m]"
    )
    jump_m: float = Field(
        default=5e-3, ge=1e-4, le=0.1, description="Motion in one sample, beyond 2 m/s, that is refused [m]"
    )
    frozen_s: float = Field(
        default=0.1,
        ge=0.0,
        le=10.0,
        description="Time for which a position may stay exactly the same under a changing force [s]; 0: for ever",
    )
    frozen_force_n: float | None = Field(
        default=None,
        ge=1e-3,
        le=1e3,
        description="Change of the force that a device must answer with some motion [N]; none: a tenth of the greatest"
        " force, and no more than 1 N",
    )
    runaway_m_per_s: float = Field(
        default=0.5, ge=0.01, le=10.0, description="Speed against half of the greatest force that is refused [m/s]"
    )

    def to_settings(self, device: Capabilities) -> CouplingSettings:
        """Return the constants of the coupling for a device with these capabilities.

        Raises:
            DeviceError: The declared moving mass is too small for the damping alone, on one of the axes.
        """
        b = self.damping_n_s_per_m
        damping = 0.5 * device.max_damping_n_s_per_m if b is None else b
        stiffness = self.stiffness_n_per_m
        if stiffness is None:
            stable = stable_stiffness_n_per_m(
                device.damping_n_s_per_m, damping, 1.0 / device.rate_hz, device.drive_delay_s
            )
            stiffness = min(stable / self.margin, device.max_stiffness_n_per_m)
        side = self.lateral_damping_n_s_per_m
        side = 0.1 * damping if side is None else side
        b, late = max(damping, side), (1.0 / device.rate_hz, device.drive_delay_s, self.velocity_filter_hz)
        least_kg = least_mass_kg(0.0, device.damping_n_s_per_m, b, *late)
        if 0.0 < device.mass_kg <= least_kg:
            raise DeviceError(
                f"haptic_node.coupling: a damping of B = {b:.4g} N s/m that acts {1e3 * least_kg / b:.3g} ms late"
                f" (T + D and the low-pass of the rate) needs a moving mass above {least_kg:.3g} kg, and"
                f" {_mass(device.mass_kg)}: give a B below {b * device.mass_kg / least_kg:.3g} N s/m"
            )
        most = device.max_force_n if self.max_force_n is None else min(self.max_force_n, device.max_force_n)
        return CouplingSettings(
            stiffness_n_per_m=(self.lateral_stiffness_n_per_m, self.lateral_stiffness_n_per_m, stiffness),
            damping_n_s_per_m=(side, side, damping),
            max_force_n=most,
            max_slew_n_per_s=most / _FULL_FORCE_S if self.max_slew_n_per_s is None else self.max_slew_n_per_s,
            velocity_filter_hz=self.velocity_filter_hz,
            needs_deadman=bool(device.deadman) if self.needs_deadman is None else self.needs_deadman,
            silence_s=self.silence_s,
            deadman_age_s=self.deadman_age_s,
            rest_s=self.rest_s,
            rest_m=self.rest_m,
            jump_m=self.jump_m,
            frozen_s=self.frozen_s,
            frozen_force_n=min(_FROZEN_N, 0.1 * most) if self.frozen_force_n is None else self.frozen_force_n,
            runaway_m_per_s=self.runaway_m_per_s,
        )

    def bounds(self, device: Capabilities) -> Bounds:
        """Return the coupling along the paper's axis with its bounds; raise DeviceError as `to_settings` does."""
        return bounds_of(self.to_settings(device), device, self.margin)


def bounds_of(settings: CouplingSettings, device: Capabilities, margin: float = STABLE_MARGIN) -> Bounds:
    """Return a coupling along the paper's axis with its bounds for a device; `margin` is that of the stable bound."""
    k, b = settings.stiffness_n_per_m[2], settings.damping_n_s_per_m[2]
    timing = device.damping_n_s_per_m, b, 1.0 / device.rate_hz, device.drive_delay_s
    passive, stable = passive_stiffness_n_per_m(*timing), stable_stiffness_n_per_m(*timing)
    least_kg = least_mass_kg(k, *timing, settings.velocity_filter_hz)
    verdict: Literal["passive", "stable", "unproven"] = "unproven"
    if k < passive:
        verdict = "passive"
    elif k <= stable / margin * (1.0 + 1e-9) and device.mass_kg > least_kg:
        verdict = "stable"
    return Bounds(k, b, passive, stable, margin, least_kg, device.mass_kg, verdict)


class DeviceModel(NamedTuple):
    """Constants of a make of devices: chosen for emulators, not measured, except for those that the maker declares."""

    mass_kg: float
    damping_n_s_per_m: float
    max_force_n: float
    max_stiffness_n_per_m: float
    max_damping_n_s_per_m: float
    reach_m: float
    rate_hz: float


ModelName = Literal["touch", "inverse3", "omega", "heavy"]
MODELS: dict[ModelName, DeviceModel] = {
    "touch": DeviceModel(0.045, 0.05, 3.3, 400.0, 4.0, 0.075, 1000.0),
    "inverse3": DeviceModel(0.20, 0.20, 10.0, 1000.0, 6.0, 0.15, 1000.0),
    "omega": DeviceModel(0.25, 0.50, 12.0, 5000.0, 30.0, 0.075, 4000.0),
    "heavy": DeviceModel(0.35, 2.0, 20.0, 5000.0, 30.0, 0.15, 4000.0),
}


class SimulatedImpedanceConfig(Settings):
    """Section `haptic_node.impedance`: the simulated device of three axes, for driver simulated_impedance."""

    model: ModelName = Field(default="inverse3", description="Constants that apply where none are given here")
    mass_kg: float | None = Field(default=None, ge=1e-3, le=10.0, description="Moving mass m [kg]")
    damping_n_s_per_m: float | None = Field(default=None, ge=0.0, le=1e3, description="Damping b [N s/m]")
    max_force_n: float | None = Field(default=None, ge=0.1, le=1e3, description="Greatest force [N]")
    rate_hz: float | None = Field(default=None, ge=100.0, le=1e4, description="Rate of the device's servo [Hz]")
    delay_s: float | None = Field(
        default=None, ge=0.0, le=0.05, description="Time from a sample to its force, D [s]; none: one sample time"
    )
    lateral_path: LateralPath = Field(
        default=(),
        max_length=10_000,
        description="Way of the hand over the sample: linear between the corners; none: the hand is free there",
    )
    lateral_stiffness_n_per_m: float = Field(
        default=300.0, ge=0.0, le=1e6, description="Spring of the arm on that way [N/m]"
    )
    lateral_damping_n_s_per_m: float = Field(
        default=5.0, ge=0.0, le=1e5, description="Damper of the arm on that way [N s/m]"
    )

    @property
    def _model(self) -> DeviceModel:
        return MODELS[self.model]

    def capabilities(self) -> Capabilities:
        """Return the capabilities that the device declares."""
        model = self._model
        rate_hz = model.rate_hz if self.rate_hz is None else self.rate_hz
        return Capabilities(
            max_force_n=model.max_force_n if self.max_force_n is None else self.max_force_n,
            max_stiffness_n_per_m=model.max_stiffness_n_per_m,
            max_damping_n_s_per_m=model.max_damping_n_s_per_m,
            workspace_min_m=-model.reach_m,
            workspace_max_m=model.reach_m,
            modes=(MODE_OFF, MODE_POSITION),
            identity=f"simulated {self.model}: mass and damping are chosen, not measured",
            force_source="estimate",
            kind="impedance",
            axes=3,
            lateral_m=((-model.reach_m, model.reach_m), (-model.reach_m, model.reach_m)),
            rate_hz=rate_hz,
            damping_n_s_per_m=model.damping_n_s_per_m if self.damping_n_s_per_m is None else self.damping_n_s_per_m,
            mass_kg=model.mass_kg if self.mass_kg is None else self.mass_kg,
            drive_delay_s=1.0 / rate_hz if self.delay_s is None else self.delay_s,
        )

    def to_params(self, coupling: CouplingConfig, operator: Any) -> CoupledParams:
        """Return the constants of device, coupling and hand."""
        capabilities = self.capabilities()
        held = 1.0 if self.lateral_path else 0.0
        path = [(point.time_s, point.x_m, point.y_m) for point in self.lateral_path] or [(0.0, 0.0, 0.0)]
        times_s, x_m, y_m = (np.array(column) for column in zip(*path, strict=True))
        side = LateralHand(
            times_s=times_s,
            x_m=x_m,
            y_m=y_m,
            stiffness_n_per_m=held * self.lateral_stiffness_n_per_m,
            damping_n_s_per_m=held * self.lateral_damping_n_s_per_m,
            force_n=(0.0, 0.0),
        )
        return CoupledParams(
            settings=coupling.to_settings(capabilities),
            mass_kg=capabilities.mass_kg,
            damping_n_s_per_m=capabilities.damping_n_s_per_m,
            servo_period_s=1.0 / capabilities.rate_hz,
            delay_s=capabilities.drive_delay_s,
            reach_m=capabilities.workspace_max_m,
            lateral=side,
            operator=operator,
        )
