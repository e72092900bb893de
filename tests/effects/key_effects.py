"""Every key of a scenario, other values that it may have, and the sessions in which it can have an effect.

    for leaf in leaves(scenario_schema()):
        found = effect_of(leaf)

A key is changed in the session that its place in the schema asks for: its section is switched on, and the choice that
has the name of its section is made. Then in those that differ by one choice beside it, or have a value beside it that
is empty by default. `sessions_of` has the sessions of keys that act in other circumstances.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from circumstances import SESSIONS, VALUES
from compared_sessions import FilesSeen, Seen, Session, seen
from pydantic import ValidationError

from telenano.settings.config import merge
from telenano.wire.errors import ConfigError

Path = tuple[str, ...]
# Choices of one key that are tried as the circumstance of another.
_MOST_CHOICES = 6


@dataclass(frozen=True)
class Leaf:
    """A key that has a value of its own.

    Attributes:
        path: Its name by sections.
        form: What the schema says of its value.
        default: Its value where it is not given.
        kinds: The sections above it that are one of several models, by what selects that.
    """

    path: Path
    form: Mapping[str, Any]
    default: Any
    kinds: tuple[tuple[Path, Mapping[str, Any]], ...] = ()

    @property
    def name(self) -> str:
        """Its dotted name, in which the kind of a model stands in brackets."""
        of_kind = {path: form["kind"] for path, form in self.kinds}
        parts = [
            self.path[n] + (f"[{of_kind[up]}]" if (up := self.path[: n + 1]) in of_kind else "")
            for n in range(len(self.path))
        ]
        return ".".join(parts)

    def choices(self) -> list[Any]:
        """Return all values of a key that has a few."""
        return choices_of(self.form)


def leaves(schema: Mapping[str, Any]) -> list[Leaf]:
    """Return every key of a scenario, those of each kind of a model included."""
    return list(_leaves(schema, (), (), schema["$defs"]))


def _leaves(
    section: Mapping[str, Any], above: Path, kinds: tuple[Any, ...], definitions: Mapping[str, Any]
) -> Iterator[Leaf]:
    for name, part in section.get("properties", {}).items():
        path = (*above, name)
        form = _resolved(part, definitions)
        if "oneOf" in form:
            for choice in form["oneOf"]:
                model = _resolved(choice, definitions)
                kind = model["properties"]["kind"]["const"]
                of_kind = {"kind": kind} | {
                    key: [
                        _point(_resolved(model["properties"][key], definitions), definitions, at)
                        for at in (0.05, 0.15, 0.5)
                    ]
                    for key in model.get("required", ())
                    if key != "kind"
                }
                yield from _leaves(model, path, (*kinds, (path, of_kind)), definitions)
        elif form.get("properties"):
            yield from _leaves(form, path, kinds, definitions)
        elif "const" not in form:
            yield Leaf(path, form, part.get("default", form.get("default")), kinds)


def _point(form: Mapping[str, Any], definitions: Mapping[str, Any], time_s: float) -> dict[str, float]:
    """Return a corner of a course, such as a force at a time."""
    keys = _resolved(form["items"], definitions)["properties"]
    return {
        key: time_s if key == "time_s" else 2.0 * (time_s > 0.1) * (1.0 if key == "force_n" else 1e-3) for key in keys
    }


def _resolved(part: Mapping[str, Any], definitions: Mapping[str, Any]) -> dict[str, Any]:
    form = dict(part)
    if "$ref" in form:
        return {**_resolved(definitions[form["$ref"].removeprefix("#/$defs/")], definitions), **form}
    if "anyOf" in form:
        parts = [_resolved(choice, definitions) for choice in form["anyOf"]]
        known = [choice for choice in parts if choice.get("type") != "null"]
        return {**known[0], **form, "parts": known}
    return form


def choices_of(form: Mapping[str, Any]) -> list[Any]:
    """Return all values of a form that has a few, empty for one that has many."""
    if form.get("type") == "boolean":
        return [False, True]
    return list(form.get("enum", ()))


def other_values(leaf: Leaf) -> list[Any]:
    """Return values that a key may have and that differ from its default."""
    found = [value for pattern, values in VALUES.items() if fits(leaf, pattern) for value in values]
    if not found:
        found = leaf.choices()
    if not found and leaf.form.get("type") == "string":
        found = ["other"]
    if not found and leaf.form.get("type") in ("number", "integer"):
        found = list(_numbers(leaf.form, leaf.default))
    return [value for value in found if value != leaf.default or type(value) is not type(leaf.default)]


def _numbers(form: Mapping[str, Any], default: float | None) -> Iterator[float]:
    """Yield numbers within the bounds of a form: beside its default, far from it, and at the ends of its range."""
    least = form.get("minimum", form.get("exclusiveMinimum", -1e3))
    most = form.get("maximum", form.get("exclusiveMaximum", 1e3))
    middle = math.sqrt(least * most) if least > 0.0 else 0.5 * (least + most)
    near = [default * factor for factor in (1.5, 0.4)] if default else []
    for value in (*near, least, most, middle):
        is_in = form.get("exclusiveMinimum", -math.inf) < value < form.get("exclusiveMaximum", math.inf)
        if is_in and least <= value <= most:
            yield round(value) if form["type"] == "integer" else float(value)


def fits(leaf: Leaf, pattern: str) -> bool:
    """Return whether a key has a name, in which `*` stands for one section and `**` at the end for all below."""
    wanted, parts = pattern.split("."), leaf.name.split(".")
    if wanted[-1] == "**":
        wanted, parts = wanted[:-1], parts[: len(wanted) - 1]
    return len(wanted) == len(parts) and all(one in ("*", part) for one, part in zip(wanted, parts, strict=True))


def nested(path: Path, value: Any) -> dict[str, Any]:
    """Return a value as the document in which it stands at a path."""
    for name in reversed(path):
        value = {name: value}
    return value  # type: ignore[no-any-return]


def asked_by(leaf: Leaf, every: Mapping[Path, list[Leaf]]) -> dict[str, Any]:
    """Return what the place of a key asks for: its sections switched on, and chosen where a choice has their name."""
    settings: dict[str, Any] = {}
    for depth in range(1, len(leaf.path)):
        section = leaf.path[:depth]
        for one in every.get(section[:-1], ()):
            if section[-1] in one.choices() and one.path != leaf.path:
                settings = merge(settings, nested(one.path, section[-1]))
        for one in every.get(section, ()):
            if one.path[-1] == "enabled" and one.path != leaf.path:
                settings = merge(settings, nested(one.path, True))
    for path, of_kind in leaf.kinds:
        settings = merge(settings, nested(path, of_kind))
    return settings


def bases_of(leaf: Leaf) -> list[Session]:
    """Return the sessions that are known for a key, else the usual one."""
    return [session for pattern, session in SESSIONS if fits(leaf, pattern)] or [Session()]


def circumstances(leaf: Leaf, every: Mapping[Path, list[Leaf]]) -> Iterator[Session]:
    """Yield sessions in which a key may have an effect."""
    bases = bases_of(leaf)
    asked = asked_by(leaf, every)
    for base in bases:
        yield replace(base, settings=merge(asked, dict(base.settings)))
    for one in every.get(leaf.path[:-1], ()):
        if one.path == leaf.path:
            continue
        values = one.choices()[:_MOST_CHOICES] or ([] if one.default else other_values(one)[:1])
        for value in values:
            if value != one.default:
                beside = merge(asked, dict(bases[0].settings), nested(one.path, value))
                yield replace(bases[0], settings=beside)


@cache
def _seen_of(session: str) -> Seen | FilesSeen | None:
    """Return what is seen of a session, None if its settings cannot be used."""
    try:
        return seen(_sessions[session])
    except (ConfigError, ValidationError):
        return None


# The sessions by what they are made of, because their settings cannot be hashed.
_sessions: dict[str, Session] = {}


def effect_of(leaf: Leaf, every: Mapping[Path, list[Leaf]], *, bases_only: bool = False) -> str:
    """Return what is seen to change by another value of a key, empty if nothing is.

    Args:
        leaf: The key.
        every: All keys, by section.
        bases_only: Whether only the sessions are tried that are known for the key.
    """
    refused = ""
    for number, session in enumerate(circumstances(leaf, every)):
        if (refused or bases_only) and number >= len(bases_of(leaf)):
            break
        _sessions[name := repr(session)] = session
        if (before := _seen_of(name)) is None:
            continue
        for value in other_values(leaf):
            changed = nested(leaf.path, value)
            try:
                difference = before.difference(changed)
            except (ConfigError, ValidationError) as error:
                if not refused and is_usable(before, nested(leaf.path[:-1], {})):
                    refused = f"refused: {str(error).splitlines()[0]}"
                continue
            if difference:
                return difference
    return refused


def is_usable(before: Seen | FilesSeen, settings: Mapping[str, Any]) -> bool:
    """Return whether a session can have these settings.

    If it cannot have the section of a key without the key either, then it is no value that is refused: the session
    lacks what the section needs.
    """
    try:
        before.difference(settings)
    except (ConfigError, ValidationError):
        return False
    return True


def by_section(found: list[Leaf]) -> dict[Path, list[Leaf]]:
    """Return the keys by the section that they stand in."""
    sections: dict[Path, list[Leaf]] = {}
    for leaf in found:
        sections.setdefault(leaf.path[:-1], []).append(leaf)
    return sections
