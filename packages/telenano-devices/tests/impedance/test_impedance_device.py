"""A device behind its servo, as the node sees it: statuses, one event a fault, and what a session then does."""

from collections.abc import Callable
from typing import Any, NamedTuple

import msgspec
import pytest
from telenano_devices.acceptance.haptic_device.simulated_link import DeviceFaults, SimulatedLink
from telenano_devices.impedance.coupling import ZERO, CouplingSettings
from telenano_devices.impedance.emulated_arm import HandMotion
from telenano_devices.impedance.impedance_config import MODELS, CouplingConfig, SimulatedImpedanceConfig
from telenano_devices.impedance.impedance_device import ImpedanceDevice
from telenano_devices.impedance.servo import ServoCommand, ServoSample, Slot

from telenano.extend.hands import MODE_FORCE, MODE_POSITION, Capabilities, DeviceError, DriveCommand
from telenano.sections import HapticConfig
from telenano.testing import handed_over, haptic_device_of, haptic_node

MS = 1e-3
MASTER = "controller@master"
CONFIG = HapticConfig.model_validate(
    {"driver": "simulated_impedance", "limits": {"position_min_m": -0.05, "position_max_m": 0.05}}
)


class Line:
    """A node with a device behind its servo, in the device's virtual time; a hand that holds it where it is."""

    def __init__(self, bench: Any, faults: DeviceFaults | None = None, **able: Any) -> None:
        declared = SimulatedImpedanceConfig().capabilities()._replace(**able)
        self.plugged, self.buttons, self.place = True, 0, (0.0, 0.0, -0.004)
        self.link = SimulatedLink(declared, self._motion, faults or DeviceFaults())
        self.device = ImpedanceDevice(self.link, CouplingConfig(rest_s=0.05), MS, self.link.now_ns)
        self.bench = bench
        self.node = haptic_node(bench, self.device, CONFIG)
        self.reference_m = 0.0

    def _motion(self, time_s: float) -> HandMotion:
        return HandMotion(self.place, 300.0, 5.0, ZERO, self.buttons, self.plugged)

    def run(self, ticks: int) -> Any:
        """Send a command each period and let the node take its turn; return the last state."""
        for _ in range(ticks):
            command = {"mode": "position", "position_m": (0.0, 0.0, -self.reference_m), "velocity_m_per_s": (0.0,) * 3}
            hand = {"hand_seq": 1, "hand_t_ns": self.bench.clock.now_ns(), "force_n": (0.2, 0.0, 0.0)}
            self.node.on_message(self.bench.received("haptic/command", MASTER, **command, **hand))
            self.bench.advance_ms(1)
            self.node.on_deadline(self.bench.clock.monotonic_ns())
        return self.bench.take("haptic/state")[-1]

    def events(self) -> list[str]:
        return [event.text for event in self.bench.take("session/event")]


@pytest.fixture
def line(bench_of: Any) -> Line:
    return Line(bench_of("haptic_node@master"), buttons=("a", "b"), has_orientation=True)


def test_hand_is_driven_once_it_has_rested_and_the_state_has_three_axes(line: Line) -> None:
    assert line.run(20).mode == "off"
    said = line.events()
    assert "stable up to" in said[0] and "the device gives no force until the hand has been at rest" in said
    line.buttons = 2
    state = line.run(600)
    assert state.mode == "position" and state.device == "ok"
    stiffness = line.device._settings.stiffness_n_per_m[2]
    # the hand means to be 4 mm beyond the reference: two springs
    depth_m = 0.004 * 300.0 / (300.0 + stiffness)
    assert -state.position_m[2] == pytest.approx(depth_m, rel=0.02, abs=0.0)
    assert state.motor_force_n[2] == pytest.approx(stiffness * depth_m, rel=0.02, abs=0.0)
    assert state.operator_force_n == tuple(-force for force in state.motor_force_n)
    # the lateral force of the sample is felt as such
    assert state.motor_force_n[0] == pytest.approx(0.2, rel=0.02) and state.position_m[0] == pytest.approx(
        0.2 / 300.0, rel=0.1
    )
    assert state.buttons == 2 and state.orientation == (1.0, 0.0, 0.0, 0.0)
    assert state.hand_energy_j is not None and state.coupling_energy_j > 0.0


def faulty(line: Line, **changes: Any) -> None:
    line.link._faults = line.link._faults._replace(**changes)


class Fault(NamedTuple):
    """What goes wrong at a device, what the event says, and whether it is refused until armed."""

    make: Callable[[Line], None]
    text: str
    refused: bool = False


FAULTS = {
    "cable": Fault(lambda line: setattr(line, "plugged", False), "the device has gone"),
    "late by 100 ms": Fault(lambda line: faulty(line, late_s=0.1, hold_s=0.0), "the servo of the device is silent"),
    "frozen": Fault(lambda line: faulty(line, frozen_at_s=0.0), "its position stood still while the force", True),
    "no number": Fault(lambda line: faulty(line, nan_at_s=line.link.time_s), "was not a finite number", True),
    "jump of 10 mm": Fault(lambda line: faulty(line, jump_at_s=0.0), "jumped", True),
    "wrong sign": Fault(lambda line: faulty(line, force_scale=-3.0), "ran against its force", True),
    "silent servo": Fault(lambda line: faulty(line, gap_at_s=0.0, gap_s=9.0), "the servo of the device is silent"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_fault_takes_the_force_and_is_one_event_in_words(line: Line, name: str) -> None:
    make, text, refused = FAULTS[name]
    assert line.run(600).mode == "position"
    line.events()
    make(line)
    for step in range(400):
        # The law goes on, so that the force would have changed.
        line.reference_m = -1e-5 * step
        state = line.run(1)
    assert state.mode == "off" and state.motor_force_n == (0.0, 0.0, 0.0)
    assert state.device == "lost"
    said = line.events()
    assert len([event for event in said if text in event]) == 1, said
    # what the guard says of a device that is not there is the other one
    assert len(said) == (1 if refused else 2), said


def test_cable_that_comes_back_needs_rest_and_a_jump_needs_arming(line: Line) -> None:
    line.run(600)
    line.plugged = False
    line.run(100)
    line.plugged = True
    assert line.run(20).mode == "off"
    assert line.run(200).mode == "position"
    faulty(line, jump_at_s=0.0)
    assert line.run(400).mode == "off"
    line.node._memory.arm_requested = True
    assert line.run(200).mode == "position"


def test_deadman_is_needed_where_a_device_has_one(bench_of: Any) -> None:
    line = Line(bench_of("haptic_node@master"), buttons=("a",), deadman="a")
    assert line.run(300).mode == "off"
    line.buttons = 1
    assert line.run(200).mode == "position"
    line.buttons = 0
    assert line.run(3).mode == "off"
    assert any("dead-man" in text for text in line.events())


def test_closed_device_and_a_mode_that_it_has_not_are_refused(line: Line) -> None:
    with pytest.raises(DeviceError, match="not one of this device's"):
        line.device.write(DriveCommand(MODE_FORCE, 0.0, 1.0))
    line.device.close()
    line.device.close()
    line.device.make_safe()
    with pytest.raises(DeviceError, match="open"):
        line.device.write(DriveCommand(MODE_POSITION, 0.0, 0.0))


def test_slot_gives_the_newest_whole_value_and_never_half_of_one() -> None:
    settings = CouplingConfig().to_settings(SimulatedImpedanceConfig().capabilities())
    command = ServoCommand(3, 5, (1.0, 2.0, 3.0), ZERO, ZERO, True, 1, False, settings)
    slot, sample = Slot(ServoCommand), Slot(ServoSample)
    memory = memoryview(bytearray(slot.size))
    assert slot.read(memory) is None
    slot.write(memory, command)
    assert slot.read(memory) == command
    memory[7] ^= 1
    assert slot.read(memory) == command
    slot.write(memory, command._replace(counter=4))
    assert slot.read(memory) == command._replace(counter=4)
    memory = memoryview(bytearray(sample.size))
    told = ServoSample(error="weg: " + "ü" * 200)
    sample.write(memory, told)
    found = sample.read(memory)
    assert found is not None and found.error.startswith("weg: ü") and isinstance(settings, CouplingSettings)


@pytest.mark.parametrize("model", MODELS)
def test_default_of_every_model_is_stable_with_its_margin_and_within_what_it_declares(model: Any) -> None:
    device: Capabilities = SimulatedImpedanceConfig(model=model).capabilities()
    bounds = CouplingConfig().bounds(device)
    assert bounds.verdict == "stable" and bounds.stiffness_n_per_m <= device.max_stiffness_n_per_m
    assert bounds.passive_n_per_m < bounds.stiffness_n_per_m <= bounds.stable_n_per_m / 4.0 * (1.0 + 1e-9)
    assert CouplingConfig(stiffness_n_per_m=0.9 * bounds.stable_n_per_m).bounds(device).verdict == "unproven"
    passive = CouplingConfig(stiffness_n_per_m=1.0, damping_n_s_per_m=0.0)
    assert passive.bounds(device).verdict == "passive"


def test_state_of_the_simulated_device_goes_on_from_what_was_kept(bench_of: Any) -> None:
    document = {"driver": "simulated_impedance", "operator": {"kind": "force_profile"}, "coupling": {"rest_s": 0.05}}
    config = HapticConfig.model_validate(document)

    def turn(bench: Any, node: Any, index: int) -> Any:
        command = {"mode": "position", "position_m": (0.0, 1e-3, -1e-5 * index), "velocity_m_per_s": (0.0,) * 3}
        hand = {"hand_seq": 1, "hand_t_ns": bench.clock.now_ns(), "force_n": (0.2, 0.0, 0.0)}
        node.on_message(bench.received("haptic/command", MASTER, **command, **hand))
        bench.advance_ms(1)
        node.on_deadline(bench.clock.monotonic_ns())
        return msgspec.structs.replace(bench.take("haptic/state")[-1], seq=0)

    first, other = bench_of("haptic_node@master"), bench_of("haptic_node@master")
    one = haptic_node(first, haptic_device_of(config), config)
    for index in range(300):
        state = turn(first, one, index)
        other.advance_ms(1)
    assert state.mode == "position" and state.motor_force_n[0] != 0.0
    two = handed_over(one, haptic_node(other, haptic_device_of(config), config))
    assert [turn(first, one, index) for index in range(300, 400)] == [
        turn(other, two, index) for index in range(300, 400)
    ]
