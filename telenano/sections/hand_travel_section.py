"""Travel and speed of the hand's reference, which the guard enforces, and within which the laws lead the hand."""

from typing import Self

from pydantic import Field, model_validator

from telenano.settings.config import Settings


class HandTravelConfig(Settings):
    """Section `controller.hand_limits`, and a part of `haptic_node.limits`."""

    position_min_m: float = Field(default=-0.0045, ge=-1.0, le=1.0, description="Lowest position reference [m]")
    position_max_m: float = Field(default=0.0145, ge=-1.0, le=1.0, description="Highest position reference [m]")
    max_speed_m_per_s: float = Field(
        default=0.03, ge=1e-12, le=10.0, description="Fastest motion of the position reference [m/s]"
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.position_min_m < self.position_max_m:
            raise ValueError(
                f"position_min_m = {self.position_min_m} m must be below position_max_m = {self.position_max_m} m"
            )
        return self
