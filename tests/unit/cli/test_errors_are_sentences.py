"""Whatever a command cannot write, or is typed wrong: one sentence and an exit code, and never a traceback."""

import errno
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from telenano.cli import live_view, output
from telenano.cli.live_view import LineView, LiveView
from telenano.testing import run

MakeFile = Callable[..., Path]
FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")


def refused(*arguments: str | Path) -> str:
    """Return the sentence of a command that fails, which it also gives as JSON."""
    code, out, err = run(*arguments)
    assert (code, out) == (1, "")
    assert err.count("\n") == 1
    assert err.startswith("telenano: ")
    code, out, again = run(*arguments, "--json")
    assert (code, again) == (1, err)
    assert json.loads(out) == {"error": err.removeprefix("telenano: ").rstrip("\n")}
    return err.removeprefix("telenano: ").rstrip("\n")


def no_space(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.fixture
def in_the_way(tmp_path: Path) -> Path:
    """Return a file that stands where a folder would have to be."""
    (tmp_path / "file").write_text("kept")
    return tmp_path / "file"


@pytest.mark.check("takes 2.0 s")
def test_a_report_that_cannot_be_written_names_its_folder_and_shows_the_summary(
    in_the_way: Path, recording_of: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    session = recording_of("wave")
    # What can be no folder is refused before the report is made.
    for out, reason in ((in_the_way, "cannot be the folder of"), (in_the_way / "report", "cannot be reached, as")):
        code, table, err = run("report", session, "--out", out)
        assert (code, table) == (1, "") and err.startswith(f"telenano: {out}: {reason} --out")
    monkeypatch.setattr("telenano.analysis.report.whole_results", no_space)
    code, table, err = run("report", session, "--out", in_the_way.with_name("out"))
    assert code == 1 and "cannot be written: No space left on device" in err and "scenario" in table
    assert in_the_way.read_text() == "kept"


@pytest.mark.parametrize("kind", ["csv", "parquet", "hdf5", "mcap-json"])
def test_an_export_that_cannot_be_written_names_its_target(make_file: MakeFile, in_the_way: Path, kind: str) -> None:
    for target in (in_the_way / "target", in_the_way / "deeper" / "target"):
        text = refused("bag", "export", make_file(), "--to", kind, "--out", target)
        assert text.startswith(f"{target}: cannot be ")
        assert text.endswith(("Not a directory", "File exists", "No such file or directory"))


def test_an_export_to_a_full_disk_says_so(make_file: MakeFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telenano_bridges.tables._write_rows", no_space)
    for attempt in ("a", "b"):
        code, _, err = run("bag", "export", make_file(), "--to", "csv", "--out", tmp_path / attempt)
        assert (code, err) == (1, f"telenano: {tmp_path / attempt}: cannot be written: No space left on device\n")


@pytest.mark.parametrize("command", ["filter", "recover", "merge"])
def test_a_copy_below_a_file_is_not_called_one_that_exists(make_file: MakeFile, in_the_way: Path, command: str) -> None:
    assert refused("bag", command, make_file(), "--out", in_the_way / "copy").startswith(
        f"{in_the_way / 'copy'}: cannot be reached, as --out asks: "
    )


# --- standard output ---


@pytest.mark.check("takes 3.8 s")
@needs_full
@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("bag", "info", "SESSION"), 1, "standard output cannot be written: No space left on device"),
        (("bag", "cat", "SESSION"), 1, "standard output cannot be written: No space left on device"),
        (("estop", "--json"), 1, "no device of the site file was found here"),
        (("upp", "--json"), 2, "no such command 'upp'; did you mean up? (`telenano --help` explains)"),
    ],
)
def test_output_that_cannot_be_written_is_one_sentence(
    arguments: tuple[str, ...], code: int, said: str, recording_of: Callable[[str], Path], tmp_path: Path
) -> None:
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(tmp_path)}
    arguments = tuple(str(recording_of("wave")) if word == "SESSION" else word for word in arguments)
    with FULL.open("w") as full:
        command = [sys.executable, "-m", "telenano", *arguments]
        done = subprocess.run(command, env=environment, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    # a stop that cannot print its result says so as well
    assert done.returncode == code
    assert done.stderr.splitlines()[0].startswith(f"telenano: {said}")
    assert done.stderr.count("\n") == 1 + ("estop" in arguments)


@pytest.mark.check("a process for each of fifteen commands")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize(
    "words",
    ["--help", "--help-all", "up --help", "device list", "device list --json", "law list", "scenario list", "doctor",
     "scenario schema", "param list", "param get", "bag info SESSION", "bag info SESSION --full", "bag cat SESSION",
     "experiment check delay_and_law"],
)  # fmt: skip
def test_a_reader_that_has_what_it_wanted_ends_a_command_without_a_word(
    words: str, recording_of: Callable[[str], Path], tmp_path: Path
) -> None:
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(tmp_path)}
    arguments = words.replace("SESSION", str(recording_of("wave"))).split()
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "wb") as closed:
        command = [sys.executable, "-m", "telenano", *arguments]
        done = subprocess.run(command, env=environment, stdout=closed, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


class FullDisk(io.StringIO):
    """A file of which nothing can be written."""

    tries = 0

    def write(self, text: str) -> int:
        self.tries += 1
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_session_goes_on_where_its_view_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_view, "rig_picture", lambda rig: live_view.Group("a table"))
    for make in (LineView, LiveView):
        full = FullDisk()
        with make(Console(file=full, force_terminal=True)) as view:
            view.show("the session is running")
            if isinstance(view, LiveView):
                view.observe(None)  # type: ignore[arg-type]
            view.show("the session is over")
        assert full.tries >= 2


def test_what_is_said_after_the_view_has_ended_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The report is made then, which takes seconds, and a terminal that shows nothing looks as if it hung."""
    for make in (LineView, LiveView):
        terminal = io.StringIO()
        with make(Console(file=terminal, force_terminal=True)) as view:
            view.show("the session is running")
        before = len(terminal.getvalue())
        view.show("making figure and summary")
        view.show("1 of 4: reading [the] session")
        assert terminal.getvalue()[before:] == "making figure and summary\n1 of 4: reading [the] session\n"


def test_what_the_system_refuses_without_the_name_of_a_file_is_said_in_its_words() -> None:
    no_more = output.system_error_text(OSError(errno.EMFILE, "Too many open files"))
    limit = output.resource.getrlimit(output.resource.RLIMIT_NOFILE)[0]
    assert no_more == f"Too many open files: this process may have {limit}; raise `ulimit -n`"
    assert output.system_error_text(OSError(errno.EACCES, "Permission denied")) == "Permission denied"
    # standard output works here, so that something else could not be written
    assert output.system_error_text(OSError(errno.ENOSPC, "No space")) == "a file cannot be written: No space"
    assert output.system_error_text(FileNotFoundError(2, "No such file", "a.txt")) == "a.txt: No such file"


_PRINTS = {
    "print('a row' * 9999)": "standard output",
    "print('a row'); sys.stdout.flush()": "standard output",
    "from rich.console import Console; Console().print('a row')": "standard output",
    "from rich.console import Console; Console(file=open('/dev/full', 'w')).print('a row')": "a file",
    "from telenano.cli.output import console; console().print('a row')": "standard output",
    "import click; click.echo('a row')": "standard output",
    "sys.stdout.write('a row' * 9999)": "standard output",
    "print('a row' * 9999, file=open('/dev/full', 'w'))": "a file",
    "open('/dev/full', 'w').write('a row' * 9999)": "a file",
}


@needs_full
@pytest.mark.parametrize(("line", "said"), _PRINTS.items(), ids=_PRINTS)
def test_what_a_package_prints_is_standard_output_and_what_it_writes_is_a_file(
    line: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "some_package.py").write_text(f"import sys\n\n\ndef run():\n    {line}\n")
    code = "from telenano.cli import output, terminal\nterminal.install()\nimport some_package as some\n"
    code += "with output.report_errors(False): some.run()"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    with FULL.open("w") as full:
        out = full if said == "standard output" else subprocess.DEVNULL
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, env=environment, stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    assert done.stderr.splitlines()[0] == f"telenano: {said} cannot be written: No space left on device"


# --- what is typed ---


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("up",), "no experiment is named, such as in `telenano up fig12`"),
        (("upp",), "no such command 'upp'; did you mean up? (`telenano --help` explains)"),
        (("up", "--scenario", "fig12", "--duration", "x"), "invalid value for '--duration': "),
        (
            ("scan", "--set-point", "3"),
            "no such option: --set-point; did you mean --setpoint? (`telenano scan --help` explains)",
        ),
        (("push", "--out", "x"), "no such option: --out (`telenano push --help` explains)"),
        (("bag", "infoo", "x"), "no such command 'infoo'; did you mean info? (`telenano bag --help` explains)"),
        (
            ("session",),
            "missing argument 'COMMAND'. Choose from: arm, start, stop, estop, set, mark, couple (`tele",
        ),
        (("keys", "allow", "slave", "KEY"), "missing option '--role'"),
        (("topic", "hz", "haptic/state", "more"), "got unexpected extra argument"),
    ],
)
def test_a_wrong_command_line_is_one_sentence(arguments: tuple[str, ...], said: str) -> None:
    code, out, err = run(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(f"telenano: {said}")
    assert "--help` explains)" in err
    code, out, again = run(*arguments, "--json")
    assert (code, again) == (2, err)
    assert json.loads(out) == {"error": err.removeprefix("telenano: ").rstrip("\n")}


@pytest.mark.parametrize("group", [(), ("bag",), ("topic",)])
def test_a_group_by_itself_shows_its_help(group: tuple[str, ...]) -> None:
    code, out, err = run(*group)
    assert code == 2
    assert (out + err).startswith("Usage:")
    assert run(*group, "--help")[0] == 0


def test_a_node_is_told_what_is_missing_in_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    from telenano.runtime.wiring.main import parse_arguments

    for arguments, said in (
        ([], "the following arguments are required: --scenario"),
        (["--site", "nowhere"], "argument --site: invalid choice: 'nowhere' (choose from "),
    ):
        with pytest.raises(SystemExit) as caught:
            parse_arguments("recorder", ("master", "slave"), arguments)
        err = capsys.readouterr().err
        assert (caught.value.code, err.count("\n")) == (2, 1)
        assert err.startswith(f"telenano node recorder: {said}")
        assert err.endswith("(`telenano node recorder --help` explains)\n")
