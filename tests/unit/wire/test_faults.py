"""Every fault of every message is one sentence with topic, key, value and what would be right, sent or received."""

import math
import re
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wire_contract import present_fields

from telenano.testing.filled_messages import CASES, WITH_OPTIONAL, examples, has_optional_keys
from telenano.wire import compose
from telenano.wire.codec import WireError, accept
from telenano.wire.messages import Array
from telenano.wire.refusals import Fault
from telenano.wire.topics import OWN_TOPICS as TOPICS

Path = tuple[str | int, ...]
# Every key is there, the free maps and the lists hold something, and no quantity is beyond its range.
FULL = next(case.name for case in CASES if case.name == "highest")


def full(topic: str) -> dict[str, Any]:
    suffix = WITH_OPTIONAL if has_optional_keys(TOPICS[topic]) else ""
    return present_fields(examples(TOPICS[topic])[FULL + suffix])


def leaves(value: Any, path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield each scalar of a message, and each array of data, with its path."""
    if isinstance(value, dict) and value.keys() != set(Array.__struct_fields__):
        for key, part in value.items():
            yield from leaves(part, (*path, key))
    elif isinstance(value, tuple):
        for at, part in enumerate(value):
            yield from leaves(part, (*path, at))
    else:
        yield path, value


def replaced(value: Any, path: Path, new: object) -> Any:
    if not path:
        return new
    if isinstance(value, dict):
        return {key: replaced(part, path[1:], new) if key == path[0] else part for key, part in value.items()}
    return tuple(replaced(part, path[1:], new) if at == path[0] else part for at, part in enumerate(value))


PLACES = [(topic, path, value) for topic in TOPICS for path, value in leaves(full(topic)) if type(value) is not dict]
# A timestamp of msgpack, bytes and a map stand where no message has them.
STRANGE = [b"\x00\x01", {"": None}, msgpack.ExtType(5, b"x")]


def stated(topic: str, fields: dict[str, Any]) -> list[Fault]:
    """Return the faults of some fields, which sender and receiver have to state alike."""
    faults = TOPICS[topic].faults_in(fields)
    with pytest.raises(WireError) as received:
        accept(topic, msgpack.packb(fields))
    assert str(received.value) == f"{topic}: {faults[0].text}"
    assert received.value.reason == ("range" if faults[0].kind == "range" else "schema")
    return faults


@pytest.mark.parametrize("topic", TOPICS)
def test_a_whole_message_has_no_fault(topic: str) -> None:
    assert TOPICS[topic].faults_in(full(topic)) == []


@given(st.sampled_from(PLACES), st.sampled_from(STRANGE))
def test_the_key_of_a_value_of_another_type_is_named_wherever_it_stands(
    place: tuple[str, Path, Any], strange: Any
) -> None:
    topic, path, _ = place
    found = TOPICS[topic].faults_in(replaced(full(topic), path, strange))
    assert [fault.kind for fault in found] == ["type"]
    assert found[0].key == ".".join(map(str, path))[:100]
    if not isinstance(strange, msgpack.ExtType):
        assert stated(topic, replaced(full(topic), path, strange)) == found


NUMBERS = [(topic, path, value) for topic, path, value in PLACES if type(value) is float]


@given(st.sampled_from(NUMBERS), st.sampled_from([math.nan, math.inf, -math.inf]))
def test_a_number_that_is_not_finite_is_named_with_its_value(place: tuple[str, Path, Any], number: float) -> None:
    topic, path, _ = place
    [fault] = stated(topic, replaced(full(topic), path, number))
    assert fault.key == ".".join(map(str, path))
    assert fault.text.startswith(f"{fault.key} is {number!r}, must be ")
    assert fault.kind == "bounds"


RANGED = [place for place in NUMBERS if abs(place[2]) < 1e300]


@given(st.sampled_from(RANGED), st.sampled_from([1e301, -1e301]))
def test_a_quantity_beyond_its_range_is_named_with_both_ends_and_sent_at_the_nearer(
    place: tuple[str, Path, Any], number: float
) -> None:
    topic, path, _ = place
    fields = replaced(full(topic), path, number)
    [fault] = stated(topic, fields)
    key = ".".join(map(str, path))
    assert re.fullmatch(
        rf"{re.escape(key)} is {re.escape(repr(number))}, must be \S+ to \S+( \S+| its SI unit)?", fault.text
    )
    assert fault.kind == "range"
    limited: list[str] = []
    message, payload = compose(topic, fields, limited.append)
    assert len(limited) == 1 and f"{key} = {number!r}" in limited[0]
    assert accept(topic, payload) == message


@given(st.sampled_from(list(TOPICS)), st.data())
def test_a_key_that_is_missing_or_misspelled_is_named(topic: str, data: st.DataObject) -> None:
    fields = full(topic)
    key = data.draw(st.sampled_from(sorted(fields)))
    misspelled = {f"{name}x" if name == key else name: value for name, value in fields.items()}
    found = TOPICS[topic].faults_in(misspelled)
    assert Fault(f"{key}x", "unknown", found[-1].text) in found
    assert f"did you mean {key}? Known are " in found[-1].text or len(key) < 3
    assert len(found) == 1 or found[0] == Fault(key, "missing", f"{key} is missing")


def test_all_faults_are_found_and_the_first_is_stated() -> None:
    fields = full("node/health")
    rows = (fields["inputs"][0] | {"lost": -1}, fields["inputs"][0] | {"src": 3, "age_s": "old"})
    faults = stated("node/health", fields | {"pid": -1, "state": "tired", "inputs": rows})
    assert [(fault.key, fault.kind) for fault in faults] == [
        ("pid", "bounds"),
        ("state", "word"),
        ("inputs.0.lost", "bounds"),
        ("inputs.1.src", "type"),
        ("inputs.1.age_s", "type"),
    ]
