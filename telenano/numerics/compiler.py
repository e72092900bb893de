"""Compilation of pure steps with numba.

`@compiled` marks a pure step, which remains a plain Python function. Python calls that function: a node makes only a
few calls per millisecond, and converting their tuples for compiled code would cost more than the arithmetic. Compiled
code that calls a marked step gets its compiled form, which is made on first use; `compiled_form` returns that form to a
study, whose single call makes millions of others. Both forms give the same bits, and a process may use both, in any
order of imports.

Compiled forms are `numba.njit` with numba's cache on disk. Numba notices a change in the file of a function, but not in
functions that it calls from other files, so its cache would continue to run an old model after an edit. The cache is
therefore in a folder named by the digest of every source that may contain a step (`source_digest`, ADR 0010).
"""

import importlib.util
import re
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, TypeVar, cast

# Imported before steps are defined, because this module records the start time of the process.
from telenano.numerics.digests import cache_folder
from telenano.wire.errors import ConfigError

F = TypeVar("F", bound=Callable[..., object])
V = TypeVar("V")

# The attribute that marks a step; its value is the compiled form that Python can call, None until it is needed.
STEP = "_telenano_step"
# Attribute with the compiled form that only compiled code calls.
_INNER = "_telenano_inner_step"
# Attribute that marks a step to be inlined into its callers.
INLINED = "_telenano_inlined"
# Attribute with the function that compiled code runs instead of a step.
VECTORIZED = "_telenano_vectorized"
# Dispatching functions (see `chosen_step`) that are not registered with the compiler yet, each with the function that
# chooses: the compiler is imported only when it is needed.
_unregistered: list[tuple[Callable[..., Any], Callable[[type], Callable[..., Any]]]] = []


def compiled(function: F, *, at_once: F | None = None) -> F:
    """Mark a pure step, which runs as plain Python if Python calls it and compiled if compiled code calls it.

    Args:
        function: The step.
        at_once: A function that compiled code runs instead, a loop over many elements with the same bits. The compiler
            vectorises it, so a division by zero raises nothing there.
    """
    setattr(function, STEP, None)
    if at_once is not None:
        setattr(function, VECTORIZED, at_once)
    return function


def inlined(function: F) -> F:
    """Mark a pure step whose compiled form is inlined into each caller, so that its tuples stay in registers.

    It is for short steps with large tuples; each call site compiles the step once more.
    """
    setattr(function, INLINED, True)
    return compiled(function)


def is_step(function: Callable[..., Any]) -> bool:
    """Return whether a function is marked as a step that can be compiled."""
    return hasattr(function, STEP)


def compiled_form(function: F) -> F:
    """Return the compiled form of a marked step, for code whose single call makes many others.

    Without numba, or with NUMBA_DISABLE_JIT=1, this is the plain function, which is slower and gives the same bits.
    """
    if importlib.util.find_spec("numba") is None:
        return function
    return _form_of(function)


def is_compiled(function: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
    """Return whether a call of a marked step needs no compilation, because its compiled form is in memory or on disk.

    The compiler is imported only if some form of the step exists, so that a process that does not need it does not wait
    for the import. Without numba, or with NUMBA_DISABLE_JIT=1, the result is True.
    """
    kept = f"*/{function.__module__.rpartition('.')[2]}.{function.__qualname__}-*.nbi"
    if importlib.util.find_spec("numba") is None:
        return True
    if getattr(function, STEP) is None and not any(cache_folder().glob(kept)):
        return False
    form = _form_of(function)
    from telenano.numerics.numba_parts import InterruptibleDispatcher

    return bool(form.is_ready(arguments)) if isinstance(form, InterruptibleDispatcher) else True


def compiled_call(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Call a marked step in its compiled form.

    Raises:
        ConfigError: The step, or one that it calls, cannot be compiled; nothing of it has run.
    """
    try:
        return compiled_form(function)(*arguments)
    # Recognise compiler errors by module, because their classes exist only if numba is installed.
    except Exception as error:
        if not type(error).__module__.startswith("numba."):
            raise
        # The compiler's text is for a terminal and lists all levels of calls; the last one is where it stopped.
        lines = [" ".join(re.sub(r"\x1b\[\d*m", "", line).split()) for line in str(error).splitlines()]
        place = next((line.rstrip(":") for line in reversed(lines) if line.startswith("File ")), "")
        named = (line for line in lines if line and not line.startswith(("Failed in", "File ", "During", "-", "<")))
        reason = next(named, type(error).__name__)
        raise ConfigError(
            f"a model of this session cannot be compiled: {reason} ({place}): write the step in what numba knows, or "
            "set NUMBA_DISABLE_JIT=1 to run all models as plain Python"
        ) from error


def always_compiled(function: F) -> F:
    """Compile a pure function for calls from Python, too: a step that contains thousands of others.

    Its module needs numba, so a node imports it only if its scenario requires it. The function may call only marked
    steps and functions of its own kind. NUMBA_DISABLE_JIT=1 keeps it plain Python.
    """
    return _form_of(compiled(function))


def chosen_step(choose: Callable[[type], Callable[..., Any]]) -> Callable[..., Any]:
    """Return a function of (params, *inputs) that calls the step returned by `choose` for the type of params.

    Compiled code chooses at compile time; steps passed as arguments would be compiled again by every process.
    """

    def plain(params: Any, *inputs: Any) -> Any:
        """Return the result of the step that belongs to the type of params."""
        return choose(type(params))(params, *inputs)

    _unregistered.append((plain, choose))
    return plain


def borrowed(value: V) -> V:
    """Return the value; in compiled code its arrays are no longer reference-counted.

    Without this, each call with a tuple that contains an array increments and decrements the array's count. The caller
    of the compiled code must keep the arrays alive, and nothing derived from them may be returned to Python.
    """
    return value


def _form_of(function: F, kind: str = STEP) -> F:
    compile_and_keep = _compiler()
    _register_choices()
    # The form that Python can call also serves compiled code.
    form = getattr(function, STEP) or getattr(function, kind, None)
    if form is None:
        form = compile_and_keep(function, kind == STEP)
        setattr(function, kind, form)
    return cast(F, form)


def _register_choices() -> None:
    """Register the functions of `chosen_step` that are new since the last call with the compiler."""
    from numba.extending import overload

    while _unregistered:
        plain, choose = _unregistered.pop()

        def typed(params: Any, *inputs: Any, choose: Any = choose) -> Callable[..., Any]:
            step = choose(params.instance_class)
            return lambda params, *inputs: step(params, *inputs)

        overload(plain, strict=False)(typed)


@cache
def _compiler() -> Callable[[Callable[..., object], bool], object]:
    # Imported here because a process that compiles nothing needs neither numba nor the wait for its import.
    import numba
    from numba.core import config, types
    from numba.core.typing.typeof import typeof_impl

    from telenano.numerics.numba_parts import InterruptibleDispatcher, StepCache, register_borrowed

    register_borrowed(borrowed)

    @typeof_impl.register(FunctionType)
    def _typeof_step(function: FunctionType, context: object) -> object:
        # The type of a function that compiled code names; an unmarked one has no compiled form, and numba reports it.
        return types.Dispatcher(cast(Any, _form_of(function, _INNER))) if is_step(function) else None

    def compile_and_keep(function: Callable[..., object], python_calls: bool) -> object:
        # The wrapper that unpacks Python's tuples is larger than most steps and takes as long to compile.
        options: dict[str, Any] = {"no_cpython_wrapper": not python_calls, "no_cfunc_wrapper": True}
        source: Any = getattr(function, VECTORIZED, function)
        if source is not function:
            options["error_model"] = "numpy"
        dispatcher: Any = numba.njit(forceinline=hasattr(function, INLINED), **options)(source)
        if not vars(config)["DISABLE_JIT"]:
            # numba has no option for the class of its dispatchers.
            dispatcher.__class__ = InterruptibleDispatcher
            dispatcher._cache = StepCache(source, python_calls)
        return dispatcher

    return compile_and_keep
