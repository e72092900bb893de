"""What enters a law at a port: the work of F dx at the hand's scale, counted while the rig runs.

At the master the work is counted at the device, with the force and the position that it measures: F_m of a sample acted
over the way from the sample before to it, F_m (x_m' - x_m). So what the servo of the device makes is in the sum. At the
slave the base goes from x_s to x_s' and the force from F_s to F_s'; the work that the law gives out is alpha_f /
alpha_p times the mean force times the way (trapezoid: exact on a spring). With both,

    E_net = int F_m dx_m - int alpha_f F_s dx_s / alpha_p

is stored in or dissipated by law and link. A passive law started at rest has E_net >= 0, at all times, whatever hand
and sample do; one that goes below has made energy.
"""

from typing import NamedTuple

from telenano.laws.law import EnergyAccount
from telenano.numerics.compiler import compiled

# The tolerance covers the rounding in sums of millions of terms, and no more.
TOLERANCE_J = 1e-9


class Port(NamedTuple):
    """Where the port is [m] and with what force [N], at the hand's scale, and the energy that entered [J]."""

    position_m: float
    force_n: float
    energy_j: float


@compiled
def opened(position_m: float, force_n: float) -> Port:
    """Start counting at a position [m] and force [N], at the hand's scale."""
    return Port(position_m, force_n, 0.0)


@compiled
def moved_to(port: Port, position_m: float, force_n: float) -> Port:
    """Move the port without counting work: the law was not in force in between."""
    return Port(position_m, force_n, port.energy_j)


@compiled
def with_inflow(port: Port, position_m: float, force_n: float) -> Port:
    """Count the work of a force [N] held over the way to a position [m], into the law: the master's port."""
    return Port(position_m, force_n, port.energy_j + force_n * (position_m - port.position_m))


@compiled
def with_outflow(port: Port, position_m: float, force_n: float) -> Port:
    """Count the work against a force [N] that goes straight from the last to this one, out of the law: the slave's."""
    work = 0.5 * (port.force_n + force_n) * (position_m - port.position_m)
    return Port(position_m, force_n, port.energy_j - work)


@compiled
def is_passive(net_j: float, net_valid: bool, account: EnergyAccount) -> bool:
    """Return whether the energies observed agree with passivity: E_net + granted >= 0 and nothing overdrawn."""
    enough = not net_valid or net_j + account.granted_j >= -TOLERANCE_J
    return enough and account.remaining_j >= -TOLERANCE_J
