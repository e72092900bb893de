"""A fixed quarter of many cases is in `make test`: the others are marked for `make check`, and none is lost."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


class Case:
    """A collected test of one set of parameters, or of none."""

    def __init__(self, path: str, test: str, case: str | None = None, *marks: str) -> None:
        self.path = ROOT / path
        self.name = test if case is None else f"{test}[{case}]"
        self.nodeid = f"{path}::{self.name}"
        self.marks = list(marks)
        if case is not None:
            self.callspec = SimpleNamespace(params={"case": case})

    def get_closest_marker(self, name: str) -> str | None:
        return name if name in self.marks else None

    def add_marker(self, mark: Any) -> None:
        self.marks.append(mark.name)


@pytest.fixture
def hooks(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the rules of collection, where one file is changed."""
    spec = importlib.util.spec_from_file_location("rules_of_collection", ROOT / "conftest.py")
    assert spec is not None and spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    changed = {"tests/changed.py", "packages/telenano-changed/"}
    monkeypatch.setattr(found, "touches", lambda *places: not changed.isdisjoint(places))
    return found


def later(hooks: Any, cases: list[Case], mark: str = "check") -> set[str]:
    hooks._leave_three_quarters(cases)
    return {case.name for case in cases if mark in case.marks}


def test_a_quarter_of_a_test_with_four_or_more_cases_stays_and_it_is_the_same_each_time(hooks: Any) -> None:
    for count, left in ((1, 1), (3, 3), (4, 1), (5, 2), (8, 2), (9, 3)):
        names = [str(number) for number in range(count)]
        first = later(hooks, [Case("tests/a.py", "test_a", name) for name in names])
        assert count - len(first) == left, count
        assert later(hooks, [Case("tests/a.py", "test_a", name) for name in reversed(names)]) == first


def test_what_is_changed_single_or_of_a_rig_stays_and_other_marks_are_kept(hooks: Any) -> None:
    assert not later(hooks, [Case("tests/changed.py", "test_a", str(number)) for number in range(8)])
    assert not later(hooks, [Case("tests/stack/test_a.py", "test_a", str(number)) for number in range(8)])
    assert not later(hooks, [Case("tests/a.py", f"test_{number}") for number in range(8)])
    slow = [Case("tests/a.py", "test_a", str(number), "endurance") for number in range(8)]
    assert not later(hooks, slow)
    assert all(case.marks == ["endurance"] for case in slow)


def test_a_package_that_a_change_leaves_alone_has_a_quarter_in_make_check_and_a_changed_one_has_all(hooks: Any) -> None:
    for package, mark in (("changed", "check"), ("other", "endurance")):
        cases = [Case(f"packages/telenano-{package}/tests/a.py", "test_a", str(number)) for number in range(8)]
        assert len(later(hooks, cases, mark)) == 6
        assert {name for case in cases for name in case.marks} == {mark}
