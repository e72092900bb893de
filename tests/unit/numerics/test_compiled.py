"""Compiled code is found again on unchanged sources and never after an edit."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from telenano.numerics.digests import (
    KEPT_FOLDERS,
    SOURCES,
    _source_files,
    cache_directory,
    remove_unused,
    source_digest,
)
from telenano.testing import describe_package

ROOT = Path(__file__).parents[3]
# errors, models of settings and messages, and what loads packages: nothing of them is compiled
NO_CONSTANTS = {
    "telenano.settings.known_packages",
    *("telenano.wire.errors", "telenano.settings.plugins"),
    *("telenano.settings.config", "telenano.settings.option"),
    # the texts of lengths in sentences
    "telenano.wire.lengths",
    # its functions reckon with results, and no step calls them
    "telenano.analysis.intervals",
}
USERS_CACHE = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")

MODULE = """
from typing import NamedTuple
from telenano.numerics.compiler import compiled

class State(NamedTuple):
    position_m: float
    steps: int

@compiled
def step(state: State, dt_s: float) -> State:
    return State(state.position_m + 2.0 * dt_s, state.steps + 1)

def unmarked(x):
    return x

@compiled
def twice(x):
    return 2 * x

@compiled
def calls_unmarked(x):
    return unmarked(x)
"""
PROGRAM = """
import model
from telenano.numerics.compiler import compiled_form
step = compiled_form(model.step)
assert step(model.State(1.0, 0), 0.25) == model.step(model.State(1.0, 0), 0.25) == (1.5, 1)
print(type(model.step).__name__, type(step).__name__)
"""
# What is compiled into the folder of a user, and when: where the change touches it.
KEPT = pytest.mark.drawn(0.0, "telenano/numerics/")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in ("telenano/afm/forces.py", "telenano/extend/laws.py", "telenano/lockstep/loop.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True)
        path.write_text("A = 1\n")
    return tmp_path


def test_the_digest_is_the_same_on_unchanged_sources(tree: Path) -> None:
    first = source_digest(tree)
    (tree / "telenano" / "lockstep" / "loop.py").touch()
    assert source_digest(tree) == first
    assert len(first) == 16
    assert int(first, 16) >= 0


def test_every_edit_of_a_source_gives_another_digest(tree: Path) -> None:
    seen = {source_digest(tree)}
    law = tree / "telenano" / "extend" / "laws.py"
    law.write_text("A = 2\n")
    seen.add(source_digest(tree))
    law.rename(law.with_name("wave.py"))
    seen.add(source_digest(tree))
    deep = tree / "telenano" / "afm" / "contact"
    deep.mkdir()
    (deep / "dugdale.py").write_text("")
    seen.add(source_digest(tree))
    (deep / "dugdale.py").unlink()
    assert source_digest(tree) in seen
    assert len(seen) == 4


def test_processes_and_other_files_hold_no_compiled_code(tree: Path) -> None:
    first = source_digest(tree)
    (tree / "services" / "afm_node").mkdir(parents=True)
    for name in ("services/afm_node/node.py", "telenano/afm/notes.md", "telenano/figures.py"):
        (tree / name).write_text("B = 1\n")
    assert source_digest(tree) == first


def test_the_folder_lies_in_the_cache_of_the_user_unless_numba_is_given_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert cache_directory() == tmp_path / "cache" / "telenano"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_directory() == tmp_path / ".cache" / "telenano"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    assert cache_directory() == tmp_path / "numba"


def install(folder: Path, package: str, kind: str = "laws") -> None:
    """Make a module in a folder that of an installed package with an entry."""
    describe_package(folder, package, {kind: {package: f"{package}:LAW"}})


def write_model(folder: Path, *, installed: bool = True) -> None:
    (folder / "model.py").write_text(MODULE)
    if installed:
        install(folder, "model")


def environment_of(folder: Path, **environment: str) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    paths = os.pathsep.join((str(folder), str(ROOT)))
    return {**kept, "PYTHONPATH": paths, "XDG_CACHE_HOME": str(folder), **environment}


def run_step(folder: Path, program: str = PROGRAM, *, installed: bool = True, **environment: str) -> str:
    write_model(folder, installed=installed)
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=environment_of(folder, **environment),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.check("takes 1.2 s")
def test_a_step_is_compiled_into_that_folder(tmp_path: Path) -> None:
    assert run_step(tmp_path) == "function InterruptibleDispatcher"
    (folder,) = (tmp_path / "telenano").iterdir()
    assert re.fullmatch("numba-[0-9a-f]{16}", folder.name)
    assert list(folder.rglob("*.nbc")), "no compiled code in the cache"
    # no other user can put anything there, whatever the umask
    assert folder.stat().st_mode & 0o777 == 0o700
    assert not list(ROOT.glob("telenano/runtime/__pycache__/*.nb?"))


# spoils each file of the cache in each way, and runs the step as a process that starts then would
SPOIL = """
import logging, os, model
from numba.core import config
from telenano.numerics import numba_parts
from telenano.numerics.compiler import compiled, compiled_form
from telenano.numerics.digests import cache_folder

def run():
    said.clear()
    numba_parts._warn.cache_clear()
    numba_parts._is_safe.cache_clear()
    # as a process that starts now: it has loaded nothing
    step = compiled_form(compiled(model.step))
    assert step(model.State(1.0, 0), 0.25) == (1.5, 1)
    return sum(step.stats.cache_hits.values()), list(said)

said = []
handler = logging.Handler()
handler.emit = lambda record: record.getMessage().startswith("compiling") or said.append(record.getMessage())
logging.getLogger().addHandler(handler)
print(run())
for kind in ("nbc", "nbi"):
    # what a crash of the machine leaves of a file
    for left in (lambda size: content[: size // 2], lambda size: b"", bytes):
        kept = max(cache_folder().rglob(f"*.{kind}"), key=lambda path: path.stat().st_mtime_ns)
        content = kept.read_bytes()
        kept.write_bytes(left(len(content)))
        assert run() == (0, [f"the compiled code in {cache_folder()} is incomplete, and is compiled again"]), run()
        # and is sound afterwards
        assert run() == (1, [])
# a process that ended between the two files, which are written one after the other
for path in cache_folder().rglob("*.nbc"):
    path.unlink()
assert [run(), run()] == [(0, []), (1, [])]

# Nothing of a folder that others can write is ever unpickled.
others = [lambda: cache_folder().chmod(0o777), lambda: cache_folder().chmod(0o720)]
others.append(lambda: cache_folder().parent.chmod(0o777))
if os.getuid() == 0:
    others.append(lambda: os.chown(cache_folder(), 12345, -1))
for spoil in others:
    spoil()
    found = [f"the compiled code in {cache_folder()} can be written by others, and is not used"]
    assert [run(), run()] == [(0, found), (0, found)]
    os.chown(cache_folder(), os.getuid(), -1)
    cache_folder().chmod(0o700)
    cache_folder().parent.chmod(0o700)
    assert run() == (1, [])

# code that checks its indices is neither found as the other, nor left for it
config.BOUNDSCHECK = 1
assert [run(), run()] == [(0, []), (1, [])]
config.BOUNDSCHECK = None
assert run() == (1, [])

def full(*_):
    raise OSError(28, "No space left on device")

for path in cache_folder().rglob("*.nb?"):
    path.unlink()
numba_parts._Files._open_for_write = full
assert run() == (0, [f"compiled code cannot be kept in {cache_folder()}: No space left on device"])
print("all")
"""


@pytest.mark.check("takes 1.2 s")
@KEPT
def test_incomplete_or_foreign_code_is_never_run_and_what_cannot_be_kept_is_used(tmp_path: Path) -> None:
    assert run_step(tmp_path, SPOIL).splitlines() == ["(0, [])", "all"]


READ_ONLY = (
    PROGRAM
    + """
print(sum(step.stats.cache_hits.values()))
"""
)


@pytest.mark.check("takes 1.4 s")
@KEPT
def test_a_folder_that_cannot_be_written_is_read_and_left_as_it_is(tmp_path: Path) -> None:
    assert run_step(tmp_path, READ_ONLY).split()[-1] == "0"
    # as the system of files of an image: root may write wherever the mode forbids it
    program = (
        """
import os, tempfile
def refused(*_, **__):
    raise OSError(30, "Read-only file system")
os.utime = os.mkdir = os.replace = tempfile.TemporaryFile = refused
"""
        + READ_ONLY
    )
    assert run_step(tmp_path, program).split()[-1] == "1"


# The second process reads the index before the first has written it, and writes after it, but for the code itself.
AT_ONCE = """
import model
from numba.core.caching import IndexDataCacheFile
from telenano.numerics.compiler import compiled, compiled_form

def run(value):
    result = compiled_form(compiled(model.twice))(value)
    return result, type(result).__name__

save_index, waiting = IndexDataCacheFile._save_index, []
def interleaved(*of_a_process):
    waiting.append(of_a_process)
    if len(waiting) == 1:
        run(2)
    else:
        for each in waiting:
            save_index(*each)
IndexDataCacheFile._save_index = interleaved
run(2.5)
IndexDataCacheFile._save_index = save_index
assert len(waiting) == 2
print(run(2.5), run(2))
"""


@pytest.mark.check("takes 1.8 s")
@KEPT
def test_two_processes_that_compile_at_once_never_find_the_code_of_each_other(tmp_path: Path) -> None:
    assert run_step(tmp_path, AT_ONCE) == "(5.0, 'float') (4, 'int')"


FORCE = """
from typing import NamedTuple
from telenano.numerics.compiler import compiled

class Spring(NamedTuple):
    k: float
    b: float

@compiled
def spring(params, x):
    return params.k * x
"""
LOOP = """
from pack import force
from telenano.numerics.compiler import chosen_step, compiled

STEPS = {force.Spring: force.spring}
step = chosen_step(lambda kind: STEPS[kind])

@compiled
def loop(params, count):
    x = 1.0
    for _ in range(count):
        x = step(params, x)
    return x
"""
RUN = """
import os, pathlib
from pack import force, loop
from telenano.numerics.compiler import compiled_form
for line in os.environ.get("EDIT", "").splitlines():
    pathlib.Path(force.__file__).write_text(line)
loop = compiled_form(loop.loop)
print(loop(force.Spring(k=2.0, b=5.0), 2), sum(loop.stats.cache_hits.values()))
"""


def write_package(folder: Path, force: str) -> None:
    pack = folder / "pack"
    pack.mkdir(exist_ok=True)
    for name, text in (("__init__", ""), ("force", force), ("loop", LOOP)):
        (pack / f"{name}.py").write_text(text)


@pytest.mark.endurance("compiles in a folder of its own, several times")
@pytest.mark.parametrize(("kind", "folders"), [("laws", 3), ("commands", 1)])
def test_an_edited_package_never_runs_the_code_of_before(tmp_path: Path, kind: str, folders: int) -> None:
    install(tmp_path, "pack", kind)
    edits = (FORCE, FORCE.replace("params.k", "10.0 * params.k"), FORCE.replace("k: float\n    b", "b: float\n    k"))
    for edited, expected in zip(edits, ("4.0", "400.0", "4.0"), strict=True):
        write_package(tmp_path, edited)
        # the time of a file is no evidence: it can be set back
        os.utime(tmp_path / "pack" / "force.py", (1e9, 1e9))
        assert run_step(tmp_path, RUN) == f"{expected} 0"
        assert run_step(tmp_path, RUN) == f"{expected} 1"
    # what no scenario can name leaves the code of everything else as it is
    assert len([*(tmp_path / "telenano").glob("numba-*")]) == folders


@pytest.mark.check("takes 1.5 s")
@KEPT
def test_a_package_that_is_edited_while_a_process_runs_leaves_no_code(tmp_path: Path) -> None:
    install(tmp_path, "pack")
    write_package(tmp_path, FORCE)
    # the process has imported what the file no longer says
    assert run_step(tmp_path, RUN, EDIT="raise SystemExit") == "4.0 0"
    assert not list((tmp_path / "telenano").rglob("loop*.nbc"))


@pytest.mark.check("takes 3.0 s")
@KEPT
def test_what_is_of_no_package_is_compiled_by_each_process(tmp_path: Path) -> None:
    for _ in range(2):
        run_step(tmp_path, PROGRAM + "assert not step.stats.cache_hits", installed=False)
    assert not list((tmp_path / "telenano").rglob("*.nbc"))


def test_what_steps_import_from_the_project_is_in_the_digest() -> None:
    """A constant from elsewhere would be compiled in, and an edit of it would not be noticed."""
    outside = set()
    for path in _source_files(ROOT):
        text = path.read_text()
        if "numerics.compiler import" in text and path.parent.name != "numerics":
            outside |= set(re.findall(r"^from ((?:services|telenano)[\w.]*) import", text, re.M))
    known = tuple(source.removesuffix(".py").replace("/", ".") for source in SOURCES)
    assert {name for name in outside if not name.startswith(known)} <= NO_CONSTANTS


def test_without_the_compiler_a_step_is_plain_python_with_the_same_result(tmp_path: Path) -> None:
    assert run_step(tmp_path, NUMBA_DISABLE_JIT="1") == "function function"
    assert not list(tmp_path.rglob("*.nb?"))


@pytest.mark.check("takes 1.4 s")
def test_nodes_compile_nothing_and_need_no_compiler(tmp_path: Path) -> None:
    nodes = "services.haptic_node, services.controller, services.afm_node, services.delay_node, services.recorder"
    imports = ", ".join(f"{name.strip()}.__main__" for name in nodes.split(","))
    program = f"import sys, {imports}; print(sorted({{'numba', 'scipy', 'llvmlite'}} & set(sys.modules)))"
    assert run_step(tmp_path, program) == "[]"
    assert not list(tmp_path.rglob("*.nb?"))


LOCKSTEP = """
import hashlib, telenano
from telenano.lockstep import lockstep
lockstep.PLAIN_TICKS = 0
done = telenano.simulate(duration_s=1.0)
print(hashlib.sha256(done["scaled_tip_force_n"].tobytes() + done["time_s"].tobytes()).hexdigest())
"""


def run_simulation(folder: Path, before: str = "") -> str:
    """Run a simulation after something, without a package: with one its compiled code would replace that of others."""
    return run_step(folder, f"{before}\n{LOCKSTEP}", installed=False, XDG_CACHE_HOME=USERS_CACHE)


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the digest of a simulation in a process of its own."""
    return run_simulation(tmp_path_factory.mktemp("simulated"))


@pytest.mark.endurance("compiles the loop in a folder of its own, once for each import")
@pytest.mark.parametrize(
    "before",
    [
        "import telenano.lockstep.simulation",
        "from telenano.lockstep.law_rules import broken_rules",
        "import telenano.afm.cantilever",
    ],
)
def test_a_simulation_does_not_depend_on_what_was_imported_before(tmp_path: Path, simulated: str, before: str) -> None:
    assert run_simulation(tmp_path, before) == simulated


@pytest.mark.check("takes 1.8 s")
def test_a_simulation_without_the_compiler_gives_the_same_bits(tmp_path: Path, simulated: str) -> None:
    program = "import sys; sys.modules['numba'] = None\n" + LOCKSTEP
    assert run_step(tmp_path, program) == simulated


@pytest.mark.check("takes 1.4 s")
@KEPT
def test_what_is_not_marked_is_named_by_the_compiler(tmp_path: Path) -> None:
    program = """
import model
from telenano.numerics.compiler import compiled_form
try:
    compiled_form(model.calls_unmarked)(1.0)
except Exception as error:
    print("unmarked" in str(error))
"""
    assert run_step(tmp_path, program) == "True"


@pytest.mark.check("takes 1.3 s")
@KEPT
def test_a_model_that_cannot_be_compiled_is_a_sentence_before_anything_ran(tmp_path: Path) -> None:
    program = """
import logging, model
from telenano.wire.errors import ConfigError
from telenano.numerics.compiler import compiled_call
said = []
handler = logging.Handler()
handler.emit = said.append
logging.getLogger("studies").addHandler(handler)
try:
    compiled_call(model.calls_unmarked, (1.0,))
except ConfigError as error:
    text = str(error)
assert text.startswith("a model of this session cannot be compiled: ") and "NUMBA_DISABLE_JIT=1" in text, text
assert "unmarked" in text and "model.py" in text and "\\x1b" not in text and "\\n" not in text, text
assert [record.getMessage()[:16] for record in said] == ["compiling models"]
print("said")
"""
    assert run_step(tmp_path, program) == "said"


def test_the_folders_of_compiled_code_that_were_used_last_are_kept(tmp_path: Path) -> None:
    names = [f"numba-{number:016x}" for number in range(KEPT_FOLDERS + 2)]
    for number, name in enumerate(names):
        (tmp_path / name / "afm").mkdir(parents=True)
        os.utime(tmp_path / name, (1e9 + number, 1e9 + number))
    # what else lies there is not ours
    for name in ("keys", "numba-of-mine"):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (1.0, 1.0))
    os.utime(tmp_path / names[0])
    remove_unused(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"keys", "numba-of-mine", names[0], *names[3:]}
