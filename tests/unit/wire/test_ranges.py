"""What a node says stays in range, and what else is wrong with it stays an error."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from wire_contract import examples

from telenano.wire import TOPICS, accept, encode
from telenano.wire.messages import AfmScanline, AfmState, InputHealth, LawStatus, NodeHealth, TeleopForward
from telenano.wire.ranges import limited
from telenano.wire.sequence import MOST_COUNTED


def _fields(topic: str) -> dict[str, object]:
    return dict(examples(TOPICS[topic])["ordinary"].__dict__)


def test_a_quantity_beyond_its_range_is_sent_as_the_nearer_end_and_told() -> None:
    fields = {**_fields("afm/state"), "tip_force_n": (0.0, -2e6, 1e308), "deflection_m": -11.0, "step_s": -1.0}
    message = limited(AfmState, fields)
    assert (message.tip_force_n, message.deflection_m, message.step_s) == ((0.0, -1e6, 1e6), -10.0, 0.0)
    assert accept("afm/state", encode(message)) == message
    told: list[str] = []
    limited(AfmState, {**_fields("afm/state"), "tip_force_n": (0.0, -2e6, 1e308)}, told.append)
    limited(AfmState, _fields("afm/state"), told.append)
    assert told == ["AfmState: tip_force_n.1 = -2000000.0 is out of range and is sent at the end of the range"]


@pytest.mark.parametrize(("value", "sent"), [(math.inf, 1e12), (-math.inf, -1e12), (1e308, 1e12)])
def test_an_infinite_quantity_is_sent_as_an_end(value: float, sent: float) -> None:
    message = limited(LawStatus, {**_fields("law/status"), "left_j": value, "port_energy_j": -value})
    assert (message.left_j, message.port_energy_j) == (sent, -sent)
    wave = limited(TeleopForward, {**_fields("teleop/forward"), "wave_sqrt_w": (0.0, value, -value)})
    assert wave.wave_sqrt_w == (0.0, math.copysign(1e6, value), math.copysign(1e6, -value))


def test_a_count_stays_at_the_most_that_it_can_hold() -> None:
    row = examples(TOPICS["node/health"])["ordinary"].__dict__["inputs"][0].__dict__
    account = limited(InputHealth, {**row, "lost": 2**64, "gaps": MOST_COUNTED, "received": -1})
    assert (account.lost, account.gaps, account.received) == (MOST_COUNTED, MOST_COUNTED, 0)
    health = limited(NodeHealth, {**_fields("node/health"), "rejected": {"schema": 2**70, "topic": 3}})
    assert health.rejected == {"schema": MOST_COUNTED, "topic": 3}


@pytest.mark.parametrize(
    "change",
    [{"left_j": math.nan}, {"left_j": "1"}, {"left_j": None}, {"law": "Wave"}, {"unknown": 1.0}, {"passive": 1}],
)
def test_anything_else_that_is_wrong_stays_an_error(change: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match=next(iter(change))):
        limited(LawStatus, {**_fields("law/status"), "port_power_w": 1e300, **change})


def test_an_array_is_not_changed_element_by_element() -> None:
    line = _fields("afm/scanline")
    height = line["height_m"].model_copy(update={"dtype": "f8", "data": bytes(40) + b"\0\0\0\0\0\0\x59\x40"})  # type: ignore[attr-defined]
    with pytest.raises(ValidationError, match="height_m"):
        limited(AfmScanline, {**line, "height_m": {**height.__dict__}})


@given(st.dictionaries(st.sampled_from(sorted(LawStatus.model_fields)), st.floats(allow_nan=False), max_size=8))
def test_whatever_is_computed_a_message_comes_out_or_names_what_is_no_number(computed: dict[str, float]) -> None:
    numbers = {key: value for key, value in computed.items() if LawStatus.model_fields[key].annotation is float}
    message = limited(LawStatus, {**_fields("law/status"), **numbers})
    assert accept("law/status", encode(message)) == message
    for key, value in numbers.items():
        bound = next(rule for rule in LawStatus.model_fields[key].metadata)
        assert getattr(message, key) == min(max(value, bound.low), bound.high)
