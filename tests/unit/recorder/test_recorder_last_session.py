"""Which part of a recording is the session."""

import numpy as np
import pytest

from telenano.recording.arrays import last_force_profile, last_session

SECOND_NS = 1_000_000_000
# a hundred samples of a programme, a hundredth of a second apart
COURSE_S = np.arange(100) / 100.0


def stamps(session_s: np.ndarray, start_ns: int) -> np.ndarray:
    return start_ns + np.round(session_s * 1e9).astype(np.int64)


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
    number = np.arange(len(session_s))
    assert last_force_profile(np.array(session_s), number).tolist() == expected
    assert last_session(np.array(session_s), number, number).tolist() == expected


@pytest.mark.parametrize("behind", [range(40, 41), range(20, 30)])
def test_a_message_behind_later_ones_begins_no_session(behind: range) -> None:
    """A copy that stands behind later messages is left out."""
    order = np.array([*range(60), *behind, *range(60, 100)])
    t_ns = stamps(COURSE_S[order], SECOND_NS)
    found = last_force_profile(COURSE_S[order], t_ns)
    assert order[found].tolist() == list(range(100))
    assert last_session(COURSE_S[order], order, t_ns).tolist() == found.tolist()


def test_a_replay_that_was_set_back_begins_anew() -> None:
    course_s = np.arange(300) / 100.0
    order = np.array([*range(250), *range(50, 300)])
    found = last_force_profile(course_s[order], stamps(course_s[order], SECOND_NS))
    assert found.tolist() == list(range(250, 500))


@pytest.mark.parametrize(
    ("idle", "seq", "starts_s", "joined"),
    [
        # the process died while the programme ran
        (5, [*range(500, 600), *range(105)], (), True),
        (0, [*range(500, 600), *range(100)], (1.05,), True),
        # a launcher began another session
        (5, [*range(500, 600), *range(105)], (1.05, 101.2), False),
        # the programme was started anew in the same process
        (0, [*range(500, 700)], (), False),
        # it was over when the process ended
        (5, [*range(500, 605), *range(100)], (), False),
    ],
)
def test_a_programme_that_a_restarted_device_begins_anew_is_of_the_same_session(
    idle: int, seq: list[int], starts_s: tuple[float, ...], joined: bool
) -> None:
    session_s = np.array([*COURSE_S, *[-1.0] * idle, *COURSE_S])
    t_ns = np.concatenate(
        [stamps(COURSE_S, SECOND_NS), 50 * SECOND_NS + np.arange(idle), stamps(COURSE_S, 101 * SECOND_NS)]
    )
    starts_ns = [round(start_s * 1e9) for start_s in starts_s]
    found = last_session(session_s, np.array(seq), t_ns, starts_ns)
    # The session has the samples of the new process from before its programme was started anew, too.
    assert found.tolist() == list(range(0 if joined else 100 + idle, 200 + idle))


@pytest.mark.parametrize(("end_s", "last"), [(None, 149), (600.0, 149), (70.5, 120), (0.5, 149)])
def test_a_programme_that_nobody_starts_anew_leaves_a_session_to_its_end(end_s: float | None, last: int) -> None:
    session_s = np.array([*COURSE_S, *[-1.0] * 50])
    t_ns = np.concatenate([stamps(COURSE_S, SECOND_NS), (50 + np.arange(50)) * SECOND_NS])
    seq = np.array([*range(500, 600), *range(50)])
    ends_ns = [] if end_s is None else [round(end_s * 1e9)]
    assert last_session(session_s, seq, t_ns, (), ends_ns).tolist() == list(range(last + 1))
    # a programme that was ended by a command is over
    assert last_session(session_s, np.arange(150), t_ns, (), ends_ns).tolist() == list(range(100))
