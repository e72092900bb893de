"""Radius of the tip and work of adhesion from the contact part of a force curve, with their uncertainties.

The retraction from the load to the pull-off is compared with Maugis and Dugdale's contact (Eq. 7-11, E5, E6) at the
reduced modulus of the configuration, plus the constant pull of the meniscus in contact (E4) where there is one. As in
the instrument, the model is in equilibrium with the spring at each base, so noise of the deflection enters the force
alone. The free parameters are the radius R, the work of adhesion w and the place of the surface, and also the zero of
the force and its drift in time, which the end of the retraction, away from the sample, determines.

The noise need not be white: it is modelled as white noise plus noise with a finite correlation time, whose sizes
maximize the restricted likelihood (`correlated_noise`). The uncertainties are those of generalized least squares with
that noise, and grow where the curve hardly distinguishes R from w. They exclude errors of the spring constant, of the
modulus and of the model.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm import MaugisDugdale, cohesive_stress_pa, force_n, reduced_modulus_pa
from telenano.analysis import denied
from telenano.numerics import compiled, compiled_form
from telenano.sections import AfmConfig
from telenano.wire import ConfigError, NoEstimateError
from telenano_lab.microscopy.correlated_noise import Noise, correlated_noise
from telenano_lab.microscopy.force_curve import Curve

Array = npt.NDArray[np.float64]

# The contact is thinned to this number of points.
_MOST_POINTS = 200
# The retraction after the contact is thinned to this number of points.
_MOST_FREE_POINTS = 400
# The fit needs this number of points in contact before the pull-off.
_LEAST_POINTS = 12
# A curve of the model is computed at this number of depths.
_GRID = 600
# The fit begins at each of these shifts of the contact point.
_SHIFTS_NM = (-1.0, -0.3, 0.0, 0.3, 1.0)
# This share of the contact before the pull-off is left out: it may end a little earlier or later than in the model.
_LEFT_OUT = 0.03
# Bounds of the fitted values.
_RADII_M = (1e-10, 1e-4)
_WORKS_J_PER_M2 = (1e-6, 10.0)
# Share of the retraction after the last jump, at its end, that is free of force; nearer, the tip is attracted.
_FREE_SHARE = 0.6
# The fit with the estimated noise ends after at most this number of steps.
_MOST_STEPS = 24
# The fit has ended when a step changes its parameters by less than this share of their errors.
_ENOUGH = 0.02


class FittedContact(NamedTuple):
    """The fitted contact: base [m], measured force [N], model force with the zero line [N]; each of shape (n,)."""

    base_m: Array
    measured_n: Array
    model_n: Array


class AdhesionFit(NamedTuple):
    """R [m] and w [J/m^2] with standard errors, scatter about the fit [N], number of points, transition parameter.

    wander_n: standard deviation of the part of the noise that is correlated in time [N]; wander_points: its correlation
    length in points. transition: lambda of Maugis.
    """

    radius_m: float
    radius_error_m: float
    work_of_adhesion_j_per_m2: float
    work_of_adhesion_error_j_per_m2: float
    residual_n: float
    points: int
    transition: float
    wander_n: float
    wander_points: float
    fitted: FittedContact

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name, without the points."""
        return {name: value for name, value in self._asdict().items() if name != "fitted"}


class _Model(NamedTuple):
    modulus_pa: float
    contact_distance_m: float
    # Pull of the meniscus per radius of the tip [N/m].
    capillary_n_per_m: float


@compiled
def _forces(contact: Any, depths_m: Array, out: Array) -> None:
    for i in range(depths_m.shape[0]):
        out[i] = force_n(contact, depths_m[i])


def fit_adhesion(curve: Curve, config: AfmConfig, reduced_modulus: float | None = None) -> AdhesionFit:
    """Fit the radius of the tip and the work of adhesion to the contact of a curve.

    Args:
        curve: The curve.
        config: The source of moduli, Poisson ratios, sigma and meniscus of the contact.
        reduced_modulus: The reduced modulus [Pa], used instead of that of the moduli.

    Raises:
        ConfigError: The curve has too few points in contact, or the model does not fit it.
    """
    from scipy.optimize import least_squares

    model = _model(config, reduced_modulus)
    part = _contact_part(curve)
    base, force = part.base_m, part.force_n
    k, load_n = curve.stiffness_n_per_m, float(force.max())
    radius = config.tip_sample.tip_radius_m
    work = max(-(part.pull_n - model.capillary_n_per_m * radius), 0.05 * -part.pull_n) / (1.75 * math.pi * radius)
    start = np.array([math.log(radius), math.log(work), 0.0])
    # Hertz gives the indentation at the load, and from it the starting place of the surface.
    indentation = (max(load_n, 1e-12) / (4.0 / 3.0 * model.modulus_pa * math.sqrt(radius))) ** (2.0 / 3.0)
    origin = part.deepest_m - indentation
    scale = max(float(np.ptp(force)), 1e-12) * 1e-3

    def predicted(free: Array) -> Array:
        """Return the model's forces in contact, and zeros away from the sample, in units of `scale`."""
        return np.concatenate([_predicted(model, free, base - origin, k, load_n), np.zeros(len(part.free_n))]) / scale

    def residuals(free: Array) -> Array:
        return np.asarray(force / scale - predicted(free)[: len(base)])

    bounds = (
        [math.log(_RADII_M[0]), math.log(_WORKS_J_PER_M2[0]), -1e3],
        [math.log(_RADII_M[1]), math.log(_WORKS_J_PER_M2[1]), 1e3],
    )
    # The end of the contact makes local minima where the surface is assumed a little too high or too low.
    fits = [
        least_squares(
            residuals,
            start + np.array([0.0, 0.0, shift]),
            bounds=bounds,
            x_scale=[0.1, 0.1, 0.1],
            diff_step=1e-5,
            ftol=1e-6,
        )
        for shift in _SHIFTS_NM
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    refusal = f"the reduced modulus {model.modulus_pa:.3g} Pa does not suit this curve: give the one of this sample"
    _refuse_bounds(best.x, refusal)
    if not best.success:
        raise ConfigError(refusal)
    try:
        free, errors, noise = _with_noise(predicted, best.x, part, scale, refusal)
    except np.linalg.LinAlgError as error:
        raise ConfigError(refusal) from error
    _refuse_bounds(free, "the curve does not tell radius and work of adhesion apart", errors[:2].tolist())
    radius, work = float(np.exp(free[0])), float(np.exp(free[1]))
    drawn = FittedContact(base, force, scale * (predicted(free) + noise.zero)[: len(base)])
    scatter = float(np.sqrt(np.mean((drawn.measured_n - drawn.model_n) ** 2)))
    contact = _contact(model, radius, work)
    return AdhesionFit(
        radius,
        radius * float(errors[0]),
        work,
        work * float(errors[1]),
        scatter,
        len(base),
        contact.transition,
        scale * noise.wander,
        noise.points,
        drawn,
    )


def _with_noise(
    predicted: Callable[[Array], Array], free: Array, part: "_Part", scale: float, refusal: str
) -> tuple[Array, Array, Noise]:
    """Return the free values fitted in the estimated noise, their standard errors, and that noise.

    Each step estimates the noise of the residuals and moves by generalized least squares with it; offset and drift of
    the force are free in each. A step that reverses the one before is halved, and so are all later ones: where the
    curve hardly distinguishes radius from work, whole steps would oscillate about the minimum and end anywhere.
    """
    measured = np.concatenate([part.force_n, part.free_n]) / scale
    times = part.place / max(float(part.place[-1]), 1.0)
    before, share = np.zeros(3), 1.0
    for _ in range(_MOST_STEPS):
        present = predicted(free)
        columns = [np.ones_like(times), times - times.mean()]
        for i in range(3):
            ahead, behind = free.copy(), free.copy()
            ahead[i], behind[i] = ahead[i] + 1e-4, behind[i] - 1e-4
            columns.append((predicted(ahead) - predicted(behind)) / 2e-4)
        noise = correlated_noise(measured - present, np.stack(columns, axis=1), part.place)
        errors = np.sqrt(np.diag(noise.covariance))[2:]
        noise = noise._replace(zero=columns[0] * noise.coefficients[0] + columns[1] * noise.coefficients[1])
        # A step beyond the range of the linear model is cut.
        move = np.clip(noise.coefficients[2:], -3.0 * errors, 3.0 * errors)
        if (move / errors) @ (before / errors) < 0.0:
            share *= 0.5
        before = move
        free = free + share * move
        _refuse_bounds(free, refusal)
        if np.all(np.abs(move) <= _ENOUGH * errors):
            break
    return free, errors, noise


def _refuse_bounds(free: Array, refusal: str, errors: Sequence[float] = (0.0, 0.0)) -> None:
    """Raise NoEstimateError if radius or work ended at the end of its range, or its relative error denies it."""
    found = (("the radius", _RADII_M, "m"), ("the work of adhesion", _WORKS_J_PER_M2, "J/m^2"))
    for value, share, (name, ends, unit) in zip(free[:2].tolist(), errors, found, strict=True):
        if reason := denied(name, math.exp(value), math.exp(value) * share, unit, ends=ends):
            raise NoEstimateError(f"{refusal} ({reason})")


def _model(config: AfmConfig, reduced_modulus: float | None) -> _Model:
    t = config.tip_sample
    modulus = reduced_modulus or reduced_modulus_pa(
        t.tip_modulus_pa, t.tip_poisson, t.sample_modulus_pa, t.sample_poisson
    )
    capillary = 4.0 * math.pi * t.liquid_energy_j_per_m2 if config.meniscus else 0.0
    return _Model(modulus, config.to_params().plant.tip.contact_distance_m, -capillary)


def _contact(model: _Model, radius_m: float, work: float) -> Any:
    return MaugisDugdale.of(radius_m, work, model.modulus_pa, cohesive_stress_pa(work, model.contact_distance_m))


class _Part(NamedTuple):
    """The retraction from the load to shortly before the pull-off, and its end away from the sample.

    base_m, force_n: of the contact; pull_n: the pull-off [N]; deepest_m: x_s - zeta at the greatest load [m]; free_n:
    the force away from the sample; place: number of each of these points in the retraction, contact first.
    """

    base_m: Array
    force_n: Array
    pull_n: float
    deepest_m: float
    free_n: Array
    place: Array


def _contact_part(curve: Curve) -> _Part:
    up = curve.retract
    pull = int(np.argmin(up.force_n))
    pull_n = float(up.force_n[pull])
    last = max(round((1.0 - _LEFT_OUT) * pull), 0)
    if last < _LEAST_POINTS or pull_n >= 0.0:
        raise ConfigError(f"the retraction has {last} points in contact before a pull-off; {_LEAST_POINTS} are needed")
    chosen = np.unique(np.linspace(0, last, min(last + 1, _MOST_POINTS)).astype(int))
    count = len(up.force_n)
    jump = pull + int(np.argmax(np.diff(up.force_n[pull:]))) if count - pull > 1 else pull
    first = jump + max(round((1.0 - _FREE_SHARE) * (count - jump)), 1)
    left = np.unique(np.linspace(first, count - 1, min(max(count - first, 0), _MOST_FREE_POINTS)).astype(int))
    return _Part(
        up.base_m[chosen],
        up.force_n[chosen],
        pull_n,
        float(up.base_m[0] - up.deflection_m[0]),
        up.force_n[left],
        np.concatenate([chosen, left]).astype(np.float64),
    )


def _predicted(model: _Model, free: Array, base: Array, k: float, load_n: float) -> Array:
    """Return the forces [N] in equilibrium with a spring k [N/m] at bases [m] measured from near the surface."""
    radius, work = math.exp(free[0]), math.exp(free[1])
    contact = _contact(model, radius, work)
    dry_n = max(load_n - model.capillary_n_per_m * radius, 0.0)
    deepest = contact.indentation_m(1.2 * dry_n + 0.1 * contact.force_unit_n)
    _, first = contact.pull_off()
    # The grid is finest where the contact ends.
    depths = first + (deepest - first) * np.linspace(0.0, 1.0, _GRID) ** 2
    forces = np.empty(_GRID)
    compiled_form(_forces)(contact, depths, forces)
    forces += model.capillary_n_per_m * radius
    bases = np.maximum.accumulate(depths + free[2] * 1e-9 + forces / k)
    # Beyond both ends the force continues along the spring, which leads the fit back.
    predicted = np.interp(base, bases, forces)
    predicted += np.where(base > bases[-1], (base - bases[-1]) * k, 0.0)
    return np.asarray(predicted + np.where(base < bases[0], (base - bases[0]) * k, 0.0))
