"""A device that takes a force is pulled in a running rig: hand without force, tip held and withdrawn, one event.

The other faults are at the servo in virtual time (`test_impedance_faults.py` of telenano-devices).
"""

import itertools
import time
from pathlib import Path
from typing import Any

import pytest
from stack_rig import Rig
from telenano_devices.doubles import libraries
from telenano_devices.doubles.live_devices import LiveDevice

NONE_N = (0.0, 0.0, 0.0)
# An arm that means to be there presses the tip onto the sample; at first it is where there is none.
PRESSING_M, AWAY_M = 0.012, 0.0
# a law's second of silence, and what a device takes to be found again
SILENT_S = 1.2
PRESSES_S, PATIENCE_S = 6.0, 30.0


class Session:
    """A rig whose hand is at an emulated device of a kind."""

    def __init__(self, rig: Rig, device: LiveDevice) -> None:
        self.rig, self.device = rig, device
        rig.environment.update(device.environment)
        rig.start(*device.options, "--duration", "600", "--headless")
        rig.wait_until(rig.running, "the session")

    def said(self, topic: str, since_ns: int) -> list[Any]:
        return [message.decode() for message in self.rig.recording().messages(topic, since_ns)]

    def newest(self) -> tuple[Any, Any]:
        """Return the newest states of hand and tip."""
        recorded, since_ns = self.rig.recording(), time.time_ns() - 10**10
        hand, tip = (recorded.messages(topic, since_ns)[-1].decode() for topic in ("haptic/state", "afm/state"))
        return hand, tip

    def follows(self) -> bool:
        hand, tip = self.newest()
        return (hand.mode, hand.device, tip.mode) == ("position", "ok", "follow")

    def presses(self) -> bool:
        hand, tip = self.newest()
        return self.follows() and -hand.operator_force_n[2] > 0.3 and tip.in_contact

    def is_safe(self) -> bool:
        hand, tip = self.newest()
        return (hand.mode, hand.device, hand.motor_force_n, tip.mode) == ("off", "lost", NONE_N, "retracted")

    def take_up(self) -> None:
        """Couple hand and tip in the air and press, as a person does: anew where the machine held the rig up."""
        said: list[str] = []
        for _ in range(6):
            self.device.do("hand_m", AWAY_M)
            self.rig.telenano("session", "arm", "--target", "haptic_node")
            done = self.rig.telenano("session", "couple")
            said.append(done.stdout + done.stderr)
            if done.returncode:
                time.sleep(0.5)
                continue
            self.device.do("hand_m", PRESSING_M)
            end_s = time.monotonic() + PRESSES_S
            while time.monotonic() < end_s:
                if self.presses():
                    return
                time.sleep(0.1)
        raise AssertionError(f"the hand did not come to the sample: {said}, {self.newest()}\n{self.rig.logs()}")


@pytest.mark.drawn(0.0, "packages/telenano-devices/telenano_devices/", "telenano/hand/", "services/haptic_node/")
@pytest.mark.skipif(**libraries.WITHOUT_CC)
def test_device_that_is_pulled_leaves_the_hand_without_force_and_the_tip_away(rig: Rig, tmp_path: Path) -> None:
    with LiveDevice("dhd", tmp_path) as device:
        session = Session(rig, device)
        session.take_up()
        since_ns = time.time_ns()
        device.do("unplugged", 1.0)
        rig.wait_until(session.is_safe, "hand and tip", PATIENCE_S)
        safe_ns = time.time_ns()
        time.sleep(SILENT_S)
        device.do("unplugged", 0.0)
        hands, tips = session.said("haptic/state", since_ns), session.said("afm/state", since_ns)
        assert {hand.motor_force_n for hand in hands if hand.device == "lost" and hand.mode == "off"} == {NONE_N}
        assert {hand.motor_force_n for hand in hands if hand.t_ns > safe_ns - 100_000_000} == {NONE_N}
        modes = [mode for mode, _ in itertools.groupby(tip.mode for tip in tips)]
        # A machine that was held up may have let the tip hold and go on once more before it.
        assert modes[-3:] == ["hold", "retracting", "retracted"] and modes[0] in ("follow", "hold"), modes
        held = [tip.base_position_m[2] for tip in tips if tip.mode == "hold"]
        assert len(set(held[-100:])) == 1
        texts = [event.text for event in session.said("session/event", since_ns)]
        assert sum("communication error" in text for text in texts) == 1, texts
        code, _, err = rig.stop()
    assert code == 0, err + rig.logs()
