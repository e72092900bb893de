"""Messages are values: they do not change, and what they may not hold is refused when they are made."""

import numpy as np
import pytest
from pydantic import ValidationError
from wire_contract import examples

from telenano.wire import TOPICS
from telenano.wire.messages import Array, HapticState


@pytest.mark.parametrize("topic", TOPICS)
def test_a_message_cannot_be_changed(topic: str) -> None:
    message = examples(TOPICS[topic])["minimal"]
    with pytest.raises(ValidationError, match="frozen"):
        message.seq = 7
    assert message.seq == 0


def test_numpy_scalars_are_taken_as_numbers() -> None:
    fields = examples(TOPICS["haptic/state"])["ordinary"].model_dump()
    position = np.array([1e-9, 2e-9, 3e-9])
    message = HapticState.model_validate({**fields, "position_m": tuple(position)})
    assert message.position_m == (1e-9, 2e-9, 3e-9)
    with pytest.raises(ValidationError, match="position_m"):
        HapticState.model_validate({**fields, "position_m": position})


def test_an_array_is_read_only_and_a_copy() -> None:
    source = np.array([1.0, 2.0])
    sent = Array.from_numpy(source)
    source[0] = 9.0
    assert sent.to_numpy().tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        sent.to_numpy()[0] = 3.0


def test_an_array_of_nan_cannot_be_made() -> None:
    with pytest.raises(ValidationError, match="NaN or infinity"):
        Array.from_numpy(np.array([np.nan]))


def test_a_scalar_has_an_empty_shape() -> None:
    sent = Array.from_numpy(np.float64(2.5e-9)[()].reshape(()))
    assert sent.shape == ()
    assert sent.to_numpy() == 2.5e-9
