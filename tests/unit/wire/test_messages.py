"""Messages are values: they do not change, and what they may not hold is refused when they are made."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from telenano.testing.filled_messages import examples
from telenano.wire import compose
from telenano.wire.codec import WireError, accept, fields_of
from telenano.wire.messages import Array, HapticState
from telenano.wire.topics import OWN_TOPICS as TOPICS


@pytest.mark.parametrize("topic", TOPICS)
def test_a_message_cannot_be_changed(topic: str) -> None:
    message = examples(TOPICS[topic])["minimal"]
    with pytest.raises(AttributeError, match="immutable"):
        message.seq = 7
    assert message.seq == 0


@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize("made", [tuple, list, np.asarray])
def test_numbers_of_numpy_are_sent_as_the_numbers_that_they_are(
    kind: type[np.floating[Any]], made: Callable[[list[Any]], object]
) -> None:
    fields = fields_of(examples(TOPICS["haptic/state"])["ordinary"])
    position = [kind(1e-9), kind(2e-9), kind(-0.0)]
    told: list[str] = []
    message, payload = compose(
        "haptic/state",
        {**fields, "position_m": made(position), "session_s": kind(0.5), "seq": np.int64(7), "estop": np.bool_(True)},
        told.append,
    )
    assert isinstance(message, HapticState)
    assert [type(value) for value in message.position_m] == [float] * 3
    assert repr(message.position_m) == repr(tuple(float(value) for value in position))
    assert (message.session_s, message.seq, message.estop) == (0.5, 7, True)
    assert accept("haptic/state", payload) == message
    assert told == []


@pytest.mark.parametrize("topic", TOPICS)
def test_a_number_of_numpy_at_any_place_of_any_message_ends_no_node(topic: str) -> None:
    fields = fields_of(examples(TOPICS[topic])["ordinary"])
    plain, payload = compose(topic, fields, pytest.fail)

    def as_numpy(value: Any) -> Any:
        if type(value) in (bool, int, float):
            return {bool: np.bool_, int: np.int64, float: np.float64}[type(value)](value)
        if isinstance(value, dict):
            return {key: as_numpy(part) for key, part in value.items()}
        return tuple(map(as_numpy, value)) if isinstance(value, tuple) else value

    assert compose(topic, as_numpy(fields), pytest.fail) == (plain, payload)


@pytest.mark.parametrize("value", [np.float32(2.0), np.bool_(True), np.asarray([1.0, 2.0])])
@pytest.mark.parametrize("topic", TOPICS)
def test_a_value_of_numpy_where_none_may_be_is_a_fault_with_its_key(topic: str, value: Any) -> None:
    fields = fields_of(examples(TOPICS[topic])["ordinary"])
    for key in fields.keys() - {"seq", "t_ns", "src", "v"}:
        try:
            message, _ = compose(topic, {**fields, key: value})
        except WireError as error:
            assert str(error).startswith(f"{topic}: {key}")
        else:
            assert getattr(message, key) == (value.tolist() if np.ndim(value) == 0 else tuple(value))
        assert {fault.key.partition(".")[0] for fault in TOPICS[topic].faults_in({**fields, key: value})} <= {key}


def test_an_array_is_read_only_and_a_copy() -> None:
    source = np.array([1.0, 2.0])
    sent = Array.from_numpy(source)
    source[0] = 9.0
    assert sent.to_numpy().tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        sent.to_numpy()[0] = 3.0


def test_an_array_of_nan_cannot_be_made() -> None:
    with pytest.raises(ValueError, match="NaN or infinity"):
        Array.from_numpy(np.array([np.nan]))


def test_a_scalar_has_an_empty_shape() -> None:
    sent = Array.from_numpy(np.float64(2.5e-9)[()].reshape(()))
    assert sent.shape == ()
    assert sent.to_numpy() == 2.5e-9
