"""What outsiders run on their own copy: each command of the workflow is one that stands in the Makefile."""

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


def test_the_workflow_tries_every_python_that_the_project_names() -> None:
    classifiers = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["classifiers"]
    named = {match[1] for line in classifiers if (match := re.search(r"Python :: (3\.\d+)$", line))}
    assert set(WORKFLOW["jobs"]["unit"]["strategy"]["matrix"]["python"]) == named


# a private part of a package, or a module of it that its makers call internal: the package, and how it is written
PRIVATE = {
    "numba": r"\bnumba\.core\b",
    "typer": r"\btyper\.(core|main)\b",
}


def test_a_package_of_which_private_parts_are_used_has_an_upper_bound() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required = [
        *project["dependencies"],
        *(text for extra in project["optional-dependencies"].values() for text in extra),
    ]
    names = {re.split(r"[\[<>=]", text)[0] for text in required} - {"telenano"}
    bounded = {re.split(r"[\[<>=]", text)[0] for text in required if "<" in text}
    sources = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("proto", "presets", "recording", "services", "analysis", "studies", "telenano")
        for path in (ROOT / folder).rglob("*.py")
    )
    used = {name for name, pattern in PRIVATE.items() if re.search(pattern, sources)}
    # `from package._part import x`, `import package._part`, `package._part`
    modules = "|".join(re.escape(name.lower().replace("-", "_")) for name in names)
    used |= {found[1] for found in re.finditer(rf"\b(?<![.\w/])({modules})(?:\.\w+)*\._[a-z]\w*", sources)}
    assert used >= {"numba", "typer"}
    assert used - bounded == set()
