"""How many messages of a channel a bridge is given."""

import pytest

from telenano.console.live_recording import Rate
from telenano.testing import hand_state, numbered, received


@pytest.mark.parametrize(("rate_hz", "count"), [(100.0, 100), (250.0, 250), (1.0, 1), (0.0, 1000)])
def test_a_channel_has_the_rate_that_was_asked_for_but_events(rate_hz: float, count: int) -> None:
    rate = Rate(rate_hz)
    assert sum(rate.is_due(received("haptic/state", hand_state(i % 500), i)) for i in range(1000)) == count
    assert all(rate.is_due(received("session/event", numbered("session/event", i), i)) for i in range(20))
