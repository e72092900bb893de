"""A stop at the limits of hand and tip, before every law: no limit is passed or winds up, and it gives no energy."""

import random
from typing import Any

import pytest

from telenano.extend.laws import NO_SIGNAL, HandSample, MasterReference
from telenano.extend.virtual_mass import LONGEST_LEAD_M
from telenano.laws.hand_limits import PASSED_LEAD_M, cut, free, hand_limits, received_within
from telenano.lockstep.law_rules import RULES
from telenano.sections.controller_section import OWN_LAWS, ControllerConfig

PERIOD_S = 1e-3
# Position up to which the search for a force is exact [m].
NEAR_M = 2e-9
# What a stop gives back of the energy that it took, which is that of the last bounce [J].
BOUNCE_J = 1e-6
RULE = next(rule for rule in RULES if rule.name == "the ends of the hand's travel wind nothing up")


def drawn_run(name: str, seed: int) -> dict[str, float]:
    """Press a hand with drawn forces against drawn limits; return what it has done at the worst."""
    rng = random.Random(f"{name} {seed}")
    config = ControllerConfig.model_validate({"law": name, "period_s": PERIOD_S})
    low, high = -rng.uniform(1e-5, 4e-3), rng.uniform(1e-5, 4e-3)
    speed, scale = 10.0 ** rng.uniform(-3.0, -1.5), config.law_config().position_scale
    limits = hand_limits(low, high, speed, PERIOD_S, rng.choice((0.0, scale)), passes=rng.random() < 0.5)
    law, params = OWN_LAWS[name], config.params()
    hand, before = HandSample(0.0, 0.0, 0.0, True), MasterReference(0.0, 0.0, 0.0, True)
    state, force_n, tip_n, beyond, fastest, given, most_given = (
        law.master_start(params, hand),
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    tip_m, device, is_stuck = 0.0, 0.0, False
    for _ in range(400):
        if rng.random() < 0.02:
            force_n, tip_n = rng.choice((0.0, rng.uniform(-10.0, 10.0))), rng.uniform(-3e-8, 3e-8)
        is_stuck ^= rng.random() < 0.01
        periods = rng.choice((1, 1, 1, 1, 2, 5))
        moved = 0.0 if is_stuck else before.position_m - device
        device += moved
        hand = HandSample(device, moved / PERIOD_S, force_n, True)
        state, sent = law.master_send(params, state, hand, periods * PERIOD_S)
        tip_m = rng.choice((tip_m, sent.position_m))
        signal = NO_SIGNAL._replace(position_m=tip_m, force_n=tip_n, active=True, silence_s=0.0, in_contact=True)
        state, reference, trial = received_within(
            limits, law.master_receive, params, state, hand, signal, periods * PERIOD_S, before, sent.position_m
        )
        beyond = max(beyond, reference.position_m - high, low - reference.position_m)
        fastest = max(fastest, abs(reference.velocity_m_per_s) / speed)
        if trial.side and reference.velocity_m_per_s:
            given += (trial.force_n - force_n) * (reference.position_m - before.position_m)
            most_given = max(most_given, given)
        before = reference
    return {"beyond_m": beyond, "fastest": fastest, "given_j": most_given}


@pytest.mark.parametrize("name", OWN_LAWS)
def test_no_drawn_force_leads_a_law_beyond_its_limits(name: str) -> None:
    worst: dict[str, Any] = {}
    for seed in range(6):
        for key, value in drawn_run(name, seed).items():
            worst[key] = max(worst.get(key, 0.0), value)
    assert worst["beyond_m"] <= NEAR_M
    assert worst["fastest"] <= 1.0 + 1e-3
    assert worst["given_j"] <= BOUNCE_J


def test_between_two_ends_that_are_close_the_other_one_is_not_passed() -> None:
    limits = hand_limits(-0.01, 0.0145, 0.03, PERIOD_S, 0.0, passes=True)
    # The lower end, the lead over the tip, is kept by 2 um more than there are up to the upper one.
    below = free()._replace(side=-1, over_m=-2e-6)
    beyond = MasterReference(0.014501583, 5e-4, 2.3, True)
    assert cut(limits, below, beyond, 0.0144996) == MasterReference(0.0145, 0.0, 2.3, True)
    assert cut(limits, below, beyond, 0.0146) == beyond, "what is further away already may stay where it is"
    within = beyond._replace(position_m=0.0144999)
    assert cut(limits, below, within, 0.0144996) == within


@pytest.mark.parametrize("name", OWN_LAWS)
def test_a_law_keeps_the_rule_of_the_ends(name: str) -> None:
    assert list(RULE.broken_by(name)) == []


def test_a_law_without_a_stop_breaks_the_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    def unlimited(limits: Any, receive: Any, *inputs: Any) -> Any:
        return (*receive(*inputs[:5]), free())

    monkeypatch.setattr("telenano.lockstep.law_rules.received_within", unlimited)
    told = list(RULE.broken_by("virtual_impedance"))
    assert [text.partition(",")[0] for text in told][:1] == ["pressed at the end of a travel of 0.002 m"]
    assert any("wound up" in text for text in told)


@pytest.mark.parametrize(("passes", "lead_m"), [(True, PASSED_LEAD_M), (False, LONGEST_LEAD_M)])
def test_a_tip_that_stands_is_led_no_further(passes: bool, lead_m: float) -> None:
    config = ControllerConfig(law="position_force")
    scale = config.law_config().position_scale
    limits = hand_limits(-1.0, 1.0, 0.03, PERIOD_S, scale, passes=passes)
    law, params, before = OWN_LAWS["position_force"], config.params(), MasterReference(0.0, 0.0, 0.0, True)
    state, held = (
        law.master_start(params, HandSample(0.0, 0.0, 0.0, True)),
        NO_SIGNAL._replace(active=True, silence_s=0.0),
    )
    for _ in range(1000):
        hand = HandSample(before.position_m, 0.0, 2.0, True)
        state, sent = law.master_send(params, state, hand, PERIOD_S)
        step = limits, law.master_receive, params, state, hand, held, PERIOD_S, before, sent.position_m
        state, before, _ = received_within(*step)
    assert 0.9 * lead_m <= before.position_m <= lead_m + NEAR_M
