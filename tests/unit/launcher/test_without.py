"""A rig of which somebody else, or a recording, runs a part."""

from pathlib import Path

import pytest

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError
from proto.nodes import START_ORDER
from services.launcher.plan import UpRequest, left_out, make_plan


def test_nodes_are_left_out_by_name_or_key() -> None:
    assert left_out(["controller"]) == {"controller@master", "controller@slave"}
    assert left_out(["controller@slave", "haptic_node"]) == {"controller@slave", "haptic_node@master"}
    assert left_out([]) == frozenset()
    with pytest.raises(ConfigError, match="--without hand: there are recorder@master"):
        left_out(["hand"])


def test_a_plan_starts_the_others_in_order(tmp_path: Path) -> None:
    request = UpRequest("fig12", DEFAULT_SITE_FILE, None, None, tmp_path / "out", False, (), ("haptic_node",))
    plan = make_plan(request, tmp_path)
    assert plan.nodes == tuple(node for node in START_ORDER if node != "haptic_node@master")
