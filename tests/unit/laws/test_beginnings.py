"""When a law may act on the hand, and when the hand leads the tip: one table for all laws."""

from itertools import product
from typing import Any

import pytest

from telenano.extend.laws import NO_SIGNAL, NO_TIP, HandSample
from telenano.extend.virtual_mass import ScaledConfig, at_hand, at_tip
from telenano.sections import LAWS

T = 1e-3
LIMIT_S = ScaledConfig().silence_limit_s
ANSWER = NO_SIGNAL._replace(active=True, silence_s=0.0)
# more than a damper takes in the first period
DAMPED_J = 1e-6
HAND = HandSample(0.0, 0.0, 1.0, True)


def may(following: bool, active: bool, silence_s: float, was_coupled: bool, stood_s: float, bridges: bool) -> Any:
    signal = ANSWER._replace(active=active, silence_s=silence_s)
    return at_hand(ScaledConfig(), HAND._replace(following=following), signal, was_coupled, stood_s, T, bridges)


CASES = tuple(
    product((False, True), (False, True), (0.0, LIMIT_S, 2.0 * LIMIT_S), (False, True), (0.0, LIMIT_S), (False, True))
)


@pytest.mark.parametrize("case", CASES)
def test_a_law_acts_on_a_hand_that_follows_where_the_tip_does_and_was_heard_of(case: Any) -> None:
    following, active, silence_s, was_coupled, stood_s, bridges = case
    found = may(*case)
    assert found.acts == (following and active and silence_s <= LIMIT_S)
    # neither what was known nor what was coupled before is another reason to act
    assert found.acts == may(following, active, silence_s, not was_coupled, stood_s, bridges).acts
    assert not (found.acts and found.stands)
    if found.stands:
        assert bridges and was_coupled and active and not following and found.stood_s <= LIMIT_S
    # the work at a device that was off, or that no law moved, belongs to no law
    assert found.counts == (following and was_coupled and stood_s == 0.0)
    assert found.stood_s == (0.0 if following else stood_s + T)


@pytest.mark.parametrize(("following", "in_contact"), list(product((False, True), repeat=2)))
def test_the_hand_leads_a_tip_that_follows_and_one_in_free_air_that_does_not_has_to_be_armed(
    following: bool, in_contact: bool
) -> None:
    tip = NO_TIP._replace(following=following, in_contact=in_contact)
    signal = ANSWER._replace(position_m=2e-9)
    found = at_tip(ScaledConfig(), signal, tip, 1e-9, True)
    assert found.leads == found.counts == following
    assert found.renews == (not following and not in_contact)
    assert found.base_m == (1e-9 if following else 2e-9)
    silent = at_tip(ScaledConfig(), signal._replace(silence_s=2.0 * LIMIT_S), tip, 1e-9, False)
    assert not silent.leads and not silent.heard and not silent.counts


@pytest.mark.parametrize("name", [name for name in LAWS if LAWS[name].uses_energy])
@pytest.mark.parametrize("sent_j", [1e-4, 0.3, 50.0])
def test_a_half_that_begins_while_the_other_one_continues_is_credited_nothing_of_before(
    name: str, sent_j: float
) -> None:
    """An instrument that was lost, or a process that was started again, begins where the other half has long counted.

    What had been sent until then was credited once more, up to the cap: 20 mJ for each loss of an instrument.
    """
    law = LAWS[name]
    params = law.config().to_params(T)  # type: ignore[attr-defined]
    signal = ANSWER._replace(energy_j=sent_j)
    tip = NO_TIP._replace(following=True)
    slave = law.slave_start(params, tip)
    slave, _ = law.slave_receive(params, slave, signal, tip, T)
    account = law.slave_energy_account(params, slave)
    assert account.remaining_j <= account.granted_j + DAMPED_J
    for begun in (law.master_start(params, HAND), law.master_resume(params, HAND, 0.0)):
        master, _ = law.master_receive(params, begun, HAND, signal, T)
        account = law.master_energy_account(params, master)
        assert account.remaining_j <= account.granted_j + DAMPED_J


@pytest.mark.parametrize("name", ["wave", "matched_wave", "passivity", "tdpa", "two_layer", "bounded_model"])
@pytest.mark.parametrize("overdrawn_j", [1e-2, 1.0])
def test_a_tip_that_has_got_more_than_was_paid_for_presses_no_further(name: str, overdrawn_j: float) -> None:
    """A base that goes by steps of its own, or a sample that jumps, takes more than the law has let it."""
    law = LAWS[name]
    params = law.config().to_params(T)  # type: ignore[attr-defined]
    tip, pressed_n = NO_TIP._replace(following=True), 1e-9
    start = ANSWER._replace(energy_j=1.0, force_n=4e-8)
    slave, _ = law.slave_receive(params, law.slave_start(params, tip), start, tip, T)
    slave, _ = law.slave_send(params, slave, tip, T)
    scale, gain = params.mass.position_scale, params.mass.force_scale
    way_m = 2.0 * scale * overdrawn_j / (gain * pressed_n)
    gone = tip._replace(base_position_m=way_m, force_n=pressed_n, in_contact=True)
    slave = slave._replace(position_m=way_m)
    slave, _ = law.slave_send(params, slave, gone, T)
    # the position of a law of waves is a counter, and that of the others the place of the hand
    place_m = 0.0 if law.uses_waves else 2.0 * way_m
    for tick in range(5):
        # what comes pays for a small part of it only
        more_j, more_m = 1e-5 * (tick + 1), scale * 1e-4 * (tick + 1)
        signal = start._replace(energy_j=1.0 + more_j, position_m=place_m + more_m, wave_sqrt_w=0.1)
        slave, wanted = law.slave_receive(params, slave, signal, gone, T)
        assert wanted.position_m <= way_m * (1.0 + 1e-9)
        slave, _ = law.slave_send(params, slave, gone, T)
