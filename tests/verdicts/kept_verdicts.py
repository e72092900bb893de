"""What the judge says of two hundred labelled courses, kept, so that a change shows which verdicts it turns.

`python tests/verdicts/kept_verdicts.py` judges them and writes them again; read the difference before you commit it.
"""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

from courses import Course, course
from judge import judge_course
from nonlinear import nonlinear_course

KEPT = Path(__file__).with_suffix(".json")
# seeds of none of the generators' limits
SEEDS = range(90_000, 90_100)
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def made() -> Iterator[tuple[str, Course]]:
    """Yield the courses by the name of generator and seed."""
    for seed in SEEDS:
        yield f"linear {seed}", course(seed)
        yield f"nonlinear {seed}", nonlinear_course(seed)


def verdicts() -> dict[str, list[str]]:
    """Return kind and reason of each course."""
    return {name: list(judge_course(one)) for name, one in made()}


def kept() -> dict[str, list[str]]:
    """Return what is kept."""
    found: dict[str, list[str]] = json.loads(KEPT.read_text("utf-8"))
    return found


def is_same(one: str, other: str) -> bool:
    """Return whether two sentences have the same words, and numbers that differ by less than a hundredth."""
    if _NUMBER.sub("#", one) != _NUMBER.sub("#", other):
        return False
    pairs = zip(_NUMBER.findall(one), _NUMBER.findall(other), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=1e-2, abs_tol=1e-9) for a, b in pairs)


if __name__ == "__main__":
    KEPT.write_text(json.dumps(verdicts(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
