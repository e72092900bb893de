"""Every law that states passivity against the adversary of the test kit, which knows no law."""

import pytest

from telenano.extend.laws import NO_SIGNAL, NO_TIP
from telenano.sections import LAWS
from telenano.testing import ADVERSE, EVERYTHING, balance, drawn, worst_balances

OWN = ("bounded_model", "matched_wave", "tdpa", "two_layer")
CORE = ("wave", "passivity")
# A change of these has all orders run, and any other one a share of the laws.
OF_LAWS = ("telenano/laws/", "telenano/testing/law_balance/", "packages/telenano-laws/telenano_laws/")
# Orders of one draw each: kind, seed, case, and how long [s]. In the first ones laws made energy before they counted
# what the hand does at its device, or before a tip paid for all that a sample may take in a step.
FOUND = (
    ("end of travel: hand", 3, 2, 20.0),
    ("end of travel: hand", 1, 2, 20.0),
    ("end of travel: hand", 3, 3, 28.0),
    ("silence forward", 1, 2, 27.0),
    ("hand lost", 1, 0, 2.0),
    ("resume", 3, 2, 10.0),
)
OTHERS = tuple(
    (kind, 1, 1, 4.0)
    for kind in (
        "let go",
        "off",
        "arm",
        "retune",
        "switch",
        "silence backward",
        "silence both",
        "end of travel: base",
        "instrument lost",
        "quantised force",
        "mixed",
    )
)


@pytest.mark.parametrize("name", OWN)
def test_a_law_of_this_package_that_states_passivity_makes_no_energy_in_a_mixture(name: str) -> None:
    law = LAWS[name]
    assert law.passive
    found = balance(law, drawn(1, 1, "mixed", law.config().silence_limit_s, 6.0))
    assert found.is_kept, found.sentence()


def test_a_device_that_something_else_moves_while_it_is_off_brings_no_energy_into_the_model() -> None:
    """The device is moved 0.1 s long into the model, whose energy nobody has paid: 0.4 mJ came out at the hand."""
    found = balance(LAWS["bounded_model"], drawn(3, 2, "resume", 0.5, 10.0))
    assert found.is_kept, found.sentence()


@pytest.mark.check("compiles the law")
@pytest.mark.drawn(0.5, *OF_LAWS)
@pytest.mark.parametrize(
    ("name", "kind", "seed", "case"),
    [
        ("tdpa", "sample that jumps", 2026, 10),
        ("two_layer", "instrument lost", 2026, 7),
        ("wave", "quantised force", 94, 23),
    ],
)
def test_orders_in_which_a_law_was_found_to_make_energy(name: str, kind: str, seed: int, case: int) -> None:
    """6.4 mJ came out over an empty account, 44 where a half began anew, 12 where a base goes by steps of its own."""
    law = LAWS[name]
    found = balance(law, drawn(seed, case, kind, law.config().silence_limit_s, 60.0), fast=True)
    assert found.is_kept and found.contact_share > 0.5, found.sentence()


@pytest.mark.parametrize("name", ["tdpa", "two_layer"])
@pytest.mark.parametrize("later_n", [0.0, 1e-8, 3e-8])
def test_the_work_of_the_tip_is_that_against_the_force_right_after_its_step(name: str, later_n: float) -> None:
    """The sample moves by itself until the next signal comes: 0.17 mJ were booked too little in a second."""
    law, period_s = LAWS[name], 1e-3
    params = law.config().to_params(period_s)
    scale, gain = params.mass.position_scale, params.mass.force_scale
    tip = NO_TIP._replace(following=True, in_contact=True, force_n=2e-8)
    signal = NO_SIGNAL._replace(active=True, silence_s=0.0)
    slave, _ = law.slave_receive(params, law.slave_start(params, tip), signal, tip, period_s)
    slave, wanted = law.slave_receive(params, slave, signal._replace(position_m=3e-12), tip, period_s)
    before_j = law.slave_energy_account(params, slave).remaining_j
    reached = tip._replace(base_position_m=wanted.position_m, force_n=2.2e-8)
    slave, _ = law.slave_send(params, slave, reached, period_s)
    work_j = gain * 2.1e-8 * wanted.position_m / scale
    slave, _ = law.slave_receive(
        params, slave, signal._replace(position_m=wanted.position_m), reached._replace(force_n=later_n), period_s
    )
    left_j = law.slave_energy_account(params, slave).remaining_j
    share = getattr(params, "shared", 0.0)
    assert wanted.position_m > 0.0
    assert left_j == pytest.approx((1.0 - share) * (before_j - work_j), rel=1e-9, abs=0.0)


@pytest.mark.parametrize(("left_j", "goes"), [(0.0, True), (-1e-7, True), (-1e-4, False)])
def test_a_tip_in_the_air_waits_where_its_account_is_overdrawn_by_a_sample_that_came_to_it(
    left_j: float, goes: bool
) -> None:
    law = LAWS["tdpa"]
    params = law.config().to_params(1e-3)
    tip = NO_TIP._replace(following=True)
    signal = NO_SIGNAL._replace(active=True, silence_s=0.0)
    slave, _ = law.slave_receive(params, law.slave_start(params, tip), signal, tip, 1e-3)
    slave = slave._replace(store=slave.store._replace(left_j=left_j))
    _, wanted = law.slave_receive(params, slave, signal._replace(position_m=1e-9), tip, 1e-3)
    assert (wanted.position_m > 0.0) == goes


@pytest.mark.check("orders of up to twenty seconds")
@pytest.mark.parametrize(("kind", "longest_s"), [("arm", 5.0), ("end of travel: hand", 20.0)])
def test_a_surface_that_was_learnt_while_the_device_was_off_throws_no_hand_back(kind: str, longest_s: float) -> None:
    """The model had the learnt surface at once in which the hand already was: 40 and 6.8 mJ came out."""
    law = LAWS["model_mediated"]
    found = balance(law, drawn(78, 0, kind, law.config().silence_limit_s, longest_s))
    assert found.is_kept and found.contact_share > 0.1, found.sentence()


@pytest.mark.check("seventeen orders for every passive law, up to 12 s of processor time each law")
@pytest.mark.drawn(0.3, *OF_LAWS)
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_a_passive_law_makes_no_energy_in_the_orders_in_which_laws_did(name: str) -> None:
    law = LAWS[name]
    limit_s = law.config().model_dump().get("silence_limit_s", 0.2)
    done = [balance(law, drawn(seed, case, kind, limit_s, longest)) for kind, seed, case, longest in (*FOUND, *OTHERS)]
    assert [one.sentence() for one in done if not one.is_kept] == []


@pytest.mark.check("eleven orders of four seconds for every passive law, 2 s of processor time each law")
@pytest.mark.drawn(0.55, *OF_LAWS)
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_a_passive_law_makes_no_energy_over_what_is_worse_than_a_constant_delay(name: str) -> None:
    law = LAWS[name]
    limit_s = law.config().model_dump().get("silence_limit_s", 0.2)
    done = [balance(law, drawn(94, 1, kind, limit_s, 4.0)) for kind in (*ADVERSE, EVERYTHING)]
    assert [one.sentence() for one in done if not one.is_kept] == []


# a thousand and more orders of up to a minute for each law
@pytest.mark.endurance("takes 5 min for each law")
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_a_passive_law_makes_no_more_energy_than_it_states_in_a_thousand_orders(name: str) -> None:
    found = worst_balances(LAWS[name], seed=94, cases=38, longest_s=60.0)
    assert sum(map(len, found.values())) >= 1000
    assert [one.sentence() for rows in found.values() for one in rows if not one.is_kept] == []
