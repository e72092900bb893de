"""No noise, drift or trembling makes a stable loop one that cycles or grows, nor an unstable one stable."""

import pytest
from noise_sweep import cases, judged, softest_share
from verdict_sweep import wrong


def test_theory_knows_both_kinds_of_loop_under_hysteresis() -> None:
    found = cases(("real",))
    assert {case.loop.is_stable for case in found if case.loop.law == "virtual_impedance"} == {True, False}
    assert {case.trembles for case in found} == {True, False}
    # eight plays of 0.025 each, and four lags of 0.015
    assert softest_share("real") == pytest.approx(1.0 - 0.2 - 0.06)


@pytest.mark.check("simulates eight of forty sessions with the noise of an instrument")
@pytest.mark.usefixtures("plain_loop")
@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.endurance("simulates all"))])
def test_no_verdict_under_noise_contradicts_the_theory(every: int) -> None:
    drawn = cases(("real_drifting",))[::every]
    assert {case.loop.is_stable for case in drawn} == {case.trembles for case in drawn} == {True, False}
    found = [(case, judged(case, 0)) for case in drawn]
    assert not [(str(case), told) for case, told in found if wrong(case.loop, told.kind) or told.kind == "no hold"]
    # the noise of this instrument hides hardly anything
    assert sum(told.kind == "cannot_say" for _, told in found) <= 0.1 * len(found)
