"""Laws stay finite within the ranges of wire and settings, and a setting beyond its range is refused with the range."""

import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import corners
import numpy as np
import pytest

from telenano.extend.virtual_mass import FARTHEST_M, bounded
from telenano.laws.energy import Port
from telenano.sections.controller_section import OWN_LAWS as LAWS
from telenano.sections.controller_section import ControllerConfig
from telenano.settings.config import flatten, validate
from telenano.wire.errors import ConfigError

ROOT = Path(__file__).parents[3]
CASES = 8


@pytest.mark.check("takes 2.5 s")
def test_every_half_as_a_node_runs_it_gives_numbers_at_the_corners() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-W", "error", str(Path(corners.__file__)), "1", str(CASES)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "")


@pytest.mark.check("takes 1.9 s")
def test_every_half_as_a_study_runs_it_gives_numbers_at_the_corners() -> None:
    assert list(corners.failures(2, CASES)) == []


def test_the_check_finds_what_is_no_number() -> None:
    corners.check("state", (1.0, (0.0, True), 7, np.zeros(3), Port(0.0, 0.0, 0.0)))
    for wrong in ((0.0, math.nan), ((1.0, (math.inf,)),), (np.array([0.0, math.nan]),), Port(0.0, -math.inf, 0.0)):
        with pytest.raises(corners.NotANumberError, match="state"):
            corners.check("state", wrong)


def _numbers() -> list[tuple[str, dict[str, Any]]]:
    found = []
    for name in (*LAWS, "deadband", "clamp"):
        model: Any = ControllerConfig.model_fields[name].annotation
        schema = model.model_json_schema()["properties"]
        found += [(f"{name}.{key}", part) for key, part in schema.items() if part.get("type") == "number"]
    return found


@pytest.mark.parametrize(("key", "schema"), _numbers(), ids=lambda part: part if isinstance(part, str) else "")
def test_a_setting_beyond_its_range_is_refused_with_the_range(key: str, schema: dict[str, Any]) -> None:
    section, name = key.split(".")
    for beyond in (1e300, -1e-300):
        with pytest.raises(ConfigError) as caught:
            validate(ControllerConfig, {section: {name: beyond}}, "f.yaml", "controller")
        assert f"f.yaml: controller.{key}: Input should be " in str(caught.value)
        assert "(allowed is from " in str(caught.value)
    if schema.get("minimum", 0.0) > 0.0:
        with pytest.raises(ConfigError, match="allowed is"):
            validate(ControllerConfig, {section: {name: 1e-300}}, "f.yaml", "controller")


def test_the_settings_as_they_come_are_well_inside_of_their_ranges() -> None:
    defaults = flatten(ControllerConfig().model_dump())
    for key, schema in _numbers():
        low, high = schema.get("minimum", 0.0), schema.get("maximum", schema.get("exclusiveMaximum"))
        assert low == 0.0 or low <= 1e-2 * defaults[key], key
        assert high >= 2.0 * defaults[key], key


def test_what_is_bounded_keeps_its_bits_inside_and_what_is_no_number_shows() -> None:
    for value in (0.0, -0.0, 5e-324, 1.5e-9, -FARTHEST_M, FARTHEST_M):
        assert repr(bounded(value, FARTHEST_M)) == repr(value)
    assert bounded(float("inf"), FARTHEST_M) == FARTHEST_M
    assert bounded(-1e300, FARTHEST_M) == -FARTHEST_M
    assert bounded(float("nan"), FARTHEST_M) != bounded(float("nan"), FARTHEST_M)
