"""The virtual coupling between a law's reference and a device that takes a force (impedance type), and its safety.

The laws are of admittance type: they take the force of the hand and return a position. A device of impedance type
returns a position and takes a force, so a spring and a damper connect the two (J. E. Colgate, M. C. Stanley, J. M.
Brown, "Issues in the haptic display of tool use", IROS 1995; R. J. Adams and B. Hannaford, "Stable haptic interaction
with virtual environments", IEEE Trans. Robotics and Automation 15, 1999):

    f[k] = -(K r + B w)[k] + f_ref,   r = x - x_ref,   w = (r[k] - r[k-1]) / T, low-passed with exp(-2 pi f_c T)

f acts on the hand, and the law takes -f as the estimate of the operator's force; at rest the two are equal.

Two bounds on K, for a sample time T, a delay D of the drive, a physical damping b and a moving mass m of the device:

    passive: b > K (T/2 + D) + |B|      (J. E. Colgate and G. G. Schenkel, J. Robotic Systems 14, 1997)
    stable:  K <= (b + B) / (T/2 + D)   hands off, reference clamped (J. J. Gil et al.; T. Hulin et al.), over a margin,
             and m >= `least_mass_kg`, because the damper B also acts late

The step runs in the servo of the device, where T and D are known. So do the rules that remove the force, see `Gate`:
the force goes to zero at once, and returns from zero at most at the slew rate. An implausible reading (not a number, a
jump, a position that stands still under a changing force) is refused until a person arms again.

Vectors are in the master frame of the messages: z away from the sample, so pushing is -z.
"""

import math
from typing import NamedTuple

from telenano.extend.hands import DeviceReading, Gate, SpatialReading
from telenano.numerics import compiled

Pair = tuple[float, float]
Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
# The orientation of a device without a wrist.
UPRIGHT: Quaternion = SpatialReading().orientation

# Margin of the default stiffness below the stable bound. The default is stable but not passive: the devices of vendors
# lie between the two bounds.
STABLE_MARGIN = 4.0
# The greatest speed of a hand [m/s]; the change of position beyond it is compared with `jump_m`.
_FASTEST_M_PER_S = 2.0


# Compiled code uses the gates as integers.
GATE_ACTIVE = int(Gate.ACTIVE)
GATE_READY = int(Gate.READY)
GATE_RELEASED = int(Gate.RELEASED)
GATE_REST = int(Gate.REST)
GATE_SILENT = int(Gate.SILENT)
GATE_DEADMAN = int(Gate.DEADMAN)
GATE_REFERENCE = int(Gate.REFERENCE)
GATE_DEVICE_SILENT = int(Gate.DEVICE_SILENT)
GATE_NOT_A_NUMBER = int(Gate.NOT_A_NUMBER)
GATE_JUMP = int(Gate.JUMP)
GATE_FROZEN = int(Gate.FROZEN)
GATE_RUNAWAY = int(Gate.RUNAWAY)


class CouplingSettings(NamedTuple):
    """K [N/m] and B [N s/m] per axis, limits of the force, and the criteria of silence, rest, jump and freezing.

    max_force_n, max_slew_n_per_s: limits of the magnitude of the force vector and of its change. velocity_filter_hz:
    f_c [Hz], 0 for none. silence_s: longest age of command or reading [s]. deadman_age_s: longest age of a report of
    the dead-man button [s]; a grip reports at some 50 Hz and falls asleep when it is left. rest_s: time for which the
    hand has to stay within rest_m [m] before there is force. jump_m: a step longer than this plus the path at 2 m/s is
    no motion of a hand [m]. frozen_s: longest time for which the position may be exactly the same while the force has
    changed by frozen_force_n [s]; 0 for no limit. runaway_m_per_s: speed against more than half of the greatest force
    that no hand reaches, but a device that pushes the wrong way soon does. extrapolation_s: longest time by which a
    reference is extrapolated [s].
    """

    stiffness_n_per_m: Vector
    damping_n_s_per_m: Vector
    max_force_n: float
    max_slew_n_per_s: float
    velocity_filter_hz: float = 0.0
    needs_deadman: bool = False
    silence_s: float = 0.05
    deadman_age_s: float = 0.1
    rest_s: float = 0.2
    rest_m: float = 2e-3
    jump_m: float = 0.005
    frozen_s: float = 0.1
    frozen_force_n: float = 1.0
    runaway_m_per_s: float = 0.5
    extrapolation_s: float = 2e-3


class CouplingReference(NamedTuple):
    """The command of the node: x_ref [m] and its velocity [m/s], and a force that is added, f_ref [N].

    engaged: the law drives the device (the guard's mode is position). age_s: time since the node wrote the command [s].
    arm_count: increases when a person arms, which ends a refusal.
    """

    position_m: Vector
    velocity_m_per_s: Vector
    force_n: Vector
    engaged: bool
    age_s: float
    arm_count: int


class CouplingReading(NamedTuple):
    """The reading of the device: its position [m] with its age [s], and the dead-man button with its own age [s]."""

    position_m: Vector
    age_s: float
    deadman: bool
    deadman_age_s: float


class CouplingState(NamedTuple):
    """State of the coupling.

    gate: one of `Gate`; limited: clamp or slew acts. force_n: force sent last [N]; own_force_n: the same without f_ref.
    position_m, reference_m: those of the last step [m]. rate_m_per_s: w after its filter; velocity_m_per_s: velocity of
    the device after the same filter. started: there was a position. rest_place_m, rest_s: position near which the hand
    has stayed, and for how long. still_force_n: force when the position last changed; still_s: time for which it has
    been the same although the force was another. arm_count: newest count that was obeyed. hand_energy_j: net energy
    from the hand [J]. coupling_energy_j: net energy that spring and damper have absorbed [J]; below zero the coupling
    generates energy.
    """

    gate: int
    limited: bool
    force_n: Vector
    own_force_n: Vector
    position_m: Vector
    reference_m: Vector
    rate_m_per_s: Vector
    velocity_m_per_s: Vector
    started: bool
    rest_place_m: Vector
    rest_s: float
    still_s: float
    still_force_n: Vector
    arm_count: int
    hand_energy_j: float
    coupling_energy_j: float


def coupling_at_start(arm_count: int = 0) -> CouplingState:
    """Return the state before the first sample: no force until the hand has been at rest."""
    return CouplingState(
        GATE_REST, False, ZERO, ZERO, ZERO, ZERO, ZERO, ZERO, False, ZERO, 0.0, 0.0, ZERO, arm_count, 0.0, 0.0
    )


def passive_stiffness_n_per_m(b_n_s_per_m: float, damping_n_s_per_m: float, sample_s: float, delay_s: float) -> float:
    """Return the K [N/m] below which any passive hand is safe, by K (T/2 + D) + |B| < b; 0.0 if there is none."""
    return max(b_n_s_per_m - abs(damping_n_s_per_m), 0.0) / (0.5 * sample_s + delay_s)


def stable_stiffness_n_per_m(b_n_s_per_m: float, damping_n_s_per_m: float, sample_s: float, delay_s: float) -> float:
    """Return the K [N/m] at which a clamped reference begins to oscillate hands off, (b + B) / (T/2 + D)."""
    return (b_n_s_per_m + damping_n_s_per_m) / (0.5 * sample_s + delay_s)


def least_mass_kg(
    k: float, b_n_s_per_m: float, damping_n_s_per_m: float, sample_s: float, delay_s: float, filter_hz: float
) -> float:
    """Return the moving mass [kg] above which K and B are stable: infinite at the stable bound, B n for K = 0.

    A sample of the position acts T/2 + D late in the mean, one of the rate T + D late, and its low-pass adds a delay of
    j T with the weight (1 - a) a^j, a = exp(-2 pi f_c T); n and s are mean and mean square of the latter. A lasting
    oscillation z = exp(i w T) needs m u w <= K + B n u w and (b + B) <= K (T/2 + D) + B s u w / 2, with
    u = (2/T) sin(w T/2): see docs/coupling.md. No w fulfils both if m > B n + K B s / (2 (b + B - K (T/2 + D))).
    """
    a = math.exp(-2.0 * math.pi * filter_hz * sample_s) if filter_hz > 0.0 else 0.0
    mean_s = sample_s + delay_s + sample_s * a / (1.0 - a)
    square_s2 = mean_s**2 + a * (sample_s / (1.0 - a)) ** 2
    left = b_n_s_per_m + damping_n_s_per_m - k * (0.5 * sample_s + delay_s)
    if left <= 0.0:
        return math.inf
    return damping_n_s_per_m * (mean_s + 0.5 * k * square_s2 / left)


@compiled
def _finite(vector: Vector) -> bool:
    return math.isfinite(vector[0]) and math.isfinite(vector[1]) and math.isfinite(vector[2])


@compiled
def _minus(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@compiled
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _length(a: Vector) -> float:
    return math.sqrt(_dot(a, a))


@compiled
def _scaled(a: Vector, factor: float) -> Vector:
    return (a[0] * factor, a[1] * factor, a[2] * factor)


@compiled
def _fault(
    settings: CouplingSettings, state: CouplingState, place: Vector, started: bool, still_s: float, dt: float
) -> int:
    """Return the gate of an implausible reading, or GATE_ACTIVE for a plausible one."""
    if not _finite(place):
        return GATE_NOT_A_NUMBER
    if started:
        if _length(_minus(place, state.position_m)) > settings.jump_m + _FASTEST_M_PER_S * dt:
            return GATE_JUMP
        if 0.0 < settings.frozen_s < still_s:
            return GATE_FROZEN
        against = -_dot(state.force_n, state.velocity_m_per_s)
        size = _length(state.force_n)
        if size > 0.5 * settings.max_force_n and against > settings.runaway_m_per_s * size:
            return GATE_RUNAWAY
    return GATE_ACTIVE


@compiled
def _gate(
    settings: CouplingSettings, gate: int, reference: CouplingReference, reading: CouplingReading, rested: bool
) -> int:
    """Return the gate for a plausible reading.

    After a closed gate the node has to disengage once, so that it begins again at the position of the hand. The
    comparisons are written so that an age that is NaN counts as too old.
    """
    if not reading.age_s <= settings.silence_s:
        return GATE_DEVICE_SILENT
    if not reference.age_s <= settings.silence_s:
        return GATE_SILENT
    if not (_finite(reference.position_m) and _finite(reference.velocity_m_per_s) and _finite(reference.force_n)):
        return GATE_REFERENCE
    if settings.needs_deadman and not (reading.deadman and reading.deadman_age_s <= settings.deadman_age_s):
        return GATE_DEADMAN
    if gate == GATE_DEADMAN:
        gate = GATE_RELEASED
    if gate not in (GATE_ACTIVE, GATE_READY, GATE_RELEASED):
        if not rested:
            return GATE_REST
        gate = GATE_RELEASED
    if not reference.engaged:
        return GATE_READY
    return GATE_RELEASED if gate == GATE_RELEASED else GATE_ACTIVE


@compiled
def _target(settings: CouplingSettings, reference: CouplingReference) -> Vector:
    ahead = min(max(reference.age_s, 0.0), settings.extrapolation_s)
    p, v = reference.position_m, reference.velocity_m_per_s
    return (p[0] + ahead * v[0], p[1] + ahead * v[1], p[2] + ahead * v[2])


@compiled
def _limited(settings: CouplingSettings, before: Vector, wanted: Vector, dt: float) -> tuple[Vector, bool]:
    """Return the force [N] after clamp and slew limit, and whether one of them acts."""
    force, limited = wanted, False
    size = _length(force)
    if size > settings.max_force_n:
        force, limited = _scaled(force, settings.max_force_n / size), True
    step = _minus(force, before)
    change, most = _length(step), settings.max_slew_n_per_s * dt
    if change > most:
        s = most / change
        return (before[0] + s * step[0], before[1] + s * step[1], before[2] + s * step[2]), True
    return force, limited


@compiled
def coupling_step(
    state: CouplingState,
    settings: CouplingSettings,
    reference: CouplingReference,
    reading: CouplingReading,
    dt: float,
) -> tuple[Vector, CouplingState]:
    """Return the force on the hand [N] for the next period, and the state after this sample.

    Args:
        state: The state after the previous sample.
        settings: Gains, limits and criteria of refusal.
        reference: The newest command of the node.
        reading: The newest reading of the device.
        dt: The time since the previous step [s], > 0.

    Raises:
        ValueError: dt is not a positive time.
    """
    if not dt > 0.0:
        raise ValueError("dt of the coupling must be a positive time in s")
    refused = state.gate >= GATE_NOT_A_NUMBER
    if refused and reference.arm_count == state.arm_count:
        return ZERO, _without_force(state, state.gate)
    # After arming, the first position is accepted as it is.
    started = state.started and not refused
    # A force that a gate has removed does not count as a change: the handle may lie in its holder.
    same = started and state.gate == GATE_ACTIVE and reading.position_m == state.position_m
    changed = same and _length(_minus(state.force_n, state.still_force_n)) > settings.frozen_force_n
    still_s = state.still_s + dt if changed else 0.0
    fault = _fault(settings, state, reading.position_m, started, still_s, dt)
    if fault != GATE_ACTIVE:
        return ZERO, _without_force(state, fault)
    return _step_of_a_good_reading(state, settings, reference, reading, (started, same, still_s), dt)


@compiled
def _without_force(state: CouplingState, gate: int) -> CouplingState:
    """Return the state under a refusal, which keeps the last position, because a refused reading moves nothing."""
    return CouplingState(
        gate=gate,
        limited=False,
        force_n=ZERO,
        own_force_n=ZERO,
        position_m=state.position_m,
        reference_m=state.position_m,
        rate_m_per_s=ZERO,
        velocity_m_per_s=ZERO,
        started=state.started,
        rest_place_m=state.position_m,
        rest_s=0.0,
        still_s=0.0,
        still_force_n=ZERO,
        arm_count=state.arm_count,
        hand_energy_j=state.hand_energy_j,
        coupling_energy_j=state.coupling_energy_j,
    )


@compiled
def _low_passed(before: Vector, new: Vector, cutoff_hz: float, dt: float) -> Vector:
    if not cutoff_hz > 0.0:
        return new
    a = math.exp(-2.0 * math.pi * cutoff_hz * dt)
    return (
        a * before[0] + (1.0 - a) * new[0],
        a * before[1] + (1.0 - a) * new[1],
        a * before[2] + (1.0 - a) * new[2],
    )


@compiled
def _step_of_a_good_reading(
    state: CouplingState,
    settings: CouplingSettings,
    reference: CouplingReference,
    reading: CouplingReading,
    checks: tuple[bool, bool, float],
    dt: float,
) -> tuple[Vector, CouplingState]:
    """Return force and state for a plausible reading.

    checks: whether there was a position before, whether it was the same, and `still_s` [s].
    """
    place = reading.position_m
    started, same, still_s = checks
    moved = _minus(place, state.position_m) if started else ZERO
    velocity = _low_passed(state.velocity_m_per_s, _scaled(moved, 1.0 / dt), settings.velocity_filter_hz, dt)
    near = started and _length(_minus(place, state.rest_place_m)) <= settings.rest_m
    rest_s = state.rest_s + dt if near else 0.0
    gate = _gate(settings, state.gate, reference, reading, rest_s >= settings.rest_s)
    if gate in (GATE_SILENT, GATE_DEVICE_SILENT, GATE_REFERENCE):
        rest_s = 0.0
    force, own, rate, limited, target = ZERO, ZERO, ZERO, False, place
    hand_j = state.hand_energy_j - _dot(state.force_n, moved)
    coupling_j = state.coupling_energy_j
    if gate == GATE_ACTIVE:
        target = _target(settings, reference)
        offset = _minus(place, target)
        if state.gate == GATE_ACTIVE:
            change = _minus(offset, _minus(state.position_m, state.reference_m))
            coupling_j -= _dot(state.own_force_n, change)
            rate = _low_passed(state.rate_m_per_s, _scaled(change, 1.0 / dt), settings.velocity_filter_hz, dt)
        k, b, f = settings.stiffness_n_per_m, settings.damping_n_s_per_m, reference.force_n
        wanted = (
            f[0] - (k[0] * offset[0] + b[0] * rate[0]),
            f[1] - (k[1] * offset[1] + b[1] * rate[1]),
            f[2] - (k[2] * offset[2] + b[2] * rate[2]),
        )
        force, limited = _limited(settings, state.force_n, wanted, dt)
        own = _minus(force, f)
    rest_place = state.rest_place_m if near else place
    still_force = state.still_force_n if same else state.force_n
    return force, CouplingState(
        gate=gate,
        limited=limited,
        force_n=force,
        own_force_n=own,
        position_m=place,
        reference_m=target,
        rate_m_per_s=rate,
        velocity_m_per_s=velocity,
        started=True,
        rest_place_m=rest_place,
        rest_s=rest_s,
        still_s=still_s,
        still_force_n=still_force,
        arm_count=reference.arm_count,
        hand_energy_j=hand_j,
        coupling_energy_j=coupling_j,
    )


@compiled
def reading_of(
    place: Vector,
    velocity: Vector,
    force: Vector,
    marks: tuple[bool, bool, int],
    handle: tuple[Quaternion, int],
    energies_j: tuple[float, float],
) -> DeviceReading:
    """Return the reading of a device along the paper's axis; minus the force of the coupling is that of the hand.

    Args:
        place: The position in the master frame [m].
        velocity: The velocity in the master frame [m/s].
        force: The force that the coupling sent, in the master frame [N].
        marks: Whether clamp or slew acts, whether the arm is at an end stop, and the gate.
        handle: Orientation and buttons.
        energies_j: The energy accounts of the hand and of the coupling [J].
    """
    limited, at_end, gate = marks
    spatial = SpatialReading(
        lateral_m=(place[0], place[1]),
        lateral_velocity_m_per_s=(velocity[0], velocity[1]),
        lateral_operator_force_n=(0.0 - force[0], 0.0 - force[1]),
        lateral_force_n=(force[0], force[1]),
        orientation=handle[0],
        buttons=handle[1],
        gate=gate,
        hand_energy_j=energies_j[0],
        coupling_energy_j=energies_j[1],
    )
    return DeviceReading(
        position_m=0.0 - place[2],
        velocity_m_per_s=0.0 - velocity[2],
        operator_force_n=force[2],
        operator_force_limited=limited,
        motor_force_n=0.0 - force[2],
        motor_voltage_v=0.0,
        end_stop=at_end,
        voltage_limited=False,
        torque_limited=False,
        spatial=spatial,
    )
