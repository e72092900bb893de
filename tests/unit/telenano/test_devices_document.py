"""docs/devices/faults.md: every fault has its row, and every test that a row names exists."""

import itertools
import re
import textwrap
from pathlib import Path

import pytest

from services.afm_node.config import AfmConfig
from services.haptic_node.config import HapticConfig
from services.runtime.settings.scenario import load_scenario

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "docs" / "devices" / "faults.md").read_text(encoding="utf-8")
NAMED = re.compile(r"(test_\w+\.py)::(test_\w+)(?:\[([^\]]+)\])?")
# a row of a table of faults, and one of a start that is refused
CASES = re.compile(r'^    "([^"]+)": (?:Fault|refused)\(|pytest\.param\(.*\bid="([^"]+)"\)', re.MULTILINE)


def found(name: str) -> str:
    (path,) = (ROOT / "tests").rglob(name)
    return path.read_text(encoding="utf-8")


def test_every_test_that_is_named_exists_with_its_case() -> None:
    named = NAMED.findall(TEXT)
    assert len(named) > 30
    for file, name, case in named:
        source = found(file)
        assert f"def {name}(" in source, f"{file}::{name}"
        cases = {first or second for first, second in CASES.findall(source)}
        # a table of faults for several devices has a row for each in a device's name
        cases |= {f"{case}-{kind}" for case in cases for kind in ("haply", "dhd", "hd", "gwyscope", "nanonis")}
        assert not case or case in cases, f"{file}::{name}[{case}]"


FAULTS = {"test_handle_faults.py": 15, "test_stage_faults.py": 15, "test_gwyscope.py": 14, "test_nanonis.py": 14}


@pytest.mark.parametrize("file", FAULTS)
def test_every_fault_that_is_tested_has_its_row(file: str) -> None:
    rows = {case for name, _, case in NAMED.findall(TEXT) if name == file}
    cases = {first or second for first, second in CASES.findall(found(file))}
    assert len(cases) > FAULTS[file]
    assert cases - rows == set()


# What may stand in a cell of a device in the place of a test.
WITHOUT = ("has none",)
COLUMNS = {"Haply Inverse3": "haply", "Force Dimension": "dhd", "Touch": "hd"}


def test_every_cell_of_a_device_has_its_test_and_every_fault_of_a_device_its_cell() -> None:
    """Hold the table of faults against the devices for which each fault is a case of the tests."""
    lines = TEXT.splitlines()
    (at,) = [number for number, line in enumerate(lines) if line.startswith("| fault | Haply Inverse3 |")]
    head = [cell.strip() for cell in lines[at].strip("|").split("|")]
    body = itertools.takewhile(lambda line: line.startswith("|"), lines[at + 2 :])
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in body]
    source = found("test_impedance_faults.py")
    table = re.search(r"^FAULTS.*?^}", source, re.MULTILINE | re.DOTALL)
    assert table is not None
    cases = set()
    for part in table[0].split('\n    "')[1:]:
        devices = re.search(r"devices=\(([^)]*)\)", part)
        kinds = re.findall(r'"(\w+)"', devices[1]) if devices else COLUMNS.values()
        cases |= {f"{part.split(chr(34))[0]}-{kind}" for kind in kinds}
    named = set()
    for row in rows:
        for title, kind in COLUMNS.items():
            cell = row[head.index(title)]
            tests = NAMED.findall(cell)
            assert tests or cell in WITHOUT, (row[0], title, cell)
            for file, _, case in tests:
                if case:
                    assert file == "test_impedance_faults.py" and case in cases, (row[0], title, case)
                    assert case.endswith(f"-{kind}"), (row[0], title, case)
                    named.add(case)
    assert len(rows) >= 16 and len(cases) > 28
    assert cases - named == set()


@pytest.mark.parametrize("page", ["devices", "devices/3-calibrate", "devices/4-first-touch"])
def test_scenarios_of_the_pages_are_valid(page: str, tmp_path: Path) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    blocks = [textwrap.dedent(block) for block in re.findall(r"^ *```yaml\n(.*?)```", text, re.MULTILINE | re.DOTALL)]
    scenarios = [block for block in blocks if block.startswith("name:")]
    assert len(scenarios) == 1
    path = tmp_path / "scenario.yaml"
    path.write_text(scenarios[0])
    found = load_scenario(path)
    found.section("afm_node", AfmConfig)
    found.section("haptic_node", HapticConfig)


def test_each_controller_has_its_column_of_faults_and_each_live_fault_both() -> None:
    """A table says of each fault what becomes of the tip of either controller; no cell is empty."""
    (head,) = re.findall(r"^\| fault of a controller \|.*\| Gwyscope, .*\| Nanonis, .*$", TEXT, re.MULTILINE)
    table = TEXT[TEXT.index(head) :].split("\n\n", 1)[0].splitlines()
    columns = head.count("|")
    assert len(table) > 14
    for row in table:
        assert row.count("|") == columns, row
        assert all(cell.strip() for cell in row.strip("|").split("|")), row
    live = {case for name, _, case in NAMED.findall(TEXT) if name == "test_controller_faults.py"}
    cases = {first or second for first, second in CASES.findall(found("test_controller_faults.py"))}
    assert live == {f"{case}-{kind}" for case in cases for kind in ("gwyscope", "nanonis")}
