"""Radius of the tip and work of adhesion from the contact part of a force curve, with their uncertainties.

The retraction from the load to the pull-off is compared with Maugis and Dugdale's contact (Eq. 7-11, E5, E6) at the
reduced modulus of the configuration, and with the constant pull of the meniscus in contact (E4) where there is one.
The model is followed as the instrument does, in equilibrium with the spring at each base, so that noise of the
deflection is noise of the force and of nothing else. Free are the radius R, the work of adhesion w and the place of
the surface. The uncertainties are those of least squares: the scatter about the fit and the curvature of its sum of
squares; they do not know of an error of the spring constant, of the modulus or of the model, and grow where the curve
hardly tells R and w apart.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.physics.contact.lennard_jones import contact_distance_m
from services.afm_node.physics.contact.maugis_dugdale import (
    cohesive_stress_pa,
    force_n,
    indentation_m,
    maugis_dugdale,
    pull_off_indentation_m,
    reduced_modulus_pa,
)
from services.numerics.compiled import compiled, compiled_form
from studies.instrument.force_curve import Curve

Array = npt.NDArray[np.float64]

_MOST_POINTS = 400
_LEAST_POINTS = 12
_GRID = 600
_SHIFTS_NM = (-1.0, -0.3, 0.0, 0.3, 1.0)
# next to the pull-off the contact may end a little earlier or later than the model's
_LEFT_OUT = 0.03
_RADII_M, _WORKS_J_PER_M2 = (1e-10, 1e-4), (1e-6, 10.0)


class AdhesionFit(NamedTuple):
    """R [m] and w [J/m^2] with standard errors, scatter about the fit [N], points used, transition parameter lambda."""

    radius_m: float
    radius_error_m: float
    work_of_adhesion_j_per_m2: float
    work_of_adhesion_error_j_per_m2: float
    residual_n: float
    points: int
    transition: float

    def as_dict(self) -> dict[str, Any]:
        return self._asdict()


class _Model(NamedTuple):
    modulus_pa: float
    contact_distance_m: float
    # pull of the meniscus for a radius [N/m]
    capillary_n_per_m: float


@compiled
def _forces(contact: Any, depths_m: Array, out: Array) -> None:
    for i in range(depths_m.shape[0]):
        out[i] = force_n(contact, depths_m[i])


def fit_adhesion(curve: Curve, config: AfmConfig, reduced_modulus: float | None = None) -> AdhesionFit:
    """Fit radius and work of adhesion to the contact of a curve.

    Parameters: config, whose moduli, Poisson ratios, sigma and meniscus the contact is taken to have; reduced_modulus
    [Pa], in the place of that of the moduli.
    Raises: ConfigError, if the curve has too few points in contact or has no such contact.
    """
    from scipy.optimize import least_squares

    model = _model(config, reduced_modulus)
    base, force, pull_n, depth_m = _contact_part(curve)
    k = curve.stiffness_n_per_m
    radius = config.tip_sample.tip_radius_m
    work = max(-(pull_n - model.capillary_n_per_m * radius), 0.05 * -pull_n) / (1.75 * math.pi * radius)
    start = np.array([math.log(radius), math.log(work), 0.0])
    # the point of the curve where it begins, by Hertz
    indentation = (max(float(force.max()), 1e-12) / (4.0 / 3.0 * model.modulus_pa * math.sqrt(radius))) ** (2.0 / 3.0)
    origin = depth_m - indentation
    scale = max(float(np.ptp(force)), 1e-12) * 1e-3

    def residuals(free: Array) -> Array:
        return np.asarray((force - _predicted(model, free, base - origin, k, float(force.max()))) / scale)

    bounds = (
        [math.log(_RADII_M[0]), math.log(_WORKS_J_PER_M2[0]), -1e3],
        [math.log(_RADII_M[1]), math.log(_WORKS_J_PER_M2[1]), 1e3],
    )
    # the end of the contact makes minima of its own where the surface is taken a little too high or too low
    fits = [
        least_squares(
            residuals, start + np.array([0.0, 0.0, shift]), bounds=bounds, x_scale=[0.1, 0.1, 0.1], diff_step=1e-5
        )
        for shift in _SHIFTS_NM
    ]
    found = min(fits, key=lambda fit: float(fit.cost))
    refusal = f"the curve has no contact of reduced modulus {model.modulus_pa:.3g} Pa: give the one of this sample"
    if not found.success or np.any(found.active_mask):
        raise ConfigError(refusal)
    variance = 2.0 * float(found.cost) / (len(base) - len(start))
    try:
        covariance = np.linalg.inv(found.jac.T @ found.jac) * variance
    except np.linalg.LinAlgError as error:
        raise ConfigError(refusal) from error
    radius, work = float(np.exp(found.x[0])), float(np.exp(found.x[1]))
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    scatter = float(np.sqrt(np.mean((residuals(found.x) * scale) ** 2)))
    contact = _contact(model, radius, work)
    return AdhesionFit(
        radius, radius * float(errors[0]), work, work * float(errors[1]), scatter, len(base), contact.transition
    )


def _model(config: AfmConfig, reduced_modulus: float | None) -> _Model:
    t = config.tip_sample
    modulus = reduced_modulus or reduced_modulus_pa(
        t.tip_modulus_pa, t.tip_poisson, t.sample_modulus_pa, t.sample_poisson
    )
    capillary = 4.0 * math.pi * t.liquid_energy_j_per_m2 if config.meniscus else 0.0
    return _Model(modulus, contact_distance_m(t.sigma_m), -capillary)


def _contact(model: _Model, radius_m: float, work: float) -> Any:
    return maugis_dugdale(radius_m, work, model.modulus_pa, cohesive_stress_pa(work, model.contact_distance_m))


def _contact_part(curve: Curve) -> tuple[Array, Array, float, float]:
    """Return base [m] and force [N] from the load to shortly before the pull-off, the pull-off [N], and x_s - zeta [m].

    The last is that of the greatest load.
    """
    up = curve.retract
    pull = int(np.argmin(up.force_n))
    pull_n = float(up.force_n[pull])
    last = max(round((1.0 - _LEFT_OUT) * pull), 0)
    if last < _LEAST_POINTS or pull_n >= 0.0:
        raise ConfigError(f"the retraction has {last} points in contact before a pull-off; {_LEAST_POINTS} are needed")
    chosen = np.unique(np.linspace(0, last, min(last + 1, _MOST_POINTS)).astype(int))
    deepest = float(up.base_m[0] - up.deflection_m[0])
    return up.base_m[chosen], up.force_n[chosen], pull_n, deepest


def _predicted(model: _Model, free: Array, base: Array, k: float, load_n: float) -> Array:
    """Return the forces [N] in equilibrium with a spring k [N/m] at bases [m] whose zero is near the surface's."""
    radius, work = math.exp(free[0]), math.exp(free[1])
    contact = _contact(model, radius, work)
    dry_n = max(load_n - model.capillary_n_per_m * radius, 0.0)
    deepest = indentation_m(contact, 1.2 * dry_n + 0.1 * contact.force_unit_n)
    first = pull_off_indentation_m(contact)
    # fine where the contact ends
    depths = first + (deepest - first) * np.linspace(0.0, 1.0, _GRID) ** 2
    forces = np.empty(_GRID)
    compiled_form(_forces)(contact, depths, forces)
    forces += model.capillary_n_per_m * radius
    bases = np.maximum.accumulate(depths + free[2] * 1e-9 + forces / k)
    # beyond both ends along the spring, so that the fit is led back
    found = np.interp(base, bases, forces)
    found += np.where(base > bases[-1], (base - bases[-1]) * k, 0.0)
    return np.asarray(found + np.where(base < bases[0], (base - bases[0]) * k, 0.0))
