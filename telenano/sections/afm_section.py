"""Configuration of the AFM: cantilever, tip and sample (Table 2 of the paper), limits.

Every default is a value of Table 2 or, where the paper gives none, a value that does not change its Fig. 12.
"""

import math
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import ConfigDict, Field, create_model, model_validator

from telenano.afm.cantilever import Plant, build_plant
from telenano.afm.contact.friction import FrictionParams, adhesion_n
from telenano.afm.contact.maugis_dugdale import reduced_modulus_pa
from telenano.afm.contact.tip_sample import AS_PRINTED, CONSISTENT, TipSampleProperties, build_tip_sample, hamaker_of
from telenano.afm.layers import Ground, Height
from telenano.afm.safety import way_s
from telenano.afm.sample.surface import PLANE, Surface
from telenano.afm.sample_models import checked_sample
from telenano.afm.spring import spring_params
from telenano.afm.step import AfmParams
from telenano.extend.instruments import SafetyParams
from telenano.extend.maps import OverMap, Span
from telenano.extend.stage import LateralParams
from telenano.sections.afm_parts import (
    MOST_CONTRADICTION,
    CantileverConfig,
    FrictionConfig,
    LateralConfig,
    ModbusConfig,
    SafetyConfig,
    SpringConfig,
    TipSampleConfig,
    TorsionConfig,
)
from telenano.sections.feel_section import FeelConfig
from telenano.sections.program_requests import InstrumentRequest
from telenano.sections.program_table import PROGRAMS
from telenano.sections.sample_maps import over_map
from telenano.sections.sample_section import SampleConfig, layers_on
from telenano.settings.afm_disturbances import DisturbanceConfig
from telenano.settings.config import Settings, filled, section_of
from telenano.settings.device_drivers import Drivers
from telenano.settings.entries import Entries
from telenano.settings.plugins import installed
from telenano.wire.errors import ConfigError
from telenano.wire.extras import missing

if TYPE_CHECKING:
    from telenano.afm.dynamic_plant import DynamicPlant

# Placing the tip takes this number of round trips over the link.
_PLACING_ROUND_TRIPS = 4.0
# Both halves of the law and the hand have started after this time [s], even at the slowest rate of the rig.
_BEGINNING_S = 0.05
# The table of contact forces extends to this multiple of the force limit, so that it still covers an overshoot.
_TABLE_REACH = 2.0

_PLANE_M = 150e-9
# Each of the node's 1000 steps a second simulates whole periods of the cantilever, eight or more.
_LEAST_RESONANCE_HZ = 8e3

_DRIVER: Any = Field(
    "simulated",
    description="simulated: the instrument described below; modbus: a real one, with the limits in safety as its "
    "guard; or the driver of a package.",
)
_ENVIRONMENT: Any = Field(
    "tip_sample",
    description="Environment that the tip meets: the sample, a linear spring on the base, or a sample of another "
    "package.",
)


class _OwnSections(Settings):
    """The keys of section `afm_node` that need no package; no driver or sample of a package may be named like one."""

    model_config = ConfigDict(serialize_by_alias=True)

    driver: str = _DRIVER
    modbus: ModbusConfig | None = Field(None, description="The real instrument, for driver modbus.")
    attended: bool = Field(
        False,
        description="Whether a person stands by to retract the tip of an AFM controller, instead of a guard "
        "(`telenano device guard`).",
    )
    environment: str = _ENVIRONMENT
    spring: SpringConfig = Field(SpringConfig(), description="The spring, for environment spring.")
    cantilever: CantileverConfig = Field(CantileverConfig(), description="Spring and read-out of the cantilever.")
    tip_sample: TipSampleConfig = Field(TipSampleConfig(), description="Tip, sample and the water between them.")
    model: Literal["quasi_static", "dynamic"] = Field(
        "quasi_static",
        description="Model of the cantilever: k zeta = F(h); or Eq. 4 in full, which needs numba and processor time.",
    )
    mode: Literal["consistent", "as_printed"] = Field(
        "consistent", description="Reading of the force law: errata E3, E4, E7 corrected, or Eq. 4 and 6 to the letter."
    )
    meniscus: bool = Field(True, description="Whether water forms a meniscus between tip and sample.")
    sample: SampleConfig | None = Field(
        None, description="Sample under the tip, as `telenano sample` makes it; none: a plane at height 0."
    )
    lateral: LateralConfig = Field(LateralConfig(), description="Limits of the lateral stage.")
    disturbances: DisturbanceConfig = Field(
        DisturbanceConfig(), description="Disturbances of a simulated instrument; all are off by default."
    )
    begin: InstrumentRequest | None = Field(
        None,
        description="Program that begins when the instrument is armed, with the keys of `set`; none: it follows "
        "commands.",
    )
    feel: FeelConfig | None = Field(
        None,
        description="A measured channel that the hand feels instead of the force, through a table; none: the force.",
    )
    friction: FrictionConfig = Field(FrictionConfig(), description="Friction, and torsion of the cantilever.")
    torsion: TorsionConfig = Field(TorsionConfig(), description="Measurement of the lateral force, errors included.")
    rest_distance_m: float = Field(
        10e-9, gt=0.0, le=1e-4, description="Tip-sample distance L with the base at 0 and no force [m]."
    )
    safety: SafetyConfig = Field(SafetyConfig(), description="Limits of base, tip force and command age.")
    allow_replay: bool = Field(False, description="Whether the AFM obeys commands that come from a recording.")

    @property
    def simulated(self) -> bool:
        """Whether the readings depend on the commands alone, so that the node can be run again from a recording."""
        return self.driver == "simulated" or DRIVERS.is_simulated(self.driver)

    @property
    def stiffest_n_per_m(self) -> float | None:
        """The greatest stiffness that the base can meet [N/m]; None where the settings do not determine it.

        A sample is felt through the cantilever, and so never feels stiffer than the cantilever.
        """
        if not self.simulated:
            return None
        if self.package_sample is not None:
            return getattr(self.package_sample, "stiffness_n_per_m", None)
        return self.spring.stiffness_n_per_m if self.environment == "spring" else self.felt_through_n_per_m

    @property
    def package_sample(self) -> Any:
        """The settings of the sample of a package that is in the place of cantilever and tip; None without one."""
        sample = SAMPLES.find(self.environment)
        return None if sample is None else section_of(self, sample.name) or sample.config()

    @property
    def felt_through_n_per_m(self) -> float:
        """Stiffness of the cantilever [N/m]; over a recorded map, of the one that measured it, if the map states it."""
        span = self.map_span
        return (0.0 if span is None else span.stiffness_n_per_m) or self.cantilever.stiffness_n_per_m

    @property
    def map_span(self) -> Span | None:
        """Extent, stiffness and quantity of the recorded map; None without one, or if it cannot be read here."""
        return None if self.sample is None else self.sample.map_span

    def doubts(self) -> str:
        """Return a warning if H and the work of adhesion contradict each other, which can be simulated; else ''."""
        t = self.tip_sample
        ratio = t.hamaker_j / hamaker_of(t.work_of_adhesion_j_per_m2)
        if 1.0 / MOST_CONTRADICTION <= ratio <= MOST_CONTRADICTION:
            return ""
        belongs = hamaker_of(t.work_of_adhesion_j_per_m2)
        return (
            f"tip_sample.hamaker_j = {t.hamaker_j:.3g} J and tip_sample.work_of_adhesion_j_per_m2 ="
            f" {t.work_of_adhesion_j_per_m2:.3g} J/m^2 contradict each other by a factor of"
            f" {max(ratio, 1.0 / ratio):.2g}: by H = 12 pi D0^2 omega that work of adhesion belongs to {belongs:.3g} J"
        )

    @model_validator(mode="after")
    def _begins_at_rest(self) -> Self:
        """Move the retracted position to the rest position of a spring that also pulls.

        At the default position, 100 nm away, such a spring would pull the hand with tens of newtons.
        """
        safety, spring = self.safety, self.spring
        if self.environment != "spring" or not spring.bilateral or "retract_position_m" in safety.model_fields_set:
            return self
        if self.driver == "simulated" and safety.base_min_m <= spring.rest_position_m < safety.base_max_m:
            moved = safety.model_copy(update={"retract_position_m": spring.rest_position_m})
            object.__setattr__(self, "safety", moved)
        return self

    @model_validator(mode="after")
    def _buildable(self) -> Self:
        if self.driver == "modbus" and self.modbus is None:
            raise ValueError("driver: modbus needs a section modbus with calibration")
        DRIVERS.require_section(self, self.driver)
        if self.begin is not None and self.begin.program not in PROGRAMS:
            raise ValueError(f"begin.program: must be one of {', '.join(PROGRAMS)}, not {self.begin.program}")
        if self.model == "dynamic":
            self._check_dynamic()
        for layer, settings in layers_on(self.sample):
            self._check_layer(layer.name, layer.height(settings))
        if self.sample is not None and self.sample.map is not None:
            self._check_map(self.sample.map)
        if self.torsion != TorsionConfig():
            self._check_torsion()
        return self

    @model_validator(mode="after")
    def _has_model(self) -> Self:
        # Some combinations have no model (E7): build the parameters here, so that reading the file fails and not the
        # first step.
        self.to_params()
        return self

    def _check_dynamic(self) -> None:
        if self.driver != "simulated" or self.environment != "tip_sample":
            raise ValueError("model: dynamic is for driver simulated and environment tip_sample")
        if self.mode != "consistent":
            raise ValueError("model: dynamic has no mode as_printed, whose meniscus pulls at any distance (E3)")
        if self.cantilever.resonance_hz < _LEAST_RESONANCE_HZ:
            raise ValueError(
                f"model: dynamic needs cantilever.resonance_hz of {_LEAST_RESONANCE_HZ:g} Hz or more: eight periods"
                f" in a step of the node, not {self.cantilever.resonance_hz:g} Hz"
            )

    def _check_layer(self, layer: str, above: Height) -> None:
        if self.driver != "simulated" or self.environment != "tip_sample":
            raise ValueError(f"sample.{layer}: a layer is for driver simulated and environment tip_sample")
        needed = self.rest_distance_m - above.clear_m
        for name, base_m in (
            ("retract_position_m", self.safety.retract_position_m),
            ("base_min_m", self.safety.base_min_m),
        ):
            if base_m > needed:
                raise ValueError(
                    f"safety.{name} = {base_m:g} m does not clear {above.what}: it must be"
                    f" {math.floor(needed * 1e9) * 1e-9:.4g} m or less"
                )

    def _check_torsion(self) -> None:
        if self.driver != "simulated" or self.environment != "tip_sample":
            raise ValueError("torsion is for driver simulated and environment tip_sample")
        if self.torsion.most_n <= self.safety.lateral_limit_n:
            raise ValueError(
                f"torsion.factor_n_per_v times torsion.range_v = {self.torsion.most_n:g} N must be above"
                f" safety.lateral_limit_n = {self.safety.lateral_limit_n:g} N, or the guard never sees that limit"
            )

    def _check_map(self, path: str) -> None:
        """Raise ValueError where the settings and the recorded map contradict each other."""
        if self.driver != "simulated" or self.environment != "tip_sample" or self.model != "quasi_static":
            raise ValueError("sample.map is for driver simulated, environment tip_sample and model quasi_static")
        if self.friction.coefficient > 0.0:
            raise ValueError("sample.map has the recorded forces alone: leave friction out")
        span, k = self.map_span, self.cantilever.stiffness_n_per_m
        if span is None:
            return
        is_stiffness_set = span.stiffness_n_per_m and "stiffness_n_per_m" in self.cantilever.model_fields_set
        if is_stiffness_set and not math.isclose(span.stiffness_n_per_m, k, rel_tol=1e-3):
            raise ValueError(
                f"cantilever.stiffness_n_per_m = {k:g} N/m contradicts sample.map {path}, which was measured with"
                f" {span.stiffness_n_per_m:g} N/m: leave it out"
            )
        if span.quantity != "force" and (self.feel is None or self.feel.channel != span.quantity):
            raise ValueError(
                f"sample.map {path} has {span.quantity} and no forces: feel.channel must be {span.quantity}, with the"
                " table that makes a force of it"
            )

    def to_guard(self) -> SafetyParams:
        """Return the limits of the guard; over a recorded map, the range of the base is at most that of the map.

        Raises:
            ValueError: The retracted base does not lie within the map; the message names the keys.
        """
        s, span, rest_m = self.safety, self.map_span, self.rest_distance_m
        limits = SafetyParams(**s.model_dump())
        if span is None:
            return limits
        set_keys, low, high = s.model_fields_set, rest_m - span.high_m, rest_m - span.low_m
        low = max(low, s.base_min_m) if "base_min_m" in set_keys else low
        high = min(high, s.base_max_m) if "base_max_m" in set_keys else high
        retracted = s.retract_position_m if "retract_position_m" in set_keys else low
        if not low <= retracted < high:
            raise ValueError(
                f"sample.map: with rest_distance_m = {rest_m:g} m the map is for a base from {rest_m - span.high_m:g}"
                f" to {rest_m - span.low_m:g} m, in which safety.base_min_m, base_max_m and retract_position_m ="
                f" {retracted:g} m leave the tip no room to move"
            )
        return limits._replace(base_min_m=low, base_max_m=high, retract_position_m=retracted)

    def to_over_map(self) -> OverMap:
        """Return the recorded map under the tip as the parameters of a step; its text states the range of the tip.

        Raises:
            ConfigError: The map cannot be used, or its package is missing.
        """
        assert self.sample is not None and self.sample.map is not None
        c, limits, (x_m, y_m) = self.cantilever, self.to_guard(), self.places_m
        sample = over_map(Path(self.sample.map), self.rest_distance_m, c.stiffness_n_per_m, c.volts_per_m)
        text = (
            f"recorded map {sample.about}; the tip stays within x ± {x_m:.3g} m, y ± {y_m:.3g} m and with its base from"
            f" {limits.base_min_m:.3g} to {limits.base_max_m:.3g} m"
        )
        return sample._replace(about=text)

    def to_lateral_params(self) -> LateralParams:
        return LateralParams(self.lateral.reach_m, self.lateral.speed_m_per_s)

    @property
    def places_m(self) -> tuple[float, float]:
        """Greatest distance of the tip from the middle in x and in y [m], as limited by the stage and by the map."""
        reach_m, span = self.lateral.reach_m, self.map_span
        return (reach_m, reach_m) if span is None else (min(reach_m, span.half_x_m), min(reach_m, span.half_y_m))

    def to_friction_params(self) -> FrictionParams:
        f = self.friction
        # Without friction the adhesion is not needed, and it takes a while to find.
        pull_n = adhesion_n(self.to_params().plant.tip) if f.coefficient > 0.0 else 0.0
        return FrictionParams(f.coefficient, pull_n, f.lateral_stiffness_n_per_m, f.tip_height_m)

    def to_surface(self) -> Surface | None:
        """Return the sample dilated by the sphere of the tip; None for a plane or a recorded map.

        Raises:
            ConfigError: The surface cannot be made; the message says what is wrong with it.
        """
        if self.sample is None or self.sample.map is not None:
            return None
        try:
            return self.sample.build().dilated(self.tip_sample.tip_radius_m)
        except ValueError as error:
            raise ConfigError(f"afm_node.sample: {error}") from error

    def sample_sides_m(self) -> tuple[float, float]:
        """Return width and depth of the sample [m]; for a plane, those of a default image."""
        if self.sample is None:
            return _PLANE_M, _PLANE_M
        if (span := self.map_span) is not None:
            return 2.0 * span.half_x_m, 2.0 * span.half_y_m
        surface = self.sample.build()
        return surface.width_m, surface.depth_m

    def measured_by_torsion(self, part: Any) -> Any:
        """Wrap the parameters of a part in those of the torsion channel; unchanged if that has its defaults."""
        return part if self.torsion == TorsionConfig() else self.torsion.around(part, self.cantilever.stiffness_n_per_m)

    def with_layers(self, part: Any, surface: Surface | None) -> Any:
        """Wrap the parameters of a part over a surface in those of each layer on the sample; unchanged without layers.

        Raises:
            ConfigError: A layer cannot lie there, or something that it needs is not installed.
        """
        for layer, settings in layers_on(self.sample):
            plant = self.to_params().plant
            seen = PLANE if surface is None or not surface.height_m.any() else surface
            ground = Ground(
                surface=seen,
                is_plane=seen is PLANE,
                sides_m=self.sample_sides_m(),
                tip_radius_m=self.tip_sample.tip_radius_m,
                stiffness_n_per_m=plant.stiffness_n_per_m,
                lateral_n_per_m=self.friction.lateral_stiffness_n_per_m,
                rest_distance_m=plant.rest_distance_m,
                volts_per_m=plant.volts_per_m,
            )
            try:
                part = layer.around(settings, part, ground)
            except ImportError as error:
                raise ConfigError(f"afm_node.sample.{layer.name}: {missing(error.name or str(error))}") from error
            except ValueError as error:
                raise ConfigError(f"afm_node.sample.{error}") from error
        return part

    def to_spring_params(self) -> AfmParams:
        """Return the parameters of the linear environment behind the same guard."""
        guard, spring = self.to_params().safety, self.spring
        return AfmParams(guard, spring_params(spring.stiffness_n_per_m, spring.rest_position_m, spring.bilateral))

    def to_sample_params(self) -> AfmParams:
        """Return the parameters of the sample of another package behind the same guard."""
        return AfmParams(self.to_guard(), self.package_sample.to_params())

    def to_dynamic(
        self,
        drive_hz: float | None = None,
        steps_per_period: int | None = None,
        temperature_k: float = 0.0,
        like: "DynamicPlant | None" = None,
        finest: int | None = None,
    ) -> "DynamicPlant":
        """Return the cantilever with its dynamics (Eq. 4), driven at drive_hz [Hz] or at its resonance.

        Args:
            drive_hz: The frequency of the drive [Hz]; None takes the resonance.
            steps_per_period: The steps in a period of the drive; None takes the configured number.
            temperature_k: The temperature of thermal noise [K]; 0 switches it off.
            like: A dynamic cantilever of this configuration, whose grid of the force is reused.
            finest: The most steps in a period where steps are divided because the tip meets the sample; None takes
                FINEST.

        Raises:
            ValueError: No model exists for these values; the message names value and unit.
        """
        # Imported here, so that a node without dynamics does not load it.
        from telenano.afm.dynamic_plant import FINEST, Damping, build_dynamic

        c, t = self.cantilever, self.tip_sample
        damping = Damping(t.liquid_viscosity_pa_s, t.liquid_thickness_m, t.sample_viscosity_pa_s, t.sample_thickness_m)
        drive = c.resonance_hz if drive_hz is None else drive_hz
        plant, steps = self.to_params().plant, steps_per_period or c.steps_per_period
        return build_dynamic(
            plant, c.resonance_hz, c.quality, drive, damping, steps, temperature_k, like, finest or FINEST
        )

    def to_params(self) -> AfmParams:
        """Return the parameters of the pure step; `_plant` caches the cantilever by its values.

        Raises:
            ValueError: No model exists for these values; the message names value and unit.
        """
        t, c, s = self.tip_sample, self.cantilever, self.safety
        properties = filled(
            TipSampleProperties,
            t,
            radius_m=t.tip_radius_m,
            reduced_modulus_pa=reduced_modulus_pa(
                t.tip_modulus_pa, t.tip_poisson, t.sample_modulus_pa, t.sample_poisson
            ),
            meniscus_radius_m=t.effective_meniscus_radius_m,
            reading=AS_PRINTED if self.mode == "as_printed" else CONSISTENT,
            meniscus=self.meniscus,
        )
        reach_n = _TABLE_REACH * s.force_limit_n
        plant = _plant(properties, reach_n, c.stiffness_n_per_m, self.rest_distance_m, c.volts_per_m)
        return AfmParams(self.to_guard(), plant)

    def to_lockstep_params(self, origin: str, duration_s: float) -> AfmParams:
        """Return the parameters of the instrument that a node would simulate, for a run of duration_s [s].

        Raises:
            ConfigError: A lockstep cannot run this instrument; the message names `origin` and the key.
        """
        from telenano.afm.over_surface import over_surface

        if self.feel is not None:
            raise ConfigError(
                f"{origin}: afm_node.feel: a lockstep renders the force of the tip only; `telenano up` can run it"
            )
        params = self.to_params()
        # The disturbances act on the cantilever through which the force on the tip is read.
        cantilever, is_gauged = params.plant, self.package_sample is not None or self.environment == "spring"
        if is_gauged:
            params = self.to_spring_params() if self.environment == "spring" else self.to_sample_params()
        elif self.sample is not None and self.sample.map is not None:
            over = self.to_over_map()
            cantilever = cantilever._replace(stiffness_n_per_m=over.stiffness_n_per_m)
            params = params._replace(plant=over.params)
        else:
            surface = self.to_surface()
            plant = over_surface(cantilever, surface, self.to_friction_params())
            params = params._replace(plant=self.with_layers(plant, surface))
        noisy = self.with_noise(params.plant, cantilever, duration_s, is_gauged=is_gauged)
        return params._replace(plant=noisy)

    def with_noise(self, part: Any, cantilever: Plant, duration_s: float, *, is_gauged: bool = False) -> Any:
        """Wrap the parameters of a part in disturbances drawn in advance for a run; unchanged if none is enabled.

        Args:
            part: The parameters of the part whose force the cantilever reads.
            cantilever: The cantilever on which the disturbances act.
            duration_s: The length of the run [s].
            is_gauged: Whether the part gives a force without a deflection, as a spring does.
        """
        from telenano.afm.disturbed import noisy_params

        if not self.disturbances.any_enabled:
            return part
        return noisy_params(self.disturbances, cantilever, duration_s, part, is_gauged=is_gauged)

    def time_to_place_s(self, round_trip_s: float, reference_m: float = 0.0) -> float:
        """Return the time before a session [s] in which the tip is moved to reference_m [m], over a link [s].

        >>> round(AfmConfig().time_to_place_s(0.060), 3)
        0.34
        """
        limits = self.to_guard()
        # Placing ends at the rest point; a hand beyond it is let in from there afterwards.
        placing_s = way_s(limits, limits.retract_position_m, min(reference_m, 0.0))
        return placing_s + _PLACING_ROUND_TRIPS * round_trip_s + _BEGINNING_S


# The drivers and the environments that need no package.
_OWN_DRIVERS = ("simulated", "modbus")
_OWN_ENVIRONMENTS = ("tip_sample", "spring")
# Packages may not use the keys of the section.
TAKEN = frozenset({*_OWN_DRIVERS, *_OWN_ENVIRONMENTS, *_OwnSections.model_fields})
SAMPLES = Entries("samples", "sample", checked_sample, TAKEN, _OWN_ENVIRONMENTS)
# A sample and a driver of one name would have one section.
_TAKEN_BY_SAMPLES = {name for name in installed("devices") if name in SAMPLES.names and SAMPLES.is_usable(name)}
DRIVERS = Drivers("afm_node", _OWN_DRIVERS, TAKEN | _TAKEN_BY_SAMPLES, experimental=("modbus",))

if TYPE_CHECKING:
    DriverName = str
    EnvironmentName = str

    class _PackageSections(_OwnSections):
        """The sections of drivers and samples of other packages."""

else:
    DriverName = DRIVERS.name_type()
    EnvironmentName = SAMPLES.name_type()
    _PackageSections = create_model(
        "_PackageSections", __base__=_OwnSections, **(SAMPLES.sections() | DRIVERS.sections())
    )


class AfmConfig(_PackageSections):
    """An AFM over a sample: simulated, or a real one."""

    driver: DriverName = _DRIVER
    environment: EnvironmentName = _ENVIRONMENT


class RecordedAfmConfig(AfmConfig):
    """The AFM of a session that ran: its model was built then, and who reads the recording needs only its settings."""

    @model_validator(mode="after")
    def _has_model(self) -> Self:
        return self


# Cached, because a configuration is built when it is read and again by the process that runs it.
@lru_cache(maxsize=16)
def _plant(
    properties: TipSampleProperties, reach_n: float, stiffness_n_per_m: float, rest_m: float, volts: float
) -> Plant:
    return build_plant(build_tip_sample(properties, reach_n), stiffness_n_per_m, rest_m, volts)
