"""Energy that enters a law at its ports: the work F dx at the hand's scale, summed while the rig runs.

At the master the work is computed from the force and the position that the device measures: F_m of a sample acted over
the motion from the previous sample to this one, F_m (x_m' - x_m). So the sum includes energy that the servo of the
device generates. At the slave the base moves from x_s to x_s' while the force changes from F_s to F_s'; the work that
the law gives out is alpha_f / alpha_p times mean force times motion (trapezoid: exact on a spring). With both,

    E_net = int F_m dx_m - int alpha_f F_s dx_s / alpha_p

is stored in or dissipated by law and link. A passive law that starts at rest has E_net >= 0 at all times, for any hand
and any sample; a negative E_net means that the law has generated energy.
"""

from typing import NamedTuple

from telenano.extend.laws import EnergyAccount
from telenano.numerics.compiler import compiled

# Tolerance for the rounding in sums of millions of terms [J].
TOLERANCE_J = 1e-9


class Port(NamedTuple):
    """Position [m] and force [N] of a port at the hand's scale, and the energy that has entered there [J]."""

    position_m: float
    force_n: float
    energy_j: float


@compiled
def opened(position_m: float, force_n: float) -> Port:
    """Return a port with zero energy at a position [m] and force [N], at the hand's scale."""
    return Port(position_m, force_n, 0.0)


@compiled
def moved_to(port: Port, position_m: float, force_n: float) -> Port:
    """Return the port at another position [m] and force [N], without work: the law was not in force meanwhile."""
    return Port(position_m, force_n, port.energy_j)


@compiled
def with_inflow(port: Port, position_m: float, force_n: float) -> Port:
    """Add the work into the law of a force [N] held over the motion to a position [m]: the master's port."""
    return Port(position_m, force_n, port.energy_j + force_n * (position_m - port.position_m))


@compiled
def with_outflow(port: Port, position_m: float, force_n: float) -> Port:
    """Subtract the work out of the law over the motion to a position [m]: the slave's port.

    The force is the mean of the last one and the one at that position, force_n [N].
    """
    work = 0.5 * (port.force_n + force_n) * (position_m - port.position_m)
    return Port(position_m, force_n, port.energy_j - work)


@compiled
def is_passive(net_j: float, net_valid: bool, account: EnergyAccount) -> bool:
    """Return whether the energies agree with passivity: E_net + granted >= 0, if known, and no account overdrawn."""
    enough = not net_valid or net_j + account.granted_j >= -TOLERANCE_J
    return enough and account.remaining_j >= -TOLERANCE_J
