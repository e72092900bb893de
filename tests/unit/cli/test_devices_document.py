"""The scenarios in the pages of the devices are valid."""

import re
import textwrap
from pathlib import Path

import pytest

from telenano.sections.afm_section import AfmConfig
from telenano.sections.hand_section import HapticConfig
from telenano.settings.scenario import LoadedScenario

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("page", ["devices", "3-calibrate", "4-first-touch"])
def test_scenarios_of_the_pages_are_valid(page: str, tmp_path: Path) -> None:
    text = (ROOT / "packages" / "telenano-devices" / "docs" / f"{page}.md").read_text(encoding="utf-8")
    blocks = [textwrap.dedent(block) for block in re.findall(r"^ *```yaml\n(.*?)```", text, re.MULTILINE | re.DOTALL)]
    scenarios = [block for block in blocks if block.startswith("name:")]
    assert len(scenarios) == 1
    path = tmp_path / "scenario.yaml"
    path.write_text(scenarios[0])
    found = LoadedScenario.load(path)
    found.section("afm_node", AfmConfig)
    found.section("haptic_node", HapticConfig)
