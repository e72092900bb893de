"""Linear theory of delay: margins of the loop, absolute stability and passivity of two-ports.

**The paper's loop.** Against a linear environment F_s = K (x_s - L), with the round trip T in the loop,

    L(s) = (K_f + 1) alpha_f alpha_p K e^(-sT) / (M_v s^2 + B_v s + K_v),

and the delay margin is the phase margin over the crossover frequency, T_c = phi / omega_c.

**The sample period.** The law integrates with the force held over a period Ts, so the loop that really runs is the
exact discretisation of L at T = 0, with the delay in whole samples. Its own margin, T_d = phi_d / omega_d of the
sampled loop, is the delay that the link may add. The hold counts as half a period: T_d = T_c - Ts/2 to first order in
omega_c Ts, so at 1 kHz a link may add 0.5 ms less than the continuous loop tolerates. Therefore T_d + Ts/2 of the
sampled loop is to be compared with T_c.

**Two-ports.** A teleoperator is written in hybrid form at the hand's scale, (F_m, -v_s) = H (v_m, F_s), with
F_s -> alpha_f F_s and v_s -> v_s / alpha_p. Llewellyn: it stays stable between any passive hand and any passive
environment if and only if Re h11 >= 0, Re h22 >= 0 and 2 Re h11 Re h22 - Re(h12 h21) >= |h12 h21| at every frequency.
It is passive if and only if the norm of its scattering matrix is at most 1, which asks for more.
"""

import cmath
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

Complex = npt.NDArray[np.complex128]
Series = npt.NDArray[np.float64]

# Crossovers are sought between these frequencies.
_LOWEST_RAD_PER_S = 1e-4
_HIGHEST_RAD_PER_S = 1e6
# The grid of the search has this number of points a decade.
_GRID = 40


class Margin(NamedTuple):
    """Delay margin [s] (infinite where the gain never reaches 1), phase margin [rad], crossover [rad/s]."""

    delay_s: float
    phase_rad: float
    crossover_rad_per_s: float


class LoopModel(NamedTuple):
    """L(s) at T = 0: gain / (mass s^2 + damping s + stiffness), at the hand's scale, in N/m, kg, N s/m and N/m."""

    gain_n_per_m: float
    mass_kg: float
    damping_n_s_per_m: float
    stiffness_n_per_m: float


class Arm(NamedTuple):
    """A passive arm about its intended path: Z_a = m s^2 + b s + k."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    mass_kg: float


class Device(NamedTuple):
    """The position servo of Eq. 2, with a^2 [1/s^2] and b_d [1/s]."""

    square: float
    damping_per_s: float


def loop_model(law: str, parameters: BaseModel, stiffness_n_per_m: float) -> LoopModel | None:
    """Return the loop of a law against a linear environment K [N/m]; None for a law without a loop of this form.

    virtual_impedance: (K_f + 1) alpha_f alpha_p K over its impedance. position_force: alpha_f alpha_p K over its mass.
    """
    values = parameters.model_dump()
    if law not in ("virtual_impedance", "position_force"):
        return None
    gain = values["force_scale"] * values["position_scale"] * stiffness_n_per_m
    return LoopModel(
        gain * (values.get("force_gain", 0.0) + 1.0),
        values["mass_kg"],
        values["damping_n_s_per_m"],
        values.get("stiffness_n_per_m", 0.0),
    )


def transfer_function(loop: LoopModel) -> Any:
    """Return L(s) at T = 0 as a `control.TransferFunction`."""
    import control

    return control.tf([loop.gain_n_per_m], [loop.mass_kg, loop.damping_n_s_per_m, loop.stiffness_n_per_m])


def sampled_loop(loop: Any, period_s: float) -> Any:
    """Return the exact discretisation of a loop whose input is held over period_s [s]."""
    import control

    return control.sample_system(loop, period_s, method="zoh")


def delay_margin(loop: Any) -> Margin:
    """Return the smallest delay that makes a stable loop neutral, over all frequencies at which its gain is 1.

    The frequencies are the roots of |L| = 1 on (0, pi/Ts) of a sampled loop and on (0, inf) of a continuous one,
    bracketed on a grid with _GRID points a decade. Without such a frequency, the margin is infinite and the crossover
    NaN.
    """
    if loop.isdtime(strict=True):
        return margin_of(lambda omega: complex(loop(np.exp(1j * omega * loop.dt))), math.pi / loop.dt * (1.0 - 1e-9))
    return margin_of(lambda omega: complex(loop(1j * omega)))


def margin_of(response: Callable[[float], complex], highest_rad_per_s: float = _HIGHEST_RAD_PER_S) -> Margin:
    """Return the delay margin of a loop given by L(j omega) at T = 0, as `delay_margin` does."""
    from scipy.optimize import brentq

    def log_gain(log_omega: float) -> float:
        return math.log(max(abs(response(math.exp(log_omega))), 1e-300))

    bottom, top = math.log(_LOWEST_RAD_PER_S), math.log(highest_rad_per_s)
    grid = np.linspace(bottom, top, math.ceil(_GRID * (top - bottom) / math.log(10.0)))
    gains = [log_gain(float(at)) for at in grid]
    margins = []
    for low, high, before, after in zip(grid[:-1], grid[1:], gains[:-1], gains[1:], strict=True):
        if before * after <= 0.0 and before != after:
            omega = math.exp(brentq(log_gain, low, high, xtol=1e-14, rtol=1e-14))
            phase = (cmath.phase(response(omega)) + math.pi) % (2.0 * math.pi)
            margins.append(Margin(phase / omega, phase, omega))
    return min(margins, default=Margin(math.inf, math.inf, math.nan))


def arm_response(loop: LoopModel, hand_gain: float, arm: Arm, device: Device) -> Callable[[float], complex]:
    """Return L(j omega) at T = 0 with an arm on the device instead of a hand of constant force.

    The arm holds x_m against its intended path with F_m = -Z_a x_m, Z_a = m s^2 + b s + k, and the device is at x_m = D
    x_mr, D = a^2 / (s^2 + b_d s + a^2) (Eq. 2). With Z_v x = g F_m - G F_s / K, where g is `hand_gain` (K_f, or 1 for
    direct reflection) and G the gain of the loop, L = G / (Z_v + g Z_a D).
    """

    def response(omega: float) -> complex:
        s = 1j * omega
        virtual = loop.mass_kg * s * s + loop.damping_n_s_per_m * s + loop.stiffness_n_per_m
        held = arm.mass_kg * s * s + arm.damping_n_s_per_m * s + arm.stiffness_n_per_m
        servo = device.square / (s * s + device.damping_per_s * s + device.square)
        return loop.gain_n_per_m / (virtual + hand_gain * held * servo)

    return response


def critical_delay_s(loop: LoopModel) -> float:
    """Return T_c [s], the delay margin of the continuous loop."""
    return delay_margin(transfer_function(loop)).delay_s


def critical_link_delay_s(loop: LoopModel, period_s: float) -> float:
    """Return T_d [s]: the delay that the link may add to a loop that is sampled every period_s [s]."""
    return delay_margin(sampled_loop(transfer_function(loop), period_s)).delay_s


def hybrid_of(law: str, parameters: BaseModel, round_trip_s: float, omega_rad_per_s: Series) -> Complex | None:
    """Return H of a law with its parameters over a constant round trip [s], half of it each way, at [rad/s].

    Returns:
        H, shape (n, 2, 2); None for a law that is not linear or has no such form here.
    """
    values = parameters.model_dump()
    half_s = 0.5 * round_trip_s
    s = 1j * omega_rad_per_s
    if law not in ("virtual_impedance", "position_force", "wave"):
        return None
    impedance = values["mass_kg"] * s + values["damping_n_s_per_m"] + values.get("stiffness_n_per_m", 0.0) / s
    if law == "wave":
        hybrid = wave_hybrid(values["impedance_n_s_per_m"], half_s, half_s, values["filter_s"], omega_rad_per_s)
        hybrid[:, 0, 0] += impedance
        return hybrid
    return direct_hybrid(impedance, values.get("force_gain"), half_s, half_s, omega_rad_per_s)


def direct_hybrid(
    impedance: Complex, force_gain: float | None, forward_s: float, backward_s: float, omega_rad_per_s: Series
) -> Complex:
    """Return H of a law that sends position forward and force back unchanged, over one-way delays [s].

    Z v = K_f (F_m - F_s e^(-s T2)) - F_s e^(-s T2), v_s = v e^(-s T1): h11 = Z / K_f, h12 = (1 + 1/K_f) e^(-s T2),
    h21 = -e^(-s T1), h22 = 0. force_gain None is direct reflection: Z v = F_m - F_s e^(-s T2), h11 = Z and
    h12 = e^(-s T2).

    Args:
        impedance: Z(j omega), shape (n,) [N s/m].
        force_gain: The gain K_f; None is direct reflection.
        forward_s: The delay to the slave, T1 [s].
        backward_s: The delay to the master, T2 [s].
        omega_rad_per_s: The frequencies, shape (n,) [rad/s].

    Returns:
        H, shape (n, 2, 2).

    Raises:
        ValueError: K_f is 0, so that the hand's force has no effect.
    """
    if force_gain == 0.0:
        raise ValueError("force_gain K_f = 0: the hand's force has no effect, so there is no two-port in hybrid form")
    s = 1j * omega_rad_per_s
    gain, excess = (1.0, 1.0) if force_gain is None else (force_gain, 1.0 + 1.0 / force_gain)
    return _matrices(impedance / gain, excess * np.exp(-s * backward_s), -np.exp(-s * forward_s), np.zeros_like(s))


def wave_hybrid(
    impedance_n_s_per_m: float, forward_s: float, backward_s: float, filter_s: float, omega_rad_per_s: Series
) -> Complex:
    """Return H of two wave transformations joined by constant delays [s] and filters of time constant filter_s [s].

    With u = (b v + F) / sqrt(2 b), w = (b v - F) / sqrt(2 b), a = e^(-s T1) / (1 + tau s), c = e^(-s T2) / (1 + tau s):
    h11 = b (1 - ac)/(1 + ac), h12 = 2c/(1 + ac), h21 = -2a/(1 + ac), h22 = (1 - ac)/(b (1 + ac))
    (Niemeyer and Slotine 1991). b is the wave impedance at the hand's scale [N s/m].
    """
    s = 1j * omega_rad_per_s
    lag = 1.0 / (1.0 + filter_s * s)
    b, a, c = impedance_n_s_per_m, lag * np.exp(-s * forward_s), lag * np.exp(-s * backward_s)
    line = (1.0 - a * c) / (1.0 + a * c)
    return _matrices(b * line, 2.0 * c / (1.0 + a * c), -2.0 * a / (1.0 + a * c), line / b)


def _matrices(h11: Complex, h12: Complex, h21: Complex, h22: Complex) -> Complex:
    return np.moveaxis(np.array([[h11, h12], [h21, h22]]), -1, 0)


def llewellyn(hybrid: Complex) -> Series:
    """Return the least of Llewellyn's three conditions at each frequency: absolutely stable where it is >= 0.

    The conditions are scaled to be dimensionless: Re h11 / |h11|, Re h22 / |h22|, (2 Re h11 Re h22 - Re h12 h21) / |h12
    h21| - 1; a condition with a zero divisor is 0, at its bound.

    Args:
        hybrid: The hybrid matrix H, shape (n, 2, 2).
    """
    h11, h12, h21, h22 = hybrid[:, 0, 0], hybrid[:, 0, 1], hybrid[:, 1, 0], hybrid[:, 1, 1]
    transfer = h12 * h21
    third = 2.0 * h11.real * h22.real - transfer.real - np.abs(transfer)
    pairs = ((h11.real, np.abs(h11)), (h22.real, np.abs(h22)), (third, np.abs(transfer)))
    ratios = [np.divide(part, size, out=np.zeros_like(part), where=size > 0.0) for part, size in pairs]
    return np.asarray(np.minimum.reduce(ratios), dtype=np.float64)
