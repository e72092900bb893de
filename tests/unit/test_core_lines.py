"""What the core is, how its lines are counted, and that it names nothing that a package brings."""

import re
import subprocess
import tomllib

import pytest
from core_lines import APART, ROOT, code_lines, core_files

from telenano.settings.known_packages import KNOWN_PACKAGES


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


def names_of_packages() -> tuple[set[str], set[str]]:
    """Return the names of the drivers, tasks and bridges that packages of the project bring, and of the packages."""
    drivers, packages = set[str](), set[str]()
    for path in sorted(ROOT.glob("packages/*/pyproject.toml")):
        project = tomllib.loads(path.read_text())["project"]
        packages |= {project["name"], project["name"].replace("-", "_")}
        entries = project.get("entry-points", {})
        drivers |= {name for kind in ("devices", "tasks") for name in entries.get(f"telenano.{kind}", {})}
    return drivers | {row.rpartition(" ")[2] for row in KNOWN_PACKAGES if row.startswith("command bridge ")}, packages


def test_the_core_names_what_packages_bring_in_one_table_of_suggestions() -> None:
    names, packages = names_of_packages()
    named = re.compile(rf"[\"'](?:{'|'.join(names)})[\"']|{'|'.join(packages)}")
    assert named.search("import telenano_lsl") and named.search('driver == "nanonis"') and not named.search("hd = 1")
    files = [path for path in core_files() if path.name != "known_packages.py"]
    found = {path.relative_to(ROOT).as_posix(): named.findall(path.read_text()) for path in files}
    assert {name: words for name, words in found.items() if words} == {}
