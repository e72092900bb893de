"""The table of durations, and what is said of a case that is slow and has no mark."""

import pytest
from case_durations import LISTED_ABOVE_S, YARDSTICK_S, Case, CaseDurations, list_of, listed


@pytest.fixture
def durations(pytestconfig: pytest.Config) -> CaseDurations:
    cases = {
        "quick": Case(processor_s=0.1, call_s=0.1, wall_s=90.0),
        "slow": Case(processor_s=9.0, call_s=8.0, wall_s=8.0),
        "slow and marked": Case(processor_s=60.0, call_s=60.0, marks="check,parametrize"),
        "slow fixture": Case(processor_s=60.0, call_s=0.1),
    }
    return CaseDurations(pytestconfig, cases)


def test_a_slow_case_without_a_mark_is_named_by_its_own_processor_time(durations: CaseDurations) -> None:
    assert durations.unmarked_above(5.0) == ["slow: 8.0 s"]
    assert durations.unmarked_above(10.0) == []


def test_a_slower_machine_may_take_longer_and_a_faster_one_no_less(durations: CaseDurations) -> None:
    durations.yardstick_s = 2.0 * YARDSTICK_S
    assert durations.unmarked_above(5.0) == []
    durations.yardstick_s = 0.5 * YARDSTICK_S
    assert durations.unmarked_above(5.0) == ["slow: 8.0 s"]


def test_the_table_has_the_slowest_case_first(durations: CaseDurations) -> None:
    _, total, _, first, *_, last = durations.table().splitlines()
    assert total.startswith("# 4 cases, 129.1 s of processor time")
    assert first.split("\t")[0] == "60.00"
    assert last == "0.10\t0.10\t90.00\t\tquick"


def test_the_list_gets_what_is_slow_and_has_no_mark_and_keeps_what_it_has(durations: CaseDurations) -> None:
    found = list_of(durations.table()).splitlines()
    assert "8.00 slow" in found
    assert not [line for line in found if line.endswith(("quick", "slow and marked", "slow fixture"))]
    assert set(listed()) <= {line.split(" ", 1)[1] for line in found}
    assert all(float(spent_s) > LISTED_ABOVE_S for spent_s in listed().values())


def test_a_listed_case_is_left_to_the_check(request: pytest.FixtureRequest) -> None:
    items = {item.nodeid: item for item in request.session.items}
    for case in listed().keys() & items.keys():
        assert items[case].get_closest_marker("check") or items[case].get_closest_marker("slow"), case
