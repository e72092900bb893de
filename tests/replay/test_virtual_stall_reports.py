"""A node that stood still says so at once, and for how long; what it may obey then is judged by `tests/simulation`."""

import pytest

from telenano.virtual import LINK_NODE, VirtualRig, constant_timing

NODES = ("haptic_node@master", "controller@master", LINK_NODE, "controller@slave", "afm_node@slave")
BEGIN_S = 0.3
# nothing late and nothing random, and the link a node of its own
TIMING = constant_timing(None, 100_000)


@pytest.mark.parametrize("node", NODES)
def test_a_node_says_for_how_long_it_stood_still(node: str) -> None:
    rig = VirtualRig(None, 1, (), TIMING)
    try:
        rig.run_until(BEGIN_S)
        begin_ns = rig.clock.now_ns()
        rig.stall(node, 0.2)
        rig.run_until(BEGIN_S + 0.3)
        (said,) = [event for event in rig.received("session/event", node) if "this process stalled" in event.text]
        assert said.level == "warning"
        assert said.data["stalled_s"] == pytest.approx(0.2, rel=0.0, abs=0.03)
        assert 0.0 <= (said.t_ns - begin_ns) * 1e-9 - 0.2 < 0.003
    finally:
        rig.close()
