"""A hand pushes a particle across the sample under laws, delay and fixtures, on the nodes and in lockstep."""

from typing import Any

import numpy as np
import pytest
import yaml
from lateral_hand import FIXTURES, PARTICLE_M, LatePage, Pushed, push_by_hand, scenario

from telenano.lockstep import lockstep
from telenano.lockstep.lockstep import Rig
from telenano.lockstep.simulation import SimulatedSession
from telenano.lockstep.trajectory import Trajectory
from telenano.sections.controller_section import ControllerConfig
from telenano.settings.config import merge, nested

DELAYED = tuple(f"delay_node.{way}.delay_s=0.1" for way in ("forward", "backward"))
LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated", "smith")


# what the store across grants the plane, and the hold of the depth as well
GRANTED_J = 1e-3 * (1.0 + 1e-9)
SHORT = 0.5, 0.7, 3.0


def simulated(times: tuple[float, float, float], *settings: str) -> SimulatedSession:
    """Run the session of `push_by_hand` in lockstep."""
    keys = {key: yaml.safe_load(value) for key, _, value in (word.partition("=") for word in settings)}
    return SimulatedSession.of(merge(scenario(*times), nested(keys, "a test")), "a test")


@pytest.fixture(scope="module")
def pushed_on_nodes() -> Pushed:
    return push_by_hand((), *SHORT)


@pytest.mark.check("takes 10 s")
def test_a_hand_pushes_a_particle_and_feels_it(pushed_on_nodes: Pushed) -> None:
    found = pushed_on_nodes
    assert found.mode == "follow"
    assert found.particle_m[0] - PARTICLE_M[0] > 6e-8
    # the tip is behind it
    assert found.particle_m[0] - found.tip_m[0] == pytest.approx(3.3e-7, rel=0.1)
    # the friction of 21.5 nN at rest is 2.15 N, more than is shown
    assert 1.0 < found.felt_n <= 2.0 * (1.0 + 1e-9)
    assert found.news[:1] == ["met"]
    assert found.is_passive


def test_in_lockstep_it_goes_as_on_the_nodes(pushed_on_nodes: Pushed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lockstep, "compiled_call", lambda step, given: step(*given))
    found = simulated(SHORT)
    tip = found.table("afm/state")
    assert tip["base_position_m.0"][-1] == pytest.approx(pushed_on_nodes.tip_m[0], abs=5e-9)
    assert tip["base_position_m.0"][-1] > 8e-8
    assert np.abs(found["shown_x_n"]).max() == pytest.approx(pushed_on_nodes.felt_n, rel=0.02)
    assert found["across_j"].min() >= -GRANTED_J


@pytest.mark.endurance
@pytest.mark.parametrize("dies", [False, True], ids=["the pointer is let go", "the page dies"])
@pytest.mark.parametrize("delay", [(), DELAYED], ids=["no delay", "200 ms"])
def test_a_tip_that_pushes_stands_soon_after_it_was_let_go(delay: tuple[str, ...], dies: bool) -> None:
    page = LatePage(delay, begins_s=0.6)
    page.hold(0.6, None)
    page.hold(1.6, 12e-3)
    begin = len(page.stage_m())
    if dies:
        page.wait(1.5)
    else:
        page.hold(1.5, None)
    page.close()
    stage = page.stage_m()
    # it was in contact, and pushed
    assert stage[begin] > 1.5e-7
    rests = stage[begin + 900 :]
    assert set(rests) == {rests[0]}
    # as far as the stylus brings it back to its middle, and what the link still carries
    assert abs(rests[0] - stage[begin]) < (40e-9 if not delay else 100e-9)


@pytest.mark.endurance
@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("delay", [(), DELAYED], ids=["no delay", "200 ms"])
def test_in_lockstep_no_port_gives_out_more_than_the_law_and_the_store_promise(
    law: str, delay: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # plain, because to compile six laws takes longer; the compiled path gives its bits, see below
    monkeypatch.setattr(lockstep, "compiled_call", lambda step, given: step(*given))
    courses: list[Trajectory] = []
    run = Rig.run

    def kept(*given: Any, **more: Any) -> Trajectory:
        courses.append(run(*given, **more))
        return courses[-1]

    monkeypatch.setattr(Rig, "run", kept)
    found = simulated((1.5, 2.2, 1.0), f"controller.law={law}", *delay, *FIXTURES)
    assert found["tip_x_m"][-1] > 2.5e-7
    assert found["across_j"].min() >= -GRANTED_J
    assert found["depth_j"].min() >= -GRANTED_J
    if law in ("wave", "passivity"):
        assert net_j(found, courses[0], law).min() >= -1e-6


def net_j(session: SimulatedSession, course: Trajectory, law: str) -> np.ndarray:
    """Return the energy that has entered the law at both ports, at the hand's scale [J]."""
    scale = ControllerConfig.model_validate({"law": law}).law_config().force_scale / 1e-5
    # the hold of the depth acts on the law as a force of the hand
    return np.asarray(course.hand_energy_j - session["depth_j"] - scale * course.tip_energy_j)


@pytest.mark.endurance
def test_the_compiled_path_across_gives_the_bits_of_the_plain_one(monkeypatch: pytest.MonkeyPatch) -> None:
    fast = simulated((0.3, 0.5, 3.0), *FIXTURES)
    monkeypatch.setattr(lockstep, "compiled_call", lambda step, given: step(*given))
    plain = simulated((0.3, 0.5, 3.0), *FIXTURES)
    assert {name: fast[name].tobytes() for name in fast} == {name: plain[name].tobytes() for name in plain}


@pytest.mark.endurance
@pytest.mark.grid(law="passivity")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("delay", [(), DELAYED], ids=["no delay", "200 ms"])
def test_under_each_law_and_delay_with_fixtures_no_port_gives_out_more_than_was_promised(
    law: str, delay: tuple[str, ...]
) -> None:
    found = push_by_hand((f"controller.law={law}", *delay, *FIXTURES), push_s=2.2)
    assert found.particle_m[0] - PARTICLE_M[0] > 2.5e-7
    statuses = found.rig.received("law/status", "controller@master")
    # what is granted across, and for the hold of the depth
    assert found.rig.loops["controller@master"].node.memory.across.store.entered_j > -1e-3  # type: ignore[attr-defined]
    if law in ("wave", "passivity"):
        assert all(status.passive for status in statuses)
