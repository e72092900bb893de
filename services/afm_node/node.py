"""The AFM process: acts on each command as it comes, on its own clock when none does, and guards the tip."""

import contextlib
import math
from typing import Any, ClassVar, NamedTuple

import msgspec
import numpy as np

from proto.errors import RefusedError, cause
from proto.instrument import MOST_TEXT
from proto.messages import AfmCommand, Array, ClockPing, LinkDelay, SessionControl
from services.afm_node import safety
from services.afm_node.config import AfmConfig
from services.afm_node.devices.capabilities import refusal
from services.afm_node.driver import AfmDriver, DeviceReport, OwnImage, OwnScan
from services.afm_node.felt import LEFT, FeltInputs, FeltState, felt_step
from services.afm_node.instrument import reach_of, runner_of
from services.afm_node.over_map import MapEdge
from services.afm_node.physics.part import AfmSample, Oscillation
from services.afm_node.physics.step import LONGEST_STEP_NS, command_wait_ns
from services.afm_node.programs.lateral import Place, moved
from services.afm_node.programs.program import FinishedLine, Inputs
from services.afm_node.programs.reach import Reach
from services.afm_node.programs.runner import RunnerState
from services.afm_node.programs.settings import (
    STIFFNESS,
    InstrumentRequest,
    changed_simulation,
    is_of_simulation,
    requested,
)
from services.afm_node.programs.table import CHANGES
from services.numerics.frames import to_paper_axis
from services.runtime.bus.bus import Received
from services.runtime.loop.clock import NEVER_NS
from services.runtime.loop.freshness import FreshnessState
from services.runtime.loop.node import DeviceDelay, Node, NodeContext
from services.runtime.loop.node_state import FindInput, Part, part
from services.runtime.loop.replay_guard import ReplayGuard

INPUTS = ("afm/command", "clock/ping", "link/delay", "session/control", "node/health")
_PROGRAM_PERIOD_NS = 100_000_000
# The truth about particles is looked at so often, and published then while one moves, else every so many looks.
_LOOK_PERIOD_NS, _RESTING_LOOKS = 50_000_000, 20
_LONGEST_STEP_S = LONGEST_STEP_NS * 1e-9
_ACTION_CODES = {name: code for code, name in safety.ACTION_NAMES.items()}
_AT_REST = Oscillation(0.0, 0.0)
_ALARMING = (
    safety.REASON_ESTOP,
    safety.REASON_FORCE_LIMIT,
    safety.REASON_FORCE_INVALID,
    safety.REASON_COMMAND_DEADLINE,
    safety.REASON_HOLD_EXPIRED,
    safety.REASON_DEVICE_LOST,
    safety.REASON_LATERAL_LIMIT,
)


class AfmMemory(msgspec.Struct, array_like=True):
    """What the node remembers from step to step.

    The state of the guard; the command in force, and when it was received [ns]; forces on the tip at the last step [N];
    where the tip is, and where a person wants it; the times of the last report of a program, of the last step, and of
    the next one [ns]; what is felt, None where it is the force; the number of the last look at the particles.
    """

    guard: safety.SafetyState
    command: AfmCommand | None = None
    command_received_ns: int = 0
    force_n: float = 0.0
    lateral_n: tuple[float, float] = (0.0, 0.0)
    place: Place = Place(0.0, 0.0)
    pointer: Place = Place(0.0, 0.0)
    told_ns: int = 0
    stepped_ns: int = 0
    due_ns: int = 0
    felt: FeltState | None = None
    particles_look: int = 0


class AfmNodeState(NamedTuple):
    """The state of the node: its own, and that of its parts."""

    memory: AfmMemory
    freshness: FreshnessState
    programs: RunnerState
    instrument: Part


class AfmNode(Node):
    """The instrument: afm/command in, afm/state out, one state a command, and one a period without any.

    Every command goes through the guard (`safety_step`) first; what the guard let through and the
    device really did is what is published. The guard judges the age of the command, by its own time stamp, and that of
    the hand's sample which it descends from, less what the link has delayed on purpose. A process that stalled counts
    that time as silence, whatever waits for it. While a program runs (`programs`), it moves the tip behind the same
    guard, and commands only pace the steps.
    """

    inputs = INPUTS
    commands: ClassVar[tuple[str, ...]] = ("arm", "estop")
    # A command to a pattern ends the operator's programme, after which the tip may stay where it is.
    named_commands: ClassVar[tuple[str, ...]] = ("stop", "set")
    journalled = True
    # After this the tick is in the slave's half and the link, which may share its processor.
    idle_after = "afm/command"
    state_kind = AfmNodeState

    def __init__(self, context: NodeContext, config: AfmConfig, driver: AfmDriver) -> None:
        super().__init__(context)
        self.period_s = context.period_s
        self._period_ns = round(self.period_s * 1e9)
        self._command_wait_ns = command_wait_ns(self._period_ns)
        # A step as long as the period is no pause.
        self._longest_step_s = max(_LONGEST_STEP_S, 2.0 * self.period_s)
        self._replay_guard = ReplayGuard(context, allow=config.allow_replay)
        self.freshness.allow_replay = config.allow_replay
        self._driver, self._driver_name = driver, config.driver
        self._own_scan: OwnScan | None = getattr(driver, "own_scan", None)
        self._simulated = config.simulated
        self._limits = config.to_params().safety
        self._memory = AfmMemory(safety.initial_safety_state(self._limits))
        self._twist_n = config.friction.lateral_stiffness_n_per_m * config.friction.tip_height_m
        self._lateral = config.to_lateral_params()
        self._reach = reach_of(config, driver)
        about = getattr(driver, "about", "")
        self._sample = about if self._reach is None else _sample_text(config, self._reach)
        self._places_m = config.places_m
        self._other_spring = False
        self._edge = None if config.map_span is None else MapEdge(config.places_m)
        self._feel = None if config.feel is None else (config.feel.channel, config.feel.to_params())
        self._left = False
        if self._feel is not None:
            self._memory.felt = FeltState()
        self._begin = config.begin
        self._reported = (self._memory.guard.mode, self._memory.guard.reason)
        self.state = "safe"
        self._device_lost = False
        self._device_text = ""
        driver.open()
        # The latency of a real instrument is known once it is open, and its programs depend on it.
        self._programs = runner_of(config, driver, self._reach, self.period_s)
        if driver.report is not None:
            self.device_delay = DeviceDelay(driver.latency_s, driver.calibration_identity)
        # compile before the first command comes; dt and inputs change nothing in the retracted state
        asked = safety.SafetyInputs(0.0, math.inf, safety.ACTION_HOLD, False, False, 0.0)
        safety.safety_step(self._limits, self._memory.guard, asked, self.period_s)
        driver.exchange(self._memory.guard.base_m)
        self._report_device(driver.report)
        self._memory.stepped_ns = self.clock.monotonic_ns()
        self._memory.due_ns = self._memory.stepped_ns + self._period_ns
        is_model = config.driver == "simulated" and config.environment == "tip_sample" and self._edge is None
        if is_model and (doubts := config.doubts()):
            self.event("fault", "warning", doubts)

    def admits(self, received: Received) -> bool:
        return self._replay_guard.admits(received)

    @property
    def is_latched(self) -> bool:
        return self._memory.guard.mode == safety.MODE_ESTOP

    def capture(self) -> AfmNodeState | None:
        if not self._simulated:
            return None
        if self._other_spring:
            raise ValueError("the stiffness of the sample was changed by a command: a re-run has to begin before that")
        parts = self.freshness.capture(), self._programs.capture(), part(self._driver.state)
        return AfmNodeState(self._memory, *parts)

    def restore(self, state: AfmNodeState, find: FindInput) -> None:
        self._memory = state.memory
        self.freshness.restore(state.freshness)
        self._programs.restore(state.programs)
        self._driver.state = state.instrument.like(self._driver.state)

    def deadline_ns(self) -> int:
        return self._memory.due_ns

    def on_message(self, received: Received) -> None:
        self._judge_stall(received.received_ns - self.clock.epoch_offset_ns)
        message = received.message
        if type(message) is AfmCommand:
            self._memory.command = message
            self._memory.command_received_ns = received.received_ns
            command_age_s = self._command_age_s()
            self.stale += command_age_s > self._limits.command_deadline_s
            self._step(self.clock.monotonic_ns(), command_age_s)
            self._memory.due_ns = self._memory.stepped_ns + self._command_wait_ns
        elif type(message) is LinkDelay:
            self.freshness.record(message)
        elif type(message) is ClockPing:
            self.publish("clock/pong", ping_t_ns=message.t_ns, received_ns=received.received_ns)

    def on_deadline(self, now_ns: int) -> None:
        """Step without a command: the guard judges the silence."""
        self._judge_stall(now_ns)
        self._step(now_ns)
        self._memory.due_ns = now_ns + self._period_ns

    def on_control(self, control: SessionControl) -> str:
        if control.command == "estop":
            self._step(self.clock.monotonic_ns(), estop=True)
            return "emergency stop latched: the tip retracts and stays until armed"
        if control.command == "stop":
            return self._withdraw()
        if control.command == "set":
            return self._set(control)
        if control.command == "arm":
            if self._programs.name:
                raise RefusedError(f"not armed: a {self._programs.name} is running; abort it first")
            refusal = self._step(self.clock.monotonic_ns(), arm=True).arm_refusal
            if refusal == safety.ARM_REFUSED_ALREADY_ARMED:
                return "armed already"
            if refusal != safety.ARM_NOT_REFUSED:
                raise RefusedError(f"not armed: {safety.ARM_REFUSAL_NAMES[refusal]}")
            self._report_reach()
            if self._begin is not None:
                return self._request(self._begin)
            return "armed: the tip follows fresh commands"
        return super().on_control(control)

    def _withdraw(self) -> str:
        """Retract the tip as at the end of a session: nobody has stopped it, and it stays retracted until armed."""
        if self._programs.name:
            return self._programs.abort()
        mode = self._step(self.clock.monotonic_ns(), withdraw=True).mode
        if mode == safety.MODE_ESTOP:
            return "the tip is in emergency stop already"
        return "the tip retracts and stays until armed"

    def _set(self, control: SessionControl) -> str:
        """Begin or change a program, or move the tip over the sample: all of a command, or nothing where it refuses."""
        changes = {key: value for key, value in control.parameters.items() if is_of_simulation(key)}
        request = requested({key: value for key, value in control.parameters.items() if key not in changes}, changes)
        simulated = changed_simulation(self._driver, changes)
        sentences = [sentence for sentence, _ in simulated]
        lateral, pointer = request.lateral, self._memory.pointer
        if lateral.x_m is not None or lateral.y_m is not None:
            if self._driver.stage is None:
                raise RefusedError("lateral: this instrument has no lateral stage")
            x_m = pointer.x_m if lateral.x_m is None else lateral.x_m
            y_m = pointer.y_m if lateral.y_m is None else lateral.y_m
            reach_x_m, reach_y_m = self._places_m
            if abs(x_m) > reach_x_m or abs(y_m) > reach_y_m:
                limit = f"lateral.reach_m = {reach_x_m:g} m"
                if self._edge is not None:
                    limit = f"the recorded map, x ± {reach_x_m:g} m, y ± {reach_y_m:g} m"
                raise RefusedError(f"lateral: {x_m:g}, {y_m:g} m is beyond {limit}")
            pointer = Place(x_m, y_m)
            sentences.append(f"the tip goes to x = {x_m:g} m, y = {y_m:g} m while it follows")
        if request.program is not None:
            sentences.append(self._request(request))
            self._memory.told_ns = 0
        # Nothing refuses from here on.
        self._memory.pointer = pointer
        self._other_spring |= STIFFNESS in changes
        for _, change in simulated:
            change()
        return "; ".join(sentences)

    def _request(self, request: InstrumentRequest) -> str:
        # Pause and abort are for the program that runs, whatever it is.
        program = "" if request.program in CHANGES else request.program or ""
        if text := refusal(self._driver_name, "", program):
            raise RefusedError(f"program: {text}")
        return self._programs.request(
            request, self._memory.guard.mode, self._memory.place, device_lost=self._device_lost
        )

    def _report_reach(self) -> None:
        """Report how the sample lies, and that a hand cannot touch it where the base does not reach it."""
        if self._sample:
            self.event("mode", "info", self._sample)
        if self._reach is not None and (fault := self._reach.hand_fault(self._memory.pointer)):
            self.event("fault", "warning", f"a hand cannot touch the sample here: {fault}")

    def make_safe(self) -> None:
        """Retract the tip, and say so if the device does not confirm it."""
        why = "it was not confirmed"
        try:
            confirmed = self._driver.retract()
        except Exception as error:  # noqa: BLE001
            # The driver of a package may raise anything, and nothing may keep the event and the end of the connection.
            confirmed, why = False, cause(error)
        if not confirmed:
            text = f"no retraction of the tip ({why}): only the instrument's own watchdog can retract it now"
            self.event("fault", "error", text)
        with contextlib.suppress(Exception):
            self._driver.close()

    def _judge_stall(self, now_ns: int) -> None:
        """Let the guard judge the time that this process stood still as silence, before it looks at what waited."""
        if stalled_s := self.begin_turn(now_ns):
            self._step(now_ns, max(self._command_age_s(), stalled_s))

    def _command_age_s(self) -> float:
        return self.freshness.command_age_s(self._memory.command, self._memory.command_received_ns, self.clock.now_ns())

    def _settle(self) -> None:
        """Go on by a part of what is known of the motion; the next part lets in what waits for the processor."""
        if self._driver.simulation is not None and self._driver.simulation.settle():
            self.defer(self._settle, NEVER_NS)

    def _step(
        self,
        now_ns: int,
        command_age_s: float | None = None,
        *,
        arm: bool = False,
        estop: bool = False,
        withdraw: bool = False,
    ) -> safety.SafetyOutputs:
        """Take a step at now_ns [ns], with the age of the command [s] where it is known already.

        With `withdraw` the step asks for a retraction, whatever afm/command asks for.
        """
        elapsed_s = min(max(now_ns - self._memory.stepped_ns, 1) * 1e-9, self._longest_step_s)
        self._memory.stepped_ns = now_ns
        if self._programs.name:
            return self._step_program(elapsed_s, estop=estop)
        command = self._memory.command
        asked = safety.SafetyInputs(
            reference_m=0.0 if command is None else to_paper_axis(command.base_position_m),
            command_age_s=self._command_age_s() if command_age_s is None else command_age_s,
            action=safety.ACTION_HOLD if command is None else _ACTION_CODES[command.mode],
            arm_requested=arm,
            estop=estop,
            force_n=self._memory.force_n,
            device_lost=self._device_lost,
            lateral_n=math.hypot(*self._memory.lateral_n),
        )
        if withdraw:
            asked = asked._replace(
                reference_m=self._memory.guard.base_m, command_age_s=0.0, action=safety.ACTION_RETRACT
            )
        wanted = self._memory.pointer
        if command is not None and command.lateral_m is not None:
            # A hand that moves the tip across has the stage, and where it leaves the tip, the tip stays.
            wanted = self._memory.pointer = Place(*command.lateral_m)
        elif command is not None:
            x, y, _ = command.base_position_m
            if x or y:
                wanted = Place(wanted.x_m + x, wanted.y_m + y)
        return self._carry_out(asked, wanted, elapsed_s)

    def _carry_out(
        self, asked: safety.SafetyInputs, wanted: Place, elapsed_s: float, image: OwnImage | None = None
    ) -> safety.SafetyOutputs:
        """Guard what is asked, apply it, measure, and publish what was done; image: what the instrument is to take."""
        self._memory.guard, allowed = safety.safety_step(self._limits, self._memory.guard, asked, elapsed_s)
        if self._edge is not None:
            wanted, text = self._edge.kept(wanted, allowed, self._memory.stepped_ns)
            if text:
                self.event("mode", "warning", text)
        if wanted is not self._memory.place and allowed.mode == safety.MODE_FOLLOW:
            self._move_laterally(wanted, elapsed_s)
        simulation = self._driver.simulation
        if simulation is not None:
            simulation.elapse(elapsed_s)
        if self._own_scan is not None:
            self._own_scan.want_image(image if allowed.mode == safety.MODE_FOLLOW else None)
        sample = self._driver.exchange(allowed.base_m)
        if (stage := self._driver.stage) is not None:
            self._memory.lateral_n = stage.lateral_force_n
        report = self._driver.report
        # A force beyond the range of the input is no number for the guard.
        self._memory.force_n = sample.force_n if report is None or report.force_valid else math.nan
        felt: dict[str, Any] = {}
        if self._feel is not None:
            sample, felt = self._made_of_channel(sample, allowed, elapsed_s)
        self._publish_state(allowed, sample, elapsed_s, report, felt)
        self._publish_particles()
        self._report_changes(allowed)
        self._report_device(report)
        self.steps += 1
        if simulation is not None and simulation.settles:
            self.defer(self._settle, NEVER_NS)
        return allowed

    def _made_of_channel(
        self, sample: AfmSample, allowed: safety.SafetyOutputs, elapsed_s: float
    ) -> tuple[AfmSample, dict[str, Any]]:
        """Return the sample with what is felt of the channel as its force, and what is published of that.

        The guard judges the greater of both forces; a value that has left the branch is no force to it.
        """
        assert self._feel is not None and self._memory.felt is not None
        channel, params = self._feel
        value = getattr(self._driver, "channels", {}).get(channel, math.nan)
        inputs = FeltInputs(value, sample.base_m, self._memory.place, allowed.mode == safety.MODE_RETRACTED)
        self._memory.felt, felt = felt_step(params, self._memory.felt, inputs, elapsed_s)
        left = felt.clamp == LEFT
        self._memory.force_n = math.nan if left else max(self._memory.force_n, felt.force_n)
        if left and not self._left:
            self.event(
                "fault", "warning", f"{channel} = {value:.6g} has left the branch of feel.table: the tip retracts"
            )
        self._left = left
        said = {"felt_channel": channel, "felt_clamp": felt.clamp}
        if math.isfinite(value):
            said["felt_value"] = value
        return sample._replace(force_n=felt.force_n), said

    def _step_program(self, elapsed_s: float, *, estop: bool) -> safety.SafetyOutputs:
        """Take a step of the program that runs, and see to its end."""
        programs = self._programs
        vibrating = self._driver.vibration
        oscillation = _AT_REST if vibrating is None else vibrating.oscillation
        inputs = Inputs(
            self._memory.guard.base_m,
            self._memory.place,
            self._memory.force_n,
            self._memory.lateral_n,
            oscillation,
            self._memory.pointer,
            own=None if self._own_scan is None else self._own_scan.take_line(),
        )
        action, wanted = programs.step(inputs, elapsed_s)
        if vibrating is not None:
            vibrating.vibrate(wanted.amplitude_m)
        if wanted.line is not None:
            self._publish_line(wanted.line)
        asked = safety.SafetyInputs(
            reference_m=wanted.base_m,
            # The references of the program are made in this step.
            command_age_s=0.0,
            action=action,
            arm_requested=self._memory.guard.mode == safety.MODE_RETRACTED and action == safety.ACTION_POSITION,
            estop=estop,
            force_n=self._memory.force_n,
            device_lost=self._device_lost,
            lateral_n=math.hypot(*self._memory.lateral_n),
        )
        allowed = self._carry_out(asked, wanted.place, elapsed_s, wanted.image)
        programs.follow_guard(allowed.mode, allowed.reason)
        if text := programs.take_notice():
            self.event("mode", "warning", text)
        is_over = programs.state in ("finished", "ended")
        if is_over or self._memory.stepped_ns - self._memory.told_ns >= _PROGRAM_PERIOD_NS:
            self._memory.told_ns = self._memory.stepped_ns
            report = programs.report()
            self.publish("afm/program", **report._replace(text=report.text[:MOST_TEXT])._asdict())
            if is_over:
                level = "info" if programs.state == "finished" else "warning"
                self.event("mode", level, report.text, program=report.program, program_state=report.state)
                if programs.leaves_tip:
                    self._memory.pointer = self._memory.place
                programs.end()
                if vibrating is not None:
                    vibrating.vibrate(0.0)
        return allowed

    def _move_laterally(self, wanted: Place, elapsed_s: float) -> None:
        stage = self._driver.stage
        if stage is not None and wanted != self._memory.place:
            self._memory.place = moved(self._lateral, self._memory.place, wanted, elapsed_s)[0]
            stage.move_to(*self._memory.place)

    def _publish_line(self, line: FinishedLine) -> None:
        lines = self._programs.report().lines
        further = {}
        if line.lateral_n is not None:
            further["lateral_force_n"] = Array.from_numpy(line.lateral_n)
            further["torsion_rad"] = Array.from_numpy(line.lateral_n / self._twist_n)
        if line.dissipated_j is not None:
            further["dissipated_j"] = Array.from_numpy(line.dissipated_j)
        self.publish(
            "afm/scanline",
            line=line.line,
            lines=lines,
            direction="retrace" if line.backward else "trace",
            start_m=(*line.start, 0.0),
            end_m=(*line.end, 0.0),
            height_m=Array.from_numpy(line.height_m),
            amplitude_m=None if line.amplitude_m is None else Array.from_numpy(line.amplitude_m),
            phase_rad=None if line.phase_rad is None else Array.from_numpy(line.phase_rad),
            **further,
        )

    def _publish_state(
        self,
        allowed: safety.SafetyOutputs,
        sample: AfmSample,
        elapsed_s: float,
        report: DeviceReport | None,
        felt: dict[str, Any],
    ) -> None:
        command = self._memory.command
        device = felt
        if report is not None:
            device = felt | {"device": report.status, "sample_age_s": report.age_s}
            device.update(output_v=report.output_v, input_v=report.input_v)
        self.publish(
            "afm/state",
            command_seq=0 if command is None else command.seq,
            base_position_m=(*self._memory.place, 0.0 - sample.base_m),
            deflection_m=sample.deflection_m,
            tip_force_n=(*self._memory.lateral_n, sample.force_n),
            separation_m=sample.distance_m,
            separation_valid=sample.distance_valid,
            in_contact=sample.in_contact,
            meniscus=sample.meniscus,
            mode=safety.MODE_NAMES[allowed.mode],
            limited=allowed.limited != 0,
            hand_seq=0 if command is None else command.hand_seq,
            hand_t_ns=0 if command is None else command.hand_t_ns,
            step_s=elapsed_s,
            **device,
        )

    def _publish_particles(self) -> None:
        """Publish where the particles of the simulation really are, for recordings: no node and no plan reads it."""
        look, before = self._memory.stepped_ns // _LOOK_PERIOD_NS, self._memory.particles_look
        if look == before or self._driver.simulation is None:
            return
        self._memory.particles_look = look
        found = self._driver.simulation.particles
        if found is None or not (found.moving.any() or look // _RESTING_LOOKS != before // _RESTING_LOOKS):
            return
        self.publish(
            "afm/particles",
            simulated=True,
            places_m=Array.from_numpy(found.places_m),
            radii_m=Array.from_numpy(found.radii_m),
            moving=Array.from_numpy(found.moving.astype(np.uint8)),
        )

    def _report_device(self, report: DeviceReport | None) -> None:
        """Take up the state of a real instrument; what it says is an event, once."""
        if report is None:
            return
        self._device_lost = report.status == "lost"
        if self.device_delay is not None and not self._device_lost:
            self.device_delay.record(report.age_s)
        if report.text != self._device_text:
            self._device_text = report.text
            ready = report.status == "ok"
            self.event("node" if ready else "fault", "info" if ready else "warning", report.text)

    def _report_changes(self, allowed: safety.SafetyOutputs) -> None:
        if (allowed.mode, allowed.reason) == self._reported:
            return
        self._reported = (allowed.mode, allowed.reason)
        self.state = "running" if allowed.mode in (safety.MODE_FOLLOW, safety.MODE_HOLD) else "safe"
        mode, reason = safety.MODE_NAMES[allowed.mode], safety.REASON_NAMES[allowed.reason]
        self.event(
            "mode",
            "warning" if allowed.reason in _ALARMING else "info",
            f"the AFM is in mode {mode}: {reason}",
            mode=mode,
            reason=reason,
            base_position_m=allowed.base_m,
        )


def _sample_text(config: AfmConfig, reach: Reach) -> str:
    """Return how a sample that was read from a file lies; empty for any other."""
    surface, sample = reach.surface, config.sample
    if sample is None or surface is None or not sample.levelled:
        return ""
    low, high = float(surface.height_m.min()), float(surface.height_m.max())
    return (
        f"sample {sample.name}: {sample.levelled} (afm_node.sample.level={sample.level}); the tip sees {low:.3g} to"
        f" {high:.3g} m"
    )
