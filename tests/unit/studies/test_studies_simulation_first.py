"""The first session of its kind runs as plain Python while another process compiles; later ones run compiled."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from presets import find_scenario
from services.numerics import compiled_beside
from services.runtime.settings.config import merge, read_yaml
from studies.loops.simulation import SimulatedSession, simulate_document, simulate_scenario

ROOT = Path(__file__).parents[3]


def marks_of(cache: Path) -> list[Path]:
    return [path for path in cache.rglob("sessions/*") if path.name != "lock"]


class Machine:
    """A machine with an empty cache, a compiler that is plain Python, and processes that never run."""

    def __init__(self, cache: Path) -> None:
        self.cache = cache
        self.compiled = 0
        self.started: list[tuple[Path, Any, Any]] = []

    def form(self, step: Callable[..., Any]) -> Callable[..., Any]:
        self.compiled += 1
        return step

    def start(self, call: Any, lock: int) -> None:
        self.started.append(compiled_beside.pickle.load(call))

    def did(self) -> tuple[int, int]:
        """Return how many sessions ran compiled and how many processes were started since this was asked last."""
        done = self.compiled, len(self.started)
        self.compiled, self.started = 0, []
        return done

    @property
    def marks(self) -> list[Path]:
        return marks_of(self.cache)


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    made = Machine(tmp_path / "cache")
    for name in (compiled_beside.COMPILE_FIRST, "NUMBA_CACHE_DIR", "NUMBA_DISABLE_JIT"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(made.cache))
    monkeypatch.setattr(compiled_beside, "compiled_form", made.form)
    monkeypatch.setattr(compiled_beside, "start", made.start)
    monkeypatch.setattr(compiled_beside, "kept_digest", lambda modules: "these sources")
    monkeypatch.setattr(compiled_beside, "_plain_ticks", 0)
    return made


def session(**given: Any) -> SimulatedSession:
    return simulate_scenario("fig12", duration_s=0.02, **given)


def test_the_first_session_is_plain_and_those_after_the_compiler_are_compiled(machine: Machine) -> None:
    first = session()
    [call] = machine.started
    assert machine.did() == (0, 1)
    compiled_beside.compile_call(*call)
    assert machine.did() == (1, 0)
    second = session()
    assert machine.did() == (1, 0)
    for name in first:
        assert np.array_equal(first[name], second[name], equal_nan=first[name].dtype.kind == "f")


def test_a_law_or_a_sample_of_its_own_is_another_kind_and_a_number_is_not(machine: Machine) -> None:
    session()
    compiled_beside.compile_call(*machine.started[0])
    machine.did()
    session(round_trip_ms=20.0, settings={"controller.virtual_impedance.force_gain": 10})
    assert machine.did() == (1, 0)
    for given in ({"law": "wave"}, {"environment": "spring"}):
        session(**given)
        assert machine.did() == (0, 1)


def test_the_compiling_process_needs_one_tick_and_a_failure_of_it_makes_no_mark(machine: Machine) -> None:
    session()
    path, step, few = machine.started[0]
    assert few[5].ticks == 1

    def fails(*given: Any) -> None:
        raise ValueError("it cannot be compiled")

    with pytest.raises(ValueError, match="cannot be compiled"):
        compiled_beside.compile_call(path, fails, few)
    assert machine.marks == []
    compiled_beside.compile_call(path, step, few)
    assert machine.marks == [path]


def test_an_edit_of_the_sources_makes_it_plain_again(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    session()
    compiled_beside.compile_call(*machine.started[0])
    machine.did()
    monkeypatch.setattr(compiled_beside, "kept_digest", lambda modules: "other sources")
    session()
    assert machine.did() == (0, 1)


def test_a_mark_in_use_is_kept_and_an_old_one_goes_with_the_code(machine: Machine) -> None:
    session()
    compiled_beside.compile_call(*machine.started[0])
    [mark] = machine.marks
    os.utime(mark, (0.0, 0.0))
    session()
    assert time.time() - mark.stat().st_mtime < 86_400.0
    os.utime(mark, (0.0, 0.0))
    from services.numerics.compiled import cache_directory, clean_cache

    assert mark in clean_cache(cache_directory(), time.time())


def test_a_process_that_goes_on_compiles(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_beside, "PLAIN_TICKS", 1000)
    # each has 320 ticks, with the coming to rest before it
    for _ in range(3):
        session()
    assert machine.did() == (0, 3)
    session()
    assert machine.did() == (1, 0)
    # it has left its mark
    session(round_trip_ms=1.0)
    assert machine.did() == (1, 0)
    assert len(machine.marks) == 1


@pytest.mark.parametrize("name", [compiled_beside.COMPILE_FIRST, "NUMBA_DISABLE_JIT"])
def test_a_variable_of_the_environment_keeps_it_as_it_was(
    name: str, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(name, "1")
    session()
    assert machine.did() == (1, 0)
    assert machine.marks == []


def test_what_must_not_be_kept_is_compiled_first(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_beside, "kept_digest", lambda modules: "")
    session()
    assert machine.did() == (1, 0)


def test_where_the_cache_cannot_be_written_it_compiles_first(machine: Machine) -> None:
    machine.cache.write_text("a file in the place of the folder")
    session()
    assert machine.did() == (1, 0)


def test_one_session_of_many_compiles_first(machine: Machine, plain_loop: None) -> None:
    document = merge(read_yaml(find_scenario("fig12")), {"duration_s": 0.02})
    simulate_document(document, "a test")
    assert machine.did() == (0, 0)


def test_one_process_compiles_at_a_time_and_one_that_was_killed_blocks_none(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    children = []

    def start(call: Any, lock: int) -> None:
        sleeps = [sys.executable, "-c", "import time; time.sleep(600)"]
        children.append(subprocess.Popen(sleeps, pass_fds=(lock,)))

    monkeypatch.setattr(compiled_beside, "start", start)
    try:
        session()
        session()
        session(law="wave")
        assert len(children) == 1
        children[0].kill()
        children[0].wait()
        session()
        assert len(children) == 2
    finally:
        for child in children:
            child.kill()
            child.wait()
    assert machine.did() == (0, 0)
    assert machine.marks == []


PROGRAM = """
import sys
from presets import find_scenario
from services.numerics import compiled_beside
from services.runtime.settings.config import merge, read_yaml
from studies.loops.simulation import simulate_scenario

found = simulate_scenario("fig12", duration_s=0.5)
print("numba" in sys.modules, found["base_position_m"].tobytes().hex())
for child in compiled_beside._compiling:
    assert child.wait() == 0
"""


@pytest.mark.endurance
def test_the_process_compiles_what_the_next_session_finds(tmp_path: Path) -> None:
    left = {name: value for name, value in os.environ.items() if name != compiled_beside.COMPILE_FIRST}
    environment = {**left, "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    environment.pop("NUMBA_CACHE_DIR", None)
    said = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        said.append(done.stdout.split())
        kept = {path.name: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nbc")}
    assert [loaded for loaded, _ in said] == ["False", "True"]
    assert said[0][1] == said[1][1]
    # the second session has compiled nothing
    assert kept
    assert max(kept.values()) <= min(path.stat().st_mtime_ns for path in marks_of(tmp_path))
