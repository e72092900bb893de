"""What every test shares.

Property tests are seeded and have no time limit on single examples, a test gives back what it changed in its process,
and marks say which cases run when.
"""

import gc
import sys
import zlib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest
from changed_files import touches
from ended_workers import pytest_testnodedown
from hypothesis import HealthCheck, settings
from restored_process import process_restored, process_restored_after_a_file

__all__ = ["process_restored", "process_restored_after_a_file", "pytest_testnodedown"]

ROOT = Path(__file__).parent
STACK = ROOT / "tests" / "stack"
PACKAGES = ROOT / "packages"
# When a test of `make endurance` is ended that names no time of its own [s]; `make test` and `make check` have the
# limit of pyproject.toml, which several of those tests need for their work.
ENDURANCE_S = 3600

# derandomize: the same examples every run, and no database of them on disk
settings.register_profile(
    "telenano",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("telenano")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave three quarters of many cases to `make check`, and what is not drawn of many slow ones to `make endurance`.

    A case is drawn by its name, so that each run has the same ones. `make test` has all cases of a changed file.
    """
    for item in items:
        if item.get_closest_marker("endurance") and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(ENDURANCE_S))
        if (grid := item.get_closest_marker("grid")) and item.get_closest_marker("endurance") is None:
            values = item.callspec.params  # type: ignore[attr-defined]
            if any(values[name] != chosen for name, chosen in grid.kwargs.items()):
                item.add_marker(pytest.mark.check(f"{grid.kwargs} stand for the grid"))
        drawn = item.get_closest_marker("drawn") if item.get_closest_marker("check") else None
        if drawn and zlib.crc32(item.name.encode()) >= drawn.args[0] * 2**32 and not touches(*_places(item, drawn)):
            item.add_marker(pytest.mark.endurance(f"{drawn.args[0]:.0%} of the cases stand for all"))
    _leave_three_quarters(items)


def _leave_three_quarters(items: list[pytest.Item]) -> None:
    """Mark for `make check` all but the first quarter, by the digests of their names, of a test's four or more cases.

    Those of a package that the change leaves alone are marked for `make endurance`. The cases of a rig of processes
    belong together, and `tests/stack` says itself which of them are in `make test`.
    """
    cases = defaultdict[tuple[Path, str], list[pytest.Item]](list)
    for item in items:
        later = item.get_closest_marker("check") or item.get_closest_marker("endurance")
        if hasattr(item, "callspec") and not later and STACK not in item.path.parents:
            cases[item.path, item.nodeid.partition("[")[0]].append(item)
    for (path, _), many in cases.items():
        if len(many) < 4 or touches(path.relative_to(ROOT).as_posix()):
            continue
        many.sort(key=lambda item: zlib.crc32(item.name.encode()))
        rest = pytest.mark.endurance if _is_in_a_package_left_alone(path) else pytest.mark.check
        for item in many[(len(many) + 3) // 4 :]:
            item.add_marker(rest("a quarter of the cases stands for all"))


def _is_in_a_package_left_alone(path: Path) -> bool:
    return PACKAGES in path.parents and not touches(f"packages/{path.relative_to(PACKAGES).parts[0]}/")


def _places(item: pytest.Item, drawn: pytest.Mark) -> tuple[str, ...]:
    """Return the files whose change has all cases of a test run: that of the test, and those that its mark names."""
    return (item.path.relative_to(ROOT).as_posix(), *drawn.args[1:])


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Collect the tests without looking for garbage, which takes a third of the time, and leave them out of it later.

    Modules and tests are half a million objects that stay: one collection of all of them takes seconds. Their bytecode
    is kept, also where the environment forbids it: other workers, runs and the processes that tests start read it.
    """
    forbidden, sys.dont_write_bytecode = sys.dont_write_bytecode, False
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()
        sys.dont_write_bytecode = forbidden
