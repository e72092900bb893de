"""Each fault of a device that takes a force in a running rig: hand without force, tip held and withdrawn, one event."""

import itertools
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import library_doubles
import pytest
from live_devices import LiveDevice
from stack_rig import Rig
from test_impedance_devices import servos

NONE_N = (0.0, 0.0, 0.0)
# An arm that means to be there presses the tip onto the sample; at first it is where there is none.
PRESSING_M, AWAY_M, BEHIND_M = 0.012, 0.0, -0.004
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


class Fault(NamedTuple):
    """How a fault comes and goes, and what one event says of it; `|` divides words of the devices."""

    begin: Callable[[Session], None]
    end: Callable[[Session], None]
    text: str
    devices: tuple[str, ...] = ("haply", "dhd", "hd")


def order(what: str, value: float) -> Callable[[Session], None]:
    return lambda session: session.device.do(what, value)


def freeze(session: Session) -> None:
    """Freeze the reading of a hand that moves in the air: the law's reference catches up with it, and its force goes.

    On the sample nothing changes, and a reading that stands still is that of a hand which does.
    """
    session.device.do("hand_m", BEHIND_M)
    session.rig.wait_until(lambda: session.newest()[0].position_m[2] > -0.9 * BEHIND_M, "a hand in the air", PATIENCE_S)
    session.device.do("loose")
    session.device.do("push_n", 1.5)
    time.sleep(0.25)
    session.device.do("frozen", 1.0)


def turn_round(session: Session) -> None:
    """Let the motors act the other way under a hand that pushes with a constant force."""
    session.device.do("hand_m", AWAY_M)
    session.device.do("loose")
    session.device.do("push_n", 1.0)
    session.device.do("sign", -1.0)


def kill_servo(session: Session) -> None:
    (servo,) = servos(session.rig)
    os.kill(servo, signal.SIGKILL)


FAULTS = {
    "pulled device": Fault(
        order("unplugged", 1.0),
        order("unplugged", 0.0),
        "is gone: plug it in|: communication error|Frame failed: Communication error",
    ),
    "no number": Fault(order("not_a_number", 1.0), order("not_a_number", 0.0), "was not a finite number"),
    "jump of 10 mm": Fault(order("offset_m", 0.01), order("offset_m", 0.0), "its position jumped"),
    "frozen reading": Fault(freeze, order("frozen", 0.0), "stood still while the force on it changed"),
    "wrong sign": Fault(turn_round, order("sign", 1.0), "it ran against its force"),
    "late by 100 ms": Fault(
        order("latency_s", 0.1),
        order("latency_s", 0.0),
        "it has sent no sample within the deadline|is silent: the device counts as lost|switched off by its watchdog"
        "|the service has been silent for 0.05 s",
    ),
    "lost calibration": Fault(order("uncalibrated", 1.0), order("uncalibrated", 0.0), "is not calibrated: put its"),
    "killed service": Fault(
        lambda session: session.device.kill(),
        lambda session: session.device.start(),
        "the service has closed the connection",
        ("haply",),
    ),
    "silent scheduler": Fault(
        order("stopped", 1.0), order("stopped", 0.0), "its scheduler calls no more (none for 0.05 s)", ("hd",)
    ),
    "killed servo": Fault(kill_servo, lambda session: None, "the process of the servo has ended with code -9"),
}


def shows(session: Session, name: str) -> None:
    """Put a fault into a rig that presses, look at hand, tip and events, and go on."""
    fault = FAULTS[name]
    session.take_up()
    since_ns = time.time_ns()
    fault.begin(session)
    session.rig.wait_until(lambda: name == "killed servo" or session.is_safe(), f"{name}: hand and tip", PATIENCE_S)
    mended_ns = time.time_ns()
    time.sleep(SILENT_S)
    fault.end(session)
    hands, tips = session.said("haptic/state", since_ns), session.said("afm/state", since_ns)
    assert {hand.motor_force_n for hand in hands if hand.device == "lost" and hand.mode == "off"} == {NONE_N}
    modes = [mode for mode, _ in itertools.groupby(tip.mode for tip in tips)]
    # A machine that was held up may have let the tip hold and go on once more before it.
    assert modes[-3:] == ["hold", "retracting", "retracted"] and modes[0] in ("follow", "hold"), modes
    held = [tip.base_position_m[2] for tip in tips if tip.mode == "hold"]
    assert len(set(held[-100:])) == 1
    if name != "killed servo":
        late = [hand for hand in hands if hand.t_ns > mended_ns - 100_000_000]
        assert {hand.motor_force_n for hand in late} == {NONE_N}
    texts = [event.text for event in session.said("session/event", since_ns)]
    found = {part: sum(part in text for text in texts) for part in fault.text.split("|")}
    assert any(found.values()) and max(found.values()) == 1, (name, texts)


@library_doubles.needs_cc
@pytest.mark.parametrize("kind", ["dhd"])
def test_device_that_is_pulled_leaves_the_hand_without_force_and_the_tip_away(
    kind: str, rig: Rig, tmp_path: Path
) -> None:
    with LiveDevice(kind, tmp_path) as device:
        session = Session(rig, device)
        shows(session, "pulled device")
        code, _, err = rig.stop()
    assert code == 0, err + rig.logs()


@pytest.mark.endurance
@library_doubles.needs_cc
@pytest.mark.parametrize("kind", ["haply", "dhd", "hd"])
def test_each_fault_leaves_the_hand_without_force_and_the_tip_away_with_one_event(
    kind: str, rig: Rig, tmp_path: Path
) -> None:
    with LiveDevice(kind, tmp_path) as device:
        session = Session(rig, device)
        for name, fault in FAULTS.items():
            if kind in fault.devices:
                shows(session, name)
        session.take_up()
        code, _, err = rig.stop()
    assert code == 0, err + rig.logs()
    assert servos(rig) == []
