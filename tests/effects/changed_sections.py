"""The keys of a scenario that a change touches: those whose schema differs, and those of changed models."""

import json
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

from changed_files import ROOT, base, changed, git
from key_effects import Leaf, leaves
from pydantic import BaseModel

from telenano.runtime.wiring.main import node_kind
from telenano.settings.scenario import Scenario
from telenano.wire.nodes import SERVICES

_SCHEMA = "telenano/settings/schemas/scenario.json"


def touched(every: list[Leaf]) -> list[Leaf]:
    """Return the keys that differ from those of the commit at which this branch left main, or whose model does."""
    if base() is None:
        return []
    files = {ROOT / name for name in changed()}
    schema = git("show", f"{base()}:{_SCHEMA}")
    before = {} if schema is None else {leaf.name: leaf.form for leaf in leaves(json.loads(schema))}
    own = {leaf.name for leaf in leaves(json.loads((ROOT / _SCHEMA).read_text("utf-8")))}
    sections = {path for path, file in files_of_sections() if file in files}
    return [
        leaf
        for leaf in every
        if (leaf.name in own and before and before.get(leaf.name) != leaf.form) or leaf.path[:-1] in sections
    ]


def files_of_sections() -> Iterator[tuple[tuple[str, ...], Path]]:
    """Yield each section of a scenario with the file that its model is written in."""
    yield from _files(Scenario, ())
    for name in SERVICES:
        yield from _files(node_kind(name).config, (name,))


def _files(model: type[BaseModel], path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Path]]:
    yield path, Path(str(sys.modules[model.__module__].__file__))
    for name, field in model.model_fields.items():
        for inner in _models(field.annotation):
            yield from _files(inner, (*path, field.alias or name))


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif not isinstance(annotation, Mapping):
        for part in get_args(annotation):
            yield from _models(part)
