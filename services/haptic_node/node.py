"""The haptic node: sets the pace of the rig, samples the operator's device, and guards it.

A sample of the hand begins here. It goes as haptic/state to `services/controller/master_half.py`, and the command that
answers it passes `telenano/hand/safety.py` before the device gets it.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from services.haptic_node.parts import HapticMemory, Tick, parts_of
from telenano.extend.hands import (
    MODE_FORCE,
    MODE_NAMES,
    MODE_OFF,
    MODE_POSITION,
    DeviceReading,
    DriveCommand,
    Gate,
    HapticDevice,
    HapticReport,
)
from telenano.hand import safety
from telenano.hand.disturbances import DisturbedHaptic
from telenano.hand.sim import SimulatedHaptic
from telenano.numerics.frames import to_paper_axis, to_site_frame
from telenano.runtime.loop.commands import author_of
from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.device_node import DeviceNode, Parts
from telenano.runtime.loop.node import NodeContext
from telenano.sections.hand_section import DRIVERS, HapticConfig, changed_operator
from telenano.sections.operator_section import InteractiveConfig
from telenano.settings.config import changed_disturbances
from telenano.timing.freshness import FreshnessState
from telenano.wire.errors import RefusedError
from telenano.wire.messages import HapticCommand, LinkDelay, OperatorForce, SessionControl
from telenano.wire.node_state import FindInput, Part, part
from telenano.wire.nodes import is_meant
from telenano.wire.received import Received

INPUTS = ("haptic/command", "operator/force", "link/delay", "session/control", "node/health")
_NO_COMMAND = HapticCommand(
    seq=0, t_ns=0, src="controller@master", v=1, hand_seq=0, hand_t_ns=0, mode="off", position_m=(0.0, 0.0, 0.0),
    velocity_m_per_s=(0.0, 0.0, 0.0), force_n=(0.0, 0.0, 0.0),
)  # fmt: skip
_MODE_CODES = {name: code for code, name in MODE_NAMES.items()}
# These reasons limit the command without changing the mode of the device.
_LIMITS = {safety.REASON_TRAVEL_LIMIT: "travel", safety.REASON_FORCE_LIMIT: "force", safety.REASON_SPEED_LIMIT: "speed"}
_NOT_RUNNING_S = -1.0
# A sample of a real device counts as late if it is older than this number of periods.
_FRESH_PERIODS = 2
# Time for which the force of an impedance device is zero after a change of law; control then restarts at the hand's
# position [s].
_LET_GO_S = 0.1
_LAW_CHANGES = "the law changes: no force meanwhile, and control begins again where the hand is"


class HapticNodeState(NamedTuple):
    """The state of the node and of its parts, for a re-run."""

    memory: HapticMemory
    freshness: FreshnessState
    deadline_ns: int
    device: Part


class HapticNode(DeviceNode):
    """The operator's device on an absolute time grid, by default of 1 kHz: haptic/command in, haptic/state out.

    Every command passes the guard (`safety.step`) first, and the node publishes the guarded command and the device's
    actual motion and force. The guard judges the age of the command, by its own time stamp, and the age of this
    device's sample that it answers, without the delays that the link adds on purpose in both directions. After a stall
    of the process the motor has no force until the next command.
    """

    inputs = INPUTS
    commands: ClassVar[tuple[str, ...]] = ("start", "stop", "arm", "estop")
    named_commands: ClassVar[tuple[str, ...]] = ("set",)
    journalled = True
    # 2: the force of the motor is what the arm gives the hand.
    state_version = 2
    # After haptic/state, the tick continues in the master half, and soon at the slave's site.
    idle_after = ""
    state_kind = HapticNodeState

    def __init__(self, context: NodeContext, config: HapticConfig, device: HapticDevice) -> None:
        super().__init__(context, allow_replay=config.allow_replay)
        self.device = device
        self._config, self._other_operator = config, False
        self._simulated = config.simulated
        device.open()
        if device.report is not None:
            self.has_device(device.capabilities.latency_s, device.capabilities.calibration)
        able = device.capabilities
        self._limits = config.limits.to_params(
            has_position_mode=MODE_POSITION in able.modes, has_force_mode=MODE_FORCE in able.modes
        )
        start_m = config.device.start_position_m
        self._memory = HapticMemory(safety.SafetyState(False, MODE_OFF, start_m), start_m)
        self._parts = Parts(parts_of(self, config, device))
        self._coupled = able.kind == "impedance"
        self._waits_for = ""
        if self._coupled:
            self._memory.gate = int(Gate.REST)
        if isinstance(device, SimulatedHaptic) and device.about:
            self.event("node", "info", device.about)
        self._command_is_new, self._command_age_s = False, math.inf
        self._ignored_force = False
        self._switch_pressed = False
        self._reported = (MODE_OFF, safety.REASONS[safety.REASON_COMMAND_STALE])
        # The newest emergency stop, which is the author of the latch; None if it was the switch of the device.
        self._stopped_by: SessionControl | None = None
        if device.report is not None:
            self.process_haptic_report(device.report)
            # The first command may come before the first tick, and control begins where the arm is.
            self._memory.position_m = device.read(_NOT_RUNNING_S, self.period_s).position_m
            self.process_haptic_report(device.report)
        if caution := DRIVERS.caution(config.driver):
            self.event("node", "warning", caution)
        # Compile the steps before the grid starts, and not in its first tick.
        self._guarded()
        self._grid = PeriodicDeadline(self.clock.monotonic_ns(), round(self.period_s * 1e9))

    @property
    def is_latched(self) -> bool:
        return self._memory.guard.estop_latched or self._memory.estop_requested

    def capture(self) -> HapticNodeState | None:
        if not self._simulated:
            return None
        if self._other_operator:
            raise ValueError("the operator was changed by a command: a re-run must begin before that")
        parts = self.freshness.capture(), self._grid.deadline_ns, part(self.device.state)
        return HapticNodeState(self._memory, *parts)

    def restore(self, state: HapticNodeState, find: FindInput) -> None:
        self._memory, self._grid.deadline_ns = state.memory, state.deadline_ns
        self.freshness.restore(state.freshness)
        self.device.state = state.device.like(self.device.state)
        if state.memory.pushed_n and isinstance(self.device, SimulatedHaptic):
            self.device.push(state.memory.pushed_n)

    def deadline_ns(self) -> int:
        return self._grid.deadline_ns

    def on_message(self, received: Received) -> None:
        if type(received.message) is HapticCommand:
            self._memory.command = received.message
            self._memory.command_received_ns = received.received_ns
            self._command_is_new = True
            self.freshness.arrived(received.message.hand_t_ns, received.received_ns)
        elif type(received.message) is LinkDelay:
            self.freshness.record(received.message)
        elif isinstance(received.message, OperatorForce):
            self._on_operator_force(received.message, received.received_ns)
        elif self._coupled and type(received.message) is SessionControl:
            self._on_law_change(received.message)

    def on_deadline(self, now_ns: int) -> None:
        """Guard the command, drive and sample the device, and publish its state."""
        if self.begin_turn(now_ns):
            # After a stall, drop the command in force, and the force of the operator.
            self._memory.command, self._memory.operator_force_n = None, 0.0
            self._memory.operator_across_n = (0.0, 0.0)
        periods = self._grid.advance(now_ns)
        self.freshness.turn_ns = self._grid.deadline_ns
        self.overruns = self._grid.overruns
        elapsed_s = periods * self.period_s
        armed = self._memory.arm_requested
        applied, command = self._guarded(), self._memory.command or _NO_COMMAND
        tick = Tick(command, applied, armed, elapsed_s, self._session_s(periods))
        self._parts.prepare(tick, self._memory)
        self.device.write(
            DriveCommand(applied.mode, applied.position_reference_m, applied.force_reference_n, tick.spatial)
        )
        tick.reading = self.device.read(tick.session_s, elapsed_s)
        self._parts.measure(tick, self._memory)
        self._memory.position_m = tick.reading.position_m
        self._publish_state(tick)
        self._report_changes(applied)
        self._parts.report(tick, self._memory)
        self.steps += 1

    def on_control(self, control: SessionControl) -> str:
        if control.command == "start":
            self._memory.session_ticks = 0
            return "the operator's force profile runs"
        if control.command == "stop":
            self._memory.session_ticks = None
            return "the operator's force profile has ended"
        if control.command == "estop":
            self._memory.estop_requested = True
            self._stopped_by = control
            return "emergency stop latched: the motor is off until armed"
        if control.command == "arm":
            if self._switch_pressed:
                raise RefusedError("not armed: the device itself reports an emergency stop")
            if self._memory.estop_requested:
                raise RefusedError("not armed: an emergency stop came in this period of the device")
            self._memory.arm_requested = True
            return "armed: the tip may follow the hand, and the motor follows fresh commands"
        if control.command == "set" and "operator" in control.parameters:
            return self._set_operator(control)
        if control.command == "set":
            if not isinstance(self.device, DisturbedHaptic):
                raise RefusedError("disturbances: only a simulated device has these settings, and this one is real")
            if not control.parameters:
                raise RefusedError("set needs parameters, such as disturbances.tremor.enabled=true")
            changed = changed_disturbances(self.device.disturbances, control.parameters, "haptic_node")
            self.device.configure(changed)
            return "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())
        return super().on_control(control)

    def make_safe(self) -> None:
        """Close the device, which takes the force from the motor."""
        self.device.close()

    def _session_s(self, periods: int) -> float:
        """Advance the operator's force profile by a number of periods; return its time [s], < 0 while none runs."""
        if self._memory.session_ticks is None:
            return _NOT_RUNNING_S
        self._memory.session_ticks += periods
        return self._memory.session_ticks * self.period_s

    def _on_operator_force(self, message: OperatorForce, received_ns: int) -> None:
        """Store the force of a person without a device; warn once if the scenario has another operator."""
        if isinstance(self._config.operator, InteractiveConfig):
            self._memory.operator_force_n, self._memory.operator_force_ns = to_paper_axis(message.force_n), received_ns
            self._memory.operator_across_n = message.force_n[:2]
        elif not self._ignored_force:
            self._ignored_force = True
            text = f"the force of {message.src} is ignored: haptic_node.operator.kind must be interactive for it"
            self.event("fault", "warning", text, source=message.src)

    def _set_operator(self, control: SessionControl) -> str:
        """Replace the simulated hand; raise RefusedError for a real device, or while a force profile runs."""
        if not isinstance(self.device, SimulatedHaptic):
            raise RefusedError("operator: only a simulated device has a simulated hand, and this one is real")
        if self._memory.session_ticks is not None:
            raise RefusedError("operator: its force profile runs; stop the session first")
        self._config = changed_operator(self._config, control.parameters)
        self.device.take_operator(self._config.operator.to_params())
        self._other_operator = True
        return f"the operator is {self._config.operator.kind} from the next session start"

    def _on_law_change(self, control: SessionControl) -> None:
        """Release the hand when the law changes, so that the new law starts without force in the coupling."""
        if control.command == "set" and "law" in control.parameters and is_meant("controller@master", control.target):
            self._memory.let_go_ticks = round(_LET_GO_S / self.period_s)

    def _guarded(self) -> safety.SafetyOutputs:
        memory, command = self._memory, self._memory.command or _NO_COMMAND
        self._waits_for = self._reason_to_wait()
        received_ns = memory.command_received_ns
        command_age_s = self.freshness.command_age_s(memory.command, received_ns, self.clock.now_ns())
        self._command_age_s = command_age_s
        if self._command_is_new:
            self._command_is_new = False
            self.stale += command_age_s > self._limits.command_deadline_s
        asked = safety.SafetyInputs(
            command_mode=_MODE_CODES[command.mode],
            position_reference_m=to_paper_axis(command.position_m),
            force_reference_n=to_paper_axis(command.force_n),
            command_age_s=command_age_s,
            estop=memory.estop_requested,
            arm_requested=memory.arm_requested,
            position_m=memory.position_m,
            device_lost=self.is_lost,
            device_waits=bool(self._waits_for),
        )
        memory.let_go_ticks = max(0, memory.let_go_ticks - 1)
        memory.estop_requested = memory.arm_requested = False
        # The step covers one period of motion after a stall of any length, so that the hand feels no jump.
        memory.guard, applied = safety.step(self._limits, memory.guard, asked, self.period_s)
        return applied

    def device_health(self) -> Mapping[str, Any]:
        """Return the fields of node/health on the device, and the travel that the guard allows the hand [m]."""
        return {**super().device_health(), "travel_m": (self._limits.position_min_m, self._limits.position_max_m)}

    def _publish_state(self, tick: Tick) -> None:
        command, applied, reading = tick.command, tick.applied, tick.reading
        limited_by = _limited_by(applied.reason, reading)
        place_m, way_m_per_s, own_n, shown_n = tick.across
        self.publish(
            "haptic/state",
            position_m=(*place_m, 0.0 - reading.position_m),
            velocity_m_per_s=(*way_m_per_s, 0.0 - reading.velocity_m_per_s),
            operator_force_n=(*own_n, 0.0 - reading.operator_force_n),
            motor_force_n=(*shown_n, 0.0 - reading.motor_force_n),
            reference_m=to_site_frame(applied.position_reference_m),
            mode=MODE_NAMES[applied.mode],
            estop=applied.estop_latched,
            # The tip must not follow a device whose readings are refused, such as one with a lost encoder.
            armed=applied.armed and tick.added_fields.get("device") != "lost",
            limited=limited_by is not None,
            session_s=tick.session_s,
            answered_seq=command.hand_seq,
            answered_t_ns=command.hand_t_ns,
            answered_at_ns=self._memory.command_received_ns,
            step_s=tick.elapsed_s,
            **({} if limited_by is None else {"limited_by": limited_by}),
            **tick.added_fields,
        )

    def process_haptic_report(self, report: HapticReport) -> None:
        """Process the report of a real device; its own emergency stop latches in this node."""
        self._memory.estop_requested |= report.estop_pressed
        self._stopped_by = None if report.estop_pressed else self._stopped_by
        self.own_stops += report.estop_pressed and not self._switch_pressed
        self._switch_pressed = report.estop_pressed
        self.process_report(report, is_late=report.age_s > _FRESH_PERIODS * self.period_s)

    def _report_changes(self, applied: safety.SafetyOutputs) -> None:
        self.state = "running" if applied.mode != MODE_OFF else "safe"
        # A limit may start and end at every tick, so it is published as `limited`, not as an event.
        reason = safety.REASON_NONE if applied.reason in _LIMITS else applied.reason
        text = self._waits_for if reason == safety.REASON_DEVICE_WAITS else safety.REASONS[reason]
        if reason == safety.REASON_NONE and applied.mode == MODE_OFF:
            text = "the motor is off, as it is commanded to be"
        if (applied.mode, text) == self._reported:
            return
        self._reported = (applied.mode, text)
        cause, values = self._cause_of(reason)
        level = "info" if reason == safety.REASON_NONE else "warning"
        facts = {"mode": MODE_NAMES[applied.mode], "reason": text, "position_m": self._memory.position_m, **values}
        self.event("mode", level, f"{text} ({cause})" if cause else text, **facts)

    def _cause_of(self, reason: int) -> tuple[str, dict[str, Any]]:
        """Return who made the guard act, and the value that did, as a clause and as facts for the event."""
        if reason == safety.REASON_ESTOP and self._stopped_by is not None:
            return author_of(self._stopped_by)
        if reason == safety.REASON_ESTOP:
            return "pressed at the device", {"author": self.context.key}
        facts = {"author": self.context.key}
        if reason != safety.REASON_COMMAND_STALE:
            return "", facts
        age_s, limit_s = self._command_age_s, self._limits.command_deadline_s
        if not math.isfinite(age_s):
            return "none has come", {**facts, "limit_s": limit_s}
        text = f"the newest one was {1e3 * age_s:.0f} ms old, and its limit is {1e3 * limit_s:.0f} ms"
        return text, {**facts, "command_age_s": age_s, "limit_s": limit_s}

    def _reason_to_wait(self) -> str:
        """Return the reason why an impedance device must not be driven now; empty if it may be."""
        if self._memory.let_go_ticks:
            return _LAW_CHANGES
        return "" if self._memory.gate in (Gate.ACTIVE, Gate.READY) else Gate(self._memory.gate).text


def _limited_by(reason: int, reading: DeviceReading) -> str | None:
    """Return the limit that is acting on the hand, the most lasting one of several; None if none is."""
    of_guard = _LIMITS.get(reason)
    acting = (
        (of_guard == "travel", "travel"),
        (reading.end_stop, "end_stop"),
        (of_guard == "force", "force"),
        (reading.operator_force_limited, "operator_force"),
        (reading.torque_limited, "torque"),
        (reading.voltage_limited, "voltage"),
        (of_guard == "speed", "speed"),
    )
    return next((name for is_acting, name in acting if is_acting), None)
