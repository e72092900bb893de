"""What the project changes of numba: where compiled code is kept, how it is called, and arrays that are borrowed.

The cache is numba's, in the folder that the digest of the sources names, and borrowed arrays have no owner (ADR 0010).
A signal that arrives in compiled code is raised when it has returned (ADR 0064).
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
from telenano.numerics.digests import cache_folder, digest_covers, stamp
from telenano.signals import interrupts

_MAIN_THREAD = main_thread().ident
# numba declares neither
_numba: Any = CPUDispatcher
_call = _numba.__call__
_compile = _numba._compile_for_args
# their declarations name only some of their types
_build: Any = cgutils
_declare: Any = type_callable
_lower: Any = lower_builtin


class _Locator(UserProvidedCacheLocator):
    """Where the code of a function is kept. A folder that cannot be written is read all the same."""

    def __init__(self, function: Any, source: str) -> None:
        super().__init__(function, source)
        self._stamp = stamp(function.__module__)

    def get_cache_path(self) -> str:
        return str(cache_folder() / self.get_suitable_cache_subpath(self._py_file))

    def get_source_stamp(self) -> str:
        return self._stamp

    @classmethod
    def from_function(cls, function: Any, source: str) -> "_Locator":
        return cls(function, source)


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012 - numba declares it so


class _Files(IndexDataCacheFile):
    """The files of one function: an index of its signatures, and a file for each."""

    def _data_name(self, number: int) -> str:
        # Two processes that compile at once would give their files the same number, and find each other's code.
        return str(super()._data_name(number)).replace(".nbc", f".{uuid4().hex}.nbc")


class StepCache(FunctionCache):
    """The cache of one function, in the form that Python can call or in that which only compiled code calls."""

    _impl_class = _Implementation

    def __init__(self, function: Any, python_calls: bool) -> None:
        super().__init__(function)
        self._cache_file.__class__ = _Files
        self._python_calls = python_calls

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is compiled for a signature; where nothing is, say that compiling it takes its time."""
        overload = None
        if self._can_be_kept(sig):
            try:
                overload = super().load_overload(sig, target_context)
            except OSError:
                pass
            # a file that the machine had not written to its disk when it crashed
            except (EOFError, UnpicklingError):
                _warn(f"the compiled code in {cache_folder()} is incomplete, and is compiled again")
                with contextlib.suppress(OSError):
                    self.flush()
        if overload is None and self._python_calls:
            _warn("compiling models, which takes some ten seconds once; `telenano doctor --warm` does it beforehand")
        return overload

    def has(self, sig: Any, target_context: Any) -> bool:
        """Return whether what is compiled for a signature is on the disk."""
        if not self._can_be_kept(sig):
            return False
        try:
            return self._index_key(sig, target_context.codegen()) in self._cache_file._load_index()
        except (OSError, EOFError, UnpicklingError):
            return False

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled; where that is not possible it is compiled again the next time."""
        if self._can_be_kept(sig):
            try:
                super().save_overload(sig, data)
            except OSError as error:
                _warn(f"compiled code cannot be kept in {cache_folder()}: {error.strerror}")

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        # code that checks its indices (NUMBA_BOUNDSCHECK) is other code
        return (*super()._index_key(sig, codegen), self._python_calls, vars(config)["BOUNDSCHECK"])

    def _can_be_kept(self, signature: Any) -> bool:
        classes = {kind.__module__ for kind in _classes(signature)}
        return digest_covers(self._py_func.__module__, classes) and _is_safe()


def _classes(part: Any) -> Iterator[type]:
    """Yield the classes of the tuples in a signature: numba's types know them, and not what became of their fields."""
    if isinstance(part, tuple | list):
        for inner in part:
            yield from _classes(inner)
    elif isinstance(part, types.Type):
        if isinstance(part, types.BaseNamedTuple):
            # numba declares it for the classes below this one
            named: Any = part
            yield named.instance_class
        for name in ("types", "dtype", "type"):
            yield from _classes(getattr(part, name, None))


@cache
def _is_safe() -> bool:
    """Return whether no other user can put code into the folder, or another folder there."""
    folder = cache_folder()
    try:
        # Where it is absent somebody else may still make it, if the folder above lets them.
        safe = is_own(folder)
    except OSError:
        safe = False
    if not safe:
        _warn(f"the compiled code in {folder} can be written by others, and is not used")
    return safe


@cache
def _warn(text: str) -> None:
    """Log a warning once in a process: what happened to the code of one function happens to that of others."""
    logging.getLogger("studies").warning(text)


class InterruptibleDispatcher(CPUDispatcher):
    """A compiled function that SIGINT and SIGTERM cannot end in the middle; numba's in all else."""

    _cache: Any

    def __call__(self, *args: Any, **keywords: Any) -> Any:
        # Python runs the handlers of signals in the main thread only.
        if get_ident() != _MAIN_THREAD:
            return _call(self, *args, **keywords)
        interrupts.watch()
        interrupts.computing(True)
        try:
            return _call(self, *args, **keywords)
        finally:
            interrupts.computing(False)

    def is_ready(self, arguments: tuple[Any, ...]) -> bool:
        """Return whether a call with such arguments compiles nothing."""
        signature = tuple(map(self.typeof_pyval, arguments))
        return signature in self.overloads or self._cache.has(signature, self.targetctx)

    def _compile_for_args(self, *args: Any, **keywords: Any) -> Any:
        # The first call compiles, which takes seconds and is plain Python.
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
        # numba counts no references to an array whose memory has no owner
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
    """Tell numba that compiled code is given by a function what it gave the function, borrowed."""
    _declare(function)(lambda context: lambda value: value)
    _lower(function, types.Any)(_lowered)
