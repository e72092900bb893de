"""What outsiders run on their own copy: each command of the workflow is one that stands in the Makefile."""

import itertools
import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
WORKFLOW: dict[str, Any] = yaml.safe_load((ROOT / ".github" / "workflows" / "checks.yml").read_text(encoding="utf-8"))
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def test_every_command_of_the_workflow_is_one_of_the_makefile() -> None:
    commands = [step["run"] for job in WORKFLOW["jobs"].values() for step in job["steps"] if "run" in step]
    targets = set(re.findall(r"^([a-z]+):", MAKEFILE, re.MULTILINE))
    assert len(commands) >= 5
    for command in commands:
        if command.startswith("make "):
            *_, target = command.split()
            assert target in targets, command
        else:
            assert command.replace(".venv/bin/", "$(BIN)/") in MAKEFILE, command


def test_test_and_check_together_run_every_test_that_ends_by_itself() -> None:
    runs = re.findall(r'\$\(BIN\)/pytest -m "([^"]+)"(.*?) \|\|', MAKEFILE)
    for is_check, is_stack, is_package in itertools.product((False, True), repeat=3):
        marks = {"check": is_check, "stack": is_stack, "endurance": False}
        folders = ("packages",) if is_package else ("tests/stack",) if is_stack else ("tests",)
        chosen = [
            expression for expression, rest in runs if rest.split()[-1] in folders and eval(expression, {}, marks)
        ]
        # a package starts real processes in a run of its own, which a person asks for
        assert len(chosen) == (0 if is_package and is_stack else 1), (marks, is_package, chosen)


def test_the_workflow_tries_every_python_that_the_project_names() -> None:
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["classifiers"]
    named = {match[1] for line in classifiers if (match := re.search(r"Python :: (3\.\d+)$", line))}
    assert set(WORKFLOW["jobs"]["unit"]["strategy"]["matrix"]["python"]) == named


# a module of a package that its makers call internal: the package, and how it is written
PRIVATE = {
    "numba": r"\bnumba\.core\b",
    "typer": r"\btyper\.(core|main)\b",
}
# private attributes of objects that packages made: the attribute, and the package
FOREIGN = {
    "_cache_file": "numba",
    "_getvalue": "numba",
    "_instance": "zenoh-ros2-sdk",
    "_load_index": "numba",
    "_py_file": "numba",
    "_py_func": "numba",
}
# public in the standard library in spite of their names
STANDARD = {"_asdict", "_exit", "_make", "_replace", "_value_"}


def sources() -> str:
    """Return all code of the project."""
    return "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("services", "telenano", "packages")
        for path in (ROOT / folder).rglob("*.py")
    )


def foreign_attributes(code: str) -> set[str]:
    """Return the private attributes that are used and nowhere defined, and those of another class by its name."""
    used = set(re.findall(r"(?<=[\w)\]]\.)_[a-z]\w*", code))
    defined = set(re.findall(r"(?<![\w.])_[a-z]\w*", code))
    defined |= set(re.findall(r"self\.(_[a-z]\w*)(?=: |(?:, [\w.]+)* =)", code))
    return (used - defined) | set(re.findall(r"[\"'](_[A-Z]\w*__\w+)[\"']", code))


def test_a_private_attribute_of_another_package_is_found() -> None:
    code = "self._own = 1\ndef _made(): pass\nx._made()\nkept._inside.close()\nvars(x)['_Writer__part']\nf(x)._deep"
    assert foreign_attributes(code) == {"_inside", "_Writer__part", "_deep"}


def test_a_package_of_which_private_parts_are_used_has_an_upper_bound() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required = [
        *project["dependencies"],
        *(text for extra in project["optional-dependencies"].values() for text in extra),
    ]
    for settings in ROOT.glob("packages/*/pyproject.toml"):
        required += tomllib.loads(settings.read_text(encoding="utf-8"))["project"]["dependencies"]
    names = {re.split(r"[\[<>=]", text)[0] for text in required} - {"telenano"}
    bounded = {re.split(r"[\[<>=]", text)[0] for text in required if "<" in text}
    code = sources()
    used = {name for name, pattern in PRIVATE.items() if re.search(pattern, code)}
    # `from package._part import x`, `import package._part`, `package._part`
    modules = "|".join(re.escape(name.lower().replace("-", "_")) for name in names)
    used |= {found[1] for found in re.finditer(rf"\b(?<![.\w/])({modules})(?:\.\w+)*\._[a-z]\w*", code)}
    assert foreign_attributes(code) - STANDARD == set(FOREIGN), "each needs its package in FOREIGN, and a bound"
    used |= set(FOREIGN.values())
    assert used >= {"numba", "typer"}
    assert used - bounded == set()
