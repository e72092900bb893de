"""Adaptations of numba: the place of compiled code, its calls, and borrowed arrays.

The cache is numba's, in a folder named by the digest of the sources, and borrowed arrays have no owner (ADR 0010). A
signal that arrives in compiled code is raised after the code has returned (ADR 0064).
"""

import contextlib
import logging
from collections.abc import Callable, Iterator
from functools import cache
from pickle import UnpicklingError
from threading import get_ident, main_thread
from typing import Any
from uuid import uuid4

from numba.core import cgutils, config, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile, UserProvidedCacheLocator
from numba.core.registry import CPUDispatcher
from numba.extending import lower_builtin, type_callable

from telenano.files.regular_files import is_own
from telenano.numerics.digests import cache_folder, further_digest
from telenano.signals import interrupts

_MAIN_THREAD = main_thread().ident
# numba declares no types for these two.
_numba: Any = CPUDispatcher
_call = _numba.__call__
_compile = _numba._compile_for_args
# numba declares only some of the types of these.
_build: Any = cgutils
_declare: Any = type_callable
_lower: Any = lower_builtin


class _Locator(UserProvidedCacheLocator):
    """Locates the compiled code of a function. A folder that cannot be written is still read."""

    def __init__(self, function: Any, source: str) -> None:
        super().__init__(function, source)

    def get_cache_path(self) -> str:
        return str(cache_folder() / self.get_suitable_cache_subpath(self._py_file))

    def get_source_stamp(self) -> str:
        return cache_folder().name

    @classmethod
    def from_function(cls, function: Any, source: str) -> "_Locator":
        return cls(function, source)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 - numba declares it so


class _Files(IndexDataCacheFile):
    """The cache files of one function: an index of its signatures, and a file for each signature."""

    def _data_name(self, number: int) -> str:
        # A unique name, because two processes that compile at once would use the same number for different code.
        return str(super()._data_name(number)).replace(".nbc", f".{uuid4().hex}.nbc")


class StepCache(FunctionCache):
    """The cache of one function, either in the form that Python can call or in that for compiled code only."""

    _impl_class = _Implementation

    def __init__(self, function: Any, python_calls: bool) -> None:
        super().__init__(function)
        self._cache_file.__class__ = _Files
        self._python_calls = python_calls

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the cached code for a signature; if there is none, warn that compilation takes some time."""
        overload = None
        if self._can_be_kept(sig):
            try:
                overload = super().load_overload(sig, target_context)
            except OSError:
                pass
            # A file that was not fully on the disk when the machine crashed.
            except (EOFError, UnpicklingError):
                _warn(f"the compiled code in {cache_folder()} is incomplete, and is compiled again")
                with contextlib.suppress(OSError):
                    self.flush()
        if overload is None and self._python_calls:
            _warn("compiling models, which takes some ten seconds once; `telenano doctor --warm` does it beforehand")
        return overload

    def has(self, sig: Any, target_context: Any) -> bool:
        """Return whether the code for a signature is on the disk."""
        if not self._can_be_kept(sig):
            return False
        try:
            return self._index_key(sig, target_context.codegen()) in self._cache_file._load_index()
        except (OSError, EOFError, UnpicklingError):
            return False

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save compiled code; if that fails, warn, and compile again in the next process."""
        if self._can_be_kept(sig):
            try:
                super().save_overload(sig, data)
            except OSError as error:
                _warn(f"compiled code cannot be kept in {cache_folder()}: {error.strerror}")

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        # Code with bounds checking (NUMBA_BOUNDSCHECK) needs its own entry.
        own = (self._python_calls, vars(config)["BOUNDSCHECK"], self._further_digest(sig))
        return (*super()._index_key(sig, codegen), *own)

    def _can_be_kept(self, signature: Any) -> bool:
        return self._further_digest(signature) is not None and _is_safe()

    def _further_digest(self, signature: Any) -> str | None:
        return further_digest({self._py_func.__module__, *(kind.__module__ for kind in _classes(signature))})


def _classes(part: Any) -> Iterator[type]:
    """Yield the classes of the named tuples in a signature: numba does not notice if their fields have changed."""
    if isinstance(part, tuple | list):
        for inner in part:
            yield from _classes(inner)
    elif isinstance(part, types.Type):
        if isinstance(part, types.BaseNamedTuple):
            # numba declares `instance_class` only in subclasses.
            named: Any = part
            yield named.instance_class
        for name in ("types", "dtype", "type"):
            yield from _classes(getattr(part, name, None))


@cache
def _is_safe() -> bool:
    """Return whether no other user can put code into the cache folder, or replace the folder."""
    folder = cache_folder()
    try:
        # If the folder is absent, `is_own` checks whether another user could create it.
        safe = is_own(folder)
    except OSError:
        safe = False
    if not safe:
        _warn(f"the compiled code in {folder} can be written by others, and is not used")
    return safe


@cache
def _warn(text: str) -> None:
    """Log a warning once in a process, because the same happens to the code of many functions."""
    logging.getLogger("studies").warning(text)


class InterruptibleDispatcher(CPUDispatcher):
    """A compiled function of numba that SIGINT and SIGTERM cannot interrupt in the middle."""

    _cache: Any

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        # Python runs signal handlers only in the main thread.
        if get_ident() != _MAIN_THREAD:
            return _call(self, *args, **keywords)
        interrupts.watch()
        interrupts.computing(True)
        try:
            return _call(self, *args, **keywords)
        finally:
            interrupts.computing(False)

    def is_ready(self, arguments: tuple[Any, ...]) -> bool:
        """Return whether a call with arguments of these types needs no compilation."""
        signature = tuple(map(self.typeof_pyval, arguments))
        return signature in self.overloads or self._cache.has(signature, self.targetctx)

    def _compile_for_args(self, *args: Any, **keywords: Any) -> Any:
        # The first call compiles, which takes seconds in plain Python and may be interrupted.
        if get_ident() != _MAIN_THREAD:
            return _compile(self, *args, **keywords)
        try:
            interrupts.computing(False)
            return _compile(self, *args, **keywords)
        finally:
            interrupts.computing(True)


def _without_owner(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.Array):
        array = _build.create_struct_proxy(kind)(context, builder, value=value)
        # numba does not count references to an array without an owner.
        array.meminfo = _build.get_null_value(array.meminfo.type)
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts: Any = kind
        for place, inner in enumerate(parts):
            part = _without_owner(context, builder, inner, builder.extract_value(value, place))
            value = builder.insert_value(value, part, place)
    return value


def _lowered(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return _without_owner(context, builder, signature.args[0], arguments[0])


def register_borrowed(function: Callable[..., object]) -> None:
    """Declare to numba a function that returns its argument with borrowed arrays; see `compiler.borrowed`."""
    _declare(function)(lambda context: lambda value: value)
    _lower(function, types.Any)(_lowered)
