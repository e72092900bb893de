"""The mechanics of emulated devices: chosen for emulators, not measured."""

from typing import NamedTuple


class ArmModel(NamedTuple):
    """m [kg], b [N s/m], Coulomb friction c [N], radius of the workspace [m], step of the encoder [m], 0 for none."""

    mass_kg: float
    damping_n_s_per_m: float
    friction_n: float = 0.0
    radius_m: float = 0.15
    resolution_m: float = 0.0


INVERSE3 = ArmModel(0.20, 0.20, radius_m=0.10, resolution_m=1e-6)
