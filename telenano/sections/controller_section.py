"""Configuration of the controller: which law, and the parameters of each."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import ConfigDict, Field, create_model, field_validator, model_validator

from telenano.extend import pass_through
from telenano.extend.laws import LONGEST_BRIDGED_PERIODS, Law, checked_law, longest_pause_periods
from telenano.laws.clamp import ClampParams
from telenano.laws.hand_limits import HandLimits, hand_limits
from telenano.laws.integration import TimingParams
from telenano.laws.lateral import LateralParams
from telenano.sections.clamp_section import ClampConfig
from telenano.sections.deadband_section import DeadbandConfig
from telenano.sections.hand_travel_section import HandTravelConfig
from telenano.sections.lateral_section import LateralConfig
from telenano.sections.own_laws import (
    PASSIVITY,
    POSITION_FORCE,
    TACTILE,
    VIRTUAL_IMPEDANCE,
    WAVE,
    PassivityConfig,
    PositionForceConfig,
    TactileConfig,
    VirtualImpedanceConfig,
    WaveConfig,
)
from telenano.settings.config import Settings, keys_of, merge, nested, package_fields, section_of, validate
from telenano.settings.known_packages import where_it_is
from telenano.settings.plugins import load, refuse
from telenano.wire.errors import ConfigError, RefusedError, known_names
from telenano.wire.messages import Scalar

OWN_LAWS: dict[str, Law] = {law.name: law for law in (VIRTUAL_IMPEDANCE, POSITION_FORCE, WAVE, PASSIVITY)}
_KINDS = {type(law.config().to_params(1e-3)): law.name for law in (*OWN_LAWS.values(), TACTILE)}  # type: ignore[attr-defined]


def _with_own_parameters(name: str, value: Any) -> Law:
    law = checked_law(name, value)
    kind = type(law.config().to_params(1e-3))  # type: ignore[attr-defined]
    # A study selects the compiled step by the class of the parameters, so no two laws may share a class.
    if _KINDS.setdefault(kind, name) != name:
        raise TypeError(
            f"has the same class of parameters, {kind.__name__}, as {_KINDS[kind]}: define a class of its own"
        )
    return law


_LAW: Any = Field(default="virtual_impedance", description="Law in force")


class _OwnSections(Settings):
    """The keys of section `controller` that need no package; no law of a package may be named like one."""

    model_config = ConfigDict(serialize_by_alias=True)

    law: str = _LAW
    period_s: Annotated[float, Field(ge=1e-4, le=0.1)] = Field(
        default=1e-3, description="Period of the hand's samples [s]; if not given, it follows from realtime.rate_hz"
    )
    switch_limit_s: Annotated[float, Field(gt=0.0, le=60.0)] = Field(
        default=2.0, description="Longest wait for the other half when the law changes [s]; after it the hand is let go"
    )
    refused_laws: dict[str, str] = Field(
        default={},
        description="Laws for which the instrument is too slow, with the reason; `telenano up` enters them by the "
        "instrument's driver",
    )
    deadband: DeadbandConfig = Field(default=DeadbandConfig(), description="Dead band in front of any law")
    hand_limits: HandTravelConfig = Field(
        default=HandTravelConfig(),
        description="Travel and speed of the hand, beyond which no law leads it; a key that is not given follows from "
        "haptic_node.limits",
    )
    clamp: ClampConfig = Field(default=ClampConfig(), description="Force clamp of the slave, for any law")
    lateral: LateralConfig = Field(
        default=LateralConfig(), description="Motion of the tip across the sample by the hand"
    )
    virtual_impedance: VirtualImpedanceConfig = Field(
        default=VirtualImpedanceConfig(), description="Parameters of the paper's law"
    )
    position_force: PositionForceConfig = Field(
        default=PositionForceConfig(), description="Parameters of direct force reflection"
    )
    wave: WaveConfig = Field(default=WaveConfig(), description="Parameters of the wave variables")
    passivity: PassivityConfig = Field(default=PassivityConfig(), description="Parameters of passivity control")
    tactile: TactileConfig = Field(default=TactileConfig(), description="Parameters of tactile feedback")

    @field_validator("law", mode="before")
    @classmethod
    def _usable_law(cls, value: Any) -> Any:
        if not isinstance(value, str):
            return value
        refuse(PACKAGE_LAWS, value)
        if value not in KNOWN_LAWS and (where := where_it_is(f"law {value}")):
            raise ValueError(where)
        return value

    @model_validator(mode="before")
    @classmethod
    def _of_installed_laws(cls, given: Any) -> Any:
        """Refuse the section of a law whose package, one of this project's, is not installed, and name the package."""
        for key in given if isinstance(given, dict) else ():
            if key not in keys_of(cls) and (where := where_it_is(f"law {key}")):
                raise ValueError(where)
        return given

    def law_config(self) -> Any:
        """Return the section of the law in force; each has position_scale, force_scale and silence_limit_s."""
        return section_of(self, self.law)

    def params(self) -> Any:
        return self.clamp.applied_to(self.law_config().to_params(self.period_s))

    def clamp_params(self) -> ClampParams:
        """Return the constants of the clamp behind the slave half."""
        section = self.law_config()
        scales = section.position_scale, section.force_scale
        return self.clamp.to_params(section.to_params(self.period_s), *scales, self.period_s)

    def hand_params(self) -> HandLimits:
        """Return the limits of the hand's reference, with the scale of a law that leads the tip by its place."""
        hand, law = self.hand_limits, KNOWN_LAWS[self.law]
        scale = 0.0 if law.uses_waves or law is TACTILE else self.law_config().position_scale
        travel = hand.position_min_m, hand.position_max_m, hand.max_speed_m_per_s
        passes = law.slave_receive is pass_through.slave_receive and not (self.clamp.enabled or self.deadband.enabled)
        return hand_limits(*travel, self.period_s, scale, passes=passes)

    def lateral_params(self) -> LateralParams:
        """Return the constants of the lateral path."""
        return self.lateral.to_params()

    def stiffness_limit_n_per_m(self, late: int = 0, *, even: bool = True) -> float | None:
        """Return the stiffest sample [N/m] that the slave half tolerates; None where it closes no loop of its own.

        Args:
            late: The periods by which the instrument answers late. The loop is an integrator with this dead time: its
                limit is sin(pi / (4 late + 2)) of the one without.
            even: Whether every signal takes the same time over the line. If not, the step that bridges a gap and the
                step of the next signal may both respond to one force, so that forces are 0 to n = late + 1 steps old in
                any order; an integrator then tolerates (3/2 + 1/(2 (n + 1))) / (2 (n + 1)) (L. Berezansky, E.
                Braverman, Advances in Difference Equations 2009, 104310).

        A law of a package states its limit as this project's laws do: `stiffness_limit_n_per_m(period_s)` of its
        settings.
        """
        section, clamp = self.law_config(), self.clamp_params()
        limits = [section.stiffness_limit_n_per_m(self.period_s)] if hasattr(section, "stiffness_limit_n_per_m") else []
        if clamp.enabled:
            limits.append(2.0 / (clamp.force_scale * clamp.reach_m_per_n))
        steps = 2.0 * (late + 2)
        share = math.sin(math.pi / (4 * late + 2)) if even else (1.5 + 1.0 / steps) / steps
        return float(min(limits)) * share if limits else None

    def stiffness_doubts(self, stiffness_n_per_m: float, latency_s: float = 0.0, *, even: bool = True) -> str:
        """Return a sentence on why a sample is too stiff for the law in force; empty where it is not.

        Args:
            stiffness_n_per_m: The stiffness that the base meets [N/m].
            latency_s: The time by which the instrument answers late [s], rounded up to whole periods.
            even: Whether every signal takes the same time over the line.
        """
        prompt, late = self.stiffness_limit_n_per_m(), late_periods(latency_s, self.period_s)
        limit = self.stiffness_limit_n_per_m(late, even=even)
        if prompt is None or limit is None or stiffness_n_per_m <= limit:
            return ""
        behind = f" with an instrument that answers {1e3 * latency_s:.4g} ms late" if late else ""
        behind += "" if even else " over a line that loses or delays signals"
        behind += f" ({prompt:.4g} N/m without that)" if behind else ""
        remedy = "an instrument that answers sooner" if late else "a smaller controller.period_s"
        return (
            f"law {self.law}: {stiffness_n_per_m:g} N/m is stiffer than the {limit:.4g} N/m that its slave half "
            "tolerates"
            f"{behind}, beyond which the force swings and the sample gets energy that no hand has paid;"
            f" {remedy}, a greater damper of the half, or a smaller force_scale times position_scale raises that"
        )

    @property
    def local_loop(self) -> bool:
        """Whether the slave half also steps between signals, on the instrument's clock."""
        return KNOWN_LAWS[self.law].local_loop or self.clamp_params().enabled

    def master_timing(self) -> TimingParams:
        """Return the constants of the timing of the master half."""
        return TimingParams(round(1e9 * self.period_s), LONGEST_BRIDGED_PERIODS, 0)

    def slave_timing(self) -> TimingParams:
        """Return the timing constants of the slave half; a local loop goes on by itself up to the silence limit."""
        silence_s = self.law_config().silence_limit_s
        longest, local_ns = longest_pause_periods(silence_s, self.period_s), round(1e9 * silence_s)
        return TimingParams(round(1e9 * self.period_s), longest, local_ns if self.local_loop else 0)


class _Laws(dict[str, Law]):
    """The laws by name; an unknown name raises a ConfigError that lists the known ones, or names its package."""

    def __missing__(self, name: str) -> Law:
        refused = PACKAGE_LAWS.problems.get(name) or where_it_is(f"law {name}")
        raise ConfigError(refused or f"unknown law {name!r}: {known_names(name, self)}; `telenano new law` makes one")


def late_periods(latency_s: float, period_s: float) -> int:
    """Return the latency of an instrument in periods, rounded up to whole ones."""
    return math.ceil(latency_s / period_s - 1e-9)


# Packages may not use the keys of the section. Laws of installed packages have the entry point `telenano.laws`.
TAKEN = frozenset({*OWN_LAWS, *_OwnSections.model_fields})
PACKAGE_LAWS = load("laws", _with_own_parameters, TAKEN)
LAWS: dict[str, Law] = _Laws({**OWN_LAWS, **PACKAGE_LAWS.found})
# Under the tactile law the hand follows the surface and does not move the tip, so that there is no loop to study.
KNOWN_LAWS: dict[str, Law] = {**LAWS, TACTILE.name: TACTILE}

if TYPE_CHECKING:
    LawName = str

    class _LawSections(_OwnSections):
        """The sections of laws of other packages."""

else:
    LawName = Literal[tuple(KNOWN_LAWS)]
    _LawSections = create_model(
        "_LawSections",
        __base__=_OwnSections,
        **package_fields(
            {
                name: (law.config, law.config(), f"Parameters of the law {name}")
                for name, law in PACKAGE_LAWS.found.items()
            }
        ),
    )


class ControllerConfig(_LawSections):
    """Section `controller` of a scenario, read by both halves of the law."""

    law: LawName = _LAW


def changed_config(config: ControllerConfig, parameters: Mapping[str, Scalar]) -> ControllerConfig:
    """Return a configuration with some parameters, given by dotted key, changed; RefusedError says which is wrong."""
    if not parameters:
        raise RefusedError("set needs parameters, such as virtual_impedance.force_gain=10")
    if "period_s" in parameters:
        raise RefusedError("controller.period_s cannot be changed while the rig runs")
    if any(key.partition(".")[0] == "refused_laws" for key in parameters):
        raise RefusedError(
            "controller.refused_laws follows from the instrument, which stays the same while the rig runs"
        )
    try:
        document = merge(config.model_dump(), nested(parameters, "session/control"))
        return validate(ControllerConfig, document, "session/control", "controller")
    except ConfigError as error:
        raise RefusedError(str(error)) from error
