"""Dynamic cantilever: Eq. 4 in full, with base excitation, in fixed steps of a fraction of the drive's period.

With the deflection zeta = h + x_s + s - L, the base x_s = x_b + x_d (moved slowly, and shaken by x_d = A_d cos(w t))
and the height s of the surface under the tip, Eq. 4 reads

    m zeta'' + 2 m b zeta' + k zeta = F(h) - B(h) h' + m x_s'',    b = pi f / Q,  m = k / (2 pi f)^2.

A step is a Strang splitting: half an impulse of the tip-sample force, the exact motion of the driven damped spring
without it, the other half. What is stiff or lightly damped is thus exact at any step (free amplitude, phase, Q), and
the error is that of the force alone, second order in the step: the impulse of a step of dt misses dt^3/12 of the
second derivative of the force along the way. Where the tip meets the sample a step is therefore halved until this
error, times the greatest speed of the tip, stays below its share of TOLERANCE_J; away from the sample FAR_STEPS are
taken at once. Where the force jumps inside a step (a meniscus forms or breaks, printed contact), the time of the
crossing is found and the impulse corrected to second order: without that the energy lost in a cycle would depend on
the grid.

Thermal noise is drawn KICKS_PER_PERIOD times in a period, deflection and velocity together, with the covariance that
white noise gives the damped spring in that time (Ornstein and Uhlenbeck; M. C. Wang and G. E. Uhlenbeck, Rev. Mod.
Phys. 17 (1945) 323, section 9). The spectral density of the free tip is thus right at any step, from zero on.

Liquid damping acts inside the layer (E2): B = pi tau_l R (L_l - h) / L_l for a0 < h < L_l, and in contact
B = pi tau_s R (a0 - h) / L_s.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.physics.cantilever import Plant
from services.afm_node.physics.contact.electrostatic import electrostatic_force_n
from services.afm_node.physics.contact.force_grid import (
    ForceGrid,
    Passages,
    build_force_grid,
    grid_force,
    grid_slopes,
    passed,
)
from services.numerics.compiled import always_compiled

BOLTZMANN_J_PER_K = 1.380649e-23
# draws of thermal noise in a period, and the standard normal numbers that they take
KICKS_PER_PERIOD = 8
NORMALS_PER_PERIOD = 2 * KICKS_PER_PERIOD
# steps taken at once away from the sample
FAR_STEPS = 8
# the most of the shortest steps that a period has
FINEST = 1536
# the errors of the steps through the force of the sample change the energy of a period by less than this, 0.06 eV
TOLERANCE_J = 0.06 * 1.602176634e-19
# the share of a period in which a tip that taps meets that force
_MEETING = 0.1
# a step goes no further than this share of the way to the next jump of the force, or this far where that is nearer
_LOOK_AHEAD = 0.25
_LEAST_WAY_M = 40e-12
# the speed of an amplitude of this is the least that the error of an impulse is multiplied by
_LEAST_AMPLITUDE_M = 1e-9
_FAR_M = 8e-9
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


class Finer(NamedTuple):
    """A step and its halves, quarters and further binary parts, for the way through the force of the sample.

    Attributes:
        flows: Shape (levels, 5): zz, zv, vz, vv of `Flow` and the duration [s]; row 0 is the whole step.
        pushes: Shape (n (2^levels - 1), 2): what unit base amplitude adds to zeta [1] and zeta' [1/s] in a part of a
            step; the parts of level l begin at row n (2^l - 1).
        turns: Shape (n 2^(levels - 1), 3): cos, sin and velocity [1/s] of the drive at the start of each of the
            shortest parts.
        error_w: Error of the energy that is allowed in a time, times 12 [W].
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

    Args:
        plant: The cantilever over its sample.
        state: Its motion, at the start of a step.
        base_m: Place of the base at the end [m].
        surface_m: Height of the surface under the tip at the end [m].
        drive_m: Amplitude of the base's vibration [m].
        steps: Steps of the plant's drive; one is divided further where the tip meets the sample.
        normals: Standard normal numbers for thermal noise, two for each eighth of a period, or none at all.

    Raises:
        ValueError: If there are fewer normal numbers.
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
    # compiled code checks no index: both tables are looked up within their length
    if normals.size > 0 and normals.size < 2 * (steps // every):
        raise ValueError("thermal noise needs two normal numbers for each eighth of a period")
    z, v = state.deflection_m, state.velocity_m_per_s
    contact, meniscus, p = state.contact, state.meniscus, state.phase_step % periods
    base, surface = state.base_m, state.surface_m
    base_step, surface_step = (base_m - base) / steps, (surface_m - surface) / steps
    base_velocity = base_step / step_s
    towards = base_velocity + surface_step / step_s
    amplitude_m = max(drive_m * math.hypot(plant.steady_in_phase, plant.steady_quadrature), _LEAST_AMPLITUDE_M)
    # the change of the force, over the square of a step, that its error may have: [N/s^2] times s^2
    bound = plant.finer.error_w / (2.0 * math.pi * plant.drive_hz * amplitude_m)
    # the base takes up its new speed at once, the tip does not
    v += base_velocity - state.base_velocity_m_per_s
    h = rest + z - base - surface - drive_m * drive[p, 2]
    contact, meniscus = passed(passages, h, contact, meniscus)
    force = grid_force(cubics, start_m, cells_per_m, attraction, h, 2 * int(contact) + int(meniscus))
    if charge > 0.0:
        force += _electrostatic(charge, radius, contact_m, h)
    in_phase, quadrature, mean, mean_force, peak = 0.0, 0.0, 0.0, 0.0, force
    work, touched, kick = 0.0, 0, 0
    i, fine_until = 0, 0
    while i < steps:
        if h > far_m and i >= fine_until and i + FAR_STEPS <= steps and normals.size == 0:
            # away from the sample the force is weak and smooth: several steps at once
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
            # A tip that turns on the way may have come nearer than at both ends.
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
                mean_force += 0.5 * (force_before + force) * FAR_STEPS
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
            mean_force += 0.5 * (force_before + force) * size / whole
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
        mean_force / steps,
        peak,
        work,
        touched / (steps * whole),
    )
    return DynamicState(z, v, base_m, base_velocity, surface_m, contact, meniscus, p), reading


@always_compiled
def _viscous_change(
    viscosity: Viscosity, h: float, speed: float, slope: float, bend: float, force_n: float, mass_kg: float
) -> float:
    """Return the second derivative along the way of F(h) - B(h) h' [N/s^2].

    slope and bend are dF/dh and d2F/dh2, and force_n is that of sample and spring.
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
    """Return how far a part of a step may go from h [m]: a share of the way to the next jump of the force [m]."""
    jump = passages.end_m if contact else passages.onset_m
    bridge = passages.breaks_m if meniscus else passages.forms_m
    return max(_LOOK_AHEAD * min(abs(h - jump), abs(h - bridge)), _LEAST_WAY_M)


@always_compiled
def _level(flows: npt.NDArray[np.float64], change: float, speed: float, way_m: float, bound: float, part: int) -> int:
    """Return how often a step has to be halved.

    Args:
        flows: Those of `Finer`.
        change: Second derivative of the force along the way [N/s^2].
        speed: Of the tip against the sample [m/s].
        way_m: How far the tip may go in one part [m].
        bound: What `change` times the square of the duration may be [N].
        part: The place within the step, in shortest parts; a part begins at a multiple of its own length.
    """
    level, last = 0, flows.shape[0] - 1
    while level < last:
        dt = flows[level, 4]
        # a NaN goes on to the shortest part
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
    """Return impulse, shift and work of the jumps between two branches, as `_corrected` has them."""
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
    """Return what a jump of the force, or of its gradient, inside a step needs: impulse, shift, work [J].

    The half impulses count the jump for half of the step; it acted from the crossing on. start_m, the way of a step at
    the speed of its start, gives with both ends the time of the crossing to second order. Impulse and shift are in
    units of step and squared step over the mass.
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
    finest: int = FINEST,
) -> DynamicPlant:
    """Prepare the exact motion of the driven spring over one step.

    Args:
        plant: The cantilever with its tip.
        resonance_hz: The frequency of the resonance, f [Hz].
        quality: The quality factor Q, above 1/2, because the spring has to oscillate.
        drive_hz: The frequency of the drive [Hz].
        damping: The damping between tip and sample.
        steps_per_period: The steps in a period of the drive, a multiple of 8.
        temperature_k: The temperature of thermal noise [K], which acts where normal numbers are given.
        like: A dynamic cantilever with the same spring, tip and sample, whose grid of the force is reused.
        finest: The most steps of a period where a step is divided because the tip meets the sample.

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
    """Return a step of dt [s], of which a period has n, and its binary parts, of which it has up to `most`.

    `response` is that of zeta to the base.
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
    """Return the thermal noise of the time of a flow: what is missing to the variances k_B T / k and k_B T / m.

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
