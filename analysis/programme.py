"""The holds that the operator's programme of a scenario has, whether or not a recording shows them."""

from itertools import pairwise

from analysis.holds import SHORTEST_HOLD_S
from services.haptic_node.config import HapticConfig
from services.haptic_node.operator_config import ForceProfileConfig, InteractiveConfig
from services.runtime.settings.config import validate
from services.runtime.settings.scenario import Scenario


def planned_holds(scenario: Scenario, end_s: float) -> list[tuple[float, float, float]]:
    """Return start [s], end [s] and force [N] of each stretch of constant force up to an end [s].

    Only a hand that is a force has them in its programme: what an arm or a person presses with is known from what was
    recorded alone.

    Raises:
        ConfigError: A key of the scenario cannot be read; the message names it.
    """
    operator = validate(HapticConfig, scenario.haptic_node, "scenario.yaml", "haptic_node").operator
    if not isinstance(operator, ForceProfileConfig):
        return []
    corners = [(point.time_s, point.force_n) for point in operator.points]
    # The force is zero before the first corner, and stays at the last one.
    corners = [(min(0.0, corners[0][0]), 0.0), (corners[0][0], 0.0), *corners]
    corners.append((max(end_s, corners[-1][0]), corners[-1][1]))
    holds: list[tuple[float, float, float]] = []
    for (first_s, force_n), (last_s, then_n) in pairwise(corners):
        if force_n != then_n:
            continue
        if holds and holds[-1][1] == first_s and holds[-1][2] == force_n:
            first_s = holds.pop()[0]
        holds.append((first_s, last_s, force_n))
    cut = [(max(0.0, first_s), min(last_s, end_s), force_n) for first_s, last_s, force_n in holds]
    return [hold for hold in cut if hold[1] - hold[0] >= SHORTEST_HOLD_S]


def is_by_hand(scenario: Scenario) -> bool:
    """Return whether a person presses, at a page or at a device, whose hand gives way to what the loop does.

    Raises:
        ConfigError: A key of the scenario cannot be read; the message names it.
    """
    config = validate(HapticConfig, scenario.haptic_node, "scenario.yaml", "haptic_node")
    return isinstance(config.operator, InteractiveConfig) or not config.simulated
