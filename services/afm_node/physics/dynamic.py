"""Dynamic cantilever: Eq. 4 in full, with base excitation, in fixed steps of a fraction of the drive's period.

With the deflection zeta = h + x_s + s - L, the base x_s = x_b + x_d (moved slowly, and shaken by x_d = A_d cos(w t))
and the height s of the surface under the tip, Eq. 4 reads

    m zeta'' + 2 m b zeta' + k zeta = F(h) - B(h) h' + m x_s'',    b = pi f / Q,  m = k / (2 pi f)^2.

A step is a Strang splitting: half an impulse of the tip-sample force, the exact motion of the driven damped spring
without it, the other half. What is stiff or lightly damped is thus exact at any step (free amplitude, phase, Q), and
the error is that of the force alone, second order in the step. Where the force jumps inside a step (a meniscus forms
or breaks, printed contact), the time of the crossing is found and the impulse corrected to second order: without that
the energy lost in a cycle would depend on the grid.

Liquid damping acts inside the layer (E2): B = pi tau_l R (L_l - h) / L_l for a0 < h < L_l, and in contact
B = pi tau_s R (a0 - h) / L_s.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.physics.cantilever import Plant
from services.afm_node.physics.contact.electrostatic import electrostatic_force_n
from services.afm_node.physics.contact.force_grid import ForceGrid, Passages, build_force_grid, grid_force, passed
from services.numerics.compiled import always_compiled

BOLTZMANN_J_PER_K = 1.380649e-23
# impulses of thermal noise in a period: as many directions in the plane of position and velocity
KICKS_PER_PERIOD = 8
# steps taken at once away from the sample
FAR_STEPS = 8
_FAR_M = 4e-9
NO_NOISE: npt.NDArray[np.float64] = np.zeros(0)


class Damping(NamedTuple):
    """Viscosities [Pa s] and thicknesses [m] of liquid layer and sample (Eq. 4, E2)."""

    liquid_viscosity_pa_s: float
    liquid_thickness_m: float
    sample_viscosity_pa_s: float
    sample_thickness_m: float


class Viscosity(NamedTuple):
    """The same for the innermost loop: B = liquid (1 - h / L_l) below L_l, sample (a0 - h) below a0."""

    liquid_kg_per_s: float
    liquid_thickness_m: float
    sample_kg_per_s_m: float
    contact_distance_m: float


class Flow(NamedTuple):
    """Exact motion of the spring without drive and sample: what zeta and zeta' become of zeta (z) and zeta' (v)."""

    zz: float
    zv: float
    vz: float
    vv: float


class DynamicPlant(NamedTuple):
    """Cantilever that vibrates over a sample; made by `build_dynamic`.

    `drive` (n, 5): at each step of a period what unit base amplitude adds to zeta [1] and zeta' [1/s] over the step,
    then cos and sin of the drive's phase at its start, and its velocity [1/s] there. `far` (n, 11): the same two for
    FAR_STEPS at once, then the sums over those steps of zeta cos, zeta sin and zeta, each as its parts of zeta, zeta'
    and base amplitude at their start.
    """

    passages: Passages
    viscosity: Viscosity
    stiffness_n_per_m: float
    rest_distance_m: float
    mass_kg: float
    damping_kg_per_s: float  # 2 m b
    drive_hz: float
    step_s: float
    flow: Flow  # over a step
    drive: npt.NDArray[np.float64]
    far_m: float  # distance beyond which FAR_STEPS are taken at once
    far_flow: Flow
    far: npt.NDArray[np.float64]
    grid: ForceGrid
    steady_in_phase: float  # of zeta without a sample, in units of the base amplitude: cos
    steady_quadrature: float  # sin
    kick_m_per_s: float  # thermal
    tip_radius_m: float
    electrostatic_n_m2: float = 0.0  # pi eps0 R^2 V^2


class DynamicState(NamedTuple):
    """Motion of the tip, place of the base, branch of the force, step within the drive's period."""

    deflection_m: float
    velocity_m_per_s: float  # of the deflection
    base_m: float
    base_velocity_m_per_s: float
    surface_m: float
    contact: bool
    meniscus: bool
    phase_step: int


class Reading(NamedTuple):
    """What was measured over some steps; amplitude and phase need whole periods.

    in_phase_m and quadrature_m: components of zeta with cos and sin of the drive [m]; mean_deflection_m; mean and
    greatest force on the tip [N]; dissipated_j: energy that the sample took from the tip [J]; contact_share of the
    time.
    """

    in_phase_m: float
    quadrature_m: float
    mean_deflection_m: float
    mean_force_n: float
    peak_force_n: float
    dissipated_j: float
    contact_share: float


@always_compiled
def advance(
    plant: DynamicPlant,
    state: DynamicState,
    base_m: float,
    surface_m: float,
    drive_m: float,
    steps: int,
    normals: npt.NDArray[np.float64],
) -> tuple[DynamicState, Reading]:
    """Go on by `steps` steps, while base and surface move evenly to base_m and surface_m [m].

    Parameters: drive_m, amplitude of the base's vibration [m]; normals, standard normal numbers for thermal
    noise, one for each eighth of a period, or none at all. Raises: ValueError, if there are fewer.
    """
    rest, step_s, drive, far = plant.rest_distance_m, plant.step_s, plant.drive, plant.far
    passages, viscosity, attraction = plant.passages, plant.viscosity, plant.grid.attraction_n_m2
    flow_zz, flow_zv, flow_vz, flow_vv = plant.flow.zz, plant.flow.zv, plant.flow.vz, plant.flow.vv
    far_zz, far_zv, far_vz, far_vv = plant.far_flow.zz, plant.far_flow.zv, plant.far_flow.vz, plant.far_flow.vv
    mass, far_m = plant.mass_kg, plant.far_m
    cubics, start_m, cells_per_m = plant.grid.cubics, plant.grid.start_m, plant.grid.cells_per_m
    charge, radius, contact_m = plant.electrostatic_n_m2, plant.tip_radius_m, viscosity.contact_distance_m
    viscous = viscosity.liquid_kg_per_s > 0.0 or viscosity.sample_kg_per_s_m > 0.0
    half = 0.5 * step_s / mass
    periods = drive.shape[0]
    every = periods // KICKS_PER_PERIOD
    # compiled code checks no index: both tables are looked up within their length
    if normals.size > 0 and normals.size < steps // every:
        raise ValueError("thermal noise needs a normal number for each eighth of a period")
    z, v = state.deflection_m, state.velocity_m_per_s
    contact, meniscus, p = state.contact, state.meniscus, state.phase_step % periods
    base, surface = state.base_m, state.surface_m
    base_step, surface_step = (base_m - base) / steps, (surface_m - surface) / steps
    base_velocity = base_step / step_s
    towards = base_velocity + surface_step / step_s
    # the base takes up its new speed at once, the tip does not
    v += base_velocity - state.base_velocity_m_per_s
    h = rest + z - base - surface - drive_m * drive[p, 2]
    contact, meniscus = passed(passages, h, contact, meniscus)
    force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
    if charge > 0.0:
        force += _electrostatic(charge, radius, contact_m, h)
    in_phase, quadrature, mean, mean_force, peak = 0.0, 0.0, 0.0, 0.0, force
    work, touching, kick = 0.0, 0, 0
    i, fine_until = 0, 0
    while i < steps:
        if h > far_m and i >= fine_until and i + FAR_STEPS <= steps and normals.size == 0:
            # away from the sample the force is weak and smooth: several steps at once
            w = v + force * half * FAR_STEPS
            z_far = far_zz * z + far_zv * w + drive_m * far[p, 0]
            v_far = far_vz * z + far_vv * w + drive_m * far[p, 1]
            q = p + FAR_STEPS
            if q >= periods:
                q -= periods
            moved_base, moved_surface = base + FAR_STEPS * base_step, surface + FAR_STEPS * surface_step
            h_far = rest + z_far - moved_base - moved_surface - drive_m * drive[q, 2]
            falling = w - towards - drive_m * drive[p, 4] < 0.0
            rising = v_far - towards - drive_m * drive[q, 4] > 0.0
            # what turns on the way may have come nearer than both ends
            if h_far > far_m and not (falling and rising):
                in_phase += far[p, 2] * z + far[p, 3] * w + far[p, 4] * drive_m
                quadrature += far[p, 5] * z + far[p, 6] * w + far[p, 7] * drive_m
                mean += far[p, 8] * z + far[p, 9] * w + far[p, 10] * drive_m
                before, force_before = h, force
                z, h, p, base, surface = z_far, h_far, q, moved_base, moved_surface
                force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
                if charge > 0.0:
                    force += _electrostatic(charge, radius, contact_m, h)
                v = v_far + force * half * FAR_STEPS
                work -= 0.5 * (force_before + force) * (h - before)
                mean_force += 0.5 * (force_before + force) * FAR_STEPS
                i += FAR_STEPS
                continue
            fine_until = i + FAR_STEPS
        v += force * half
        start = (v - towards - drive_m * drive[p, 4]) * step_s
        g_z, g_v = drive_m * drive[p, 0], drive_m * drive[p, 1]
        z, v = flow_zz * z + flow_zv * v + g_z, flow_vz * z + flow_vv * v + g_v
        p += 1
        if p == periods:
            p = 0
        base += base_step
        surface += surface_step
        before, force_before = h, force
        h = rest + z - base - surface - drive_m * drive[p, 2]
        touches, wet = passed(passages, h, contact, meniscus)
        if touches != contact or wet != meniscus:
            if touches != contact:
                at = passages.onset_m if touches else passages.end_m
                jump = passages.onset_n if touches else passages.end_n
                slope = passages.onset_n_per_m if touches else passages.end_n_per_m
                impulse, shift, lost = _corrected(at, jump, slope, before, h, start)
                v, z, work = v + impulse * step_s / mass, z + shift * step_s * step_s / mass, work - lost
            if wet != meniscus:
                at = passages.forms_m if wet else passages.breaks_m
                jump = passages.forms_n if wet else passages.breaks_n
                impulse, shift, lost = _corrected(at, jump, 0.0, before, h, start)
                v, z, work = v + impulse * step_s / mass, z + shift * step_s * step_s / mass, work - lost
            h = rest + z - base - surface - drive_m * drive[p, 2]
            contact, meniscus = touches, wet
        force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
        if charge > 0.0:
            force += _electrostatic(charge, radius, contact_m, h)
        v += force * half
        work -= 0.5 * (force_before + force) * (h - before)
        if viscous and (contact or h < viscosity.liquid_thickness_m):
            b = damping_at(viscosity, h)
            speed = v - towards - drive_m * drive[p, 4]
            x = 0.5 * b * step_s / mass
            slower = speed * (1.0 - x) / (1.0 + x)
            work += 0.5 * mass * (speed * speed - slower * slower)
            v += slower - speed
        if normals.size > 0 and i % every == every - 1:
            v += plant.kick_m_per_s * normals[kick]
            kick += 1
        in_phase += z * drive[p, 2]
        quadrature += z * drive[p, 3]
        mean += z
        mean_force += 0.5 * (force_before + force)
        peak = max(peak, force)
        touching += int(contact)
        i += 1
    reading = Reading(
        2.0 * in_phase / steps,
        2.0 * quadrature / steps,
        mean / steps,
        mean_force / steps,
        peak,
        work,
        touching / steps,
    )
    return DynamicState(z, v, base_m, base_velocity, surface_m, contact, meniscus, p), reading


@always_compiled
def _corrected(
    at_m: float, jump_n: float, slope_n_per_m: float, before_m: float, after_m: float, start_m: float
) -> tuple[float, float, float]:
    """Return what a jump of the force, or of its gradient, inside a step needs: impulse, shift, work [J].

    The half impulses count the jump for half of the step; it acted from the crossing on. Parameters: start_m, way of a
    step at the speed of its start, which with both ends gives the time of the crossing to second order. Impulse and
    shift are in units of step and squared step over the mass.
    """
    way = after_m - before_m
    if way == 0.0:
        return 0.0, 0.0, 0.0
    share = min(max((at_m - before_m) / way, 0.0), 1.0)
    bend = way - start_m
    speed = start_m + 2.0 * bend * share
    if speed * way > 0.0:
        time = min(max(share - (start_m * share + bend * share * share - share * way) / speed, 0.0), 1.0)
    else:
        time = share
    late = jump_n * (0.5 - time) - 0.5 * slope_n_per_m * way * time * (1.0 - time)
    work = (jump_n * (0.5 - share) - 0.5 * slope_n_per_m * way * share * (1.0 - share)) * way
    return late, 0.5 * jump_n * (1.0 - time) ** 2, work


# compiled here, and plain Python where nodes without a compiler call it
_electrostatic = always_compiled(electrostatic_force_n)


@always_compiled
def damping_at(viscosity: Viscosity, h: float) -> float:
    """B [kg/s] of liquid layer or sample (Eq. 4, E2)."""
    if h <= viscosity.contact_distance_m:
        return viscosity.sample_kg_per_s_m * (viscosity.contact_distance_m - h)
    return viscosity.liquid_kg_per_s * max(1.0 - h / viscosity.liquid_thickness_m, 0.0)


def build_dynamic(
    plant: Plant,
    resonance_hz: float,
    quality: float,
    drive_hz: float,
    damping: Damping,
    steps_per_period: int = 96,
    temperature_k: float = 0.0,
    like: DynamicPlant | None = None,
) -> DynamicPlant:
    """Prepare the exact motion of the driven spring over one step.

    Parameters: plant, the cantilever with its tip; resonance_hz, f; quality, Q, above 1/2 (it must oscillate);
    drive_hz; damping; steps_per_period, of the drive, a multiple of 8; temperature_k, of thermal noise, where normal
    numbers are given; like, one of the same cantilever, tip and sample, whose grid of the force is taken.
    Raises: ValueError naming value and unit of what cannot be.
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
    wd, decay = math.sqrt(w0 * w0 - b * b), math.exp(-b * dt)
    c, s = math.cos(wd * dt), math.sin(wd * dt)
    flow = Flow(decay * (c + b / wd * s), decay * s / wd, -decay * w0 * w0 / wd * s, decay * (c - b / wd * s))
    # zeta = Re Z e^(i w t), for x_d = cos w t
    response = -w * w / complex(w0 * w0 - w * w, 2.0 * b * w)
    turns = [complex(math.cos(2.0 * math.pi * i / n), math.sin(2.0 * math.pi * i / n)) for i in range(n)]
    positions = [(response * turn).real for turn in turns]
    velocities = [(response * turn * complex(0.0, w)).real for turn in turns]
    drive = np.empty((n, 5))
    for i, turn in enumerate(turns):
        after = (i + 1) % n
        drive[i, 0] = positions[after] - flow.zz * positions[i] - flow.zv * velocities[i]
        drive[i, 1] = velocities[after] - flow.vz * positions[i] - flow.vv * velocities[i]
        drive[i, 2:] = turn.real, turn.imag, -w * turn.imag
    kick = math.sqrt(4.0 * b * BOLTZMANN_J_PER_K * temperature_k / mass / (drive_hz * KICKS_PER_PERIOD))
    tip = plant.tip
    # before this distance nothing begins or ends, and beyond it van der Waals' force is some pN
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
        passages, viscosity, k, plant.rest_distance_m, mass, 2.0 * mass * b, drive_hz, dt, flow, drive, far_m,
        far_flow, far, grid, response.real, -response.imag, kick, tip.radius_m,
    )  # fmt: skip


def _together(flow: Flow, drive: npt.NDArray[np.float64]) -> tuple[Flow, npt.NDArray[np.float64]]:
    """Return the motion over FAR_STEPS and its table: each row of sums is linear in zeta, zeta' and base amplitude."""
    n = drive.shape[0]
    far = np.zeros((n, 11))
    after = flow
    for start in range(n):
        # zeta and zeta' as (part of zeta, part of zeta', part of the base amplitude)
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


def drive_work_j(plant: DynamicPlant, drive_m: float, in_phase_m: float, quadrature_m: float) -> float:
    """Return the energy that the shaken base gives in a period of steady vibration [J].

    The base exerts k zeta + 2 m b zeta' and moves by x_d; only the part of zeta at the drive's frequency does work.
    """
    w = 2.0 * math.pi * plant.drive_hz
    return math.pi * drive_m * (plant.damping_kg_per_s * w * in_phase_m - plant.stiffness_n_per_m * quadrature_m)


def steady_state(plant: DynamicPlant, base_m: float, drive_m: float, surface_m: float = 0.0) -> DynamicState:
    """Return the state of a tip that vibrates steadily far from any sample: what a scan or a curve begins with."""
    velocity = plant.steady_quadrature * 2.0 * math.pi * plant.drive_hz
    return DynamicState(plant.steady_in_phase * drive_m, velocity * drive_m, base_m, 0.0, surface_m, False, False, 0)


def free_amplitude_m(plant: DynamicPlant, drive_m: float) -> float:
    """Return the amplitude of zeta without a sample [m]."""
    return math.hypot(plant.steady_in_phase, plant.steady_quadrature) * drive_m
