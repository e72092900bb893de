"""Section `haptic_node.disturbances`: noise, tremor and other disturbances of a simulated master.

`telenano.hand.disturbances` has their models.
"""

from pydantic import Field

from telenano.settings.config import Settings


class EncoderConfig(Settings):
    """Quantisation of the position."""

    enabled: bool = Field(False, description="Whether the disturbance acts")
    resolution_m: float = Field(
        1e-6, gt=0.0, le=1e-2, description="Displacement of the arm per step of the encoder [m]; up to 1e-2"
    )


class ForceNoiseConfig(Settings):
    """Noise of the force sensor."""

    enabled: bool = Field(False, description="Whether the disturbance acts")
    rms_n: float = Field(0.01, ge=0.0, le=100.0, description="White noise, root mean square of a sample [N]")


class TremorConfig(Settings):
    """Tremor of the operator."""

    enabled: bool = Field(False, description="Whether the disturbance acts")
    rms_n: float = Field(0.05, ge=0.0, le=100.0, description="Root mean square of the tremor's force [N]")
    frequency_hz: float = Field(9.0, ge=1.0, le=50.0, description="Frequency of the tremor [Hz]; 1 to 50")


class WanderConfig(Settings):
    """Wandering of the operator's force."""

    enabled: bool = Field(False, description="Whether the disturbance acts")
    rms_n: float = Field(
        0.03, ge=0.0, le=100.0, description="Root mean square of the wandering force, 1/f from 0.05 to 13 Hz [N]"
    )


class HandDisturbanceConfig(Settings):
    """Section `haptic_node.disturbances`."""

    seed: int = Field(0, ge=0, lt=2**63, description="Seed of all random disturbances")
    encoder: EncoderConfig = Field(EncoderConfig(), description="Quantisation of the position")
    force_noise: ForceNoiseConfig = Field(ForceNoiseConfig(), description="Noise of the force sensor")
    tremor: TremorConfig = Field(TremorConfig(), description="Tremor of the operator")
    wander: WanderConfig = Field(WanderConfig(), description="Wandering of the operator's force")

    @property
    def any_enabled(self) -> bool:
        return self.encoder.enabled or self.force_noise.enabled or self.tremor.enabled or self.wander.enabled

    @property
    def resolution_m(self) -> float:
        """Way of the arm for a step of the encoder [m], 0 without one."""
        return self.encoder.resolution_m if self.encoder.enabled else 0.0
