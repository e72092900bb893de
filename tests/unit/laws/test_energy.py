"""What enters at a port: exact on a spring, and a sign that cannot be missed."""

import pytest

from telenano.extend.laws import EnergyAccount
from telenano.laws.energy import TOLERANCE_J, is_passive, moved_to, opened, with_inflow, with_outflow

NONE = EnergyAccount(0.0, 0.0, 0.0)


def test_held_force_times_way() -> None:
    port = opened(1e-3, 0.0)
    for n in range(1, 11):
        port = with_inflow(port, 1e-3 + 1e-4 * n, 2.0)
    assert port.energy_j == pytest.approx(2e-3, rel=1e-12, abs=0.0)


def test_work_on_a_spring_is_its_energy_whatever_the_steps() -> None:
    for steps in (1, 7, 100):
        port = opened(0.0, 0.0)
        for n in range(1, steps + 1):
            x = 2e-3 * n / steps
            port = with_outflow(port, x, 3000.0 * x)
        assert port.energy_j == pytest.approx(-0.5 * 3000.0 * 4e-6, rel=1e-12, abs=0.0)
        assert with_outflow(port, 0.0, 0.0).energy_j == pytest.approx(0.0, abs=1e-15)


def test_motion_out_of_force_is_no_work() -> None:
    port = moved_to(with_inflow(opened(0.0, 0.0), 1e-3, 1.0), 5e-3, 9.0)
    assert port.energy_j == pytest.approx(1e-3, rel=1e-14, abs=0.0)


@pytest.mark.parametrize(
    ("net_j", "known", "account", "passive"),
    [
        (0.0, True, NONE, True),
        (-TOLERANCE_J, True, NONE, True),
        (-TOLERANCE_J * (1.0 + 1e-6), True, NONE, False),
        (-1.0, False, NONE, True),
        (-2e-3, True, EnergyAccount(0.0, 0.0, 2e-3), True),
        (-2e-3 - 2.0 * TOLERANCE_J, True, EnergyAccount(0.0, 0.0, 2e-3), False),
        (1.0, True, EnergyAccount(-1e-6, 0.0, 0.0), False),
        (1.0, True, EnergyAccount(-TOLERANCE_J, 0.0, 0.0), True),
        # rounding makes no more than a nanojoule
        (-1e-9, True, NONE, True),
        (-1.01e-9, True, NONE, False),
        (1.0, True, EnergyAccount(-1.01e-9, 0.0, 0.0), False),
    ],
)
def test_passive_at_the_bound_and_not_past_it(net_j: float, known: bool, account: EnergyAccount, passive: bool) -> None:
    assert is_passive(net_j, known, account) is passive
