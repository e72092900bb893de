"""Disturbances of a real master (paper, 5.1.3): encoder, force sensor, and tremor of the operator. By default all off.

*Encoder*: the position comes in whole steps, and the velocity is their difference over a sample. *Force sensor*: white
noise. *Tremor*: physiological tremor of a hand is a narrow band around 8 to 12 Hz (R. J. Elble, W. C. Koller, Tremor,
1990); here a resonance of that frequency with a Q of 8, driven by white noise. *Wander*: the errors of a hand that
holds a force grow towards low frequencies (G. G. Sutton, K. Sykes, J. Physiol. 190 (1967) 281, between 0.4 and 9 Hz);
here 1/f noise from 0.05 to 13 Hz, while the session runs. Both are forces added to that of any model of the hand. The
screw cannot be driven back, so the force sensor measures them, and they move the arm only through the law. At a device
of impedance type they are added to the force of its coupling, and do not push its mass.

A node draws them step by step; a session in lockstep draws them for its whole run beforehand, with the same step.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from telenano.extend.hands import Capabilities, DeviceReading
from telenano.hand.sim import SimulatedHaptic
from telenano.hand.step import DisturbedPlantParams, disturbed_reading
from telenano.numerics.normal_numbers import normal_number
from telenano.numerics.sines import sine_noise, sines_of
from telenano.settings.hand_disturbances import HandDisturbanceConfig

Series = npt.NDArray[np.float64]

_TREMOR_Q = 8.0
# Lowest frequency of the wander [Hz].
_WANDER_LOW_HZ = 0.05
# Highest frequency of the wander [Hz]: muscles do not answer above it.
_WANDER_HIGH_HZ = 13.0
# Random stream of the wander, other than that of the vibration of an instrument with the same seed.
_WANDER = 2


class HandDisturbanceState(NamedTuple):
    """Last position read [m]; the two components of the tremor, of unit variance; normal numbers used."""

    position_m: float
    tremor: float
    quadrature: float
    drawn: int


class HandDisturbances(NamedTuple):
    """The settings of the disturbances of a device, and their state."""

    config: HandDisturbanceConfig
    state: HandDisturbanceState


def hand_noise_step(
    config: HandDisturbanceConfig, state: HandDisturbanceState, dt: float
) -> tuple[HandDisturbanceState, float]:
    """Return the state and the sum of sensor noise and tremor [N], drawn dt [s] after the last sample."""
    force, drawn, tremor, quadrature = 0.0, state.drawn, state.tremor, state.quadrature
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
    return HandDisturbanceState(state.position_m, tremor, quadrature, drawn), force


def wander_n(config: HandDisturbanceConfig, session_time_s: float) -> float:
    """Return the wander of the force of the hand [N] at a time of the session [s]; 0 before the session starts."""
    if not config.wander.enabled or session_time_s < 0.0:
        return 0.0
    sines = sines_of(config.seed, _WANDER, _WANDER_LOW_HZ, _WANDER_HIGH_HZ)
    return sine_noise(sines, config.wander.rms_n, session_time_s)


def disturbed(
    config: HandDisturbanceConfig, state: HandDisturbanceState, reading: DeviceReading, session_time_s: float, dt: float
) -> tuple[HandDisturbanceState, DeviceReading]:
    """Return the state and the disturbed reading at a time of the session [s], dt [s] after the last sample."""
    after, force_n = hand_noise_step(config, state, dt)
    force_n += wander_n(config, session_time_s)
    reading_disturbed = disturbed_reading(reading, config.resolution_m, state.position_m, force_n, dt)
    return after._replace(position_m=reading_disturbed.position_m), reading_disturbed


def disturbed_plant_params(
    config: HandDisturbanceConfig, plant: Any, samples: int, period_s: float
) -> DisturbedPlantParams:
    """Draw the disturbances of a run of `samples` samples, one a period_s [s], from the seed of `config` alone."""
    return DisturbedPlantParams(plant, *_drawn(config, samples, period_s), config.resolution_m)


@lru_cache(maxsize=8)
def _drawn(config: HandDisturbanceConfig, samples: int, period_s: float) -> tuple[Series, Series]:
    """Return noise plus tremor [N], and the wander [N], each of shape (samples,); the runs of a study share them."""
    state, forces_n = HandDisturbanceState(0.0, 0.0, 0.0, 0), []
    for _ in range(samples):
        state, force_n = hand_noise_step(config, state, period_s)
        forces_n.append(force_n)
    wandering_n = [wander_n(config, index * period_s) for index in range(samples)]
    return np.array(forces_n), np.array(wandering_n)


class DisturbedHaptic(SimulatedHaptic):
    """The simulated device with its disturbances; while all are off it is the device itself."""

    def __init__(
        self,
        params: Any,
        start_position_m: float,
        config: HandDisturbanceConfig,
        declared: Capabilities | None = None,
        about: str = "",
    ) -> None:
        super().__init__(params, start_position_m, declared, about)
        self.state.disturbed = HandDisturbances(config, HandDisturbanceState(start_position_m, 0.0, 0.0, 0))

    def configure(self, config: HandDisturbanceConfig) -> None:
        """Use other disturbances from now on."""
        self.state.disturbed = self.state.disturbed._replace(config=config)

    @property
    def disturbances(self) -> HandDisturbanceConfig:
        return cast(HandDisturbances, self.state.disturbed).config

    def read(self, session_time_s: float, dt_s: float) -> DeviceReading:
        reading = super().read(session_time_s, dt_s)
        config, state = self.state.disturbed
        if not config.any_enabled:
            return reading
        state, reading = disturbed(config, state, reading, session_time_s, dt_s)
        self.state.disturbed = HandDisturbances(config, state)
        return reading
