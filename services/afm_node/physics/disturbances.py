"""What disturbs a real AFM (paper, 5.1.3), as models of one step: each seeded, each off unless it is switched on.

At the instrument's rate of a step a millisecond, with t its own time:

    x_piezo = x + hysteresis(x) + creep(x) + drift t + vibration(t)
    zeta    = zeta(x_piezo) + thermal + (white + 1/f + rounding of the converter) / gain of the read-out

*Vibration*: a sum of sines between two frequencies, evenly spread over the logarithm, of equal amplitude and random
phase; what lies above half the rate of the instrument folds back, as it does in a sampled signal. *Hysteresis*: play
operators (Prandtl-Ishlinskii; Kuhnen, Eur. J. Control 9 (2003) 407): x + sum of w_i (p_i - x), p_i following x behind
a play of r_i. *Creep*: first-order lags, one a decade of time, which together are nearly logarithmic. *Thermal noise*:
<zeta^2> = k_B T / k, at each step anew, since the cantilever is far faster. *1/f noise*: first-order noises, one an
octave of frequency, of equal power. *Electrostatic*: the force of a voltage that stands or wanders.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import Field

from services.numerics.normal_numbers import NormalNumbers
from services.runtime.settings.config import Settings

BOLTZMANN_J_PER_K = 1.380649e-23
Array = npt.NDArray[np.float64]

_SINES = 48
_PLAYS = 8
LAGS_S = (0.1, 1.0, 10.0, 100.0)
_OCTAVES = 12


class VibrationConfig(Settings):
    """Vibration of the base."""

    enabled: bool = Field(False, description="Whether it acts.")
    rms_m: float = Field(0.1e-9, ge=0.0, le=1e-6, description="Root mean square [m].")
    low_hz: float = Field(1.0, gt=0.0, le=1e5, description="Lowest frequency [Hz].")
    high_hz: float = Field(400.0, gt=0.0, le=1e5, description="Highest frequency [Hz]; the paper has 1 Hz to 10 kHz.")


class HysteresisConfig(Settings):
    """Hysteresis of the piezo."""

    enabled: bool = Field(False, description="Whether it acts.")
    share: float = Field(0.1, ge=0.0, le=0.2, description="Width of a loop over the whole range, as a share of it.")
    range_m: float = Field(100e-9, gt=0.0, le=1e-3, description="Range over which the plays are spread [m].")


class CreepConfig(Settings):
    """Creep of the piezo."""

    enabled: bool = Field(False, description="Whether it acts.")
    share_per_decade: float = Field(
        0.02, ge=0.0, le=0.5, description="Share of a step that follows in a decade of time."
    )


class DriftConfig(Settings):
    """Thermal drift of the distance."""

    enabled: bool = Field(False, description="Whether it acts.")
    speed_m_per_s: float = Field(0.05e-9, ge=-1e-6, le=1e-6, description="Speed of the base towards the sample [m/s].")


class ThermalConfig(Settings):
    """Thermal noise of the cantilever."""

    enabled: bool = Field(False, description="Whether it acts.")
    temperature_k: float = Field(300.0, ge=0.0, le=2000.0, description="Temperature [K].")


class ReadoutConfig(Settings):
    """Noise of the bridge (Eq. 3) and its converter."""

    enabled: bool = Field(False, description="Whether it acts.")
    white_v: float = Field(0.5e-3, ge=0.0, le=1.0, description="White noise, root mean square of a sample [V].")
    flicker_v: float = Field(0.5e-3, ge=0.0, le=1.0, description="1/f noise, root mean square over its octaves [V].")
    converter_bits: int = Field(16, ge=4, le=32, description="Bits of the converter.")
    converter_range_v: float = Field(10.0, gt=0.0, le=1e3, description="It reads from minus this to this [V].")


class ElectrostaticConfig(Settings):
    """Voltage between tip and sample: contact potential, charges, or a bias; the force is that of `electrostatic`."""

    enabled: bool = Field(False, description="Whether it acts.")
    voltage_v: float = Field(1.0, ge=-100.0, le=100.0, description="Mean voltage [V].")
    noise_v: float = Field(0.0, ge=0.0, le=100.0, description="Root mean square of what it wanders by [V].")
    correlation_s: float = Field(1.0, gt=0.0, le=1e4, description="Time over which it wanders [s].")


class DisturbanceConfig(Settings):
    """Section `afm_node.disturbances`."""

    seed: int = Field(0, ge=0, lt=2**63, description="Seed of everything that is random.")
    vibration: VibrationConfig = Field(VibrationConfig(), description="Vibration of the base.")
    hysteresis: HysteresisConfig = Field(HysteresisConfig(), description="Hysteresis of the piezo.")
    creep: CreepConfig = Field(CreepConfig(), description="Creep of the piezo.")
    drift: DriftConfig = Field(DriftConfig(), description="Thermal drift.")
    thermal: ThermalConfig = Field(ThermalConfig(), description="Thermal noise of the cantilever.")
    readout: ReadoutConfig = Field(ReadoutConfig(), description="Noise of the read-out.")
    electrostatic: ElectrostaticConfig = Field(ElectrostaticConfig(), description="Force of a voltage at the tip.")

    @property
    def any_enabled(self) -> bool:
        parts = (getattr(self, name) for name in type(self).model_fields if name != "seed")
        return any(part.enabled for part in parts)


class DisturbanceState(NamedTuple):
    """Time [s]; plays [m]; creep lags [m]; 1/f parts, of unit variance; how many normal numbers were used.

    wandered: of the voltage, of unit variance.
    """

    time_s: float
    plays_m: tuple[float, ...]
    lags_m: tuple[float, ...]
    flicker: tuple[float, ...]
    drawn: int
    wandered: float = 0.0


class Sines(NamedTuple):
    """Angular frequencies [rad/s] and phases of the vibration."""

    rates: tuple[float, ...]
    phases: tuple[float, ...]


def sines_of(config: DisturbanceConfig) -> Sines:
    """Return frequencies and phases of the vibration, which the seed decides."""
    random = np.random.Generator(np.random.Philox(key=config.seed, counter=[0, 0, 0, 1]))
    v = config.vibration
    low, high = sorted((v.low_hz, v.high_hz))
    # Each lies somewhere in its part of the band: an even comb would have a period. Powers and sines are those of the C
    # library, one after the other: NumPy's own depend on the instructions of the processor.
    places = [(i + share) / _SINES for i, share in enumerate(random.random(_SINES).tolist())]
    rates = tuple(2.0 * math.pi * low * math.pow(high / low, place) for place in places)
    return Sines(rates, tuple(2.0 * math.pi * share for share in random.random(_SINES).tolist()))


def begun() -> DisturbanceState:
    """Return the state at the beginning: everything at rest."""
    return DisturbanceState(0.0, (0.0,) * _PLAYS, (0.0,) * len(LAGS_S), (0.0,) * _OCTAVES, 0)


def at_rest(state: DisturbanceState, base_m: float) -> DisturbanceState:
    """Return a state in which the piezo has been at base_m [m] for long; time and noise go on."""
    return state._replace(plays_m=(base_m,) * _PLAYS, lags_m=(base_m,) * len(LAGS_S))


def displaced(
    config: DisturbanceConfig, sines: Sines, state: DisturbanceState, base_m: float, dt: float
) -> tuple[DisturbanceState, float]:
    """Return where the piezo really is [m] when it was sent to base_m [m], dt [s] after the last step."""
    time, x = state.time_s + dt, base_m
    plays, lags = state.plays_m, state.lags_m
    if config.hysteresis.enabled:
        plays = tuple(_play(p, base_m, r) for p, r in zip(plays, play_radii_m(config.hysteresis), strict=True))
        x += 4.0 * config.hysteresis.share / _PLAYS * sum(p - base_m for p in plays)
    if config.creep.enabled:
        lags = tuple(
            lag + (base_m - lag) * (1.0 - math.exp(-dt / lag_s)) for lag, lag_s in zip(lags, LAGS_S, strict=True)
        )
        x += config.creep.share_per_decade * sum(lag - base_m for lag in lags)
    if config.drift.enabled:
        x += config.drift.speed_m_per_s * time
    if config.vibration.enabled:
        amplitude = config.vibration.rms_m * math.sqrt(2.0 / _SINES)
        x += amplitude * sum(
            math.sin(rate * time + phase) for rate, phase in zip(sines.rates, sines.phases, strict=True)
        )
    return state._replace(time_s=time, plays_m=plays, lags_m=lags), x


def charged(
    config: ElectrostaticConfig, normals: NormalNumbers, state: DisturbanceState, dt: float
) -> tuple[DisturbanceState, float]:
    """Return the voltage between tip and sample [V], dt [s] after the last step."""
    if not config.enabled:
        return state, 0.0
    if config.noise_v == 0.0:
        return state, config.voltage_v
    kept = math.exp(-dt / config.correlation_s)
    wandered = kept * state.wandered + math.sqrt(1.0 - kept * kept) * normals.at(state.drawn)
    return state._replace(wandered=wandered, drawn=state.drawn + 1), config.voltage_v + config.noise_v * wandered


def play_radii_m(config: HysteresisConfig) -> tuple[float, ...]:
    """Return the plays r_i [m]: all have turned round by the middle of the range."""
    return tuple(0.25 * config.range_m * (i + 0.5) / _PLAYS for i in range(_PLAYS))


def _play(position_m: float, input_m: float, radius_m: float) -> float:
    return min(max(position_m, input_m - radius_m), input_m + radius_m)


def read_out(
    config: DisturbanceConfig,
    normals: NormalNumbers,
    state: DisturbanceState,
    deflection_m: float,
    stiffness_n_per_m: float,
    volts_per_m: float,
    dt: float,
) -> tuple[DisturbanceState, float]:
    """Return what the read-out says of a deflection [m], dt [s] after the last step."""
    drawn, zeta, flicker = state.drawn, deflection_m, state.flicker
    if config.thermal.enabled:
        zeta += math.sqrt(BOLTZMANN_J_PER_K * config.thermal.temperature_k / stiffness_n_per_m) * normals.at(drawn)
        drawn += 1
    r = config.readout
    if r.enabled:
        volts = volts_per_m * zeta + r.white_v * normals.at(drawn)
        drawn += 1
        parts = []
        for octave, part in enumerate(flicker):
            # corners from 0.1 Hz on, an octave apart
            kept = math.exp(-2.0 * math.pi * 0.1 * 2.0**octave * dt)
            parts.append(kept * part + math.sqrt(1.0 - kept * kept) * normals.at(drawn))
            drawn += 1
        flicker = tuple(parts)
        volts += r.flicker_v / math.sqrt(_OCTAVES) * sum(flicker)
        zeta = converted_v(volts, r.converter_bits, r.converter_range_v) / volts_per_m
    return state._replace(drawn=drawn, flicker=flicker), zeta


def converted_v(volts: float, bits: int, range_v: float) -> float:
    """Return what a converter of so many bits makes of a voltage [V] between -range_v and range_v.

    >>> converted_v(0.3, 4, 1.0), converted_v(7.0, 4, 1.0)
    (0.25, 0.875)
    """
    step = 2.0 * range_v / float(1 << bits)
    return min(max(round(volts / step) * step, -range_v), range_v - step)
