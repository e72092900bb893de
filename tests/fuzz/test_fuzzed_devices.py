"""No answer of a device ends its driver, whatever bytes, types and numbers it has, also within a retraction."""

import fuzzed_devices
import pytest

IN_CHECK, IN_ENDURANCE = 120, 2000


def check(kind: str, first: int, count: int) -> None:
    told = [fuzzed_devices.session(kind, seed) for seed in range(first, first + count)]
    # The damage was felt.
    assert sum(map(bool, told)) > 0.1 * count


@pytest.mark.check("takes 2.7 s")
@pytest.mark.parametrize("kind", fuzzed_devices.SESSIONS)
def test_no_answer_ends_a_driver(kind: str) -> None:
    check(kind, 0, IN_CHECK)


@pytest.mark.endurance
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("kind", fuzzed_devices.SESSIONS)
def test_no_answer_ends_a_driver_in_many_sessions(kind: str) -> None:
    check(kind, IN_CHECK, IN_ENDURANCE)
