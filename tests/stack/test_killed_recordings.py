"""kill -9 of a recorder at random moments, many times; a few times it is done in test_running_rig.py."""

from typing import Any

import pytest
from killed import check_killed, kill_recorders


@pytest.mark.endurance
def test_killed_recordings_are_readable_and_lose_no_more_than_a_flush(rig: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    check_killed(rig, kill_recorders(rig, 20))
    code, _, err = rig.stop()
    assert code == 0, err
