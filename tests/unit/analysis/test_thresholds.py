"""The thresholds of the verdicts are those of the table in docs/studies.md, and no more than twelve."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from telenano.analysis import holds, modes, verdict

STUDIES = Path(__file__).parents[3] / "docs" / "studies.md"
ROW = re.compile(r"^\| `([A-Z_]+)` \| ([0-9.]+) \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)
# settings of the fit and names, which decide about no motion
NO_THRESHOLDS = {"LEAST_SAMPLES", "LONGEST_STEP_S", "REPORTED_WITHIN_S"}

# numbers in comparisons that are no thresholds, by module and function
NO_DECISION = {
    ("verdict", "judge"): {2: "eight windows of eight samples"},
    ("verdict", "_by_modes"): {
        0.5: "half a turn is a swing, and half of a size is of its order",
        2.0: "half of an amplitude from peak to peak by its root, and either side of a change",
        3.0: "parts of a stretch",
        50.0: "keeps the exponential finite",
    },
    ("verdict", "_left"): {1e-6: "digits of a sentence"},
    ("verdict", "_words"): {0.5: "half a turn is a swing"},
    ("verdict", "_undecided"): {0.25: "words of a quarter of a turn", 0.1: "words of a noise that matters"},
    ("verdict", "_by_windows"): {0.5: "half of a size is of its order", 50.0: "keeps the exponential finite"},
    ("verdict", "_falls_as_noise"): {0.25: "a density that goes with the root of the frequency"},
    ("verdict", "_has_line"): {2.0: "neighbours that have a mean", 1.4: "change of a 1/f density in half an octave"},
    ("verdict", "rounding_of"): {4: "a read-out that rounds repeats its values"},
    ("verdict", "_approaching"): {2.0: "either side of a change"},
    ("verdict", "_gone"): {0.5: "the later half", 2: "a square"},
    ("verdict", "_recurs"): {2.0: "out of rest, and not at its edge"},
    ("verdict", "_even"): {1e-6: "rounding of time stamps"},
    ("holds", "_stood"): {3.0: "medians of a course without its ramps"},
    ("holds", "judge_holds"): {0.5: "the larger part of a hold"},
    ("holds", "_judge_hold"): {0.125: "the last part of an episode that is looked at alone"},
    ("holds", "_late"): {99.0: "what is usual on an uneven link"},
    ("holds", "_judged_contact"): {2.0: "half as long as the longest part"},
    ("holds", "_judge_swing"): {0.5: "half of a size is of its order"},
    ("holds", "_covered"): {0.5: "the larger part"},
}


def compared(tree: ast.AST, function: str = "", inside: bool = False) -> Iterator[tuple[str, float]]:
    """Give each number other than 0 and 1 that stands in a comparison, with the function that it is in."""
    for node in ast.iter_child_nodes(tree):
        name = node.name if isinstance(node, ast.FunctionDef) else function
        here = inside or isinstance(node, ast.Compare)
        if isinstance(node, ast.Constant):
            if here and type(node.value) in (int, float) and node.value not in (0, 1):
                yield name, float(node.value)
        else:
            # a place in a series decides nothing
            yield from compared(node.value if isinstance(node, ast.Subscript) else node, name, here)


def test_no_number_beside_the_table_decides() -> None:
    for module in (verdict, holds):
        own = module.__name__.rpartition(".")[2]
        found: dict[tuple[str, str], set[float]] = {}
        for function, value in compared(ast.parse(Path(str(module.__file__)).read_text("utf-8"))):
            found.setdefault((own, function), set()).add(value)
        assert found == {place: set(known) for place, known in NO_DECISION.items() if place[0] == own}


def test_a_number_in_a_comparison_is_found() -> None:
    rule = "def f(late, n):\n    return sum(late) > 2 or 7 * n // 8 < n or late[3] > 1"
    assert list(compared(ast.parse(rule))) == [("f", 2.0), ("f", 7.0), ("f", 8.0)]


def test_the_table_in_the_document_is_that_of_the_code() -> None:
    rows = {name: float(value) for name, value, _, _ in ROW.findall(STUDIES.read_text("utf-8"))}
    code = {
        name: float(value)
        for module in (modes, verdict, holds)
        for name, value in vars(module).items()
        if name.isupper() and not name.startswith("_") and isinstance(value, int | float)
    }
    assert {name: value for name, value in code.items() if name not in NO_THRESHOLDS} == rows
    assert len(rows) <= 12


def test_every_threshold_has_a_reason_above_it_in_the_code() -> None:
    for module in (modes, verdict, holds):
        lines = Path(str(module.__file__)).read_text("utf-8").splitlines()
        for number, line in enumerate(lines):
            if re.match(r"[A-Z][A-Z_]+ = [0-9.]+$", line):
                assert lines[number - 1].startswith("#"), line
