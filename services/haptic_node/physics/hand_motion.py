"""What a hand on a device of three axes does at a time."""

from typing import NamedTuple

from services.haptic_node.coupling import ZERO, Vector


class HandMotion(NamedTuple):
    """What the hand does at a time [s]: where it means to be, its spring and damper, a force besides, and buttons."""

    place_m: Vector = ZERO
    stiffness_n_per_m: float = 0.0
    damping_n_s_per_m: float = 0.0
    force_n: Vector = ZERO
    buttons: int = 0
    plugged: bool = True
