"""One constant a line: each is assigned by itself, so that it has room for a comment of its own."""

import ast
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Tests, benchmarks and examples are left out, those of the packages as well.
LEFT_OUT = frozenset({"tests", "benchmarks", "examples"})


def sources() -> list[Path]:
    """Return the files of Python that git knows and that ship."""
    command = ["git", "ls-files", "-z", "--", "*.py"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    names = (Path(name) for name in listed.split("\0") if name)
    return [name for name in names if not LEFT_OUT & set(name.parts) and (ROOT / name).is_file()]


def shared_lines(text: str) -> Iterator[int]:
    """Yield the lines of a module on which several constants are assigned, in the module itself or in a class.

    An enumeration by `range` and the parts of one result have no tuple of values on the right, and are no such line.
    """
    blocks: list[list[ast.stmt]] = [ast.parse(text).body]
    for block in blocks:
        blocks += (statement.body for statement in block if isinstance(statement, ast.ClassDef))
        for statement in block:
            if not isinstance(statement, ast.Assign) or not isinstance(statement.targets[0], ast.Tuple | ast.List):
                continue
            values, count = statement.value, len(statement.targets[0].elts)
            is_tuple = isinstance(values, ast.Tuple | ast.List) and len(values.elts) == count
            if is_tuple or isinstance(values, ast.GeneratorExp | ast.ListComp):
                yield statement.lineno


@pytest.mark.check("parses every module that ships")
def test_each_constant_has_a_line_of_its_own() -> None:
    texts = {name: (ROOT / name).read_text(encoding="utf-8") for name in sources()}
    shared = [f"{name}:{line}" for name, text in texts.items() for line in shared_lines(text)]
    assert not shared, f"assign each constant on a line of its own, under its own comment: {', '.join(shared)}"


def test_the_library_the_processes_and_the_packages_are_looked_at() -> None:
    assert {"telenano", "services", "packages", "deploy"} <= {name.parts[0] for name in sources()}


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("A, B = 1, 2", [1]),
        ("A = 1\n(A, B) = (1.0, 's')", [2]),
        ("class C:\n    title, about = 'T', 'A sentence.'", [2]),
        ("A, B = (f'{x}' for x in 'ab')", [1]),
        ("A = 1, 2", []),
        ("A, B = range(2)", []),
        ("A, B = f()", []),
        ("def f():\n    a, b = 1, 2", []),
    ],
)
def test_a_line_of_several_constants_is_found(text: str, lines: list[int]) -> None:
    assert list(shared_lines(text)) == lines
