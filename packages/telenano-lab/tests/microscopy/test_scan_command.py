"""Gains of `telenano scan` that no feedback can have: one sentence that names the option, before anything moves."""

from pathlib import Path

import pytest

from telenano.testing import invoke


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--live", "--gain", "nan"), "--gain = nan must be above 0 to 1e+07 [1/s]"),
        (("--live", "--gain", "-3"), "--gain = -3 must be above 0 to 1e+07 [1/s]"),
        (("--live", "--proportional", "-0.5"), "--proportional = -0.5 must be 0 to 100"),
        (("--live", "--proportional", "inf"), "--proportional = inf must be 0 to 100"),
        (("--proportional", "nan"), "--proportional = nan must be 0 to 100"),
        (("--sample", "flat", "--mode", "contact", "--gain", "1e5"), "it must be below 2000 1/s"),
        (("--sample", "flat", "--gain", "1e5"), "it must be below 666.667 1/s"),
        (("--setpoint", "1.2"), "--setpoint = 1.2 must be 0.05 to below 1"),
        (("--live", "--mode", "contact", "--setpoint", "2e6"), "--setpoint = 2e+06 must be above -1e+06 to 1e+06 [nN]"),
        (("--dwell", "0"), "--dwell = 0 must be above 0 to 10000 [ms]"),
        (("--pixels", "1"), "--pixels = 1 must be 2 to 4096"),
        (("--set", "particles.count=3"), "does not clear the highest particle"),
    ],
)
def test_an_impossible_gain_is_refused_by_the_name_of_its_option(
    options: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    result = invoke(["scan", "--out", str(tmp_path / "out"), *options])
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in result.stderr
    assert result.stderr.strip().count("\n") == 0
    assert not list(tmp_path.glob("out/scan.*"))
