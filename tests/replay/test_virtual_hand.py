"""A hand pushes a particle across the sample on the nodes in virtual time, under laws, delay and fixtures."""

import pytest
from lateral_hand import FIXTURES, PARTICLE_M, push_by_hand

DELAYED = tuple(f"delay_node.{way}.delay_s=0.1" for way in ("forward", "backward"))
LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated", "smith")


def test_a_hand_pushes_a_particle_and_feels_it() -> None:
    found = push_by_hand(presses_s=0.5, push_s=0.7, press_n=3.0)
    assert found.mode == "follow"
    assert found.particle_m[0] - PARTICLE_M[0] > 8e-8
    # the tip is behind it
    assert found.particle_m[0] - found.tip_m[0] == pytest.approx(3.3e-7, rel=0.1)
    # the friction of 21.5 nN at rest is 2.15 N, more than is shown
    assert 1.0 < found.felt_n <= 2.0 * (1.0 + 1e-9)
    assert found.news[:1] == ["met"]
    assert found.is_passive


@pytest.mark.endurance
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("delay", [(), DELAYED], ids=["no delay", "200 ms"])
def test_under_each_law_and_delay_with_fixtures_no_port_gives_out_more_than_was_promised(
    law: str, delay: tuple[str, ...]
) -> None:
    found = push_by_hand((f"controller.law={law}", *delay, *FIXTURES), push_s=2.2)
    assert found.particle_m[0] - PARTICLE_M[0] > 2.5e-7
    statuses = found.rig.received("law/status", "controller@master")
    # what is granted across, and for the hold of the depth
    assert found.rig.loops["controller@master"].node._across.store.entered_j > -2.5e-5  # type: ignore[attr-defined]
    if law in ("wave", "passivity"):
        assert all(status.passive for status in statuses)
