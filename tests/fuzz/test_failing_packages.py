"""A package may fail in any way, and is left out by its name: every command that does not name it works."""

import json
import random
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from failing_packages import AT_IMPORT, CALLS, NOISE, RAISES, ROWS, fails_at_import, fails_in_call, has_rows

from telenano.settings import DEMO_RECORDING

SEED = 95
ENDS = ("the end of the program", "the end of the program by an object")
OWN_COMMANDS = ("evil", "bag evil")
# What check runs of the command lines.
SHORT = {"at import": ("--help", "law list"), "in a call": OWN_COMMANDS, "rows of commands": ("--help-all",)}
# Characters that a terminal obeys, and the beginning of a line that the text of a package would make.
OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\ufffd]|^b` c", re.MULTILINE)
WAYS: dict[str, tuple[dict[str, str], Callable[..., dict[str, Any]]]] = {
    "at import": (AT_IMPORT, fails_at_import),
    "in a call": ({**RAISES, "prints": f"print({NOISE!r})"}, fails_in_call),
    "rows of commands": (ROWS, has_rows),
}


def faults_of(way: str, line: str, end: Any) -> list[str]:
    """Return what is wrong with how a command ended."""
    if isinstance(end, str):
        return [f"goes on: {end[:500]}"]
    output, faults = end["output"], []
    if end["raised"]:
        faults.append(f"a traceback: {end['raised'][-500:]}")
    if OBEYED.search(output):
        faults.append(f"a terminal obeys a text of the package: {output[-500:]!r}")
    is_called = line in CALLS and way == "in a call"
    if end["code"] not in ((0, 1, 2) if is_called or line.startswith("doctor") else (0,)):
        faults.append(f"its code is {end['code']}: {output[-500:]}")
    if is_called and end["code"] and line != "doctor --json":
        said = [text for text in output.splitlines() if text.startswith("telenano: ")]
        if len(said) != 1:
            faults.append(f"not one sentence: {output[-500:]}")
    if line.endswith("--json") and not is_called:
        documents = [text for text in output.splitlines() if text.startswith(("{", "["))]
        if not documents or not all(_is_json(text) for text in documents):
            faults.append(f"no document: {output[-500:]}")
    if not output.strip() and not is_called:
        faults.append("prints nothing")
    return faults


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def chosen(cases: Sequence[str], count: int | None) -> Sequence[str]:
    return cases if count is None else random.Random(SEED).sample(cases, count)


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "count",
    [
        pytest.param(1, marks=pytest.mark.check("two seconds for each of three packages")),
        pytest.param(None, marks=pytest.mark.endurance("ten seconds for each of sixty packages")),
    ],
)
def test_a_package_that_fails_is_left_out(count: int | None, way: str, tmp_path: Path) -> None:
    sources, ends_with = WAYS[way]
    wrong = []
    for number, name in enumerate(chosen(list(sources), count)):
        (tmp_path / str(number)).mkdir()
        lines = {} if count is None else {"lines": SHORT[way]}
        for line, end in ends_with(tmp_path / str(number), sources[name], DEMO_RECORDING, **lines).items():
            # A command may end the program with a code of its own, and without a word.
            if not (name in ENDS and way == "in a call" and line in OWN_COMMANDS):
                wrong += [f"{name}: {line}: {fault}" for fault in faults_of(way, line, end)]
    assert not wrong, "\n".join(wrong)
