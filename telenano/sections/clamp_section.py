"""Section `controller.clamp`: the force clamp of the slave (`telenano.laws.clamp`)."""

from typing import Any

from pydantic import Field

from telenano.extend.ranges import parameter
from telenano.laws.clamp import NO_LIMIT_N, ClampParams
from telenano.settings.config import Settings


class ClampConfig(Settings):
    """Section `controller.clamp`."""

    enabled: bool | None = Field(
        default=None,
        description="Whether the slave's force is limited to that of the hand; none: as the law defines it",
    )
    force_margin_n: float = parameter(
        0.1, "N", "Force by which the tip may press harder than the hand, at the hand's scale F_0 [N]"
    )
    damping_n_s_per_m: float = parameter(30.0, "N s/m", "Damper B_g of the clamp, at the hand's scale [N s/m]")

    def applied_to(self, params: Any) -> Any:
        """Return the constants of a law with its own clamp switched by `enabled`; unchanged if it has none."""
        if self.enabled is None or not hasattr(params, "margin_n"):
            return params
        if hasattr(params, "clamped"):
            return params._replace(clamped=self.enabled, margin_n=self.force_margin_n)
        return params if self.enabled else params._replace(margin_n=NO_LIMIT_N)

    def to_params(self, law_params: Any, position_scale: float, force_scale: float, period_s: float) -> ClampParams:
        """Return the constants of the clamp behind a law; it is off behind a law with a clamp of its own."""
        enabled = bool(self.enabled) and not hasattr(law_params, "margin_n")
        reach = position_scale * period_s / self.damping_n_s_per_m
        return ClampParams(enabled, force_scale, reach, self.force_margin_n)
