"""Settings of the parts of an AFM: cantilever, tip and sample (Table 2 of the paper), guard, friction, real devices."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from telenano.afm.cantilever import volts_per_m
from telenano.afm.contact.capillary import meniscus_radius_m
from telenano.afm.torsion import TorsionParams
from telenano.settings.config import Settings
from telenano.wire.topics import deadline_of

BasePosition = Annotated[float, Field(ge=-1e-4, le=1e-4)]
Speed = Annotated[float, Field(gt=0.0, le=1e-3)]


class CantileverConfig(Settings):
    """Spring and read-out of the cantilever (Table 2, Eq. 3)."""

    stiffness_n_per_m: float = Field(40.0, ge=1e-3, le=1e4, description="Spring constant k [N/m].")
    resonance_hz: float = Field(150e3, gt=0.0, le=1e7, description="Free resonance f [Hz], for the dynamic model.")
    quality: float = Field(100.0, gt=0.5, le=1e7, description="Quality factor Q in air, above 0.5; dynamic model.")
    steps_per_period: int = Field(
        96, ge=16, le=4096, multiple_of=8, description="Steps of a period of the drive, a multiple of 8; dynamic model."
    )
    bridge_supply_v: float = Field(2.5, gt=0.0, le=100.0, description="Bridge supply voltage V0 [V].")
    amplifier_gain: float = Field(1e4, gt=0.0, le=1e7, description="Gain Gc of the bridge amplifier.")
    sensitivity_per_m: float = Field(
        1e3, gt=0.0, le=1e9, description="Relative change of resistance per deflection Sc [1/m]; 1e3 is 1e-6 per nm."
    )

    @property
    def volts_per_m(self) -> float:
        """The gain of the read-out, Eq. 3 [V/m]."""
        return volts_per_m(self.bridge_supply_v, self.amplifier_gain, self.sensitivity_per_m)


# H and omega are measured separately, and the H of Table 2 is 2.6 times the one that follows from its omega. A factor
# above 4 is taken for a mistake.
MOST_CONTRADICTION = 4.0


class TipSampleConfig(Settings):
    """Tip, sample and the water between them. Values that are not given come from the preset."""

    preset: Literal["table_2"] = Field(
        "table_2", description="Source of values that are not given: Table 2 of the paper."
    )
    tip_radius_m: float = Field(10e-9, ge=1e-10, le=1e-3, description="Tip radius R [m].")
    hamaker_j: float = Field(1.89e-19, gt=0.0, le=1e-17, description="Hamaker constant H [J].")
    sigma_m: float = Field(3.49e-10, ge=1e-11, le=1e-8, description="Interatomic distance sigma [m].")
    work_of_adhesion_j_per_m2: float = Field(0.072, ge=1e-6, le=10.0, description="Work of adhesion omega [J/m^2].")
    tip_modulus_pa: float = Field(170e9, ge=1e2, le=1e13, description="Young's modulus of the tip [Pa].")
    sample_modulus_pa: float = Field(4e9, ge=1e2, le=1e13, description="Young's modulus of the sample [Pa].")
    tip_poisson: float = Field(0.5, gt=-1.0, le=0.5, description="Poisson ratio of the tip.")
    sample_poisson: float = Field(0.3, gt=-1.0, le=0.5, description="Poisson ratio of the sample.")
    liquid_energy_j_per_m2: float = Field(
        0.073, ge=0.0, le=1.0, description="Surface energy gamma_L of the liquid [J/m^2]."
    )
    meniscus_radius_m: float = Field(1.2e-9, ge=1e-11, le=1e-6, description="Curvature radius r1 of the meniscus [m].")
    relative_humidity: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="Relative humidity, a fraction; given instead of meniscus_radius_m, it sets r1.",
    )
    liquid_thickness_m: float = Field(0.8e-9, gt=0.0, le=1e-6, description="Thickness L_l of the liquid layer [m].")
    liquid_viscosity_pa_s: float = Field(
        0.0, ge=0.0, le=1e6, description="Viscosity tau_l of the liquid layer [Pa s]; dynamic model."
    )
    sample_thickness_m: float = Field(1e-9, gt=0.0, le=1e-3, description="Thickness L_s of the damping sample [m].")
    sample_viscosity_pa_s: float = Field(
        0.0, ge=0.0, le=1e9, description="Viscosity tau_s of the sample [Pa s]; dynamic model."
    )
    break_distance_m: float = Field(
        4e-9, gt=0.0, le=1e-5, description="Distance delta_b at which the meniscus breaks [m], above 2 r1."
    )

    @model_validator(mode="after")
    def _one_meniscus(self) -> Self:
        if self.relative_humidity is not None and "meniscus_radius_m" in self.model_fields_set:
            raise ValueError("give either meniscus_radius_m or relative_humidity, not both: one follows from the other")
        return self

    @property
    def effective_meniscus_radius_m(self) -> float:
        """Curvature radius r1 [m], from the humidity where that is given."""
        return self.meniscus_radius_m if self.relative_humidity is None else meniscus_radius_m(self.relative_humidity)


class SafetyConfig(Settings):
    """Limits of base and tip; positions along the paper's axis, towards the sample, 0 at the rest distance."""

    base_min_m: BasePosition = Field(-200e-9, description="Base furthest from the sample [m].")
    base_max_m: BasePosition = Field(200e-9, description="Base furthest towards the sample [m].")
    base_speed_m_per_s: Speed = Field(
        2e-6, description="Fastest motion of the base [m/s]; Fig. 12 approaches at 15 nm/s."
    )
    resume_acceleration_m_per_s2: float = Field(
        2e-6,
        gt=0.0,
        le=1e6,
        description="Acceleration of the base to its speed after a hold [m/s^2]: 0.4 nm in 20 ms.",
    )
    retract_position_m: BasePosition = Field(
        -100e-9,
        description="Base in the safe state [m], within the range; if it is not given and a spring also pulls, that "
        "spring's rest position, because it would pull at any other.",
    )
    retract_speed_m_per_s: Speed = Field(1e-6, description="Speed of retraction [m/s].")
    force_limit_n: float = Field(
        200e-9, gt=0.0, le=1e-3, description="Repulsive force above which the tip is retracted [N]."
    )
    lateral_limit_n: float = Field(
        1e-5, gt=0.0, le=1e-3, description="Lateral force above which the tip is retracted [N]."
    )
    command_deadline_s: float = Field(
        deadline_of("afm/command"),
        gt=0.0,
        le=10.0,
        description="Greatest age of a command, and of the hand's sample behind it, at which it is followed [s]; "
        "beyond it the base holds.",
    )
    hold_time_s: float = Field(0.2, ge=0.0, le=60.0, description="Time in hold before retracting [s].")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.base_min_m <= self.retract_position_m < self.base_max_m:
            raise ValueError(
                f"base_min_m = {self.base_min_m} m <= retract_position_m = {self.retract_position_m} m < "
                f"base_max_m = {self.base_max_m} m does not hold"
            )
        return self


class LateralConfig(Settings):
    """Limits of the stage that moves tip or sample in x and y."""

    reach_m: float = Field(50e-6, gt=0.0, le=1e-3, description="Reach either way of the centre [m].")
    speed_m_per_s: float = Field(20e-6, gt=0.0, le=1.0, description="Greatest speed [m/s].")


class FrictionConfig(Settings):
    """Friction of the tip on the sample, and torsion of the cantilever under lateral force; the paper has neither."""

    coefficient: float = Field(0.0, ge=0.0, le=2.0, description="Coefficient mu of Amontons, 0 to 2; 0: no friction.")
    lateral_stiffness_n_per_m: float = Field(
        100.0, gt=0.0, le=1e6, description="Lateral stiffness of the cantilever at the tip [N/m]."
    )
    tip_height_m: float = Field(10e-6, gt=0.0, le=1e-3, description="Height of the tip [m]: torsion is F / (k h).")


class SpringConfig(Settings):
    """A linear environment instead of cantilever and sample, as the theory of delay assumes it."""

    stiffness_n_per_m: float = Field(20.0, gt=0.0, le=1e9, description="Stiffness K [N/m].")
    rest_position_m: BasePosition = Field(0.0, description="Base at which the spring is at rest [m]: F = K (x_s - L).")
    bilateral: bool = Field(True, description="Whether the spring also pulls; only then is it linear.")


class ModbusConfig(Settings):
    """A stage and a deflection signal that are connected through a Modbus instrument."""

    calibration: str = Field(min_length=1, description="Calibration file of this individual device (stage.yaml)")
    host: str | None = Field(
        None, min_length=1, max_length=255, description="Host, instead of the one in the calibration"
    )
    port: int | None = Field(None, ge=1, le=65535, description="Port, instead of the one in the calibration")


class AfmControllerConfig(Settings):
    """The controller of an AFM, or the guard in front of it."""

    calibration: str = Field(min_length=1, description="Calibration file of this individual controller")
    host: str | None = Field(
        None, min_length=1, max_length=255, description="Host, instead of the one in the calibration"
    )
    port: int | None = Field(None, ge=1, le=65535, description="Port, instead of the one in the calibration")


_CROSSTALK = "Apparent lateral force along {axis} of a bent cantilever, as a share of k zeta."


class TorsionConfig(Settings):
    """Measurement of the lateral force by torsion, with the errors of the channel."""

    factor_n_per_v: float = Field(2e-6, gt=0.0, le=1e-3, description="Calibration factor of the torsion channel [N/V].")
    range_v: float = Field(10.0, gt=0.0, le=1e3, description="Range of its read-out, either way [V].")
    gain_error: float = Field(
        0.0, ge=-0.9, le=9.0, description="Relative error of the factor: 0.2 reads a fifth too much."
    )
    gain_uncertainty: float = Field(
        0.0, ge=0.0, le=1.0, description="Relative standard uncertainty that the calibration states."
    )
    crosstalk_x: float = Field(0.0, ge=-1.0, le=1.0, description=_CROSSTALK.format(axis="x"))
    crosstalk_y: float = Field(0.0, ge=-1.0, le=1.0, description=_CROSSTALK.format(axis="y"))

    @property
    def most_n(self) -> float:
        """The greatest lateral force along an axis that can be read [N]."""
        return self.factor_n_per_v * self.range_v

    def around(self, part: Any, stiffness_n_per_m: float) -> Any:
        """Wrap the parameters of a part in those of this channel, for a cantilever of stiffness_n_per_m [N/m]."""
        cross = stiffness_n_per_m * self.crosstalk_x, stiffness_n_per_m * self.crosstalk_y
        return TorsionParams(part, 1.0 + self.gain_error, *cross, self.most_n)
