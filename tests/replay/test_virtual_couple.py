"""`session couple` in virtual time: a stall has parted hand and tip, and the command brings them together again."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from telenano.console.coupling import TOPICS, couple
from telenano.recording.reader import Recording
from telenano.rerun.rerun import rerun
from telenano.runtime.loop.commands import Command
from telenano.virtual import ARMED_S, STARTED_S, VirtualRig
from telenano.wire.errors import RigError
from telenano.wire.nodes import DEVICES, HAND, TIP

SOURCES = {"haptic/state": HAND, "afm/state": TIP, "teleop/backward": "controller@slave"}
POSITION_SCALE = 1.5e-6
# within which a hand counts as at rest
REST_M = 1e-3
# The hand goes elsewhere while it is let go of, and stays there [s, m].
PATH = [(0.0, 0.0), (0.12, 0.0), (0.16, -0.0035)]
STALLED_S, STALL_S, PARTED_S = STARTED_S + 0.03, 0.2, STARTED_S + 0.35
NODES = ("haptic_node@master", "controller@master", "controller@slave", "afm_node@slave")


class VirtualConsole:
    """What `couple` asks of a rig, at one in virtual time."""

    def __init__(self, rig: VirtualRig, now_s: float) -> None:
        self.rig, self.now_s = rig, now_s
        self._seen = {topic: len(rig.received(topic, src)) for topic, src in SOURCES.items()}
        self.sent: list[str] = []

    def run(self, time_s: float) -> None:
        self.now_s += time_s
        self.rig.run_until(self.now_s)

    def look(self, duration_s: float) -> Iterator[Any]:
        self.run(duration_s)
        found = []
        for topic in TOPICS:
            known = self.rig.received(topic, SOURCES[topic])
            found += known[self._seen[topic] :]
            self._seen[topic] = len(known)
        return iter(sorted(found, key=lambda message: int(message.t_ns)))

    def send(self, command: Command, retry_s: float = 0.0) -> str:
        until_s = self.now_s + retry_s
        self.sent.append(command.name)
        while True:
            before = len(self.rig.received("session/event", TIP))
            newest_state = self.rig.received("afm/state", TIP)[-1]
            self.rig.command(command.name, command.target, newest_state, **dict(command.parameters))
            self.run(0.05)
            events = self.rig.received("session/event", TIP)[before:]
            answer = next(event for event in events if event.kind in ("ack", "refused"))
            if answer.kind == "ack":
                return str(answer.text)
            if self.now_s >= until_s:
                raise RigError(answer.text)


def newest(rig: VirtualRig) -> tuple[Any, Any]:
    return rig.received("haptic/state", HAND)[-1], rig.received("afm/state", TIP)[-1]


def off_m(rig: VirtualRig) -> float:
    """Return how far the base is from where the law sends it without an offset [m]."""
    hand, tip = newest(rig)
    return float(POSITION_SCALE * hand.reference_m[2] - tip.base_position_m[2])


def parted(law: str, folder: Path | None) -> VirtualRig:
    """Return a rig whose hand went elsewhere while its half of the law stood still."""
    scenario: dict[str, Any] = {
        "name": "couple",
        "description": "a stall parts hand and tip",
        "duration_s": 60.0,
        "haptic_node": {
            "driver": "simulated_impedance",
            "coupling": {"rest_s": 0.05},
            "operator": {
                "kind": "impedance",
                "arm": "ordinary",
                "path": [{"time_s": at_s, "position_m": place_m} for at_s, place_m in PATH],
            },
        },
        "controller": {"law": law},
        "afm_node": {"rest_distance_m": 10e-9},
    }
    rig = VirtualRig(folder, 1, (), scenario=scenario)
    rig.run_until(ARMED_S)
    rig.command("arm", "*", place="hand")
    rig.run_until(STARTED_S)
    rig.command("start", "*")
    rig.run_until(STALLED_S)
    rig.stall("controller@master", STALL_S)
    rig.run_until(PARTED_S)
    return rig


LAWS = ("virtual_impedance", "position_force", "wave", "passivity", "model_mediated", "smith")


@pytest.mark.check("takes 2 s")
@pytest.mark.parametrize(
    "law", [law if law == "passivity" else pytest.param(law, marks=pytest.mark.endurance) for law in LAWS]
)
def test_what_a_stall_has_left_between_hand_and_tip_is_gone_without_a_jump(law: str, tmp_path: Path) -> None:
    rig = parted(law, tmp_path)
    hand, tip = newest(rig)
    assert (hand.mode, tip.mode) == ("position", "follow")
    assert abs(off_m(rig)) > 3e-9
    hands, tips = (len(rig.received(topic, src)) for topic, src in (("haptic/state", HAND), ("afm/state", TIP)))
    console = VirtualConsole(rig, PARTED_S)
    text = couple(console)
    assert text.startswith("hand and tip are coupled again: the tip went from ")
    assert console.sent == ["stop", "arm"]
    hand, tip = newest(rig)
    assert (hand.mode, tip.mode) == ("position", "follow")
    # What a hand at rest may move before it is coupled stays between the two; a line of waves has F dt / b besides.
    assert abs(off_m(rig)) < POSITION_SCALE * REST_M + (5e-10 if law == "wave" else 0.0)
    # The base goes no faster than its guard lets it, and the hand is let go of and taken up without a push.
    went = rig.received("afm/state", TIP)[tips - 1 :]
    for before, after in pairwise(went):
        way_m = abs(after.base_position_m[2] - before.base_position_m[2])
        assert way_m <= 2e-6 * (after.t_ns - before.t_ns) * 1e-9 + 4.1e-9
    pushed = [abs(state.motor_force_n[2]) for state in rig.received("haptic/state", HAND)[hands - 1 :]]
    assert max(pushed) < 0.5
    modes = {state.mode for state in went}
    assert modes == {"follow", "retracting", "retracted"}
    recording = Recording(rig.finish())
    for node in NODES:
        assert rerun(recording, node).identical, node


@pytest.mark.endurance
def test_hand_that_presses_is_not_let_go_of_and_an_emergency_stop_stays_latched() -> None:
    rig = VirtualRig(None, 1)
    console = VirtualConsole(rig, 0.0)
    console.run(ARMED_S)
    rig.command("arm", "*", place="hand")
    console.run(STARTED_S - ARMED_S)
    rig.command("start", "*")
    console.run(0.6)
    with pytest.raises(RigError, match=r"nothing has moved: the (tip touches the sample|hand presses with)"):
        couple(console)
    assert console.sent == []
    for device in DEVICES:
        rig.command("estop", device)
    console.run(0.2)
    with pytest.raises(RigError, match="nothing has moved: a device is in emergency stop"):
        couple(console)
    assert newest(rig)[1].mode == "estop" and console.sent == []
    rig.close()
