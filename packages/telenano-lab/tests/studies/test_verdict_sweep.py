"""No outage makes a stable loop one that cycles or grows, and none makes an unstable one stable."""

import pytest
from verdict_sweep import GAINS, LAWS, OUTAGES_S, ROUND_TRIPS_MS, loops, sweep, wrong


def test_theory_knows_both_kinds_of_loop() -> None:
    found = loops()
    assert len(found) == (len(LAWS) - 1 + len(GAINS)) * len(ROUND_TRIPS_MS)
    assert {loop.is_stable for loop in found if loop.law == "virtual_impedance"} == {True, False}


@pytest.mark.check("simulates forty sessions with an outage in each")
@pytest.mark.parametrize("every_s", [1.5, pytest.param(0.1, marks=pytest.mark.endurance("takes 2 min"))])
def test_no_verdict_over_an_outage_contradicts_the_theory(every_s: float) -> None:
    found = sweep(every_s)
    assert len(found) == len(loops()) * len(OUTAGES_S)
    assert not [(loop, kind) for (loop, _), kinds in found.items() for kind in kinds if wrong(loop, kind)]
