"""Laws and link on real processes: switched while they run, changed by command, and in agreement with lockstep."""

import json
from typing import Any

import numpy as np
import pytest

from services.recorder.columns import columns
from services.recorder.reader import Recording


def test_switching_the_law_moves_neither_tip_nor_hand(rig: Any) -> None:
    rig.start("--duration", "600", "--set", "haptic_node.operator.points=[{time_s: 0.2, force_n: 0.0}, "
              "{time_s: 0.6, force_n: 1.0}]")  # fmt: skip
    rig.wait_until(rig.running, "a running session")
    rig.wait_until(lambda: _pressing(rig), "a tip pressed onto the sample", patience_s=60.0)
    switched = rig.tell("session", "set", "law=wave", "--target", "controller")
    assert switched.returncode == 0, switched.stdout + switched.stderr
    rig.wait_until(lambda: _law(rig) == "wave", "the other law on the bus", patience_s=60.0)
    back = rig.tell("session", "set", "law=virtual_impedance", "--target", "controller")
    assert back.returncode == 0, back.stdout + back.stderr
    rig.wait_until(lambda: _law(rig) == "virtual_impedance", "the first law again", patience_s=60.0)
    code, _, err = rig.stop()
    assert code == 0, err
    recording = Recording(rig.out / "session.mcap")
    forward = columns(recording, "teleop/forward", ("t_ns", "law"))
    tip = columns(recording, "afm/state", ("t_ns", "base_position_m.2", "mode"))
    for at in np.flatnonzero(forward["law"][1:] != forward["law"][:-1]):
        around = np.abs(tip["t_ns"] - forward["t_ns"][at]) < 30_000_000
        assert set(tip["mode"][around]) == {"follow"}
        # the free approach moves 15 pm a millisecond; a switch must not be seen among such steps
        assert np.abs(np.diff(tip["base_position_m.2"][around])).max() < 20e-12


def _pressing(rig: Any) -> bool:
    done = rig.tell("topic", "echo", "afm/state", "--count", "1")
    return bool(done.stdout.strip()) and json.loads(done.stdout)["tip_force_n"][2] > 5e-9


def _law(rig: Any) -> str:
    done = rig.tell("topic", "echo", "teleop/backward", "--count", "1")
    return str(json.loads(done.stdout)["law"])


def test_link_is_shown_changed_refused_and_cleared(rig: Any) -> None:
    rig.start("--duration", "600")
    rig.wait_until(rig.running, "a running session")
    assert rig.tell("link", "set", "forward.delay_s=0.004", "backward.loss.probability=0.1").returncode == 0
    refused = rig.tell("link", "set", "forward.delay_s=-1.0")
    assert refused.returncode == 1
    assert "forward.delay_s" in refused.stdout
    shown = json.loads(rig.tell("link", "show", "--json").stdout)
    assert shown["forward"]["settings"]["delay_s"] == 0.004
    assert shown["clock"]["valid"]
    # one machine, one clock: the offset is nought within its own uncertainty
    assert abs(shown["clock"]["offset_s"]) <= shown["clock"]["uncertainty_s"]
    assert rig.tell("link", "profile", "lan").returncode == 0
    assert rig.tell("link", "clear").returncode == 0
    code, _, err = rig.stop()
    assert code == 0, err
    told = [message.decode() for message in Recording(rig.out / "session.mcap").messages(["link/fates"])]
    lost = [fate for message in told for fate in message.fates if fate.dropped]
    assert {fate.dropped for fate in lost} == {"loss"}
    # what the ground truth calls lost is what did not come out at the other site
    sent, came = _numbers(rig, "teleop/backward"), _numbers(rig, "teleop/backward@master")
    told_lost = {fate.seq for fate in lost if fate.topic == "teleop/backward"}
    inside = {seq for seq in sent if min(came) < seq < max(came)}
    assert inside - came == told_lost & inside


def _numbers(rig: Any, channel: str) -> set[int]:
    return set(columns(Recording(rig.out / "session.mcap"), channel, ("seq",))["seq"].tolist())


def test_bus_agrees_with_lockstep_on_both_sides_of_the_edge(rig: Any) -> None:
    done = rig.tell(
        "study", "validate", "--environment", "spring", "--stiffness", "38", "--delay", "20,24", "--out",
        str(rig.folder / "study"), "--json", patience_s=150.0,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["agree"]
    (edge,) = found["bus_critical_delay_ms"]
    # theory: 22.44 ms
    assert edge["bus_critical_delay_ms"] == pytest.approx(22.44, abs=3.0)
