"""The slave halves against the sample: how stiff one they bear, and what a burst of messages does to them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from tried_laws import TRIED_LAWS

from telenano.extend.laws import MOST_PERIODS_A_STEP, NO_SIGNAL, PortSignal, SlaveReference, TipMeasurement
from telenano.extend.virtual_mass import FOLLOWED_M
from telenano.lockstep.law_rules import RULES
from telenano.sections.afm_section import AfmConfig
from telenano.sections.controller_section import LAWS, ControllerConfig

T = 1e-3
SCALE, FORCE_SCALE = 1.5e-6, 1e8
LOCAL = ("passivity", "wave", "model_mediated")
# as long a step as each half may make
STEPS = {"passivity": 1, "model_mediated": 1, "wave": MOST_PERIODS_A_STEP}


def config_of(name: str, **section: Any) -> ControllerConfig:
    return ControllerConfig.model_validate({"law": name, name: section})


def swing_after(name: str, stiffness: float, steps: int, *lates: int, **section: Any) -> float:
    """Return how far the force of a half swings in the end [N]: alone on a spring, a hand of 1 N that gives way.

    lates: how many steps late the instrument tells what it measured, in turn.
    """
    lates = lates or (0,)
    law, params = LAWS[name], config_of(name, **section).params()
    base, dt = 1e-11, STEPS[name] * T
    tip = TipMeasurement(base, stiffness * base, 0.0, False, True, True, 0.0)
    slave = law.slave_start(params, tip)
    signal = NO_SIGNAL._replace(position_m=2e-8, force_n=1e-8, energy_j=0.0, active=True, silence_s=0.0)
    forces, told = [], [tip] * (max(lates) + 1)
    for n in range(steps):
        late = lates[n % len(lates)]
        tip = told[-1 - late]._replace(outstanding_m=told[-1].base_position_m - told[-1 - late].base_position_m)
        # waves that go on as those of a hand of 1 N do, and energy for all that may happen
        if name == "wave":
            signal = signal._replace(position_m=SCALE * 0.01 * dt * n, energy_j=0.005 * dt * n)
        else:
            signal = signal._replace(energy_j=1e-3 * n)
        if n == steps // 2:
            signal = signal._replace(force_n=0.5 * signal.force_n)
        slave, wanted = law.slave_receive(params, slave, signal, tip, dt)
        told.append(tip._replace(base_position_m=wanted.position_m, force_n=stiffness * wanted.position_m))
        slave, _ = law.slave_send(params, slave, told[-1 - late], dt)
        forces.append(FORCE_SCALE * told[-1].force_n)
    return max(forces[-20:]) - min(forces[-20:])


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("section", [{}, {"position_scale": 3e-6}, {"force_scale": 2e8}])
def test_a_half_bears_samples_up_to_its_stated_stiffness_and_swings_just_beyond(
    name: str, section: dict[str, float]
) -> None:
    limit = config_of(name, **section).stiffness_limit_n_per_m()
    assert limit is not None
    assert swing_after(name, 0.97 * limit, 1500, **section) < 0.05
    assert swing_after(name, 1.03 * limit, 1500, **section) > 0.2


@pytest.mark.parametrize("late", [1, 2, 4])
@pytest.mark.parametrize("name", LOCAL)
def test_an_instrument_that_is_late_lowers_the_limit_as_the_document_derives(name: str, late: int) -> None:
    limit = config_of(name).stiffness_limit_n_per_m(late)
    assert limit is not None
    assert limit == pytest.approx(
        config_of(name).stiffness_limit_n_per_m() * math.sin(math.pi / (4 * late + 2)), rel=1e-12
    )
    assert swing_after(name, 0.9 * limit, 1500, late) < 0.05
    assert swing_after(name, 1.1 * limit, 1500, late) > 0.2


# orders in which forces may be up to n steps old, by the gaps of a line before an instrument that is n - 1 periods late
ORDERS = {1: [(0, 1), (0, 1, 1), (0, 0, 1)], 3: [(2, 3), (2, 2, 3), (0, 1, 2, 3), (0, 1, 2, 3, 3, 3)]}


@pytest.mark.parametrize("oldest", ORDERS)
@pytest.mark.parametrize("name", LOCAL)
def test_over_a_line_with_gaps_a_half_bears_what_is_stated_in_any_order_of_late_forces(name: str, oldest: int) -> None:
    config = config_of(name)
    limit, even = config.stiffness_limit_n_per_m(oldest - 1, even=False), config.stiffness_limit_n_per_m()
    assert limit is not None
    assert even is not None
    assert max(swing_after(name, 0.9 * limit, 1500, *lates) for lates in ORDERS[oldest]) < 0.05
    # at half of what it bears without gaps, where every second signal is lost; the old limit is twice that
    if oldest == 1:
        assert swing_after(name, 0.45 * even, 1500, 0, 1) < 0.05
        assert swing_after(name, 0.55 * even, 1500, 0, 1) > 0.2


def growth(gain: float, lates: Sequence[int]) -> float:
    """Return the spectral radius of e[k+1] = e[k] - gain e[k-d] over a round of the delays d."""
    size = max(lates) + 1
    turned = np.eye(size)
    for late in lates:
        step = np.diag(np.ones(size - 1), -1)
        step[0, 0] = 1.0
        step[0, late] -= gain
        turned = step @ turned
    return float(np.abs(np.linalg.eigvals(turned)).max())


@pytest.mark.parametrize(
    ("oldest", "longest", "sharp"), [(1, 8, 1.0), (2, 6, 2.0 - math.sqrt(2.0)), (3, 5, 0.4450418679)]
)
def test_the_stated_share_keeps_an_integrator_stable_for_all_orders_of_delays(
    oldest: int, longest: int, sharp: float
) -> None:
    """The least gain at which some order grows lies a tenth above the stated one, and at 2 sin(pi/(4n+2)) or below."""
    config = config_of("model_mediated")
    limit, even = config.stiffness_limit_n_per_m(oldest - 1, even=False), config.stiffness_limit_n_per_m()
    assert limit is not None
    assert even is not None
    stated = 2.0 * limit / even
    orders = [lates for n in range(1, longest + 1) for lates in product(range(oldest + 1), repeat=n)]
    assert max(growth(stated, lates) for lates in orders) <= 1.0 + 1e-9
    assert max(growth(1.001 * sharp, lates) for lates in orders) > 1.0
    assert 0.87 * sharp < stated < sharp


def test_the_limits_are_those_that_the_document_derives() -> None:
    limits = {name: config_of(name).stiffness_limit_n_per_m() for name in TRIED_LAWS}
    assert limits == {
        "virtual_impedance": None,
        "position_force": None,
        "wave": pytest.approx(2.0 * 100.0 / (150.0 * 3.0 * T), rel=1e-12),
        "passivity": pytest.approx(800.0, rel=1e-3),
        "model_mediated": pytest.approx(2.0 * 30.0 / (150.0 * T), rel=1e-12),
    }
    # the clamp behind another law is a loop as well, and the least of all counts
    clamped = ControllerConfig.model_validate({"law": "position_force", "clamp": {"enabled": True}})
    assert clamped.stiffness_limit_n_per_m() == pytest.approx(400.0, rel=1e-12)
    # half the period bears twice as stiff a sample
    fast = ControllerConfig.model_validate({"law": "model_mediated", "period_s": 5e-4})
    assert fast.stiffness_limit_n_per_m() == pytest.approx(800.0, rel=1e-12)


def test_a_sample_beyond_the_limit_is_named_with_the_remedy() -> None:
    config = config_of("wave")
    assert config.stiffness_doubts(444.0) == ""
    assert config.stiffness_doubts(445.0).startswith("law wave: 445 N/m is stiffer than the 444.4 N/m")
    assert "controller.period_s" in config.stiffness_doubts(445.0)
    assert config_of("virtual_impedance").stiffness_doubts(1e6) == ""


def test_a_line_that_is_not_even_is_named_with_both_limits() -> None:
    config = config_of("wave")
    assert config.stiffness_doubts(194.0, even=False) == config.stiffness_doubts(440.0) == ""
    text = config.stiffness_doubts(195.0, even=False)
    assert text.startswith(
        "law wave: 195 N/m is stiffer than the 194.4 N/m that its slave half tolerates over a line that loses "
        "or delays signals (444.4 N/m without that)"
    )
    both = config_of("model_mediated").stiffness_doubts(53.0, 4e-3, even=False)
    assert "the 52.78 N/m that its slave half tolerates with an instrument that answers 4 ms late over a line" in both
    limits = [config_of(name).stiffness_limit_n_per_m(even=False) for name in LOCAL]
    assert limits == pytest.approx([350.0, 194.4, 175.0], rel=1e-3)


def test_a_late_instrument_is_named_with_both_limits() -> None:
    config = config_of("model_mediated")
    assert config.stiffness_doubts(69.0, 4e-3) == config.stiffness_doubts(399.0) == ""
    text = config.stiffness_doubts(70.0, 4e-3)
    assert text.startswith(
        "law model_mediated: 70 N/m is stiffer than the 69.46 N/m that its slave half tolerates with"
    )
    assert "an instrument that answers 4 ms late (400 N/m without that)" in text
    # a part of a period counts as a whole one, and a sample beyond both limits is one of them still
    assert config.stiffness_doubts(70.0, 3.1e-3) == text.replace("4 ms", "3.1 ms")
    assert "4 ms late" in config.stiffness_doubts(500.0, 4e-3)
    assert config_of("virtual_impedance").stiffness_doubts(1e6, 0.1) == ""


def test_the_base_meets_nothing_stiffer_than_its_spring_or_its_cantilever() -> None:
    assert AfmConfig().stiffest_n_per_m == AfmConfig().cantilever.stiffness_n_per_m
    spring = AfmConfig.model_validate({"environment": "spring", "spring": {"stiffness_n_per_m": 500.0}})
    assert spring.stiffest_n_per_m == 500.0


def standing(params: Any, state: Any, signal: PortSignal, tip: TipMeasurement, dt: float) -> tuple[Any, SlaveReference]:
    """Follow no further than the wall, which it never touches, but press a spring at the start as asked."""
    base = min(signal.position_m, 2.9e-9 + 1e3 * tip.force_n)
    return state._replace(position_m=base), SlaveReference(base, True)


@pytest.mark.check("takes 1.3 s")
def test_a_law_that_never_touches_breaks_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    rule = next(rule for rule in RULES if rule.name.startswith("touches a wall"))
    assert list(rule.broken_by("model_mediated")) == []
    monkeypatch.setitem(LAWS, "model_mediated", replace(LAWS["model_mediated"], slave_receive=standing))
    faults = list(rule.broken_by("model_mediated"))
    assert "presses with 0 N on average" in faults[0]


def test_a_law_that_overlooks_what_a_late_instrument_still_has_to_do_breaks_a_rule(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    law = LAWS["model_mediated"]

    def hasty(params: Any, state: Any, signal: PortSignal, tip: TipMeasurement, dt: float) -> tuple[Any, Any]:
        """Press with twice the force that the guard has left, which a prompt instrument bears at half the limit."""
        return law.slave_receive(params, state, signal, tip._replace(force_n=2.0 * tip.force_n), dt)

    rule = next(rule for rule in RULES if rule.name.startswith("touches a wall"))
    monkeypatch.setitem(LAWS, "model_mediated", replace(law, slave_receive=hasty))
    assert any("reports it to the law 4 ms later" in fault for fault in rule.broken_by("model_mediated"))


@pytest.mark.parametrize("name", LOCAL)
@pytest.mark.parametrize("messages", [3, 30, 300])
def test_a_base_that_does_not_go_where_it_is_sent_is_sent_no_further_than_by_one_message(
    name: str, messages: int
) -> None:
    law, params = LAWS[name], config_of(name).params()
    tip = TipMeasurement(0.0, 2e-9, 0.0, False, True, True, 0.0)
    signal = NO_SIGNAL._replace(position_m=1e-9, force_n=1e-8, energy_j=1.0, active=True, silence_s=0.0)
    slave = law.slave_start(params, tip)
    # the first takes the half up
    slave, _ = law.slave_receive(params, slave, signal._replace(position_m=0.0, energy_j=0.0), tip, T)
    _, one = law.slave_receive(params, slave, signal, tip, T)
    wanted = one
    for _ in range(messages):
        slave, wanted = law.slave_receive(params, slave, signal, tip, T)
    # the whole force of the hand takes the coupling of `passivity` 25 pm in a period
    assert wanted.position_m <= FOLLOWED_M + max(3.0 * abs(one.position_m), 2.5e-11)
