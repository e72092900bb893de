"""A recording cannot ask for more than it is: memory by its size, and each of its chunks a few times."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bounded_reading
import pytest
from forged_files import copied, repeated_index, wide_index
from made_sessions import BEGAN_NS, Made

pytestmark = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the memory is read from /proc")
ROOT = Path(__file__).parents[2]
_HANGS_S = 240.0
# So much more than a sound file of that size takes, and ten times what the file has more [MB]; so often all its chunks.
# What is not closed is read for its channels, for its times and for its messages.
_MORE_MB, _BY_SIZE, _MOST_TIMES = 200.0, 10.0, 3
_YEAR_NS = 365 * 86_400 * 10**9

CORPUS: dict[str, Callable[[Path, Path], Any]] = {
    "one of 1970 at the start": lambda sound, path: copied(sound, path, lambda at, ns: 0 if at == 0 else ns),
    "one of 1970 inside": lambda sound, path: copied(sound, path, lambda at, ns: 7 if at == 4000 else ns),
    "one of 2554": lambda sound, path: copied(sound, path, lambda at, ns: 2**64 - 2 if at == 4000 else ns),
    "one of 1970 in each chunk": lambda sound, path: copied(sound, path, lambda at, ns: 0 if at % 40 == 0 else ns),
    "over centuries": lambda sound, path: copied(sound, path, lambda at, ns: BEGAN_NS + at * _YEAR_NS // 20),
    "a pause of half a day": lambda sound, path: copied(
        sound, path, lambda at, ns: ns + (at > 4000) * 12 * 3600 * 10**9
    ),
    "a pause of half a day after each": lambda sound, path: copied(
        sound, path, lambda at, ns: BEGAN_NS + at * 12 * 3600 * 10**9
    ),
    "sent in 1970": lambda sound, path: copied(sound, path, sent=lambda at, ns: 1 if at % 500 == 3 else ns),
    "sent in 2554": lambda sound, path: copied(sound, path, sent=lambda at, ns: 2**64 - 2 if at == 4000 else ns),
    "backwards": lambda sound, path: copied(sound, path, lambda at, ns: 2 * BEGAN_NS - ns),
    "not closed, one of 1970": lambda sound, path: copied(
        sound, path, lambda at, ns: 0 if at == 4000 else ns, closed=False
    ),
    "an index of 30 times": lambda sound, path: path.write_bytes(repeated_index(sound.read_bytes(), "chunks", 30)),
    "attachments of 3000 times": lambda sound, path: path.write_bytes(
        repeated_index(sound.read_bytes(), "attachments", 3000)
    ),
    "metadata of 3000 times": lambda sound, path: path.write_bytes(
        repeated_index(sound.read_bytes(), "metadata", 3000)
    ),
    "all chunks from 0 on": lambda sound, path: path.write_bytes(wide_index(sound.read_bytes(), 0, 2**63)),
    "all chunks for a day": lambda sound, path: path.write_bytes(
        wide_index(sound.read_bytes(), BEGAN_NS, BEGAN_NS + 80_000 * 10**9)
    ),
}
# These are tried in each run of the tests, and the rest is left to the long one.
_CHEAP = [("one of 1970 inside", "view"), ("an index of 30 times", "bag info"), ("all chunks from 0 on", "view")]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sound")
    return copied(Made().write(folder), folder / "sound.mcap")


@pytest.fixture(scope="module")
def taken(sound: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], dict[str, Any]]:
    """Return what a command takes for the sound file, each asked for once."""
    known: dict[str, dict[str, Any]] = {}

    def of(command: str) -> dict[str, Any]:
        if command not in known:
            known[command] = reading(command, sound, tmp_path_factory.mktemp("twin"))
            # A command that refuses the sound file would have every other one pass.
            assert known[command]["outcome"] in ("read", "exit 0"), known[command]
        return known[command]

    return of


def reading(command: str, path: Path, folder: Path) -> dict[str, Any]:
    """Return what reading a file by a command in a process of its own came to."""
    (folder / "in").mkdir()
    done = subprocess.run(
        [sys.executable, "-P", bounded_reading.__file__, command, path, folder / "in"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(folder)}, capture_output=True, text=True,
        timeout=_HANGS_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0 and "Traceback" not in done.stderr, (command, path, done.stderr[-2000:])
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def check(name: str, command: str, sound: Path, taken: Callable[[str], dict[str, Any]], folder: Path) -> dict[str, Any]:
    path = folder / "made.mcap"
    CORPUS[name](sound, path)
    twin, whole = taken(command), taken("whole")
    found = reading(command, path, folder)
    assert found["peak_mb"] <= twin["peak_mb"] + _MORE_MB + _BY_SIZE * path.stat().st_size / 1e6, (found, twin)
    # The page plays a file over and over. The chunk of the one message that is out of place is looked at once more.
    most = _MOST_TIMES * max(whole["chunks"], twin["chunks"]) + 1
    assert found["chunks"] <= most, (name, command, found, twin)
    return found


@pytest.mark.check("takes 3.4 s")
@pytest.mark.parametrize(("name", "command"), _CHEAP)
def test_a_file_asks_for_no_more_than_it_is(
    sound: Path, taken: Callable[[str], dict[str, Any]], tmp_path: Path, name: str, command: str
) -> None:
    check(name, command, sound, taken, tmp_path)


@pytest.mark.endurance
@pytest.mark.parametrize("command", list(bounded_reading.COMMANDS))
def test_no_command_takes_more_for_any_file_than_it_is(
    sound: Path, taken: Callable[[str], dict[str, Any]], tmp_path: Path, command: str
) -> None:
    twin = taken(command)
    found = {}
    for number, name in enumerate(CORPUS):
        folder = tmp_path / str(number)
        folder.mkdir()
        found[name] = check(name, command, sound, taken, folder)
    largest = {key: max(each[key] for each in found.values()) for key in ("peak_mb", "processor_s", "chunks")}
    sys.stdout.write(f"{command}: sound {twin}, largest {largest}\n")
