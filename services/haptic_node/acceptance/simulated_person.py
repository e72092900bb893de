"""A person who goes through the motion of a take at a simulated device, as the prompts ask for it."""

import math
from collections.abc import Callable

from services.haptic_node.acceptance.checks import STANDARD_GRAVITY_M_PER_S2
from services.haptic_node.acceptance.take import Step
from services.haptic_node.coupling import ZERO, Vector
from services.haptic_node.devices.simulated_link import HandMotion
from services.haptic_node.driver import Capabilities

# an ordinary arm
_STIFFNESS_N_PER_M, _DAMPING_N_S_PER_M = 300.0, 5.0
_SLOW = ((0, 0.8), (0, -0.8), (0, 0.0), (1, 0.8), (1, -0.8), (1, 0.0), (2, 0.8), (2, -0.8), (2, 0.0))
_PUSHED = {"right": 0, "forward": 1, "up": 2}


def person(device: Capabilities, steps: tuple[Step, ...], mass_kg: float = 0.0) -> Callable[[float], HandMotion]:
    """Return what the hand does at each time of a take [s]."""
    reach_m = device.workspace_max_m
    held = 1 << device.buttons.index(device.deadman) if device.deadman else 0

    def at(time_s: float) -> HandMotion:
        for step in steps:
            if time_s <= step.seconds:
                return motion(step.name, time_s / step.seconds)
            time_s -= step.seconds
        return HandMotion(plugged=True)

    def motion(name: str, share: float) -> HandMotion:
        place, buttons = ZERO, held if name in ("hold", "mass", "cable") else 0
        if name == "rest":
            return HandMotion()
        if name == "slow":
            place = _on_way(share, reach_m)
        elif name == "fast":
            swing = 0.4 * reach_m
            at_s = 2.0 * math.pi * share * 8.0
            place = (swing * math.sin(at_s), swing * math.sin(1.3 * at_s), swing * math.sin(0.7 * at_s))
        elif name in _PUSHED:
            way = 0.5 * reach_m * math.sin(math.pi * share) ** 2
            place = (way * (name == "right"), way * (name == "forward"), way * (name == "up"))
        elif name == "button" and device.buttons:
            at_button = share * len(device.buttons)
            buttons = (1 << min(len(device.buttons) - 1, int(at_button))) * (0.2 < at_button - int(at_button) < 0.7)
        elif name == "mass":
            return HandMotion(force_n=(0.0, 0.0, -mass_kg * STANDARD_GRAVITY_M_PER_S2), buttons=buttons)
        plugged = name != "cable" or not 0.3 < share < 0.65
        return HandMotion(place, _STIFFNESS_N_PER_M, _DAMPING_N_S_PER_M, ZERO, buttons, plugged)

    return at


def _on_way(share: float, reach_m: float) -> Vector:
    """Return where the hand is on its way along one axis after the other."""
    at = share * len(_SLOW)
    leg = min(len(_SLOW) - 1, int(at))
    (axis, end), (before, begin) = _SLOW[leg], _SLOW[leg - 1] if leg else (0, 0.0)
    begin = begin if before == axis else 0.0
    # eased, so that no leg begins or ends with a jerk
    way = reach_m * (begin + (end - begin) * 0.5 * (1.0 - math.cos(math.pi * (at - leg))))
    return way * (axis == 0), way * (axis == 1), way * (axis == 2)
