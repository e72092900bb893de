"""Rules over pairs of options hold for every command: what is stated twice, what is void, and one JSON object."""

import json
from pathlib import Path
from typing import Annotated

import pytest
import typer
from command_lines import commands

from telenano.cli.lazy_commands import _plain
from telenano.cli.option_rules import Keys, Void, name_of, rules, rules_of
from telenano.cli.output import fail, print_json
from telenano.settings import DEMO_RECORDING
from telenano.testing import run

DEMO = str(DEMO_RECORDING)


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))


def refused(line: str) -> str:
    """Return the sentence with which a command is refused before it begins."""
    code, out, err = run(*line.split())
    assert (code, out) == (2, ""), (line, out, err)
    assert list(Path().iterdir()) == []
    return err


@pytest.mark.parametrize(
    ("line", "both"),
    [
        ("simulate fig12 --seed 1 --seed 2", "--seed 1 and --seed 2: --seed is given twice"),
        ("up fig12 --out a --round-trip-ms 3 --out b", "--out a and --out b: --out is given twice"),
        ("simulate fig12 --no-report --no-report", "--no-report and --no-report: --no-report is given twice"),
        ("push --from 0,0 --to 9,9 --stop-on-loss --no-stop-on-loss", "--stop-on-loss is given twice"),
        ("topic list --rig a --rig b", "--rig a and --rig b"),
    ],
)
def test_an_option_that_is_no_list_is_given_once(line: str, both: str) -> None:
    assert both in refused(line)


@pytest.mark.parametrize(
    ("line", "first", "second"),
    [
        ("param get --set duration_s=1 --set duration_s=2", "--set duration_s=1", "--set duration_s=2"),
        ("scenario check fig12 --set a.b=1 --set a.b=1", "--set a.b=1", "--set a.b=1"),
        ("scenario check fig12 --set a.b={c:1} --set a.b.c=2", "--set a.b={c:1}", "--set a.b.c=2"),
        ("simulate fig12 --duration 3 --set duration_s=4", "--set duration_s=4", "--duration 3"),
        ("up fig12 --round-trip-ms 3 --set delay_node.forward.delay_s=1", "--round-trip-ms 3", "delay_s=1"),
        ("up fig12 --instrument ideal --set instrument=real", "--instrument ideal", "--set instrument=real"),
        ("simulate fig12 --seed 1 --seeds 3", "--seed 1", "--seeds 3"),
        ("simulate fig12 --seed 1 --sweep seed=0,1", "--seed 1", "--sweep seed=0,1"),
        ("simulate fig12 --seed 1 --set delay_node.seed=2", "--seed 1", "--set delay_node.seed=2"),
        ("up fig12 --round-trip-ms 40 --sweep round_trip_ms=0,60", "--round-trip-ms 40", "--sweep round_trip_ms=0,60"),
        ("up fig12 --set controller.law=wave --sweep controller.law=wave,smith", "law=wave", "law=wave,smith"),
        ("session set law=wave law=smith", "law=wave", "law=smith"),
        ("link set delay_s=1 delay_s=2", "delay_s=1", "delay_s=2"),
        ("device probe --device haply --set haptic_node.driver=dhd", "--device haply", "--set haptic_node.driver=dhd"),
        ("scan --out o --temperature 300 --afm disturbances.thermal.temperature_k=9", "--temperature 300", "=9"),
    ],
)
def test_a_key_is_stated_once_and_both_texts_are_named(line: str, first: str, second: str) -> None:
    text = refused(line)
    assert "both state" in text and first in text and second in text


def test_keys_beside_one_another_and_of_several_sections_are_no_contradiction() -> None:
    both_ways = "--set delay_node.forward.delay_s=0.01 --set delay_node.backward.delay_s=0.02 --set duration_s=1"
    code, _, err = run("scenario", "check", "fig12", *both_ways.split())
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("line", "void"),
    [
        ("simulate fig12 --table csv", "--table: not without --sweep or --seeds"),
        ("simulate fig12 --no-report --style paper", "--style: not with --no-report"),
        ("simulate fig12 --overwrite", "--overwrite: not without --out"),
        ("up fig12 --scenario touch", "--scenario: not with fig12"),
        (
            "up fig12 --attach --set a.b=1 --allow-replay",
            "--set, --allow-replay: not with --attach",
        ),
        ("up fig12 --attach --round-trip-ms 0 --without afm_node", "--round-trip-ms, --without: not with --attach"),
        ("up fig12 --site slave --round-trip-ms 1", "--round-trip-ms: not with --site slave, where no link runs"),
        ("up fig12 --site slave --attach", "--attach: not with --site slave, where no session is conducted"),
        ("up fig12 --wait 0", "--wait: not without --attach or --site"),
        ("up fig12 --site slave --duration 3", "--duration: not with --site slave"),
        ("up fig12 --headless --quiet", "--headless: not with --quiet"),
        ("session set law=wave --return", "--return: not without arm"),
        ("session couple --target afm_node", "--target: not with couple"),
        ("link profile --show", "--show: not without NAME"),
        ("link profile 5g --show --site-file local", "--site-file: not with --show"),
        ("status --all --duration 2", "--duration: not with --all"),
        ("doctor --warm --stage none.yaml", "--stage: not with --warm"),
        ("param list delay_node --all", "--all: not with delay_node"),
        ("new law mine --node afm_node", "--node: not without device"),
        ("view --revoke me --demo", "--demo: not with --revoke"),
        ("view --addresses --rig mine", "--rig: not with --addresses"),
        (f"view {DEMO} --demo", "not with --demo"),
        (f"replay {DEMO} --end 2 --duration 1", "--duration: not with --end"),
        ("record --out a.mcap --quota-policy stop", "--quota-policy: not without --quota"),
        ("curve --out o --live --points 9", "--points: not with --live"),
        ("scan --out o --mask-above 3", "--mask-above: not without --align-rows"),
        ("push --from 0,0 --to 9,9 --pitch 0.3", "--pitch: not without --mode sweep"),
        ("assemble --pattern letters:AB --count 3", "--count: not with --pattern"),
        ("benchmark cell --out o", "--out: not with cell"),
        ("link probe --from a.mcap --duration 9", "--duration: not with --from"),
        ("relay --join master --mbit-per-s 9", "--mbit-per-s: not with --join"),
    ],
)
def test_what_another_option_makes_void_is_refused(line: str, void: str) -> None:
    assert void in refused(line)


def test_help_is_shown_whatever_else_is_given() -> None:
    code, out, _ = run("up", "--attach", "--wait", "3", "--wait", "4", "--help")
    assert code == 0 and "Usage" in out


def test_rules_name_options_and_arguments_of_their_commands() -> None:
    told = 0
    for words, command in commands():
        names = {name_of(parameter) for parameter in command.params} | {"*"}
        for row in rules_of(command):
            terms = (row.option,) if isinstance(row, Keys) else (row.options, row.beside, row.unless, row.but)
            asked = {term.strip().partition(" ")[0] for text in terms for term in text.split(",") if term.strip()}
            assert asked <= names, f"{' '.join(words)}: {asked - names}"
            if isinstance(row, Keys) and row.of != "--set":
                assert row.of in names
            assert isinstance(row, Keys) or row.beside or row.unless
            told += 1
    assert told > 50


@pytest.mark.parametrize("code", [0, 1])
def test_json_is_one_object_whatever_a_command_prints(code: int, capsys: pytest.CaptureFixture[str]) -> None:
    app = typer.Typer(add_completion=False)

    @app.command()
    def chatty(as_json: Annotated[bool, typer.Option("--json")] = False) -> None:
        typer.echo("words for a person")
        print_json({"a": 1})
        print_json({"a": 2, "b": 3})
        if code:
            fail("wrong", code=code, as_json=as_json)

    command = _plain(typer.main.get_command(app), ("chatty",))
    assert (command.main(["--json"], standalone_mode=False) or 0) == code
    out, err = capsys.readouterr()
    assert json.loads(out) == {"a": 2, "b": 3, **({"error": "wrong"} if code else {})}
    assert "words for a person" in err


def test_rules_are_declared_beside_those_of_another_decorator() -> None:
    @rules(Void("--a", "which", beside="--b"))
    @rules(Keys("--c", "c"))
    def command() -> None: ...

    assert command.option_rules == (Keys("--c", "c"), Void("--a", "which", beside="--b"))  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (f"bag cat {DEMO} --start 1764000000", "lasts 8.500 s"),
        (f"bag cat {DEMO} --start 5 --end 3", "from 5 s to 3 s"),
        (f"bag cat {DEMO} --topics afm/state --topics afm/stat", "has no channel afm/stat: did you mean afm/state"),
        (f"bag filter {DEMO} --out made.mcap --start 1000", "lasts 8.500 s"),
        (f"bag filter {DEMO} --out made.mcap --nodes afm_node --nodes nobody", "has no message of node nobody"),
    ],
)
def test_a_choice_that_chooses_nothing_says_what_there_is(line: str, why: str) -> None:
    code, out, err = run(*line.split())
    assert (code, out) == (1, "") and why in err
    assert list(Path().iterdir()) == []
