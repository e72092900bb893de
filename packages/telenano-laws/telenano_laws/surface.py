"""A compact Maugis-Dugdale surface, seen from the base of a cantilever, and its recursive fit to measured contacts.

With the indentation s from the point where the contact ends, and the cantilever stiffness k in series,

    F(s) = kappa s^(3/2) - F_a,   y(s) = s + kappa s^(3/2) / k,   y = x_s - x_c.

Three parameters: x_c, base position at which the contact ends [m]; kappa = 4/3 E* sqrt(R) for a sphere [N/m^1.5]; F_a,
adhesion at that point [N]. This is the DMT limit of Maugis-Dugdale (Maugis, J. Colloid Interface Sci. 150, 1992), exact
for lambda -> 0. For other lambda the two offsets, which are free here, absorb nearly all of the difference: fitted to
Table 2 (lambda = 0.83), the contact stiffness at indentations of 0 to 2 nm is right within a few percent (tested). A
constant meniscus force is part of F_a.

Outside (y < 0) the adhesion fades linearly over a range l, F = -F_a (1 + y / l): a local rendering of the jump in the
limit l -> 0 would chatter. F is a function of y, so the surface has a potential V(y) and is passive while its
parameters are constant; a change of parameters adds V after minus V before, by `force_and_potential`.

The fit is by least squares over the newest force in each of a few bins of the position. It uses the whole range that
the tip visited lately, and not only its present position, so it neither forgets nor drifts while the tip is at rest.

This module computes in nm and nN, so that the numbers of the fit are near one.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import compiled

NANO = 1e-9
# Factor that converts kappa from N/m^1.5 to nN/nm^1.5.
KAPPA_UNIT = 10.0**-4.5
BINS = 32
# Rows of the array of samples.
_AT = 0
_FORCE = 1
_WEIGHT = 2
_ROOT = 3
# Greatest number of steps of Newton's method.
_ITERATIONS = 30
# Factor by which the weights of all bins fall when the tip moves to another bin.
_KEEP = 0.98
# Least weight of a bin that bounds the end of the contact.
_LEAST_BOUNDING = 0.3
# First damping of the fit, and its bounds.
_FIRST_DAMPING = 1e-2
_LEAST_DAMPING = 1e-6
_MOST_DAMPING = 1e6


class Surface(NamedTuple):
    """x_c [nm], kappa [nN/nm^1.5], F_a [nN]."""

    contact_nm: float
    kappa: float
    adhesion_nn: float


class Fit(NamedTuple):
    """The estimated surface and its data: the newest force in each of BINS bins of the base position, with a weight.

    samples: shape (4, BINS); the rows are the base positions [nm], the forces [nN], the weights (0 for an empty bin),
    and the root (`root_of`) at each position over `surface` [nm^0.5]. `bin`: the last visited one; damping: that of the
    last step of the fit; known: whether the tip ever met a surface.
    """

    surface: Surface
    samples: npt.NDArray[np.float64]
    bin: int
    damping: float
    known: bool


class FitParams(NamedTuple):
    """Stiffness of the cantilever k [N/m = nN/nm], range of the adhesion l [nm], first kappa, width of a bin [nm]."""

    cantilever: float
    range_nm: float
    kappa: float
    bin_nm: float


@compiled
def root_of(y_nm: float, ratio: float) -> float:
    """Solve r^2 + ratio r^3 = y for r >= 0; 0 for y <= 0. Newton's method starts above, where it is monotonic."""
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
    """Return F [nN] at a base position [nm], and V = int F dx from far away to that position [nN nm = 1e-18 J]."""
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
    """Start a fit at the first sample in contact; a pushing force puts the end of the contact before this position."""
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
    """Store a sample in its bin; all others lose weight when the tip enters another bin, but not while it stays."""
    index = math.floor(position_nm / params.bin_nm) % BINS
    samples, surface = fit.samples.copy(), fit.surface
    if index != fit.bin:
        samples[_WEIGHT] *= _KEEP
    samples[_AT, index], samples[_FORCE, index], samples[_WEIGHT, index] = position_nm, force, 1.0
    samples[_ROOT, index] = root_of(position_nm - surface.contact_nm, surface.kappa / params.cantilever)
    return Fit(surface, samples, index, fit.damping, fit.known)


def _place_roots_at_once(samples: npt.NDArray[np.float64], contact_nm: float, ratio: float) -> None:
    """Do each Newton step for all samples before the next step; the steps are those of `root_of`."""
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
    """Store the root of every sample, for a contact that ends at contact_nm [nm]; changes `samples`."""
    for index in range(BINS):
        samples[_ROOT, index] = root_of(float(samples[_AT, index]) - contact_nm, ratio)


@compiled
def over(params: FitParams, fit: Fit, surface: Surface) -> Fit:
    """Return the fit with another surface, and the roots of its samples for that."""
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
    """Solve [[p, q], [q, r]] [x, y]' = [u, v]', positive definite; the fixed order gives the same bits everywhere."""
    below = q / p
    y = (v - below * u) / (r - below * q)
    return (u - q * y) / p, y


@compiled
def _damped(diagonal: float, damping: float) -> float:
    # The last term keeps a parameter constant if no sample depends on it.
    return diagonal + damping * diagonal + 1e-12


@compiled
def fitted(params: FitParams, fit: Fit, position_nm: float, force: float) -> Fit:
    """Update the fit with one sample in contact, by one Levenberg-Marquardt step over the bins.

    A step that would increase the misfit is dropped and the next one is damped more, so a step never increases the
    misfit of the stored samples. The contact ends below each position that was in contact, so x_c stays below these,
    but by no more than the range of the adhesion: another force law (a straight line) would else move it away forever.
    """
    fit = remembered(params, fit, position_nm, force)
    surface, samples = fit.surface, fit.samples
    # J' W J (c: x_c, k: kappa, a: F_a) and J' W e, summed over the bins in their order.
    cc = ck = ca = kk = ka = aa = 0.0
    side_c = side_k = side_a = 0.0
    lowest = position_nm
    for index in range(BINS):
        weight = float(samples[_WEIGHT, index])
        if weight > 0.0:
            # Old samples, perhaps from before the surface moved, have too little weight to bound the contact's end.
            if weight > _LEAST_BOUNDING:
                lowest = min(lowest, float(samples[_AT, index]))
            r = float(samples[_ROOT, index])
            by_c, by_k, by_a = gradient(surface, params.cantilever, r)
            error = weight * (float(samples[_FORCE, index]) - (surface.kappa * r * r * r - surface.adhesion_nn))
            cc, ck, ca = cc + weight * by_c * by_c, ck + weight * by_c * by_k, ca + weight * by_c * by_a
            kk, ka, aa = kk + weight * by_k * by_k, ka + weight * by_k * by_a, aa + weight * by_a * by_a
            side_c, side_k, side_a = side_c + error * by_c, side_k + error * by_k, side_a + error * by_a
    cc, kk, aa = _damped(cc, fit.damping), _damped(kk, fit.damping), _damped(aa, fit.damping)
    # x_c comes first, by the Schur complement of the other two, because it is bounded; these absorb the remainder.
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
