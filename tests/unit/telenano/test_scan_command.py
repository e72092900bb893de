"""Gains of `telenano scan` that no feedback can have: one sentence that names the option, before anything moves."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from telenano.cli.root import app

RUNNER = CliRunner()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--live", "--gain", "nan"), "--gain = nan must be positive and finite [1/s]"),
        (("--live", "--gain", "-3"), "--gain = -3 must be positive and finite [1/s]"),
        (("--live", "--proportional", "-0.5"), "--proportional = -0.5 must be 0 or more, and finite"),
        (("--live", "--proportional", "inf"), "--proportional = inf must be 0 or more, and finite"),
        (("--proportional", "nan"), "proportional (--proportional) = nan must be 0 or more"),
        (("--sample", "flat", "--mode", "contact", "--gain", "1e5"), "it must be below 40000 1/s"),
        (("--sample", "flat", "--gain", "1e5"), "it must be below 18849.6 1/s"),
    ],
)
def test_an_impossible_gain_is_refused_by_the_name_of_its_option(
    options: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    result = RUNNER.invoke(app, ["scan", "--out", str(tmp_path / "out"), *options])
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert result.stderr.strip().count("\n") == 0
    assert not list(tmp_path.glob("out/scan.*"))
