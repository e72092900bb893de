import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import command_page
import pytest

from telenano.cli.lazy_commands import GROUPS as HEADINGS
from telenano.cli.lazy_commands import LAZY_COMMANDS, load
from telenano.runtime.wiring.main import node_kind, parse_arguments, run_node
from telenano.settings import DEFAULT_SITE_FILE, TWO_SITES_FILE, plugins
from telenano.settings.included import site_file_named
from telenano.settings.known_packages import known_of
from telenano.testing import run
from telenano.wire.errors import RigError


@pytest.fixture(autouse=True)
def _private_runtime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    # The rigs of others on this machine may hold its processors, which is said on the terminal.
    monkeypatch.setattr("telenano.launcher.processors._SHARED", tmp_path)


COMMANDS = command_page.commands()
# the commands of the project's packages that stand in no group
OF_PACKAGES = [words for words in known_of("command") if " " not in words] + ["conformance"]


def test_results_go_below_out_where_no_folder_is_given() -> None:
    places = {
        path: parameter.default
        for path, command in {**COMMANDS, "telenano compare": load("compare")}.items()
        for parameter in getattr(command, "params", [])
        if "--out" in parameter.opts and parameter.default is not None
    }
    assert {path: place for path, place in places.items() if Path(place).parts[:1] != ("out",)} == {}
    assert "telenano compare" in places


@pytest.mark.parametrize("path", sorted(COMMANDS))
def test_every_command_answers_help(path: str) -> None:
    code, out, _ = run(*path.split()[1:], "--help")
    assert code == 0
    assert "Usage" in out


@pytest.mark.parametrize("path", sorted(COMMANDS))
def test_every_flag_has_a_help_text_and_a_unit_where_it_is_a_number(path: str) -> None:
    for parameter in getattr(COMMANDS[path], "params", []):
        text = getattr(parameter, "help", None)
        assert text, f"{path} {parameter.name} has no help"
        if parameter.metavar in ("S", "D"):
            assert re.search(r"\[m?s\]", text), f"{path} {parameter.name} has no unit"


def test_help_lists_every_command_once() -> None:
    assert sorted(name for names in HEADINGS.values() for name in names) == sorted([*LAZY_COMMANDS, *OF_PACKAGES])
    listed = re.findall(r"^  ([a-z]\S*)  +[A-Z]", run("--help-all")[1], re.MULTILINE)
    assert [name for name in listed if name in (*LAZY_COMMANDS, *OF_PACKAGES)] == [
        name for names in HEADINGS.values() for name in names
    ]


def test_version_names_telenano_and_what_extends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, group in (("made-laws", "telenano.laws"), ("made-other", "other.laws")):
        folder = tmp_path / f"{name.replace('-', '_')}-2.5.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.5\n")
        (folder / "entry_points.txt").write_text(f"[{group}]\nmade = made:thing\n")
    before = run("--version")[1].splitlines()
    assert before[0] == version("telenano")
    monkeypatch.syspath_prepend(tmp_path)
    plugins._installed.cache_clear()
    code, text, _ = run("--version")
    plugins._installed.cache_clear()
    after = text.splitlines()
    assert code == 0 and after[0] == before[0]
    assert after[1:] == sorted([*before[1:], "made-laws 2.5"])


def test_a_site_file_without_a_node_is_named(tmp_path: Path) -> None:
    site_file = tmp_path / "site.yaml"
    site_file.write_text("nodes:\n  launcher@master: ipc:///tmp/x\n")
    code, _, err = run("up", "--scenario", "fig12", "--site-file", str(site_file))
    assert code == 2
    assert str(site_file) in err
    assert "haptic_node@master" in err


def test_a_wrong_key_or_value_is_named_before_anything_starts(tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, _, err = run("up", "--scenario", "fig12", "--out", out, "--set", "haptic_node.device.time_constant_s=x")
    assert code == 2
    assert "haptic_node.device.time_constant_s" in err and "'x'" in err
    assert not out.exists()


def test_what_overrides_a_profile_is_one_line_on_the_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import telenano.cli.commands.up

    def end(*_: object) -> None:
        raise RigError("the rig would begin here")

    monkeypatch.setattr(telenano.cli.commands.up, "run_rig", end)
    satellite = ("up", "--scenario", "fig12", "--out", str(tmp_path), "--set", "delay_node.profile=satellite")
    assert run(*satellite)[2] == "telenano: the rig would begin here\n"
    for more in ((), ("--json",)):
        lines = run(*satellite, "--round-trip-ms", "40", *more)[2].splitlines()
        assert len(lines) == 2
        assert lines[0].startswith("telenano: ")
        assert "the profile satellite is changed: forward.delay_s is 0.02, not 0.31, backward.delay_s" in lines[0]


@pytest.mark.parametrize(
    ("option", "value"),
    [
        *(("duration", value) for value in ("-1", "0", "nan")),
        *(("round-trip-ms", value) for value in ("-1", "nan", "inf", "8e6")),
    ],
)
def test_a_senseless_duration_or_delay_is_refused(tmp_path: Path, option: str, value: str) -> None:
    code, _, err = run("up", "--scenario", "fig12", "--out", str(tmp_path / "out"), f"--{option}", value)
    assert code == 2
    assert option.removesuffix("-ms") in err


@pytest.mark.parametrize("name", ["session.mcap", "session_2.mcap"])
def test_an_existing_recording_is_kept(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"precious")
    code, _, err = run("up", "--scenario", "fig12", "--out", str(tmp_path))
    assert code == 2
    assert f"{tmp_path / name} exists already" in err
    assert "--overwrite" in err
    assert (tmp_path / name).read_bytes() == b"precious"


@pytest.mark.parametrize(
    "command",
    [
        *("topic list", "topic echo afm/state", "topic hz afm/state"),
        *("session arm", "session set law=wave --target controller", "link show", "link set forward.delay_s=0.01"),
        "scan --live --out image",
        "curve --live --out curve",
    ],
)
def test_silence_without_a_rig_is_said_at_once(command: str, tmp_path: Path) -> None:
    # what a console that was killed left behind is no rig
    (tmp_path / "run").mkdir(mode=0o700)
    for name in ("console@master", "player@master"):
        (tmp_path / "run" / name).touch()
    # without a limit of time some would listen for ever
    code, out, err = run(*command.split(), "--json")
    assert code == 1
    assert "no rig of this site file was found here: no socket in" in json.loads(out)["error"]
    assert err.startswith("telenano: ")


def test_a_topic_that_stays_silent_is_said_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run").mkdir(mode=0o700)
    # as a rig leaves it that was killed with all its nodes
    (tmp_path / "run" / "afm_node@slave").touch()
    monkeypatch.setattr("telenano.cli.commands.topic._SILENCE_S", 0.01)
    code, _, err = run("topic", "echo", "afm/state", "--duration", "0.2")
    assert code == 1
    assert "telenano: nothing was received on afm/state within 0.01 s: is `telenano up` running" in err


def test_a_bridge_without_a_rig_says_so_and_fails() -> None:
    pytest.importorskip("uvicorn")
    code, out, err = run("bridge", "foxglove", "--port", "0", "--duration", "0")
    assert code == 1
    assert "bridge: ws://127.0.0.1:" in out
    assert "token=" not in out
    assert "no rig of this site file was found on this machine yet; waiting for one" in err
    assert "nothing was received" in err


def test_a_recorder_without_a_rig_says_that_its_file_is_empty(tmp_path: Path) -> None:
    code, _, err = run("record", "--out", str(tmp_path / "empty.mcap"), "--duration", "0")
    assert code == 1
    assert "no rig of this site file was found on this machine yet; waiting for one" in err
    assert f"The recording is empty: {tmp_path / 'empty.mcap'}" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--attach", "--set", "a.b=1", "--allow-replay"), "--set, --allow-replay: not with --attach, which starts no"),
        (("--wait", "3"), "--wait: not without --attach or --site"),
        (("--site", "slave", "--duration", "3"), "--duration: not with --site slave"),
        (("--site", "slave", "--attach"), "--attach: not with --site slave, where no session is conducted"),
    ],
)
def test_up_refuses_what_could_not_act(arguments: tuple[str, ...], words: str) -> None:
    code, out, err = run("up", "--scenario", "fig12", *arguments)
    assert (code, out) == (2, "")
    assert words in err


@pytest.mark.check("takes 1.3 s")
def test_attaching_to_nobody_ends_at_its_limit(tmp_path: Path) -> None:
    arguments = ("--attach", "--scenario", "fig12", "--wait", "0.1", "--out", str(tmp_path / "out"), "--json")
    result = subprocess.run(
        [sys.executable, "-m", "telenano", "up", *arguments], capture_output=True, text=True, check=False
    )
    assert result.returncode == 1
    assert json.loads(result.stdout)["error"].startswith(
        "the rig was not ready within 0.1 s: delay_node@master has not"
    )


@pytest.mark.check("takes 1.3 s")
def test_a_node_gets_the_arguments_that_follow_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    result = subprocess.run(
        [sys.executable, "-c", "from telenano.cli.app import main; main()", "node", "recorder", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "telenano node recorder" in result.stdout
    assert "--with-parent" in result.stdout
    # names of scenarios and site files as for every other command
    wrong = run_node(node_kind("recorder"), ["--scenario", "no_such"])
    assert wrong == 2
    assert "unknown scenario 'no_such': known are assembly, fig10" in capsys.readouterr().err
    assert parse_arguments("recorder", ("master",), ["--scenario", "fig12"]).site_file == DEFAULT_SITE_FILE


def test_help_does_not_import_what_it_does_not_need() -> None:
    code = "import atexit, sys, telenano.cli.app as root; sys.argv = ['telenano', '--help']; "
    code += "unneeded = {'zmq', 'numpy', 'numba', 'matplotlib', 'pydantic', 'rich.table', 'hashlib', 'json'}; "
    code += "atexit.register(lambda: print(unneeded & set(sys.modules))); root.main()"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.endswith("set()\n")


def test_a_site_file_of_the_project_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert site_file_named(Path("two_sites")) == TWO_SITES_FILE
    assert site_file_named(None) is None
    # a path stays a path, also one that is not there, so that the error names it
    for path in (Path("mine.yaml"), Path("three_sites")):
        assert site_file_named(path) == path
    (tmp_path / "two_sites").write_text("nodes: {}")
    assert site_file_named(Path("two_sites")) == Path("two_sites")


def test_imports_are_not_searched_for_garbage_and_what_a_command_makes_is() -> None:
    code = "import atexit, gc, sys, telenano.cli.app as root; sys.argv = ['telenano', {}]; "
    code += "atexit.register(lambda: print(gc.isenabled())); root.main()"
    for argument, collects in (("'--help'", "False"), ("'new', '--help'", "True")):
        command = [sys.executable, "-c", code.format(argument)]
        result = subprocess.run(command, capture_output=True, text=True, check=True)
        assert result.stdout.endswith(f"{collects}\n")
