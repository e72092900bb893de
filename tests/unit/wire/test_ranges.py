"""What a node says stays in range, and what else is wrong with it stays an error."""

import math
from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from telenano.testing.filled_messages import examples
from telenano.wire import compose, encode
from telenano.wire.codec import WireError, accept
from telenano.wire.messages import InputHealth, LawStatus
from telenano.wire.sequence import MOST_COUNTED
from telenano.wire.topics import TOPICS


def _fields(topic: str) -> dict[str, Any]:
    return msgspec.structs.asdict(examples(TOPICS[topic])["ordinary"])


def limited(topic: str, report: Callable[[str], None] = lambda text: None, **changes: object) -> Any:
    """Return an ordinary message of a topic with some fields changed, as a node sends it."""
    message, payload = compose(topic, {**_fields(topic), **changes}, report)
    assert encode(message) == payload
    return message


def test_a_quantity_beyond_its_range_is_sent_as_the_nearer_end_and_told() -> None:
    message = limited("afm/state", tip_force_n=(0.0, -2e6, 1e308), deflection_m=-11.0, step_s=-1.0)
    assert (message.tip_force_n, message.deflection_m, message.step_s) == ((0.0, -1e6, 1e6), -10.0, 0.0)
    assert accept("afm/state", encode(message)) == message
    told: list[str] = []
    limited("afm/state", told.append, tip_force_n=(0.0, -2e6, 1e308))
    limited("afm/state", told.append)
    assert told == ["AfmState: tip_force_n.1 = -2000000.0 is out of range and is sent at the end of the range"]


def test_a_count_stays_at_the_most_that_it_can_hold() -> None:
    row = _fields("node/health")["inputs"][0]
    counts = {"lost": 2**64, "gaps": MOST_COUNTED, "received": -1}
    for account in (msgspec.structs.replace(row, **counts), msgspec.structs.asdict(row) | counts):
        health = limited("node/health", inputs=(account,), rejected={"schema": 2**70, "topic": 3})
        assert isinstance(health.inputs[0], InputHealth)
        assert (health.inputs[0].lost, health.inputs[0].gaps) == (MOST_COUNTED, MOST_COUNTED)
        assert health.inputs[0].received == 0
        assert health.rejected == {"schema": MOST_COUNTED, "topic": 3}


def test_a_quantity_of_a_record_that_was_made_before_is_limited_too() -> None:
    row = _fields("node/health")["inputs"][0]
    health = limited("node/health", inputs=(msgspec.structs.replace(row, age_s=1e300),))
    assert health.inputs[0].age_s == 1e10


@pytest.mark.parametrize(
    "change",
    [{"left_j": math.nan}, {"left_j": "1"}, {"left_j": None}, {"law": "Wave"}, {"unknown": 1.0}, {"passive": 1}],
)
def test_anything_else_that_is_wrong_stays_an_error(change: dict[str, object]) -> None:
    with pytest.raises(WireError, match=next(iter(change))):
        limited("law/status", port_power_w=1e300, **change)


def test_an_array_is_not_changed_element_by_element() -> None:
    height = _fields("afm/scanline")["height_m"]
    beyond = msgspec.structs.replace(height, dtype="f8", data=bytes(40) + b"\0\0\0\0\0\0\x59\x40")
    for given_height in (beyond, msgspec.structs.asdict(beyond)):
        with pytest.raises(WireError, match="height_m"):
            limited("afm/scanline", height_m=given_height)


FIELDS = {field.name: field.type for field in msgspec.structs.fields(LawStatus)}


@example({"left_j": math.inf, "port_energy_j": -math.inf})
@given(st.dictionaries(st.sampled_from(sorted(FIELDS)), st.floats(allow_nan=False), max_size=8))
def test_whatever_is_computed_a_message_comes_out_or_names_what_is_no_number(computed: dict[str, float]) -> None:
    numbers = {key: value for key, value in computed.items() if FIELDS[key].__origin__ is float}
    message = limited("law/status", **numbers)
    assert accept("law/status", encode(message)) == message
    for key, value in numbers.items():
        bounds = next(rule for rule in FIELDS[key].__metadata__ if rule.ge is not None)
        assert getattr(message, key) == min(max(value, bounds.ge), bounds.le)
