"""Force at the hand and motion of the tip have the numbers of the check case."""

import pytest
from telenano_laws.four_channel import FourChannelConfig, hand_force, tip_acceleration

PERIOD_S = 1e-3


def test_force_at_the_hand_and_motion_of_the_tip() -> None:
    params = FourChannelConfig(
        coupling_damping_n_s_per_m=10.0, coupling_stiffness_n_per_m=100.0, tip_mass_kg=0.5
    ).to_params(PERIOD_S)
    apart, faster, tip_n, hand_n = 0.01 - 0.008, 0.1 - 0.08, 1.0, 1.2
    assert hand_force(params, apart, faster, tip_n, hand_n) == pytest.approx(1.3, rel=1e-12)
    acceleration = tip_acceleration(params, apart, faster, tip_n, hand_n)
    assert acceleration == pytest.approx(1.4, rel=1e-12)
    assert 0.08 + PERIOD_S * acceleration == pytest.approx(0.0814, rel=1e-12)
