"""What leaves a port within its energy; the numbers are those of the check cases."""

import pytest
from telenano_laws.bounded_model import BoundedModelConfig
from telenano_laws.ports import clipped_force, paid_base, paid_way

from telenano.extend.laws import TipMeasurement

PERIOD_S = 1e-3
NO_TIP = TipMeasurement(0.0, 0.0, 0.0, False, False, False, 0.0)


@pytest.mark.parametrize(
    ("velocity", "left_j", "force"),
    [(-0.1, 1e-4, 1.00393670), (0.1, 0.0, 2.0), (-0.1, 0.0, 0.0), (0.001, 0.0, 1.498)],
)
def test_a_force_is_clipped_to_what_may_leave_in_the_coming_period(
    velocity: float, left_j: float, force: float
) -> None:
    mass_kg, damping, hand_n, wanted_n = 0.5, 2.0, 1.0, 2.0
    own = PERIOD_S * (velocity + PERIOD_S * (hand_n - damping * velocity) / mass_kg)
    way_m_per_n = PERIOD_S * PERIOD_S / mass_kg
    found = clipped_force(wanted_n, own, way_m_per_n, left_j)
    assert found == pytest.approx(force, rel=1e-8, abs=1e-12)
    assert -found * (own - way_m_per_n * found) <= left_j + 1e-18


@pytest.mark.parametrize("force", [-2.0, -0.1, 0.0, 0.3, 5.0])
@pytest.mark.parametrize("way", [-1e-4, -1e-6, 1e-6, 1e-4])
@pytest.mark.parametrize("left_j", [0.0, 1e-7, 1e-4])
def test_no_sample_up_to_the_limit_gets_more_over_a_way_than_is_left(force: float, way: float, left_j: float) -> None:
    stiffest = 2e5
    paid = paid_way(way, force, stiffest, left_j)
    assert 0.0 <= paid / way <= 1.0
    for share in (0.01, 0.5, 1.0):
        assert force * paid + 0.5 * share * stiffest * paid * paid <= left_j + 1e-18


def test_what_a_late_instrument_has_not_carried_out_yet_is_paid_for_once_only() -> None:
    """Four steps are commanded before the first of them is measured; together they cost no more than is left."""
    params, stiffest, left_j = BoundedModelConfig().mass_params(PERIOD_S), 6e4, 1e-5
    base_m = sent_m = 1e-9
    for _ in range(4):
        tip = NO_TIP._replace(base_position_m=base_m, force_n=1e-9, in_contact=True, outstanding_m=sent_m - base_m)
        sent_m = paid_base(params, sent_m, tip, 1e-4, stiffest, left_j, 0.0)
    way_m = (sent_m - base_m) / params.position_scale
    assert 0.1 * way_m + 0.5 * stiffest * way_m * way_m == pytest.approx(left_j, rel=1e-9)


@pytest.mark.parametrize(
    ("way_m", "force_n", "in_contact", "gone_m"),
    [(1e-3, 0.0, False, 5e-6), (-1e-3, 0.0, False, -1e-3), (1e-3, 1e-9, True, 0.0), (-1e-3, -1e-9, True, 0.0)],
)
def test_without_energy_a_tip_goes_away_freely_and_comes_near_by_what_meeting_the_sample_may_cost(
    way_m: float, force_n: float, in_contact: bool, gone_m: float
) -> None:
    params = BoundedModelConfig().mass_params(PERIOD_S)
    tip = NO_TIP._replace(force_n=force_n, in_contact=in_contact, following=True)
    base_m = paid_base(params, 0.0, tip, way_m, 6e4, 0.0, 5e-6)
    assert base_m / params.position_scale == pytest.approx(gone_m, rel=1e-9, abs=1e-18)
