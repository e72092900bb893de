"""A compact Maugis-Dugdale surface as the base of a cantilever meets it, and its recursive fit to what comes back.

With the indentation s from the point where the contact ends, and the cantilever k in series,

    F(s) = kappa s^(3/2) - F_a,   y(s) = s + kappa s^(3/2) / k,   y = x_s - x_c.

Three parameters: x_c, base position at which the contact ends [m]; kappa = 4/3 E* sqrt(R) for a sphere [N/m^1.5]; F_a,
adhesion at that point [N]. This is the DMT limit of Maugis-Dugdale (Maugis, J. Colloid Interface Sci. 150, 1992), exact
for lambda -> 0. For other lambda the two offsets, free here, take up nearly all of the difference: fitted to Table 2
(lambda = 0.83) the contact stiffness at indentations of 0 to 2 nm comes out within a few percent (tested). A constant
meniscus force is part of F_a.

Outside (y < 0) the pull fades linearly over a range l, F = -F_a (1 + y / l): with the jump that it has in the limit
l -> 0 a local rendering would chatter. F is a function of y, so the surface has a potential V(y) and is passive as it
stands; what a change of parameters adds to V is `potential_j` after less before.

The fit is by least squares over the newest force in each of a few bins of the position: it rests on all of the way that
was gone lately, not on the place where the tip stands, so it neither forgets nor drifts while the tip stands still.

Inside, lengths are in nm and forces in nN, so that the fit is of numbers near one.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import compiled

NANO = 1e-9
# The factor is kappa in nN/nm^1.5 for one N/m^1.5.
KAPPA_UNIT = 10.0**-4.5
BINS = 32
# The rows of the samples.
_AT = 0
_FORCE = 1
_WEIGHT = 2
_ROOT = 3
# Newton's method takes this number of steps at most.
_ITERATIONS = 30
# The weights of all bins fall to this share when the tip goes to another bin.
_KEEP = 0.98
# A bin below this weight does not bound the end of the contact.
_LEAST_BOUNDING = 0.3
# The damping of the fit begins here, and stays between the bounds.
_FIRST_DAMPING = 1e-2
_LEAST_DAMPING = 1e-6
_MOST_DAMPING = 1e6


class Surface(NamedTuple):
    """x_c [nm], kappa [nN/nm^1.5], F_a [nN]."""

    contact_nm: float
    kappa: float
    adhesion_nn: float


class Fit(NamedTuple):
    """The estimate and what it rests on: the newest force in each of BINS bins of the base position, with a weight.

    samples: shape (4, BINS), by row the base positions [nm], the forces [nN], the weights, of which 0 is an empty bin,
    and the root (`root_of`) at each position over `surface` [nm^0.5]. `bin`: the one visited last; damping: that of the
    last step of the fit; known: whether a surface was ever met.
    """

    surface: Surface
    samples: npt.NDArray[np.float64]
    bin: int
    damping: float
    known: bool


class FitParams(NamedTuple):
    """Cantilever k [N/m = nN/nm], range of the pull l [nm], first kappa, width of a bin [nm]."""

    cantilever: float
    range_nm: float
    kappa: float
    bin_nm: float


@compiled
def root_of(y_nm: float, ratio: float) -> float:
    """Solve r^2 + ratio r^3 = y for r >= 0, y >= 0, by Newton from above, where it converges monotonically."""
    if y_nm <= 0.0:
        return 0.0
    r = math.sqrt(y_nm)
    for _ in range(_ITERATIONS):
        step = (r * r * (1.0 + ratio * r) - y_nm) / (r * (2.0 + 3.0 * ratio * r))
        r -= step
        if step <= 1e-15 * r:
            break
    return r


@compiled
def force_and_potential(
    surface: Surface, cantilever: float, range_nm: float, position_nm: float
) -> tuple[float, float]:
    """Return F [nN] at a base position [nm], and V = int F dx from far away to there [nN nm = 1e-18 J]."""
    y, kappa, adhesion = position_nm - surface.contact_nm, surface.kappa, surface.adhesion_nn
    if y <= -range_nm:
        return 0.0, 0.0
    if y < 0.0:
        return -adhesion * (1.0 + y / range_nm), -0.5 * adhesion * (y + range_nm) * (y + range_nm) / range_nm
    r = root_of(y, kappa / cantilever)
    stored = kappa * r * r * r * r * r * (0.4 + 0.5 * kappa * r / cantilever)
    return kappa * r * r * r - adhesion, stored - adhesion * (y + 0.5 * range_nm)


@compiled
def gradient(surface: Surface, cantilever: float, r: float) -> tuple[float, float, float]:
    """Return dF/dx_c, dF/dkappa, dF/dF_a in contact, at the root r >= 0 of y (`root_of`)."""
    yielding = 1.0 + 1.5 * surface.kappa * r / cantilever
    return -1.5 * surface.kappa * r / yielding, r * r * r / yielding, -1.0


@compiled
def unknown(params: FitParams) -> Fit:
    """Return the fit before any contact."""
    return Fit(Surface(0.0, params.kappa, 0.0), np.zeros((4, BINS)), -1, _FIRST_DAMPING, False)


@compiled
def met(params: FitParams, position_nm: float, force: float) -> Fit:
    """Start a fit at the first sample in contact: the contact ends here, or where this force is lost."""
    adhesion = max(-force, 0.0)
    r = (max(force, 0.0) / params.kappa) ** (1.0 / 3.0)
    y = r * r * (1.0 + params.kappa * r / params.cantilever)
    first = Fit(
        surface=Surface(position_nm - y, params.kappa, adhesion),
        samples=np.zeros((4, BINS)),
        bin=-1,
        damping=_FIRST_DAMPING,
        known=True,
    )
    return remembered(params, first, position_nm, force)


@compiled
def remembered(params: FitParams, fit: Fit, position_nm: float, force: float) -> Fit:
    """Store a sample in its bin; the others lose weight when the tip goes to another bin, and not while it stands."""
    index = math.floor(position_nm / params.bin_nm) % BINS
    samples, surface = fit.samples.copy(), fit.surface
    if index != fit.bin:
        samples[_WEIGHT] *= _KEEP
    samples[_AT, index], samples[_FORCE, index], samples[_WEIGHT, index] = position_nm, force, 1.0
    samples[_ROOT, index] = root_of(position_nm - surface.contact_nm, surface.kappa / params.cantilever)
    return Fit(surface, samples, index, fit.damping, fit.known)


def _place_roots_at_once(samples: npt.NDArray[np.float64], contact_nm: float, ratio: float) -> None:
    """Take a step of Newton for all samples before the next one; the steps are those of `root_of`."""
    at, roots, is_iterating = samples[_AT], samples[_ROOT], np.empty(BINS, np.bool_)
    for index in range(BINS):
        y = at[index] - contact_nm
        is_iterating[index] = y > 0.0
        roots[index] = 0.0 if y <= 0.0 else math.sqrt(y)
    for _ in range(_ITERATIONS):
        left = 0
        for index in range(BINS):
            y, r = at[index] - contact_nm, roots[index]
            step = (r * r * (1.0 + ratio * r) - y) / (r * (2.0 + 3.0 * ratio * r))
            roots[index] = r - step if is_iterating[index] else r
            is_iterating[index] = is_iterating[index] and step > 1e-15 * roots[index]
            left += is_iterating[index]
        if left == 0:
            break


@partial(compiled, at_once=_place_roots_at_once)
def place_roots(samples: npt.NDArray[np.float64], contact_nm: float, ratio: float) -> None:
    """Put the root at the position of every sample over a contact that ends at contact_nm [nm]."""
    for index in range(BINS):
        samples[_ROOT, index] = root_of(float(samples[_AT, index]) - contact_nm, ratio)


@compiled
def over(params: FitParams, fit: Fit, surface: Surface) -> Fit:
    """Return the fit with another surface, under which its samples have other roots."""
    samples, ratio = fit.samples.copy(), surface.kappa / params.cantilever
    place_roots(samples, surface.contact_nm, ratio)
    return Fit(surface, samples, fit.bin, fit.damping, fit.known)


@compiled
def misfit(fit: Fit) -> float:
    """Return the weighted sum of squared residuals [nN^2] of the samples against the surface."""
    total, samples, kappa, adhesion = 0.0, fit.samples, fit.surface.kappa, fit.surface.adhesion_nn
    for index in range(BINS):
        weight = float(samples[_WEIGHT, index])
        if weight > 0.0:
            r = float(samples[_ROOT, index])
            error = float(samples[_FORCE, index]) - (kappa * r * r * r - adhesion)
            total += weight * error * error
    return total


@compiled
def solved_pair(p: float, q: float, r: float, u: float, v: float) -> tuple[float, float]:
    """Solve [[p, q], [q, r]] [x, y]' = [u, v]', positive definite, by elimination in this order on every machine."""
    below = q / p
    y = (v - below * u) / (r - below * q)
    return (u - q * y) / p, y


@compiled
def _damped(diagonal: float, damping: float) -> float:
    # The last term keeps a parameter in its place if nothing depends on it.
    return diagonal + damping * diagonal + 1e-12


@compiled
def fitted(params: FitParams, fit: Fit, position_nm: float, force: float) -> Fit:
    """Update the fit by one sample in contact, with one step of Levenberg and Marquardt over the bins.

    A step that would fit worse is not taken and the next one is more careful, so the misfit of what is remembered never
    rises by a step. A contact that still holds at a position ends further out: x_c stays below it, but no further than
    the range of the pull, because a shape that is not one of ours (a straight line) would drive it away without end.
    """
    fit = remembered(params, fit, position_nm, force)
    surface, samples = fit.surface, fit.samples
    # J' W J (c: x_c, k: kappa, a: F_a) and J' W e; the bins are added up in their order
    cc = ck = ca = kk = ka = aa = 0.0
    side_c = side_k = side_a = 0.0
    lowest = position_nm
    for index in range(BINS):
        weight = float(samples[_WEIGHT, index])
        if weight > 0.0:
            # samples from before the surface moved have lost the weight to bound the end of the contact
            if weight > _LEAST_BOUNDING:
                lowest = min(lowest, float(samples[_AT, index]))
            r = float(samples[_ROOT, index])
            by_c, by_k, by_a = gradient(surface, params.cantilever, r)
            error = weight * (float(samples[_FORCE, index]) - (surface.kappa * r * r * r - surface.adhesion_nn))
            cc, ck, ca = cc + weight * by_c * by_c, ck + weight * by_c * by_k, ca + weight * by_c * by_a
            kk, ka, aa = kk + weight * by_k * by_k, ka + weight * by_k * by_a, aa + weight * by_a * by_a
            side_c, side_k, side_a = side_c + error * by_c, side_k + error * by_k, side_a + error * by_a
    cc, kk, aa = _damped(cc, fit.damping), _damped(kk, fit.damping), _damped(aa, fit.damping)
    # x_c by the Schur complement of the other two: it has a bound, and what it cannot take is theirs
    by_k, by_a = solved_pair(kk, ka, aa, ck, ca)
    step_c = (side_c - side_k * by_k - side_a * by_a) / (cc - ck * by_k - ca * by_a)
    contact = min(max(surface.contact_nm + step_c, min(lowest - params.range_nm, surface.contact_nm)), lowest)
    step_c = contact - surface.contact_nm
    step_k, step_a = solved_pair(kk, ka, aa, side_k - ck * step_c, side_a - ca * step_c)
    tried = over(
        params,
        fit,
        Surface(
            contact,
            min(max(surface.kappa + step_k, 0.02 * params.kappa), 50.0 * params.kappa),
            max(surface.adhesion_nn + step_a, 0.0),
        ),
    )
    if misfit(tried) <= misfit(fit):
        return Fit(tried.surface, tried.samples, fit.bin, max(0.3 * fit.damping, _LEAST_DAMPING), True)
    return Fit(surface, samples, fit.bin, min(4.0 * fit.damping, _MOST_DAMPING), True)
