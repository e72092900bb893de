"""Tuples in compiled code: numba does not fill in the defaults of a NamedTuple, so steps give every field."""

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import pytest

from services.controller.law import NO_SIGNAL, PortSignal, port_signal
from services.numerics.compiled import compiled, compiled_form

ROOT = Path(__file__).resolve().parents[3]
MARKS = {"compiled", "inlined", "always_compiled"}
MODULES = [
    path.relative_to(ROOT)
    for package in ("services", "studies")
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
