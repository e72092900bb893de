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

    enabled: bool = Field(default=False, description="Whether it acts")
    x0_m: Place = Field(default=0.0, description="Begin of the line over the sample, x [m]")
    y0_m: Place = Field(default=0.0, description="Begin of the line, y [m]")
    x1_m: Place = Field(default=1e-6, description="End of the line, x [m]: the goal of the tip")
    y1_m: Place = Field(default=0.0, description="End of the line, y [m]")
    stiffness_n_per_m: Spring = Field(default=200.0, description="Spring at the hand [N/m]")
    max_force_n: Force = Field(default=1.5, description="Most that it draws with [N]")


class DiscConfig(Settings):
    """A disc over the sample that the tip does not enter, such as another particle."""

    enabled: bool = Field(default=False, description="Whether it acts")
    x_m: Place = Field(default=0.0, description="Its middle over the sample, x [m]")
    y_m: Place = Field(default=0.0, description="Its middle, y [m]")
    radius_m: Annotated[float, Field(gt=0.0, le=1e-3)] = Field(default=600e-9, description="Its radius [m]")
    stiffness_n_per_m: Spring = Field(default=200.0, description="Spring at the hand [N/m]")
    max_force_n: Force = Field(default=1.5, description="Most that it pushes back with [N]")


class DepthConfig(Settings):
    """The hand is held at the depth that it had when this was switched on."""

    enabled: bool = Field(default=False, description="Whether it acts")
    stiffness_n_per_m: Spring = Field(default=400.0, description="Spring at the hand [N/m]")
    damping_n_s_per_m: Damper = Field(default=20.0, description="Damper at the hand [N s/m]")
    max_force_n: Force = Field(default=3.0, description="Most that it holds with [N]")


class LateralConfig(Settings):
    """Section `controller.lateral`."""

    mode: Literal["direct", "rate", "position"] = Field(
        default="direct",
        description="direct: the place of the hand is that of the tip at the law's position_scale; rate: it is the"
        " velocity of the tip; position: as direct at a scale of its own, with a clutch",
    )
    clutch: Literal["engaged", "released"] = Field(
        default="engaged", description="released: the hand moves freely and the tip stands; not in mode direct"
    )
    rate_per_s: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        default=3e-5, description="Velocity of the tip for a displacement of the hand [1/s]: 3e-5 is 30 nm/s for a mm"
    )
    dead_zone_m: Annotated[float, Field(ge=0.0, le=0.1)] = Field(
        default=1e-3, description="Displacement of the hand within which the tip stands, mode rate [m]"
    )
    speed_m_per_s: Speed = Field(
        default=300e-9, description="Fastest tip in mode rate [m/s]: 10 nm at 30 Hz by Eq. 14 of the paper"
    )
    position_scale: Annotated[float, Field(ge=1e-12, le=1.0)] = Field(
        default=5e-5, description="Way of the tip for one of the hand, mode position: 5e-5 is 1 um for 20 mm"
    )
    position_speed_m_per_s: Speed = Field(default=2e-6, description="Fastest tip in mode position [m/s]")
    force_scale: Annotated[float, Field(ge=1e-3, le=1e15)] = Field(
        default=1e8, description="Force at the hand for the lateral force on the tip: 1e8 is 1 N for 10 nN"
    )
    max_force_n: Force = Field(default=2.0, description="Most that the hand feels across, fixtures included [N]")
    force_rate_n_per_s: Annotated[float, Field(gt=0.0, le=1e6)] = Field(
        default=50.0, description="Fastest change of the lateral force of the tip as it is felt [N/s]"
    )
    centring_n_per_m: Spring = Field(default=30.0, description="Spring to where the tip stands, mode rate [N/m]")
    damping_n_s_per_m: Damper = Field(default=2.0, description="Damper across at the hand [N s/m]")
    pulse_n: Force = Field(default=0.3, description="Pulse that is felt when a particle is met or lost [N]")
    pulse_s: Annotated[float, Field(gt=0.0, le=1.0)] = Field(default=0.02, description="Duration of that pulse [s]")
    contact_n: Annotated[float, Field(gt=0.0, le=1e-3)] = Field(
        default=1e-9, description="Lateral force beyond its noise from which on a particle is met, at the tip [N]"
    )
    lost_way_m: Annotated[float, Field(gt=0.0, le=1e-4)] = Field(
        default=17e-9, description="Way of the tip with less than 0.3 of the force after which it is lost [m]"
    )
    granted_j: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=2e-3,
        description="Energy that may leave across before any has entered [J], half of it along the depth: 1 mJ is what"
        " 0.4 N on an ordinary arm and 1.8 mm down a slope take",
    )
    store_j: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.02, description="Most energy that is kept of what has entered across [J]"
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
