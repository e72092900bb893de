"""What a recorded map under the tip means for the settings of the instrument: its guard, its cantilever, its words."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from services.afm_node.physics.cantilever import volts_per_m
from services.afm_node.physics.recorded_map import MapParams
from services.afm_node.physics.sample.force_map import SI_UNITS, ForceMap, map_params, read_map
from services.afm_node.programs.lateral import Place
from services.afm_node.safety import LIMITED_BY_RANGE, MODE_FOLLOW, SafetyOutputs, SafetyParams

if TYPE_CHECKING:
    from services.afm_node.config import _OwnSections

# A hand that trembles at the edge of a map is told of it once.
_QUIET_NS = 2_000_000_000


class MapEdge:
    """Keeps the tip on a recorded map in x and y, and says once that it was asked to go further.

    Args:
        places_m: How far from the middle the map goes in x and in y [m].
    """

    def __init__(self, places_m: tuple[float, float]) -> None:
        self._places_m = places_m
        self._reached_ns: int | None = None

    def kept(self, wanted: Place, allowed: SafetyOutputs, now_ns: int) -> tuple[Place, str]:
        """Return the place on the map that is next to the one wanted, and a sentence where there is one to say."""
        x_m, y_m = (min(max(at, -most), most) for at, most in zip(wanted, self._places_m, strict=True))
        is_outside = x_m != wanted.x_m or y_m != wanted.y_m
        if not is_outside and not (allowed.limited & LIMITED_BY_RANGE and allowed.mode == MODE_FOLLOW):
            return wanted, ""
        is_quiet = allowed.mode != MODE_FOLLOW or (
            self._reached_ns is not None and now_ns - self._reached_ns < _QUIET_NS
        )
        self._reached_ns = now_ns
        asked = (
            f"x = {wanted.x_m:.4g} m, y = {wanted.y_m:.4g} m" if is_outside else f"a base beyond {allowed.base_m:.4g} m"
        )
        text = f"the recorded map ends here, and the tip stays on it: it was asked to go to {asked}"
        return Place(x_m, y_m), "" if is_quiet else text


def require_feelable(config: "_OwnSections", path: str) -> None:
    """Raise ValueError where the settings and the map of an instrument contradict each other."""
    if config.driver != "simulated" or config.environment != "tip_sample" or config.model != "quasi_static":
        raise ValueError("sample.map is for driver simulated, environment tip_sample and model quasi_static")
    if config.friction.coefficient > 0.0:
        raise ValueError("sample.map has the forces that were recorded, and no friction besides")
    span, k = config.map_span, config.cantilever.stiffness_n_per_m
    if span is None:
        return
    given = span.stiffness_n_per_m and "stiffness_n_per_m" in config.cantilever.model_fields_set
    if given and not math.isclose(span.stiffness_n_per_m, k, rel_tol=1e-3):
        raise ValueError(
            f"cantilever.stiffness_n_per_m = {k:g} N/m contradicts sample.map {path}, which was measured with"
            f" {span.stiffness_n_per_m:g} N/m: leave it out"
        )
    if span.quantity != "force" and (config.feel is None or config.feel.channel != span.quantity):
        raise ValueError(
            f"sample.map {path} has {span.quantity} and no forces: feel.channel must be {span.quantity}, with the table"
            " that makes a force of it"
        )


def guard_of(config: "_OwnSections") -> SafetyParams:
    """Return the limits of the guard; over a recorded map the base has the range of the map and no more.

    Raises:
        ValueError: The base cannot be on the map; the message names the keys.
    """
    s, span, rest_m = config.safety, config.map_span, config.rest_distance_m
    limits = SafetyParams(**s.model_dump())
    if span is None:
        return limits
    given, low, high = s.model_fields_set, rest_m - span.high_m, rest_m - span.low_m
    low = max(low, s.base_min_m) if "base_min_m" in given else low
    high = min(high, s.base_max_m) if "base_max_m" in given else high
    retracted = s.retract_position_m if "retract_position_m" in given else low
    if not low <= retracted < high:
        raise ValueError(
            f"sample.map: with rest_distance_m = {rest_m:g} m the map is for a base from {rest_m - span.high_m:g} to"
            f" {rest_m - span.low_m:g} m, in which safety.base_min_m, base_max_m and retract_position_m ="
            f" {retracted:g} m leave the tip no way"
        )
    return limits._replace(base_min_m=low, base_max_m=high, retract_position_m=retracted)


def read_params(config: "_OwnSections") -> tuple[MapParams, ForceMap, str]:
    """Return what the instrument steps over, the map, and the map in words; ConfigError, if it cannot be used."""
    assert config.sample is not None and config.sample.map is not None
    path, c = Path(config.sample.map), config.cantilever
    found, digest = read_map(path)
    gain = volts_per_m(c.bridge_supply_v, c.amplifier_gain, c.sensitivity_per_m)
    params = map_params(found, config.rest_distance_m, c.stiffness_n_per_m, gain)
    limits, (x_m, y_m) = guard_of(config), config.places_m
    points, branches = " x ".join(map(str, found.values.shape[1:])), ("one branch", "approach and retract")
    text = (
        f"recorded map {path.name} ({digest}): {found.quantity} [{SI_UNITS[found.quantity]}], {points} points,"
        f" {branches[len(found.values) - 1]}; the tip stays within x ± {x_m:.3g} m, y ± {y_m:.3g} m and with its base"
        f" from {limits.base_min_m:.3g} to {limits.base_max_m:.3g} m"
    )
    return params, found, text
