"""Configuration of the haptic node: device, guard and drivers, with the presets of the paper."""

import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import ConfigDict, Field, create_model, model_validator

from telenano.extend.hands import SimulatedHand
from telenano.hand import sim, step
from telenano.hand.disturbances import DisturbedHaptic, disturbed_plant_params
from telenano.hand.motor import SUBSTEP_S, MotorParams
from telenano.hand.safety import SafetyParams
from telenano.sections.hand_travel_section import HandTravelConfig
from telenano.sections.lateral_hand_section import LateralHandConfig
from telenano.sections.operator_section import ArmConstants, ForceProfileConfig, ImpedanceConfig, OperatorConfig
from telenano.settings.config import Settings, filled, validate
from telenano.settings.device_drivers import Drivers
from telenano.settings.hand_disturbances import HandDisturbanceConfig
from telenano.settings.known_packages import SIMULATED_DRIVERS
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.messages import Scalar
from telenano.wire.topics import deadline_of

# E1: the printed gain gives a bandwidth of 1.318 Hz, the printed bandwidth of 30 Hz needs the other gain.
SERVO_GAINS_V_PER_M: dict[str, float] = {"paper_bandwidth": 1.917e5, "paper_gain": 1.0e4}


class DeviceConfig(Settings):
    """The 1-DOF device (Table 1, Eq. 1-2). Values that the paper does not give are marked as our own choice."""

    preset: Literal["paper_bandwidth", "paper_gain"] = Field(
        default="paper_bandwidth",
        description="Servo gain: 1.917e5 V/m for the 30 Hz of Table 1, or the printed 10000 V/m: 1.318 Hz (E1)",
    )
    servo_gain_v_per_m: float | None = Field(
        default=None, ge=1e-3, le=1e7, description="Servo gain G [V/m], instead of the preset's"
    )
    speed_gain_rad_per_s_v: float = Field(
        default=29.41,
        ge=1e-3,
        le=1e4,
        description="Motor gain Km [(rad/s)/V]; 1/Km is K_t [N m/A] and K_e",
    )
    screw_m_per_rad: float = Field(default=2.79e-5, ge=1e-9, le=0.1, description="Screw Kp [m/rad]")
    time_constant_s: float = Field(default=1.1e-3, ge=1e-4, le=1.0, description="Motor time constant Tm [s]")
    friction_torque_n_m: float = Field(
        default=3.15e-3, ge=0.0, le=1.0, description="Coulomb friction at the motor, either way [N m]"
    )
    armature_resistance_ohm: float = Field(
        default=5.0,
        ge=1e-6,
        le=1e3,
        description="Armature resistance R [ohm], our own choice (not in the paper). Friction acts like"
        " torque*R*Km volts: 0.463 V, a position band of 2.4 um (paper_bandwidth) or 46 um (paper_gain)",
    )
    voltage_limit_v: float = Field(
        default=48.0,
        ge=1e-6,
        le=1e3,
        description="Supply of the drive [V], our own choice; 39 mm/s unloaded",
    )
    torque_limit_n_m: float = Field(
        default=0.05,
        ge=1e-9,
        le=10.0,
        description="Motor torque at the current limit [N m], our own choice",
    )
    position_min_m: float = Field(default=-0.005, ge=-1.0, le=1.0, description="End stop away from the sample [m]")
    position_max_m: float = Field(
        default=0.015, ge=-1.0, le=1.0, description="End stop towards the sample [m]; 20 mm of travel in all"
    )
    start_position_m: float = Field(default=0.0, ge=-1.0, le=1.0, description="Where the arm stands at start [m]")

    @model_validator(mode="after")
    def _consistent(self) -> "DeviceConfig":
        if not self.position_min_m < self.position_max_m:
            raise ValueError(
                f"position_min_m = {self.position_min_m} m must be below position_max_m = {self.position_max_m} m"
            )
        if not self.position_min_m <= self.start_position_m <= self.position_max_m:
            raise ValueError(
                f"start_position_m = {self.start_position_m} m must lie between the end stops at"
                f" {self.position_min_m} m and {self.position_max_m} m"
            )
        if self.torque_limit_n_m <= self.friction_torque_n_m:
            raise ValueError(
                f"torque_limit_n_m = {self.torque_limit_n_m} N m must exceed friction_torque_n_m ="
                f" {self.friction_torque_n_m} N m, or the motor never moves"
            )
        a2, _ = self.to_params().closed_loop_coefficients()
        if not math.sqrt(a2) * SUBSTEP_S < math.pi:
            raise ValueError(
                f"servo_gain_v_per_m = {self.to_params().servo_gain_v_per_m} V/m with this motor rings at"
                f" {math.sqrt(a2) / (2.0 * math.pi):.0f} Hz, below {0.5 / SUBSTEP_S:.0f} Hz is needed"
            )
        return self

    def to_params(self) -> MotorParams:
        gain = self.servo_gain_v_per_m
        return filled(MotorParams, self, servo_gain_v_per_m=SERVO_GAINS_V_PER_M[self.preset] if gain is None else gain)


class LimitsConfig(HandTravelConfig):
    """Limits of the guard in front of the driver."""

    command_deadline_s: float = Field(
        default=deadline_of("haptic/command"),
        ge=1e-6,
        le=10.0,
        description="Greatest age of a command, and of the hand's sample that it answers, at which it is still "
        "followed [s]; beyond it the motor is off",
    )
    max_force_n: float = Field(
        default=10.0,
        ge=1e-12,
        le=1e3,
        description="Largest force reference, for devices with a force mode [N]",
    )

    def to_params(self, *, has_position_mode: bool, has_force_mode: bool) -> SafetyParams:
        return filled(SafetyParams, self, has_position_mode=has_position_mode, has_force_mode=has_force_mode)


class SerialConfig(Settings):
    """A handle on a serial port, in handle protocol 1."""

    port: str = Field(
        min_length=1,
        description="Device file, best one in /dev/serial/by-id, where its name stays the same whenever it is plugged "
        "in",
    )
    baud: int = Field(1_000_000, ge=115_200, le=12_000_000, description="Bits a second; without effect on native USB")
    calibration: str = Field(min_length=1, description="Calibration file of this individual device (handle.yaml)")


_DRIVER: Any = Field(
    default="simulated",
    description="simulated: device and operator below; serial: a real handle; or the driver of a package",
)


class _OwnSections(Settings):
    """The keys of section `haptic_node` that need no package; no driver of a package may be named like one."""

    model_config = ConfigDict(serialize_by_alias=True)

    driver: str = _DRIVER
    serial: SerialConfig | None = Field(default=None, description="The real handle, for driver serial")
    device: DeviceConfig = Field(default=DeviceConfig(), description="The simulated device")
    limits: LimitsConfig = Field(default=LimitsConfig(), description="The guard in front of the device")
    operator: OperatorConfig = Field(
        default=ForceProfileConfig(kind="force_profile"),
        description="The simulated hand; the force profile of Fig. 12 if not given",
    )
    lateral: LateralHandConfig | None = Field(
        default=None,
        description="A simulated hand that moves across the sample, for a device of one axis; none: the device has no "
        "such axes",
    )
    disturbances: HandDisturbanceConfig = Field(
        default=HandDisturbanceConfig(),
        description="Disturbances of the simulated device and hand; all are off by default",
    )
    allow_replay: bool = Field(
        default=False, description="Whether the device obeys commands that come from a recording"
    )

    @property
    def simulated(self) -> bool:
        """Whether the readings depend on the commands alone, so that the node can be run again from a recording."""
        return self.driver == "simulated" or DRIVERS.is_simulated(self.driver)

    @property
    def in_lockstep(self) -> bool:
        """Whether a session without a rig can run the device."""
        driver = DRIVERS.find(self.driver)
        return self.driver == "simulated" if driver is None else driver.in_lockstep

    @property
    def arm(self) -> ArmConstants | None:
        """The constants of the arm of the hand, None for a hand without one.

        >>> path = ({"time_s": 0.0, "position_m": 0.0},)
        >>> HapticConfig.model_validate({"operator": {"kind": "impedance", "arm": "soft", "path": path}}).arm
        ArmConstants(stiffness_n_per_m=50.0, damping_n_s_per_m=5.0, mass_kg=0.15)
        """
        return self.operator.constants if isinstance(self.operator, ImpedanceConfig) else None

    @property
    def lateral_in_force(self) -> LateralHandConfig:
        """The hand across the sample, with its defaults where there is no section."""
        return LateralHandConfig() if self.lateral is None else self.lateral

    @model_validator(mode="after")
    def _serial_is_described(self) -> Self:
        if self.driver == "serial" and self.serial is None:
            raise ValueError("driver: serial needs a section serial with port and calibration")
        DRIVERS.require_section(self, self.driver)
        return self

    @model_validator(mode="after")
    def _limits_inside_travel(self) -> Self:
        if self.driver != "simulated":
            # A real device has its travel in its calibration. The constants of a package's simulated device are checked
            # here.
            if self.in_lockstep:
                try:
                    self.to_simulated_hand()
                except ConfigError as error:
                    raise ValueError(str(error)) from None
            return self
        device, limits = self.device, self.limits
        for name, value in (("position_min_m", limits.position_min_m), ("position_max_m", limits.position_max_m)):
            if not device.position_min_m <= value <= device.position_max_m:
                raise ValueError(
                    f"limits.{name} = {value} m must lie between the end stops of the device at"
                    f" {device.position_min_m} m and {device.position_max_m} m"
                )
        unloaded = device.voltage_limit_v * device.speed_gain_rad_per_s_v * device.screw_m_per_rad
        if limits.max_speed_m_per_s > unloaded:
            raise ValueError(
                f"limits.max_speed_m_per_s = {limits.max_speed_m_per_s} m/s is more than the device can do at"
                f" device.voltage_limit_v = {device.voltage_limit_v} V: {math.floor(unloaded * 1e6) / 1e6} m/s"
            )
        return self

    def to_plant_params(self) -> step.PlantParams:
        return step.PlantParams(self.device.to_params(), self.operator.to_params())

    def to_simulated_hand(self) -> SimulatedHand:
        """Return the simulated device of the driver's package, else that of the paper, with the hand on it.

        Raises:
            ConfigError: The settings of the device do not fit together; the message names the key.
        """
        driver = DRIVERS.find(self.driver)
        if driver is not None and driver.in_lockstep:
            hand: SimulatedHand = driver.model(self)
            return hand
        params = self.to_plant_params()
        return SimulatedHand(params, sim.capabilities(params))

    def to_simulated_device(self) -> DisturbedHaptic:
        """Return the simulated device and its hand as a `HapticDevice`, with the disturbances of the section."""
        hand = self.to_simulated_hand()
        start_m = self.device.start_position_m
        return DisturbedHaptic(hand.params, start_m, self.disturbances, hand.capabilities, hand.about)

    def to_simulated_params(self) -> Any:
        """Return the constants of the simulated device and its hand."""
        return self.to_simulated_hand().params

    def to_params(self, samples: int = 0, period_s: float = 0.0) -> step.HapticParams:
        """Return the constants of guard, device and hand for the compiled step; no simulated device has a force mode.

        Args:
            samples: The length of the run in samples, for which disturbances are drawn; 0 leaves them out.
            period_s: The time from one sample to the next [s], above 0 where there are samples.
        """
        guard = self.limits.to_params(has_position_mode=True, has_force_mode=False)
        plant: Any = self.to_simulated_params()
        if samples > 0 and self.disturbances.any_enabled:
            plant = disturbed_plant_params(self.disturbances, plant, samples, period_s)
        return step.HapticParams(guard, plant)

    def initial_state(self) -> step.HapticStepState:
        """Return the state at start: at rest, off, not latched."""
        return step.initial_state(self.to_simulated_params(), self.device.start_position_m)


_OWN_DRIVERS = ("simulated", "serial")
# Packages may not use the keys of the section.
TAKEN = frozenset({*_OWN_DRIVERS, *_OwnSections.model_fields})
DRIVERS = Drivers("haptic_node", _OWN_DRIVERS, TAKEN, experimental=("serial",))

if TYPE_CHECKING:
    DriverName = str

    class _DriverSections(_OwnSections):
        """The sections of drivers of other packages."""

else:
    DriverName = DRIVERS.name_type()
    _DriverSections = create_model("_DriverSections", __base__=_OwnSections, **DRIVERS.sections())


class HapticConfig(_DriverSections):
    """Section `haptic_node` of a scenario."""

    driver: DriverName = _DRIVER


def recorded_hand(section: Mapping[str, Any], origin: str) -> tuple[OperatorConfig, bool]:
    """Return the simulated hand of a recorded section, and whether its device was simulated.

    The package that has the driver of the section need not be installed.

    Raises:
        ConfigError: The hand cannot be read; the message names the key.
    """
    operator = {key: value for key, value in section.items() if key == "operator"}
    driver = str(section.get("driver", "simulated"))
    try:
        simulated = driver in ("simulated", *SIMULATED_DRIVERS) or DRIVERS.is_simulated(driver)
    except ValueError:
        simulated = False
    return validate(HapticConfig, operator, origin, "haptic_node").operator, simulated


def changed_operator(config: HapticConfig, parameters: Mapping[str, Scalar]) -> HapticConfig:
    """Return settings with another simulated operator, whose section is the JSON text of the parameter `operator`.

    Raises:
        RefusedError: There are further parameters, the text is no such section, or it would begin or end the control by
            a person.
    """
    if others := sorted(set(parameters) - {"operator"}):
        raise RefusedError(f"{others[0]}: cannot be set together with operator")
    try:
        section = json.loads(str(parameters["operator"]))
        changed = validate(HapticConfig, {"operator": section}, "session/control", "haptic_node").operator
    except (ValueError, ConfigError) as error:
        raise RefusedError(f"operator: {error}") from error
    if "interactive" in (changed.kind, config.operator.kind):
        raise RefusedError("operator: a change between a person and a simulated hand needs a new rig")
    return config.model_copy(update={"operator": changed})
