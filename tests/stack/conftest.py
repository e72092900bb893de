"""Tests on real processes: every rig is taken down, whatever became of the test.

`make test` has the tests of the one rig that they share, `shared_rig`, with a process a node; all others start rigs of
their own, and are in `make check` or `make endurance`.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import machine
import pytest
from browser_page import browser
from commands import COMMANDS
from installations import built
from stack_rig import CONSTANT_PUSH, FIGURE_AND_PUSH, FIGURE_S, Rig
from two_sites import TwoSites


# before the cases are drawn, which are among those of `make check`, and after pytest has sorted them
@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> Iterator[None]:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.stack)
            of_make_test = has_shared_rig(item) and not shares_processes(item)
            if not of_make_test and item.get_closest_marker("endurance") is None:
                item.add_marker(pytest.mark.check)
    written = [item for item in items if way_of(item)]
    yield
    # Tests that have a way keep the order in which they are written: pytest sorts them by the place of a way among the
    # parameters of each test, and so begins the rig of a module anew whenever that differs.
    left = set(items)
    in_order = iter([item for item in written if item in left])
    items[:] = [next(in_order) if way_of(item) else item for item in items]
    # The shared rig runs from its first test to the end, so its tests come after those with rigs of their own: two rigs
    # have not room on two processors. The tests of one way come before those of the other, because a way keeps its rig
    # for all of them; those that end the shared rig come last, because they judge the state that all others left.
    items.sort(
        key=lambda item: (
            has_shared_rig(item),
            shares_processes(item),
            item.get_closest_marker("ends_shared_rig") is not None,
        )
    )


def has_shared_rig(item: pytest.Item) -> bool:
    """Return whether a test runs on the rig that many tests share."""
    return "shared_rig" in getattr(item, "fixturenames", ())


def way_of(item: pytest.Item) -> str:
    """Return how a test wants the nodes of its rig put into processes; empty where it does not say."""
    return str(item.callspec.params.get("processes", "")) if hasattr(item, "callspec") else ""


def shares_processes(item: pytest.Item) -> bool:
    """Return whether a test has a rig whose nodes share processes."""
    return way_of(item) == "site"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if machine.notes():
        terminalreporter.section("what this machine did not give")
        for text in machine.notes():
            terminalreporter.line(text)


@pytest.fixture(scope="session", autouse=True)
def our_turn() -> Iterator[None]:
    machine.keep_our_turn()
    yield
    COMMANDS.close()


@pytest.fixture(scope="module")
def processes(request: pytest.FixtureRequest) -> str:
    """How the nodes of a rig are put into processes; tests about safety have it for `node` and for `site`."""
    return str(getattr(request, "param", "node"))


@pytest.fixture
def rig(tmp_path: Path, processes: str) -> Iterator[Rig]:
    with closing(Rig(tmp_path, processes)) as rig:
        yield rig


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """Run one browser for all tests of a module."""
    with browser() as found:
        yield found


@pytest.fixture(autouse=True)
def closed_windows(request: pytest.FixtureRequest) -> Iterator[None]:
    """Close the windows of a test after it: a page goes on drawing, and takes time from the tests that follow."""
    found = request.getfixturevalue("chromium") if "chromium" in request.fixturenames else None
    before = list(found.contexts) if found else []
    yield
    for window in list(found.contexts) if found else []:
        if window not in before:
            window.close()


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("wheel"))


@pytest.fixture
def sites(tmp_path: Path) -> Iterator[TwoSites]:
    with closing(TwoSites(tmp_path)) as sites:
        yield sites


@pytest.fixture(scope="module")
def pressing_rig(tmp_path_factory: pytest.TempPathFactory, processes: str) -> Iterator[Rig]:
    """Run a rig of the module's own, whose hand stays pressed onto the sample."""
    with closing(Rig(tmp_path_factory.mktemp("pressing"), processes)) as rig:
        rig.start("--duration", "600", "--set", CONSTANT_PUSH)
        rig.wait_until(rig.running, "a running session")
        yield rig


@pytest.fixture(scope="session")
def shared_rigs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Rig]]:
    """Yield what gives the shared rig of a way; whoever asks for that of the other way ends this one."""
    with ExitStack() as running:
        started: dict[str, Rig] = {}

        def of(processes: str) -> Rig:
            if processes not in started:
                running.close()
                started.clear()
                rig = running.enter_context(closing(Rig(tmp_path_factory.mktemp("shared"), processes)))
                rig.start("--duration", "900", "--set", FIGURE_AND_PUSH)
                rig.wait_until(rig.running, "a running session")
                rig.wait_until(lambda: rig.session_s() > FIGURE_S, "the end of the programme of Fig. 12")
                started[processes] = rig
            return started[processes]

        yield of


@pytest.fixture(scope="module")
def shared_rig(shared_rigs: Callable[[str], Rig], processes: str) -> Rig:
    """Give the rig that has run Fig. 12 once, and then presses: one for all tests that leave it as they found it."""
    return shared_rigs(processes)
