"""The memory of the haptic node, the data of a tick, and the parts that act before and after guard and device."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import msgspec

from telenano.extend.hands import (
    MODE_OFF,
    Capabilities,
    DeviceReading,
    Gate,
    HapticDevice,
    HapticReport,
    Pair,
    SpatialCommand,
    SpatialReading,
)
from telenano.hand import safety
from telenano.hand.lateral_hand import LateralHandParams, LateralHandState, lateral_hand_step
from telenano.hand.sim import SimulatedHaptic
from telenano.runtime.loop.device_node import StepPart
from telenano.sections.hand_section import HapticConfig
from telenano.sections.operator_section import InteractiveConfig
from telenano.timing.freshness import age_s
from telenano.wire.messages import HapticCommand

# Position [m], velocity [m/s], own force and displayed force [N] of the hand across the sample, (x, y) each.
Across = tuple[Pair, Pair, Pair, Pair]
_ZERO: Pair = (0.0, 0.0)
_NO_SIDE = SpatialCommand()


class HapticMemory(msgspec.Struct, array_like=True):
    """Values that the node keeps from tick to tick.

    guard, position_m: state of the guard, and position of the arm at the last tick [m]; command, command_received_ns:
    the command in force, and its time of reception [ns]; operator_force_n, operator_force_ns: force of an operator
    without a device [N], and its time of reception [ns]; pushed_n: force that the simulated hand holds [N];
    estop_requested, arm_requested: requests since the last tick; session_ticks: ticks since the session began, None
    before; gate: the `Gate` of an impedance device; let_go_ticks: ticks left without force after a change of law;
    operator_across_n: force of that operator across the sample [N]; across: the simulated hand there.
    """

    guard: safety.SafetyState
    position_m: float
    command: HapticCommand | None = None
    command_received_ns: int = 0
    operator_force_n: float = 0.0
    operator_force_ns: int = 0
    pushed_n: float = 0.0
    estop_requested: bool = False
    arm_requested: bool = False
    session_ticks: int | None = None
    gate: int = int(Gate.ACTIVE)
    let_go_ticks: int = 0
    operator_across_n: tuple[float, float] = (0.0, 0.0)
    across: LateralHandState = LateralHandState()


@dataclass(slots=True)
class Tick:
    """One tick: the command, the guarded command, and the reading of the device after it.

    armed: whether a person has armed since the previous tick. elapsed_s, session_s: time since that tick, and time of
    the force profile [s]. shown_n, pushed_n: forces across the sample, of the controller and of an operator without a
    device [N]. added_fields: keys of haptic/state that the parts add.
    """

    command: HapticCommand
    applied: safety.SafetyOutputs
    armed: bool
    elapsed_s: float
    session_s: float
    pushed_n: Pair = _ZERO
    spatial: SpatialCommand = _NO_SIDE
    reading: DeviceReading = field(init=False)
    across: Across = (_ZERO, _ZERO, _ZERO, _ZERO)
    added_fields: dict[str, Any] = field(default_factory=dict)

    @property
    def shown_n(self) -> Pair:
        return _ZERO if self.applied.mode == MODE_OFF else self.command.force_n[:2]


TickPart = StepPart[Tick, HapticMemory]


class RealHandle(TickPart):
    """Publishes and processes the reports of a real device."""

    def __init__(self, device: HapticDevice, process_report: Callable[[HapticReport], None]) -> None:
        self._device, self._process_report = device, process_report

    def measure(self, tick: Tick, memory: HapticMemory) -> None:
        self._report = report = cast(HapticReport, self._device.report)
        tick.added_fields.update({"device": report.status, "sample_age_s": report.age_s, **report.counts})

    def report(self, tick: Tick, memory: HapticMemory) -> None:
        self._process_report(self._report)


class PushedHand(TickPart):
    """Applies the newest force of an operator without a device to a simulated hand, or 0 if it is too old."""

    def __init__(self, device: HapticDevice, deadline_s: float, now_ns: Callable[[], int]) -> None:
        self._deadline_s, self._now_ns = deadline_s, now_ns
        self._hands = [device] if isinstance(device, SimulatedHaptic) else []

    def prepare(self, tick: Tick, memory: HapticMemory) -> None:
        # The age counts from the reception, because page and rig may run on different clocks.
        is_fresh = age_s(self._now_ns(), memory.operator_force_ns) <= self._deadline_s
        force_n, tick.pushed_n = (memory.operator_force_n, memory.operator_across_n) if is_fresh else (0.0, _ZERO)
        for hand in self._hands:
            if force_n != memory.pushed_n:
                memory.pushed_n = force_n
                hand.push(force_n)
            hand.push_lateral(tick.pushed_n)


class SpatialDevice(TickPart):
    """Adds the commands and readings that only devices of impedance type or with three axes have."""

    def __init__(self, able: Capabilities) -> None:
        self._has_orientation, self._has_buttons = able.has_orientation, bool(able.buttons)

    def prepare(self, tick: Tick, memory: HapticMemory) -> None:
        is_off = tick.applied.mode == MODE_OFF
        tick.spatial = SpatialCommand(_ZERO if is_off else tick.command.position_m[:2], tick.shown_n, tick.armed)

    def measure(self, tick: Tick, memory: HapticMemory) -> None:
        spatial = tick.reading.spatial or SpatialReading()
        memory.gate = spatial.gate
        tick.across = spatial[:4]
        tick.added_fields.update(hand_energy_j=spatial.hand_energy_j, coupling_energy_j=spatial.coupling_energy_j)
        if self._has_orientation:
            tick.added_fields["orientation"] = spatial.orientation
        if self._has_buttons:
            tick.added_fields["buttons"] = spatial.buttons
        if Gate(memory.gate).is_fault:
            # A reading that is invalid until a person arms is no hand to follow, simulated or not.
            tick.added_fields["device"] = "lost"


class LateralHand(TickPart):
    """Advances the simulated hand across the sample; the force of the controller acts on it while the guard permits."""

    def __init__(self, params: LateralHandParams) -> None:
        self._params = params

    def measure(self, tick: Tick, memory: HapticMemory) -> None:
        forces = tick.pushed_n, tick.shown_n
        memory.across = lateral_hand_step(self._params, memory.across, *forces, tick.session_s, tick.elapsed_s)
        x, y, v_x, v_y, own_x, own_y, shown_x, shown_y = memory.across
        tick.across = (x, y), (v_x, v_y), (own_x, own_y), (shown_x, shown_y)


def parts_of(node: Any, config: HapticConfig, device: HapticDevice) -> list[TickPart]:
    """Return the parts of a node with an open device, in the order in which they act."""
    parts: list[TickPart] = []
    able, operator = device.capabilities, config.operator
    if isinstance(operator, InteractiveConfig):
        parts.append(PushedHand(device, operator.force_deadline_s, node.clock.now_ns))
    if device.report is not None:
        parts.append(RealHandle(device, node.process_haptic_report))
    if able.kind == "impedance" or able.axes == 3:
        parts.append(SpatialDevice(able))
    elif config.lateral is not None:
        parts.append(LateralHand(config.lateral.to_params()))
    return parts
