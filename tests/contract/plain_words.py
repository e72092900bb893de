"""Count the words that CONTRIBUTING.md has a plainer one for: `python tests/contract/plain_words.py [KIND …]`.

With a kind (identifier, message, prose, value) it lists where each of them is. The table names each word and what is
written instead. A word marked `*` may stand in no identifier and in no message; every one is counted in comments,
docstrings and documents. A *value* is a variable, parameter or attribute whose name says what happened to it (`found`)
and not what it is. Tests, and files that are generated, are not looked at.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
TABLE = re.compile(r"^\| (?P<words>[^|]+?)(?P<worst> \*)? \| (?P<instead>[^|]+) \|$", re.MULTILINE)
GENERATED = (
    "docs/cli.md",
    "docs/scenarios.md",
    "docs/summary.md",
    "docs/reliability.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
)
# Names of values that do not say what the value is.
NAMES_OF_NOTHING = ("found", "given", "known", "said", "told")
PROSE_IN_CODE = {
    ".ts": re.compile(r"//.*|/\*.*?\*/", re.DOTALL),
    ".yaml": re.compile(r"#.*"),
    ".yml": re.compile(r"#.*"),
}


class Word(NamedTuple):
    """A row of the table: the pattern of its words, and whether no identifier and no message may have it."""

    name: str
    pattern: "re.Pattern[str]"
    is_worst: bool


class Finding(NamedTuple):
    """A word in its place; kind is identifier, message, prose or value."""

    kind: str
    word: Word
    place: str


def words() -> list[Word]:
    """Return the rows of the table in CONTRIBUTING.md."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    begin = text.index("| instead of | write |")
    rows = TABLE.findall(text[begin : text.index("\n\n", begin)])
    return [
        Word(names, pattern_of(names), bool(worst))
        for names, worst, _ in rows
        if not names.startswith("instead of") and set(names) != {"-"}
    ]


def pattern_of(names: str) -> "re.Pattern[str]":
    """Return a pattern for the words of a row, which commas part; letters next to them make another word."""
    parts = "|".join(r"\s+".join(map(re.escape, name.split())) for name in names.split(","))
    return re.compile(rf"(?<![a-z])(?:{parts})(?![a-z])", re.IGNORECASE)


def findings(known: list[Word]) -> Iterator[Finding]:
    """Yield every word of the table in the files of the project that people read or call."""
    # Most texts have none of the words, which one search finds out.
    any_word = re.compile("|".join(word.pattern.pattern for word in known), re.IGNORECASE)
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        path = ROOT / name
        is_test = name.startswith(("tests/", "benchmarks/")) or bool({"test", "tests"} & set(path.parts))
        if is_test or name in GENERATED or not path.exists():
            continue
        if path.suffix == ".py":
            texts = list(of_python(path.read_text(encoding="utf-8")))
        elif path.suffix == ".md":
            texts = [("prose", 1, path.read_text(encoding="utf-8"))]
        elif path.suffix in PROSE_IN_CODE:
            found = PROSE_IN_CODE[path.suffix].findall(path.read_text(encoding="utf-8"))
            texts = [("prose", 1, text) for text in found]
        else:
            continue
        if path.suffix == ".py":
            yield from vague_values(path.read_text(encoding="utf-8"), name)
        for kind, line, text in texts:
            if not any_word.search(text):
                continue
            for word in known if kind == "prose" else [word for word in known if word.is_worst]:
                for _ in word.pattern.finditer(text):
                    yield Finding(kind, word, f"{name}:{line}")


def vague_values(text: str, name: str) -> Iterator[Finding]:
    """Yield the values of a module that `NAMES_OF_NOTHING` name, with an underscore in front of it or without."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Name | ast.Attribute | ast.arg):
            for identifier in identifiers(node):
                if (plain := identifier.lstrip("_")) in NAMES_OF_NOTHING:
                    yield Finding("value", Word(plain, pattern_of(plain), True), f"{name}:{node.lineno}")


def of_python(text: str) -> Iterator[tuple[str, int, str]]:
    """Yield identifiers, messages and prose of a module, each with its line; identifiers are split into words."""
    tree = ast.parse(text)
    docstrings = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                docstrings.add(id(first.value))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield ("prose" if id(node) in docstrings else "message"), node.lineno, node.value
        for identifier in identifiers(node):
            parted = re.sub(r"([a-z])([A-Z])", r"\1 \2", identifier).replace("_", " ")
            yield "identifier", getattr(node, "lineno", 1), parted
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield "prose", token.start[0], token.string


def identifiers(node: ast.AST) -> Iterator[str]:
    """Yield the names that a node gives to something."""
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        yield node.id
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
        yield node.attr
    elif isinstance(node, ast.arg):
        yield node.arg
    elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name


def ceilings() -> dict[str, int]:
    """Return how many such words may stand in each kind of text; none of the numbers may rise."""
    document = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    found: dict[str, int] = document["tool"]["telenano"]["other-words-at-most"]
    return found


def main() -> int:
    found = list(findings(words()))
    counts = {kind: [one for one in found if one.kind == kind] for kind in ("identifier", "message", "prose", "value")}
    for kind, ones in counts.items():
        by_word = {one.word.name: 0 for one in ones}
        for one in ones:
            by_word[one.word.name] += 1
        sys.stdout.write(f"{kind}: {len(ones)} {by_word}\n")
    for kind in sys.argv[1:]:
        for one in sorted(counts[kind], key=lambda one: one.word.name):
            sys.stdout.write(f"{one.word.name}: {one.place}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
