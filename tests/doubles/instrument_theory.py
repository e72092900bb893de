"""Theoretical relations by which tests judge the models of the instrument."""

import math

from telenano.afm.cantilever import Plant, branch_force
from telenano.afm.dynamic_plant import DynamicPlant


def base_for(plant: Plant, distance_m: float, contact: bool, meniscus: bool) -> float:
    """Return the base position X [m] that holds the tip in equilibrium at h [m] on the branch (contact, meniscus)."""
    force, _ = branch_force(plant.tip, distance_m, contact, meniscus)
    return plant.rest_distance_m - distance_m + force / plant.stiffness_n_per_m


def drive_work_j(plant: DynamicPlant, drive_m: float, in_phase_m: float, quadrature_m: float) -> float:
    """Return the work of the driven base in a period of steady vibration [J].

    The base exerts k zeta + 2 m b zeta' and moves by x_d; only the part of zeta at the drive's frequency does work.
    """
    w = 2.0 * math.pi * plant.drive_hz
    return math.pi * drive_m * (plant.damping_kg_per_s * w * in_phase_m - plant.stiffness_n_per_m * quadrature_m)
