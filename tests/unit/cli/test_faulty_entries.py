"""What a command says of an entry of a package that cannot be used, for each kind of entry and each fault of it.

The faults are that its module does not exist, that the module has no such name, that its import raises, and that the
call of what it leads to raises. Drivers, operators, samples and programs are called in a running node alone, where
`tests/stack/test_faulty_packages.py` has them raise.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from telenano.cli.new_package import new_package
from telenano.settings.plugins import KINDS
from telenano.testing import describe_package, environment_with

pytestmark = pytest.mark.check("one process loads every entry of every kind and runs the doctor")

TARGETS = {"absent": "hollow.gone:IT", "lost": "hollow:gone", "raising": "hollow.raising:IT"}
SAID = {
    "absent": "ModuleNotFoundError: No module named 'hollow.gone'",
    "lost": "AttributeError: module 'hollow' has no attribute 'gone'",
    "raising": "RuntimeError: no licence",
    "failing": "no licence",
    "number": "hollow.failing:NUMBER must be a function or a group of typer that can be imported",
    "typo": "table_absent of the package hollow 1.2 cannot be used: ModuleNotFoundError",
    "unfinished": "the package hollow returned NoneType, and must return a CopyResult; choose another format",
}
# what the entry `failing` of a kind leads to
CALLED = {
    "checks": "hollow.failing:call",
    "exports": "hollow.failing:call",
    "laws": "hollow.law:FAILING",
    "readers": "hollow.failing:READER",
    "scenarios": "hollow.failing:call",
    "tasks": "hollow.task:FAILING",
}
FAILING = """
from telenano.settings import FileReader
NUMBER = 3
READER = FileReader(heights="hollow.failing:call")
def call(*words):
    raise RuntimeError("no licence")
def run(json: bool = False):
    call()
def unfinished(*words):
    pass
"""
EXPERIMENT = """
name: check
title: check
scenario: fig12
tasks: [{0}]
factors: {{law: [wave]}}
participants: 1
repetitions: 1
"""
# The commands that ask for an entry; a dictionary of commands has rows, which are entries in their turn.
ASKED = {
    "laws": ["law check {0}", "param get controller.law --set controller.law={0}"],
    "devices": ["device probe --device {0}", "param get afm_node.driver --set afm_node.driver={0}"],
    "operators": ["param get haptic_node.operator --set haptic_node.operator.kind={0}"],
    "samples": [
        "param get afm_node.environment --set afm_node.environment={0}",
        "study stability --environment {0} --law wave",
    ],
    "programs": ["param get afm_node.begin --set afm_node.begin.program={0}"],
    "tasks": ["experiment check experiment_{0}.yaml"],
    "scenarios": ["scenario show {0}"],
    "commands": ["{0}", "bag {0}"],
    "checks": ["doctor"],
    "advisers": ["doctor"],
    "exports": ["bag export recorded/session.mcap --out written --to {0}"],
    "readers": ["sample --out written --sample a.{0}"],
    "functions": ["doctor"],
    "topics": ["topic info wind/{0}"],
    "panels": ["doctor"],
    "transports": ["doctor"],
}
PROGRAM = """
import contextlib, io, json, sys
import numpy as np
from pathlib import Path
from typer.testing import CliRunner
from telenano.cli.root import app
from telenano.recording.made_records import write_recording
from telenano_lab.microscopy.image_files import Image
from telenano_lab.microscopy.image_output import write_images
from telenano.wire import example
from telenano.recording import recorded

write_recording(Path("recorded"), [recorded("session/event", example("session/event"), 10**18)])
told = {}
for line in json.load(sys.stdin):
    done = CliRunner().invoke(app, [*line.split(), "--json"])
    broken = None if isinstance(done.exception, (SystemExit, type(None))) else repr(done.exception)
    told[line] = (done.exit_code, done.stderr, broken, done.stdout)
with contextlib.redirect_stderr(io.StringIO()) as said:
    write_images(Path(), {"height": Image("Height", "m", np.zeros((2, 4)), 4e-8, 2e-8)}, "tapping")
json.dump({"commands": told, "images": said.getvalue().splitlines()}, sys.stdout)
"""


def faults_of(kind: str) -> list[str]:
    """Return the faults that an entry of a kind can have, by the name that the entry has here."""
    also = {"commands": ["failing", "number", "typo"], "exports": ["failing", "unfinished"]}
    return [*TARGETS, *also.get(kind, ["failing"] if kind in CALLED else [])]


def install(site: Path) -> None:
    """Put a package with every fault of every kind where Python finds it."""
    package = site / "hollow"
    package.mkdir(parents=True)
    rows = {**TARGETS, "failing": "hollow.failing:run", "number": "hollow.failing:NUMBER"}
    table = {f"{group}{name}": (target, "A command.") for group in ("", "bag ") for name, target in rows.items()}
    files = {
        "__init__.py": "",
        "raising.py": "raise RuntimeError('no licence')\n",
        "failing.py": FAILING,
        "rows.py": f"ROWS = {table!r}\n",
    }
    for kind, line in (("law", "    def to_params("), ("task", "    def duration_s(")):
        source = new_package(kind, "failing", site.parent / kind)[2].read_text()  # type: ignore[arg-type]
        head, _, rest = source.partition(line)
        signature, _, body = rest.partition(":\n")
        files[f"{kind}.py"] = f"{head}{line}{signature}:\n        raise RuntimeError('no licence')\n{body}"
    for name, text in files.items():
        (package / name).write_text(text)
    entries = {kind: dict(TARGETS) for kind in KINDS}
    for kind, target in CALLED.items():
        entries[kind]["failing"] = target
    # the name of a topic is two words
    entries["topics"] = {f"wind_{fault}": target for fault, target in TARGETS.items()}
    images = {f"image_{fault}": target for fault, target in entries["exports"].items()}
    entries["exports"] |= {"unfinished": "hollow.failing:unfinished", **images}
    entries["commands"] = {"rows": "hollow.rows:ROWS", **{f"table_{name}": to for name, to in TARGETS.items()}}
    describe_package(site, "hollow", entries)


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Run every command in one process; return for each its exit code, what it says, and what it raised."""
    folder = tmp_path_factory.mktemp("faulty")
    install(folder / "site")
    for name in (*TARGETS, "failing"):
        (folder / f"a.{name}").write_bytes(b"a file of this package")
        (folder / f"experiment_{name}.yaml").write_text(EXPERIMENT.format(name))
    lines = [line.format(fault) for kind, lines in ASKED.items() for line in lines for fault in faults_of(kind)]
    found = environment_with(folder / "site")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        input=json.dumps(lines), capture_output=True, text=True, cwd=folder, env=found, check=True,
    )  # fmt: skip
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("line", "fault"),
    [
        (line, fault)
        for kind, lines in ASKED.items() if lines != ["doctor"]
        for line in lines for fault in faults_of(kind)
    ],
)  # fmt: skip
def test_a_command_that_asks_for_a_faulty_entry_ends_with_a_sentence(
    told: dict[str, Any], line: str, fault: str
) -> None:
    code, err, broken, out = told["commands"][line.format(fault)]
    assert broken is None
    (said,) = err.splitlines()
    assert said.startswith("telenano: ") and "the package hollow" in said and SAID[fault] in said
    assert fault != "typo" or said.startswith("telenano: no such command 'typo'; ")
    assert json.loads(out)["error"] in said
    # What raises when it is run fails; what cannot be read or imported is a fault of what names it.
    ran = fault in ("failing", "unfinished") and line.startswith(("{0}", "bag", "experiment"))
    assert code == (1 if ran else 2)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "tasks"])
def test_the_doctor_names_every_faulty_entry(told: dict[str, Any], kind: str) -> None:
    code, _, broken, out = told["commands"]["doctor"]
    found = "\n".join(finding["found"] for finding in json.loads(out)["findings"])
    assert broken is None and code in (0, 1)
    for fault in TARGETS:
        name = f"table_{fault}" if kind == "commands" else fault
        assert f"{name} of the package hollow 1.2 cannot be used: {SAID[fault]}" in found
    assert "the package hollow 1.2 failed (hollow.failing, line 6, in call): RuntimeError: no licence" in found


@pytest.mark.parametrize("fault", [*TARGETS, "failing"])
def test_an_image_that_a_faulty_entry_does_not_write_is_named(told: dict[str, Any], fault: str) -> None:
    (said,) = (line for line in told["images"] if f"scan.{fault} was not written" in line)
    assert "the package hollow 1.2" in said and SAID[fault] in said


def test_every_kind_of_entry_is_asked_for() -> None:
    assert set(ASKED) == set(KINDS)
