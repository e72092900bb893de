"""Tuples in compiled code: numba does not fill in the defaults of a NamedTuple, so steps give every field."""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from telenano.laws.law import NO_SIGNAL, PortSignal, port_signal
from telenano.numerics.compiler import borrowed, compiled, compiled_form

ROOT = Path(__file__).resolve().parents[3]
MARKS = {"compiled", "inlined", "always_compiled"}
MODULES = [
    path.relative_to(ROOT)
    for package in ("services", "telenano")
    for path in sorted((ROOT / package).rglob("*.py"))
    if any(f"\n@{mark}\n" in path.read_text() for mark in MARKS)
]


class Pair(NamedTuple):
    """A tuple with a default."""

    first: float
    second: float = 2.0


def resolved(module: ModuleType, node: ast.expr) -> Any:
    """Return what a name or an attribute of a module stands for, None for anything else."""
    if isinstance(node, ast.Name):
        return getattr(module, node.id, None)
    return getattr(resolved(module, node.value), node.attr, None) if isinstance(node, ast.Attribute) else None


def incomplete_tuples(tree: ast.Module, module: ModuleType) -> Iterator[str]:
    """Yield each NamedTuple that a marked step makes without naming or giving all of its fields."""
    for step in ast.walk(tree):
        if not (isinstance(step, ast.FunctionDef) and MARKS & {ast.unparse(mark) for mark in step.decorator_list}):
            continue
        for call in (node for node in ast.walk(step) if isinstance(node, ast.Call)):
            kind = resolved(module, call.func)
            if isinstance(kind, type) and hasattr(kind, "_fields"):
                given = [*call.args, *call.keywords]
                if len(given) != len(kind._fields):
                    yield f"{step.name}, line {call.lineno}: {kind.__name__} with {len(given)} of {len(kind._fields)}"


@pytest.mark.parametrize("path", MODULES, ids=str)
def test_every_tuple_in_a_compiled_step_is_given_all_of_its_fields(path: Path) -> None:
    module = importlib.import_module(".".join(path.with_suffix("").parts))
    assert list(incomplete_tuples(ast.parse((ROOT / path).read_text()), module)) == []


def test_a_missing_field_is_found() -> None:
    source = "@compiled\ndef step(x):\n    return Pair(x), Pair(x, 1.0), Pair(second=x)\n"
    module = importlib.import_module(__name__)
    assert [found.rsplit(": ", 1)[1] for found in incomplete_tuples(ast.parse(source), module)] == [
        "Pair with 1 of 2",
        "Pair with 1 of 2",
    ]


@compiled
def _silent_second(x: float) -> float:
    return Pair(x).second


@compiled
def _signals(x: float) -> tuple[PortSignal, PortSignal]:
    return port_signal(position_m=x, active=True), port_signal(x, force_n=x, silence_s=1.0)


def test_numba_leaves_a_default_of_a_tuple_out() -> None:
    # the reason of the rule above: where this begins to pass, tuples of steps may have defaults
    assert _silent_second(1.0) == 2.0
    numba = pytest.importorskip("numba")
    with pytest.raises((numba.core.errors.NumbaError, TypeError)):
        compiled_form(_silent_second)(1.0)


def test_a_signal_by_names_is_the_same_compiled() -> None:
    moving, pressing = _signals(3.0)
    assert compiled_form(_signals)(3.0) == (moving, pressing)
    assert moving == NO_SIGNAL._replace(position_m=3.0, active=True, silence_s=0.0)
    assert pressing == NO_SIGNAL._replace(position_m=3.0, force_n=3.0, silence_s=1.0)


@compiled
def _first_of(pair: Pair) -> float:
    return pair.first


@compiled
def _through(pair: Pair) -> float:
    return _first_of(pair) + pair.second


class Kept(NamedTuple):
    """A state with an array."""

    values: npt.NDArray[np.float64]
    sum: float


@compiled
def _next(kept: Kept, n: int) -> Kept:
    values = kept.values.copy()
    values[n % len(values)] += 1.0
    return Kept(values, kept.sum + values[0])


@compiled
def _many(start: Kept, count: int) -> Kept:
    # what is made of a borrowed array has a count again
    state = borrowed(start)
    for n in range(count):
        state = _next(state, n)
    return state


def test_arrays_in_the_states_of_steps_are_freed() -> None:
    start, run = Kept(np.zeros(4), 0.0), compiled_form(_many)
    run(start, 1)
    numba_memory = pytest.importorskip("numba.core.runtime").rtsys
    memory = pytest.importorskip("numba.core.runtime._nrt_python")
    memory.memsys_enable_stats()
    before = numba_memory.get_allocation_stats()
    kept = run(start, 1000)
    after = numba_memory.get_allocation_stats()
    assert kept.values.tolist() == [250.0] * 4
    # what Python was given is all that is left
    assert after.alloc - before.alloc >= 1000
    assert after.alloc - before.alloc - (after.free - before.free) <= 1
    assert start.values.tolist() == [0.0] * 4


class Around(NamedTuple):
    """A tuple of tuples with arrays and without."""

    alike: tuple[Kept, Kept]
    nothing: None
    number: int


@compiled
def _second_of(around: Around) -> npt.NDArray[np.float64]:
    return borrowed(around).alike[1].values[1:]


def test_a_borrowed_array_is_that_of_the_caller_and_has_no_count() -> None:
    pytest.importorskip("numba")
    around = Around((Kept(np.zeros(4), 0.0), Kept(np.ones(4), 1.0)), None, 3)
    second = compiled_form(_second_of)(around)
    assert _second_of(around).base is around.alike[1].values
    assert second.ctypes.data == _second_of(around).ctypes.data
    # numba gives Python an array without an owner where there is no count of references to its memory
    assert second.base is None
    assert not second.flags.owndata


def test_a_step_that_compiled_code_has_called_can_be_called_by_python_too() -> None:
    # the form that only compiled code calls does not unpack the tuples of Python
    assert compiled_form(_through)(Pair(1.0, 2.0)) == 3.0
    assert compiled_form(_first_of)(Pair(4.0, 2.0)) == 4.0
