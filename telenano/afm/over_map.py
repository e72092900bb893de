"""What an instrument steps over where a recorded map lies under its tip, and the map in words."""

from pathlib import Path

from telenano.afm.cantilever import volts_per_m
from telenano.afm.config import AfmConfig
from telenano.afm.recorded_map import MapParams
from telenano.afm.sample.force_map import SI_UNITS, ForceMap, map_params, read_map


def read_params(config: AfmConfig) -> tuple[MapParams, ForceMap, str]:
    """Return what the instrument steps over, the map, and the map in words; ConfigError, if it cannot be used."""
    assert config.sample is not None and config.sample.map is not None
    path, c = Path(config.sample.map), config.cantilever
    found, digest = read_map(path)
    gain = volts_per_m(c.bridge_supply_v, c.amplifier_gain, c.sensitivity_per_m)
    params = map_params(found, config.rest_distance_m, c.stiffness_n_per_m, gain)
    limits, (x_m, y_m) = config.to_guard(), config.places_m
    points, branches = " x ".join(map(str, found.values.shape[1:])), ("one branch", "approach and retract")
    text = (
        f"recorded map {path.name} ({digest}): {found.quantity} [{SI_UNITS[found.quantity]}], {points} points,"
        f" {branches[len(found.values) - 1]}; the tip stays within x ± {x_m:.3g} m, y ± {y_m:.3g} m and with its base"
        f" from {limits.base_min_m:.3g} to {limits.base_max_m:.3g} m"
    )
    return params, found, text
