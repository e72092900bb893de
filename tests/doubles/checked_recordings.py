"""Checks the recordings that the tests make, from outside: a fault in one is an error of the test that made it.

The rigs of a test say where they record: a recorder in virtual time when it finishes its file, and a rig of processes
when it is closed. After the test each file is read by `told_and_counted`, unless the test has removed it.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import told_and_counted

from services.recorder.intake import Intake
from telenano.testing.processes import LiveRig

# A larger file would take more than about a second [bytes].
MOST_BYTES = 8_000_000
_made: dict[Path, None] = {}
_counts = {"checked": 0, "too large": 0}


def note(path: Path) -> None:
    """Have a recording checked when the test that runs has ended."""
    _made.setdefault(path.absolute())


def _observe(owner: Any, name: str, paths: Any) -> None:
    inside = getattr(owner, name)

    def observed(self: Any, *given: Any, **named: Any) -> Any:
        for path in paths(self):
            note(path)
        return inside(self, *given, **named)

    setattr(owner, name, observed)


def _of_recorder(intake: Intake) -> list[Path]:
    # A disk in memory has no names of files.
    name = None if intake.writer is None else getattr(intake.writer._stream, "name", None)
    return [Path(name)] if isinstance(name, str) else []


def _of_rig(rig: LiveRig) -> list[Path]:
    return sorted(rig.folder.rglob("session*.mcap"))


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "unchecked(reason): its recordings are not as a recorder makes them")
    _observe(Intake, "finish", _of_recorder)
    _observe(LiveRig, "close", _of_rig)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Iterator[None]:
    yield
    made = list(_made)
    _made.clear()
    if item.get_closest_marker("unchecked") is not None:
        return
    faults = [fault for path in made for fault in _check(path)]
    assert faults == [], "the plain libraries count otherwise than the recording tells:\n" + "\n".join(faults[:20])


def _check(path: Path) -> list[str]:
    try:
        is_small = path.stat().st_size <= MOST_BYTES
    except OSError:
        return []
    _counts["checked" if is_small else "too large"] += 1
    return told_and_counted.check(path) if is_small else []


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if any(_counts.values()):
        said = ", ".join(f"{count} {what}" for what, count in _counts.items())
        terminalreporter.line(f"recordings read by the plain libraries: {said}")
