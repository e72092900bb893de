"""Which part of a recording is the session."""

import numpy as np
import pytest

from recording.arrays import last_session


@pytest.mark.parametrize(
    ("session_s", "expected"),
    [
        ([-1.0, -1.0, 0.0, 0.1, 0.2, -1.0], [2, 3, 4]),
        ([0.0, 0.1, -1.0, 0.0, 0.1, 0.2], [3, 4, 5]),
        ([0.0, 0.1, 0.2, 0.0, 0.1], [3, 4]),
        ([-1.0, -1.0], []),
        ([], []),
    ],
)
def test_the_last_programme_is_the_session(session_s: list[float], expected: list[int]) -> None:
    assert last_session(np.array(session_s)).tolist() == expected
