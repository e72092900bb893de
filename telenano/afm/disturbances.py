"""Disturbances of a real AFM (paper, 5.1.3) that do not depend on its motion.

Each is seeded, and off unless it is switched on. Hysteresis, creep, stage and converter depend on the motion: they are
in `disturbed`. A node draws the noise step by step; a study in lockstep draws it for the whole run beforehand, with the
same step.

At the instrument's rate of one step a millisecond, with t its own time:

    x_piezo = S(x + hysteresis(x) + creep(x)) + drift t + wander(t) + vibration(t)
    x, y    = x, y of the stage - drift of the sample
    zeta    = zeta(x_piezo) + thermal + (white + 1/f + rounding of the converter) / gain of the read-out

*Vibration*: a sum of sines between two frequencies, evenly spaced on a logarithmic scale, of equal amplitude and random
phase; frequencies above half the rate of the instrument fold back, as in any sampled signal. *Hysteresis*: play
operators (Prandtl-Ishlinskii; Kuhnen, Eur. J. Control 9 (2003) 407): x + sum of w_i (p_i - x), where p_i follows x
behind a play of r_i. *Creep*: first-order lags, one a decade of time, which together are nearly logarithmic. *Stage*:
S(s) = w^2 / (s^2 + 2 d w s + w^2), its first resonance, or the drive in front of it, behind hysteresis and creep (D.
Croft, G. Shed, S. Devasia, J. Dyn. Syst. Meas. Control 123 (2001) 35); with d = 1/sqrt(2) it is at -3 dB at w.
*Thermal noise*: <zeta^2> = k_B T / k, drawn anew each step, since the cantilever is far faster. *1/f noise*: a sum of
first-order noises, one an octave of frequency, of equal power. *Electrostatic*: the force of a constant or wandering
voltage.
"""

import math
from functools import lru_cache
from typing import NamedTuple

from telenano.numerics.normal_numbers import normal_number
from telenano.numerics.sines import sine_noise, sines_of
from telenano.settings.afm_disturbances import DisturbanceConfig, VibrationConfig

BOLTZMANN_J_PER_K = 1.380649e-23

_OCTAVES = 12
# Vibration uses the first random stream of the seed; the normal numbers use another one.
_VIBRATION = 1


class NoiseState(NamedTuple):
    """Time [s]; the parts of 1/f noise, of unit variance; count of normal numbers used; wandering part of the voltage.

    wandered: of unit variance. sample: drift of the sample in x and y [m], and the random-walk parts of its speeds in x
    and y [m/s]. base: wander of the base in z [m], and its speed, of unit variance.
    """

    time_s: float
    flicker: tuple[float, ...]
    drawn: int
    wandered: float
    sample: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    base: tuple[float, float] = (0.0, 0.0)


class Noise(NamedTuple):
    """Disturbances of one step: of the base [m], the deflection [m] and the read-out [V]; the voltage of the tip [V].

    drift_m and vibration_m add to the base, voltage_v is the voltage of the tip, thermal_m adds to the deflection,
    white_v and flicker_v add to the read-out; sample_x_m, sample_y_m: drift of the sample. Off means zero.
    """

    drift_m: float = 0.0
    vibration_m: float = 0.0
    voltage_v: float = 0.0
    thermal_m: float = 0.0
    white_v: float = 0.0
    flicker_v: float = 0.0
    sample_x_m: float = 0.0
    sample_y_m: float = 0.0


def noise_start() -> NoiseState:
    """Return the state before the first number is drawn."""
    return NoiseState(0.0, (0.0,) * _OCTAVES, 0, 0.0)


@lru_cache(maxsize=8)
def _memory(dt: float) -> tuple[tuple[float, float], ...]:
    """Return, for each part of 1/f noise, its decay over dt [s] and the scale of the new draw; corners from 0.1 Hz."""
    kept = [math.exp(-2.0 * math.pi * 0.1 * 2.0**octave * dt) for octave in range(_OCTAVES)]
    return tuple((share, math.sqrt(1.0 - share * share)) for share in kept)


def noise_step(
    config: DisturbanceConfig, state: NoiseState, stiffness_n_per_m: float, dt: float
) -> tuple[NoiseState, Noise]:
    """Draw the disturbances of a step, dt [s] after the last one, for a cantilever of this stiffness [N/m]."""
    time_s, drawn, flicker, wandered = state.time_s + dt, state.drawn, state.flicker, state.wandered
    drift, base = config.drift, state.base
    drift_m = drift.speed_m_per_s * time_s if drift.enabled else 0.0
    vibration_m = _vibration_m(config.seed, config.vibration, time_s) if config.vibration.enabled else 0.0
    sample = _drifted(config, state, dt) if config.drift.enabled else state.sample
    drawn += 2 * (drift.enabled and drift.walk_m2_per_s3 > 0.0)
    if drift.enabled and drift.wander_m_per_s > 0.0:
        # The speed is an Ornstein-Uhlenbeck process; its first value is drawn from the stationary distribution.
        kept = math.exp(-dt / drift.wander_s) if state.time_s > 0.0 else 0.0
        speed = kept * base[1] + math.sqrt(1.0 - kept * kept) * normal_number(config.seed, drawn)
        base, drawn = (base[0] + drift.wander_m_per_s * speed * dt, speed), drawn + 1
        drift_m += base[0]
    voltage_v, e = 0.0, config.electrostatic
    if e.enabled:
        voltage_v = e.voltage_v
        if e.noise_v != 0.0:
            kept = math.exp(-dt / e.correlation_s)
            wandered = kept * wandered + math.sqrt(1.0 - kept * kept) * normal_number(config.seed, drawn)
            drawn, voltage_v = drawn + 1, voltage_v + e.noise_v * wandered
    thermal_m, white_v, flicker_v = 0.0, 0.0, 0.0
    if config.thermal.enabled:
        variance_m2 = BOLTZMANN_J_PER_K * config.thermal.temperature_k / stiffness_n_per_m
        thermal_m = math.sqrt(variance_m2) * normal_number(config.seed, drawn)
        drawn += 1
    r = config.readout
    if r.enabled:
        white_v = r.white_v * normal_number(config.seed, drawn)
        drawn += 1
        parts = []
        for part, (kept, added) in zip(flicker, _memory(dt), strict=True):
            parts.append(kept * part + added * normal_number(config.seed, drawn))
            drawn += 1
        flicker = tuple(parts)
        flicker_v = r.flicker_v / math.sqrt(_OCTAVES) * sum(flicker)
    noise = Noise(drift_m, vibration_m, voltage_v, thermal_m, white_v, flicker_v, sample[0], sample[1])
    return NoiseState(time_s, flicker, drawn, wandered, sample, base), noise


def _drifted(config: DisturbanceConfig, state: NoiseState, dt: float) -> tuple[float, float, float, float]:
    """Return the drift of the sample in x and y [m] after dt [s] more, and the wandering parts of its speeds [m/s]."""
    drift, (x, y, more_x, more_y) = config.drift, state.sample
    x, y = x + (drift.x_m_per_s + more_x) * dt, y + (drift.y_m_per_s + more_y) * dt
    if drift.walk_m2_per_s3 > 0.0:
        step = math.sqrt(drift.walk_m2_per_s3 * dt)
        more_x += step * normal_number(config.seed, state.drawn)
        more_y += step * normal_number(config.seed, state.drawn + 1)
    return x, y, more_x, more_y


def _vibration_m(seed: int, config: VibrationConfig, time_s: float) -> float:
    return sine_noise(sines_of(seed, _VIBRATION, config.low_hz, config.high_hz), config.rms_m, time_s)
