"""The map of the paper and its errata: complete, and every function and command in it exists."""

import pkgutil
import re
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import pytest
from rig_graph import edges

from telenano.wire.nodes import name_of

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
SVG = "{http://www.w3.org/2000/svg}"
FOLDERS = ("services", "telenano", "packages/telenano-lab/telenano_lab/studies")
SOURCES = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]


def rows(page: str) -> list[list[str]]:
    """Return the cells of each row of the tables of a page, without heads."""
    lines = (DOCS / page).read_text(encoding="utf-8").splitlines()
    found = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    return [row for row in found if set(row[0]) - {"-"}]


def equations_of(text: str) -> set[int]:
    found = set()
    for first, last in re.findall(r"Eq\. ?(\d+)(?:[-–](\d+))?", text):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def test_every_equation_that_the_code_cites_is_in_the_map() -> None:
    cited = {number for path in SOURCES for number in equations_of(path.read_text(encoding="utf-8"))}
    listed = {number for row in rows("paper.md") for number in equations_of(row[0])}
    assert len(cited) > 10
    # the paper has 17 equations
    assert cited <= listed == set(range(1, 18))


NAMED = re.compile(r"`((?:services|telenano|telenano_lab.studies)\.[a-zA-Z0-9_.]+)`")
FUNCTIONS = sorted({name for row in rows("paper.md") for name in NAMED.findall(row[3])})


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_of_the_map_exists(name: str) -> None:
    assert pkgutil.resolve_name(name) is not None


def test_every_link_between_the_pages_leads_somewhere() -> None:
    pages = [
        *ROOT.glob("*.md"),
        *DOCS.rglob("*.md"),
        *ROOT.glob("*/README.md"),
        *ROOT.glob("proto/*.md"),
        *ROOT.glob("packages/*/*.md"),
        *ROOT.glob("packages/*/docs/*.md"),
        *ROOT.glob("services/*/README.md"),
        *ROOT.glob("telenano/*/README.md"),
    ]
    broken = []
    for page in pages:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)(?: \"[^\"]*\")?\)", text):
            path, _, anchor = target.partition("#")
            if re.match(r"[a-z]+:", target):
                continue
            there = page.parent / path if path else page
            if not there.exists() or (anchor and there.suffix == ".md" and anchor not in anchors(there)):
                broken.append(f"{page.relative_to(ROOT)}: {target}")
    assert not broken


@cache
def anchors(page: Path) -> set[str]:
    """Return what the headings of a page are linked by."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    found: list[str] = []
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").strip().lower()
        name = re.sub(r"[^\w\- ]", "", words).replace(" ", "-")
        found.append(f"{name}-{found.count(name)}" if name in found else name)
    return set(found)


def test_the_diagram_of_the_architecture_is_the_graph_of_the_tables() -> None:
    drawn = ElementTree.parse(DOCS / "architecture.svg").getroot()
    arrows = {}
    for group in drawn.iterfind(f"{SVG}g[@id]"):
        assert group.find(f"{SVG}path") is not None
        arrows[group.attrib["id"]] = " ".join(str(words.text) for words in group.iter(f"{SVG}tspan"))
    topics: dict[str, list[str]] = {}
    for edge in edges():
        rate = f" {edge.rate_hz:g} Hz" if edge.rate_hz is not None else ""
        topics.setdefault(f"{edge.source}-{edge.reader}", []).append(f"{edge.topic}{rate}")
    assert arrows == {arrow: " ".join(words) for arrow, words in topics.items()}
    boxes = {words.text for words in drawn.iter(f"{SVG}text")}
    assert {name_of(node) for arrow in arrows for node in arrow.split("-")} <= boxes
    assert "](architecture.svg)" in (DOCS / "architecture.md").read_text(encoding="utf-8")


def test_the_site_has_every_page() -> None:
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r"\b([a-z0-9_-]+\.md)\b", text))
    assert {path.name for path in DOCS.glob("*.md")} <= named
