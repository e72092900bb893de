"""The guard with its state decides as `safety_step` does, and holds the tip away from what a node's guard would."""

import math

import pytest

from telenano.afm import TipGuard
from telenano.sections.afm_section import AfmConfig

PERIOD_S = 1e-3
LIMITS = AfmConfig().to_params().safety


def test_a_tip_at_rest_follows_as_fast_as_its_limit_lets_it() -> None:
    guard = TipGuard(LIMITS)
    before_m = guard.base_m
    assert not guard.follows
    far_m = LIMITS.base_max_m
    way_m = guard.follow(far_m, PERIOD_S, force_n=0.0) - before_m
    assert guard.follows and way_m == pytest.approx(LIMITS.base_speed_m_per_s * PERIOD_S, rel=1e-9, abs=0.0)
    for _ in range(round((far_m - before_m) / way_m) + 1):
        guard.follow(far_m, PERIOD_S, force_n=0.0)
    assert guard.base_m == far_m


@pytest.mark.parametrize(
    ("force_n", "is_lost", "reason"),
    [
        (2.0 * LIMITS.force_limit_n, False, "force_limit"),
        (math.nan, False, "force"),
        (0.0, True, "lost"),
    ],
)
def test_a_tip_that_may_not_follow_withdraws_and_says_why(force_n: float, is_lost: bool, reason: str) -> None:
    guard = TipGuard(LIMITS)
    for _ in range(50):
        guard.follow(0.0, PERIOD_S, force_n=0.0)
    before_m = guard.base_m
    assert guard.follow(LIMITS.base_max_m, PERIOD_S, force_n=force_n, is_lost=is_lost) < before_m
    assert not guard.follows and reason in guard.reason


def test_a_tip_that_is_withdrawn_follows_no_more_until_it_is_there() -> None:
    guard = TipGuard(LIMITS)
    for _ in range(200):
        guard.follow(0.0, PERIOD_S, force_n=0.0)
    base_m = guard.retract(PERIOD_S, force_n=0.0)
    assert not guard.follows and guard.reason == "retract_requested"
    while guard.base_m > LIMITS.retract_position_m:
        later_m = guard.follow(0.0, PERIOD_S, force_n=0.0)
        assert later_m <= base_m
        base_m = later_m
    guard.follow(0.0, PERIOD_S, force_n=0.0)
    assert guard.follows


def test_a_tip_at_rest_that_is_to_retract_stays_where_it_is_and_is_not_armed() -> None:
    guard = TipGuard(LIMITS)
    before_m, before = guard.base_m, guard.reason
    for _ in range(3):
        assert guard.retract(PERIOD_S, force_n=0.0) == before_m
        assert not guard.follows and guard.reason == before == "start"
