"""Section `controller.lateral`: how a hand moves the tip across the sample, and what it feels there."""

from typing import Annotated, Literal

from pydantic import Field

from telenano.laws.lateral import DepthParams, DiscParams, FeelParams, GuideParams, LateralParams, MotionParams
from telenano.settings.config import Settings, filled

MODES = ("direct", "rate", "position")
Place = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Spring = Annotated[float, Field(ge=0.0, le=1e5)]
Damper = Annotated[float, Field(ge=0.0, le=1e3)]
Force = Annotated[float, Field(ge=0.0, le=50.0)]
Speed = Annotated[float, Field(gt=0.0, le=1e-3)]


class GuideConfig(Settings):
    """A line over the sample to which the hand is drawn."""

    enabled: bool = Field(default=False, description="Whether the fixture acts")
    x0_m: Place = Field(default=0.0, description="Start of the line over the sample, x [m]")
    y0_m: Place = Field(default=0.0, description="Start of the line, y [m]")
    x1_m: Place = Field(default=1e-6, description="End of the line, x [m]: the goal of the tip")
    y1_m: Place = Field(default=0.0, description="End of the line, y [m]")
    stiffness_n_per_m: Spring = Field(default=200.0, description="Spring at the hand [N/m]")
    max_force_n: Force = Field(default=1.5, description="Greatest force with which the line draws the hand [N]")


class DiscConfig(Settings):
    """A disc over the sample that the tip does not enter, such as another particle."""

    enabled: bool = Field(default=False, description="Whether the fixture acts")
    x_m: Place = Field(default=0.0, description="Middle of the disc over the sample, x [m]")
    y_m: Place = Field(default=0.0, description="Middle of the disc, y [m]")
    radius_m: Annotated[float, Field(gt=0.0, le=1e-3)] = Field(default=600e-9, description="Radius of the disc [m]")
    stiffness_n_per_m: Spring = Field(default=200.0, description="Spring at the hand [N/m]")
    max_force_n: Force = Field(default=1.5, description="Greatest force with which the disc pushes back [N]")


class DepthConfig(Settings):
    """A fixture that holds the hand at the depth that it had when the fixture was switched on."""

    enabled: bool = Field(default=False, description="Whether the fixture acts")
    stiffness_n_per_m: Spring = Field(default=400.0, description="Spring at the hand [N/m]")
    damping_n_s_per_m: Damper = Field(default=20.0, description="Damper at the hand [N s/m]")
    max_force_n: Force = Field(default=3.0, description="Greatest force that holds the hand [N]")


class LateralConfig(Settings):
    """Section `controller.lateral`."""

    mode: Literal["direct", "rate", "position"] = Field(
        default="direct",
        description="direct: the place of the hand sets that of the tip at the law's position_scale; rate: it sets "
        "the velocity of the tip; position: as direct, at a scale of its own and with a clutch",
    )
    clutch: Literal["engaged", "released"] = Field(
        default="engaged", description="released: the hand moves freely and the tip stands still; not in mode direct"
    )
    rate_per_s: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=3e-5, description="Velocity of the tip per displacement of the hand [1/s]: 3e-5 is 30 nm/s for a mm"
    )
    dead_zone_m: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        default=1e-3, description="Displacement of the hand within which the tip stands still, mode rate [m]"
    )
    speed_m_per_s: Speed = Field(
        default=300e-9,
        description="Greatest speed of the tip in mode rate [m/s]: 10 nm at 30 Hz by Eq. 14 of the paper",
    )
    position_scale: Annotated[float, Field(ge=1e-12, le=1.0)] = Field(
        default=5e-5,
        description="Displacement of the tip per displacement of the hand, mode position: 5e-5 is 1 um for 20 mm",
    )
    position_speed_m_per_s: Speed = Field(default=2e-6, description="Greatest speed of the tip in mode position [m/s]")
    force_scale: Annotated[float, Field(ge=1e-3, le=1e15)] = Field(
        default=1e8, description="Force at the hand per lateral force on the tip: 1e8 is 1 N for 10 nN"
    )
    max_force_n: Force = Field(
        default=2.0, description="Greatest force that the hand feels across, fixtures included [N]"
    )
    force_rate_n_per_s: Annotated[float, Field(gt=0.0, le=1e6)] = Field(
        default=50.0, description="Fastest change of the tip's lateral force at the hand [N/s]"
    )
    centring_n_per_m: Spring = Field(
        default=30.0, description="Spring to the place of the hand at which the tip stands still, mode rate [N/m]"
    )
    damping_n_s_per_m: Damper = Field(default=2.0, description="Damper at the hand, across [N s/m]")
    pulse_n: Force = Field(
        default=0.3, description="Force of the pulse that the hand feels when the tip meets or loses a particle [N]"
    )
    pulse_s: Annotated[float, Field(gt=0.0, le=1.0)] = Field(default=0.02, description="Duration of that pulse [s]")
    contact_n: Annotated[float, Field(gt=0.0, le=1e-3)] = Field(
        default=1e-9,
        description="Lateral force on the tip, beyond its noise, from which on a particle counts as met [N]",
    )
    lost_way_m: Annotated[float, Field(gt=0.0, le=1e-4)] = Field(
        default=17e-9,
        description="Way of the tip with less than 0.3 of that force after which the particle counts as lost [m]",
    )
    granted_j: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=2e-3,
        description="Energy that may leave across before any has entered [J], half of it along the depth; 0.4 N on an "
        "ordinary arm and 1.8 mm down a slope take 1 mJ",
    )
    store_j: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.02, description="Greatest amount that is kept of the energy that has entered across [J]"
    )
    guide: GuideConfig = Field(default=GuideConfig(), description="Virtual fixture: a line")
    disc: DiscConfig = Field(default=DiscConfig(), description="Virtual fixture: a wall around a place")
    depth: DepthConfig = Field(default=DepthConfig(), description="Virtual fixture: the depth of the hand")

    def to_params(self) -> LateralParams:
        """Return the constants of the steps."""
        is_rate = self.mode == "rate"
        motion = MotionParams(
            mode=MODES.index(self.mode),
            engaged=self.clutch == "engaged",
            gain=self.rate_per_s if is_rate else self.position_scale,
            dead_zone_m=self.dead_zone_m if is_rate else 0.0,
            speed_m_per_s=self.speed_m_per_s if is_rate else self.position_speed_m_per_s,
        )
        return LateralParams(
            motion,
            filled(FeelParams, self, centring_n_per_m=self.centring_n_per_m if is_rate else 0.0),
            filled(GuideParams, self.guide),
            filled(DiscParams, self.disc),
            filled(DepthParams, self.depth),
        )
