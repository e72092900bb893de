"""Silence and loss by the numbers of messages, and stamps that are of no clock."""

import random

import numpy as np
import pytest

from telenano.recording.arrays import in_step
from telenano.recording.silence import Break, breaks_of, joined

HAND = "haptic/state"
TIMES_S = np.arange(-500, 2500) * 1e-3
NUMBERS = np.arange(TIMES_S.size)
SPAN_S = (0.0, 2.0)


def breaks(kept: np.ndarray, numbers: np.ndarray = NUMBERS, **known: object) -> list[Break]:
    return breaks_of(HAND, TIMES_S[kept], numbers[kept], SPAN_S, **known)  # type: ignore[arg-type]


def standing(first_s: float, last_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times [s], and numbers, of a source that stood still, whose numbers go on."""
    there = (first_s >= TIMES_S) | (last_s <= TIMES_S)
    return TIMES_S[there], np.arange(there.sum())


def test_a_series_without_a_pause_has_no_break() -> None:
    assert breaks(np.ones(TIMES_S.size, dtype=bool)) == []


def test_every_pause_of_a_generator_is_told_by_its_numbers() -> None:
    """A pause of any length and place: stood still, restarted, lost, or stood still with a few messages lost."""
    dice = random.Random(11)
    for _ in range(300):
        first_s = dice.uniform(0.01, 1.9)
        last_s = first_s + dice.uniform(0.055, 0.6)
        away = (first_s < TIMES_S) & (last_s > TIMES_S)
        kind = dice.choice(["silent", "anew", "lost", "silent with a loss"])
        if kind == "lost":
            times_s, numbers = TIMES_S[~away], NUMBERS[~away]
        else:
            times_s, numbers = standing(first_s, last_s)
            after = times_s >= last_s
            if kind == "anew":
                numbers = np.where(after, numbers - numbers[after][0], numbers)
            elif kind == "silent with a loss":
                # less than half of what was due in the pause
                numbers = np.where(after, numbers + dice.randrange(1, 1 + round(400.0 * (last_s - first_s))), numbers)
        (found,) = breaks_of(HAND, times_s, numbers, SPAN_S)
        assert (found.lost, found.anew) == (kind == "lost", kind == "anew"), kind
        assert found.start_s == pytest.approx(first_s, abs=1.5e-3)
        assert found.end_s == pytest.approx(min(last_s, SPAN_S[1]), abs=1.5e-3)


@pytest.mark.parametrize(
    ("sent", "is_closed", "lost"), [(1001, True, False), (2501, True, True), (None, True, False), (None, False, True)]
)
def test_at_the_end_the_count_of_the_publisher_decides(sent: int | None, is_closed: bool, lost: bool) -> None:
    until = np.arange(TIMES_S.size) < 1001
    (found,) = breaks(until, sent=sent, is_closed=is_closed)
    assert found == Break(HAND, pytest.approx(0.5), 2.0, lost)


@pytest.mark.parametrize(("first", "lost"), [(0, False), (700, True)])
def test_at_the_beginning_the_first_number_decides(first: int, lost: bool) -> None:
    late = TIMES_S >= 0.3
    (found,) = breaks(late, NUMBERS - 800 + first)
    assert found == Break(HAND, 0.0, pytest.approx(0.3), lost)


@pytest.mark.parametrize(("sent", "lost"), [(None, True), (5, True), (0, False)])
def test_a_topic_without_any_sample_is_lacking_unless_nothing_was_sent(sent: int | None, lost: bool) -> None:
    assert breaks(np.zeros(TIMES_S.size, dtype=bool), sent=sent) == [Break(HAND, 0.0, 2.0, lost)]


def test_the_spans_of_several_topics_are_joined_and_losses_are_kept_apart_from_silences() -> None:
    of_all = [Break("a", 0.2, 0.4, True), Break("b", 0.3, 0.5, True), Break("c", 0.45, 0.9, False)]
    assert joined(of_all, lost=True) == ((0.2, 0.5),)
    assert joined(of_all, lost=False) == ((0.45, 0.9),)
    assert joined([], lost=True) == ()


@pytest.mark.parametrize("place", [0, 1, 50, 98, 99])
@pytest.mark.parametrize("stamp", [0, 2**63 - 1, 10**18 + 20 * 10**9])
@pytest.mark.parametrize("many", [1, 3])
def test_a_few_stamps_of_another_time_are_left_out(place: int, stamp: int, many: int) -> None:
    stamps = 10**18 + np.arange(100, dtype=np.int64) * 10**6
    wrong = slice(place, place + many)
    stamps[wrong] = stamp
    expected = np.ones(100, dtype=bool)
    expected[wrong] = False
    found = in_step(stamps)
    # a first or last one that lies behind, or ahead, may be the one after a pause
    is_at_edge = (place == 0 and stamp < 10**18) or (place + many >= 100 and stamp > 10**18)
    assert found.tolist() == (np.ones(100, dtype=bool) if is_at_edge else expected).tolist()


def test_a_pause_and_a_clock_that_is_set_back_keep_all() -> None:
    stamps = 10**18 + np.arange(100, dtype=np.int64) * 10**6
    paused = np.concatenate([stamps[:50], stamps[50:53] + 2 * 10**9, stamps[53:] + 5 * 10**9])
    assert in_step(paused).all()
    assert in_step(np.concatenate([stamps[:50], stamps[50:] - 3 * 10**9])).all()
    assert in_step(stamps[:0]).shape == (0,)
    assert in_step(stamps[:1]).all()
