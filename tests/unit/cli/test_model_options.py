"""Options that are made from a settings model: their names, units, bounds and defaults are those of the model."""

from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from telenano.cli.model_options import GIVEN, options_of, validated, with_options
from telenano.sections.program_table import OWN_PROGRAMS
from telenano.settings.program_settings import CurveSettings, ScanSettings
from telenano.wire.errors import ConfigError

RUNNER = CliRunner()


def app_of(model: Any, leave_out: tuple[str, ...] = ()) -> tuple[typer.Typer, list[dict[str, Any]]]:
    """Return a program with one command, and the list of what the command is given."""
    calls: list[dict[str, Any]] = []

    @with_options(model, leave_out)
    def command(given: dict[str, Any], last: int = 3) -> None:
        calls.append({**given, "last": last})

    made = typer.Typer(rich_markup_mode=None)
    made.command()(command)
    return made, calls


def test_what_is_given_arrives_in_si_units_and_what_is_not_is_left_to_the_model() -> None:
    app, calls = app_of(ScanSettings)
    words = "--mode tapping --pixels 32 --dwell 2 --amplitude 15 --gain 600 --approach 50 --setpoint-share 0.7 --last 4"
    result = RUNNER.invoke(app, words.split())
    assert result.exit_code == 0, result.output
    assert calls == [
        {
            "mode": "tapping",
            "pixels": 32,
            "dwell_s": 2.0 * 1e-3,
            "amplitude_m": 15.0 * 1e-9,
            "setpoint_share": 0.7,
            "gain_per_s": 600.0,
            "approach_m_per_s": 50.0 * 1e-9,
            "last": 4,
        }
    ]
    assert RUNNER.invoke(app, []).exit_code == 0
    assert calls[1] == {"last": 3}


def test_the_help_has_unit_bounds_and_default() -> None:
    app, _ = app_of(ScanSettings, ("x_m",))
    text = " ".join(RUNNER.invoke(app, ["--help"], env={"COLUMNS": "300", "TERM": "dumb"}).output.split())
    assert (
        "Time on each pixel, each way [ms]; default: 4 ms, or 2 steps of a slow instrument; above 0 to 10000." in text
    )
    assert "default: 400." in text
    assert "Force that is held in contact mode [nN]; above -1e+06 to 1e+06; default: 5." in text
    assert "--x " not in text
    assert GIVEN not in text


def test_a_value_that_the_model_refuses_is_named_by_its_option_and_unit() -> None:
    with pytest.raises(ConfigError, match=r"^--speed = -5 must be above 0 to 1e\+06 \[nm/s\]$"):
        validated(CurveSettings, {"speed_m_per_s": -5e-9})
    with pytest.raises(ConfigError, match=r"^--setpoint = 2 must be 0.05 to below 1$"):
        validated(ScanSettings, {"setpoint_share": 2.0}, {"setpoint_share": "--setpoint"})


@pytest.mark.parametrize("name", OWN_PROGRAMS)
def test_every_setting_of_every_program_can_be_an_option(name: str) -> None:
    options = options_of(OWN_PROGRAMS[name].settings)
    assert [option.field for option in options if option.kind is None] == []
    assert app_of(OWN_PROGRAMS[name].settings)[0] is not None
