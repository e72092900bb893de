"""What installed packages add is found by its entry points, and does no harm where it cannot be used."""

from email.message import Message
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from telenano.settings import find_scenario, plugins
from telenano.settings.included import known_scenarios
from telenano.wire.errors import ConfigError


def entry(kind: str, name: str, target: str, package: str = "pack") -> Any:
    found = EntryPoint(name, target, f"telenano.{kind}")
    object.__setattr__(found, "dist", SimpleNamespace(metadata=metadata_of(package)))
    return found


def metadata_of(package: str, *required: str) -> Message:
    metadata = Message()
    for key, value in (("Name", package), ("Version", "1.2"), *(("Requires-Dist", text) for text in required)):
        metadata[key] = value
    return metadata


@pytest.fixture
def entries(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[Any]:
    rows: list[Any] = []
    found = SimpleNamespace(select=lambda group: [row for row in rows if row.group == group])
    monkeypatch.setattr(plugins, "entry_points", lambda: found)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(plugins, "_problems", {})
    for cached in (plugins._installed, plugins._digest):
        cached.cache_clear()
    yield rows
    for cached in (plugins._installed, plugins._digest):
        cached.cache_clear()


def number(name: str, value: Any) -> int | None:
    if not isinstance(value, int):
        raise TypeError(f"is a {type(value).__name__}, must be an int")
    return value


def test_what_can_be_used_is_loaded_and_what_cannot_says_why(entries: list[Any], tmp_path: Path) -> None:
    (tmp_path / "pack_a.py").write_text("GOOD = 7\nTEXT = 'x'\n")
    (tmp_path / "pack_b.py").write_text("raise RuntimeError('no licence')\n")
    entries += [entry("laws", "good", "pack_a:GOOD"), entry("laws", "text", "pack_a:TEXT")]
    entries += [entry("laws", "broken", "pack_b:LAW"), entry("laws", "absent", "pack_c:LAW")]
    entries += [entry("laws", "Wave-2", "pack_a:GOOD"), entry("laws", "wave", "pack_a:GOOD")]
    entries += [entry("laws", "twice", "pack_a:GOOD"), entry("laws", "twice", "pack_a:TEXT", "other")]
    loaded = plugins.load("laws", number, ("wave",))
    assert loaded.found == {"good": 7}
    what = "of the package pack 1.2 cannot be used"
    assert loaded.problems["text"] == f"text {what}: TypeError: is a str, must be an int"
    assert loaded.problems["broken"] == f"broken {what}: RuntimeError: no licence"
    assert "No module named 'pack_c'" in loaded.problems["absent"]
    assert "lower-case" in loaded.problems["Wave-2"]
    assert loaded.problems["wave"].endswith("wave is a name of telenano's own")
    assert "pack and other both have one of this name" in loaded.problems["twice"]
    with pytest.raises(ValueError, match="no licence"):
        plugins.refuse(loaded, "broken")
    plugins.refuse(loaded, "good")


def test_an_entry_of_a_group_that_is_no_kind_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [entry("laws", "good", "pack_a:GOOD"), entry("layers", "dust", "pack_a:DUST")]
    other = EntryPoint("dust", "pack_a:DUST", "pytest11")
    monkeypatch.setattr(plugins, "entry_points", lambda: EntryPoints((*rows, other)))
    (text,) = plugins.of_no_kind()
    assert text.startswith("pack_a:DUST is not used: its group is telenano.layers; known are laws, devices, ")
    monkeypatch.setenv("TELENANO_WITHOUT_PACKAGES", "1")
    assert plugins.of_no_kind() == []


def test_a_package_of_many_entries_is_read_once(entries: list[Any]) -> None:
    class Package:
        reads = 0

        @property
        def metadata(self) -> Message:
            self.reads += 1
            return metadata_of("pack", "telenano>=99")

    package = Package()
    for kind in ("laws", "devices", "checks"):
        for name in ("first", "second"):
            entries.append(entry(kind, name, "pack:ENTRY"))
            object.__setattr__(entries[-1], "dist", package)
    assert [row.name for row in plugins.all_installed()] == ["first", "second"] * 3
    assert all("it needs telenano >=99" in row.problem for row in plugins.all_installed())
    assert package.reads == 1


def test_a_digest_is_of_every_file_of_the_package(entries: list[Any], tmp_path: Path) -> None:
    folder = tmp_path / "pack_d" / "deep"
    folder.mkdir(parents=True)
    (tmp_path / "pack_d" / "__init__.py").write_text("LAW = 1\n")
    (folder / "table.csv").write_text("1,2\n")
    entries.append(entry("laws", "mine", "pack_d:LAW"))
    digests = {plugins.installed("laws")["mine"].digest}
    assert plugins.digest_of_all(plugins.in_lockstep()) != ""
    (folder / "table.csv").write_text("1,3\n")
    plugins._digest.cache_clear()
    digests.add(plugins.installed("laws")["mine"].digest)
    (tmp_path / "pack_d" / "__pycache__").mkdir()
    (tmp_path / "pack_d" / "__pycache__" / "x.pyc").write_bytes(b"1")
    plugins._digest.cache_clear()
    digests.add(plugins.installed("laws")["mine"].digest)
    assert len(digests) == 2
    assert all(len(digest) == len("sha256:") + 64 for digest in digests)
    assert plugins.parts_of(plugins.in_lockstep()) == ("pack_d",)


def test_an_edit_of_one_device_changes_no_other_one_and_that_of_a_shared_part_all_that_use_it(
    entries: list[Any], tmp_path: Path
) -> None:
    files = {
        "__init__.py": "",
        "one/driver.py": "from pack_f.shared.wire import WIRE\n",
        "two/driver.py": 'WIRE = "pack_f.helper:WIRE"\n',
        "three/driver.py": "",
        "three/data.csv": "1",
        "shared/wire.py": "from pack_f import helper\nWIRE = 1\n",
        "helper.py": "WIRE = 1\n",
    }
    for name, text in files.items():
        (tmp_path / "pack_f" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "pack_f" / name).write_text(text)
    entries += [entry("devices", name, f"pack_f.{name}.driver:DRIVER") for name in ("one", "two", "three")]

    def changed_by(name: str) -> set[str]:
        def digests() -> dict[str, str]:
            plugins._digest.cache_clear()
            plugins._parts.cache_clear()
            plugins._mentioned.cache_clear()
            return {name: row.digest for name, row in plugins.installed("devices").items()}

        before = digests()
        with (tmp_path / "pack_f" / name).open("a") as file:
            file.write("# edited\n")
        return {name for name, digest in digests().items() if digest != before[name]}

    assert changed_by("one/driver.py") == {"one"}
    assert changed_by("three/data.csv") == {"three"}
    assert changed_by("shared/wire.py") == {"one"}
    assert changed_by("helper.py") == {"one", "two"}
    assert changed_by("__init__.py") == {"one", "two", "three"}


def test_a_scenario_of_a_package_is_known_by_its_name(entries: list[Any], tmp_path: Path) -> None:
    (tmp_path / "soft.yaml").write_text("name: soft\n")
    (tmp_path / "pack_e.py").write_text(
        "from pathlib import Path\nSOFT = Path(__file__).with_name('soft.yaml')\nGONE = 'gone.yaml'\nFIG12 = SOFT\n"
    )
    entries += [entry("scenarios", name, f"pack_e:{name.upper()}") for name in ("soft", "gone", "fig12")]
    assert find_scenario("soft") == tmp_path / "soft.yaml"
    # those of the project keep their names
    assert find_scenario("fig12").parent != tmp_path
    assert {"fig12", "soft"} <= set(known_scenarios())
    with pytest.raises(ConfigError, match=r"unknown scenario 'away': known are .*fig12, .*soft, touch"):
        find_scenario("away")
    with pytest.raises(ConfigError, match=r"gone of the package pack .* cannot be used: ValueError: gone\.yaml is no"):
        find_scenario("gone")


# --- modules whose import raises what is no ordinary error ---


def problem_of(entries: list[Any], tmp_path: Path, name: str, source: str) -> str:
    (tmp_path / f"{name}.py").write_text(source)
    entries.append(entry("laws", name, f"{name}:LAW"))
    plugins._installed.cache_clear()
    loaded = plugins.load("laws", number)
    assert name not in loaded.found
    return loaded.problems[name]


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("raise SystemExit(0)", "its import ends the whole program (SystemExit: 0)"),
        ("import sys; sys.exit(7)", "its import ends the whole program (SystemExit: 7)"),
        ("raise KeyboardInterrupt", "its import raises KeyboardInterrupt"),
        ("class E(BaseException): pass\nraise E('no')", "E: no"),
    ],
)
def test_a_module_that_ends_the_program_is_named_and_left_out(
    entries: list[Any], tmp_path: Path, source: str, said: str
) -> None:
    (tmp_path / "sound.py").write_text("LAW = 7\n")
    entries.append(entry("laws", "sound", "sound:LAW"))
    found = problem_of(entries, tmp_path, "ends", source)
    assert found == f"ends of the package pack 1.2 cannot be used: {said}"
    # the others are not affected
    assert plugins.load("laws", number).found == {"sound": 7}
    assert found in plugins.known_problems()


def test_what_a_package_prints_is_no_part_of_what_a_command_prints(
    entries: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "talks.py").write_text("print('hello')\nLAW = 7\n")
    entries.append(entry("laws", "talks", "talks:LAW"))
    assert plugins.load("laws", number).found == {"talks": 7}
    said = capsys.readouterr()
    assert (said.out, said.err) == ("", "hello\n")


def test_a_signal_at_a_command_is_none_of_a_package(entries: list[Any], tmp_path: Path) -> None:
    (tmp_path / "long.py").write_text("from telenano.signals.interrupts import Interrupted\nraise Interrupted\n")
    entries.append(entry("laws", "long", "long:LAW"))
    with pytest.raises(KeyboardInterrupt):
        plugins.load("laws", number)


def test_an_error_is_attributed_to_the_package_whose_code_was_called_last(entries: list[Any], tmp_path: Path) -> None:
    (tmp_path / "pack_f.py").write_text("def step(x):\n    return 1 / x\nLAW = 1\n")
    entries.append(entry("laws", "mine", "pack_f:LAW"))
    step = __import__("pack_f").step
    with pytest.raises(ZeroDivisionError) as caught:
        step(0)
    said = plugins.fault_of_package(caught.value)
    assert said == "the package pack 1.2 failed (pack_f, line 2, in step): ZeroDivisionError: division by zero"
    assert plugins.fault_of_package(ValueError("ours")) == ""


class WordlessError(Exception):
    """An error of a package whose text cannot be made."""

    def __str__(self) -> str:
        raise RuntimeError("and this one neither")


def test_an_error_without_words_is_named_by_its_class() -> None:
    assert plugins.fault_of_import(WordlessError()) == "WordlessError, whose text cannot be made"
    assert plugins.fault_of_import(ValueError()) == "ValueError"
    assert plugins.fault_of_import(ValueError("no licence")) == "ValueError: no licence"
