"""Common parts of the laws: a virtual mass that turns forces into motion of a position-controlled device.

The device is a non-backdrivable screw, so each law produces a position reference. All of them except the paper's move

    M_v x'' + B_v x' = F_m - F_e,

where F_m is the operator's force and F_e the force that the law ascribes to the environment, at the hand's scale:
F = alpha_f F_s, x = x_s / alpha_p. The power F v at the hand's scale is then the same on both sides, and the passivity
of the laws refers to it. The discretisation is exact for forces held over a period, so F dx is the exact energy.
"""

import math
from typing import Any, NamedTuple

from telenano.extend.laws import HandSample, PortSignal, TipMeasurement, port_signal
from telenano.extend.ranges import parameter
from telenano.numerics.compiler import compiled
from telenano.numerics.discretisation import exact_discretisation
from telenano.settings.config import Settings, filled
from telenano.wire.topics import deadline_of

# Limits of position [m] and speed [m/s] that no hand or tip reaches; they keep references finite in an unstable loop.
FARTHEST_M = 1e6
FASTEST_M_PER_S = 1e9
# A base follows if it deviates by less than this [m] from the reference of the command that it has carried out: half a
# step of a 12-bit converter over a stage of 0.4 um, with some margin.
FOLLOWED_M = 6e-11
# A base further away than this, at the hand's scale [m], was moved by something other than the half's own loop.
ARRIVED_M = 1e-3
# Greatest lead of a reference over its device [m]: a device that follows lags by less, and one that is stuck, such as
# at the end of its travel, is led no further.
LONGEST_LEAD_M = 2e-3
# A tip that has received more energy than was paid for, by this amount [J], presses no further until more arrives; a
# single step takes less.
OVERDRAWN_J = 1e-5
# Initial received energy count of a half that begins after the other one [J]: it starts counting at the first signal
# that it receives, so that nothing is credited twice.
NOTHING_HEARD = -1.0
# Greatest stored work of the hand that a law has not used, for the kinetic energy of its mass [J].
_KEPT_WORK_J = 1e-3


class MassParams(NamedTuple):
    """Scales, limits, and the exact step of the mass: x += phi_xv v + gamma_x F, v = phi_vv v + gamma_v F."""

    position_scale: float
    force_scale: float
    silence_limit_s: float
    period_s: float
    phi_xv_s: float
    phi_vv: float
    gamma_x_m_per_n: float
    gamma_v_m_per_n_s: float


class Mass(NamedTuple):
    """Virtual mass: x [m], x' [m/s], and the offset at the tip in x_ref = alpha_p x + offset [m].

    `coupled`: True if the force of the tip acts on it.
    """

    position_m: float
    velocity_m_per_s: float
    tip_offset_m: float
    coupled: bool


class HandPort(NamedTuple):
    """Energy account of the hand's port.

    device_m: last position of the device [m]; credit_j: work of the hand at the device minus the energy that the
    channel got [J]; sent_j: energy reported to the other half [J]; granted_j: energy granted without payment [J]. The
    channel gets its energy at the reference, but the hand works at the device, which may be late or stuck. A half
    begins with `HandPort(device_m, 0.0, 0.0, 0.0)`.
    """

    device_m: float
    credit_j: float
    sent_j: float
    granted_j: float


class ScaledConfig(Settings):
    """The parameters that every law has."""

    position_scale: float = parameter(1.5e-6, "m/m", "alpha_p, metres at the tip per metre at the hand")
    force_scale: float = parameter(1e8, "N/N", "alpha_f, newtons at the hand per newton at the tip")
    silence_limit_s: float = parameter(
        deadline_of("teleop/backward"),
        "s",
        "Time without a signal from the other half after which the hand is let go [s]",
    )

    def limit_of_damper(self, damping_n_s_per_m: float, period_s: float, most_periods: int = 1) -> float:
        """Return the stiffest sample K [N/m] for a base that moves against the measured force through a damper.

        The force F_s of a step is that of its beginning. Over n periods Ts the force error is multiplied by
        1 - alpha_f alpha_p K n Ts / B: at -1 the sample gets all the energy that the damper should dissipate, and
        beyond that even more.

        Args:
            damping_n_s_per_m: The damping B at the hand's scale [N s/m].
            period_s: The period Ts [s].
            most_periods: The longest step n [periods].
        """
        return 2.0 * damping_n_s_per_m / (self.force_scale * self.position_scale * most_periods * period_s)


class MassConfig(ScaledConfig):
    """The virtual mass; the defaults move in free space like the paper's impedance divided by its force gain of 20."""

    mass_kg: float = parameter(0.5, "kg", "Virtual mass M_v [kg]")
    damping_n_s_per_m: float = parameter(100.0, "N s/m", "Virtual damping B_v [N s/m]")

    def mass_params(self, period_s: float, line_n_s_per_m: float = 0.0) -> MassParams:
        """Return the constants for a period [s]; `line_n_s_per_m` is another damper of the law on the mass [N s/m]."""
        damping = self.damping_n_s_per_m + line_n_s_per_m
        step = exact_discretisation(self.mass_kg, damping, 0.0, period_s)
        return filled(
            MassParams,
            self,
            period_s=period_s,
            phi_xv_s=step.phi_xv,
            phi_vv=step.phi_vv,
            gamma_x_m_per_n=step.gamma_x,
            gamma_v_m_per_n_s=step.gamma_v,
        )


@compiled
def periods_in(dt: float, period_s: float) -> int:
    """Return dt [s] as a whole number of periods, at least one."""
    return max(1, round(dt / period_s))


@compiled
def bounded(value: float, most: float) -> float:
    """Limit a value to the range from -most to most; a value within it keeps its bits."""
    if value > most:
        return most
    return -most if value < -most else value


@compiled
def followed(params: MassParams, reference_m: float, tip: TipMeasurement) -> float:
    """Return the position from which the base's reference continues [m].

    A base that did not reach its reference, because it was held or its speed was limited, continues from where it is:
    the missing distance of commands that it has carried out is dropped. Pending commands count as carried out, because
    a late instrument will still do so. A deviation up to FOLLOWED_M is kept, and a base that has not arrived
    (`has_arrived`) continues at `reference_m`.
    """
    if not has_arrived(params, reference_m, tip):
        return reference_m
    expected = tip.base_position_m + tip.outstanding_m
    return expected + bounded(reference_m - expected, FOLLOWED_M)


@compiled
def has_arrived(params: MassParams, reference_m: float, tip: TipMeasurement) -> bool:
    """Return whether the base is near its reference [m]; until then its motion is not caused by the law."""
    missing = reference_m - (tip.base_position_m + tip.outstanding_m)
    return abs(missing) <= max(params.position_scale * ARRIVED_M, 2.0 * FOLLOWED_M)


@compiled
def at_rest(position_m: float) -> Mass:
    """Return the mass at rest, not coupled, with zero offset between hand and tip."""
    return Mass(position_m, 0.0, 0.0, False)


@compiled
def resumed(params: MassParams, hand: HandSample, tip_reference_m: float) -> Mass:
    """Return the mass with the hand's motion, and the offset that makes `tip_reference_m` [m] the tip's reference."""
    offset = tip_reference_m - params.position_scale * hand.position_m
    return Mass(hand.position_m, hand.velocity_m_per_s, offset, False)


@compiled
def rescaled(old: MassParams, new: MassParams, mass: Mass) -> Mass:
    """Keep the tip's reference constant when alpha_p changes."""
    offset = mass.tip_offset_m + (old.position_scale - new.position_scale) * mass.position_m
    return Mass(mass.position_m, mass.velocity_m_per_s, offset, mass.coupled)


@compiled
def tip_reference(params: MassParams, mass: Mass) -> float:
    """Return x_ref = alpha_p x + offset [m]."""
    return params.position_scale * mass.position_m + mass.tip_offset_m


@compiled
def mass_signal(params: MassParams, mass: Mass, hand: HandSample, energy_j: float, active: bool) -> PortSignal:
    """Return the signal of a master half with a mass: the tip's reference, its velocity, and the force of the hand.

    Args:
        params: The scales.
        mass: The virtual mass.
        hand: The newest sample.
        energy_j: Energy that the law counts at its port [J]; 0 if it counts none.
        active: Whether the tip may follow.
    """
    return port_signal(
        position_m=tip_reference(params, mass),
        velocity_m_per_s=params.position_scale * mass.velocity_m_per_s,
        force_n=hand.force_n / params.force_scale,
        energy_j=energy_j,
        active=active,
    )


@compiled
def is_coupled(params: Any, signal: PortSignal) -> bool:
    """Return whether the tip follows and its last signal is within the silence limit."""
    return signal.active and signal.silence_s <= params.silence_limit_s


@compiled
def is_retracted(params: Any, signal: PortSignal) -> bool:
    """Return whether a recent signal says that the tip neither follows nor touches, so that it must be armed."""
    return not signal.active and not signal.in_contact and signal.silence_s <= params.silence_limit_s


class AtHand(NamedTuple):
    """Decision on a sample of the hand at the master half; `at_hand` makes it for all laws.

    acts: the law's knowledge of the tip (model, store or reference) moves the hand. stands: the device is off for a
    moment, so the hand stays where it is and the law continues. If neither holds, the hand is released, and rendering
    restarts on the next coupling, without a force whose energy was not paid. renews: the tip must be armed, so learnt
    values, stored energy and offsets restart as in a new session. counts: the device was moved by the law up to this
    sample, so the work of the hand counts for it. coupled: the tip follows and was heard recently. stood_s: time for
    which the device has been off [s].
    """

    acts: bool
    stands: bool
    renews: bool
    counts: bool
    coupled: bool
    stood_s: float


@compiled
def at_hand(
    params: Any, hand: HandSample, signal: PortSignal, was_coupled: bool, stood_s: float, dt: float, bridges: bool
) -> AtHand:
    """Decide whether the master half acts, stands or waits: when armed, returning, unanswered, or with its device off.

    After arming and after an interruption the same condition applies: the tip follows, its answer is recent, and the
    device follows. Earlier knowledge is never a reason to act.

    Args:
        params: Parameters with `silence_limit_s` [s].
        hand: The newest sample.
        signal: The newest answer, with the time since.
        was_coupled: Whether the half acted or stood at the previous sample.
        stood_s: Time for which the device had been off then [s].
        dt: The time since that sample [s].
        bridges: Whether the law continues over a device that is off for at most the silence limit.
    """
    coupled = is_coupled(params, signal)
    off_s = 0.0 if hand.following else stood_s + dt
    stands = coupled and not hand.following and bridges and was_coupled and off_s <= params.silence_limit_s
    return AtHand(
        acts=coupled and hand.following,
        stands=stands,
        renews=is_retracted(params, signal),
        counts=hand.following and was_coupled and stood_s == 0.0,
        coupled=coupled,
        stood_s=off_s,
    )


class AtTip(NamedTuple):
    """Decision on a measurement at the slave half; `at_tip` makes it for all laws.

    leads: the hand leads the base; otherwise the base goes to `base_m` [m], its last reference, or the place for a tip
    that does not follow. renews: the tip must be armed, so stored energy restarts. counts: the motion up to this
    measurement was caused by the law. heard: the other half was heard recently.
    """

    leads: bool
    renews: bool
    counts: bool
    heard: bool
    base_m: float


@compiled
def at_tip(params: Any, signal: PortSignal, tip: TipMeasurement, position_m: float, was_coupled: bool) -> AtTip:
    """Decide whether the hand leads the base, or the base goes to a stated position, as `AtTip`.

    Args:
        params: Parameters with `silence_limit_s` [s].
        signal: The newest signal of the master half, with the time since.
        tip: The newest measurement.
        position_m: The last reference of the base [m].
        was_coupled: Whether the hand led the base at the previous measurement.
    """
    return AtTip(
        leads=is_coupled(params, signal) and tip.following,
        renews=not tip.following and not tip.in_contact,
        counts=was_coupled and tip.following,
        heard=signal.silence_s <= params.silence_limit_s,
        base_m=position_m if tip.following else signal.position_m,
    )


@compiled
def let_go(params: MassParams, mass: Mass, hand: HandSample, signal: PortSignal) -> Mass:
    """Return the mass at rest at the hand's position, with the offset that keeps the tip's reference constant.

    Over a retracted tip the offset is zero, as before the first arming: an offset from an interruption ends there.
    """
    offset = mass.tip_offset_m + params.position_scale * (mass.position_m - hand.position_m)
    return Mass(hand.position_m, 0.0, 0.0 if is_retracted(params, signal) else offset, False)


@compiled
def moved(params: MassParams, mass: Mass, force_n: float) -> Mass:
    """Move the mass by one period under a held force [N]."""
    position = mass.position_m + params.phi_xv_s * mass.velocity_m_per_s + params.gamma_x_m_per_n * force_n
    velocity = params.phi_vv * mass.velocity_m_per_s + params.gamma_v_m_per_n_s * force_n
    return Mass(bounded(position, FARTHEST_M), bounded(velocity, FASTEST_M_PER_S), mass.tip_offset_m, True)


@compiled
def kept_near(mass: Mass, after: Mass, hand_m: float) -> Mass:
    """Return the mass `after` a step, stopped if it leads the device at `hand_m` [m] too far for one that follows."""
    most = max(LONGEST_LEAD_M, abs(mass.position_m - hand_m))
    lead = after.position_m - hand_m
    if abs(lead) <= most:
        return after
    return Mass(hand_m + bounded(lead, most), 0.0, after.tip_offset_m, after.coupled)


@compiled
def worked(port: HandPort, hand: HandSample, counts: bool) -> HandPort:
    """Add the work of the hand at its device since the last sample, if the law moved the device (`counts`)."""
    work_j = hand.force_n * (hand.position_m - port.device_m) if counts else 0.0
    return HandPort(hand.position_m, port.credit_j + work_j, port.sent_j, port.granted_j)


@compiled
def begun_again(port: HandPort, all_j: float, is_restart: bool) -> HandPort:
    """Restart the account: drop the hand's unused credit and the unsent part of `all_j`, the total energy to send [J].

    Energy that was sent but not paid stays owed; after an arming (`is_restart`) it is granted instead.
    """
    owed_j = max(port.sent_j - all_j - port.credit_j, 0.0)
    return HandPort(
        port.device_m, 0.0 if is_restart else -owed_j, port.sent_j, port.granted_j + (owed_j if is_restart else 0.0)
    )


@compiled
def unpaid_j(port: HandPort) -> float:
    """Return the energy [J] that the channel got but the hand has not put into its device, which must not be spent."""
    return max(-port.credit_j, 0.0)


@compiled
def put_in(port: HandPort, into_j: float, all_j: float) -> HandPort:
    """Book the energy that the channel got at the reference [J], and send the paid part of `all_j`, the total [J]."""
    credit_j = min(port.credit_j - into_j, _KEPT_WORK_J)
    return HandPort(port.device_m, credit_j, max(port.sent_j, all_j + min(credit_j, 0.0)), port.granted_j)


@compiled
def placed(mass: Mass, position_m: float, velocity_m_per_s: float) -> Mass:
    """Return the mass with another position [m] and velocity [m/s]; offset and coupling stay."""
    return Mass(position_m, velocity_m_per_s, mass.tip_offset_m, mass.coupled)


@compiled
def paid_stretch(
    stretch_m: float, motion_m: float, stiffness_n_per_m: float, remaining_j: float
) -> tuple[float, float]:
    """Limit a motion d [m] of the coupling's end to the remaining energy [J]; return it and the work on the channel.

    The channel gives out exactly F d + K d^2 / 2 with F = K stretch; the work done on it [J] is the negative of that.
    """
    force, k = stiffness_n_per_m * stretch_m, stiffness_n_per_m
    out = force * motion_m + 0.5 * k * motion_m * motion_m
    if out <= remaining_j:
        return motion_m, -out
    root = math.sqrt(force * force + 2.0 * k * max(remaining_j, 0.0))
    return (math.copysign(root, motion_m) - force) / k, -remaining_j
