"""The virtual mass: its exact step, and its rules of coupling."""

import math

import pytest

from services.controller.law import NO_SIGNAL, HandSample
from services.controller.laws.shared.virtual_mass import (
    Mass,
    MassConfig,
    at_rest,
    let_go,
    moved,
    tip_reference,
)

PERIOD_S = 1e-3
PARAMS = MassConfig().mass_params(PERIOD_S)


def test_motion_under_a_held_force_is_the_closed_form() -> None:
    mass, force, tau = at_rest(0.0), 0.7, 0.5 / 100.0
    for _ in range(40):
        mass = moved(PARAMS, mass, force)
    t = 40 * PERIOD_S
    x = force / 100.0 * (t - tau * (1.0 - math.exp(-t / tau)))
    assert mass.position_m == pytest.approx(x, rel=1e-12, abs=0.0)
    assert mass.velocity_m_per_s == pytest.approx(force / 100.0 * (1.0 - math.exp(-t / tau)), rel=1e-12, abs=0.0)


def test_let_go_moves_the_mass_and_not_the_tip() -> None:
    mass = Mass(7e-3, 0.02, 3e-10, True)
    free = let_go(PARAMS, mass, HandSample(5e-3, 0.0, 1.0, True), NO_SIGNAL)
    assert (free.position_m, free.velocity_m_per_s, free.coupled) == (5e-3, 0.0, False)
    assert tip_reference(PARAMS, free) == pytest.approx(tip_reference(PARAMS, mass), rel=1e-14, abs=0.0)


def test_over_a_retracted_tip_hand_and_tip_are_on_the_line_through_zero() -> None:
    mass, hand = Mass(7e-3, 0.02, 3e-10, True), HandSample(5e-3, 0.0, 1.0, True)
    retracted = NO_SIGNAL._replace(silence_s=0.0)
    assert let_go(PARAMS, mass, hand, retracted) == Mass(5e-3, 0.0, 0.0, False)
    # a tip that still touches, or that nobody hears, may be on the sample
    for other in (retracted._replace(in_contact=True), retracted._replace(active=True), NO_SIGNAL):
        assert let_go(PARAMS, mass, hand, other).tip_offset_m == pytest.approx(3.3e-9, rel=1e-12, abs=0.0)
