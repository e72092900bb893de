"""What people type first: other names of commands, options of other programs, numbers with their units."""

import re
from itertools import takewhile
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import telenano
from telenano.cli.lazy_commands import MEANT
from telenano.cli.model_options import options_of
from telenano.cli.root import app
from telenano.launcher.plan import SessionRequest, UpRequest
from telenano.settings import DEMO_RECORDING


def typed(line: str, **more: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, line.split(), env=more)
    return done.exit_code, " ".join(done.output.split())


@pytest.mark.parametrize("line", ["help", "--help", "-h"])
def test_help_lists_the_commands(line: str) -> None:
    code, text = typed(line)
    assert code == 0
    assert "Usage: " in text and " simulate " in text


@pytest.mark.parametrize("line", ["help up", "up --help", "run --help", "help run"])
def test_the_help_of_a_command_comes_by_either_word(line: str) -> None:
    code, text = typed(line)
    assert code == 0
    assert "[NAME|FILE]" in text and "--scenario" in text and "--round-trip-ms" in text


def test_the_version_has_a_short_option() -> None:
    assert typed("-V") == typed("--version")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("up", "no experiment is named"),
        ("run", "no experiment is named"),
        ("up fig12 --scenario touch", "--scenario: not with fig12, which names the experiment"),
        ("up fig13", "did you mean fig12"),
        ("up session.mcap", "is the name of a recording"),
        ("simulate session.mcap", "is the name of a recording"),
        ("up fig12 --delay 40", "--round-trip-ms 40"),
        ("simulate fig12 --rate 500", "--set realtime.rate_hz=500"),
        ("up fig12 --verbose", "OUT/logs"),
        ("up fig12 --round-trip-ms 40kg", "is not a valid float"),
        ("simulate fig12 --duration 5nm", "is not a valid float"),
        ("stop", "telenano estop"),
        ("up fig12 law=wave", "is changed by --set controller.law=wave"),
        ("laws", "telenano law list"),
        ("scenarios", "telenano scenario list"),
        ("restart", "begins a new session"),
        ("demo", "telenano up fig12"),
        ("report session.mcap", "session.mcap: cannot be read"),
        # a word that a group of commands has
        ("export x.mcap", "telenano bag export"),
        ("verify x.mcap", "telenano bag verify"),
        ("info x.mcap", "telenano bag info"),
        ("show fig12", "telenano scenario show"),
        ("check", "telenano scenario check"),
        # or that says what a command does
        ("convert x.mcap out.csv", "telenano bag export"),
        ("bag record", "`telenano record`"),
        # or that an option has
        ("version", "`telenano --version`"),
        ("completion bash", "--show-completion"),
        ("sweep", "`telenano up fig12 --sweep`"),
        # the name of another thing
        ("fig12", "`telenano up fig12` runs it"),
        # the plural, and what means nothing
        ("nodes", "did you mean node?"),
        # the words of other programs
        ("ps", "`telenano status`"),
        ("top", "`telenano status`"),
        ("kill", "`telenano estop`"),
        ("logs afm", "the folder `logs`"),
        ("gui", "`telenano view`"),
        ("ping", "`telenano link show`"),
        ("emergency-stop", "`telenano estop`"),
        ("--verbose status", "OUT/logs"),
        ("-q up fig12", "`telenano up fig12 --quiet`"),
        ("up fig12 --dry-run", "`telenano scenario check FILE`"),
        ("up --config fig12", "`telenano up my.yaml`"),
        ("up fig12 --loss 0.1", "delay_node.forward.loss.probability"),
        ("up fig12 --jitter 5", "delay_node.forward.jitter.scale_s"),
        ("e-stop", "did you mean estop?"),
        ("arm", "`telenano session --help`"),
        # a group knows its own commands, and not those of others that have the name
        ("link list", "there are show"),
        ("study list", "there are "),
        ("law info wave", "there are list, show"),
        ("zzz", "there are up, simulate"),
        ("bag zzz", "there are info"),
        ("up fig12 --latency 40", "did you mean --round-trip-ms?"),
        ("up fig12 --rtt 40", "did you mean --round-trip-ms?"),
        ("up fig12 --controller wave", "--set controller.KEY=VALUE"),
        ("up fig12 --force-gain 5", ".force_gain=VALUE"),
        ("up fig12 -o x", "there are --"),
        ("up fig12 controller.law=wave", "--set controller.law=wave"),
        ("up fig12.yaml", "did you mean fig12?"),
        ("up Fig12", "did you mean fig12?"),
    ],
)
def test_what_is_meant_is_said(line: str, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, text = typed(line)
    assert code == 2
    assert says in text


@pytest.mark.parametrize(
    ("flag", "text", "value"),
    [
        ("--round-trip-ms", "40", 40.0),
        ("--round-trip-ms", "40ms", 40.0),
        ("--round-trip-ms", "0.04 s", 40.0),
        ("--duration", "2s", 2.0),
        ("--duration", "500ms", 0.5),
        ("--duration", "1min", 60.0),
        ("--duration", "1e1", 10.0),
    ],
)
def test_a_number_may_have_its_unit(flag: str, text: str, value: float, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def noted(request: UpRequest, folder: Path) -> None:
        seen.append(request)
        raise typer.Exit(7)

    monkeypatch.setattr("telenano.cli.commands.up.make_plan", noted)
    done = CliRunner().invoke(app, ["up", "fig12", flag, text, "--out", "/nowhere"])
    assert done.exit_code == 7, done.output
    field = next(option.field for option in options_of(SessionRequest) if option.flag in (flag, f"{flag}-s"))
    assert getattr(seen[0], field) == pytest.approx(value)


def test_a_file_or_a_folder_is_no_command_and_no_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "done").mkdir()
    (tmp_path / "done" / "session.mcap").write_bytes(b"")
    for line, says in (
        ("done", "telenano view done"),
        ("bag done/session.mcap", "telenano bag info done/session.mcap"),
        ("up done", "is the folder of a recording"),
        ("simulate done", "is the folder of a recording"),
    ):
        code, text = typed(line)
        assert code == 2 and says in text, text


@pytest.mark.check("judges a recording")
def test_a_session_is_named_by_its_folder(tmp_path: Path) -> None:
    (tmp_path / "session.mcap").write_bytes(DEMO_RECORDING.read_bytes())
    code, text = typed(f"report {tmp_path}")
    assert code == 0, text
    assert (tmp_path / "summary.json").is_file() and (tmp_path / "fig12.png").is_file()


def test_completion_offers_what_there_is() -> None:
    assert {"open", "simulate", "live"} <= set(dir(telenano))
    assert not {"Any", "import_module", "TYPE_CHECKING"} & set(dir(telenano))
    assert all(hasattr(telenano, name) for name in dir(telenano))


@pytest.mark.parametrize("line", ["arm", "top", "up fig12 --port 9999", "up fig12 --host 10.0.0.2", "up nosuch.yaml"])
def test_nothing_is_meant_by_what_only_shares_letters_with_it(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert "did you mean" not in typed(line)[1]


@pytest.mark.parametrize("name", sorted(MEANT))
def test_the_commands_that_are_meant_are_there(name: str) -> None:
    code, text = typed(name)
    assert code == 2
    for command in re.findall(r"`telenano ([^`]+)`", text.partition(" (`telenano")[0]):
        words = [*takewhile(lambda word: word.islower() and word[0] != "-" and word != "fig12", command.split())]
        assert typed(" ".join([*words, "--help"]))[0] == 0, command


@pytest.mark.parametrize("group", ["bag", "law", "study", "link"])
def test_the_help_of_a_group_comes_by_its_word(group: str) -> None:
    assert typed(f"{group} help") == typed(f"{group} --help")


@pytest.mark.check("takes 4 s")
def test_a_report_goes_beside_the_summary_of_a_session(tmp_path: Path) -> None:
    file = tmp_path / "session.mcap"
    file.write_bytes(DEMO_RECORDING.read_bytes())
    code, text = typed(f"report {file}")
    assert code == 2 and "--out" in text
    assert typed(f"report {tmp_path}")[0] == 0
    before = (tmp_path / "summary.json").read_bytes()
    (tmp_path / "fig12.png").unlink()
    assert typed(f"report {file}")[0] == 0
    assert (tmp_path / "summary.json").read_bytes() == before
    assert (tmp_path / "fig12.png").is_file()
    code, text = typed(f"report {tmp_path / 'nosuch.mcap'}")
    assert code == 2 and "nosuch.mcap: cannot be read" in text


def test_a_column_of_texts_and_numbers_begins_at_its_name_in_a_pipe() -> None:
    assert CliRunner().invoke(app, ["param", "list"]).output.splitlines()[1].split("  ")[0] == "name"
