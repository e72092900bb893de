"""Of each estimate: outside three stated errors at most 1 %, refused though it has an answer at most 5 %."""

import pytest
from made_estimates import ESTIMATES, row

FEW = 12


@pytest.mark.check("makes 108 measurements")
@pytest.mark.parametrize("name", ESTIMATES)
def test_of_a_few_none_is_far_outside_its_error_and_few_are_refused(name: str) -> None:
    found = row(name, range(FEW))
    assert found.outside <= 1
    assert found.refused <= 2
    assert found.accepted <= 1


@pytest.mark.endurance
@pytest.mark.parametrize("name", ESTIMATES)
def test_of_400_one_in_a_hundred_is_outside_and_one_in_twenty_refused(name: str) -> None:
    found = row(name, range(400))
    assert found.outside <= 0.01 * found.answers
    assert found.refused <= 0.05 * found.answers
