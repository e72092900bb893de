"""All keys of a scenario with default, range and description, and the JSON Schemas of scenario and site files."""

import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, NamedTuple

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.wiring.main import node_kind
from telenano.settings.config import merge, read_yaml
from telenano.settings.included import scenarios
from telenano.settings.scenario import LoadedScenario, Scenario
from telenano.wire.errors import ConfigError, known_names
from telenano.wire.nodes import SERVICES

_KNOWN = re.compile(r"did you mean [^?]*\? Known are|known are")
_UNKNOWN = re.compile(r"(?:^|: )([^\s:]+): (?:unknown key|.+ has no key )")
# The last part of the key for each of the paper's symbols, as in docs/glossary.md.
_SYMBOLS = {
    "K_f": "force_gain",
    "M_v": "mass_kg",
    "B_v": "damping_n_s_per_m",
    "K_v": "stiffness_n_per_m",
    "alpha_p": "position_scale",
    "alpha_f": "force_scale",
    "α_p": "position_scale",
    "α_f": "force_scale",
    "b": "impedance_n_s_per_m",
    "T_s": "period_s",
}
# Greatest number of keys in a suggestion; a word such as `delay_s` is in three sections.
_MOST_MEANT = 4
_NEAR = 0.8
_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class Key(NamedTuple):
    """A key of a scenario; least and most are its bounds in the unit that `about` states, None without a bound."""

    name: str
    kind: str
    default: Any
    least: float | None
    most: float | None
    about: str


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario file, including the sections of all nodes."""
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
    # An entry may be a string, which is its only endpoint.
    nodes = schema["properties"]["nodes"]
    nodes["additionalProperties"] = {"anyOf": [nodes.get("additionalProperties", True), {"type": "string"}]}
    return {**schema, "$schema": _DIALECT, "title": "Site file of telenano"}


def all_keys() -> list[Key]:
    """Return every key of a scenario that has a value and not only further keys, in the order of the sections."""
    schema = scenario_schema()
    return list(_keys(schema, "", schema["$defs"]))


def first_keys(keys: Iterable[Key]) -> list[Key]:
    """Return the keys that people change first: those at the top of a section, and those in a packaged scenario."""
    changed = {name for path in scenarios().values() for name in _names(read_yaml(path))}
    return [key for key in keys if key.name.count(".") < 2 or key.name in changed]


def _names(document: Any, prefix: str = "") -> Iterator[str]:
    for name, value in document.items() if isinstance(document, Mapping) else ():
        yield f"{prefix}{name}"
        yield from _names(value, f"{prefix}{name}.")


def _keys(schema: Mapping[str, Any], prefix: str, definitions: Mapping[str, Any]) -> Iterator[Key]:
    for name, part in schema.get("properties", {}).items():
        resolved = _resolved(part, definitions)
        if resolved.get("properties"):
            yield from _keys(resolved, f"{prefix}{name}.", definitions)
        else:
            yield Key(
                f"{prefix}{name}",
                _kind(resolved),
                part.get("default", resolved.get("default")),
                _bound(resolved, ("minimum", "exclusiveMinimum")),
                _bound(resolved, ("maximum", "exclusiveMaximum")),
                part.get("description", resolved.get("description", "")),
            )


def _resolved(part: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    """Return a part of a schema with its references resolved; of alternatives, the first that is not null."""
    resolved: dict[str, Any] = dict(part)
    if "$ref" in resolved:
        return {**_resolved(definitions[resolved["$ref"].removeprefix("#/$defs/")], definitions), **resolved}
    if "anyOf" in resolved:
        choices = [_resolved(choice, definitions) for choice in resolved["anyOf"]]
        first = next((choice for choice in choices if choice.get("type") != "null"), {})
        return {**first, **resolved, "type": " or ".join(_kind(choice) for choice in choices)}
    return resolved


def _kind(part: Mapping[str, Any]) -> str:
    if "enum" in part:
        return ", ".join(map(str, part["enum"]))
    if "oneOf" in part:
        return "one of several models, by kind"
    return str(part.get("const", part.get("type", "any")))


def _bound(part: Mapping[str, Any], names: tuple[str, str]) -> float | None:
    return next((part[name] for name in names if name in part), None)


def filled(loaded: LoadedScenario) -> dict[str, Any]:
    """Return a scenario with all defaults filled in; ConfigError names file and key at fault."""
    sections = {
        name: loaded.section(name, node_kind(name).config).model_dump(mode="json", exclude_none=True)
        for name in SERVICES
    }
    return merge(loaded.scenario.model_dump(mode="json"), sections)


def with_meant(line: str) -> str:
    """Return the line of an error with a suggestion from all sections for the key that it calls unknown.

    The line is returned unchanged if it names no unknown key or none is similar.
    """
    unknown = _UNKNOWN.search(line)
    if unknown is None:
        return line
    section, _, last = unknown[1].rpartition(".")
    # Listing all keys takes most of a second, so it is done only for an unknown key.
    parts = [key.name.split(".") for key in all_keys()]
    names = list(dict.fromkeys(".".join(each[:count]) for each in parts for count in range(2, len(each) + 1)))
    word = _SYMBOLS.get(last, last)
    words = [name.rpartition(".")[2] for name in names]
    if word not in words:
        if "did you mean" in line:
            return line
        word = next(iter(get_close_matches(word, set(words), n=1, cutoff=_NEAR)), "")
    endings = [name for name, ending in zip(names, words, strict=True) if ending == word]
    inner = [name for name in endings if section and name.startswith(f"{section.partition('.')[0]}.")]
    meant = " or ".join((inner or endings)[:_MOST_MEANT])
    if not meant:
        return line
    text, count = _KNOWN.subn(lambda _: f"did you mean {meant}? Known are", line, count=1)
    return text if count else f"{line}; did you mean {meant}?"


def keys_named(word: str) -> list[str]:
    """Return the keys whose last part contains a word or a symbol of the paper, as `force_gain` contains `gain`.

    Keys that people change first are preferred, then exact matches, then matches at the end.
    """
    word = _SYMBOLS.get(word, word.replace("-", "_").lower())
    keys = all_keys()
    for among in (first_keys(keys), keys):
        endings = {key.name: f"_{key.name.rpartition('.')[2]}_" for key in among}
        exact = [name for name, end in endings.items() if end == f"_{word}_"]
        last = [name for name, end in endings.items() if end.endswith(f"_{word}_")]
        if found := exact or last or [name for name, end in endings.items() if f"_{word}_" in end]:
            return found
    return []


def value_at(document: Mapping[str, Any], key: str, whole: str = "the scenario") -> Any:
    """Return the value of a dotted key; ConfigError lists the known keys at the point where it is wrong.

    Args:
        document: The keys with their values.
        key: The dotted key.
        whole: What an error calls the document.
    """
    value: Any = document
    seen: list[str] = []
    for part in key.split("."):
        if isinstance(value, list) and part.isdecimal() and int(part) < len(value):
            value = value[int(part)]
        elif isinstance(value, Mapping) and part in value:
            value = value[part]
        else:
            if isinstance(value, Mapping) or len(seen) < 2:
                names = known_names(part, value if isinstance(value, Mapping) else document)
                raise ConfigError(f"{key}: {'.'.join(seen) or whole} has no key {part}; {names}")
            names = known_names(part, value_at(document, ".".join(seen[:-1]), whole))
            raise ConfigError(f"{key}: {'.'.join(seen)} is {value!r} and has no keys; {names} in {'.'.join(seen[:-1])}")
        seen.append(part)
    return value
