"""What a recorded map under the tip means for the settings of the instrument: its guard, its cantilever, its words."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from telenano.afm.cantilever import volts_per_m
from telenano.afm.recorded_map import MapParams
from telenano.afm.safety import SafetyParams
from telenano.afm.sample.force_map import SI_UNITS, ForceMap, map_params, read_map

if TYPE_CHECKING:
    from telenano.afm.config import _OwnSections


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
