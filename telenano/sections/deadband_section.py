"""Section `controller.deadband`: the perceptual dead band in front of any law (`telenano.laws.deadband`)."""

from typing import Annotated

from pydantic import Field

from telenano.extend.ranges import parameter
from telenano.laws.deadband import DeadbandParams
from telenano.settings.config import Settings


class DeadbandConfig(Settings):
    """Section `controller.deadband`; floors at the tip's scale, wave at the hand's."""

    enabled: bool = Field(default=False, description="Whether to keep back signals that would not be felt")
    weber_fraction: Annotated[float, Field(ge=0.0, lt=1.0)] = Field(
        default=0.1, description="Least perceptible relative change w; [0, 1)"
    )
    position_resolution_m: float = Field(
        default=5e-11, ge=0.0, le=10.0, description="Least change of a position sent [m]"
    )
    velocity_floor_m_per_s: float = parameter(1e-10, "m/s", "Least change of a velocity [m/s]", zero=True)
    force_floor_n: float = parameter(1e-10, "N", "Least change of a force [N]")
    wave_floor_sqrt_w: float = parameter(1e-3, "sqrt(W)", "Least change of a wave [sqrt(W)]")
    keep_alive_s: Annotated[float, Field(gt=0.0, le=0.04)] = Field(
        default=0.02,
        description="Longest time without a signal [s]; (0, 0.04], because the devices take 0.05 s as silence",
    )

    def to_params(self) -> DeadbandParams:
        return DeadbandParams(
            enabled=self.enabled,
            weber_fraction=self.weber_fraction,
            position_m=self.position_resolution_m,
            velocity_m_per_s=self.velocity_floor_m_per_s,
            force_n=self.force_floor_n,
            wave_sqrt_w=self.wave_floor_sqrt_w,
            keep_alive_s=self.keep_alive_s,
        )
