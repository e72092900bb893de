"""The haptic process: paces the rig, samples the operator's device and guards it."""

from typing import Any, ClassVar, NamedTuple

import msgspec

from proto.errors import RefusedError
from proto.messages import HapticCommand, LinkDelay, OperatorForce, SessionControl
from proto.nodes import is_meant
from services.haptic_node import safety
from services.haptic_node.config import HapticConfig, changed_operator
from services.haptic_node.coupling import FAULTS, GATE_ACTIVE, GATE_READY, GATE_REST, GATES
from services.haptic_node.driver import (
    DeviceReading,
    DeviceReport,
    DriveCommand,
    HapticDevice,
    Pair,
    PushedDevice,
    SpatialCommand,
    SpatialReading,
    Status,
)
from services.haptic_node.operator_config import InteractiveConfig
from services.haptic_node.physics.disturbances import DisturbedHaptic, changed_disturbances
from services.haptic_node.physics.lateral_hand import LateralHandState, lateral_hand_step
from services.haptic_node.physics.sim import SimulatedHaptic
from services.numerics.frames import to_paper_axis, to_site_frame
from services.runtime.bus.bus import Received
from services.runtime.loop.deadlines import PeriodicDeadline
from services.runtime.loop.freshness import FreshnessState, age_s
from services.runtime.loop.node import DeviceDelay, Node, NodeContext
from services.runtime.loop.node_state import FindInput, Part, part
from services.runtime.loop.replay_guard import ReplayGuard

INPUTS = ("haptic/command", "operator/force", "link/delay", "session/control", "node/health")
_MODE_CODES = {name: code for code, name in safety.MODE_NAMES.items()}
# These reasons limit the command without changing the mode of the device.
_LIMITS = (safety.REASON_TRAVEL_LIMIT, safety.REASON_SPEED_LIMIT, safety.REASON_FORCE_LIMIT)
_NOT_RUNNING_S = -1.0
# A sample of a real device that is younger than so many periods needs no remark.
_FRESH_PERIODS = 2
# With a change of law the force of an impedance device is zero for so long, and control begins anew where the hand is.
_LET_GO_S = 0.1
_LAW_CHANGES = "the law changes: no force meanwhile, and control begins anew where the hand is"


class HapticMemory(msgspec.Struct, array_like=True):
    """What the node remembers from tick to tick.

    The state of the guard, and where the arm was at the last tick [m]; the command in force, and when it was received
    [ns]; the force of an operator without a device [N], when it was received [ns], and the one that the simulated hand
    holds [N]; what was asked for since the last tick; ticks since the session began, None before; why an impedance
    device gives no force, of `coupling.GATES`; ticks for which it is let go of, after a change of law; the force of
    that operator across [N], and the simulated hand there.
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
    gate: int = GATE_ACTIVE
    let_go_ticks: int = 0
    operator_across_n: tuple[float, float] = (0.0, 0.0)
    across: LateralHandState = LateralHandState()


class HapticNodeState(NamedTuple):
    """The state of the node: its own, and that of its parts."""

    memory: HapticMemory
    freshness: FreshnessState
    deadline_ns: int
    device: Part


class HapticNode(Node):
    """The operator's device on an absolute grid, by default of 1 kHz: haptic/command in, haptic/state out.

    Every command goes through the guard (`safety.step`) first; what the guard let through and the
    device really did is what is published. The guard judges the age of the command, by its own time stamp, and that of
    the sample of this device which it answers, less what the link has delayed on purpose, both ways. A process that
    stalled takes the force from the motor until the next command.
    """

    inputs = INPUTS
    commands: ClassVar[tuple[str, ...]] = ("start", "stop", "arm", "estop")
    named_commands: ClassVar[tuple[str, ...]] = ("set",)
    journalled = True
    # After this the tick is in the master's half, and soon at the slave's side.
    idle_after = ""
    state_kind = HapticNodeState

    def __init__(self, context: NodeContext, config: HapticConfig, device: HapticDevice) -> None:
        super().__init__(context)
        self.period_s = context.period_s
        self._replay_guard = ReplayGuard(context, allow=config.allow_replay)
        self.freshness.allow_replay = config.allow_replay
        self.device = device
        self._config, self._other_operator = config, False
        self._simulated = config.simulated
        device.open()
        if device.report is not None:
            self.device_delay = DeviceDelay(device.capabilities.latency_s, device.capabilities.calibration)
        self._limits = config.limits.to_params(
            has_position_mode=safety.MODE_POSITION in device.capabilities.modes,
            has_force_mode=safety.MODE_FORCE in device.capabilities.modes,
        )
        start_m = config.device.start_position_m
        self._memory = HapticMemory(safety.SafetyState(False, safety.MODE_OFF, start_m), start_m)
        able = device.capabilities
        self._coupled, self._buttons = able.kind == "impedance", able.buttons
        self._has_orientation = able.has_orientation
        self._waits_for = ""
        if self._coupled:
            self._memory.gate = GATE_REST
            if device.report is None:
                self.event("node", "info", f"{able.identity}; {config.coupling.bounds(able).sentence()}")
        self._command_is_new = False
        operator = config.operator
        self._force_deadline_s = operator.force_deadline_s if isinstance(operator, InteractiveConfig) else None
        self._push_across = getattr(device, "push_lateral", None) if self._coupled else None
        # a device that has these axes is asked itself
        self._across = None if config.lateral is None or self._coupled else config.lateral.to_params()
        self._ignored_force = False
        self._switch_pressed = False
        self._reported = (safety.MODE_OFF, safety.REASONS[safety.REASON_COMMAND_STALE])
        self._device_text = ""
        self._device_status: Status = "ok"
        self._report_device(device.report)
        # The steps are compiled before the grid starts, not in its first tick.
        self._guarded()
        self._grid = PeriodicDeadline(self.clock.monotonic_ns(), round(self.period_s * 1e9))

    def admits(self, received: Received) -> bool:
        return self._replay_guard.admits(received)

    @property
    def is_latched(self) -> bool:
        return self._memory.guard.estop_latched or self._memory.estop_requested

    def capture(self) -> HapticNodeState | None:
        if not self._simulated:
            return None
        if self._other_operator:
            raise ValueError("the operator was changed by a command: a re-run has to begin before that")
        parts = self.freshness.capture(), self._grid.deadline_ns, part(self.device.state)
        return HapticNodeState(self._memory, *parts)

    def restore(self, state: HapticNodeState, find: FindInput) -> None:
        self._memory, self._grid.deadline_ns = state.memory, state.deadline_ns
        self.freshness.restore(state.freshness)
        self.device.state = state.device.like(self.device.state)
        if state.memory.pushed_n and isinstance(self.device, PushedDevice):
            self.device.push(state.memory.pushed_n)

    def deadline_ns(self) -> int:
        return self._grid.deadline_ns

    def on_message(self, received: Received) -> None:
        if type(received.message) is HapticCommand:
            self._memory.command = received.message
            self._memory.command_received_ns = received.received_ns
            self._command_is_new = True
        elif type(received.message) is LinkDelay:
            self.freshness.record(received.message)
        elif isinstance(received.message, OperatorForce):
            self._on_operator_force(received.message, received.received_ns)
        elif self._coupled and type(received.message) is SessionControl:
            self._on_law_change(received.message)

    def on_deadline(self, now_ns: int) -> None:
        """Guard the command, drive and sample the device, publish what it did."""
        if self.begin_turn(now_ns):
            # The command in force is dropped, and the force of the operator with it.
            self._memory.command, self._memory.operator_force_n = None, 0.0
            self._memory.operator_across_n = (0.0, 0.0)
        periods = self._grid.advance(now_ns)
        self.freshness.turn_ns = self._grid.deadline_ns
        self.overruns = self._grid.overruns
        elapsed_s = periods * self.period_s
        if self._memory.session_ticks is not None:
            self._memory.session_ticks += periods
        armed = self._memory.arm_requested
        applied = self._guarded()
        self._push()
        self.device.write(self._drive_command(applied, armed))
        reading = self.device.read(self._session_s(), elapsed_s)
        self._move_across(applied, elapsed_s)
        self._memory.position_m = reading.position_m
        if reading.spatial is not None:
            self._memory.gate = reading.spatial.gate
        report = self.device.report
        self._publish_state(applied, reading, elapsed_s, report)
        self._report_changes(applied)
        self._report_device(report)
        self.steps += 1

    def on_control(self, control: SessionControl) -> str:
        if control.command == "start":
            self._memory.session_ticks = 0
            return "the operator's programme runs"
        if control.command == "stop":
            self._memory.session_ticks = None
            return "the operator's programme has ended"
        if control.command == "estop":
            self._memory.estop_requested = True
            return "emergency stop latched: the motor is off until armed"
        if control.command == "arm":
            if self._switch_pressed:
                raise RefusedError("not armed: the device itself reports an emergency stop")
            self._memory.arm_requested = True
            return "armed: the motor follows fresh commands"
        if control.command == "set" and "operator" in control.parameters:
            return self._set_operator(control)
        if control.command == "set":
            if not isinstance(self.device, DisturbedHaptic):
                raise RefusedError("disturbances: a real device has its own")
            self.device.configure(changed_disturbances(self.device.disturbances, control.parameters))
            return "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())
        return super().on_control(control)

    def make_safe(self) -> None:
        """Take the force from the motor."""
        self.device.close()

    def _session_s(self) -> float:
        return _NOT_RUNNING_S if self._memory.session_ticks is None else self._memory.session_ticks * self.period_s

    def _on_operator_force(self, message: OperatorForce, received_ns: int) -> None:
        """Take the force of a person without a device; say once where the scenario has another operator."""
        if self._force_deadline_s is not None:
            self._memory.operator_force_n, self._memory.operator_force_ns = to_paper_axis(message.force_n), received_ns
            self._memory.operator_across_n = message.force_n[:2]
        elif not self._ignored_force:
            self._ignored_force = True
            text = f"the force of {message.src} is ignored: haptic_node.operator.kind must be interactive for it"
            self.event("fault", "warning", text, source=message.src)

    def _set_operator(self, control: SessionControl) -> str:
        """Put another simulated hand on the device, while the operator's programme does not run."""
        if not isinstance(self.device, SimulatedHaptic):
            raise RefusedError("operator: a real device has its own")
        if self._memory.session_ticks is not None:
            raise RefusedError("operator: its programme runs; stop the session first")
        self._config = changed_operator(self._config, control.parameters)
        self.device.take_operator(self._config.operator.to_params())
        self._other_operator = True
        return f"the operator is {self._config.operator.kind}, with the next start"

    def _push(self) -> None:
        """Let the simulated hand hold the newest force, or none where that is too old: its page may be gone."""
        if self._force_deadline_s is None or not isinstance(self.device, PushedDevice):
            return
        # The age counts from the reception, because the page and the rig may have been started with different clocks.
        force_n = self._memory.operator_force_n if self._is_pushed() else 0.0
        if force_n != self._memory.pushed_n:
            self._memory.pushed_n = force_n
            self.device.push(force_n)
        if self._push_across is not None:
            self._push_across(self._memory.operator_across_n if self._is_pushed() else (0.0, 0.0))

    def _on_law_change(self, control: SessionControl) -> None:
        """Let go of the hand when the law changes: the new one is to find no force in the coupling."""
        if control.command == "set" and "law" in control.parameters and is_meant("controller@master", control.target):
            self._memory.let_go_ticks = round(_LET_GO_S / self.period_s)

    def _drive_command(self, applied: safety.SafetyOutputs, armed: bool) -> DriveCommand:
        command, mode = self._memory.command, applied.mode
        if not self._coupled:
            return DriveCommand(mode, applied.position_reference_m, applied.force_reference_n)
        spatial = SpatialCommand(arm=armed)
        if command is not None and mode != safety.MODE_OFF:
            spatial = SpatialCommand(command.position_m[:2], command.force_n[:2], armed)
        return DriveCommand(mode, applied.position_reference_m, applied.force_reference_n, spatial)

    def _is_pushed(self) -> bool:
        """Whether the force of an operator without a device is fresh."""
        if self._force_deadline_s is None:
            return False
        return age_s(self.clock.now_ns(), self._memory.operator_force_ns) <= self._force_deadline_s

    def _move_across(self, applied: safety.SafetyOutputs, elapsed_s: float) -> None:
        """Advance the simulated hand across the sample; the controller pulls at it while the guard lets it."""
        if self._across is None:
            return
        command, memory = self._memory.command, self._memory
        pushed_n = memory.operator_across_n if self._is_pushed() else (0.0, 0.0)
        shown_n = (0.0, 0.0) if command is None or applied.mode == safety.MODE_OFF else command.force_n[:2]
        memory.across = lateral_hand_step(self._across, memory.across, pushed_n, shown_n, self._session_s(), elapsed_s)

    def _guarded(self) -> safety.SafetyOutputs:
        command = self._memory.command
        self._waits_for = self._reason_to_wait()
        command_age_s = self.freshness.command_age_s(command, self._memory.command_received_ns, self.clock.now_ns())
        if self._command_is_new:
            self._command_is_new = False
            self.stale += command_age_s > self._limits.command_deadline_s
        asked = safety.SafetyInputs(
            command_mode=safety.MODE_OFF if command is None else _MODE_CODES[command.mode],
            position_reference_m=0.0 if command is None else to_paper_axis(command.position_m),
            force_reference_n=0.0 if command is None else to_paper_axis(command.force_n),
            command_age_s=command_age_s,
            estop=self._memory.estop_requested,
            arm_requested=self._memory.arm_requested,
            position_m=self._memory.position_m,
            device_lost=self._device_status == "lost",
            device_waits=bool(self._waits_for),
        )
        self._memory.let_go_ticks = max(0, self._memory.let_go_ticks - 1)
        self._memory.estop_requested = self._memory.arm_requested = False
        # The step covers one period of motion, however long the process stalled, so that the hand feels no jump.
        self._memory.guard, applied = safety.step(self._limits, self._memory.guard, asked, self.period_s)
        return applied

    def _across_of(self, reading: DeviceReading) -> tuple[Pair, Pair, Pair, Pair]:
        """Return place [m], velocity [m/s], own force and shown force [N] of the hand across the sample, (x, y) each.

        They are the device's where it has these axes, and of the simulated hand otherwise.
        """
        side = reading.spatial
        if side is not None:
            return side.lateral_m, side.lateral_velocity_m_per_s, side.lateral_operator_force_n, side.lateral_force_n
        x, y, v_x, v_y, own_x, own_y, shown_x, shown_y = self._memory.across
        return (x, y), (v_x, v_y), (own_x, own_y), (shown_x, shown_y)

    def _publish_state(
        self, applied: safety.SafetyOutputs, reading: DeviceReading, elapsed_s: float, report: DeviceReport | None
    ) -> None:
        command = self._memory.command
        device = {} if report is None else {"device": report.status, "sample_age_s": report.age_s, **report.counts}
        if self._memory.gate in FAULTS:
            # What cannot be believed until a person arms is no hand, simulated or not.
            device["device"] = "lost"
        place_m, way_m_per_s, own_n, shown_n = self._across_of(reading)
        self.publish(
            "haptic/state",
            position_m=(*place_m, 0.0 - reading.position_m),
            velocity_m_per_s=(*way_m_per_s, 0.0 - reading.velocity_m_per_s),
            operator_force_n=(*own_n, 0.0 - reading.operator_force_n),
            motor_force_n=(*shown_n, 0.0 - reading.motor_force_n),
            reference_m=to_site_frame(applied.position_reference_m),
            mode=safety.MODE_NAMES[applied.mode],
            estop=applied.estop_latched,
            limited=applied.reason in _LIMITS or _device_limited(reading),
            session_s=self._session_s(),
            answered_seq=0 if command is None else command.hand_seq,
            answered_t_ns=0 if command is None else command.hand_t_ns,
            answered_at_ns=self._memory.command_received_ns,
            step_s=elapsed_s,
            **device,
            **self._spatial_keys(reading.spatial),
        )

    def _spatial_keys(self, found: SpatialReading | None) -> dict[str, Any]:
        """Return the keys of haptic/state that only devices of three axes or of impedance type have."""
        if found is None:
            return {}
        keys: dict[str, Any] = {"hand_energy_j": found.hand_energy_j, "coupling_energy_j": found.coupling_energy_j}
        if self._has_orientation:
            keys["orientation"] = found.orientation
        if self._buttons:
            keys["buttons"] = found.buttons
        return keys

    def _report_device(self, report: DeviceReport | None) -> None:
        """Take up the state of a real device: its emergency stop latches here, and what it says is an event, once."""
        if report is None:
            return
        self._device_status = report.status
        if self.device_delay is not None and report.status != "lost":
            self.device_delay.record(report.age_s)
        self._memory.estop_requested |= report.estop_pressed
        self.own_stops += report.estop_pressed and not self._switch_pressed
        self._switch_pressed = report.estop_pressed
        if report.text != self._device_text:
            self._device_text = report.text
            ready = report.status == "ok" and report.age_s <= _FRESH_PERIODS * self.period_s
            self.event("node" if ready else "fault", "info" if ready else "warning", report.text)

    def _report_changes(self, applied: safety.SafetyOutputs) -> None:
        self.state = "running" if applied.mode != safety.MODE_OFF else "safe"
        # a limit may come and go at every tick; it is published as `limited`, not as an event
        reason = safety.REASON_NONE if applied.reason in _LIMITS else applied.reason
        text = self._waits_for if reason == safety.REASON_DEVICE_WAITS else safety.REASONS[reason]
        if (applied.mode, text) == self._reported:
            return
        self._reported = (applied.mode, text)
        self.event(
            "mode",
            "info" if reason == safety.REASON_NONE else "warning",
            text,
            mode=safety.MODE_NAMES[applied.mode],
            position_m=self._memory.position_m,
        )

    def _reason_to_wait(self) -> str:
        """Return why an impedance device is not to be driven now, empty if it may be."""
        if self._memory.let_go_ticks:
            return _LAW_CHANGES
        return "" if self._memory.gate in (GATE_ACTIVE, GATE_READY) else GATES[self._memory.gate]


def _device_limited(reading: DeviceReading) -> bool:
    return reading.operator_force_limited or reading.end_stop or reading.voltage_limited or reading.torque_limited
