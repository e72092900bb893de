"""Extensions in installed packages: laws, devices, samples, programs, commands and more, found by entry points.

A package names them in its `pyproject.toml`, and they are found as soon as pip has installed it:

    [project.entry-points."telenano.laws"]
    my_law = "my_package.law:MY_LAW"

An entry that cannot be used is left out of the table and does no further harm: whoever asks for it gets a report of its
problem. With `TELENANO_WITHOUT_PACKAGES` set, no entry is found. An installed package is code with the rights of the
user who started the program, so an import that kills the process or never returns cannot be prevented. An entry is
identified by its kind, its name and a digest of the files that it is made of, so that an edit of one driver does not
change the identity of the others; its distribution and version are recorded as information.
"""

import contextlib
import importlib.util
import os
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points, version
from pathlib import Path
from traceback import walk_tb
from typing import Any, Generic, NamedTuple, TypeVar, overload

from telenano.signals import interrupts
from telenano.wire.errors import PackageError, TelenanoError, described

# The kinds that scenarios and experiments can name, on which a run therefore depends.
SCENARIO_KINDS = ("laws", "devices", "operators", "samples", "programs", "readers", "tasks", "scenarios")
KINDS = (
    *SCENARIO_KINDS,
    *("advisers", "commands", "checks", "exports", "functions", "panels", "topics", "transports"),
)
NAME = re.compile(r"[a-z][a-z0-9_]{0,31}")

T = TypeVar("T")

# The problems of the entries that this process has loaded so far, by kind and name.
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
        """The digest of the entry's own folder and of the other parts of its package that it mentions."""
        return digest_of_parts(_parts(self.target))

    def facts(self) -> dict[str, str]:
        """Return the package, its version and the digest, as a recording keeps them."""
        return {"package": self.package, "version": self.version, "digest": self.digest}


class LoadedEntries(NamedTuple, Generic[T]):
    """The usable entries of a kind by name, and the problem of each of the others."""

    found: dict[str, T]
    problems: dict[str, str]


def installed(kind: str) -> dict[str, Plugin]:
    """Return the entries of a kind by name, without importing them.

    Scenarios use the name as a key; an entry whose name two packages use is refused.
    """
    return _installed()[kind]


@cache
def _installed() -> dict[str, dict[str, Plugin]]:
    # Entry points and the metadata of packages are read once, because reading their files is slow.
    entries = _entries()
    packages, own = dict[int, tuple[str, str, str]](), version("telenano")
    plugins_of: dict[str, dict[str, Plugin]] = {kind: {} for kind in KINDS}
    for kind, rows in plugins_of.items():
        for entry in sorted(entries.select(group=f"telenano.{kind}"), key=lambda entry: (entry.name, entry.value)):
            dist = entry.dist
            if dist and id(dist) not in packages:
                read = dist.metadata  # parsed again at each access
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


def _entries() -> Any:
    # Python 3.11 has another class for them than later ones, which has the same methods.
    return EntryPoints() if os.environ.get("TELENANO_WITHOUT_PACKAGES") else entry_points()


def _other_version(required: Iterable[str], own: str) -> str:
    """Return a sentence if a package requires another version of telenano than this one; empty if not."""
    for text in required:
        # The form that `telenano new` writes is read without the library, whose import takes longer than all the other
        # work.
        usual = re.fullmatch(r"telenano(?:\[.*\])?==([\d.]+\.)\*", text)
        if re.match(r"telenano[^-\w.]", text) and not (usual and own.startswith(usual[1])):
            from packaging.requirements import Requirement

            needed = Requirement(text)
            if needed.name == "telenano" and not needed.specifier.contains(own, prereleases=True):
                return f"it needs telenano {needed.specifier}, and this is {own}: install its release for {own}"
    return ""


def name_of_ending(path: Path | str) -> str:
    """Return the name of the entry for files of this ending: `jpk_force` for `a.jpk-force`, empty without an ending."""
    return Path(path).suffix.lower().removeprefix(".").replace("-", "_")


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
        check: Returns the part of an entry to use, or None to leave the entry out; raises TypeError or ValueError with
            the fault of the entry. The default accepts functions only.
        taken: The names that the project uses itself.
        only: The name of the one entry to import; None for all of them.
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
    """A text stream whose `close` does nothing."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def close(self) -> None:
        """Do nothing, so that a package cannot end the output of the command."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextlib.contextmanager
def shielded() -> Iterator[None]:
    """Run code of a package, and keep its output apart from that of the command.

    Its output goes to standard error, and both streams are restored afterwards, whatever it closes or replaces.
    """
    copies = {}
    for number in (1, 2):
        # The process may have been started without this descriptor.
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
    """Call code of an installed package, and turn its exceptions into a sentence with the name of the package.

    Args:
        package: The name of the package.
        passed: Exceptions that pass unchanged, as a TelenanoError does.

    Raises:
        PackageError: The code has raised another exception, or would end the program.
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
    """Return whether an exception is a signal to this process, not raised by the package itself."""
    if isinstance(error, interrupts.Interrupted | interrupts.Ended):
        return True
    return isinstance(error, KeyboardInterrupt) and not interrupts.is_handled()


def fault_of_import(error: BaseException) -> str:
    """Describe the exception that the import of a package raised; a signal to the command is raised again."""
    if isinstance(error, SystemExit):
        return f"its import ends the whole program ({described(error)})"
    if not isinstance(error, KeyboardInterrupt):
        return described(error)
    # A signal to the command has a class of its own; a plain KeyboardInterrupt may be the package's.
    if type(error) is not KeyboardInterrupt:
        raise error
    return "its import raises KeyboardInterrupt"


def of_no_kind() -> list[str]:
    """Return a sentence for each entry of a group of telenano's that is no kind, such as one with a misspelt name."""
    entries = _entries()
    strays = sorted(entries.groups - {f"telenano.{kind}" for kind in KINDS})
    return [
        f"{entry.value} is not used: its group is {group}; known are {', '.join(KINDS)}"
        for group in strays
        if group.startswith("telenano.")
        for entry in entries.select(group=group)
    ]


def all_installed() -> list[Plugin]:
    """Return the entries of every kind."""
    return [row for kind in KINDS for row in installed(kind).values()]


def in_scenarios() -> list[Plugin]:
    """Return the entries that scenarios and experiments can name: a run depends on these packages and on no other."""
    return [row for kind in SCENARIO_KINDS for row in installed(kind).values()]


def in_lockstep() -> list[Plugin]:
    """Return the entries that a session without a rig can run: its results depend on no real device."""
    return [row for row in in_scenarios() if row.kind != "devices"]


def parts_of(rows: Iterable[Plugin]) -> tuple[str, ...]:
    """Return the parts of which entries are made, as names of modules."""
    return tuple(sorted({part for row in rows for part in _parts(row.target)}))


def parts_of_module(module: str) -> tuple[str, ...]:
    """Return the parts of which a module of an installed package is made; none for a module of no such package."""
    has_entry = any(_top_level(row.target) == _top_level(module) for row in all_installed())
    return _parts(module) if has_entry else ()


def fault_of_package(error: BaseException) -> str:
    """Return a sentence that names the package in which an error arose; empty where no package took part.

    Of several packages it names the one whose code was called last.
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
    """Return one digest of all entries and their files; empty without entries."""
    digests = [f"{row.kind}.{row.name} {row.digest}" for row in rows]
    return _sha256("\n".join(digests).encode()) if digests else ""


def digest_of_parts(parts: Sequence[str]) -> str:
    """Return one digest of the files of parts of packages."""
    digests = [_digest(part) for part in parts]
    return digests[0] if len(digests) == 1 else "sha256:" + _sha256("\n".join(digests).encode())


@cache
def files_of(parts: tuple[str, ...]) -> tuple[Path, ...]:
    """Return the files of parts of packages."""
    return tuple(path for part in parts for _, path in _files(part))


@cache
def _digest(part: str) -> str:
    files = (name.encode() + b"\0" + path.read_bytes() for name, path in _files(part))
    return "sha256:" + _sha256(b"".join(files))


@cache
def _parts(target: str) -> tuple[str, ...]:
    """Return the parts of a package that an entry is made of, as names of modules.

    A part is a folder or a module directly in the package. An entry is made of the part that defines it and of all
    parts that this one mentions, also in strings, because wires and steps are named by strings. For an entry that is
    defined in a module directly in the package, the whole package is one part.
    """
    top, *inner = target.partition(":")[0].strip().split(".")
    roots = _roots(top)
    if not inner or not any((root / inner[0]).is_dir() for root in roots):
        return (top,)
    # The package runs `__init__` whenever something of it is imported, so it counts for each entry.
    found, waiting = set[str](), {inner[0], "__init__"}
    while waiting := {name for name in waiting - found if any(_place(root, name) for root in roots)}:
        found |= waiting
        waiting = {name for part in waiting for name in _mentioned(top, part)}
    return tuple(f"{top}.{part}" for part in sorted(found))


def _sha256(content: bytes) -> str:
    # Imported here, because it would slow down the list of commands.
    from hashlib import sha256

    return sha256(content).hexdigest()


def _top_level(target: str) -> str:
    return target.partition(":")[0].partition(".")[0].strip()


@cache
def _mentioned(top: str, part: str) -> frozenset[str]:
    """Return the names that the modules of a part may use from their package: after its name and a dot, or imported."""
    named = re.compile(rf"\b{re.escape(top)}\.(\w+)")
    imported = re.compile(rf"^\s*from {re.escape(top)} import \(?([\w, \n]+)", re.MULTILINE)
    texts = [path.read_text("utf-8", "replace") for name, path in _files(f"{top}.{part}") if name.endswith(".py")]
    words = " ".join(found for text in texts for found in imported.findall(text))
    return frozenset({name for text in texts for name in named.findall(text)} | set(re.findall(r"\w+", words)))


@cache
def _roots(top_level: str) -> tuple[Path, ...]:
    """Return the folders of a package; none for a single module or for a package that is not installed."""
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
            raise ValueError(f"{path} is not a file")
        return path

    return load("scenarios", path_of)


def refuse(loaded: LoadedEntries[Any], name: Any) -> None:
    """Raise ValueError saying why an entry of that name cannot be used, where there is one."""
    if isinstance(name, str) and name in loaded.problems:
        raise ValueError(loaded.problems[name])
