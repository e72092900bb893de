"""Perceptual dead band: a signal is sent when it differs perceptibly from the last one sent, else the receiver holds.

Force, velocity and wave are compared by Weber's law, |y - y_sent| > max(w |y_sent|, floor): people do not feel changes
of less than about a tenth. A position has no natural origin to which a change could be related, so it has a fixed
resolution instead. Changes of contact or activity are always sent. A signal is also sent after a time without any,
because the other side takes a silence (50 ms) for a dead link. Source: P. Hinterseer, S. Hirche, S. Chaudhuri,
E. Steinbach, M. Buss, "Perception-based data reduction and transmission of haptic data", IEEE Trans. Signal Processing
56 (2008).

Passivity. The receiver holds the last value. While a force F is held, which may change by up to w |F|, the channel can
generate energy at the rate w |F v|, like a negative damper of w |F / v|; laws without an energy account (virtual
impedance, position-force, Smith) lose that much margin. Wave variables and passivity control send cumulative counters,
so a value that is held back is only late, and its energy cannot be spent before it arrives: they stay passive. The
local model of the model-mediated law does not pass through the channel at all.
"""

from typing import NamedTuple

from telenano.extend.laws import PortSignal
from telenano.numerics.compiler import compiled


class DeadbandParams(NamedTuple):
    """Constants of the dead band: Weber fraction, smallest perceptible changes, and longest time without a signal."""

    enabled: bool
    weber_fraction: float
    position_m: float
    velocity_m_per_s: float
    force_n: float
    wave_sqrt_w: float
    keep_alive_s: float


class DeadbandState(NamedTuple):
    """The signal last sent, the time since then [s] (negative before the first), and the numbers offered and sent."""

    last: PortSignal
    since_s: float
    offered: int
    sent: int


@compiled
def initial_deadband_state(signal: PortSignal) -> DeadbandState:
    """Return a state after which the next signal is always sent; `signal` serves for its type only."""
    return DeadbandState(signal, -1.0, 0, 0)


@compiled
def _differs(value: float, last: float, weber_fraction: float, floor: float) -> bool:
    return abs(value - last) > max(weber_fraction * abs(last), floor)


@compiled
def deadband(params: DeadbandParams, state: DeadbandState, signal: PortSignal, dt: float) -> tuple[DeadbandState, bool]:
    """Return the next state, and whether to send a signal, dt [s] after the previous one was offered."""
    last, w = state.last, params.weber_fraction
    since_s = state.since_s + dt
    send = (
        not params.enabled
        or state.since_s < 0.0
        # The tolerance is for rounding in a sum of periods, which must not delay the signal by a period.
        or since_s >= params.keep_alive_s * (1.0 - 1e-9)
        or signal.active != last.active
        or signal.in_contact != last.in_contact
        or signal.separation_valid != last.separation_valid
        or _differs(signal.position_m, last.position_m, 0.0, params.position_m)
        or _differs(signal.velocity_m_per_s, last.velocity_m_per_s, w, params.velocity_m_per_s)
        or _differs(signal.force_n, last.force_n, w, params.force_n)
        or _differs(signal.wave_sqrt_w, last.wave_sqrt_w, w, params.wave_sqrt_w)
    )
    if send:
        return DeadbandState(signal, 0.0, state.offered + 1, state.sent + 1), True
    return DeadbandState(last, since_s, state.offered + 1, state.sent), False
