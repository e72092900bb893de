"""How late the hand of a page is: over lines that are drawn, by what the line is known to have done."""

import random

import pytest

from services.viz_node.hand_age import HandAge

PERIOD_S = 1.0 / 60.0
LATE_S = 0.1
SEEDS = range(30)


def frames(seed: int) -> list[tuple[float, float, float]]:
    """Return stamp, arrival and true lateness [s] of the frames of two minutes, over a line that is drawn.

    The clocks differ and drift. What a frame takes is the way, jitter, and what waits before it in a line of TCP: now
    and then the line stands still, or carries less than is sent, and its queue grows.
    """
    draw = random.Random(900 + seed)
    offset_s, drift = draw.uniform(-1e5, 1e5), draw.uniform(-5e-5, 5e-5)
    way_s, jitter_s = draw.uniform(0.002, 0.3), draw.choice((0.0, 0.005, 0.02))
    stands = sorted((draw.uniform(5.0, 118.0), draw.uniform(0.05, 2.0)) for _ in range(draw.randrange(6)))
    made, last_s, sent_s = [], 0.0, 0.0
    while sent_s < 120.0:
        sent_s += PERIOD_S
        took_s = way_s + draw.expovariate(1.0 / jitter_s) if jitter_s else way_s
        at_s = sent_s + took_s
        for begin_s, length_s in stands:
            if begin_s <= at_s < begin_s + length_s:
                at_s = begin_s + length_s
        last_s = at_s = max(at_s, last_s)
        made.append((offset_s + sent_s * (1.0 + drift), at_s, at_s - sent_s - way_s))
    return made


def wrong_share(seeds: range) -> tuple[float, float]:
    """Return the share of late frames that are called fresh, and of fresh ones that are called late."""
    missed = late = false = fresh = 0
    for seed in seeds:
        age = HandAge()
        for stamp_s, at_s, true_s in frames(seed):
            said = age.take(stamp_s, at_s, None) > LATE_S
            # What is nearer to the limit than the jitter of the quickest frame is neither.
            if true_s > LATE_S + 0.02:
                late, missed = late + 1, missed + (not said)
            elif true_s < LATE_S - 0.02:
                fresh, false = fresh + 1, false + said
    return missed / late, false / fresh


def test_late_frames_are_found_and_fresh_ones_are_not_called_late() -> None:
    missed, false = wrong_share(range(8))
    assert missed < 0.01
    assert false < 0.001


@pytest.mark.check("thirty lines of two minutes")
def test_late_frames_are_found_over_many_lines() -> None:
    missed, false = wrong_share(SEEDS)
    assert missed < 0.01
    assert false < 0.001


def test_a_page_whose_machine_slept_is_fresh_again_by_a_question_that_came_back_at_once() -> None:
    age, slept_s = HandAge(), 30.0
    for number in range(100):
        age.take(number * PERIOD_S, 5.0 + number * PERIOD_S, (5.0, 0.02))
    stamp_s, now_s = 100 * PERIOD_S, 5.0 + 100 * PERIOD_S + slept_s
    # Nothing is known of the line since: the frame may have waited.
    assert age.take(stamp_s, now_s, (6.5, 0.02)) == pytest.approx(slept_s)
    assert age.take(stamp_s + 0.5, now_s + 0.5, (now_s + 0.4, 0.3)) == pytest.approx(slept_s)
    assert age.take(stamp_s + 1.0, now_s + 1.0, (now_s + 0.9, 0.02)) == 0.0


def test_a_slower_way_is_the_usual_one_after_a_minute() -> None:
    age = HandAge()
    late = [age.take(at_s, at_s + (0.02 if at_s < 30 else 0.2), None) > LATE_S for at_s in range(150)]
    assert not any(late[:30])
    assert all(late[30:80])
    assert not any(late[100:])
