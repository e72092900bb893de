"""What lies on a sample and a tip meets there: layers, which packages bring (entry points `telenano.layers`).

A layer is a part around the tip over the surface (`part`). It has settings, the section of its name in
`afm_node.sample`, and a state of its own. It may hold the tip up or push it aside, and change what is measured:

    DUST = Layer("dust", DustConfig, lambda settings: Height(1e-8, 1e-7, "the dust"), dust_around)

What is so in it and no instrument knows, such as where its grains really are, is its *truth*: `Part.truths` of its part
gives it by the name of the layer, and `fields` makes a message of it for recordings, which no planner reads.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from telenano.afm.sample.surface import Surface


class Ground(NamedTuple):
    """What a layer lies on, and what is over it.

    surface: as the sphere of the tip sees it, a plane at height 0 where is_plane; sides_m: width and depth [m];
    tip_radius_m: of its apex [m]; stiffness_n_per_m, lateral_n_per_m: of the cantilever along z and across [N/m];
    rest_distance_m: of the tip without force, with the base at 0 [m]; volts_per_m: of its read-out [V/m].
    """

    surface: Surface
    is_plane: bool
    sides_m: tuple[float, float]
    tip_radius_m: float
    stiffness_n_per_m: float
    lateral_n_per_m: float
    rest_distance_m: float
    volts_per_m: float


class Height(NamedTuple):
    """How far a layer stands above the surface, and how high a retracted tip has to be [m]; in words what it clears."""

    height_m: float
    clear_m: float
    what: str


@dataclass(frozen=True)
class Layer:
    """What lies on a sample.

    Args:
        name: The name of its section in `afm_node.sample`.
        config: The model of that section, a class of `telenano.settings.Settings`.
        height: Returns, of the settings, how far it stands above the surface.
        around: Returns, of settings, the parameters of a part and the ground under it, those of the layer around that
            part; it registers its own part (`part.register_part`) before. ValueError names the key at fault.
        topic: The topic on which its truth is published for recordings, often while it changes; empty for none.
        fields: Returns, of its truth, the fields of the message.
        changes: Returns whether its truth changes.
    """

    name: str
    config: type[Any]
    height: Callable[[Any], Height]
    around: Callable[[Any, Any, Ground], Any]
    topic: str = ""
    fields: Callable[[Any], Mapping[str, Any]] = lambda truth: {}
    changes: Callable[[Any], bool] = lambda truth: False


def checked_layer(name: str, value: Any) -> Layer:
    """Return the layer that an entry of a package is; TypeError or ValueError says what is wrong with it."""
    if not isinstance(value, Layer):
        raise TypeError(f"is a {type(value).__name__}, must be a Layer")
    if value.name != name:
        raise ValueError(f"calls itself {value.name}")
    return value
