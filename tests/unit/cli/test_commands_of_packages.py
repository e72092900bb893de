"""What a package adds to the command line and to the doctor, and what its being there must not change."""

import re
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.microscopy.force_curve import read_measured
from telenano_lab.microscopy.image_files import Image
from telenano_lab.microscopy.image_output import write_images
from typer.testing import CliRunner

from telenano.cli import lazy_commands
from telenano.cli.commands.doctor import checks_of_packages
from telenano.cli.root import app
from telenano.recording import recorded
from telenano.recording.export import export_recording
from telenano.recording.made_records import write_recording
from telenano.recording.provenance import plugin_facts
from telenano.sections.surface_files import read_surface
from telenano.settings import plugins
from telenano.testing import describe_package
from telenano.wire import example
from telenano.wire.errors import ConfigError
from telenano.wire.extras import how_to_add_package

RUNNER = CliRunner()
ROOT = Path(__file__).parents[3]


class Made:
    """Puts packages with entries on the path, as an installation by pip does."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def __call__(self, name: str, files: dict[str, str], entries: dict[str, str], requires: str = "telenano") -> None:
        (self.folder / name).mkdir()
        for file, text in {"__init__.py": "", **files}.items():
            (self.folder / name / file).write_text(text)
        rows = {kind: dict(line.split(" = ") for line in lines.splitlines()) for kind, lines in entries.items()}
        describe_package(self.folder, name, rows, more=f"Requires-Dist: {requires}\n")
        forget()


def forget() -> None:
    plugins._installed.cache_clear()
    plugins._digest.cache_clear()
    lazy_commands.package_commands.cache_clear()


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(plugins, "_problems", {})
    forget()
    before = set(sys.modules)
    yield Made(folder)
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(folder)):
            del sys.modules[name]
    forget()


COMMAND = """
import typer
def greet(name: str = "you") -> None:
    "Greet somebody."
    typer.echo(f"hello {name}")
group = typer.Typer()
@group.callback()
def of_group() -> None:
    "Two commands."
@group.command()
def first() -> None:
    "The first."
    typer.echo("first")
"""


def rows(**commands: str) -> str:
    return f"ROWS = { {words.replace('__', ' '): (target, 'Greet somebody.') for words, target in commands.items()} }\n"


def said(*words: str, code: int = 0) -> str:
    result = RUNNER.invoke(app, words)
    assert result.exit_code == code, result.output
    return result.output


def test_a_package_adds_commands_to_the_root_and_to_groups_at_any_depth(make: Any) -> None:
    files = {"rows.py": rows(greet="greeter.cli:greet", bag__greet="greeter.cli:greet", bag__more="greeter.cli:group"),
             "cli.py": COMMAND}  # fmt: skip
    make("greeter", files, {"commands": "greeter = greeter.rows:ROWS"})
    make("deeper", {"rows.py": rows(bag__more__greet="greeter.cli:greet")}, {"commands": "deeper = deeper.rows:ROWS"})
    sys.modules.pop("greeter.cli", None)
    help_text = said("--help")
    assert "Packages" in help_text and "greet" in help_text.partition("Packages")[2]
    assert "Greet somebody." in said("bag", "--help")
    # what is only listed is not imported
    assert "greeter.cli" not in sys.modules
    assert said("greet", "--name", "hand") == said("bag", "greet", "--name", "hand") == "hello hand\n"
    assert said("bag", "more", "first") == "first\n"
    assert "no such command 'greed'; did you mean greet?" in said("greed", code=2)


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        (rows(up="taker.cli:greet"), "there is a command 'up' already"),
        (rows(fine="taker.cli"), "'fine': 'taker.cli' is not words and module:function"),
        (
            "ROWS = {'fine': ('taker.cli:greet', None)}",
            "'fine': None is not a sentence",
        ),
        ("ROWS = {'fine': 7}", "TypeError"),
        ("ROWS = {7: ('taker.cli:greet', 'Greet.')}", "AttributeError"),
        ("ROWS = 7", "AttributeError"),
        ("ROWS = 3", "AttributeError"),
    ],
)
def test_a_table_of_commands_that_cannot_be_used_is_a_problem_and_hinders_nothing(
    make: Any, table: str, problem: str
) -> None:
    make("taker", {"rows.py": table, "cli.py": COMMAND}, {"commands": "taker = taker.rows:ROWS"})
    assert "Packages" not in said("--help")
    (text,) = plugins.known_problems()
    assert text.startswith("taker of the package taker 1.2 cannot be used: ") and problem in text
    assert "--scenario" in said("up", "--help")


def test_a_package_for_another_version_is_named_and_not_used(make: Any) -> None:
    make(
        "older", {"rows.py": rows(greet="older.cli:greet")}, {"commands": "older = older.rows:ROWS"}, "telenano==0.0.*"
    )
    assert "Packages" not in said("--help")
    (text,) = plugins.known_problems()
    own = version("telenano")
    assert f"it needs telenano ==0.0.*, and this is {own}: install its release for {own}" in text
    make("fits", {"rows.py": rows(greet="fits.cli:greet")}, {"commands": "fits = fits.rows:ROWS"}, "telenano>=0.1,<9")
    assert "Packages" in said("--help")


def test_a_command_of_a_known_package_that_is_not_installed_is_named_with_what_adds_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(lazy_commands, "package_commands", dict)
    text = said("bridge", "lsl", code=2)
    package = "telenano-bridges[lsl]"
    assert f"the command 'lsl' is in the package {package}: {how_to_add_package(package)}" in text
    text = said("experiment", "check", "delay_and_law", code=2)
    package = "telenano-lab[experiments]"
    assert f"the command 'experiment' is in the package {package}: {how_to_add_package(package)}" in text
    listed = said("--help-all")
    assert "  law " in listed and not {"study", "experiment", "benchmark"} & set(listed.split())


def test_packages_that_lockstep_does_not_run_change_no_digest_and_only_drivers_are_recorded(make: Any) -> None:
    def found() -> tuple[Any, ...]:
        run = plugins.in_lockstep()
        return plugins.digest_of_all(run), plugin_facts(), plugins.parts_of(run)

    before = found()
    make("tool", {"rows.py": rows(greet="tool.cli:greet")}, {"commands": "tool = tool.rows:ROWS"})
    assert found() == before
    make("laws_too", {"law.py": "LAW = 1"}, {"laws": "mine = laws_too.law:LAW", "commands": "laws_too = laws_too:X"})
    changed = found()[0]
    assert changed != before[0] and "laws.mine" in plugin_facts()
    make("driver", {"device.py": "DEVICE = 1"}, {"devices": "its = driver.device:DEVICE"})
    assert found()[0] == changed and "devices.its" in plugin_facts()
    assert not any(name.startswith("commands") for name in plugin_facts())


def test_checks_of_packages_are_findings_and_one_that_fails_is_one_too(make: Any) -> None:
    sound = "def check():\n    return [('cable', 'ok', 'it is plugged in')]\nBAD = 3\ndef broken():\n    return 1 / 0\n"
    lines = "cable = checker.all:check\nbroken = checker.all:broken\nbad = checker.all:missing"
    make("checker", {"all.py": sound}, {"checks": lines})
    found = {finding.name: finding for finding in checks_of_packages()}
    assert found["cable"].level == "ok" and found["cable"].advice == ""
    assert found["broken"].level == "warning"
    said = "the package checker 1.2 failed (checker.all, line 5, in broken): ZeroDivisionError: division by zero"
    assert found["broken"].found == said
    assert any("bad of the package checker" in text for text in plugins.known_problems())


def test_an_entry_that_has_to_be_a_function_and_is_none_is_told_with_its_package(make: Any, tmp_path: Path) -> None:
    make(
        "numeral",
        {"all.py": "THREE = 3\n"},
        {"checks": "three = numeral.all:THREE", "exports": "three = numeral.all:THREE"},
    )
    problem = "three of the package numeral 1.2 cannot be used: TypeError: is a int, must be a function"
    checks_of_packages()
    assert problem in plugins.known_problems()
    recording = write_recording(tmp_path / "recorded", [recorded("session/event", example("session/event"), 10**18)])
    with pytest.raises(ConfigError, match=problem):
        export_recording(recording, tmp_path / "x", "three")


def test_a_format_of_a_package_exports_a_recording_and_one_that_is_missing_is_named(
    make: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = """
from telenano.recording import CopyResult
def names(recording, target, selection):
    found = [message.plain()["src"] for message in recording.select(selection)]
    target.write_text(" ".join(found))
    return CopyResult(path=str(target), messages=len(found), skipped=())
"""
    make("namer", {"all.py": source}, {"exports": "names = namer.all:names\nbad = namer.all:no"})
    told = [recorded("session/event", example("session/event", seq=seq), 10**18 + seq) for seq in range(3)]
    recording = write_recording(tmp_path / "recorded", told)
    export_recording(recording, tmp_path / "names.txt", "names")
    assert len((tmp_path / "names.txt").read_text().split()) == 3
    with pytest.raises(ConfigError, match=r"bad of the package namer 1\.2 cannot be used: AttributeError"):
        export_recording(recording, tmp_path / "x", "bad")
    with pytest.raises(ConfigError, match=r"'nams' is not a format; did you mean names\?; known are mcap-json, "):
        export_recording(recording, tmp_path / "x", "nams")
    monkeypatch.setattr(plugins, "load", lambda *_, **__: plugins.LoadedEntries({}, {}))
    how = re.escape("the format ros2 is in the package telenano-bridges[ros2]: ")
    with pytest.raises(ConfigError, match=how):
        export_recording(recording, tmp_path / "x", "ros2")
    assert not (tmp_path / "x").exists()


IMAGES = """
def write(path, images, about):
    path.write_text(f"{about.mode} {about.sample} {' '.join(images)}")
def fail(path, images, about):
    path.write_text("half")
    raise ValueError("it is full")
"""


def test_an_image_is_written_in_the_formats_of_packages_and_kept_where_one_fails(
    make: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make("painter", {"all.py": IMAGES}, {"exports": "image_txt = painter.all:write\nimage_raw = painter.all:fail"})
    height = Image("Height", "m", np.zeros((2, 4)), 4e-8, 2e-8)
    files = write_images(tmp_path, {"height": height}, "tapping", sample="flat")
    assert (tmp_path / "scan.txt").read_text() == "tapping flat height"
    assert set(files) == {path.name for path in tmp_path.iterdir() if path.is_file()}
    assert set(files) >= {"scan.gwy", "scan.gsf", "scan.png", "scan.txt"}
    assert "scan.raw was not written: the package painter 1.2 failed" in capsys.readouterr().err


PAGE = (ROOT / "docs" / "extending" / "surfaces.md").read_text("utf-8")
READER = re.search(r"## My files.*?```python\n(.*?)```", PAGE, re.DOTALL)
LIBRARY = """
import numpy
def read(path):
    values = numpy.loadtxt(path)
    return type("Picture", (), {"width_m": 2e-7, "depth_m": 1e-7, "heights_m": values})
"""


def test_files_are_read_by_the_package_whose_entry_has_their_name(make: Any, tmp_path: Path) -> None:
    assert READER is not None
    files = {"files.py": READER[1], "none.py": "NONE = 3"}
    make("my_package", files, {"readers": "my_scan = my_package.files:MY_SCAN\nbad = my_package.none:NONE"})
    make("my_library", {"__init__.py": LIBRARY}, {})
    heights = np.array([[0.0, 1e-9, 2e-9], [3e-9, 4e-9, 5e-9]])
    np.savetxt(tmp_path / "a.my-scan", heights)
    found = read_surface(tmp_path / "a.my-scan")
    assert np.array_equal(found.height_m, heights)
    assert (found.width_m, found.depth_m) == pytest.approx((2e-7, 1e-7))
    (tmp_path / "b.my-scan").write_text("no numbers")
    with pytest.raises(ConfigError, match=r"b\.my-scan: could not convert string"):
        read_surface(tmp_path / "b.my-scan")
    (tmp_path / "c.bad").write_text("3")
    with pytest.raises(ConfigError, match=r"c\.bad: bad of the package my_package 1\.2 cannot be used: TypeError"):
        read_surface(tmp_path / "c.bad")
    # what has no curve is no file of curves
    with pytest.raises(
        ConfigError, match=r"a\.my-scan: is not a complete force curve: is of no format of force curves"
    ):
        read_measured(tmp_path / "a.my-scan")
