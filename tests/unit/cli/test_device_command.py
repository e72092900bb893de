"""The scenarios that the emulated devices of `telenano device simulate` take."""

from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from telenano.cli import root
from telenano.cli.commands.device_files import section_of
from telenano.sections.afm_section import AfmConfig


@pytest.mark.parametrize("emulator", ["haply", "handle", "t7", "gwyscope", "nanonis"])
def test_emulators_take_a_scenario_by_its_name_and_say_which_there_are(emulator: str) -> None:
    done = CliRunner().invoke(root.app, ["device", "simulate", emulator, "--scenario", "fig13"])
    assert done.exit_code == 2
    assert "unknown scenario 'fig13': did you mean fig12? Known are" in done.output and "fig12" in done.output


def test_scenario_of_an_emulator_is_a_name_a_file_or_the_defaults(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        yaml.safe_dump(
            {"name": "mine", "description": "mine", "duration_s": 1.0, "afm_node": {"rest_distance_m": 2.0e-8}}
        )
    )
    found = [section_of(given, "afm_node", AfmConfig).rest_distance_m for given in (Path("fig12"), file)]
    assert found == [1.0e-8, 2.0e-8]
    assert section_of(None, "afm_node", AfmConfig) == AfmConfig()
