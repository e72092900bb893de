"""A simulated person, who makes the motion of a take at a simulated device as the prompts ask."""

import math
from collections.abc import Callable

from telenano.extend.hands import Capabilities
from telenano_devices.acceptance.haptic_device.take import STANDARD_GRAVITY_M_PER_S2
from telenano_devices.acceptance.take import Step
from telenano_devices.impedance.coupling import ZERO, Vector
from telenano_devices.impedance.emulated_arm import HandMotion

# Stiffness and damping of an ordinary arm.
_STIFFNESS_N_PER_M = 300.0
_DAMPING_N_S_PER_M = 5.0
_SLOW = ((0, 0.8), (0, -0.8), (0, 0.0), (1, 0.8), (1, -0.8), (1, 0.0), (2, 0.8), (2, -0.8), (2, 0.0))
_PUSHED = {"right": 0, "forward": 1, "up": 2}


def person(
    reach_m: Vector, buttons: int, held: int, steps: tuple[Step, ...], mass_kg: float = 0.0
) -> Callable[[float], HandMotion]:
    """Return the function from a time of a take [s] to the motion of the hand.

    Args:
        reach_m: Half of the workspace on each axis [m].
        buttons: The number of buttons.
        held: The bits of the buttons that are held while the device is driven, such as a dead-man.
        steps: The steps of the take.
        mass_kg: The mass that is hung at the handle [kg].
    """

    def at(time_s: float) -> HandMotion:
        for step in steps:
            if time_s <= step.seconds:
                return motion(step.name, time_s / step.seconds)
            time_s -= step.seconds
        return HandMotion(plugged=True)

    def motion(name: str, share: float) -> HandMotion:
        place, pressed = ZERO, held if name in ("hold", "mass", "cable") else 0
        if name == "rest":
            return HandMotion()
        if name == "slow":
            place = _on_way(share, reach_m)
        elif name == "fast":
            at_s = 2.0 * math.pi * share * 8.0
            x, y, z = reach_m
            place = (0.4 * x * math.sin(at_s), 0.4 * y * math.sin(1.3 * at_s), 0.4 * z * math.sin(0.7 * at_s))
        elif name in _PUSHED:
            place = _along(_PUSHED[name], 0.5 * reach_m[_PUSHED[name]] * math.sin(math.pi * share) ** 2)
        elif name == "button" and buttons:
            at_button = share * buttons
            pressed = (1 << min(buttons - 1, int(at_button))) * (0.2 < at_button - int(at_button) < 0.7)
        elif name == "mass":
            return HandMotion(force_n=(0.0, 0.0, -mass_kg * STANDARD_GRAVITY_M_PER_S2), buttons=pressed)
        plugged = name != "cable" or not 0.3 < share < 0.65
        return HandMotion(place, _STIFFNESS_N_PER_M, _DAMPING_N_S_PER_M, ZERO, pressed, plugged)

    return at


def reach_of(device: Capabilities) -> Vector:
    """Return half of the workspace that a device declares, on each axis [m]."""
    (x0, x1), (y0, y1) = device.lateral_m
    return 0.5 * (x1 - x0), 0.5 * (y1 - y0), 0.5 * (device.workspace_max_m - device.workspace_min_m)


def _on_way(share: float, reach_m: Vector) -> Vector:
    """Return the position of the hand [m] as it moves along one axis after the other; share 0 to 1 of the step."""
    at = share * len(_SLOW)
    leg = min(len(_SLOW) - 1, int(at))
    (axis, end), (before, begin) = _SLOW[leg], _SLOW[leg - 1] if leg else (0, 0.0)
    begin = begin if before == axis else 0.0
    # The motion is eased, so that no leg begins or ends with a jerk.
    way = reach_m[axis] * (begin + (end - begin) * 0.5 * (1.0 - math.cos(math.pi * (at - leg))))
    return _along(axis, way)


def _along(axis: int, way_m: float) -> Vector:
    return way_m * (axis == 0), way_m * (axis == 1), way_m * (axis == 2)
