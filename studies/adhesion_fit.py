"""Radius of the tip and work of adhesion from the contact part of a force curve, with their uncertainties.

The retraction from the load to the pull-off is compared with Maugis and Dugdale's contact (Eq. 7-11, E5, E6) at the
reduced modulus of the configuration, and with the constant pull of the meniscus in contact (E4) where there is one.
Free are the radius R, the work of adhesion w and the place of the surface. The uncertainties are those of least
squares: the scatter about the fit and the curvature of its sum of squares; they do not know of an error of the spring
constant, of the modulus or of the model, and grow where the curve hardly tells R and w apart.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.lennard_jones import contact_distance_m
from services.afm_node.maugis_dugdale import cohesive_stress_pa, force_n, maugis_dugdale, reduced_modulus_pa
from services.runtime.compiled import compiled
from studies.force_curve import Curve

Array = npt.NDArray[np.float64]

_MOST_POINTS = 400
_LEAST_POINTS = 12
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


def fit_adhesion(curve: Curve, config: AfmConfig) -> AdhesionFit:
    """Fit radius and work of adhesion to the contact of a curve.

    Parameters: config, whose moduli, Poisson ratios, sigma and meniscus the contact is taken to have.
    Raises: ConfigError, if the curve has too few points in contact or the fit does not converge.
    """
    from scipy.optimize import least_squares

    model = _model(config)
    travel, force, pull_n = _contact_part(curve)
    k = curve.stiffness_n_per_m
    radius = config.tip_sample.tip_radius_m
    work = max(-(pull_n + model.capillary_n_per_m * radius), 0.05 * -pull_n) / (1.75 * math.pi * radius)
    # by Hertz, how deep the tip is at the load
    depth = (max(float(force.max()), 1e-12) / (4.0 / 3.0 * model.modulus_pa * math.sqrt(radius))) ** (2.0 / 3.0)
    start = np.array([math.log(radius), math.log(work), (float(travel[np.argmax(force)]) - depth) * 1e9])
    scale = max(float(np.ptp(force)), 1e-12) * 1e-3

    def residuals(free: Array) -> Array:
        forces, stiffness = _predicted(model, free, travel)
        # the deflection is in the travel too: noise of the force moves the point along the curve
        return np.asarray((force - forces) / (1.0 + stiffness / k) / scale)

    bounds = (
        [math.log(_RADII_M[0]), math.log(_WORKS_J_PER_M2[0]), start[2] - 50.0],
        [math.log(_RADII_M[1]), math.log(_WORKS_J_PER_M2[1]), start[2] + 50.0],
    )
    found = least_squares(residuals, start, bounds=bounds, x_scale=[0.1, 0.1, 0.1], diff_step=1e-5, loss="linear")
    if not found.success:
        raise ConfigError(f"radius and work of adhesion cannot be fitted: {found.message}")
    free = len(travel) - len(start)
    variance = 2.0 * float(found.cost) / free
    try:
        covariance = np.linalg.inv(found.jac.T @ found.jac) * variance
    except np.linalg.LinAlgError as error:
        raise ConfigError("the curve does not tell radius and work of adhesion apart") from error
    radius, work = float(np.exp(found.x[0])), float(np.exp(found.x[1]))
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    forces, _ = _predicted(model, found.x, travel)
    scatter = float(np.sqrt(np.mean((force - forces) ** 2)))
    contact = _contact(model, radius, work)
    return AdhesionFit(
        radius, radius * float(errors[0]), work, work * float(errors[1]), scatter, len(travel), contact.transition
    )


def _model(config: AfmConfig) -> _Model:
    t = config.tip_sample
    modulus = reduced_modulus_pa(t.tip_modulus_pa, t.tip_poisson, t.sample_modulus_pa, t.sample_poisson)
    capillary = 4.0 * math.pi * t.liquid_energy_j_per_m2 if config.meniscus else 0.0
    return _Model(modulus, contact_distance_m(t.sigma_m), -capillary)


def _contact(model: _Model, radius_m: float, work: float) -> Any:
    return maugis_dugdale(radius_m, work, model.modulus_pa, cohesive_stress_pa(work, model.contact_distance_m))


def _contact_part(curve: Curve) -> tuple[Array, Array, float]:
    """Return travel x_s - zeta [m] and force [N] from the load to shortly before the pull-off, and the pull-off [N]."""
    up = curve.retract
    pull = int(np.argmin(up.force_n))
    pull_n = float(up.force_n[pull])
    last = max(round((1.0 - _LEFT_OUT) * pull), 0)
    if last < _LEAST_POINTS or pull_n >= 0.0:
        raise ConfigError(f"the retraction has {last} points in contact before a pull-off; {_LEAST_POINTS} are needed")
    chosen = np.unique(np.linspace(0, last, min(last + 1, _MOST_POINTS)).astype(int))
    return up.base_m[chosen] - up.deflection_m[chosen], up.force_n[chosen], pull_n


def _predicted(model: _Model, free: Array, travel: Array) -> tuple[Array, Array]:
    """Return forces [N] and stiffnesses [N/m] at the depths of the travel."""
    radius, work = math.exp(free[0]), math.exp(free[1])
    contact = _contact(model, radius, work)
    depths = travel - free[2] * 1e-9
    forces, ahead = np.empty(len(depths)), np.empty(len(depths))
    _forces(contact, depths, forces)
    step = 1e-12
    _forces(contact, depths + step, ahead)
    stiffness = np.clip((ahead - forces) / step, 0.0, 1e4)
    return forces + model.capillary_n_per_m * radius, stiffness
