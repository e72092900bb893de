"""Each pair of options of each command is run, or refused by a sentence: see `option_pairs.py`."""

import random
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from option_effects import COSTLY, SLOW
from option_pairs import TO_A_RIG, WORDS, faults_of, pairs

from telenano.cli.child_session import run_session
from telenano.wire.errors import RigError

SEED = 118
# The share of the pairs of quick commands that `make check` tries.
SHARE = 0.05
PAIRS = list(pairs())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of all commands: the files that are given there take a while to make."""
    return tmp_path_factory.mktemp("pairs")


@pytest.fixture(autouse=True)
def own_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(folder / "run"))
    monkeypatch.setenv("TELENANO_KEYS_DIR", str(folder / "keys"))

    def begin(*_: object) -> Any:
        raise RigError("the rig would begin here")

    def begin_child(command: Sequence[str], **how: Any) -> Any:
        return begin() if "up" in command else run_session(command, **how)

    # A rig has no virtual time: its options are tried up to the start of its processes.
    monkeypatch.setattr("telenano.cli.commands.up.run_rig", begin)
    monkeypatch.setattr("telenano.cli.sweep.run_session", begin_child)


def found_in(rows: Iterable[tuple[str, Any, Any]], folder: Path) -> list[str]:
    return [fault for row in rows for fault in faults_of(*row, folder)]


@pytest.mark.endurance("takes two hours")
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("command", WORDS)
def test_every_pair_of_options_keeps_the_promises(command: str, folder: Path) -> None:
    found = found_in((row for row in PAIRS if row[0] == command), folder)
    assert not found, "\n".join(found)


def drawn() -> list[tuple[str, Any, Any]]:
    """Return a twentieth of the pairs of quick commands, those of one command side by side."""
    quick = [row for row in PAIRS if row[0] not in (*COSTLY, *SLOW)]
    chosen = set(random.Random(SEED).sample(range(len(quick)), round(SHARE * len(quick))))
    return [row for place, row in enumerate(quick) if place in chosen]


@pytest.mark.check("takes a minute")
@pytest.mark.timeout(1800)
def test_a_twentieth_of_the_pairs_of_options_keeps_the_promises(folder: Path) -> None:
    found = found_in(drawn(), folder)
    assert not found, "\n".join(found)


def test_rows_are_of_commands_that_have_pairs() -> None:
    assert {name for name, _, _ in PAIRS} >= TO_A_RIG.keys()
