"""What leaves a port within its energy; the numbers are those of the check cases."""

import pytest
from telenano_laws.ports import clipped_force, paid_damped_way

PERIOD_S = 1e-3


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
    damping = 100.0
    paid = paid_damped_way(way, force, damping, PERIOD_S, left_j)
    assert 0.0 <= paid / way <= 1.0
    for share in (0.01, 0.5, 1.0):
        stiffness = share * 2.0 * damping / PERIOD_S
        assert force * paid + 0.5 * stiffness * paid * paid <= left_j + 1e-18
