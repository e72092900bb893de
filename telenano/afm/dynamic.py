"""Dynamic cantilever: Eq. 4 in full, with base excitation, in fixed steps of a fraction of the drive's period.

With the deflection zeta = h + x_s + s - L, the base x_s = x_b + x_d (slow motion x_b, drive x_d = A_d cos(w t)) and the
height s of the surface under the tip, Eq. 4 reads

    m zeta'' + 2 m b zeta' + k zeta = F(h) - B(h) h' + m x_s'',    b = pi f / Q,  m = k / (2 pi f)^2.

A step is a Strang splitting: half an impulse of the tip-sample force, the exact motion of the driven damped spring
without it, the other half. The free motion (amplitude, phase, Q) is thus exact at any step, however stiff or lightly
damped the spring is. Only the force has an error, second order in the step: the impulse of a step of dt misses dt^3/12
of the second derivative of the force along the path. Near the sample a step is therefore halved until this error,
times the greatest speed of the tip, stays below its share of TOLERANCE_J; away from the sample FAR_STEPS steps are
computed as one. Where the force jumps inside a step (a meniscus forms or breaks, printed contact), the time of the
crossing is found and the impulse corrected to second order: otherwise the energy lost in a cycle would depend on the
grid.

Thermal noise is drawn KICKS_PER_PERIOD times in a period, deflection and velocity together, with the covariance that
white noise gives the damped spring in that time (Ornstein and Uhlenbeck; M. C. Wang and G. E. Uhlenbeck, Rev. Mod.
Phys. 17 (1945) 323, section 9). The spectral density of the free tip is thus right at any step, from zero frequency on.

Liquid damping acts inside the layer (E2): B = pi tau_l R (L_l - h) / L_l for a0 < h < L_l, and in contact
B = pi tau_s R (a0 - h) / L_s.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.contact.electrostatic import electrostatic_force_n
from telenano.afm.contact.force_grid import Passages, grid_force, grid_slopes, passed
from telenano.afm.dynamic_plant import FAR_STEPS, KICKS_PER_PERIOD, DynamicPlant, Viscosity
from telenano.numerics.compiler import always_compiled, compiled

# Largest motion of the tip in a part of a step, as a share of the distance to the next jump of the force.
_LOOK_AHEAD = 0.25
# A part of a step may always move the tip by this distance, however near the jump is [m].
_LEAST_WAY_M = 40e-12
# Lower bound of the amplitude [m] whose speed multiplies the error of an impulse.
_LEAST_AMPLITUDE_M = 1e-9
NO_NOISE: npt.NDArray[np.float64] = np.zeros(0)


class DynamicState(NamedTuple):
    """Motion of the tip, position of base and surface, branch of the force, step within the drive's period."""

    deflection_m: float
    velocity_m_per_s: float  # of the deflection
    base_m: float
    base_velocity_m_per_s: float
    surface_m: float
    contact: bool
    meniscus: bool
    phase_step: int


class Reading(NamedTuple):
    """Measurement over some steps; amplitude and phase need whole periods.

    in_phase_m and quadrature_m: components of zeta with cos and sin of the drive [m]; mean_deflection_m [m];
    peak_force_n: greatest force on the tip [N]; dissipated_j: energy that the sample took from the tip [J];
    contact_share: share of the time in contact.
    """

    in_phase_m: float
    quadrature_m: float
    mean_deflection_m: float
    peak_force_n: float
    dissipated_j: float
    contact_share: float


@compiled
def lag_rad(in_phase_m: float, quadrature_m: float) -> float:
    """Return the phase lag of the deflection behind the drive [rad], pi/2 in free motion at the resonance.

    A larger lag means attraction, a smaller one repulsion. The base is driven towards the sample and the deflection
    counts away from it; this function removes that half turn.
    """
    return math.atan2(-quadrature_m, -in_phase_m)


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
    """Advance the motion by `steps` steps, while base and surface move evenly to base_m and surface_m [m].

    Args:
        plant: The cantilever over its sample.
        state: Its motion, at the start of a step.
        base_m: Position of the base at the end [m].
        surface_m: Height of the surface under the tip at the end [m].
        drive_m: Amplitude of the base's vibration [m].
        steps: Number of steps of the plant's drive; a step is divided further where the tip meets the sample.
        normals: Standard normal numbers for thermal noise, two for each eighth of a period; empty for no noise.

    Raises:
        ValueError: There are some normal numbers, but too few.
    """
    step_s, drive, far = plant.step_s, plant.drive, plant.far
    attraction, charge, contact_m = (
        plant.grid.attraction_n_m2,
        plant.electrostatic_n_m2,
        plant.viscosity.contact_distance_m,
    )
    far_zz, far_zv, far_vz, far_vv = plant.far_flow.zz, plant.far_flow.zv, plant.far_flow.vz, plant.far_flow.vv
    cubics, start_m, cells_per_m = plant.grid.cubics, plant.grid.start_m, plant.grid.cells_per_m
    rest, far_m, half_far = plant.rest_distance_m, plant.far_m, 0.5 * FAR_STEPS * step_s / plant.mass_kg
    flows, pushes, turns = plant.finer.flows, plant.finer.pushes, plant.finer.turns
    passages, viscosity, radius = plant.passages, plant.viscosity, plant.tip_radius_m
    stiffness, mass = plant.stiffness_n_per_m, plant.mass_kg
    viscous = viscosity.liquid_kg_per_s > 0.0 or viscosity.sample_kg_per_s_m > 0.0
    periods, whole = drive.shape[0], 1 << (flows.shape[0] - 1)
    every = periods // KICKS_PER_PERIOD
    # Compiled code checks no index, so both tables must be long enough.
    if normals.size > 0 and normals.size < 2 * (steps // every):
        raise ValueError("thermal noise needs two normal numbers for each eighth of a period")
    z, v = state.deflection_m, state.velocity_m_per_s
    contact, meniscus, p = state.contact, state.meniscus, state.phase_step % periods
    base, surface = state.base_m, state.surface_m
    base_step, surface_step = (base_m - base) / steps, (surface_m - surface) / steps
    base_velocity = base_step / step_s
    towards = base_velocity + surface_step / step_s
    amplitude_m = max(drive_m * math.hypot(plant.steady_in_phase, plant.steady_quadrature), _LEAST_AMPLITUDE_M)
    # Allowed change of the force [N]: its second derivative [N/s^2] times the square of a step [s^2].
    bound = plant.finer.error_w / (2.0 * math.pi * plant.drive_hz * amplitude_m)
    # The base takes its new speed at once; the tip does not.
    v += base_velocity - state.base_velocity_m_per_s
    h = rest + z - base - surface - drive_m * drive[p, 2]
    contact, meniscus = passed(passages, h, contact, meniscus)
    force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
    if charge > 0.0:
        force += _electrostatic(charge, radius, contact_m, h)
    in_phase, quadrature, mean, peak = 0.0, 0.0, 0.0, force
    work, touched, kick = 0.0, 0, 0
    i, fine_until = 0, 0
    while i < steps:
        if h > far_m and i >= fine_until and i + FAR_STEPS <= steps and normals.size == 0:
            # Away from the sample the force is weak and smooth: take several steps at once.
            w = v + force * half_far
            z_far = far_zz * z + far_zv * w + drive_m * far[p, 0]
            v_far = far_vz * z + far_vv * w + drive_m * far[p, 1]
            q = p + FAR_STEPS
            if q >= periods:
                q -= periods
            moved_base, moved_surface = base + FAR_STEPS * base_step, surface + FAR_STEPS * surface_step
            h_far = rest + z_far - moved_base - moved_surface - drive_m * drive[q, 2]
            falling = w - towards - drive_m * drive[p, 4] < 0.0
            rising = v_far - towards - drive_m * drive[q, 4] > 0.0
            # A tip that turns within these steps may have come nearer than at either end.
            if h_far > far_m and not (falling and rising):
                in_phase += far[p, 2] * z + far[p, 3] * w + far[p, 4] * drive_m
                quadrature += far[p, 5] * z + far[p, 6] * w + far[p, 7] * drive_m
                mean += far[p, 8] * z + far[p, 9] * w + far[p, 10] * drive_m
                before, force_before = h, force
                z, h, p, base, surface = z_far, h_far, q, moved_base, moved_surface
                force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
                if charge > 0.0:
                    force += _electrostatic(charge, radius, contact_m, h)
                v = v_far + force * half_far
                work -= 0.5 * (force_before + force) * (h - before)
                i += FAR_STEPS
                continue
            fine_until = i + FAR_STEPS
        noise_z, noise_v = 0.0, 0.0
        if normals.size > 0 and i % every == every - 1:
            noise_z = plant.kick.z_m * normals[kick]
            noise_v = plant.kick.va_m_per_s * normals[kick] + plant.kick.vb_m_per_s * normals[kick + 1]
            kick += 2
        part, low = 0, base + surface
        while part < whole:
            at, level = p * whole + part, 0
            if whole > 1:
                speed = v - towards - drive_m * turns[at, 2]
                slope, bend = grid_slopes(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
                if viscous and (contact or h < viscosity.liquid_thickness_m):
                    change = _viscous_change(viscosity, h, speed, slope, bend, force - stiffness * z, mass)
                else:
                    change = abs(bend * speed * speed + slope * (force - stiffness * z) / mass)
                level = _level(flows, change, abs(speed), _way_m(passages, h, contact, meniscus), bound, part)
            size, dt = whole >> level, flows[level, 4]
            half = 0.5 * dt / mass
            v += force * half
            start = (v - towards - drive_m * turns[at, 2]) * dt
            row = periods * ((1 << level) - 1) + at // size
            z, v = (
                flows[level, 0] * z + flows[level, 1] * v + drive_m * pushes[row, 0],
                flows[level, 2] * z + flows[level, 3] * v + drive_m * pushes[row, 1],
            )
            part, at = part + size, at + size
            if at == turns.shape[0]:
                at = 0
            if part == whole:
                z, v = z + noise_z, v + noise_v
            before, force_before = h, force
            away = rest - low - part / whole * (base_step + surface_step) - drive_m * turns[at, 0]
            h = away + z
            touches, wet = passed(passages, h, contact, meniscus)
            if touches != contact or wet != meniscus:
                impulse, shift, lost = _jumps(passages, touches, wet, contact, meniscus, before, h, start)
                v, z, work = v + impulse * dt / mass, z + shift * dt * dt / mass, work - lost
                h, contact, meniscus = away + z, touches, wet
            force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
            if charge > 0.0:
                force += _electrostatic(charge, radius, contact_m, h)
            v += force * half
            work -= 0.5 * (force_before + force) * (h - before)
            if viscous and (contact or h < viscosity.liquid_thickness_m):
                speed = v - towards - drive_m * turns[at, 2]
                x = damping_at(viscosity, h) * half
                slower = speed * (1.0 - x) / (1.0 + x)
                work += 0.5 * mass * (speed * speed - slower * slower)
                v += slower - speed
            peak = max(peak, force)
            touched += int(contact) * size
        base += base_step
        surface += surface_step
        p += 1
        if p == periods:
            p = 0
        in_phase += z * drive[p, 2]
        quadrature += z * drive[p, 3]
        mean += z
        i += 1
    reading = Reading(
        2.0 * in_phase / steps,
        2.0 * quadrature / steps,
        mean / steps,
        peak,
        work,
        touched / (steps * whole),
    )
    return DynamicState(z, v, base_m, base_velocity, surface_m, contact, meniscus, p), reading


@always_compiled
def _viscous_change(
    viscosity: Viscosity, h: float, speed: float, slope: float, bend: float, force_n: float, mass_kg: float
) -> float:
    """Return a bound of the second derivative in time of F(h) - B(h) h' [N/s^2].

    slope and bend are dF/dh [N/m] and d2F/dh2 [N/m^2], speed is h' [m/s], and force_n the force of sample and spring.
    """
    b = damping_at(viscosity, h)
    if h <= viscosity.contact_distance_m:
        steep = -viscosity.sample_kg_per_s_m
    else:
        steep = -viscosity.liquid_kg_per_s / viscosity.liquid_thickness_m
    pull = (force_n - b * speed) / mass_kg
    jerk = (slope * speed - steep * speed * speed - b * pull) / mass_kg
    return abs(bend * speed * speed + slope * pull) + abs(3.0 * steep * speed * pull) + abs(b * jerk)


@always_compiled
def _way_m(passages: Passages, h: float, contact: bool, meniscus: bool) -> float:
    """Return the longest path [m] of one part of a step from h [m]: a share of the distance to the next jump."""
    jump = passages.end_m if contact else passages.onset_m
    bridge = passages.breaks_m if meniscus else passages.forms_m
    return max(_LOOK_AHEAD * min(abs(h - jump), abs(h - bridge)), _LEAST_WAY_M)


@always_compiled
def _level(flows: npt.NDArray[np.float64], change: float, speed: float, way_m: float, bound: float, part: int) -> int:
    """Return how many times a step has to be halved.

    Args:
        flows: The table `flows` of `Finer`.
        change: Second derivative of the force in time [N/s^2].
        speed: Speed of the tip against the sample [m/s].
        way_m: Longest path of the tip in one part [m].
        bound: Upper bound of `change` times the square of the duration [N].
        part: Position within the step, in shortest parts; a part begins at a multiple of its own length.
    """
    level, last = 0, flows.shape[0] - 1
    while level < last:
        dt = flows[level, 4]
        # NaN fails every comparison and so leads to the shortest part.
        if change * dt * dt <= bound and speed * dt <= way_m and part % (1 << (last - level)) == 0:
            break
        level += 1
    return level


@always_compiled
def _jumps(
    passages: Passages,
    touches: bool,
    wet: bool,
    contact: bool,
    meniscus: bool,
    before_m: float,
    after_m: float,
    start_m: float,
) -> tuple[float, float, float]:
    """Return the sums of `_corrected` (impulse, shift, work) over the jumps between two branches."""
    impulse, shift, work = 0.0, 0.0, 0.0
    if touches != contact:
        at = passages.onset_m if touches else passages.end_m
        jump = passages.onset_n if touches else passages.end_n
        slope = passages.onset_n_per_m if touches else passages.end_n_per_m
        impulse, shift, work = _corrected(at, jump, slope, before_m, after_m, start_m)
    if wet != meniscus:
        at = passages.forms_m if wet else passages.breaks_m
        jump = passages.forms_n if wet else passages.breaks_n
        more = _corrected(at, jump, 0.0, before_m, after_m, start_m)
        impulse, shift, work = impulse + more[0], shift + more[1], work + more[2]
    return impulse, shift, work


@always_compiled
def _corrected(
    at_m: float, jump_n: float, slope_n_per_m: float, before_m: float, after_m: float, start_m: float
) -> tuple[float, float, float]:
    """Return the correction for a jump of the force, or of its gradient, inside a step: impulse, shift, work [J].

    The half impulses count the jump for half of the step, but it acts from the crossing on. start_m is the motion of
    the step at its initial speed; with both ends it gives the time of the crossing to second order. Impulse and shift
    [N] become a velocity and a distance when multiplied by dt / m and dt^2 / m.
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


# Compiled here; nodes without a compiler call the plain Python function.
_electrostatic = always_compiled(electrostatic_force_n)


@always_compiled
def damping_at(viscosity: Viscosity, h: float) -> float:
    """Damping coefficient B [kg/s] of liquid layer or sample at h [m] (Eq. 4, E2)."""
    if h <= viscosity.contact_distance_m:
        return viscosity.sample_kg_per_s_m * (viscosity.contact_distance_m - h)
    return viscosity.liquid_kg_per_s * max(1.0 - h / viscosity.liquid_thickness_m, 0.0)


def steady_state(plant: DynamicPlant, base_m: float, drive_m: float) -> DynamicState:
    """Return the state of a tip that vibrates steadily far from any sample, with which a scan or a curve begins."""
    velocity = plant.steady_quadrature * 2.0 * math.pi * plant.drive_hz
    return DynamicState(plant.steady_in_phase * drive_m, velocity * drive_m, base_m, 0.0, 0.0, False, False, 0)


def free_amplitude_m(plant: DynamicPlant, drive_m: float) -> float:
    """Return the amplitude of zeta without a sample [m], for a base that vibrates with amplitude drive_m [m]."""
    return math.hypot(plant.steady_in_phase, plant.steady_quadrature) * drive_m
