"""The command lines in the code blocks of all documents, and the test that runs each of them."""

import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

ROOT = Path(__file__).parents[2]
# Kinds of lines that tests/stack/test_documents_run.py runs unchanged.
ALONE, RIG, BESIDE, KEYS, PYTHON = "alone", "rig", "beside", "keys", "python"
# Lines that tests/stack/test_pictures.py runs, because they make a picture of the page.
PICTURE = "picture"
KINDS = (ALONE, RIG, BESIDE, KEYS, PYTHON, PICTURE)
# Commands that are run beside a rig, with arguments that end a command which would not end by itself.
FOR_A_MOMENT = {
    "session": (), "estop": (), "status": (), "link": (), "topic": (), "bridge": ("--duration", "1", "--port", "0"),
}  # fmt: skip
_BLOCK = re.compile(r"^( *)```([a-z]*)\n(.*?)^\1```", re.DOTALL | re.MULTILINE)
_SHELL = ("sh", "bash", "console")


class Rule(NamedTuple):
    """The test that runs lines of a page with a beginning, or the reason why none does."""

    page: str
    beginning: str
    test: str = ""
    reason: str = ""


def _rules() -> tuple[Rule, ...]:
    said = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    by_test = [Rule(*place, test=test) for test, places in said["run by"].items() for place in places]
    return (*by_test, *(Rule(*place, reason=reason) for reason, places in said["not run"].items() for place in places))


RULES = _rules()


class Line(NamedTuple):
    """A command line of a document, or a whole block of Python or MATLAB."""

    page: str
    block: int  # number of the block in its page
    language: str
    text: str

    @property
    def words(self) -> list[str]:
        """The arguments of `telenano`, or all words of another command."""
        words = shlex.split(self.text, comments=True)
        return words[1:] if words and Path(words[0]).name == "telenano" else words

    @property
    def out(self) -> str:
        """The value of `--out`; empty without it."""
        words = self.words if self.language in _SHELL else []
        return words[words.index("--out") + 1] if "--out" in words else ""

    @property
    def is_telenano(self) -> bool:
        words = shlex.split(self.text, comments=True) if self.language in _SHELL else []
        return bool(words) and Path(words[0]).name == "telenano"


class Picture(NamedTuple):
    """A picture of a page whose title names the file that a command of the page writes."""

    page: str
    path: str  # beside the page
    origin: str  # such as out/delay/compare.png


@cache
def lines() -> tuple[Line, ...]:
    """Return every command line of every document of the project."""
    places = (
        "*.md",
        "docs/**/*.md",
        "*/README.md",
        "services/*/README.md",
        "telenano/*/README.md",
        "packages/*/telenano_*/*/*/*/README.md",
        "packages/*/README.md",
        "packages/*/docs/*.md",
        "proto/*.md",
    )
    found = {path for place in places for path in ROOT.glob(place)}
    # A folder telenano-NAME at the root is a package that a developer has made here with `telenano new`.
    pages = sorted(path for path in found if not path.relative_to(ROOT).parts[0].startswith("telenano-"))
    return tuple(line for page in pages for line in _lines_of(page))


@cache
def pictures() -> tuple[Picture, ...]:
    """Return the pictures of the documents that are made by a command."""
    return tuple(
        Picture(str(page.relative_to(ROOT)), *found)
        for page in sorted({ROOT / line.page for line in lines()})
        for found in re.findall(r'!\[[^\]]*\]\((\S+) "(out/\S+)"\)', page.read_text(encoding="utf-8"))
    )


def makes(line: Line, file: str) -> bool:
    """Return whether a line writes a file: in its `--out`, or by a block of Python that names it."""
    if line.language == "python":
        return f'"{file}"' in line.text
    return bool(line.out) and (file == line.out or file.startswith(f"{line.out}/"))


def of_kind(*kinds: str) -> list[Line]:
    """Return the lines of some kinds."""
    return [line for line in lines() if runner_of(line) in kinds]


def rule_of(line: Line) -> Rule | None:
    """Return the explicit rule for a line, the most specific one; None if there is none."""
    found = [rule for rule in RULES if line.page.endswith(rule.page) and line.text.startswith(rule.beginning)]
    return max(found, key=lambda rule: len(rule.beginning), default=None)


def runner_of(line: Line) -> str:
    """Return the kind of a line, the test that runs it, or the reason why none does; empty if that is undefined."""
    if rule := rule_of(line):
        return rule.test or rule.reason
    if line.language == "python":
        return PYTHON
    if not line.is_telenano or "&&" in line.words:
        return ""
    if any(makes(line, picture.origin) for picture in pictures() if picture.page == line.page):
        return PICTURE
    command = line.words[0]
    return RIG if command == "up" else KEYS if command == "keys" else BESIDE if command in FOR_A_MOMENT else ALONE


def _lines_of(page: Path) -> Iterator[Line]:
    name = str(page.relative_to(ROOT))
    for number, found in enumerate(_BLOCK.finditer(page.read_text(encoding="utf-8"))):
        language, text = found[2], found[3]
        if language in ("python", "matlab"):
            yield Line(name, number, language, text)
        if language not in _SHELL:
            continue
        for line in text.replace("\\\n", " ").splitlines():
            # A console block also contains the output of the command.
            if line.strip().startswith("$ ") if language == "console" else shlex.split(line, comments=True):
                yield Line(name, number, language, line.strip().removeprefix("$ "))


def differing(made: Path, shipped: Path) -> float:
    """Return the share of pixels of two pictures that differ in brightness; 1 if the pictures differ in size."""
    from PIL import Image

    now, then = (np.asarray(Image.open(path).convert("L"), dtype=float) for path in (made, shipped))
    return float(np.mean(np.abs(now - then) > 48.0)) if now.shape == then.shape else 1.0
