"""A push among particles on the virtual rig: its recording has the truth, and a re-run gives it exactly."""

from itertools import pairwise

import msgspec
import pytest
from telenano_lab.assembly import bench
from telenano_lab.assembly.messages import AfmParticles
from telenano_lab.assembly.particles import layer

from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.virtual import ARMED_S, VirtualRig

SCENARIO = {
    "name": "pushed",
    "description": "The tip pushes one of three particles",
    "duration_s": 1.0,
    "haptic_node": {"operator": {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}]}},
    "afm_node": bench({"places": [[0.0, 0.0], [7e-7, 3e-8], [-2e-6, 2e-6]]}, 1.0),
}
PUSH = {
    "program": "push",
    "push.x0_m": 0.0,
    "push.y0_m": 0.0,
    "push.x1_m": 4e-7,
    "push.y1_m": 0.0,
    "push.approach_m_per_s": 5e-6,
    "push.mode": "straight",
}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    rig = VirtualRig(tmp_path_factory.mktemp("particles"), 3, scenario=SCENARIO)
    rig.run_until(ARMED_S)
    rig.command("set", "afm_node", **PUSH)
    rig.run_until(1.4)
    return Recording(rig.finish())


def test_the_recording_has_where_the_particles_really_were(recording: Recording) -> None:
    told = [message.fields() for message in recording.messages(("afm/particles",))]
    messages = [msgspec.convert(fields, AfmParticles) for fields in told]
    assert all(message.simulated for message in messages)
    places = [message.places_m.to_numpy() for message in messages]
    way = places[-1] - places[0]
    # the first pushes the second, and the third is left alone
    assert way[0, 0] > 200e-9 and way[1, 0] > 50e-9 and way[2].tolist() == [0.0, 0.0]
    assert messages[0].moving.to_numpy().tolist() == [0, 0, 0]
    # 20 a second while one moves, else one
    times_s = [1e-9 * message.t_ns for message in messages]
    moving = [before for before, message in zip(times_s, messages, strict=True) if message.moving.to_numpy().any()]
    assert len(moving) >= 3
    assert min(b - a for a, b in pairwise(times_s)) >= 0.048


def test_a_rerun_is_exact(recording: Recording) -> None:
    result = rerun(recording, "afm_node@slave")
    assert result.difference == "" and result.identical
    assert result.compared["afm/particles"] >= 3 and result.compared["afm/state"] > 1000


def test_a_rerun_that_is_not_compiled_is_exact(recording: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layer, "tick", getattr(layer.tick, "py_func", layer.tick))
    assert rerun(recording, "afm_node@slave").identical


def test_another_strength_of_the_interface_is_a_difference(recording: Recording) -> None:
    other = ["afm_node.sample.particles.shear_pa=1.3e7"]
    assert not rerun(recording, "afm_node@slave", settings=other).identical
