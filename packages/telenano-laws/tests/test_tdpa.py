"""The observer, the controller and the compensation have the numbers of their check cases."""

import pytest
from telenano_laws.ports import opened, paid_way, two_counters
from telenano_laws.tdpa import drift_free_way

PERIOD_S = 1e-3
# The check cases are those of a force that does not change over a step.
SOFT_N_PER_M = 1e-3


def test_the_observer_counts_by_direction() -> None:
    # columns of the case: where the hand is, and the force that was held from there on
    places, forces = (0.0, 2e-4, 4e-4, 3e-4, 1e-4), (1.0, 1.0, 1.5, 0.0, 1.25)
    store, seen = opened(0.0), [(0.0, 0.0)]
    for before, after, force in zip(places, places[1:], forces, strict=False):
        store = two_counters(store, force * (after - before))
        seen.append((store.sent_j, 0.0 - store.left_j))
    expected = [(0.0, 0.0), (2e-4, 0.0), (4e-4, 0.0), (4e-4, 1.5e-4), (4e-4, 1.5e-4)]
    assert seen == [pytest.approx(row, rel=1e-9, abs=1e-15) for row in expected]


def test_the_tip_moves_as_far_as_is_paid() -> None:
    rows = [(0.5, 0.1, 1e-4), (1.0, 0.1, 1e-4), (1.0, -0.05, 1e-4), (2.0, 0.1, 1.5e-4)]
    out_j, in_j, speeds = 0.0, 0.0, []
    for force, speed, received_j in rows:
        way = paid_way(speed * PERIOD_S, force, SOFT_N_PER_M, received_j - out_j)
        out_j, in_j = out_j + max(force * way, 0.0), in_j + max(-force * way, 0.0)
        speeds.append(way / PERIOD_S)
    assert speeds == pytest.approx([0.1, 0.05, -0.05, 0.025], rel=1e-6)
    assert (out_j, in_j) == pytest.approx((1.5e-4, 5e-5), rel=1e-6)


@pytest.mark.parametrize(("force", "left_j", "speed"), [(1.0, 5e-5, 0.03), (1.0, 1e-5, 0.01), (0.0, 1e-9, 0.03)])
def test_what_the_tip_is_behind_is_made_up_for_within_the_account(force: float, left_j: float, speed: float) -> None:
    # the hand went on by 10 mm/s to 5 mm + a period, the tip is at 4 mm, kappa is 20 /s
    wanted = drift_free_way(5e-3, 5e-3 + 0.01 * PERIOD_S, 4e-3, 20.0 * PERIOD_S)
    assert paid_way(wanted, force, SOFT_N_PER_M, left_j) / PERIOD_S == pytest.approx(speed, rel=1e-6)
