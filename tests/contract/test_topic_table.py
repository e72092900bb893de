"""The table of topics makes sense, and every field of every message says what it is and in which unit."""

import math
import re
import typing
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from wire_contract import FOLDER, range_table, topic_table

from telenano.testing.filled_messages import schema_of
from telenano.wire import Topic, instrument, journal_messages, messages, network_messages
from telenano.wire.codec import MAX_MESSAGE_BYTES, MOST_BYTES, Reason
from telenano.wire.messages import MAX_KEYS, Message, Record
from telenano.wire.ranges import RANGES
from telenano.wire.topics import OWN_TOPICS as TOPICS

# topics that more than one kind of node may send
SHARED = {"session/control", "session/event", "node/health", "node/journal", "link/key", "link/network"}
# What the name of a measured number ends in: SI units and their quotients, and the two that a process is measured in.
_SYMBOL = "(m2|m|s|ns|n|j|w|hz|rad|kg|k|pa|a|v|c|ohm|sqrt_w)"
UNIT = re.compile(rf"_({_SYMBOL}(_{_SYMBOL})*(_per_{_SYMBOL})?|bytes|percent)$")
# Measured numbers without a unit in their names. A whole number counts or names things and needs none.
UNITLESS = {
    "felt_value": "SI unit of the channel",
    "orientation": "parts of a unit quaternion",
}

ROWS = list(TOPICS.values())
_DECLARED = (messages, instrument, network_messages, journal_messages)
_MODULES = tuple(module.__name__ for module in _DECLARED)
SPEC = (FOLDER / "SPEC.md").read_text(encoding="utf-8")


def _records() -> Iterator[type[Record]]:
    waiting: list[type[Record]] = [Record]
    while waiting:
        record = waiting.pop()
        # nodes build records of their own on this base; the contract is what stands in proto
        waiting += [kind for kind in record.__subclasses__() if kind.__module__ in _MODULES]
        yield record


def _is_measured(annotation: object) -> bool:
    """Return whether a field has a measured number, or a tuple of such; maps carry the unit in their keys."""
    if annotation is float:
        return True
    return typing.get_origin(annotation) is not dict and any(_is_measured(a) for a in typing.get_args(annotation))


def test_every_message_has_one_topic() -> None:
    public = {r for r in _records() if issubclass(r, Message) and r is not Message and not r.__name__.startswith("_")}
    assert sorted(row.model.__name__ for row in ROWS) == sorted(model.__name__ for model in public)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_one_publisher_a_topic(row: Topic) -> None:
    if row.name in SHARED:
        assert row.delivery == "lossless" or row.publishers == ("*",)
    else:
        assert len(row.publishers) == 1
        assert row.publishers[0] != "*"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_rate_deadline_and_reading_fit_together(row: Topic) -> None:
    assert (row.rate_hz is None) == (row.deadline_s is None)
    if row.rate_hz is not None and row.deadline_s is not None:
        # a few messages may be lost before a topic counts as stale, but nobody waits a hundred periods
        assert 3.0 <= row.rate_hz * row.deadline_s <= 100.0
        assert row.deadline_s > 0.0
    assert (row.delivery == "lossless") == (row.rate_hz is None)
    # a piece of a recording is in the recording that it is a piece of
    assert row.recorded == (row.name != "recording/piece")


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_the_link_carries_a_topic_away_from_its_publisher(row: Topic) -> None:
    sites = {publisher.partition("@")[2] for publisher in row.publishers} - {""}
    if row.bridged == "forward":
        assert sites <= {"master"}
    if row.bridged == "backward":
        assert sites <= {"slave"}
    assert re.fullmatch(r"[a-z]+/[a-z]+", row.name)


def test_no_topic_is_the_beginning_of_another() -> None:
    # ZeroMQ subscribes by prefix
    assert not [(a, b) for a in TOPICS for b in TOPICS if a != b and b.startswith(a)]


@pytest.mark.parametrize("record", list(_records()), ids=lambda record: record.__name__)
def test_every_field_is_described_and_named_with_its_unit_and_none_if_absent(record: type[Record]) -> None:
    for field in msgspec.structs.fields(record):
        name = field.name
        assert any(rule.description for rule in field.type.__metadata__), f"{name} has no description"
        assert field.required or field.default is None, f"{name} has a default: a key that may be absent has None"
        if _is_measured(field.type):
            assert bool(UNIT.search(name)) != (name in UNITLESS), (
                f"{name} has no unit of UNIT, or one too many: give it its SI unit, as in force_n, or name it in"
                " UNITLESS of tests/contract/test_topic_table.py"
            )


def test_the_rule_finds_a_field_without_unit_and_knows_no_field_that_is_gone() -> None:
    assert not UNIT.search("force")
    assert UNIT.search("force_n")
    assert set(UNITLESS) <= {name for record in _records() for name in record.__struct_fields__}
    kinds = {field.name: field.type for row in ROWS for field in msgspec.structs.fields(row.model)}
    assert _is_measured(kinds["wave_sqrt_w"])
    assert not _is_measured(kinds["parameters"])


@pytest.mark.parametrize("record", list(_records()), ids=lambda record: record.__name__)
def test_every_message_is_frozen_and_refuses_what_it_does_not_know(record: type[Record]) -> None:
    config = record.__struct_config__
    assert (config.frozen, config.forbid_unknown_fields, config.omit_defaults, config.gc) == (True, True, True, False)
    assert record.__doc__
    if record.__struct_fields__:
        with pytest.raises(TypeError, match="Extra positional arguments"):
            record(1)


def test_every_version_counts_from_one() -> None:
    for row in ROWS:
        assert row.model.version >= 1
        assert schema_of(row)["properties"]["v"]["minimum"] == 1


def test_the_specification_has_the_table_the_limits_and_the_reasons() -> None:
    assert topic_table() in SPEC
    assert range_table() in SPEC
    plain = "".join(SPEC.split())
    for limit in (f"{MAX_MESSAGE_BYTES}bytesinamessage", f"{MAX_KEYS}keysinamap"):
        assert limit in plain, limit
    for reason in typing.get_args(Reason):
        assert f"`{reason}`" in SPEC, reason


def _numbers(schema: dict[str, Any], root: dict[str, Any], name: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every number and integer that a schema has a name for, with what is said of it."""
    if "$ref" in schema:
        yield from _numbers(root["$defs"][schema["$ref"].rpartition("/")[2]], root, name)
    for key, part in schema.get("properties", {}).items():
        yield from _numbers(part, root, f"{name}.{key}")
    for part in (*schema.get("anyOf", ()), *schema.get("prefixItems", ())):
        yield from _numbers(part, root, name)
    if "items" in schema:
        yield from _numbers(schema["items"], root, name)
    if schema.get("type") in ("number", "integer"):
        yield name, schema


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_every_quantity_has_a_finite_range_and_every_count_an_end(row: Topic) -> None:
    schema, known = schema_of(row), {(entry.low, entry.high) for entry in RANGES}
    found = list(_numbers(schema, schema))
    assert len(found) >= 3
    for name, number in found:
        if number["type"] == "number":
            bounds = (number["minimum"], number["maximum"])
            assert bounds in known, f"{name} has bounds of its own: a measured number has a range of wire/ranges.py"
        elif name != ".v":
            highest = number.get("maximum", number.get("exclusiveMaximum", 2**64) - 1)
            assert -(2**63) <= number["minimum"] < highest < 2**63, name


def test_every_range_is_used_finite_and_has_a_reason() -> None:
    used = {
        (number["minimum"], number["maximum"])
        for row in ROWS
        for _, number in _numbers(schema_of(row), schema_of(row))
        if number["type"] == "number"
    }
    for entry in RANGES:
        assert math.isfinite(entry.low)
        assert math.isfinite(entry.high)
        assert entry.low <= 0.0 < entry.high
        assert entry.low in (0.0, -entry.high)
        assert len(entry.reason) > 10
        # the elements of an array are no numbers of a schema
        assert (entry.low, entry.high) in used or entry.unit == "rad"


def test_the_table_shows_every_row_as_it_is() -> None:
    lines = topic_table().splitlines()
    assert len(lines) == len(ROWS) + 2
    for row, line in zip(ROWS, lines[2:], strict=True):
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        assert len(cells) == 9
        assert cells[0] == f"`{row.name}`"
        assert cells[3] == row.delivery
        assert cells[4] == (f"{row.rate_hz:g} Hz" if row.rate_hz else "on change")
        assert cells[6] == f"{MOST_BYTES[row.model] >> 10} KiB"
        assert cells[7] == (row.bridged or "–")
