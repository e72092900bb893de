"""List every text that a command, a node, a report or the page can print: `python tests/contract/printed_texts.py`.

With a number N and a seed it draws N of them, for a reader who states each in other words without seeing the code. A
text is a string of four words or more that is no docstring; in the place of a value stands its expression in braces.
"""

import ast
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
_WORDS = re.compile(r"[A-Za-z][a-z']+(?:[ ,;:]+(?:`[^`]*`|\{[^}]*\}|[A-Za-z0-9'.-]+)){3,}")
_STRINGS_OF_THE_PAGE = re.compile(r"\"(?:[^\"\\\n]|\\.)*\"|`(?:[^`\\]|\\.)*`")


class Printed(NamedTuple):
    """A text and its place, `file:line`."""

    place: str
    text: str


def printed_texts() -> Iterator[Printed]:
    """Yield the texts of the library, the services, the packages and the page, in the order of their files."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.splitlines():
        path = ROOT / name
        is_shipped = name.startswith(("telenano/", "services/", "packages/", "deploy/"))
        if not is_shipped or {"tests", "test"} & set(path.parts) or not path.is_file():
            continue
        if path.suffix == ".py":
            yield from (Printed(f"{name}:{line}", text) for line, text in of_python(path.read_text("utf-8")))
        elif path.suffix in (".ts", ".js"):
            yield from (Printed(f"{name}:{line}", text) for line, text in of_script(path.read_text("utf-8")))


def of_python(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of what a module can print."""
    nodes = list(ast.walk(ast.parse(source)))
    # A string that stands alone is a docstring, and the parts of a formatted one belong to it.
    apart = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            apart |= {id(part) for part in ast.walk(node) if part is not node}
    strings = [node for node in nodes if isinstance(node, ast.JoinedStr | ast.Constant) and id(node) not in apart]
    for node in sorted(strings, key=lambda node: (node.lineno, node.col_offset)):
        text = ""
        for part in node.values if isinstance(node, ast.JoinedStr) else [node]:
            if isinstance(part, ast.FormattedValue):
                text += f"{{{ast.unparse(part.value)}}}"
            elif isinstance(part, ast.Constant) and isinstance(part.value, str):
                text += part.value
        if _WORDS.search(text):
            yield node.lineno, " ".join(text.split())


def of_script(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of what a module of the page can show."""
    for match in _STRINGS_OF_THE_PAGE.finditer(source):
        text = match[0][1:-1].replace("${", "{")
        if _WORDS.search(text) and "\n" not in text:
            yield source.count("\n", 0, match.start()) + 1, text


def main(arguments: list[str]) -> None:
    """Print all texts, or as many as the first argument says, drawn by the seed that is the second."""
    texts = list(printed_texts())
    if arguments:
        texts = random.Random(int(arguments[1])).sample(texts, int(arguments[0]))
    sys.stdout.writelines(f"{place}\t{text}\n" for place, text in texts)


if __name__ == "__main__":
    main(sys.argv[1:])
