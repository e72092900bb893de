"""Lines of code of the core and of the tests: `python tests/unit/core_lines.py`.

Docstrings, comments and blank lines do not count, so that none of them is left out for the sake of the number.
"""

import ast
import io
import subprocess
import sys
import tokenize
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Each of them has a measure of its own: what they have more of is no burden of who reads the core.
APART = ("tests", "benchmarks", "examples", "packages")
# The tests of the rig and of its packages, with what only they use. Those of the page are in TypeScript.
TESTS = ("tests", "packages/*/tests/*")
_NO_CODE = frozenset(
    {
        *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING),
        tokenize.ENDMARKER,
    }
)
_WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def core_files() -> list[Path]:
    """Return the files of the core that git knows.

    Raises:
        OSError, subprocess.CalledProcessError: This is no checkout of git.
    """
    return _files("*.py", *(f":(exclude){folder}" for folder in APART))


def files_of_tests() -> list[Path]:
    """Return the files of the tests that git knows.

    Raises:
        OSError, subprocess.CalledProcessError: This is no checkout of git.
    """
    return [path for path in _files(*TESTS) if path.suffix == ".py"]


def _files(*patterns: str) -> list[Path]:
    command = ["git", "ls-files", "-z", "--", *patterns]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    # a file that was deleted and not yet committed is still listed
    return [path for name in listed.split("\0") if name and (path := ROOT / name).is_file()]


def code_lines(text: str) -> int:
    """Return how many lines of a module have code on them."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, _WITH_DOCSTRING) or ast.get_docstring(node, clean=False) is None:
            continue
        first = node.body[0]
        docstrings.update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docstrings)


def lines_of_tests() -> int:
    """Return how many lines of the tests have code on them."""
    return sum(code_lines(path.read_text(encoding="utf-8")) for path in files_of_tests())


def most_lines_of_tests() -> int:
    """Return the greatest number of lines of code in the tests that pyproject.toml allows."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return int(settings["tool"]["telenano"]["test-lines-at-most"])


if __name__ == "__main__":
    counts = {path.relative_to(ROOT).parts[0]: 0 for path in core_files()}
    for path in core_files():
        counts[path.relative_to(ROOT).parts[0]] += code_lines(path.read_text(encoding="utf-8"))
    for folder, count in sorted(counts.items(), key=lambda row: -row[1]):
        sys.stdout.write(f"{count:6d} {folder}\n")
    sys.stdout.write(f"{sum(counts.values()):6d} lines of code in the core\n")
    sys.stdout.write(f"{lines_of_tests():6d} lines of code in the tests\n")
