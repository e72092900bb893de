"""What the core and its tests are, how their lines are counted, and that the core names nothing of a package."""

import re
import subprocess
import tomllib

import pytest
from core_lines import APART, ROOT, code_lines, core_files, files_of_tests, lines_of_tests, most_lines_of_tests

from telenano.settings.known_packages import known_of


@pytest.fixture(scope="module", autouse=True)
def checkout() -> None:
    try:
        files = core_files()
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"which files belong to the core is known in a checkout of git alone: {error}")
    if not files:
        pytest.skip(f"git keeps nothing of {ROOT}: this is a copy inside another checkout")


def test_core_is_without_tests_benchmarks_and_packages() -> None:
    folders = {path.relative_to(ROOT).parts[0] for path in core_files()}
    assert {"services", "telenano"} <= folders and folders.isdisjoint(APART)


def test_docstrings_comments_and_blank_lines_are_no_code() -> None:
    text = '''"""A module.

Of two lines."""

# a comment
A = """one
two"""


def f():
    """Return."""
    return A
'''
    assert code_lines(text) == 4


def test_the_tests_are_those_of_the_rig_and_of_its_packages() -> None:
    names = {path.relative_to(ROOT).as_posix() for path in files_of_tests()}
    assert {"tests/unit/core_lines.py", "packages/telenano-lsl/tests/test_lsl_bridge.py"} <= names
    assert names.isdisjoint(path.relative_to(ROOT).as_posix() for path in core_files())
    assert not [name for name in names if "tests" not in name.split("/")]


@pytest.mark.check("reads every test")
def test_the_tests_have_no_more_lines_of_code_than_the_project_allows() -> None:
    assert lines_of_tests() <= most_lines_of_tests()


def names_of_packages() -> tuple[set[str], set[str]]:
    """Return the names of the drivers, tasks and bridges that packages of the project bring, and of the packages."""
    drivers, packages = set[str](), set[str]()
    for path in sorted(ROOT.glob("packages/*/pyproject.toml")):
        project = tomllib.loads(path.read_text())["project"]
        packages |= {project["name"], project["name"].replace("-", "_")}
        entries = project.get("entry-points", {})
        drivers |= {name for kind in ("devices", "tasks") for name in entries.get(f"telenano.{kind}", {})}
    return drivers | {row.removeprefix("bridge ") for row in known_of("command") if row.startswith("bridge ")}, packages


def test_the_core_names_what_packages_bring_in_one_table_of_suggestions() -> None:
    names, packages = names_of_packages()
    named = re.compile(rf"[\"'](?:{'|'.join(names)})[\"']|{'|'.join(packages)}")
    assert named.search("import telenano_lsl") and named.search('driver == "nanonis"') and not named.search("hd = 1")
    files = [path for path in core_files() if path.name != "known_packages.py"]
    found = {path.relative_to(ROOT).as_posix(): named.findall(path.read_text()) for path in files}
    assert {name: words for name, words in found.items() if words} == {}
