"""Layers on a sample, such as particles, that the tip meets; packages bring them (entry points `telenano.samples`).

A layer is a part around the tip over the surface (`part`). It has settings, the section of its name in
`afm_node.sample`, and a state of its own. It may hold the tip up or push it aside, and change the measurement:

    DUST = Layer("dust", DustConfig, lambda settings: Height(1e-8, 1e-7, "the dust"), dust_around)

The *truth* of a layer is the part of its state that no instrument can measure, such as the true places of its grains:
`Part.truths` gives it by the name of the layer, and `fields` makes a message of it for recordings, which no planner
reads.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from telenano.afm.sample.surface import Surface
from telenano.extend.samples import SampleModel


class Ground(NamedTuple):
    """The surface under a layer, and the tip and cantilever over it.

    surface: as the sphere of the tip sees it, a plane at height 0 where is_plane; sides_m: its width and depth [m];
    tip_radius_m: radius of the apex [m]; stiffness_n_per_m, lateral_n_per_m: stiffness of the cantilever along z and
    across [N/m]; rest_distance_m: distance of the tip without force, with the base at 0 [m]; volts_per_m: gain of the
    read-out [V/m].
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
    """Height of a layer above the surface, least height of a retracted tip [m], and the name of what it must clear."""

    height_m: float
    clear_m: float
    what: str


@dataclass(frozen=True)
class Layer:
    """A layer on a sample.

    Args:
        name: The name of its section in `afm_node.sample`.
        config: The model of that section, a class of `telenano.settings.Settings`.
        height: Function from the settings to the height of the layer above the surface.
        around: Function from the settings, the parameters of the inner part and the ground to the parameters of the
            layer around that part. The layer's own part must be registered before (`part.register_part`). It raises
            ValueError that names the key at fault.
        topic: The topic on which its truth is published for recordings, often while it changes; empty for none.
        fields: Function from its truth to the fields of the message.
        changes: Function from its truth to whether it is changing.
    """

    name: str
    config: type[Any]
    height: Callable[[Any], Height]
    around: Callable[[Any, Any, Ground], Any]
    topic: str = ""
    fields: Callable[[Any], Mapping[str, Any]] = lambda truth: {}
    changes: Callable[[Any], bool] = lambda truth: False


def checked_layer(name: str, value: Any) -> Layer | None:
    """Return the layer of an entry point; None if it is a whole sample.

    `name` is the name of the entry point, which the layer must have too.

    Raises:
        TypeError, ValueError: It is neither, or has another name; the message says so.
    """
    if isinstance(value, SampleModel):
        return None
    if not isinstance(value, Layer):
        raise TypeError(f"is a {type(value).__name__}, must be a SampleModel or a Layer")
    if value.name != name:
        raise ValueError(f"is registered under another name than its own, {value.name}")
    return value
