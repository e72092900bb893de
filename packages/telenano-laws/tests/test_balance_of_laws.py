"""Every law that states passivity against the adversary of telenano-conformance, which knows no law."""

import pytest

from telenano.extend.testing import balance, drawn, known_law, worst_balances

OWN = ("bounded_model", "matched_wave", "tdpa", "two_layer")
CORE = ("wave", "passivity")
# the kinds of order in which three draws find energy that the law has made, as docs/laws.md states it
BROKEN = {
    "bounded_model": set(),
    "matched_wave": {"end of travel: hand"},
    "tdpa": {"end of travel: hand", "silence forward"},
    "two_layer": {"hand lost", "silence forward"},
    "wave": {"end of travel: hand"},
    "passivity": set(),
}


@pytest.mark.parametrize("name", OWN)
def test_a_law_of_this_package_that_states_passivity_makes_no_energy_in_a_mixture(name: str) -> None:
    law = known_law(name)
    assert law.passive
    found = balance(law, drawn(1, 1, "mixed", law.config().silence_limit_s, 12.0))
    assert found.is_kept, found.sentence()


def test_a_device_that_something_else_moves_while_it_is_off_brings_no_energy_into_the_model() -> None:
    """The device is moved 0.1 s long into the model, whose energy nobody has paid: 0.4 mJ came out at the hand."""
    found = balance(known_law("bounded_model"), drawn(3, 2, "resume", 0.5, 10.0))
    assert found.is_kept, found.sentence()


@pytest.mark.check("sixteen kinds of transition, three draws of half a minute each, for every passive law")
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_a_passive_law_makes_energy_at_no_transition_but_those_that_are_known(name: str) -> None:
    found = worst_balances(known_law(name), seed=1, cases=3, longest_s=30.0)
    assert len(found) == 16
    broken = {kind: rows[0].sentence() for kind, rows in found.items() if not rows[0].is_kept}
    assert set(broken) == BROKEN[name], broken


@pytest.mark.check("twenty seconds of a rig for each law")
@pytest.mark.parametrize("name", [*OWN, *CORE])
def test_at_the_end_of_the_hands_travel_only_bounded_model_takes_no_work_that_the_device_has_not(name: str) -> None:
    """What docs/laws.md states as a limit of the others: their reference goes on where the device is stuck."""
    law = known_law(name)
    found = balance(law, drawn(3, 2, "end of travel: hand", law.config().silence_limit_s, 20.0))
    assert found.is_kept == (name == "bounded_model"), found.sentence()
    assert found.reference_j >= -1e-5
