"""The docstring of a public function or class shows a call of it, and the call is one that it takes."""

import ast
import inspect
import re
import textwrap
from enum import Enum
from importlib import import_module
from typing import Any

import msgspec
import pytest
from public_names import counted
from pydantic import BaseModel

_BLOCK = re.compile(r"^ *Example:\n((?: {4,}.*\n?|\n)+)", re.MULTILINE)


def to_be_called() -> dict[str, Any]:
    """Return what a person calls, by its public name.

    Constants and types of annotations are read, errors are caught, messages are made and read by their topics, which
    have golden examples, and settings by their sections, whose schemas have these docstrings.
    """
    named = {f"{module}.{name}": getattr(import_module(module), name) for module, name in sorted(counted())}
    called = {name: getattr(made, "py_func", made) for name, made in named.items()}
    return {
        name: made
        for name, made in called.items()
        if inspect.isfunction(made)
        or (inspect.isclass(made) and not issubclass(made, BaseException | Enum | msgspec.Struct | BaseModel))
    }


PUBLIC = to_be_called()


def examples_in(documentation: str) -> list[ast.AST]:
    """Return the statements and expressions of the examples of a docstring."""
    plain = re.sub(r"^( *)(>>>|\.\.\.) ", r"\1", textwrap.dedent(documentation) + "\n", flags=re.MULTILINE)
    blocks = [textwrap.dedent(block) for block in _BLOCK.findall(plain)]
    return [part for block in blocks for part in ast.walk(ast.parse(block))]


def calls_in(documentation: str, name: str) -> list[ast.Call]:
    """Return the calls of a name, or of what it has, in the examples of a docstring."""
    calls = [part for part in examples_in(documentation) if isinstance(part, ast.Call)]
    return [part for part in calls if re.match(rf"{name}\b", ast.unparse(part.func))]


def is_inherited_in(documentation: str, name: str) -> bool:
    """Return whether an example has a class of a name, as that of a protocol has."""
    classes = [part for part in examples_in(documentation) if isinstance(part, ast.ClassDef)]
    return any(ast.unparse(base).partition("[")[0] == name for part in classes for base in part.bases)


def refused(made: Any, name: str, call: ast.Call) -> str:
    """Return why a call is not one that the function or class takes, empty if it is."""
    target = made
    for attribute in ast.unparse(call.func).removeprefix(name).split(".")[1:]:
        target = getattr(target, attribute)
    if any(isinstance(part, ast.Starred) for part in call.args) or any(word.arg is None for word in call.keywords):
        return ""
    try:
        inspect.signature(target).bind(*call.args, **{str(word.arg): word.value for word in call.keywords})
    except TypeError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("public", PUBLIC)
def test_a_public_name_shows_a_call_that_it_takes(public: str) -> None:
    made, name = PUBLIC[public], public.rpartition(".")[2]
    documentation = inspect.getdoc(made) or ""
    calls = calls_in(documentation, name)
    assert calls or is_inherited_in(documentation, name), f"{public}: its docstring needs an `Example:` with a call"
    assert not [text for call in calls if (text := refused(made, name, call))]


def test_a_call_with_other_arguments_is_found() -> None:
    call = calls_in("Return.\n\nExample:\n    where(1, of=2)\n", "where")[0]
    assert not refused(lambda place, of: 0, "where", call)
    assert "of" in refused(lambda place: 0, "where", call)
