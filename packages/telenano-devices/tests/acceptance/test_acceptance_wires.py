"""Acceptance over the wire of each driver, in virtual time: a good device passes, and each check finds its fault.

The servo of the driver runs with its emulated device and a simulated person at it; `record_take` plays the node.
"""

import itertools
import math
import shutil
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

if shutil.which("cc") is None:
    pytest.skip("the doubles of vendors' libraries need a C compiler: apt install gcc", allow_module_level=True)

from telenano_devices.acceptance.haptic_device.checks import HAPTIC_DEVICE
from telenano_devices.acceptance.haptic_device.person import person, reach_of
from telenano_devices.acceptance.haptic_device.take import Facts, record_take, steps_of
from telenano_devices.acceptance.take import Clock, Take, Verdict, overall
from telenano_devices.doubles.live_devices import write_hand
from telenano_devices.doubles.servo_bench import DEVICES, EmulatedDevice, VirtualTime
from telenano_devices.impedance.coupling import Vector
from telenano_devices.impedance.emulated_arm import HandMotion
from telenano_devices.impedance.impedance_config import CouplingConfig
from telenano_devices.impedance.impedance_wire import Turn
from telenano_devices.impedance.servo import DeviceSample, ServoCommand, ServoSample
from telenano_devices.impedance.servo_process import ServoLoop, SharedServo

from telenano.extend.hands import Capabilities, Quaternion

PACE, MASS_KG = 0.15, 0.05
STEPS = steps_of(MASS_KG, PACE)
DEADMAN: dict[str, Any] = {"haply": {"deadman": "a"}, "dhd": {"deadman_button": 0}, "hd": {"deadman_button": 0}}


def begins_s(name: str) -> float:
    """Return when a step of the take begins [s]."""
    return sum(step.seconds for step in itertools.takewhile(lambda step: step.name != name, STEPS))


class Wrong:
    """What is wrong with the readings of a device, between its wire and the servo, and with what the node hears."""

    axes: tuple[int, int, int] = (0, 1, 2)
    signs: Vector = (1.0, 1.0, 1.0)
    scale = 1.0
    drift_m_per_s = noise_m = step_m = 0.0
    hold_s = late_s = 0.0
    # so much longer takes one call in so many
    stall_s, every = 0.0, 1
    nan_at_s = jump_at_s = math.inf
    # a cable that is out and not told, or a reading that stands still
    frozen_s = gap_s = (math.inf, math.inf)
    reported_force = 1.0
    quaternion: Quaternion | None = None
    dead_buttons = 0
    deadman_is_ignored = False

    def __init__(self, changes: Mapping[str, Any]) -> None:
        for name, value in changes.items():
            assert hasattr(self, name), name
            setattr(self, name, value)
        self._old: list[DeviceSample] = []
        self._kept: DeviceSample | None = None
        self._kept_ns = self.count = 0

    def reading(self, sample: DeviceSample, time_s: float) -> DeviceSample:
        """Return what the servo hears in the place of a sample."""
        self.count += 1
        kept = self._kept
        if kept is not None:
            since_s = (sample.taken_ns - self._kept_ns) * 1e-9
            if since_s < self.hold_s or self.frozen_s[0] <= time_s < self.frozen_s[1]:
                return kept._replace(taken_ns=sample.taken_ns, deadman_ns=sample.deadman_ns)
        x, y, z = (
            self.scale * sign * sample.position_m[axis] for axis, sign in zip(self.axes, self.signs, strict=True)
        )
        x += self.drift_m_per_s * time_s + self.noise_m * math.sin(1.9 * self.count**2)
        z += 0.01 * (time_s >= self.jump_at_s)
        if self.step_m:
            x, y, z = (self.step_m * round(value / self.step_m) for value in (x, y, z))
        if self.nan_at_s <= time_s < self.nan_at_s + 5e-3:
            z = math.nan
        found = sample._replace(position_m=(x, y, z), buttons=sample.buttons & ~self.dead_buttons)
        self._kept = found = found._replace(orientation=self.quaternion or found.orientation)
        self._kept_ns = sample.taken_ns
        self._old.append(found)
        while len(self._old) > 1 and self._old[1].taken_ns <= sample.taken_ns - self.late_s * 1e9:
            self._old.pop(0)
        return self._old[0]


class TakeBench:
    """The servo of a device in virtual time with `record_take` as its node, each waiting for the other."""

    def __init__(self, kind: str, folder: Path, orders: Mapping[str, float], wrong: Wrong, told: bool = True) -> None:
        self.time, self.wrong = VirtualTime(), wrong
        self.device = EmulatedDevice(kind, self.time, folder, **DEADMAN[kind])
        self.wire, self._turn = self.device.wire, lambda sample: (0.0, 0.0, 0.0)
        self.capabilities: Capabilities = self.wire.open()
        hand = person(reach_of(self.capabilities), len(self.capabilities.buttons), 1, STEPS, MASS_KG)
        self._give(kind, folder, hand if told else lambda time_s: hand(time_s)._replace(plugged=True))
        for name, value in orders.items():
            self.device.do(name, value)
        self.shared = SharedServo(bytearray(SharedServo.SIZE))
        self.shared.flag(True, False)
        self._to_node, self._to_servo = threading.Semaphore(0), threading.Semaphore(0)
        self._began_ns = self._due_ns = self.time.ns
        self._ended = False
        self.coupling = CouplingConfig()
        self._last: ServoSample | None = None

    def _give(self, kind: str, folder: Path, hand: Callable[[float], HandMotion]) -> None:
        if kind == "haply":
            self.device.service.arm.person, self.device.service.has_person = hand, True
        else:
            path = folder / "hand"
            write_hand(path, kind, hand, sum(step.seconds for step in STEPS))
            self.device.double.hand(path)

    @property
    def s(self) -> float:
        return (self.time.ns - self._began_ns) * 1e-9

    # what a servo asks of its wire

    def open(self) -> Capabilities:
        return self.wire.open()

    def run(self, turn: Turn) -> None:
        def told(sample: DeviceSample) -> Vector | None:
            if self.wrong.stall_s and self.wrong.count % self.wrong.every == 0:
                self.time.ns += round(self.wrong.stall_s * 1e9)
                if self.device.kind != "haply":
                    self.device.double.set("virtual_s", self.time.s)
            return turn(self.wrong.reading(sample, self.s))

        self.wire.run(told)

    def session(self, runs: bool) -> None:
        self.wire.session(runs)

    def close(self) -> None:
        self.wire.close()

    # what `record_take` asks of its link

    def send(self, command: ServoCommand) -> None:
        if self.wrong.deadman_is_ignored:
            command = command._replace(settings=command.settings._replace(needs_deadman=False))
        self.shared.write_command(command)

    def newest(self, session_time_s: float, dt_s: float) -> ServoSample | None:
        found = self.shared.sample()
        if found is not None and not self.wrong.gap_s[0] <= self.s < self.wrong.gap_s[1]:
            factor = self.wrong.reported_force
            x, y, z = found.force_n
            self._last = found._replace(force_n=(factor * x, factor * y, factor * z))
        return self._last

    def take(self) -> Take[Facts]:
        """Run servo and take to the end of the take."""
        taken: list[Take[Facts]] = []
        node = threading.Thread(target=lambda: taken.append(self._record()))
        node.start()
        self._to_servo.acquire()
        loop = ServoLoop(
            self.shared,
            self,
            self.capabilities,
            now_ns=self.time.now_ns,
            sleep=self.time.sleep,
            is_needed=self._is_needed,
        )
        loop.run()
        node.join()
        return taken[0]

    def _record(self) -> Take[Facts]:
        settings = self.coupling.to_settings(self.capabilities)
        facts = Facts(self.capabilities, settings, MASS_KG, "foot switch")
        try:
            return record_take(self, facts, STEPS, Clock(self.time.now_ns, self._wait))  # type: ignore[arg-type]
        finally:
            self._ended = True
            self._to_servo.release()

    def _wait(self, deadline_ns: int) -> None:
        self._due_ns = deadline_ns
        self._to_servo.release()
        self._to_node.acquire()

    def _is_needed(self) -> bool:
        while not self._ended and self.time.ns >= self._due_ns:
            self._to_node.release()
            self._to_servo.acquire()
        return not self._ended


def found_by(
    kind: str,
    folder: Path,
    orders: Mapping[str, float],
    wrong: Mapping[str, Any],
    told: bool = True,
    stiffness: float | None = None,
) -> dict[str, Verdict]:
    bench = TakeBench(kind, folder, orders, Wrong(wrong), told)
    bench.coupling = CouplingConfig(stiffness_n_per_m=stiffness)
    take = bench.take()
    return {verdict.check: verdict for verdict in HAPTIC_DEVICE.judge(take)}


# what each check has to find: what is done to the emulated device, and to its readings
FAULTS: dict[str, tuple[Mapping[str, float], Mapping[str, Any]]] = {
    "finite positions": ({}, {"nan_at_s": begins_s("slow") + 0.5}),
    "rate": ({}, {"stall_s": 2e-3}),
    "jitter": ({}, {"stall_s": 3e-3, "every": 20}),
    "age of samples": ({}, {"late_s": 0.02}),
    "gaps": ({}, {"gap_s": (begins_s("fast") + 0.3, begins_s("fast") + 0.4)}),
    "fresh positions": ({}, {"hold_s": 0.02}),
    "no jumps": ({}, {"jump_at_s": begins_s("slow") + 0.5}),
    "no frozen readings": ({}, {"frozen_s": (begins_s("hold") + 0.6, math.inf)}),
    "noise at rest": ({}, {"noise_m": 2e-4}),
    "drift at rest": ({}, {"drift_m_per_s": 1e-3}),
    "resolution": ({}, {"step_m": 5e-4}),
    "scale of positions": ({}, {"scale": 1.5}),
    "sign of x": ({}, {"signs": (-1.0, 1.0, 1.0)}),
    "sign of y": ({}, {"axes": (0, 2, 1)}),
    "sign of z": ({}, {"signs": (1.0, 1.0, -1.0)}),
    "sign of forces": ({"sign": -1.0}, {}),
    "scale of forces": ({"sign": 0.5}, {}),
    "rendering stiffness": ({"drive_delay_s": math.nan}, {}),
    "limits of force": ({}, {"reported_force": 3.0}),
    "buttons": ({}, {"dead_buttons": 4}),
    "dead-man": ({}, {"deadman_is_ignored": True}),
    "cable loss": (
        {},
        {"frozen_s": (begins_s("cable") + 0.3 * STEPS[-1].seconds, begins_s("cable") + 0.7 * STEPS[-1].seconds)},
    ),
    "orientation": ({}, {"quaternion": (1.0, 1.0, 0.0, 0.0)}),
}
# With this delay of the drive [s], and this stiffness [N/m] of the coupling, it swings under the person's hand.
SWINGS: dict[str, tuple[float, float | None]] = {"haply": (0.04, None), "dhd": (0.009, None), "hd": (0.02, 1000.0)}
# A device of these doubles has no wrist.
WITHOUT = {("orientation", "dhd")}


@pytest.mark.parametrize("kind", ["hd", *(pytest.param(kind, marks=pytest.mark.endurance) for kind in DEVICES[:2])])
def test_good_device_passes_over_its_wire(kind: str, tmp_path: Path) -> None:
    verdicts = found_by(kind, tmp_path, {}, {})
    others = [verdict for verdict in verdicts.values() if verdict.result != "pass"]
    assert [verdict.check for verdict in others] == (["orientation"] if kind == "dhd" else []), others
    assert overall(list(verdicts.values())) == "pass"
    assert set(FAULTS) | {"workspace", "independent stop"} == set(verdicts)


@pytest.mark.endurance
@pytest.mark.parametrize("kind", DEVICES)
@pytest.mark.parametrize("name", FAULTS)
def test_each_check_finds_the_fault_that_is_put_in_over_each_wire(name: str, kind: str, tmp_path: Path) -> None:
    if (name, kind) in WITHOUT:
        pytest.skip("the emulated device has no wrist, so the check cannot say")
    orders, wrong = FAULTS[name]
    stiffness = None
    if "drive_delay_s" in orders:
        delay_s, stiffness = SWINGS[kind]
        orders = {"drive_delay_s": delay_s}
    verdicts = found_by(kind, tmp_path, orders, wrong, told=name != "cable loss", stiffness=stiffness)
    assert verdicts[name].result == "fail", verdicts[name]
    assert overall(list(verdicts.values())) == "fail"
