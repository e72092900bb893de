"""The hand moves the tip across the sample, feels the lateral force there, and is guided by virtual fixtures.

*Rate*: the displacement e of the hand from the point where it engaged commands the velocity of the tip,
v = g (|e| - e_0) e / |e|, limited to that of Eq. 14. Then no loop passes through the position of the hand, because the
force of a moving particle does not depend on it. *Position*: the tip moves by the scaled motion of the hand; with the
clutch released, the hand moves freely. The reference of the tip is the sum of these motions. The slave's half adds its
changes to the position of the stage (`lateral_slave_step`). Motion that was not sent, or that arrived after a silence,
is dropped, so the tip never catches up blindly.

The lateral force at the hand is the sum of the force of the tip (scaled, limited to F_max, slew-rate limited), a spring
to the centre (rate), a damper, a pulse of 20 ms when a particle is met or lost, and the fixtures. A fixture is a spring
between the hand and its target: in mode position the point at which the tip is on the line, or outside the disc; in
mode rate the displacement that brings the tip there with a time constant of 1 s. The depth hold is a force on the law's
axis.

**Energy.** The forces of this module are paid from two stores, one for the plane and one for the depth. Each holds the
work of the hand, summed from sample to sample, and half of the energy granted at the start. Before the next sample the
hand can take at most F v T + |F| a T^2 from a force F, with an acceleration of at most a = 20 m/s^2; a force that the
store cannot pay is reduced. So neither store gives out more than was granted, for any delay and any motion of the
fixtures, and the law keeps its promise along its own axis. The stage is a motion source at the slave, limited by its
speed and by the guard's lateral limit.

The energy of the spring to the centre, k e^2 / 2, is reserved for that spring. Otherwise a particle that pushes the
hand back could spend it, no force would bring a released hand back, and in mode rate the tip would never stop.
"""

import math
from typing import NamedTuple

from telenano.numerics.compiler import compiled

# Modes in which the hand moves the tip.
DIRECT = 0
RATE = 1
POSITION = 2
# News of a particle that a step can have.
NO_NEWS = 0
MET = 1
LOST = 2

_HAND_ACCELERATION_M_PER_S2 = 20.0
# Time constant with which fixtures bring the tip to its target in mode rate [s].
_GUIDED_S = 1.0
# Greatest displacement of the hand by fixtures in mode rate [m].
_MOST_GUIDED_M = 5e-3
# Number of successive steps above the noise at which a particle counts as met.
_MET_STEPS = 3
# Share of the plateau below which the force counts as that of a lost particle.
_LOST_SHARE = 0.3
# Number of standard deviations by which a force is above the noise.
_DEVIATIONS = 3.0
# Weight of a step in the running mean and variance of the noise, which thus extend over some 50 steps.
_NOISE_SHARE = 0.02
# Distance of the tip over which the plateau is averaged [m].
_PLATEAU_WAY_M = 7e-9
# Time at rest after which the origin of the reference over the sample is measured again [s].
_STILL_S = 1.0
# Longest time for which one signal may bring motion [s].
_LONGEST_WAY_S = 0.02
# The stage's reference leads its position by at most the motion of _LEAD_S [s] at full speed, plus _LEAD_M [m].
_LEAD_S = 0.1
_LEAD_M = 1e-9
# Time without motion of the hand after which it no longer controls the stage [s].
_IDLE_S = 0.2


class MotionParams(NamedTuple):
    """Mode, whether the clutch is engaged, gain (rate: [1/s], position: [1]), dead zone [m], speed limit [m/s]."""

    mode: int
    engaged: bool
    gain: float
    dead_zone_m: float
    speed_m_per_s: float

    def steering_force_n(
        self,
        stiffness_n_per_m: float,
        place_m: tuple[float, float],
        neutral_m: tuple[float, float],
        shown_n: tuple[float, float],
        speed_m_per_s: tuple[float, float],
    ) -> tuple[float, float]:
        """Return the force of a person who steers [N], as `steering_force_n` of this module does."""
        return steering_force_n(self, stiffness_n_per_m, place_m, neutral_m, shown_n, speed_m_per_s)


@compiled
def steering_force_n(
    motion: MotionParams,
    stiffness_n_per_m: float,
    place_m: tuple[float, float],
    neutral_m: tuple[float, float],
    shown_n: tuple[float, float],
    speed_m_per_s: tuple[float, float],
) -> tuple[float, float]:
    """Return the force [N] of a person who wants a velocity of the tip [m/s] in mode rate.

    The arm is a spring that pulls the stylus to the displacement for that velocity, and opposes the displayed force.
    For velocity 0 that is the point where the stylus engaged.

    Args:
        motion: The constants of the motion of the tip.
        stiffness_n_per_m: The stiffness of the arm [N/m].
        place_m: The position of the stylus [m].
        neutral_m: The position at which it engaged [m].
        shown_n: The force that it displays [N].
        speed_m_per_s: The wanted velocity of the tip [m/s].
    """
    v_x, v_y = speed_m_per_s
    speed = math.sqrt(v_x * v_x + v_y * v_y)
    share = 1.0 / motion.gain + motion.dead_zone_m / speed if speed > 0.0 else 0.0
    x_m, y_m = neutral_m[0] + share * v_x, neutral_m[1] + share * v_y
    return stiffness_n_per_m * (x_m - place_m[0]) - shown_n[0], stiffness_n_per_m * (y_m - place_m[1]) - shown_n[1]


class FeelParams(NamedTuple):
    """Constants of the lateral force at the hand, and its energy limits (`LateralConfig`)."""

    force_scale: float
    max_force_n: float
    force_rate_n_per_s: float
    centring_n_per_m: float
    damping_n_s_per_m: float
    pulse_n: float
    pulse_s: float
    contact_n: float
    lost_way_m: float
    granted_j: float
    store_j: float


class GuideParams(NamedTuple):
    """Constants of a line over the sample that guides the hand."""

    enabled: bool
    x0_m: float
    y0_m: float
    x1_m: float
    y1_m: float
    stiffness_n_per_m: float
    max_force_n: float


class DiscParams(NamedTuple):
    """Constants of a disc over the sample that the hand is kept out of."""

    enabled: bool
    x_m: float
    y_m: float
    radius_m: float
    stiffness_n_per_m: float
    max_force_n: float


class DepthParams(NamedTuple):
    """Constants of the hold of the hand's depth."""

    enabled: bool
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    max_force_n: float


class LateralParams(NamedTuple):
    """Constants of the lateral path."""

    motion: MotionParams
    feel: FeelParams
    guide: GuideParams
    disc: DiscParams
    depth: DepthParams


class LateralHand(NamedTuple):
    """A sample of the hand: position across and along the law's axis (z) [m], velocities [m/s], whether it follows."""

    x_m: float
    y_m: float
    z_m: float
    speed_x_m_per_s: float
    speed_y_m_per_s: float
    speed_z_m_per_s: float
    following: bool


class LateralFar(NamedTuple):
    """Values from the slave's half: lateral force on the tip [N], position of the stage [m]; known: they are recent."""

    force_x_n: float
    force_y_n: float
    x_m: float
    y_m: float
    known: bool


class ContactDetector(NamedTuple):
    """Detects a particle by its force.

    mean_n, variance_n2: of the force without a particle [N, N^2]; steps: successive steps above the noise; plateau_n:
    mean force of the particle [N]; faint_m: distance moved with a force far below it [m]; x_m, y_m: last position of
    the stage [m].
    """

    mean_n: float
    variance_n2: float
    steps: int
    plateau_n: float
    faint_m: float
    x_m: float
    y_m: float


class Clutch(NamedTuple):
    """The hand at its last sample: position [m], mode and clutch; live: whether it followed.

    neutral_x_m, neutral_y_m: position at which it engaged [m]; depth_m: depth at which it is held, if `holds` [m].
    """

    live: bool
    mode: int
    engaged: bool
    holds: bool
    x_m: float
    y_m: float
    z_m: float
    neutral_x_m: float
    neutral_y_m: float
    depth_m: float


class Path(NamedTuple):
    """Sum of the motions of the tip [m], its origin over the sample [m] if `placed`, time since the last motion [s]."""

    x_m: float
    y_m: float
    placed: bool
    origin_x_m: float
    origin_y_m: float
    still_s: float


class RenderedForce(NamedTuple):
    """The force of the tip as rendered at the hand [N], and the remaining time [s] and direction of a pulse."""

    x_n: float
    y_n: float
    pulse_s: float
    pulse_x: float
    pulse_y: float


class EnergyTank(NamedTuple):
    """Energy that entered laterally, stored lateral energy, stored energy of the depth, and dissipated energy [J]."""

    entered_j: float
    left_j: float
    left_z_j: float
    spilled_j: float


NO_ENERGY = EnergyTank(0.0, 0.0, 0.0, 0.0)


class LateralMasterState(NamedTuple):
    """State of the master's half of the lateral path; recordings use these names of its parts.

    force_n: force displayed at the hand, across and along the law's axis [N]; news: whether a particle was met or lost.
    """

    held: Clutch
    travel: Path
    touch: ContactDetector
    felt: RenderedForce
    store: EnergyTank
    force_n: tuple[float, float, float]
    news: int


@compiled
def lateral_at_rest() -> LateralMasterState:
    """Return the state before the first sample."""
    return LateralMasterState(
        Clutch(False, DIRECT, False, False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        Path(0.0, 0.0, False, 0.0, 0.0, 0.0),
        ContactDetector(0.0, 0.0, 0, 0.0, 0.0, 0.0, 0.0),
        RenderedForce(0.0, 0.0, 0.0, 0.0, 0.0),
        NO_ENERGY,
        (0.0, 0.0, 0.0),
        NO_NEWS,
    )


@compiled
def _length(x: float, y: float) -> float:
    return math.sqrt(x * x + y * y)


@compiled
def _clipped(x: float, y: float, most: float) -> tuple[float, float]:
    size = _length(x, y)
    share = most / size if size > most else 1.0
    return share * x, share * y


@compiled
def _clutched(params: LateralParams, before: Clutch, hand: LateralHand) -> Clutch:
    """Return the hand at a sample; it engages anew at its start, and after a change of mode or of the clutch."""
    motion = params.motion
    takes_hold = not (before.live and before.engaged and before.mode == motion.mode)
    holds = params.depth.enabled and hand.following
    return Clutch(
        live=hand.following,
        mode=motion.mode,
        engaged=motion.engaged,
        holds=holds,
        x_m=hand.x_m,
        y_m=hand.y_m,
        z_m=hand.z_m,
        neutral_x_m=hand.x_m if takes_hold else before.neutral_x_m,
        neutral_y_m=hand.y_m if takes_hold else before.neutral_y_m,
        depth_m=before.depth_m if holds and before.holds else hand.z_m,
    )


@compiled
def _tank_after(feel: FeelParams, state: LateralMasterState, hand: LateralHand) -> EnergyTank:
    """Return the energy after the work of the force that was displayed since the last sample."""
    before, tank = state.held, state.store
    if not before.live:
        return tank
    f_x, f_y, f_z = state.force_n
    across = f_x * (hand.x_m - before.x_m) + f_y * (hand.y_m - before.y_m)
    left, left_z = tank.left_j - across, tank.left_z_j - f_z * (hand.z_m - before.z_m)
    kept, kept_z = min(left, feel.store_j), min(left_z, feel.store_j)
    return EnergyTank(tank.entered_j - across, kept, kept_z, tank.spilled_j + (left - kept) + (left_z - kept_z))


@compiled
def _step_m(params: LateralParams, before: Clutch, clutch: Clutch, path: Path, dt: float) -> tuple[float, float]:
    """Return the motion of the tip in a step of dt [s] in x and y [m]."""
    motion, disc = params.motion, params.disc
    if motion.mode == POSITION:
        if not before.live:
            return 0.0, 0.0
        x, y = motion.gain * (clutch.x_m - before.x_m), motion.gain * (clutch.y_m - before.y_m)
        return _clipped(x, y, motion.speed_m_per_s * dt)
    x, y = clutch.x_m - clutch.neutral_x_m, clutch.y_m - clutch.neutral_y_m
    size = _length(x, y)
    share = motion.gain * dt * (1.0 - motion.dead_zone_m / size) if size > motion.dead_zone_m else 0.0
    x, y = _clipped(share * x, share * y, motion.speed_m_per_s * dt)
    out_x, out_y = path.origin_x_m + path.x_m - disc.x_m, path.origin_y_m + path.y_m - disc.y_m
    size = _length(out_x, out_y)
    if not (disc.enabled and path.placed and 0.0 < size < disc.radius_m):
        return x, y
    # Within the disc the tip may move only outwards or tangentially.
    inwards = min((x * out_x + y * out_y) / size, 0.0)
    return x - inwards * out_x / size, y - inwards * out_y / size


@compiled
def _path_after(path: Path, way: tuple[float, float], far: LateralFar, dt: float) -> Path:
    x, y = path.x_m + way[0], path.y_m + way[1]
    still = 0.0 if way[0] != 0.0 or way[1] != 0.0 else path.still_s + dt
    if far.known and (not path.placed or still > _STILL_S):
        return Path(x, y, True, far.x_m - x, far.y_m - y, still)
    return Path(x, y, path.placed, path.origin_x_m, path.origin_y_m, still)


@compiled
def _displacement_m(motion: MotionParams, e_n: float, aside_m: float) -> float:
    """Return the motion of the hand along a normal [m] that brings the tip `aside_m` [m] along it.

    Args:
        motion: The constants of the motion.
        e_n: Displacement of the hand along the normal [m].
        aside_m: The distance from tip to target along the normal [m]; negative if the target is behind it.
    """
    if motion.mode == POSITION:
        return aside_m / motion.gain
    return min(max(aside_m / (_GUIDED_S * motion.gain), -_MOST_GUIDED_M), _MOST_GUIDED_M) - e_n


@compiled
def _fixtures(params: LateralParams, clutch: Clutch, path: Path) -> tuple[float, float]:
    """Return the force of guide and disc on the hand in x and y [N]; zero while released or without a known origin."""
    force_x, force_y = 0.0, 0.0
    if not (path.placed and clutch.engaged):
        return force_x, force_y
    x, y = path.origin_x_m + path.x_m, path.origin_y_m + path.y_m
    e_x, e_y = clutch.x_m - clutch.neutral_x_m, clutch.y_m - clutch.neutral_y_m
    guide, disc = params.guide, params.disc
    along_x, along_y = guide.x1_m - guide.x0_m, guide.y1_m - guide.y0_m
    length = _length(along_x, along_y)
    if guide.enabled and length > 0.0:
        n_x, n_y = -along_y / length, along_x / length
        aside = (x - guide.x0_m) * n_x + (y - guide.y0_m) * n_y
        drawn = guide.stiffness_n_per_m * _displacement_m(params.motion, e_x * n_x + e_y * n_y, -aside)
        drawn = min(max(drawn, -guide.max_force_n), guide.max_force_n)
        force_x, force_y = drawn * n_x, drawn * n_y
    out_x, out_y = x - disc.x_m, y - disc.y_m
    size = _length(out_x, out_y)
    if disc.enabled and size > 0.0:
        n_x, n_y = out_x / size, out_y / size
        drawn = disc.stiffness_n_per_m * _displacement_m(params.motion, e_x * n_x + e_y * n_y, disc.radius_m - size)
        drawn = min(max(drawn, 0.0), disc.max_force_n)
        force_x, force_y = force_x + drawn * n_x, force_y + drawn * n_y
    return force_x, force_y


@compiled
def _detect_contact(feel: FeelParams, contact: ContactDetector, far: LateralFar) -> tuple[ContactDetector, int]:
    """Return the detector after a lateral force of the tip, and whether a particle was met or lost by it."""
    size, way = _length(far.force_x_n, far.force_y_n), _length(far.x_m - contact.x_m, far.y_m - contact.y_m)
    mean, variance, steps, plateau, faint = (
        contact.mean_n,
        contact.variance_n2,
        contact.steps,
        contact.plateau_n,
        contact.faint_m,
    )
    news = NO_NEWS
    if steps < _MET_STEPS:
        if size > mean + _DEVIATIONS * math.sqrt(variance) + feel.contact_n:
            steps, plateau, faint = steps + 1, size, 0.0
            news = MET if steps == _MET_STEPS else NO_NEWS
        else:
            aside = size - mean
            steps, mean = 0, mean + _NOISE_SHARE * aside
            variance += _NOISE_SHARE * (aside * aside - variance)
    elif size < _LOST_SHARE * plateau:
        faint += way
        if faint > feel.lost_way_m:
            steps, mean, variance, plateau, faint, news = 0, size, 0.0, 0.0, 0.0, LOST
    else:
        plateau, faint = plateau + way / (way + _PLATEAU_WAY_M) * (size - plateau), 0.0
    return ContactDetector(mean, variance, steps, plateau, faint, far.x_m, far.y_m), news


@compiled
def _rendered(
    feel: FeelParams, rendered: RenderedForce, far: LateralFar, news: int, way: tuple[float, float], dt: float
) -> RenderedForce:
    """Return the rendered force of the tip, which fades to zero during a silence, and the pulse.

    A new pulse acts against the motion `way` of the tip [m].
    """
    scale = feel.force_scale if far.known else 0.0
    x, y = _clipped(scale * far.force_x_n, scale * far.force_y_n, feel.max_force_n)
    x, y = _clipped(x - rendered.x_n, y - rendered.y_n, feel.force_rate_n_per_s * dt)
    if news == NO_NEWS:
        return RenderedForce(
            rendered.x_n + x, rendered.y_n + y, max(rendered.pulse_s - dt, 0.0), rendered.pulse_x, rendered.pulse_y
        )
    size = _length(way[0], way[1])
    back_x, back_y = (-way[0] / size, -way[1] / size) if size > 0.0 else (1.0, 0.0)
    return RenderedForce(rendered.x_n + x, rendered.y_n + y, feel.pulse_s, back_x, back_y)


@compiled
def _force_n(
    params: LateralParams,
    clutch: Clutch,
    path: Path,
    rendered: RenderedForce,
    tank: EnergyTank,
    hand: LateralHand,
    dt: float,
) -> tuple[float, float, float]:
    """Return the force displayed until the next sample, in x, y and z [N], reduced to the energy in the stores."""
    feel, depth = params.feel, params.depth
    v_x, v_y, v_z = hand.speed_x_m_per_s, hand.speed_y_m_per_s, hand.speed_z_m_per_s
    drawn_x, drawn_y = _fixtures(params, clutch, path)
    share = rendered.pulse_s / feel.pulse_s
    pulse = feel.pulse_n * 4.0 * share * (1.0 - share)
    spring = feel.centring_n_per_m if clutch.engaged else 0.0
    damping = feel.damping_n_s_per_m
    e_x, e_y = clutch.x_m - clutch.neutral_x_m, clutch.y_m - clutch.neutral_y_m
    back_x, back_y = _clipped(-spring * e_x - damping * v_x, -spring * e_y - damping * v_y, feel.max_force_n)
    f_x, f_y = rendered.x_n + drawn_x + pulse * rendered.pulse_x, rendered.y_n + drawn_y + pulse * rendered.pulse_y
    f_x, f_y = _clipped(f_x + back_x, f_y + back_y, feel.max_force_n)
    f_x, f_y = f_x - back_x, f_y - back_y
    f_z = 0.0
    if clutch.holds:
        f_z = depth.stiffness_n_per_m * (clutch.depth_m - clutch.z_m) - depth.damping_n_s_per_m * v_z
        f_z = min(max(f_z, -depth.max_force_n), depth.max_force_n)
    granted = 0.5 * feel.granted_j
    left_j, back_j = tank.left_j + granted, _most_j(_length(back_x, back_y), back_x * v_x + back_y * v_y, dt)
    share = _affordable(back_j, left_j)
    back_x, back_y = share * back_x, share * back_y
    # The energy of the spring to the centre is reserved for it, because it has to bring back a released hand.
    kept_j = max(0.5 * spring * (e_x * e_x + e_y * e_y), share * back_j)
    share = _affordable(_most_j(_length(f_x, f_y), f_x * v_x + f_y * v_y, dt), left_j - kept_j)
    share_z = _affordable(_most_j(abs(f_z), f_z * v_z, dt), tank.left_z_j + granted)
    return back_x + share * f_x, back_y + share * f_y, share_z * f_z


@compiled
def _most_j(force_n: float, power_w: float, dt: float) -> float:
    """Return the greatest energy [J] that the hand can take in dt [s] from a force [N], at its present power [W]."""
    return (power_w + force_n * _HAND_ACCELERATION_M_PER_S2 * dt) * dt


@compiled
def _affordable(most_j: float, left_j: float) -> float:
    """Return the share of a force that left_j pays, if the hand can take at most most_j from the whole force [J]."""
    left = max(left_j, 0.0)
    return left / most_j if most_j > left else 1.0


@compiled
def lateral_master_step(
    params: LateralParams, state: LateralMasterState, hand: LateralHand, far: LateralFar, dt: float
) -> LateralMasterState:
    """Return the state after a sample of the hand: reference, forces, energy, and news of a particle.

    Args:
        params: The constants, of mode rate or position.
        state: The state at the previous sample.
        hand: The sample.
        far: The values from the slave's half.
        dt: The time between the two samples [s].
    """
    clutch, tank = _clutched(params, state.held, hand), _tank_after(params.feel, state, hand)
    moves = clutch.live and clutch.engaged and far.known
    way = _step_m(params, state.held, clutch, state.travel, dt) if moves else (0.0, 0.0)
    path = _path_after(state.travel, way, far, dt)
    contact, news = _detect_contact(params.feel, state.touch, far) if far.known else (state.touch, NO_NEWS)
    rendered = _rendered(params.feel, state.felt, far, news, way, dt)
    force = _force_n(params, clutch, path, rendered, tank, hand, dt) if clutch.live else (0.0, 0.0, 0.0)
    return LateralMasterState(clutch, path, contact, rendered, tank, force, news)


class LateralSlaveState(NamedTuple):
    """State of the slave's half: newest reference of the hand [m], and target of the stage [m].

    live: there is a previous reference to continue from; idle_s: time since the hand moved the stage [s].
    """

    live: bool
    reference_x_m: float
    reference_y_m: float
    x_m: float
    y_m: float
    idle_s: float


@compiled
def lateral_slave_at_rest() -> LateralSlaveState:
    """Return the state before the first signal."""
    return LateralSlaveState(False, 0.0, 0.0, 0.0, 0.0, _IDLE_S)


@compiled
def hand_moves(state: LateralSlaveState) -> bool:
    """Return whether the hand controls the stage."""
    return state.live and state.idle_s < _IDLE_S


@compiled
def lateral_slave_step(
    params: LateralParams,
    state: LateralSlaveState,
    reference_m: tuple[float, float],
    place_m: tuple[float, float],
    continues: bool,
    dt: float,
) -> LateralSlaveState:
    """Return the state after a signal with a reference [m], dt [s] after the previous one; the stage is at place_m [m].

    continues: the instrument follows, and neither a silence nor a restart lies between this signal and the previous.
    """
    x, y = reference_m
    if not (state.live and continues):
        return LateralSlaveState(continues, x, y, place_m[0], place_m[1], _IDLE_S)
    speed = params.motion.speed_m_per_s
    # The limit is 1.5 times the speed, because signals come in bursts.
    way = _clipped(x - state.reference_x_m, y - state.reference_y_m, 1.5 * speed * min(dt, _LONGEST_WAY_S))
    idle = 0.0 if way[0] != 0.0 or way[1] != 0.0 else state.idle_s + dt
    from_x, from_y = (state.x_m, state.y_m) if state.idle_s < _IDLE_S else place_m
    ahead = _clipped(from_x + way[0] - place_m[0], from_y + way[1] - place_m[1], _LEAD_S * speed + _LEAD_M)
    return LateralSlaveState(True, x, y, place_m[0] + ahead[0], place_m[1] + ahead[1], min(idle, _IDLE_S))
