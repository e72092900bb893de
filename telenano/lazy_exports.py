"""The public face of a room: what its `__init__` names for type checkers, imported when it is first used.

A room lists its public names once, and the last line makes them importable:

    if TYPE_CHECKING:
        from telenano.recording.reader import Recording as Recording
    else:
        __getattr__, __dir__ = face(__name__)

The modules of a room are imported one by one in this way because most processes need one or two of them, and an
emergency stop cannot wait for NumPy.
"""

import importlib
import sys
from collections.abc import Callable, Collection, Mapping
from typing import Any


def face(
    room: str, moved: Mapping[str, Collection[str]] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a room.

    Args:
        room: The name of its package, whose `__init__` imports the public names under `if TYPE_CHECKING:`.
        moved: The public names of before that are now in another room, by that room. Code that imports them here finds
            them, and `dir` does not list them.
    """
    package = sys.modules[room]
    modules: dict[str, str] = {}
    rooms = {name: other for other, names in (moved or {}).items() for name in names}

    def module_of(name: str) -> str | None:
        # The parser is imported with the first name, because a process that uses no face does not need it.
        if not modules:
            from pathlib import Path

            modules.update(names_of(Path(str(package.__file__)).read_text(encoding="utf-8")))
        return modules.get(name) or rooms.get(name)

    def get(name: str) -> Any:
        # dunder names are asked for by the import system itself, and never belong to a face
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
    """Return the names of a face with the module of each, from the text of the room's `__init__`."""
    import ast

    blocks = [part for part in ast.parse(source).body if isinstance(part, ast.If)]
    listed = [part for block in blocks if ast.unparse(block.test) == "TYPE_CHECKING" for part in block.body]
    imports = [part for part in listed if isinstance(part, ast.ImportFrom) and part.module]
    return {each.name: str(part.module) for part in imports for each in part.names if each.asname == each.name}
