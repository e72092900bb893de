"""The constants of a dynamic cantilever: its exact motion over a step, its drive, its noise, the force of its sample.

The integrator that uses them, with its method, is in `telenano.afm.dynamic`.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.cantilever import Plant
from telenano.afm.contact.force_grid import ForceGrid, Passages, build_force_grid

BOLTZMANN_J_PER_K = 1.380649e-23
# Draws of thermal noise in a period, and the standard normal numbers that they use.
KICKS_PER_PERIOD = 8
NORMALS_PER_PERIOD = 2 * KICKS_PER_PERIOD
# Steps taken at once away from the sample.
FAR_STEPS = 8
# The largest number of shortest steps in a period.
FINEST = 1536
# Bound of the energy error of a period that steps through the force of the sample may cause: 0.06 eV.
TOLERANCE_J = 0.06 * 1.602176634e-19
# The share of a period in which a tapping tip meets that force.
_MEETING = 0.1
_FAR_M = 8e-9


class Damping(NamedTuple):
    """Viscosities [Pa s] and thicknesses [m] of liquid layer and sample (Eq. 4, E2)."""

    liquid_viscosity_pa_s: float
    liquid_thickness_m: float
    sample_viscosity_pa_s: float
    sample_thickness_m: float


class Viscosity(NamedTuple):
    """Damping in the form of the innermost loop: B = liquid (1 - h / L_l) below L_l, sample (a0 - h) below a0."""

    liquid_kg_per_s: float
    liquid_thickness_m: float
    sample_kg_per_s_m: float
    contact_distance_m: float


class Flow(NamedTuple):
    """Exact motion over a step without drive and sample: the matrix from zeta (z) and zeta' (v) to the new values."""

    zz: float
    zv: float
    vz: float
    vv: float


class Finer(NamedTuple):
    """A step and its halves, quarters and further binary parts, for motion through the force of the sample.

    Attributes:
        flows: Shape (levels, 5): zz, zv, vz, vv of `Flow` and the duration [s]; row 0 is the whole step.
        pushes: Shape (n (2^levels - 1), 2): increments of zeta [1] and zeta' [1/s] for unit base amplitude in a part of
            a step; the parts of level l begin at row n (2^l - 1).
        turns: Shape (n 2^(levels - 1), 3): cos, sin and velocity [1/s] of the drive at the start of each of the
            shortest parts.
        error_w: Allowed error of the energy per unit of time, times 12 [W].
    """

    flows: npt.NDArray[np.float64]
    pushes: npt.NDArray[np.float64]
    turns: npt.NDArray[np.float64]
    error_w: float


class Kick(NamedTuple):
    """Thermal noise of an eighth of a period, for two standard normal numbers a and b.

    zeta changes by z_m a, and zeta' by va_m_per_s a + vb_m_per_s b.
    """

    z_m: float
    va_m_per_s: float
    vb_m_per_s: float


class DynamicPlant(NamedTuple):
    """Cantilever that vibrates over a sample; made by `build_dynamic`.

    `drive` (n, 5), a row for each step of a period: increments of zeta [1] and zeta' [1/s] over the step for unit base
    amplitude, then cos and sin of the drive's phase and its velocity [1/s] at the start of the step. `far` (n, 11): the
    two increments over FAR_STEPS, then the sums over those steps of zeta cos, zeta sin and zeta, each as three
    coefficients, of zeta, zeta' and base amplitude at the first step.
    """

    passages: Passages
    viscosity: Viscosity
    stiffness_n_per_m: float
    rest_distance_m: float
    mass_kg: float
    damping_kg_per_s: float  # 2 m b
    drive_hz: float
    step_s: float
    drive: npt.NDArray[np.float64]
    finer: Finer
    far_m: float  # distance beyond which FAR_STEPS are taken at once
    far_flow: Flow
    far: npt.NDArray[np.float64]
    grid: ForceGrid
    steady_in_phase: float  # of zeta without a sample, in units of the base amplitude: cos
    steady_quadrature: float  # sin
    kick: Kick
    tip_radius_m: float
    electrostatic_n_m2: float = 0.0  # pi eps0 R^2 V^2


def build_dynamic(
    plant: Plant,
    resonance_hz: float,
    quality: float,
    drive_hz: float,
    damping: Damping,
    steps_per_period: int = 96,
    temperature_k: float = 0.0,
    like: DynamicPlant | None = None,
    finest: int = FINEST,
) -> DynamicPlant:
    """Build a dynamic cantilever: the exact motion of the driven spring over one step, and the force of its sample.

    Args:
        plant: The cantilever with its tip.
        resonance_hz: The frequency of the resonance, f [Hz].
        quality: The quality factor Q, above 1/2, because the spring has to oscillate.
        drive_hz: The frequency of the drive [Hz].
        damping: The damping between tip and sample.
        steps_per_period: The steps in a period of the drive, a multiple of 8, 16 or more.
        temperature_k: The temperature of thermal noise [K]; it acts only where `advance` gets normal numbers.
        like: A dynamic cantilever with the same spring, tip and sample, whose grid of the force is reused.
        finest: The largest number of steps a period where steps are divided because the tip meets the sample.

    Raises:
        ValueError: A value is impossible; the message names it and its unit.
    """
    checks = (("resonance f", resonance_hz, 0.0, "Hz"), ("drive frequency", drive_hz, 0.0, "Hz"),
              ("quality factor Q", quality, 0.5, ""))  # fmt: skip
    for name, value, least, unit in checks:
        if not (math.isfinite(value) and value > least):
            raise ValueError(f"{name} = {value} {unit} must be finite and > {least:g} {unit}".replace(" ,", ","))
    if steps_per_period < 16 or steps_per_period % KICKS_PER_PERIOD:
        raise ValueError(f"steps per period = {steps_per_period} must be a multiple of {KICKS_PER_PERIOD} from 16 on")
    if min(damping.liquid_viscosity_pa_s, damping.sample_viscosity_pa_s) < 0.0:
        raise ValueError("viscosities must be >= 0 Pa s")
    if min(damping.liquid_thickness_m, damping.sample_thickness_m) <= 0.0:
        raise ValueError("thicknesses of liquid layer and sample must be > 0 m")
    k, n = plant.stiffness_n_per_m, steps_per_period
    w0, w = 2.0 * math.pi * resonance_hz, 2.0 * math.pi * drive_hz
    b = math.pi * resonance_hz / quality
    mass = k / (w0 * w0)
    dt = 1.0 / (drive_hz * n)
    # zeta = Re Z e^(i w t), for x_d = cos w t
    response = -w * w / complex(w0 * w0 - w * w, 2.0 * b * w)
    finer = _finer(response, w, w0, b, n, dt, finest)
    every = finer.turns.shape[0] // n
    drive = np.column_stack((finer.pushes[:n], finer.turns[::every]))
    flow = _flow(w0, b, dt)
    tip = plant.tip
    # Beyond this distance no contact, meniscus or liquid layer begins, and the van der Waals force is a few pN.
    far_m = 1e-9 + max(_FAR_M, tip.meniscus_break_m if tip.has_meniscus else 0.0, damping.liquid_thickness_m)
    far_flow, far = _together(flow, drive)
    grid, passages = build_force_grid(tip, far_m + 20e-9) if like is None else (like.grid, like.passages)
    viscosity = Viscosity(
        math.pi * damping.liquid_viscosity_pa_s * tip.radius_m,
        damping.liquid_thickness_m,
        math.pi * damping.sample_viscosity_pa_s * tip.radius_m / damping.sample_thickness_m,
        tip.contact_distance_m,
    )
    return DynamicPlant(
        passages, viscosity, k, plant.rest_distance_m, mass, 2.0 * mass * b, drive_hz, dt, drive, finer, far_m,
        far_flow, far, grid, response.real, -response.imag,
        _kick(_flow(w0, b, 1.0 / (drive_hz * KICKS_PER_PERIOD)), k, mass, temperature_k), tip.radius_m,
    )  # fmt: skip


def _flow(w0: float, b: float, dt: float) -> Flow:
    """Return the exact motion of the free damped spring over dt [s]; w0 and b in 1/s."""
    wd, decay = math.sqrt(w0 * w0 - b * b), math.exp(-b * dt)
    c, s = math.cos(wd * dt), math.sin(wd * dt)
    return Flow(decay * (c + b / wd * s), decay * s / wd, -decay * w0 * w0 / wd * s, decay * (c - b / wd * s))


def _finer(response: complex, w: float, w0: float, b: float, n: int, dt: float, most: int) -> Finer:
    """Return a step of dt [s], of which a period has n, and its binary parts, of which a period has up to `most`.

    `response` is the complex amplitude of zeta for unit base amplitude; w, w0 and b are in 1/s.
    """
    levels = 1
    while n << levels <= most:
        levels += 1
    finest = n << (levels - 1)
    turns = np.empty((finest, 3))
    positions, velocities = [0.0] * finest, [0.0] * finest
    for i in range(finest):
        turn = complex(math.cos(2.0 * math.pi * i / finest), math.sin(2.0 * math.pi * i / finest))
        positions[i], velocities[i] = (response * turn).real, (response * turn * complex(0.0, w)).real
        turns[i] = turn.real, turn.imag, -w * turn.imag
    flows, pushes = np.empty((levels, 5)), np.empty((n * ((1 << levels) - 1), 2))
    for level in range(levels):
        size, first = finest // (n << level), n * ((1 << level) - 1)
        flow = _flow(w0, b, dt / (1 << level))
        flows[level] = *flow, dt / (1 << level)
        for i in range(n << level):
            at, after = i * size, (i + 1) * size % finest
            pushes[first + i, 0] = positions[after] - flow.zz * positions[at] - flow.zv * velocities[at]
            pushes[first + i, 1] = velocities[after] - flow.vz * positions[at] - flow.vv * velocities[at]
    return Finer(flows, pushes, turns, 12.0 * TOLERANCE_J / (_MEETING * n * dt))


def _kick(flow: Flow, stiffness_n_per_m: float, mass_kg: float, temperature_k: float) -> Kick:
    """Return the thermal noise over the time of a flow, which restores the variances k_B T / k and k_B T / m.

    The covariance that white noise adds in that time is S - F S F^T, with the flow F and the stationary S.
    """
    energy = BOLTZMANN_J_PER_K * temperature_k
    if energy == 0.0:
        return Kick(0.0, 0.0, 0.0)
    zz, vv = energy / stiffness_n_per_m, energy / mass_kg
    var_z = zz - flow.zz * flow.zz * zz - flow.zv * flow.zv * vv
    cov = -flow.zz * flow.vz * zz - flow.zv * flow.vv * vv
    var_v = vv - flow.vz * flow.vz * zz - flow.vv * flow.vv * vv
    z_m = math.sqrt(max(var_z, 0.0))
    along = cov / z_m if z_m > 0.0 else 0.0
    return Kick(z_m, along, math.sqrt(max(var_v - along * along, 0.0)))


def _together(flow: Flow, drive: npt.NDArray[np.float64]) -> tuple[Flow, npt.NDArray[np.float64]]:
    """Return the motion over FAR_STEPS and its table: each row of sums is linear in zeta, zeta' and base amplitude."""
    n = drive.shape[0]
    far = np.zeros((n, 11))
    after = flow
    for start in range(n):
        # zeta and zeta', each as coefficients of the initial zeta, the initial zeta' and the base amplitude.
        z, v = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
        for step in range(FAR_STEPS):
            row = drive[(start + step) % n]
            z, v = (
                [flow.zz * z[c] + flow.zv * v[c] + (float(row[0]) if c == 2 else 0.0) for c in range(3)],
                [flow.vz * z[c] + flow.vv * v[c] + (float(row[1]) if c == 2 else 0.0) for c in range(3)],
            )
            turn = drive[(start + step + 1) % n]
            for c in range(3):
                far[start, 2 + c] += z[c] * turn[2]
                far[start, 5 + c] += z[c] * turn[3]
                far[start, 8 + c] += z[c]
        far[start, :2] = z[2], v[2]
        after = Flow(z[0], z[1], v[0], v[1])
    return after, far
