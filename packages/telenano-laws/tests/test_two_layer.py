"""Tanks, transfer and level control have the numbers of their check cases."""

import pytest
from telenano_laws.ports import PortEnergy, credited, paid_way, sent_on, tank
from telenano_laws.two_layer import TwoLayerConfig, level_damper

# The check case is that of a force that does not change over a step.
SOFT_N_PER_M = 1e-4
PERIOD_S, SHARE, CAP_J = 1e-3, 0.01, 1.0


def test_the_hands_tank_is_charged_by_its_damper_and_sends_a_share() -> None:
    # alpha 1e3 N s/m for a joule, and a level of 1 mJ
    params = TwoLayerConfig(level_j=1e-3, level_gain_n_s_per_m_j=1e3).to_params(PERIOD_S)
    rows = [(0.0, 0.1, 1.0, 0.0), (1e-4, 0.1, 1.0, 0.0), (2e-4, -0.2, 1.0, 5e-5)]
    store, force, place, received, seen = PortEnergy(0.0, 0.0, 1e-4, 0.0), 0.0, 0.0, 0.0, []
    for x, velocity, wanted_n, more_j in rows:
        received += more_j
        store = tank(credited(store, received, CAP_J), force * (x - place), CAP_J)
        sent = SHARE * store.left_j
        store = sent_on(store, sent)
        force, place = wanted_n + level_damper(params, store.left_j) * velocity, x
        seen.append((store.left_j, sent, force))
    expected = [
        (9.9e-5, 1e-6, 1.0901),
        (2.059299e-4, 2.0801e-6, 1.0794070),
        (3.6023189e-4, 3.638706e-6, 0.87204638),
    ]
    assert seen == [pytest.approx(row, rel=1e-6) for row in expected]


def test_the_tip_stands_when_its_tank_is_empty() -> None:
    store, received, seen = PortEnergy(0.0, 0.0, 5e-5, 0.0), 0.0, []
    for force, speed, more_j in [(1.0, 0.02, 0.0), (1.0, 0.04, 0.0), (1.0, -0.03, 1e-5)]:
        received += more_j
        store = credited(store, received, CAP_J)
        sent = SHARE * store.left_j
        store = sent_on(store, sent)
        way = paid_way(speed * PERIOD_S, force, SOFT_N_PER_M, store.left_j)
        store = tank(store, -force * way, CAP_J)
        seen.append((way / PERIOD_S, sent, store.left_j))
    expected = [(0.02, 5e-7, 2.95e-5), (0.029205, 2.95e-7, 0.0), (-0.03, 1e-7, 3.99e-5)]
    assert seen == [pytest.approx(row, rel=1e-6, abs=1e-11) for row in expected]
