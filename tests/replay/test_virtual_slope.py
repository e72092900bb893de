"""A hand of three axes pushes along a slope, by position and by rate: felt, recorded, replayed, run again exactly."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
import zmq

from services.player.node import PlayerNode, PlaySettings
from services.player.run import ReplayRequest, run_replay
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.virtual import STARTED_S, record_session
from telenano.wire.nodes import PLAYER

SLOPE = 0.2
FORCE_SCALE, ARM_N_PER_M = 1e8, 300.0
REPLAYED = ("haptic/state", "haptic/command", "afm/state")
# where the hand is across: it presses first, and then goes up the slope [s, m]
PATH = [(0.5, 0.0), (1.5, 0.006), (2.0, 0.006)]
ENDS_S = STARTED_S + 2.0
# The folders of the code that decides what these tests measure.
ACROSS = ("services/player/", "telenano/hand/", "telenano/laws/", "telenano/rerun/", "telenano/sections/")
NODES = ("haptic_node@master", "controller@master", "controller@slave", "afm_node@slave")


def session(folder: Path, mode: str, slope: float) -> Recording:
    """Record a session over a sample of 2 um that rises with x."""
    x = np.linspace(-1e-6, 1e-6, 64)
    np.save(folder / "slope.npy", np.tile(slope * x, (64, 1)))
    presses = [{"time_s": 0.0, "force_n": 0.0}, {"time_s": 0.2, "force_n": 2.0}]
    scenario: dict[str, Any] = {
        "name": "slope",
        "description": "a hand of three axes pushes along a slope",
        "duration_s": 60.0,
        "haptic_node": {
            "driver": "simulated_impedance",
            "coupling": {"rest_s": 0.05},
            "impedance": {"lateral_path": [{"time_s": at_s, "x_m": x_m} for at_s, x_m in PATH]},
            "operator": {"kind": "force_profile", "points": presses},
        },
        "controller": {
            "law": "virtual_impedance",
            "virtual_impedance": {"position_scale": 1e-5},
            "lateral": {"mode": mode, "position_scale": 2e-5},
        },
        "afm_node": {
            "rest_distance_m": 10e-9,
            "meniscus": False,
            "sample": {"name": str(folder / "slope.npy"), "size_m": 2e-6},
        },
    }
    return Recording(record_session(folder, 1, (), ENDS_S, scenario))


def states(recording: Recording, topic: str) -> list[Any]:
    return [message.decode() for message in recording.messages((topic,))]


def replayed(recording: Recording, folder: Path) -> Counter[str]:
    """Replay hand and tip as fast as it goes, and return how many messages of each topic a reader received."""
    site_file = folder / "site.yaml"
    site_file.write_text(yaml.safe_dump({"nodes": {node: f"ipc://{folder}/{node}" for node in (*NODES, PLAYER)}}))
    found: Counter[str] = Counter()
    with zmq.Context() as context, context.socket(zmq.SUB) as reader:
        reader.set(zmq.RCVHWM, 0)
        reader.subscribe("")
        for node in NODES:
            reader.connect(f"ipc://{folder}/{node}")

        def read(_player: PlayerNode | None = None) -> None:
            while reader.poll(0):
                found[reader.recv_multipart()[0].decode()] += 1

        settings = PlaySettings(rate=0.0, wait_s=10.0)
        run_replay(ReplayRequest([recording.path], site_file, topics=REPLAYED, settings=settings), observe=read)
        read()
    return Counter({topic: found[topic] for topic in REPLAYED})


@pytest.mark.check("takes 6 s")
@pytest.mark.drawn(0.0, *ACROSS)
@pytest.mark.parametrize("mode", ["position", "rate"])
def test_a_slope_is_felt_across_and_the_session_is_run_again_exactly(mode: str, tmp_path: Path) -> None:
    recording = session(tmp_path, mode, SLOPE)
    hands, tips = states(recording, "haptic/state"), states(recording, "afm/state")
    hand, tip = hands[-1], tips[-1]
    assert hand.mode == "position" and tip.mode == "follow" and tip.in_contact
    x_m, felt_n = hand.position_m[0], hand.motor_force_n[0]
    # The sample pushes down the slope with the share of what presses onto it, and the hand is held back by that.
    assert tip.tip_force_n[0] == pytest.approx(-SLOPE * tip.tip_force_n[2], rel=0.05, abs=0.0)
    centring_n = 30.0 * x_m if mode == "rate" else 0.0
    assert felt_n == pytest.approx(FORCE_SCALE * tip.tip_force_n[0] - centring_n, rel=0.03, abs=0.0)
    assert x_m == pytest.approx(PATH[-1][1] + felt_n / ARM_N_PER_M, rel=0.02, abs=0.0)
    # The tip went up the slope, by the way of the hand, or by its displacement less the dead zone.
    later = [state for state in tips if state.t_ns > tips[-1].t_ns - 200_000_000]
    way_m = tip.base_position_m[0] - later[0].base_position_m[0]
    if mode == "position":
        assert tip.base_position_m[0] == pytest.approx(2e-5 * x_m, rel=0.02, abs=0.0)
        assert tip.base_position_m[0] > 8e-8
    else:
        assert way_m / 0.2 == pytest.approx(3e-5 * (x_m - 1e-3), rel=0.05, abs=0.0)
    pressed = next(state for state in tips if state.t_ns > tips[-1].t_ns - 1_400_000_000)
    rise_m, run_m = (tip.base_position_m[axis] - pressed.base_position_m[axis] for axis in (2, 0))
    assert rise_m == pytest.approx(SLOPE * run_m, rel=0.1, abs=0.0)
    # It is replayed onto a bus as it was recorded, and each node gives the same again, bit by bit.
    assert replayed(recording, tmp_path) == Counter(message.topic for message in recording.messages(REPLAYED))
    for node in NODES:
        assert rerun(recording, node).identical, node


@pytest.mark.check("takes 4 s")
@pytest.mark.drawn(0.0, *ACROSS)
def test_a_plane_is_not_felt_across(tmp_path: Path) -> None:
    recording = session(tmp_path, "position", 0.0)
    hand, tip = states(recording, "haptic/state")[-1], states(recording, "afm/state")[-1]
    assert tip.in_contact and tip.base_position_m[0] > 1e-7
    assert abs(tip.tip_force_n[0]) < 1e-12 and abs(hand.motor_force_n[0]) < 0.01
