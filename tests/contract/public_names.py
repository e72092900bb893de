"""The names that a package may use: the faces of rooms, and what `telenano.extend` has.

`python tests/contract/public_names.py` counts them by room; with a room, such as `telenano.recording`, it lists its
names, and with a package of the project what that package uses. A name that no package, no template and no example
uses is not public for anybody, and goes.
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
    # a package may have a face of its own
    found["telenano.faces"] = {"face"}
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
                targets = [each for target in part.targets for each in getattr(target, "elts", [target])]
                names += [each.id for each in targets if isinstance(each, ast.Name)]
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
            module = modules[part.value.id]
            # a value of the program may have the name of a module
            if module == API or part.attr in named_in(module):
                yield module, part.attr


@cache
def named_in(module: str) -> frozenset[str]:
    """Return every name at the top of a module of the project, its imports too."""
    body = ast.parse((ROOT / module.replace(".", "/")).with_suffix(".py").read_text("utf-8")).body
    imported = {each.asname or each.name for part in body if isinstance(part, ast.ImportFrom) for each in part.names}
    return frozenset({*names_in(body), *imported})


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
        text = path.read_text("utf-8")
        texts += re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        texts += re.findall(r"`(from telenano[\w.]* import [\w, ]+)`", text)
    statements = [
        part
        for text in texts
        for part in re.findall(r"^ *from telenano[\w.]* import (?:\([^)]*\)|.*)", text, re.MULTILINE)
    ]
    return frozenset(name for part in statements for name in imports_in(part.strip()))


def counted() -> set[tuple[str, str]]:
    """Return module and name of what is public: all that faces list, and of `telenano.extend` what somebody uses.

    A module of `telenano.extend` has what the core needs of it as well.
    """
    used = {name for package in PACKAGES for name in used_by(package)} | used_by_strangers()
    names = {(module, name) for module, listed in offered().items() for name in listed}
    return {row for row in names if row in used or not row[0].startswith("telenano.extend.")}


def at_most() -> int:
    """Return the greatest number of public names that pyproject.toml allows."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    return int(settings["tool"]["telenano"]["public-names-at-most"])


if __name__ == "__main__":
    if len(sys.argv) > 1:
        asked = sys.argv[1]
        listed = {(asked, name) for name in offered()[asked]} if asked in offered() else used_by(asked)
        sys.stdout.writelines(f"{module}.{name}\n" for module, name in sorted(listed))
    else:
        for module in sorted(offered()):
            sys.stdout.write(f"{sum(row[0] == module for row in counted()):5d} {module}\n")
        sys.stdout.write(f"{len(counted()):5d} public names\n")
