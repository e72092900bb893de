"""The sample under the tip (section `afm_node.sample`): a computed shape, a file, or a function of the user's."""

import importlib
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, create_model, model_validator

from telenano.afm.layers import Layer, checked_layer
from telenano.afm.sample.surface import MOST_PIXELS, SHAPES, Surface, centred, checked, plane_levelled
from telenano.extend.maps import Span
from telenano.sections.sample_maps import span_of
from telenano.sections.surface_files import read_surface
from telenano.settings.config import Settings, keys_of, refused_code, section_of
from telenano.settings.entries import Entries
from telenano.settings.known_packages import where_it_is
from telenano.wire.errors import ConfigError, described

_LEVELS: dict[str, Callable[[Surface], Surface]] = {
    "centre": centred,
    "plane": plane_levelled,
    "absolute": lambda surface: surface,
}
_LEVELLED = {
    "centre": "its heights are shifted so that its middle is at 0",
    "plane": "its mean plane is subtracted",
    "absolute": "its heights are those of the file",
}
Length = Annotated[float, Field(ge=1e-9, le=1e-3)]


class _OwnSample(Settings):
    """The keys of section `sample` that need no package; no layer may be named like one."""

    model_config = ConfigDict(serialize_by_alias=True)

    name: str = Field(
        "dots",
        min_length=1,
        description=f"{', '.join(SHAPES)}, a file (.gsf, .npy; others by the readers of packages), or module:function"
        " of x and y [m], which only `--allow-code` runs.",
    )
    map: str | None = Field(
        None,
        min_length=1,
        description="A recorded map to feel instead of a surface: a .npz from `telenano sample import`; it excludes "
        "all other keys.",
    )
    size_m: Length | None = Field(
        None,
        description="Side of the square [m], 1e-9 to 1e-3; default 150e-9. Files other than .npy have a size of their "
        "own.",
    )
    pixels: int = Field(512, ge=2, le=MOST_PIXELS, description="Heights along a side of a computed sample.")
    channel: str | None = Field(None, description="Part of the name of one channel of a file; default: its height.")
    level: Literal["centre", "plane", "absolute"] = Field(
        "centre",
        description="Level of a file's heights. centre: the height in the middle becomes 0, as after an approach there;"
        " plane: the mean plane is subtracted; absolute: as in the file.",
    )
    seed: int = Field(0, ge=0, description="Seed of the places of the dots.")
    dot_count: int = Field(12, ge=1, le=10_000, description="Number of dots.")
    dot_radius_m: Length = Field(5e-9, description="Radius of a dot at its foot [m].")
    height_m: float = Field(10e-9, ge=0.0, le=1e-4, description="Height of a dot or of a ridge [m].")
    period_m: Length = Field(50e-9, description="Period of the grating [m].")

    @model_validator(mode="before")
    @classmethod
    def _layers_are_here(cls, value: Any) -> Any:
        for key, section in value.items() if isinstance(value, Mapping) else ():
            if section is not None and key not in keys_of(cls) and (hint := where_it_is(f"layer {key}")):
                raise ValueError(hint)
        return value

    @model_validator(mode="after")
    def _size_where_needed(self) -> Self:
        if self.map is not None and (others := self.model_fields_set - {"map"}):
            raise ValueError(f"map: {self.map} describes the whole sample; leave out {', '.join(sorted(others))}")
        if not self.is_file and "level" in self.model_fields_set:
            raise ValueError(f"level: is for files; {self.name} has heights of its own")
        if not self.is_file and self.channel is not None:
            raise ValueError(f"channel: is for files; {self.name} has one height and no channels")
        return self

    @property
    def is_file(self) -> bool:
        return self.name not in SHAPES and ":" not in self.name

    @property
    def levelled(self) -> str:
        """How the heights of a file are levelled, in words; empty for a sample that is no file."""
        return _LEVELLED[self.level] if self.is_file else ""

    @property
    def map_span(self) -> Span | None:
        """Extent, stiffness and quantity of the recorded map; None without one, or if it cannot be read here."""
        return None if self.map is None else span_of(Path(self.map))

    def build(self) -> Surface:
        """Return the surface.

        Raises:
            ConfigError: The sample cannot be made; the message names it and what is wrong with it.
        """
        if self.map is not None:
            raise ConfigError(f"sample.map {self.map}: a recorded map has no surface to image; it can be felt on a rig")
        if self.is_file:
            return _LEVELS[self.level](read_surface(Path(self.name), self.channel, self.size_m))
        size_m = 150e-9 if self.size_m is None else self.size_m
        try:
            if shape := SHAPES.get(self.name):
                keys = {key: getattr(self, key) for key in signature(shape).parameters}
                return shape(**{**keys, "size_m": size_m})
            return checked(self._computed(size_m), size_m, size_m)
        except ValueError as error:
            raise ConfigError(f"sample {self.name}: {error}") from error

    def _computed(self, size_m: float) -> Any:
        """Return the heights [m] from one call of the user's function with all x (a row) and all y (a column) [m]."""
        if text := refused_code("sample.name", self.name):
            raise ConfigError(text)
        module, _, name = self.name.partition(":")
        try:
            function: Callable[..., Any] = getattr(importlib.import_module(module), name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(f"has no such function: {error}; write module:function, on Python's path") from error
        middles = (np.arange(self.pixels) + 0.5) * (size_m / self.pixels)
        try:
            heights = np.asarray(function(middles[None, :], middles[:, None]), dtype=np.float64)
            return np.broadcast_to(heights, (self.pixels, self.pixels))
        # The user's function may raise anything.
        except Exception as error:
            raise ValueError(f"failed for arrays of x and y in m: {described(error)}") from error


# a layer may not use the keys of the section
TAKEN = frozenset(_OwnSample.model_fields)
LAYERS = Entries("samples", "layer", checked_layer, TAKEN)

if TYPE_CHECKING:

    class _LayerSections(_OwnSample):
        """The sections of layers."""

else:
    _LayerSections = create_model("_LayerSections", __base__=_OwnSample, **LAYERS.sections())


class SampleConfig(_LayerSections):
    """The surface under the tip. Every default is that of Fig. 8 of the paper, or our own where it gives none."""

    def layer(self, name: str) -> Any:
        """Return the settings of a layer that lies on the sample, None where it does not: `sample.layer("particles")`.

        Raises:
            AttributeError: No installed package has a layer of that name.
        """
        return section_of(self, name)


def layers_on(sample: SampleConfig | None) -> list[tuple[Layer, Any]]:
    """Return the layers that lie on a sample, from below upwards, with the settings of each."""
    sections = [(name, None if sample is None else sample.layer(name)) for name in LAYERS.names]
    layers = [(LAYERS.find(name), settings) for name, settings in sections if settings is not None]
    return [(layer, settings) for layer, settings in layers if layer is not None]
