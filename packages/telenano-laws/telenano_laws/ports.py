"""Energy accounts of the ports that laws of this package share, and motions and forces limited by them.

All quantities are at the hand's scale, x = x_s / alpha_p and F = alpha_f F_s, so all energies are joules at the hand.
"""

import math
from typing import NamedTuple

from telenano.extend.laws import EnergyAccount, HandSample, TipMeasurement
from telenano.extend.virtual_mass import NOTHING_HEARD, Mass, MassParams
from telenano.extend.virtual_mass import HandPort as HandPort
from telenano.extend.virtual_mass import begun_again as begun_again
from telenano.extend.virtual_mass import bounded as bounded
from telenano.extend.virtual_mass import followed as followed
from telenano.extend.virtual_mass import is_retracted as is_retracted
from telenano.extend.virtual_mass import kept_near as kept_near
from telenano.extend.virtual_mass import put_in as put_in
from telenano.extend.virtual_mass import unpaid_j as unpaid_j
from telenano.extend.virtual_mass import worked as worked
from telenano.numerics import compiled


class PortEnergy(NamedTuple):
    """Energy account of a port [J].

    sent_j, received_j: totals, which never decrease; left_j: energy that may still leave the port; granted_j: energy
    granted without payment. received_j is `NOTHING_HEARD` until the first signal, because energy that the other half
    sent before does not count.
    """

    sent_j: float
    received_j: float
    left_j: float
    granted_j: float


@compiled
def opened(start_j: float) -> PortEnergy:
    """Return an account that starts with the granted energy E_0 [J]."""
    return PortEnergy(0.0, NOTHING_HEARD, start_j, start_j)


@compiled
def reopen(store: PortEnergy, energy_j: float, heard: bool, start_j: float) -> PortEnergy:
    """Restart with E_0 [J]: grant the energy missing up to it, and do not count energy received up to a signal."""
    granted = store.granted_j + max(start_j - store.left_j, 0.0)
    return PortEnergy(store.sent_j, energy_j if heard else store.received_j, start_j, granted)


@compiled
def recount_received(store: PortEnergy, energy_j: float, heard: bool) -> PortEnergy:
    """Start counting received energy at a signal; the energy left is not changed."""
    return PortEnergy(store.sent_j, energy_j if heard else store.received_j, store.left_j, store.granted_j)


@compiled
def credited(store: PortEnergy, energy_j: float, cap_j: float) -> PortEnergy:
    """Add the energy [J] that the other side has sent since its last signal; energy above the cap is dissipated."""
    if store.received_j < 0.0:
        return recount_received(store, energy_j, True)
    added = max(energy_j - store.received_j, 0.0)
    left = max(min(store.left_j + added, cap_j), store.left_j) if added > 0.0 else store.left_j
    return PortEnergy(store.sent_j, store.received_j + added, left, store.granted_j)


@compiled
def two_counters(store: PortEnergy, into_j: float) -> PortEnergy:
    """Book work at a port by direction: energy into the network is sent on, energy out of it is spent."""
    sent, left = store.sent_j + max(into_j, 0.0), store.left_j + min(into_j, 0.0)
    return PortEnergy(sent, store.received_j, left, store.granted_j)


@compiled
def tank(store: PortEnergy, into_j: float, cap_j: float) -> PortEnergy:
    """Book work at a port in its own tank; energy above the cap is dissipated."""
    left = store.left_j + into_j
    if into_j > 0.0:
        left = max(min(left, cap_j), store.left_j)
    return PortEnergy(store.sent_j, store.received_j, left, store.granted_j)


@compiled
def kept_below(store: PortEnergy, cap_j: float) -> PortEnergy:
    """Limit a store to another cap; energy above it is dissipated."""
    return PortEnergy(store.sent_j, store.received_j, min(store.left_j, cap_j), store.granted_j)


@compiled
def of_scales(old: MassParams, new: MassParams) -> tuple[float, float]:
    """Return the factors that convert lengths and forces of the tip, as stored at the hand's scale, to new scales."""
    return old.position_scale / new.position_scale, new.force_scale / old.force_scale


@compiled
def sent_on(store: PortEnergy, energy_j: float) -> PortEnergy:
    """Send energy [J] from the tank to the other side."""
    return PortEnergy(store.sent_j + energy_j, store.received_j, store.left_j - energy_j, store.granted_j)


@compiled
def account_of(store: PortEnergy) -> EnergyAccount:
    """Return the energy account for `law/status`; the other port is assumed to have the same grant."""
    return EnergyAccount(store.left_j, 0.0, 2.0 * store.granted_j)


@compiled
def clipped_force(force_n: float, own_m: float, way_m_per_n: float, left_j: float) -> float:
    """Return the force on an admittance [N], limited to the energy that may leave in the coming period.

    The mass moves by own_m - way_m_per_n f under the force f, so the work that leaves is -f (own_m - way_m_per_n f).
    The forces for which that is at most left_j lie between the roots of a quadratic equation.

    Args:
        force_n: The desired force against the hand [N].
        own_m: The displacement of the mass without that force [m].
        way_m_per_n: The decrease of the displacement per newton, > 0 [m/N].
        left_j: The energy that may leave; a negative value counts as 0 [J].
    """
    root = math.sqrt(own_m * own_m + 4.0 * way_m_per_n * max(left_j, 0.0))
    low, high = (own_m - root) / (2.0 * way_m_per_n), (own_m + root) / (2.0 * way_m_per_n)
    return min(max(force_n, low), high)


@compiled
def paid_way(way_m: float, force_n: float, stiffness_n_per_m: float, left_j: float) -> float:
    """Return the part of a displacement [m] that the energy covers for any sample up to the given stiffness.

    A sample of at most the stiffness K takes at most F d + K d^2 / 2 over a displacement d that starts at the force F.
    """
    side = math.copysign(1.0, way_m)
    against = force_n * side
    root = math.sqrt(against * against + 2.0 * stiffness_n_per_m * max(left_j, 0.0))
    most = max(root - against, 0.0) / stiffness_n_per_m
    return side * min(abs(way_m), most)


@compiled
def paid_base(
    params: MassParams,
    position_m: float,
    tip: TipMeasurement,
    way_m: float,
    stiffness_n_per_m: float,
    left_j: float,
    unpaid_m: float,
) -> float:
    """Return the new reference of the base [m], as far as the energy covers the whole motion to it.

    The motion includes commands that a late instrument has not carried out yet. Retraction of a tip in the air needs no
    energy, because nothing opposes it.

    Args:
        params: The scales.
        position_m: The last reference of the base [m].
        tip: The measured position and force.
        way_m: The desired motion from the last reference, at the hand's scale [m].
        stiffness_n_per_m: The stiffest sample that is paid for, at the hand's scale [N/m].
        left_j: The energy that may leave [J].
        unpaid_m: The motion allowed without energy if no force opposes it, at the hand's scale [m].
    """
    scale = params.position_scale
    ahead = (followed(params, position_m, tip) - tip.base_position_m) / scale + way_m
    if ahead < 0.0 and not tip.in_contact:
        return tip.base_position_m + scale * ahead
    force_n = params.force_scale * tip.force_n
    paid = paid_way(ahead, force_n, stiffness_n_per_m, left_j)
    if force_n * ahead <= 0.0 and abs(paid) < unpaid_m:
        paid = bounded(ahead, unpaid_m)
    return tip.base_position_m + scale * paid


@compiled
def slid_work(last_m: float, last_n: float, here_m: float, force_n: float) -> float:
    """Return the work [J] on the sample between two measurements, by the trapezoidal rule."""
    return 0.5 * (last_n + force_n) * (here_m - last_m)


@compiled
def rearm(
    store: PortEnergy, port: HandPort, energy_j: float, heard: bool, start_j: float
) -> tuple[PortEnergy, HandPort]:
    """Restart the hand's port after an arming; energy that was sent and that the hand has not paid is granted."""
    port = begun_again(port, store.sent_j, True)
    paid = PortEnergy(port.sent_j, store.received_j, store.left_j, store.granted_j)
    return reopen(paid, energy_j, heard, start_j), port


@compiled
def stood(mass: Mass, hand: HandSample) -> Mass:
    """Return the mass at rest at the position of a device that is off for a moment."""
    return Mass(hand.position_m, 0.0, mass.tip_offset_m, True)


@compiled
def paid_or_granted(store: PortEnergy, into_j: float) -> PortEnergy:
    """Book the work [J] of a motion that cannot be shortened; energy that the store lacks for it is granted."""
    lacking = max(-into_j - max(store.left_j, 0.0), 0.0)
    left = store.left_j + min(into_j, 0.0) + lacking
    return PortEnergy(store.sent_j, store.received_j, left, store.granted_j + lacking)
