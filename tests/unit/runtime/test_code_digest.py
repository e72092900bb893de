"""The digest of a compiled function changes with what is compiled into it, and with nothing else."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from services.numerics.code_digest import code_digest
from services.numerics.compiled import chosen_step

FORCES = '''
from typing import NamedTuple
"""Forces."""
STIFFNESS_N_PER_M, DAMPING_N_S_PER_M = 2.0, 3.0
TABLE = (1.0, 2.0)

class Spring(NamedTuple):
    k: float
    b: float = 0.5

class Wall(NamedTuple):
    k: float

def spring(params, x):
    """Return the force."""
    return params.k * x + STIFFNESS_N_PER_M

def wall(params, x):
    return -spring(params, x)

def unused(x):
    return x + DAMPING_N_S_PER_M
'''
LOOP = """
import forces
from forces import Wall

def alone(x):
    return x * 2.0

def direct(params, x, gain=3.0):
    return gain * forces.wall(params, x)

def by_choice(params, x):
    return force_of(params, x)

def builds(x):
    return force_of(Wall(1.0), x)

def scaled(x):
    return [forces.TABLE[0] * x for _ in range(2)]
"""


def modules(name: str = "", old: str = "", new: str = "") -> dict[str, str]:
    """Return the digests of the functions of LOOP, after a replacement in one of the two sources."""
    sources = {"forces": FORCES, "loop": LOOP}
    if name:
        assert old in sources[name]
        sources[name] = sources[name].replace(old, new)
    forces, loop = ModuleType("forces"), ModuleType("loop")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "forces", forces)
        # "services." makes a module ours, whose attributes are looked into
        patch.setattr("services.numerics.code_digest._OWN_PACKAGES", ("forces",))
        exec(sources["forces"], vars(forces))
        steps = {forces.Spring: forces.spring, forces.Wall: forces.wall}
        loop.force_of = chosen_step(lambda kind: steps[kind])  # type: ignore[attr-defined]
        exec(sources["loop"], vars(loop))
        names = ("alone", "direct", "builds", "scaled")
        found = {name: code_digest(getattr(loop, name)) for name in names}
        for kind in (forces.Spring, forces.Wall):
            found[kind.__name__] = code_digest(loop.by_choice, [kind])
        return found


def changed(name: str, old: str, new: str) -> set[str]:
    before, after = modules(), modules(name, old, new)
    return {function for function in before if before[function] != after[function]}


def test_the_digest_is_the_same_for_the_same_code() -> None:
    first = modules()
    assert first == modules()
    assert len(set(first.values())) == len(first)


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("forces", "def unused", "# a comment\n\ndef unused", ""),
        ("forces", "Return the force.", "Return another text.", ""),
        ("forces", "x + DAMPING", "x - DAMPING", ""),
        ("forces", "DAMPING_N_S_PER_M = 2.0, 3.0", "DAMPING_N_S_PER_M = 2.0, 4.0", ""),
        ("forces", "return -spring", "return spring", "direct Wall builds"),
        ("forces", "params.k * x", "params.k / x", "direct Wall builds Spring"),
        ("forces", "= 2.0, 3.0", "= 3.0, 2.0", "direct Wall builds Spring"),
        ("forces", "(1.0, 2.0)", "(2.0, 1.0)", "scaled"),
        # a field is found by its place
        ("forces", "    k: float\n    b: float = 0.5", "    b: float\n    k: float = 0.5", "Spring"),
        (
            "forces",
            "class Wall(NamedTuple):\n    k: float",
            "class Wall(NamedTuple):\n    k: float = 1.0",
            "builds Wall",
        ),
        ("loop", "gain=3.0", "gain=-3.0", "direct"),
        ("loop", "Wall(1.0)", "Wall(-1.0)", "builds"),
        ("loop", "range(2)", "range(3)", "scaled"),
        ("loop", "\ndef alone", "\n\n\ndef alone", ""),
        ("loop", "forces.wall(", "forces.spring(", "direct"),
    ],
)
def test_it_changes_with_what_is_compiled_into_it(name: str, old: str, new: str, expected: str) -> None:
    assert changed(name, old, new) == set(expected.split())


def test_the_code_of_a_package_counts_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "my_law.py").write_text("def step(x):\n    return x\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("services.numerics.code_digest.modules", lambda: ("my_law.",))
    digests = iter(("sha256:1", "sha256:2", "sha256:2"))
    monkeypatch.setattr("services.numerics.code_digest.digest_of", lambda module: next(digests))
    import my_law  # type: ignore[import-not-found]

    assert code_digest(my_law.step) != code_digest(my_law.step)
    monkeypatch.delitem(sys.modules, "my_law")
