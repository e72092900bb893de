"""What an experiment may vary from trial to trial is what `set` can change at each node."""

import pytest
from command_table import settable
from telenano_lab.experiments.plan import changes_while_running


@pytest.mark.parametrize("node", ["controller", "delay_node", "haptic_node"])
def test_what_may_vary_from_trial_to_trial_is_what_set_can_change(node: str) -> None:
    assert all(changes_while_running(f"{node}.{key}") or key == "operator" for key in settable(node))
    assert changes_while_running("afm_node.spring.stiffness_n_per_m")
    assert not changes_while_running("afm_node.environment")
    assert not changes_while_running("controller.period_s")
    assert not changes_while_running("haptic_node.device.start_position_m")
    assert not changes_while_running("duration_s")
