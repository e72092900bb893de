"""Exact discretisation of the linear systems of the laws, with the same bits on every processor.

LAPACK, BLAS and the elementary functions of the C library choose their kernels by the processor, which changes the last
digit. Decimal arithmetic does not depend on the processor. It runs once for a set of parameters, never in a loop.
"""

from decimal import MAX_EMAX, MIN_EMIN, ROUND_HALF_EVEN, Context, Decimal, localcontext
from typing import NamedTuple

# Far more than the 17 digits of a double, because rows of very different size lose digits.
_DIGITS = 60
_LARGEST_STEP = Decimal("0.25")


class Discretisation(NamedTuple):
    """x+ = phi_xx x + phi_xv v + gamma_x u, v+ = phi_vx x + phi_vv v + gamma_v u over one period."""

    phi_xx: float
    phi_xv: float
    phi_vx: float
    phi_vv: float
    gamma_x: float
    gamma_v: float


def exact_discretisation(mass: float, damping: float, stiffness: float, period_s: float) -> Discretisation:
    """Return the discrete step of M x'' + B x' + K x = u over a period [s] with u held, each number correctly rounded.

    phi = exp(A T) with A = [[0, 1], [-K/M, -B/M]], gamma = psi [0, 1/M]' with psi the integral of exp(A t) from 0 to T.
    Taylor's series gives both for a part T / 2^n; then psi(2 t) = psi(t) (1 + phi(t)), phi(2 t) = phi(t)^2, n times.

    Args:
        mass: The mass M [kg], finite, > 0.
        damping: The damping B [N s/m], finite, >= 0.
        stiffness: The stiffness K [N/m], finite, >= 0.
        period_s: The period T [s], finite, > 0.
    """
    with localcontext(Context(prec=_DIGITS, rounding=ROUND_HALF_EVEN, Emin=MIN_EMIN, Emax=MAX_EMAX)) as context:
        spring, damper = Decimal(stiffness) / Decimal(mass), Decimal(damping) / Decimal(mass)
        step, doublings = Decimal(period_s), 0
        while (spring.sqrt() + damper) * step > _LARGEST_STEP:
            step, doublings = step / 2, doublings + 1
        # Each doubling may cost one bit of precision.
        context.prec += doublings // 3
        phi, psi = _series((Decimal(0), Decimal(1), -spring, -damper), step)
        for _ in range(doublings):
            psi = _plus(psi, _times(psi, phi))
            phi = _times(phi, phi)
        phi_xx, phi_xv, phi_vx, phi_vv = map(float, phi)
        gamma_x, gamma_v = float(psi[1] / Decimal(mass)), float(psi[3] / Decimal(mass))
        return Discretisation(
            phi_xx=phi_xx, phi_xv=phi_xv, phi_vx=phi_vx, phi_vv=phi_vv, gamma_x=gamma_x, gamma_v=gamma_v
        )


def decay(ratio: float) -> float:
    """Return exp(-ratio), rounded to the nearest double; ratio [1], >= 0."""
    with localcontext(Context(prec=_DIGITS, Emin=MIN_EMIN, Emax=MAX_EMAX)):
        return float((-Decimal(ratio)).exp())


def approach(ratio: float) -> float:
    """Return 1 - exp(-ratio), rounded to the nearest double: the share of a first-order step; ratio [1], >= 0."""
    exact = Decimal(ratio)
    # The subtraction from 1 loses this number of digits, so as many more are computed.
    lost = max(0, -exact.adjusted()) if exact.is_finite() else 0
    with localcontext(Context(prec=_DIGITS + lost, Emin=MIN_EMIN, Emax=MAX_EMAX)):
        return float(1 - (-exact).exp())


# A 2 x 2 matrix, row by row.
_Matrix = tuple[Decimal, Decimal, Decimal, Decimal]


def _series(a: _Matrix, step: Decimal) -> tuple[_Matrix, _Matrix]:
    """Return exp(A t) and its integral over a small step t, from their series to the last digit of the context."""
    one = (Decimal(1), Decimal(0), Decimal(0), Decimal(1))
    phi, psi, term, order = one, _scaled(one, step), one, 1
    while True:
        term = _scaled(_times(term, a), step / order)
        order += 1
        next_phi, next_psi = _plus(phi, term), _plus(psi, _scaled(term, step / order))
        if (next_phi, next_psi) == (phi, psi):
            return phi, psi
        phi, psi = next_phi, next_psi


def _times(p: _Matrix, q: _Matrix) -> _Matrix:
    a, b, c, d = p
    e, f, g, h = q
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def _plus(p: _Matrix, q: _Matrix) -> _Matrix:
    return p[0] + q[0], p[1] + q[1], p[2] + q[2], p[3] + q[3]


def _scaled(p: _Matrix, factor: Decimal) -> _Matrix:
    return p[0] * factor, p[1] * factor, p[2] * factor, p[3] * factor
