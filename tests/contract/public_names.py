"""The names that a package may use: the faces of rooms, and what `telenano.extend` has.

`python tests/contract/public_names.py` counts them by room; with the name of a package it lists what that package
uses. A name that no package, no template and no example uses is not public for anybody, and goes.
"""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from telenano.faces import names_of

ROOT = Path(__file__).parents[2]
# A package may import `telenano` itself too, whose names are those of `telenano.__all__`.
API = "telenano"


@cache
def offered() -> dict[str, set[str]]:
    """Return the public names by the module that a package imports them from."""
    library = ROOT / "telenano"
    found = {
        f"telenano.{path.parent.name}": set(names_of(path.read_text("utf-8"))) for path in library.glob("*/__init__.py")
    }
    for path in sorted((library / "extend").glob("[a-z]*.py")):
        found[f"telenano.extend.{path.stem}"] = set(names_in(ast.parse(path.read_text("utf-8")).body))
    # a room with code of its own in its `__init__`
    found["telenano.settings"] |= set(
        names_in(ast.parse((library / "settings" / "__init__.py").read_text("utf-8")).body)
    )
    found[API] = set(names_of_all(library / "__init__.py"))
    return {module: names for module, names in found.items() if names}


def names_of_all(path: Path) -> list[str]:
    """Return what `__all__` of a module lists."""
    for part in ast.parse(path.read_text("utf-8")).body:
        if isinstance(part, ast.Assign) and ast.unparse(part.targets[0]) == "__all__":
            return list(ast.literal_eval(part.value))
    return []


def names_in(body: list[ast.stmt]) -> Iterator[str]:
    """Yield the names that the statements of a module define, or import as themselves, for others."""
    names: list[str | None] = []
    for part in body:
        match part:
            case ast.ImportFrom():
                names += [each.asname for each in part.names if each.asname == each.name]
            case ast.FunctionDef() | ast.ClassDef():
                names.append(part.name)
            case ast.Assign():
                names += [each.id for each in part.targets if isinstance(each, ast.Name)]
            case ast.AnnAssign(target=ast.Name(id=name)):
                names.append(name)
    yield from (name for name in names if name and not name.startswith("_"))


def imports_in(text: str) -> Iterator[tuple[str, str]]:
    """Yield module and name of each import of the project in a source, and of what is read of an imported module."""
    tree = ast.parse(text)
    modules: dict[str, str] = {}
    for part in ast.walk(tree):
        if isinstance(part, ast.ImportFrom) and (part.module or "").split(".")[0] in ("telenano", "services"):
            for each in part.names:
                module = f"{part.module}.{each.name}"
                if (ROOT / module.replace(".", "/")).with_suffix(".py").is_file():
                    modules[each.asname or each.name] = module
                yield str(part.module), each.name
        elif isinstance(part, ast.Import):
            for each in part.names:
                if each.name.split(".")[0] in ("telenano", "services"):
                    modules[each.asname or each.name.split(".")[0]] = each.name if each.asname else "telenano"
    for part in ast.walk(tree):
        if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name) and part.value.id in modules:
            yield modules[part.value.id], part.attr


def files_of(package: str) -> list[Path]:
    """Return the modules of a package of the project, without its tests."""
    folder = ROOT / "packages" / package
    return [
        path for path in sorted(folder.rglob("*.py")) if path.relative_to(folder).parts[0] not in ("tests", "build")
    ]


PACKAGES = sorted(path.parent.name for path in ROOT.glob("packages/*/pyproject.toml"))


@cache
def used_by(package: str) -> frozenset[tuple[str, str]]:
    """Return module and name of all that a package uses of the project."""
    return frozenset(name for path in files_of(package) for name in imports_in(path.read_text("utf-8")))


@cache
def used_by_strangers() -> frozenset[tuple[str, str]]:
    """Return module and name of all that the templates of `telenano new` and the examples of the documents use."""
    texts = [path.read_text("utf-8") for path in sorted((ROOT / "telenano" / "templates").glob("*.py.txt"))]
    for path in (*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "packages").glob("*/README.md"))):
        texts += re.findall(r"```python\n(.*?)```", path.read_text("utf-8"), re.DOTALL)
    statements = [
        part
        for text in texts
        for part in re.findall(r"^ *from telenano[\w.]* import (?:\([^)]*\)|.*)", text, re.MULTILINE)
    ]
    return frozenset(name for part in statements for name in imports_in(part.strip()))


def at_most() -> int:
    """Return the greatest number of public names that pyproject.toml allows."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    return int(settings["tool"]["telenano"]["public-names-at-most"])


if __name__ == "__main__":
    if len(sys.argv) > 1:
        for module, name in sorted(used_by(sys.argv[1])):
            sys.stdout.write(f"{module}.{name}\n")
    else:
        for module, names in sorted(offered().items()):
            sys.stdout.write(f"{len(names):5d} {module}\n")
        sys.stdout.write(f"{sum(map(len, offered().values())):5d} public names\n")
