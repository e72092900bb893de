"""Compilation of pure steps.

`@compiled` marks a pure step and leaves it the plain Python function that it is. Python calls it as such: a node makes
a few calls a millisecond, and boxing their tuples for compiled code would cost more than the arithmetic. Compiled code
that calls a marked step finds its compiled form, which is made at the first need; `compiled_form` gives that form to a
study, whose one call makes millions of others. Both forms give the same bits, and a process may use both, whatever it
imported first.

Compiled forms are `numba.njit` with numba's cache on disk. Numba notices a change of the file that a function is in,
but not of the functions that it calls from other files, so its cache would continue running an old model after an edit.
It is therefore in a folder that is named by the digest of every source that may hold a step (`source_digest`, ADR
0010).
"""

import importlib.util
import re
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, TypeVar, cast

# imported here because it notes when this process began, before steps are defined
from telenano.numerics.digests import cache_folder
from telenano.wire.errors import ConfigError

F = TypeVar("F", bound=Callable[..., object])
V = TypeVar("V")

# The attribute that marks a step. It holds the compiled form that Python can call, None before it was needed.
STEP = "_telenano_step"
# the compiled form that only compiled code calls
_INNER = "_telenano_inner_step"
# marks a step that is compiled into its callers
INLINED = "_telenano_inlined"
# the function that compiled code runs in the place of a step
VECTORIZED = "_telenano_vectorized"
# The choices whose compiled form the compiler does not know yet, each with the function that chooses. The compiler is
# imported when it is needed.
_unregistered: list[tuple[Callable[..., Any], Callable[[type], Callable[..., Any]]]] = []


def compiled(function: F, *, at_once: F | None = None) -> F:
    """Mark a pure step: plain Python where Python calls it, compiled where compiled code calls it.

    Args:
        function: The step.
        at_once: What compiled code runs instead: a loop of the same bits over many elements. The compiler does several
            elements at once, for which a division by zero must raise nothing there.
    """
    setattr(function, STEP, None)
    if at_once is not None:
        setattr(function, VECTORIZED, at_once)
    return function


def inlined(function: F) -> F:
    """Mark a pure step whose compiled form becomes part of each caller, so that its tuples stay in registers.

    It is for short steps that hand large tuples on; each place that calls one compiles it once more.
    """
    setattr(function, INLINED, True)
    return compiled(function)


def is_step(function: Callable[..., Any]) -> bool:
    """Return whether a function is marked as a step that can be compiled."""
    return hasattr(function, STEP)


def compiled_form(function: F) -> F:
    """Return the compiled form of a marked step, for a caller whose one call makes many others.

    Without numba, or with NUMBA_DISABLE_JIT=1, that is the plain function, which is slower and gives the same bits.
    """
    if importlib.util.find_spec("numba") is None:
        return function
    return _form_of(function)


def is_compiled(function: Callable[..., Any], arguments: tuple[Any, ...]) -> bool:
    """Return whether a call of a marked step compiles nothing: its compiled form is in this process or on the disk.

    The compiler is imported only where either has some form of the step, so that a process which never needs it does
    not wait for it. Without numba, or with NUMBA_DISABLE_JIT=1, there is nothing to compile.
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
        ConfigError: It, or a step that it calls, cannot be compiled; nothing of it has run.
    """
    try:
        return compiled_form(function)(*arguments)
    # The errors of the compiler can be named only where it is installed.
    except Exception as error:
        if not type(error).__module__.startswith("numba."):
            raise
        # The compiler writes for a terminal, each level of calls above the one where it stopped.
        lines = [" ".join(re.sub(r"\x1b\[\d*m", "", line).split()) for line in str(error).splitlines()]
        place = next((line.rstrip(":") for line in reversed(lines) if line.startswith("File ")), "")
        named = (line for line in lines if line and not line.startswith(("Failed in", "File ", "During", "-", "<")))
        reason = next(named, type(error).__name__)
        raise ConfigError(
            f"a model of this session cannot be compiled: {reason} ({place}): write the step in what numba knows, or "
            "set NUMBA_DISABLE_JIT=1 to run all models as plain Python"
        ) from error


def always_compiled(function: F) -> F:
    """Compile a pure function for Python as well: a step that is thousands of others in one call.

    The module that has it needs numba, so a node imports it only where its scenario asks for it. It may call only
    marked steps and functions like itself. NUMBA_DISABLE_JIT=1 keeps it plain Python.
    """
    return _form_of(compiled(function))


def chosen_step(choose: Callable[[type], Callable[..., Any]]) -> Callable[..., Any]:
    """Return a function of (params, *inputs) that calls the step which `choose` gives for the type of params.

    Compiled code makes the choice while it is compiled; steps handed over as arguments would be compiled again by every
    process.
    """

    def plain(params: Any, *inputs: Any) -> Any:
        """Return what the step that belongs to the type of params returns."""
        return choose(type(params))(params, *inputs)

    _unregistered.append((plain, choose))
    return plain


def borrowed(value: V) -> V:
    """Return the value, in compiled code with arrays whose references are not counted any more.

    A tuple that holds an array counts one reference more and one less at each call that takes it. What calls the
    compiled code must keep the arrays, and nothing made of them may go back to Python.
    """
    return value


def _form_of(function: F, kind: str = STEP) -> F:
    compile_and_keep = _compiler()
    _register_choices()
    # what Python can call serves compiled code as well
    form = getattr(function, STEP) or getattr(function, kind, None)
    if form is None:
        form = compile_and_keep(function, kind == STEP)
        setattr(function, kind, form)
    return cast(F, form)


def _register_choices() -> None:
    """Tell the compiler of the choices that were made since it was last informed."""
    from numba.extending import overload

    while _unregistered:
        plain, choose = _unregistered.pop()

        def typed(params: Any, *inputs: Any, choose: Any = choose) -> Callable[..., Any]:
            step = choose(params.instance_class)
            return lambda params, *inputs: step(params, *inputs)

        overload(plain, strict=False)(typed)


@cache
def _compiler() -> Callable[[Callable[..., object], bool], object]:
    # The import is here because a process that compiles nothing need not have numba, nor wait for its import.
    import numba
    from numba.core import config, types
    from numba.core.typing.typeof import typeof_impl

    from telenano.numerics.numba_parts import InterruptibleDispatcher, StepCache, register_borrowed

    register_borrowed(borrowed)

    @typeof_impl.register(FunctionType)
    def _typeof_step(function: FunctionType, context: object) -> object:
        # A function that compiled code names: one that is not marked has no compiled form, and numba reports it.
        return types.Dispatcher(cast(Any, _form_of(function, _INNER))) if is_step(function) else None

    def compile_and_keep(function: Callable[..., object], python_calls: bool) -> object:
        # What unpacks the tuples that Python gives is larger than most steps, and takes as long to compile.
        options: dict[str, Any] = {"no_cpython_wrapper": not python_calls, "no_cfunc_wrapper": True}
        source: Any = getattr(function, VECTORIZED, function)
        if source is not function:
            options["error_model"] = "numpy"
        dispatcher: Any = numba.njit(forceinline=hasattr(function, INLINED), **options)(source)
        if not vars(config)["DISABLE_JIT"]:
            # numba has no option for the class of what it makes
            dispatcher.__class__ = InterruptibleDispatcher
            dispatcher._cache = StepCache(source, python_calls)
        return dispatcher

    return compile_and_keep
