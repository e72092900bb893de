"""What disturbs a real master (paper, 5.1.3): its encoder, its force sensor, and the operator's tremor. All are off.

*Encoder*: the position comes in whole steps, and the velocity is their difference over a sample. *Force sensor*: white
noise. *Tremor*: physiological tremor of a hand is a narrow band around 8 to 12 Hz (R. J. Elble, W. C. Koller, Tremor,
1990); here a resonance of that frequency with a Q of 8, driven by white noise. The screw cannot be driven back, so it
is seen by the force sensor and moves the arm only through the law.
"""

import math
from typing import NamedTuple, cast

from pydantic import Field

from telenano.extend.hands import Capabilities, DeviceReading
from telenano.hand.coupled import CoupledParams
from telenano.hand.sim import SimulatedHaptic
from telenano.hand.step import PlantParams
from telenano.numerics.normal_numbers import normal_number
from telenano.settings.config import Settings

_TREMOR_Q = 8.0


class EncoderConfig(Settings):
    """Quantisation of the position."""

    enabled: bool = Field(False, description="Whether it acts")
    resolution_m: float = Field(1e-6, gt=0.0, le=1e-2, description="Way of the arm for a step [m]; up to 1e-2")


class ForceNoiseConfig(Settings):
    """Noise of the force sensor."""

    enabled: bool = Field(False, description="Whether it acts")
    rms_n: float = Field(0.01, ge=0.0, le=100.0, description="White noise, root mean square of a sample [N]")


class TremorConfig(Settings):
    """Tremor of the operator."""

    enabled: bool = Field(False, description="Whether it acts")
    rms_n: float = Field(0.05, ge=0.0, le=100.0, description="Root mean square of its force [N]")
    frequency_hz: float = Field(9.0, ge=1.0, le=50.0, description="Its frequency [Hz]; 1 to 50")


class HandDisturbanceConfig(Settings):
    """Section `haptic_node.disturbances`."""

    seed: int = Field(0, ge=0, lt=2**63, description="Seed of everything that is random")
    encoder: EncoderConfig = Field(EncoderConfig(), description="Quantisation of the position")
    force_noise: ForceNoiseConfig = Field(ForceNoiseConfig(), description="Noise of the force sensor")
    tremor: TremorConfig = Field(TremorConfig(), description="Tremor of the operator")

    @property
    def any_enabled(self) -> bool:
        return self.encoder.enabled or self.force_noise.enabled or self.tremor.enabled


class HandDisturbanceState(NamedTuple):
    """Last position read [m]; the two components of the tremor, of unit variance; normal numbers used."""

    position_m: float
    tremor: float
    quadrature: float
    drawn: int


class HandDisturbances(NamedTuple):
    """What disturbs a device, and the state of that."""

    config: HandDisturbanceConfig
    state: HandDisturbanceState


def disturbed(
    config: HandDisturbanceConfig, state: HandDisturbanceState, reading: DeviceReading, dt: float
) -> tuple[HandDisturbanceState, DeviceReading]:
    """Return what a disturbed device reads, dt [s] after the last sample."""
    position, velocity = reading.position_m, reading.velocity_m_per_s
    force, drawn = reading.operator_force_n, state.drawn
    tremor, quadrature = state.tremor, state.quadrature
    if config.encoder.enabled:
        step = config.encoder.resolution_m
        position = round(position / step) * step
        velocity = (position - state.position_m) / dt
    if config.force_noise.enabled:
        force += config.force_noise.rms_n * normal_number(config.seed, drawn)
        drawn += 1
    if config.tremor.enabled:
        rate = 2.0 * math.pi * config.tremor.frequency_hz
        kept = math.exp(-rate / (2.0 * _TREMOR_Q) * dt)
        spread = math.sqrt(1.0 - kept * kept)
        c, s = math.cos(rate * dt), math.sin(rate * dt)
        tremor, quadrature = (
            kept * (c * tremor - s * quadrature) + spread * normal_number(config.seed, drawn),
            kept * (s * tremor + c * quadrature) + spread * normal_number(config.seed, drawn + 1),
        )
        drawn += 2
        force += config.tremor.rms_n * tremor
    found = reading._replace(position_m=position, velocity_m_per_s=velocity, operator_force_n=force)
    return HandDisturbanceState(position, tremor, quadrature, drawn), found


class DisturbedHaptic(SimulatedHaptic):
    """The simulated device with its disturbances; while all are off it is the device itself."""

    def __init__(
        self,
        params: PlantParams | CoupledParams,
        start_position_m: float,
        config: HandDisturbanceConfig,
        declared: Capabilities | None = None,
    ) -> None:
        super().__init__(params, start_position_m, declared)
        self.state.disturbed = HandDisturbances(config, HandDisturbanceState(start_position_m, 0.0, 0.0, 0))

    def configure(self, config: HandDisturbanceConfig) -> None:
        """Take other disturbances from now on."""
        self.state.disturbed = self.state.disturbed._replace(config=config)

    @property
    def disturbances(self) -> HandDisturbanceConfig:
        return cast(HandDisturbances, self.state.disturbed).config

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        reading = super().read(session_time_s, dt_s)
        config, state = self.state.disturbed
        if not config.any_enabled:
            return reading
        state, reading = disturbed(config, state, reading, dt_s)
        self.state.disturbed = HandDisturbances(config, state)
        return reading
