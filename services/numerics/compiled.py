"""Compilation of pure steps.

`@compiled` marks a pure step and leaves it the plain Python function that it is. Python calls it as such: a node makes
a few calls a millisecond, and boxing their tuples for compiled code would cost more than the arithmetic. Compiled code
that calls a marked step finds its compiled form, which is made at the first need; `compiled_form` gives that form to a
study, whose one call makes millions of others. Both forms give the same bits, and a process may use both, whatever it
imported first.

Compiled forms are `numba.njit` with a cache on disk. Numba notices a change of the file that a function is in, but not
of the functions that it calls from other files, so a plain cache would go on running an old model after an edit. This
one keeps the digest of every source that may hold a step (`source_digest`), and compiles again after an edit of any of
them (ADR 0010).
"""

import contextlib
import hashlib
import importlib.util
import os
import re
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

from presets.plugins import digest_of_all, package_files
from presets.plugins import modules as package_modules
from proto.errors import ConfigError

F = TypeVar("F", bound=Callable[..., object])
V = TypeVar("V")

_ROOT = Path(__file__).resolve().parents[2]
# These folders and files hold the steps, and everything else that the outcome of a study depends on.
SOURCES = (
    *("services/numerics", "services/haptic_node", "services/afm_node", "services/controller", "services/delay_node"),
    *("studies/loops", "studies/instrument", "studies/learning", "analysis/modes.py", "analysis/verdict.py"),
    "studies/assembly/bench.py",
    # deadlines, which are compiled into the loop
    *("proto/topics.py", "services/runtime/loop/freshness.py"),
)
_SHELLS = ("node.py", "half.py", "__main__.py")
# Raise it with every change of what `compile_cache` writes, or of the options of the compiler.
_CACHE_FORMAT = "7"
# Files of other checkouts and of obsolete signatures are removed after so many days.
CACHE_DAYS = 14
# This file in the folder of the cache tells when it was last cleaned.
_CLEANED = "cleaned"

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
# Every module with steps imports this one before it defines them.
_STARTED_S = time.time()


def source_digest(root: Path = _ROOT) -> str:
    """Return the digest (16 hex digits) of every Python file that may hold compiled steps or constants they use."""
    digest = hashlib.sha256(version("numba").encode())
    for path in _source_files(root):
        digest.update(str(path.relative_to(root)).encode())
        digest.update(path.read_bytes())
    # installed packages have steps as well
    digest.update(digest_of_all().encode())
    return digest.hexdigest()[:16]


def kept_digest(modules: Iterable[str]) -> str:
    """Return the digest under which code compiled from these modules is kept on disk; empty if it must not be kept.

    It must not where a module is neither one of SOURCES nor of an installed package, because no digest has its sources.
    It must not where a source was edited after this process began either: what was imported may be older than its file.
    """
    known = all((module + ".").startswith(_known_modules()) for module in modules)
    return _digest_of_process() if known and not _edited_since(_STARTED_S) else ""


@cache
def _known_modules() -> tuple[str, ...]:
    return (*(source.removesuffix(".py").replace("/", ".") + "." for source in SOURCES), *package_modules())


@cache
def _digest_of_process() -> str:
    return source_digest()


def _source_files(root: Path) -> Iterator[Path]:
    for source in SOURCES:
        for path in sorted((root / source).rglob("*.py")) or [root / source]:
            if not path.name.endswith(_SHELLS) and path.is_file():
                yield path


@cache
def _watched() -> tuple[Path, ...]:
    return (*_source_files(_ROOT), *package_files())


def _edited_since(time_s: float) -> bool:
    try:
        # the time of the last change of a file, which copying it with its times does not set back
        return any(path.stat().st_ctime > time_s for path in _watched())
    except OSError:
        return True


def cache_directory() -> Path:
    """Return the folder of compiled code: a folder in it for each of sources, a file a function and signature."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return base / "telenano" / f"numba-{_CACHE_FORMAT}-{version('numba')}"


def clean_cache(folder: Path, now_s: float) -> list[Path]:
    """Delete compiled code that no process has used for CACHE_DAYS; return what went.

    Beside the folder are those of other versions, which may be in use. Looks once a day.
    """
    old: list[Path] = []
    marker = folder / _CLEANED
    with contextlib.suppress(OSError):
        if marker.exists() and now_s - marker.stat().st_mtime < 86_400.0:
            return old
        marker.touch()
        os.utime(marker, (now_s, now_s))
    for other in folder.parent.glob("numba-*"):
        with contextlib.suppress(OSError):
            if other != folder and _unused(other, now_s):
                shutil.rmtree(other)
                old.append(other)
    for path in folder.glob("*/*"):
        with contextlib.suppress(OSError):
            if _unused(path, now_s):
                path.unlink()
                old.append(path)
    return old


def _unused(path: Path, now_s: float) -> bool:
    return now_s - path.stat().st_mtime > CACHE_DAYS * 86_400.0


def compiled(function: F) -> F:
    """Mark a pure step: plain Python where Python calls it, compiled where compiled code calls it."""
    setattr(function, STEP, None)
    return function


def inlined(function: F) -> F:
    """Mark a pure step whose compiled form becomes part of each caller, so that its tuples stay in registers.

    It is for short steps that hand large tuples on; each place that calls one compiles it once more.
    """
    setattr(function, INLINED, True)
    return compiled(function)


def vectorized(plain: F) -> Callable[[F], F]:
    """Mark a function that compiled code runs in the place of `plain`: a loop of the same bits over many elements.

    The compiler does several elements at once, for which a division by zero must raise nothing there.
    """

    def mark(function: F) -> F:
        setattr(compiled(plain), VECTORIZED, function)
        return function

    return mark


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


def compiled_call(function: Callable[..., Any], given: tuple[Any, ...]) -> Any:
    """Call a marked step in its compiled form.

    Raises:
        ConfigError: It, or a step that it calls, cannot be compiled; nothing of it has run.
    """
    try:
        return compiled_form(function)(*given)
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

    Compiled code makes the choice while it is compiled; steps handed over as arguments would be compiled anew by every
    process.
    """

    def plain(params: Any, *inputs: Any) -> Any:
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
    """Tell the compiler of the choices that were made since it was told last."""
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

    import services.numerics.borrowed_arrays  # noqa: F401 - tells numba what `borrowed` is
    from services.numerics.compile_cache import CheckedCache
    from services.signals.interruptible import InterruptibleDispatcher

    @typeof_impl.register(FunctionType)
    def _typeof_step(function: FunctionType, context: object) -> object:
        # A function that compiled code names: one that is not marked has no compiled form, and numba says so.
        return types.Dispatcher(cast(Any, _form_of(function, _INNER))) if is_step(function) else None

    if "NUMBA_CACHE_DIR" not in os.environ:
        folder = cache_directory()
        vars(config)["CACHE_DIR"] = str(folder)
        # If the folder cannot be made, numba says so when it wants to write.
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)
            clean_cache(folder, time.time())

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
            dispatcher._cache = CheckedCache(source, python_calls)
        return dispatcher

    return compile_and_keep
