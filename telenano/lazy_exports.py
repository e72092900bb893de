"""Lazy public names of a room (a package of telenano): each is imported at its first use.

The `__init__` of a room lists its public names once, for type checkers, and the last line makes them importable:

    if TYPE_CHECKING:
        from telenano.recording.reader import Recording as Recording
    else:
        __getattr__, __dir__ = face(__name__)

The modules of a room are imported one by one because most processes need only one or two of them, and an emergency stop
cannot wait for the import of NumPy.
"""

import importlib
import sys
from collections.abc import Callable, Collection, Mapping
from typing import Any


def face(
    room: str, moved: Mapping[str, Collection[str]] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a room; an unknown name raises AttributeError at its use.

    Args:
        room: The name of its package, whose `__init__` imports the public names under `if TYPE_CHECKING:`.
        moved: Former public names that are now in other rooms, by room. They can still be imported here, but `dir` does
            not list them.
    """
    package = sys.modules[room]
    modules: dict[str, str] = {}
    rooms = {name: other for other, names in (moved or {}).items() for name in names}

    def module_of(name: str) -> str | None:
        # The source is parsed at the first name, because a process that uses none does not need the parser.
        if not modules:
            from pathlib import Path

            modules.update(names_of(Path(str(package.__file__)).read_text(encoding="utf-8")))
        return modules.get(name) or rooms.get(name)

    def get(name: str) -> Any:
        # The import system itself looks up names that begin with two underscores, which are never public.
        module = None if name.startswith("__") else module_of(name)
        if module is None:
            raise AttributeError(f"module {room!r} has no attribute {name!r}")
        attribute = getattr(importlib.import_module(module), name)
        if name not in rooms:
            setattr(package, name, attribute)
        return attribute

    def names() -> list[str]:
        module_of("")
        own = {
            name for name, value in vars(package).items() if name.isupper() or getattr(value, "__module__", "") == room
        }
        return sorted(name for name in {*own, *modules} - {"TYPE_CHECKING"} if not name.startswith("_"))

    return get, names


def names_of(source: str) -> dict[str, str]:
    """Return the public names of a room with the module of each, from the source text of its `__init__`."""
    import ast

    blocks = [part for part in ast.parse(source).body if isinstance(part, ast.If)]
    listed = [part for block in blocks if ast.unparse(block.test) == "TYPE_CHECKING" for part in block.body]
    imports = [part for part in listed if isinstance(part, ast.ImportFrom) and part.module]
    return {each.name: str(part.module) for part in imports for each in part.names if each.asname == each.name}
