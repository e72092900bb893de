"""Recorded maps that a rig feels: what a map is, whether it can be felt, and its file."""

from services.afm_node.physics.sample.force_map import (
    MEMBERS,
    SI_UNITS,
    UNITS,
    Array,
    ForceMap,
    MapError,
    checked_map,
    gates,
    read_members,
    write_map,
)

__all__ = [
    "MEMBERS",
    "SI_UNITS",
    "UNITS",
    "Array",
    "ForceMap",
    "MapError",
    "checked_map",
    "gates",
    "read_members",
    "write_map",
]
