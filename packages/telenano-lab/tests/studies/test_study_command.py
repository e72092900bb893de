"""The command line of the studies: what it reads, what it refuses and with which message."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from telenano_lab.studies import option_values
from telenano_lab.studies.option_values import Jitter
from telenano_lab.studies.study_command import app
from typer.testing import CliRunner

from telenano.testing import invoke
from telenano.wire import ConfigError

RUN = CliRunner()
STABILITY = ["stability", "--law", "virtual_impedance", "--environment", "spring"]


def test_numbers_are_lists_and_ranges() -> None:
    assert option_values.numbers("--delay", "0:20:5", 0.0, 100.0, "ms") == (0.0, 5.0, 10.0, 15.0, 20.0)
    assert option_values.numbers("--delay", "40,0:0.3:0.1,7", 0.0, 100.0, "ms") == (0.0, 0.1, 0.2, 0.3, 7.0, 40.0)
    assert option_values.numbers("--delay", "3:3:1", 0.0, 100.0, "ms") == (3.0,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("-1", "-1 ms is outside 0 to 100 ms"),
        ("101", "outside"),
        ("x", "'x' is not a number"),
        ("", "is not a number"),
        ("1:2", "start:stop:step"),
        ("1:2:0", "step > 0"),
        ("1:2:-1", "step > 0"),
        ("5:1:1", "not below its start"),
        ("nan", "not finite"),
        ("0:inf:1", "not finite"),
        ("0:100:0.001", "more than 10000"),
    ],
)
def test_bad_numbers_name_option_and_remedy(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        option_values.numbers("--delay", text, 0.0, 100.0, "ms")
    assert str(caught.value).startswith("--delay")


def test_frequencies_lie_in_what_a_hand_can_do() -> None:
    assert option_values.frequencies("5,0.3") == (0.3, 5.0)
    with pytest.raises(ConfigError, match=r"--frequency 80: 80 Hz is outside 0\.05 to 50 Hz"):
        option_values.frequencies("80")


def test_laws_jitter_and_loss() -> None:
    assert option_values.laws("all") == option_values.COMPARED_LAWS
    assert option_values.laws("wave, smith,wave") == ("wave", "smith")
    assert option_values.jitters("0,5,50%") == (Jitter(0.0), Jitter(5.0), Jitter(0.5, relative=True))
    assert option_values.losses("20%,0") == (0.0, 0.2)
    assert option_values.settings(["wave.filter_s=0.0", "deadband.enabled=true"]) == (
        ("deadband.enabled", True), ("wave.filter_s", 0.0),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--law", "nonsense"], "unknown law 'nonsense', known are all, virtual_impedance"),
        (["--delay", "-5"], "--delay -5"),
        (["--loss", "1.5"], "--loss 1.5"),
        (["--loss", "-0.1"], "--loss -0.1"),
        (["--jitter", "-1"], "--jitter -1"),
        (["--jitter", "120%"], "--jitter 120%"),
        (["--stiffness", "0"], "--stiffness 0"),
        (["--gain", "x"], "--gain"),
        (["--duration", "-1"], "--duration"),
        (["--duration", "1", "--delay", "200"], "leaves no hold"),
        (["--set", "virtual_impedance.mass_kg"], "not of the form"),
        (["--set", "virtual_impedance.mass_kg=-1"], "mass_kg"),
        (["--set", "virtual_impedance.unknown=1"], "unknown"),
        (["--mass", "0.1"], "--mass: spring has none; give --environment body"),
        (["--environment", "body", "--mass", "1e-7"], "it must be at least"),
        (["--seed", "3"], "--seed: nothing is random without --jitter, --loss or a disturbance"),
        (["--seeds", "3"], "--seeds: nothing is random without"),
    ],
)
def test_bad_options_end_in_a_sentence_and_code_2(tmp_path: Path, options: list[str], words: str) -> None:
    result = RUN.invoke(app, [*STABILITY, "--out", str(tmp_path / "out"), "--json", *options])
    assert result.exit_code == 2
    assert words in json.loads(result.stdout)["error"]
    assert words in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("plain_loop")
def test_a_sample_that_is_too_stiff_for_a_law_is_named(tmp_path: Path) -> None:
    options = [
        "stability",
        "--law",
        "wave",
        "--environment",
        "spring",
        "--delay",
        "0",
        "--duration",
        "2",
        "--workers",
        "1",
    ]
    result = RUN.invoke(app, [*options, "--stiffness", "20,500", "--out", str(tmp_path / "out")])
    assert result.exit_code == 0
    assert result.stderr.count("telenano: warning: law wave: 500 N/m is stiffer than the 444.4 N/m") == 1
    assert "20 N/m is stiffer" not in result.stderr


def test_a_cluster_without_dask_names_what_adds_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    options = ["--delay", "0", "--stiffness", "38", "--scheduler", "tcp://h:1", "--out", str(tmp_path / "out")]
    result = invoke(["study", *STABILITY, *options])
    assert result.exit_code == 2
    assert "dask is not installed: pip install" in result.stderr


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = RUN.invoke(app, [*STABILITY, "--out", str(tmp_path / "file" / "out")])
    assert result.exit_code == 1
    assert "cannot be made" in result.stderr


def test_stability_prints_one_object(tmp_path: Path) -> None:
    options = ["--delay", "0,60", "--stiffness", "38", "--workers", "1", "--out", str(tmp_path), "--json"]
    result = RUN.invoke(app, [*STABILITY, *options])
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    assert summary["critical_delay_ms"]["38"] == pytest.approx(22.44, rel=2e-3, abs=0.0)
    assert summary == json.loads((tmp_path / "stability.json").read_text())
    assert {p.name for p in tmp_path.iterdir()} >= {"stability.html", "stability.png", "stability.parquet"}


def test_loop_that_no_delay_upsets_ends_in_a_page(tmp_path: Path) -> None:
    options = ["--delay", "0,20", "--stiffness", "5", "--hand", "stiff", "--workers", "1", "--out", str(tmp_path)]
    result = RUN.invoke(app, [*STABILITY, *options, "--json"])
    assert result.exit_code == 0, result.output
    (line,) = json.loads(result.stdout)["lines"]
    assert (line["hand"], line["theory_unlimited"], line["theory_delay_ms"]) == ("stiff", True, None)
    assert "any" in (tmp_path / "stability.html").read_text()


def test_stability_prints_a_table(tmp_path: Path) -> None:
    options = ["--delay", "0,60", "--stiffness", "38", "--workers", "1", "--out", str(tmp_path)]
    result = RUN.invoke(app, [*STABILITY, *options])
    assert result.exit_code == 0, result.output
    assert "22.45" in result.stdout or "22.44" in result.stdout
    assert "stability.html" in result.stdout


def test_a_table_tells_a_sweep_that_was_too_short_from_a_law_without_theory(tmp_path: Path) -> None:
    options = ["--delay", "0,20", "--stiffness", "10", "--duration", "2", "--workers", "1", "--out", str(tmp_path)]
    result = RUN.invoke(app, ["stability", "--law", "wave", "--environment", "spring", *options])
    assert result.exit_code == 0, result.output
    (row,) = (line for line in result.stdout.splitlines() if "wave" in line)
    assert re.split(" {2,}", row) == ["wave", "K = 10 N/m", "no theory", "> 20", "> 20"]


def test_transparency_prints_one_object(tmp_path: Path) -> None:
    options = ["--law", "virtual_impedance", "--delay", "0,100", "--out", str(tmp_path), "--json"]
    result = RUN.invoke(app, ["transparency", *options, "--frequency", "2,5"])
    assert result.exit_code == 0, result.output
    first, second = json.loads(result.stdout)["rows"]
    assert first["verdict"] == "stable"
    assert second["rendered_stiffness_n_per_m"] is None
    # the delay takes stiffness from what can be rendered passively: B_v = 2000 N s/m over K_f + 1 and the delay
    assert first["passive_n_per_m"] > 5.0 * second["passive_n_per_m"] > 0.0
    assert "http" not in (tmp_path / "transparency.html").read_text()
    assert {p.name for p in tmp_path.iterdir()} >= {"impedances.png", "hybrid-0ms.png", "spectra.parquet"}


def test_help_is_there_at_once() -> None:
    code = "import sys; import telenano_lab.studies.study_command; "
    code += "bad = {'numba', 'matplotlib', 'control', 'pyarrow', 'dask'}; "
    code += "print(sorted(bad & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    for command in ("stability", "transparency", "validate"):
        assert RUN.invoke(app, [command, "--help"]).exit_code == 0
