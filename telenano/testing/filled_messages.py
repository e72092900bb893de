"""Examples of each message, by test case: least and greatest values, empty fields, unusual characters.

They are made from the schemas, so new fields are filled too.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import cycle
from typing import Any

import msgpack
import msgspec
import numpy as np

from telenano.wire.codec import WireError, decode, fields_of
from telenano.wire.messages import Array, Message, SessionControl
from telenano.wire.schema import json_schema
from telenano.wire.topics import Topic

WITH_OPTIONAL = "_with_optional_keys"


# Values of strings with a pattern, which the text of a case would not match.
_PATTERNED = {"id": "7f3a-01", "law": "virtual_impedance", "public_key": "07" * 32, "answers": "a9" * 32}


_ELEMENT_TYPES = ("f8", "u1", "i2", "i4", "f4")


# The least positive integer that a reader changes if it stores integers as doubles.
_BEYOND_DOUBLE = 2**53 + 1


@dataclass(frozen=True)
class Case:
    """The values with which the fields of one example are filled.

    `end`: integers get the lowest (0), a large odd (1) or the highest (2) allowed value. `numbers` are used for floats
    in turn; if there are none, each float gets the lowest (`end` 0) or the highest value of its range. `choice` selects
    among words and element types. `filled`: whether maps, lists, arrays and optional parts have content.
    """

    name: str
    end: int
    numbers: tuple[float, ...]
    text: str
    choice: int
    flag: bool
    filled: bool


CASES = (
    Case("minimal", 0, (0.0,), "", 0, False, False),
    Case("ordinary", 1, (0.00703, -1.25e-9, 1.0), "gap closed", 1, True, True),
    Case("greatest", 2, (sys.float_info.max, -sys.float_info.max), "x" * 64, 2, True, True),
    Case("least", 0, (sys.float_info.min, -5e-324, 5e-324), " ", 3, False, True),
    Case("negative_zero", 1, (-0.0,), "-0", 4, True, True),
    Case("unicode", 1, (0.1, -2.0 / 3.0), 'Ångström µN 力 🔬 \u0000\n"', 5, False, True),
    Case("nil", 1, (2.5e-10, -1e-3), "nil", 6, True, False),
    # The ends of the ranges; `greatest` lies beyond them, and tests the numbers themselves.
    Case("highest", 2, (), "highest", 7, True, True),
    Case("lowest", 0, (), "lowest", 8, False, True),
)


def schema_of(topic: Topic) -> dict[str, Any]:
    """Return the JSON Schema of a topic's message; `x-topic` and `x-version` are its topic and version."""
    schema = json_schema(topic.model)
    schema["properties"]["v"]["maximum"] = topic.model.version
    if topic.model is not SessionControl:
        # A reader ignores unknown keys, except that a command with one is refused.
        for record in (schema, *schema.get("$defs", {}).values()):
            record.pop("additionalProperties")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "x-topic": topic.name,
        "x-version": topic.model.version,
        **schema,
    }


@cache
def examples(topic: Topic) -> Mapping[str, Message]:
    """Return one valid message per case, by the name of the case; the same ones every time.

    If the message has optional keys, there is each case without them, and another one with all of them.
    """
    schema = json_schema(topic.model)
    sets = {"": schema["required"]}
    if has_optional_keys(topic):
        sets[WITH_OPTIONAL] = list(schema["properties"])
    made = {}
    for suffix, keys in sets.items():
        for case in CASES:
            fields = _Filler(topic, schema.get("$defs", {}), case).fill(schema, keys)
            try:
                made[case.name + suffix] = decode(topic.name, msgpack.packb(fields))
            except WireError as error:
                raise TypeError(
                    f"no example can be made of {topic.model.__name__}: {error}. A measured number has a range of "
                    "telenano/wire/ranges.py, as `PositionM` does, and not bounds of its own"
                ) from None
    return made


def has_optional_keys(topic: Topic) -> bool:
    """Return whether the message of a topic has keys that may be absent."""
    return any(not field.required for field in msgspec.structs.fields(topic.model))


class _Filler:
    """Makes the fields of one example from a JSON Schema."""

    def __init__(self, topic: Topic, definitions: dict[str, Any], case: Case) -> None:
        self._topic = topic
        self._definitions = definitions
        self._case = case
        self._numbers: Iterator[float] = cycle(case.numbers or (0.0,))

    def fill(self, schema: dict[str, Any], keys: Sequence[str]) -> dict[str, Any]:
        filled = {name: self._field(name, field) for name, field in schema["properties"].items() if name in keys}
        return {**filled, "v": self._topic.model.version} if "v" in filled else filled

    def _field(self, name: str, schema: dict[str, Any]) -> Any:
        if name == "src":
            return _a_source(self._topic)
        return _PATTERNED[name] if name in _PATTERNED else self._value(schema)

    def _value(self, schema: dict[str, Any]) -> Any:
        if "$ref" in schema:
            return self._record(schema["$ref"].rpartition("/")[2])
        if "anyOf" in schema:
            return self._value(schema["anyOf"][0 if self._case.filled else -1])
        if words := schema.get("enum") or schema.get("examples"):
            return words[self._case.choice % len(words)]
        return getattr(self, f"_{schema['type']}")(schema)

    def _record(self, name: str) -> Any:
        return self._numeric_array() if name == Array.__name__ else self._whole(self._definitions[name])

    def _whole(self, schema: dict[str, Any]) -> dict[str, Any]:
        return self.fill(schema, list(schema["properties"]))

    def _numeric_array(self) -> dict[str, Any]:
        kind = _ELEMENT_TYPES[self._case.choice % len(_ELEMENT_TYPES)]
        # The elements begin below zero for signed types, and are multiples of 0.5 nm for floats.
        steps = np.arange(6 if self._case.filled else 0) - (0 if kind == "u1" else 3)
        elements = (steps * (0.5e-9 if kind[0] == "f" else 1)).astype(kind)
        shaped = elements.reshape((2, -1) if elements.size else (0,))
        return fields_of(Array.from_numpy(shaped))

    def _object(self, schema: dict[str, Any]) -> dict[str, Any]:
        # A map may hold several kinds of values; each gets an entry.
        kinds = schema["additionalProperties"].get("anyOf", [schema["additionalProperties"]])
        return {f"section.{self._case.name}_{kind['type']}": self._value(kind) for kind in kinds if self._case.filled}

    def _array(self, schema: dict[str, Any]) -> tuple[Any, ...]:
        if "prefixItems" in schema:
            return tuple(self._value(item) for item in schema["prefixItems"])
        return tuple(self._value(schema["items"]) for _ in range(2 if self._case.filled else 0))

    def _integer(self, schema: dict[str, Any]) -> int:
        lowest = int(schema.get("minimum", -(2**63)))
        highest = int(schema.get("maximum", schema.get("exclusiveMaximum", 2**63) - 1))
        return (lowest, min(_BEYOND_DOUBLE, highest), highest)[self._case.end]

    def _number(self, schema: dict[str, Any]) -> float:
        value = next(self._numbers)
        if not self._case.numbers:
            # A quantity without a unit has no range.
            largest = sys.float_info.max
            return float(schema.get("maximum", largest) if self._case.end else schema.get("minimum", -largest))
        return -value if value < 0.0 and schema.get("minimum") == 0.0 else value

    def _string(self, schema: dict[str, Any]) -> str:
        return self._case.text[: schema.get("maxLength")]

    def _boolean(self, schema: dict[str, Any]) -> bool:
        return self._case.flag

    def _null(self, schema: dict[str, Any]) -> None:
        return None


def _a_source(topic: Topic) -> str:
    publisher = topic.publishers[0].replace("*", "afm_node")
    if "@" in publisher:
        return publisher
    return f"{publisher}@{'slave' if publisher == 'afm_node' else 'master'}"
