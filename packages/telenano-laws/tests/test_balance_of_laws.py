"""Every law that states passivity against the adversary of telenano-conformance, which knows no law."""

import pytest

from telenano.laws import LAWS
from telenano.testing import balance, drawn, worst_balances

OWN = ("bounded_model", "matched_wave", "tdpa", "two_layer")
CORE = ("wave", "passivity")
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
    (kind, 1, 1, 8.0)
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
# the kinds of order in which draws find energy that the law has made, as docs/laws.md states it
BROKEN: dict[str, set[str]] = {name: set() for name in (*OWN, *CORE)}


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


@pytest.mark.check("orders of up to twenty seconds")
@pytest.mark.parametrize(("kind", "longest_s"), [("arm", 5.0), ("end of travel: hand", 20.0)])
def test_a_surface_that_was_learnt_while_the_device_was_off_throws_no_hand_back(kind: str, longest_s: float) -> None:
    """The model had the learnt surface at once in which the hand already was: 40 and 6.8 mJ came out."""
    law = LAWS["model_mediated"]
    found = balance(law, drawn(78, 0, kind, law.config().silence_limit_s, longest_s))
    assert found.is_kept and found.contact_share > 0.1, found.sentence()


@pytest.mark.check("seventeen orders for every passive law, up to 8 s of processor time each law")
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_a_passive_law_makes_no_energy_in_the_orders_in_which_laws_did(name: str) -> None:
    law = LAWS[name]
    limit_s = law.config().model_dump().get("silence_limit_s", 0.2)
    broken = []
    for kind, seed, case, longest_s in (*FOUND, *OTHERS):
        found = balance(law, drawn(seed, case, kind, limit_s, longest_s))
        if not (found.is_kept or kind in BROKEN[name]):
            broken.append(found.sentence())
    assert not broken


@pytest.mark.endurance
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_a_passive_law_makes_energy_at_no_transition_but_those_that_are_known(name: str, seed: int) -> None:
    found = worst_balances(LAWS[name], seed=seed, cases=8, longest_s=60.0)
    assert len(found) == 16
    broken = {kind: rows[0].sentence() for kind, rows in found.items() if not rows[0].is_kept}
    assert set(broken) == BROKEN[name], broken
