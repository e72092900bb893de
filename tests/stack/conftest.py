"""Tests on real processes: every rig is taken down, whatever became of the test."""

from collections.abc import Iterator
from pathlib import Path

import machine
import pytest
from commands import COMMANDS
from stack_rig import Rig


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.stack)


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


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    yield rig
    rig.close()
