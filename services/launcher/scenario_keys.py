"""Every key of a scenario with its default, range and unit, and the JSON Schema of scenario and site files."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from presets import scenarios
from proto.errors import ConfigError, known_names
from proto.nodes import SERVICES
from services.runtime.bus.address_book import AddressBook
from services.runtime.settings.config import merge, read_yaml
from services.runtime.settings.scenario import LoadedScenario, Scenario
from services.runtime.wiring.main import node_kind

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class Key(NamedTuple):
    """A key of a scenario; least and most are bounds in the unit that `about` names, None where there is none."""

    name: str
    kind: str
    default: Any
    least: float | None
    most: float | None
    about: str


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario file, the sections of all nodes included."""
    schema = Scenario.model_json_schema()
    definitions: dict[str, Any] = dict(schema.pop("$defs", {}))
    for name in SERVICES:
        section = node_kind(name).config.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
        definitions |= {f"{name}.{key}": part for key, part in section.pop("$defs", {}).items()}
        about = schema["properties"][name].get("description", "")
        schema["properties"][name] = {**section, "description": about}
    head = {"$schema": _DIALECT, "title": "Scenario of telenano", "description": "An experiment: one section a node"}
    return {**schema, **head, "$defs": dict(sorted(definitions.items()))}


def site_schema() -> dict[str, Any]:
    """Return the JSON Schema of a site file."""
    schema = AddressBook.model_json_schema()
    # an entry may be given as its only endpoint
    nodes = schema["properties"]["nodes"]
    nodes["additionalProperties"] = {"anyOf": [nodes.get("additionalProperties", True), {"type": "string"}]}
    return {**schema, "$schema": _DIALECT, "title": "Site file of telenano"}


def all_keys() -> list[Key]:
    """Return every key of a scenario that has a value of its own, in the order of its sections."""
    schema = scenario_schema()
    return list(_keys(schema, "", schema["$defs"]))


def first_keys(keys: Iterable[Key]) -> list[Key]:
    """Return the keys that people change first: those at the top of a section, and what a packaged scenario changes."""
    changed = {name for path in scenarios().values() for name in _names(read_yaml(path))}
    return [key for key in keys if key.name.count(".") < 2 or key.name in changed]


def _names(document: Any, prefix: str = "") -> Iterator[str]:
    for name, value in document.items() if isinstance(document, Mapping) else ():
        yield f"{prefix}{name}"
        yield from _names(value, f"{prefix}{name}.")


def _keys(schema: Mapping[str, Any], prefix: str, definitions: Mapping[str, Any]) -> Iterator[Key]:
    for name, part in schema.get("properties", {}).items():
        found = _resolved(part, definitions)
        if found.get("properties"):
            yield from _keys(found, f"{prefix}{name}.", definitions)
        else:
            yield Key(
                f"{prefix}{name}",
                _kind(found),
                part.get("default", found.get("default")),
                _bound(found, ("minimum", "exclusiveMinimum")),
                _bound(found, ("maximum", "exclusiveMaximum")),
                part.get("description", found.get("description", "")),
            )


def _resolved(part: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return a part with what it refers to; of alternatives that with a model, or the first that is not null."""
    found: dict[str, Any] = dict(part)
    if "$ref" in found:
        return {**_resolved(definitions[found["$ref"].removeprefix("#/$defs/")], definitions), **found}
    if "anyOf" in found:
        choices = [_resolved(choice, definitions) for choice in found["anyOf"]]
        first = next((choice for choice in choices if choice.get("type") != "null"), {})
        return {**first, **found, "type": " or ".join(_kind(choice) for choice in choices)}
    return found


def _kind(part: Mapping[str, Any]) -> str:
    if "enum" in part:
        return ", ".join(map(str, part["enum"]))
    if "oneOf" in part:
        return "one of several models, by kind"
    return str(part.get("const", part.get("type", "any")))


def _bound(part: Mapping[str, Any], names: tuple[str, str]) -> float | None:
    return next((part[name] for name in names if name in part), None)


def filled(loaded: LoadedScenario) -> dict[str, Any]:
    """Return a scenario with every default in it; ConfigError names file and key at fault."""
    sections = {
        name: loaded.section(name, node_kind(name).config).model_dump(mode="json", exclude_none=True)
        for name in SERVICES
    }
    return merge(loaded.scenario.model_dump(mode="json"), sections)


def value_at(document: Mapping[str, Any], key: str) -> Any:
    """Return what a dotted key has; ConfigError names the keys that there are at the point where it is wrong."""
    value: Any = document
    seen: list[str] = []
    for part in key.split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, Mapping) and part in value:
            value = value[part]
        else:
            if isinstance(value, Mapping) or len(seen) < 2:
                known = known_names(part, value if isinstance(value, Mapping) else document)
                raise ConfigError(f"{key}: {'.'.join(seen) or 'the scenario'} has no key {part}; {known}")
            known = known_names(part, value_at(document, ".".join(seen[:-1])))
            raise ConfigError(f"{key}: {'.'.join(seen)} is {value!r} and has no keys; in {'.'.join(seen[:-1])} {known}")
        seen.append(part)
    return value
