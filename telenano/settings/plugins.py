"""What installed packages add: laws, devices, samples, programs, commands and more, by entry points.

A package names them in its `pyproject.toml`, and is found as soon as pip has installed it:

    [project.entry-points."telenano.laws"]
    my_law = "my_package.law:MY_LAW"

One that cannot be used is no harm to what does not use it: it is missing from the table, and its problem is reported to
whoever asks for it. With `TELENANO_WITHOUT_PACKAGES` set there is none. An installed package is code that runs as who
started the program: one that ends the process or never returns when it is imported does so. An entry is identified by
its kind, its name and a digest of the files that it is made of, so that an edit of one driver leaves the others what
they were; which distribution it came in, and in which version, is recorded as information.
"""

import contextlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points, version
from pathlib import Path
from traceback import walk_tb
from typing import Any, Generic, NamedTuple, TypeVar, overload

from telenano.signals import interrupts
from telenano.wire.errors import PackageError, TelenanoError, described

# What scenarios and experiments name, and so what a run depends on.
SCENARIO_KINDS = (
    *("laws", "devices", "hand_sections", "operators", "samples", "layers", "maps"),
    *("programs", "tasks", "scenarios"),
)
KINDS = (
    *SCENARIO_KINDS,
    *(
        "advisers",
        "commands",
        "checks",
        "exports",
        "functions",
        "images",
        "panels",
        "readers",
        "steps",
        "topics",
        "transports",
    ),
)
NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")

T = TypeVar("T")

# The problems of what this process has loaded so far, by kind and name.
_problems: dict[tuple[str, str], str] = {}


class Plugin(NamedTuple):
    """An entry of an installed package; `problem` is empty for one that can be tried."""

    kind: str
    name: str
    package: str
    version: str
    target: str
    problem: str = ""

    @property
    def digest(self) -> str:
        """Return the digest of its own folder and of what that imports of the same package."""
        digests = [_digest(part) for part in _parts(self.target)]
        return digests[0] if len(digests) == 1 else "sha256:" + _sha256("\n".join(digests).encode())

    def facts(self) -> dict[str, str]:
        """Return what a recording keeps of it."""
        return {"package": self.package, "version": self.version, "digest": self.digest}


class LoadedEntries(NamedTuple, Generic[T]):
    """The entries of a kind that can be used, by name, and for the others what is wrong with them."""

    found: dict[str, T]
    problems: dict[str, str]


def installed(kind: str) -> dict[str, Plugin]:
    """Return the entries of a kind by name, without importing them.

    A name is that of a key in a scenario; one that two packages use belongs to neither.
    """
    return _installed()[kind]


@cache
def _installed() -> dict[str, dict[str, Plugin]]:
    # Both are read once, since their files are dear: the entries of all that is installed, and who each package is.
    entries = EntryPoints() if os.environ.get("TELENANO_WITHOUT_PACKAGES") else entry_points()
    packages, own = dict[int, tuple[str, str, str]](), version("telenano")
    plugins_of: dict[str, dict[str, Plugin]] = {kind: {} for kind in KINDS}
    for kind, rows in plugins_of.items():
        for entry in sorted(entries.select(group=f"telenano.{kind}"), key=lambda entry: (entry.name, entry.value)):
            dist = entry.dist
            if dist and id(dist) not in packages:
                read = dist.metadata  # parsed again at every look
                other = _other_version(read.get_all("Requires-Dist") or (), own)
                packages[id(dist)] = read["Name"], read["Version"], other
            package, its_version, problem = packages.get(id(dist), ("unknown", "unknown", ""))
            row = Plugin(kind, entry.name, package, its_version, entry.value, problem)
            if not NAME.fullmatch(entry.name):
                text = "its name must be of lower-case letters, digits and _, begin with a letter, and have at most 32"
                row = row._replace(problem=text)
            plugin = rows.get(entry.name)
            if plugin is not None and plugin.package != row.package:
                row = row._replace(problem=f"{plugin.package} and {row.package} both have one of this name: remove one")
            rows[entry.name] = row
    return plugins_of


def _other_version(required: Iterable[str], own: str) -> str:
    """Return that what a package requires is another version of telenano than this one; empty if not."""
    for text in required:
        # What `telenano new` writes is read without the library, whose import takes longer than all the other work.
        usual = re.fullmatch(r"telenano(?:\[.*\])?==([\d.]+\.)\*", text)
        if re.match(r"telenano[^-\w.]", text) and not (usual and own.startswith(usual[1])):
            from packaging.requirements import Requirement

            needed = Requirement(text)
            if needed.name == "telenano" and not needed.specifier.contains(own, prereleases=True):
                return f"it needs telenano {needed.specifier}, and this is {own}: install its release for {own}"
    return ""


def _function(_: str, value: Any) -> Any:
    """Return an entry that is a function; TypeError for another one."""
    if not callable(value):
        raise TypeError(f"is a {type(value).__name__}, must be a function")
    return value


@overload
def load(kind: str, *, taken: Collection[str] = (), only: str | None = None) -> LoadedEntries[Callable[..., Any]]: ...


@overload
def load(
    kind: str, check: Callable[[str, Any], T | None], taken: Collection[str] = (), only: str | None = None
) -> LoadedEntries[T]: ...


def load(
    kind: str, check: Callable[[str, Any], Any] = _function, taken: Collection[str] = (), only: str | None = None
) -> LoadedEntries[Any]:
    """Import the entries of a kind.

    Args:
        kind: The kind of entries.
        check: Returns what is used of an entry, None if it is for something else, and raises TypeError or ValueError
            that says what is wrong with it; without it every entry must be a function.
        taken: The names that the project uses itself.
        only: The name of the one entry that is wanted; None for all of them.
    """
    loaded = LoadedEntries[Any]({}, {})
    for name, row in installed(kind).items():
        if only not in (None, name):
            continue
        own = f"{name} is a name of telenano's own" if name in taken else ""
        problem = row.problem or own or _tried(row, check, loaded.found)
        if problem:
            loaded.problems[name] = f"{name} of the package {row.package} {row.version} cannot be used: {problem}"
            _problems[kind, name] = loaded.problems[name]
    return loaded


def known_problems() -> list[str]:
    """Return a sentence for each entry that this process has tried to load and cannot use."""
    return [_problems[key] for key in sorted(_problems)]


def _tried(row: Plugin, check: Callable[[str, Any], T | None], loaded: dict[str, T]) -> str:
    try:
        with shielded():
            value = check(row.name, EntryPoint(row.name, row.target, f"telenano.{row.kind}").load())
    # The code of a package may raise anything, of which not all is an `Exception`.
    except BaseException as error:  # noqa: BLE001
        return fault_of_import(error)
    if value is not None:
        loaded[row.name] = value
    return ""


class _Shield:
    """A text stream that others may close: it stays open."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def close(self) -> None:
        """Close nothing: what a command prints afterwards is not the package's to end."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def shielded() -> Iterator[None]:
    """Run code of a package whose output is none of what a command prints.

    What it prints goes to standard error, and both streams are as they were afterwards, whatever it closes or replaces.
    """
    copies = {}
    for number in (1, 2):
        # A process may have been started without it.
        with contextlib.suppress(OSError):
            copies[number] = os.dup(number)
    stream: Any = None if sys.stderr is None else _Shield(sys.stderr)
    try:
        with contextlib.redirect_stdout(stream), contextlib.redirect_stderr(stream):
            yield
    finally:
        for number, copy in copies.items():
            try:
                os.fstat(number)
            except OSError:
                os.dup2(copy, number)
            os.close(copy)


@contextlib.contextmanager
def code_of(package: str, *passed: type[BaseException]) -> Iterator[None]:
    """Call code of an installed package; whatever that raises is a sentence with its name.

    Args:
        package: The name of the package.
        passed: What it may raise as it is, besides a TelenanoError.

    Raises:
        PackageError: It has raised something else, or would end the program.
    """
    with shielded():
        try:
            yield
        # The code of a package may raise anything, of which not all is an `Exception`.
        except BaseException as error:
            if isinstance(error, (TelenanoError, *passed)) or _is_of_person(error):
                raise
            text = fault_of_package(error) or f"the package {package} failed: {described(error)}"
            raise PackageError(text) from error


def _is_of_person(error: BaseException) -> bool:
    """Return whether an error is a signal at this process, and none that a package has raised itself."""
    if isinstance(error, interrupts.Interrupted | interrupts.Ended):
        return True
    return isinstance(error, KeyboardInterrupt) and not interrupts.is_handled()


def fault_of_import(error: BaseException) -> str:
    """Return in words what the import of a package raised; raise a signal at a command, which is not one of it."""
    if isinstance(error, SystemExit):
        return f"its import ends the whole program ({described(error)})"
    if not isinstance(error, KeyboardInterrupt):
        return described(error)
    # A signal at a command has a class of its own; this one the package may have raised itself.
    if type(error) is not KeyboardInterrupt:
        raise error
    return "its import raises KeyboardInterrupt"


def all_installed() -> list[Plugin]:
    """Return the entries of every kind."""
    return [row for kind in KINDS for row in installed(kind).values()]


def in_scenarios() -> list[Plugin]:
    """Return the entries that scenarios and experiments can name: a run depends on these packages and on no other."""
    return [row for kind in SCENARIO_KINDS for row in installed(kind).values()]


def in_lockstep() -> list[Plugin]:
    """Return those that a session without a rig can run: what is computed there depends on no real device."""
    return [row for row in in_scenarios() if row.kind != "devices"]


def with_steps() -> list[Plugin]:
    """Return those whose compiled steps no scenario can name: what is computed with them depends on them alone."""
    return list(installed("steps").values())


def modules(rows: Iterable[Plugin]) -> tuple[str, ...]:
    """Return what entries are made of, as the beginnings of module names."""
    return tuple(sorted({part + "." for row in rows for part in _parts(row.target)}))


def fault_of_package(error: BaseException) -> str:
    """Return in a sentence which package an error came from, empty where none had a part in it.

    Of several it is the one whose code was called last.
    """
    owners = {_top_level(row.target): row for row in all_installed()}
    fault = ""
    for frame, line in walk_tb(error.__traceback__):
        row = owners.get(frame.f_globals.get("__name__", "").partition(".")[0])
        if row is not None:
            place = f"{frame.f_globals['__name__']}, line {line}, in {frame.f_code.co_name}"
            fault = f"the package {row.package} {row.version} failed ({place}): {described(error)}"
    return fault


def digest_of_all(rows: Iterable[Plugin]) -> str:
    """Return a digest of the files of the packages of entries; empty without any."""
    digests = [f"{row.kind}.{row.name} {row.digest}" for row in rows]
    return _sha256("\n".join(digests).encode()) if digests else ""


def package_files(rows: Iterable[Plugin]) -> list[Path]:
    """Return the files of the packages of entries."""
    return [path for name in modules(rows) for _, path in _files(name.removesuffix("."))]


@cache
def _digest(part: str) -> str:
    files = (name.encode() + b"\0" + path.read_bytes() for name, path in _files(part))
    return "sha256:" + _sha256(b"".join(files))


@cache
def _parts(target: str) -> tuple[str, ...]:
    """Return the parts of a package that an entry is made of, as names of modules.

    A part is a folder or a module directly in the package. An entry is made of the part in which it is defined and of
    all that it mentions, strings included, because wires and steps are named by strings. Of an entry that is defined in
    a module directly in the package the whole package is one part.
    """
    top, *inner = target.partition(":")[0].strip().split(".")
    roots = _roots(top)
    if not inner or not any((root / inner[0]).is_dir() for root in roots):
        return (top,)
    # What the package runs whenever something of it is imported counts for each.
    found, waiting = set[str](), {inner[0], "__init__"}
    while waiting := {name for name in waiting - found if any(_place(root, name) for root in roots)}:
        found |= waiting
        waiting = {name for part in waiting for name in _mentioned(top, part)}
    return tuple(f"{top}.{part}" for part in sorted(found))


def _sha256(content: bytes) -> str:
    # The list of commands has no time for this import.
    from hashlib import sha256

    return sha256(content).hexdigest()


def _top_level(target: str) -> str:
    return target.partition(":")[0].partition(".")[0].strip()


@cache
def _mentioned(top: str, part: str) -> frozenset[str]:
    """Return what the modules of a part may name of their package: behind its name and a dot, or imported from it."""
    named = re.compile(rf"\b{re.escape(top)}\.(\w+)")
    imported = re.compile(rf"^\s*from {re.escape(top)} import \(?([\w, \n]+)", re.MULTILINE)
    texts = [path.read_text("utf-8", "replace") for name, path in _files(f"{top}.{part}") if name.endswith(".py")]
    words = " ".join(found for text in texts for found in imported.findall(text))
    return frozenset({name for text in texts for name in named.findall(text)} | set(re.findall(r"\w+", words)))


@cache
def _roots(top_level: str) -> tuple[Path, ...]:
    """Return the folders of a package; none of a module or of what is not installed."""
    spec = importlib.util.find_spec(top_level)
    return tuple(Path(location) for location in (spec and spec.submodule_search_locations) or ())


def _place(root: Path, part: str) -> Path | None:
    """Return the folder or file of a part in a folder of its package."""
    return next((path for path in (root / part, root / f"{part}.py") if path.exists()), None)


def _files(name: str) -> Iterable[tuple[str, Path]]:
    """Return the files of a package, or of a part of one, by their names in it."""
    top, _, part = name.partition(".")
    if not (roots := _roots(top)):
        spec = importlib.util.find_spec(top)
        return [(Path(spec.origin).name, Path(spec.origin))] if spec and spec.origin else []
    places = [(root, _place(root, part) if part else root) for root in roots]
    files = [(root, path) for root, place in places if place for path in (place, *place.rglob("*"))]
    names = ((path.relative_to(root).as_posix(), path) for root, path in files if path.is_file())
    return sorted((name, path) for name, path in names if "__pycache__" not in path.parts)


def scenario_files() -> LoadedEntries[Path]:
    """Return the scenarios of installed packages: an entry is the path of a YAML file, or a function that gives it."""

    def path_of(name: str, value: Any) -> Path:
        path = Path(value() if callable(value) else value)
        if not path.is_file():
            raise ValueError(f"{path} is no file")
        return path

    return load("scenarios", path_of)


def refuse(loaded: LoadedEntries[Any], name: Any) -> None:
    """Raise ValueError saying why an entry of that name cannot be used, where there is one."""
    if isinstance(name, str) and name in loaded.problems:
        raise ValueError(loaded.problems[name])
