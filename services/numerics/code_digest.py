"""Digest of a compiled function: of its code, and of everything that was compiled into it.

Compiled code contains the functions that it calls and the values of the constants that it names, from whatever file
they are. So what decides whether it may be used again is not the age of a file but this: the bytecode of the function
and of all that it reaches, the constants, and the fields of the tuples in its signature. An edit of a comment, of a
docstring, of a function that is not called, or of a file that only plots leaves it as it is.
"""

import enum
import hashlib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from presets.plugins import digest_of, modules
from services.numerics.compiled import CHOICE

_OWN_PACKAGES = ("proto", "presets", "services", "studies")


def code_digest(function: Callable[..., Any], classes: Iterable[type] = ()) -> str:
    """Return the digest (64 hex digits) of a function of plain Python that is compiled for a signature.

    Parameters: classes, the NamedTuples in the signature.
    """
    waiting: list[Any] = [function, *classes]
    seen: set[int] = set()
    kept: list[Any] = []
    parts: set[str] = set()
    choices: list[Callable[[type], Any]] = []
    kinds: list[type] = []
    while waiting:
        value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        # an object that is gone might lend its id to another
        kept.append(value)
        own, reached = _described(value)
        parts.add(own)
        waiting += reached
        new_choices = [choice for choice in (getattr(value, CHOICE, None),) if choice is not None]
        new_kinds = [value] if _is_tuple_class(value) else []
        choices += new_choices
        kinds += new_kinds
        # every class with every choice, once
        waiting += _chosen(new_choices, kinds)
        waiting += _chosen(choices, new_kinds)
    return hashlib.sha256("\n".join(sorted(parts)).encode()).hexdigest()


def _chosen(choices: Iterable[Callable[[type], Any]], kinds: Iterable[type]) -> Iterator[Any]:
    for choose in choices:
        for kind in kinds:
            # a class that is none of its parameters
            try:
                yield choose(kind)
            except KeyError:
                continue


def _described(value: Any) -> tuple[str, list[Any]]:
    """Return what distinguishes a value itself, and the values that it reaches."""
    value = getattr(value, "py_func", value)
    if isinstance(value, FunctionType):
        return _described_function(value)
    if _is_tuple_class(value):
        defaults = getattr(value, "_field_defaults", {})
        described = [(name, _constant(default)) for name, default in defaults.items()]
        return f"class {_name(value)} {value._fields} {described}", list(defaults.values())
    if isinstance(value, type):
        members = [(item.name, item.value) for item in value] if issubclass(value, enum.Enum) else ""
        return f"class {_name(value)} {members}", []
    if isinstance(value, tuple | list):
        return _constant(value), list(value)
    return _constant(value), []


def _described_function(function: FunctionType) -> tuple[str, list[Any]]:
    own = f"function {_name(function)} {_code(function.__code__, function.__doc__)}"
    package = function.__module__ + "."
    if package.startswith(modules()):
        # the code of others may depend on what is not seen here, such as a table that it reads
        own += digest_of(function.__module__)
    reached = [_cell(cell) for cell in function.__closure__ or ()]
    reached += [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    own += str([_constant(value) for value in reached])
    names = _names(function.__code__)
    spaces = [function.__globals__]
    found = [function.__globals__[name] for name in names if name in function.__globals__]
    # with their names: of two constants that change places both values are still there
    own += str([(name, _constant(function.__globals__[name])) for name in names if name in function.__globals__])
    for value in found:
        if isinstance(value, ModuleType) and vars(value) not in spaces:
            attributes = [name for name in names if name in vars(value)]
            own += str([(value.__name__, name, _constant(vars(value)[name])) for name in attributes])
            # what other libraries have comes with their versions
            reached += [vars(value)[name] for name in attributes if _is_ours(value.__name__)]
    return own, reached + found


@cache
def _code(code: CodeType, document: str | None) -> str:
    """Return the digest of code without its lines, docstring and comments."""
    constants = [
        _code(item, None) if isinstance(item, CodeType) else _constant(item)
        for item in code.co_consts
        if document is None or item != document
    ]
    counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    variables = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
    described = repr((code.co_code, code.co_exceptiontable, counts, variables, constants))
    return hashlib.sha256(described.encode()).hexdigest()


@cache
def _names(code: CodeType) -> tuple[str, ...]:
    """Return the names of globals and attributes that code uses, with those of the functions inside it."""
    inner = (name for item in code.co_consts if isinstance(item, CodeType) for name in _names(item))
    return tuple(sorted({*code.co_names, *inner}))


def _constant(value: Any) -> str:
    """Return a text that is the same in every process, and as exact as the value."""
    kind = _name(type(value))
    if isinstance(value, enum.Enum):
        return f"{kind} {value.name} {value.value!r}"
    if isinstance(value, bool | int | float | complex | str | bytes | slice | None):
        return f"{kind} {value!r}"
    if isinstance(value, frozenset):
        return f"{kind} {sorted(map(_constant, value))}"
    if isinstance(value, tuple | list):
        return f"{kind} {[_constant(item) for item in value]}"
    if isinstance(value, np.ndarray | np.generic):
        return f"{kind} {value.dtype.str} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, ModuleType):
        return f"{kind} {value.__name__}"
    return f"{kind} {getattr(value, '__module__', '')}.{getattr(value, '__qualname__', '')}"


def _cell(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:
        # of a name that is not bound yet, which nothing compiled can use
        return None


def _is_tuple_class(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in _OWN_PACKAGES or (module + ".").startswith(modules())


def _name(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"
