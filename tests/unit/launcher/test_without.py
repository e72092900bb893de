"""A rig of which a part runs elsewhere, or is replayed."""

from pathlib import Path

import pytest

from telenano.launcher.plan import UpRequest, excluded_nodes, make_plan
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import START_ORDER


def test_nodes_are_left_out_by_name_or_key() -> None:
    assert excluded_nodes(["controller"]) == {"controller@master", "controller@slave"}
    assert excluded_nodes(["controller@slave", "haptic_node"]) == {"controller@slave", "haptic_node@master"}
    assert excluded_nodes([]) == frozenset()
    with pytest.raises(ConfigError, match="--without hand: no such node, known are recorder@master"):
        excluded_nodes(["hand"])


def test_a_plan_starts_the_others_in_order(tmp_path: Path) -> None:
    request = UpRequest(scenario="fig12", site_file=DEFAULT_SITE_FILE, out=tmp_path / "out", without=("haptic_node",))
    plan = make_plan(request, tmp_path)
    assert plan.nodes == tuple(node for node in START_ORDER if node != "haptic_node@master")
