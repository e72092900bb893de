"""The AFM node: steps on each command, or on its own clock if none comes, and guards the tip.

A command comes from `services/controller/slave_half.py` and passes `telenano/afm/safety.py` before the driver gets it.
What the instrument then did and measured goes back to the slave half as afm/state.
"""

import contextlib
import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, TypeGuard

import msgspec

from telenano.afm import safety
from telenano.afm.felt import FeltState
from telenano.afm.programs.runner import RunnerState
from telenano.afm.step import LONGEST_STEP_NS, command_wait_ns
from telenano.devices.afm.capabilities import refusal
from telenano.devices.afm.guard_causes import cause_of
from telenano.devices.afm.guarded import AfmMemory, GuardedInstrument, Step, line_fields, parts_of
from telenano.devices.afm.instrument import pointed, reach_of, runner_of, sample_text
from telenano.extend.instruments import AfmDriver
from telenano.extend.programs import Wanted
from telenano.extend.stage import Place
from telenano.numerics.frames import to_paper_axis
from telenano.runtime.loop.commands import author_of
from telenano.runtime.loop.device_node import DeviceNode
from telenano.runtime.loop.node import NodeContext
from telenano.sections.afm_section import DRIVERS, AfmConfig
from telenano.sections.program_requests import (
    STIFFNESS,
    InstrumentRequest,
    changed_simulation,
    is_of_simulation,
    requested,
)
from telenano.sections.program_table import CHANGES
from telenano.timing.freshness import FreshnessState
from telenano.wire.errors import RefusedError, cause
from telenano.wire.lengths import in_nm
from telenano.wire.messages import AfmCommand, ClockPing, LinkDelay, Scalar, SessionControl
from telenano.wire.node_state import FindInput, Part, part
from telenano.wire.received import Received

INPUTS = ("afm/command", "clock/ping", "link/delay", "session/control", "node/health")
_PROGRAM_PERIOD_NS = 100_000_000
# Without a command the instrument holds; at the end of a session it retracts, whatever afm/command says.
_NO_COMMAND = AfmCommand(
    seq=0, t_ns=0, src="controller@slave", v=1, hand_seq=0, hand_t_ns=0, mode="hold", base_position_m=(0.0, 0.0, 0.0)
)
_WITHDRAWAL = msgspec.structs.replace(_NO_COMMAND, mode="retract")
_ACTION_CODES = {name: code for code, name in safety.ACTION_NAMES.items()}
_LONGEST_STEP_S = LONGEST_STEP_NS * 1e-9
_ARMED = {
    safety.MODE_FOLLOW: "armed: the tip follows fresh commands of an armed hand",
    safety.MODE_RETRACTED: "armed: the tip stays withdrawn until a fresh command of an armed hand comes",
}
# Speed with which the base returns to a place if the `arm` states none: 100 nm in 2 s [m/s].
_RETURN_M_PER_S = 50e-9
# Least distance of a return [m].
_LEAST_WAY_M = 1e-10
# Parameters of an `arm` that sends the tip towards the sample.
WORDS = ("place", "place_m", "speed_m_per_s")
_ALARMING = (
    safety.REASON_ESTOP,
    safety.REASON_FORCE_LIMIT,
    safety.REASON_FORCE_INVALID,
    safety.REASON_COMMAND_DEADLINE,
    safety.REASON_HOLD_EXPIRED,
    safety.REASON_DEVICE_LOST,
    safety.REASON_LATERAL_LIMIT,
)


# Reasons of acts that somebody else asked for.
_ASKED = (safety.REASON_ESTOP, safety.REASON_HOLD_REQUESTED, safety.REASON_RETRACT_REQUESTED, safety.REASON_ARMED)


class Way(NamedTuple):
    """Motion of the base after an `arm`: whether it moves, its target [m] and speed [m/s]; inf as in `SafetyInputs`."""

    goes: bool = False
    place_m: float = math.inf
    speed_m_per_s: float = math.inf


_STAYS, _TO_HAND = Way(), Way(goes=True)


class AfmNodeState(NamedTuple):
    """The state of the node and of its parts, for a re-run."""

    memory: AfmMemory
    freshness: FreshnessState
    programs: RunnerState
    instrument: Part


class AfmNode(DeviceNode):
    """The instrument: afm/command in, afm/state out, one state per command, and one per period without commands.

    Every command passes the guard (`safety.safety_step`) first, and the node publishes the guarded command and the
    device's actual motion and force. The guard judges the age of the command, by its own time stamp, and the age of the
    hand's sample that it descends from, without the delay that the link adds on purpose. After a stall, the process
    counts that time as silence, even if messages are waiting. A running program (`programs`) moves the tip behind the
    same guard, and commands only set the pace of the steps.

    A command is in force only if the hand was armed in the sample that it descends from; any other one is answered, but
    counts as none. So it makes no difference in which order hand and tip are armed, or by whom.
    """

    inputs = INPUTS
    commands: ClassVar[tuple[str, ...]] = ("arm", "estop")
    # Obeyed only if sent to this node by name: a `stop` to a pattern ends the force profile, and the tip may stay.
    named_commands: ClassVar[tuple[str, ...]] = ("stop", "set")
    journalled = True
    # 2: the base of an instrument that returns is where it is found, and a small force has to last to show a surface.
    state_version = 2
    # After afm/command, the tick continues in the slave half and the link, which may share the processor.
    idle_after = "afm/command"
    state_kind = AfmNodeState

    def __init__(self, context: NodeContext, config: AfmConfig, driver: AfmDriver) -> None:
        super().__init__(context, allow_replay=config.allow_replay)
        self._period_ns = round(self.period_s * 1e9)
        self._command_wait_ns = command_wait_ns(self._period_ns)
        # A step of a period must not count as a pause, even if the period is long.
        self._longest_step_s = max(_LONGEST_STEP_S, 2.0 * self.period_s)
        self._config, self._driver = config, driver
        self._limits = config.to_params().safety
        felt = None if config.feel is None else FeltState()
        self._memory = AfmMemory(safety.initial_safety_state(self._limits), felt=felt, words=True)
        self._reach = reach_of(config, driver)
        self._other_spring = False
        self._reported = (self._memory.guard.mode, self._memory.guard.reason)
        # The command that is being carried out: it is the author of what the guard does in this step.
        self._order: SessionControl | None = None
        # Fields of afm/state on the possible return in this step.
        self._way_back: dict[str, float] = {}
        self.state = "safe"
        driver.open()
        # The latency of a real instrument is known only after it is opened, and its programs depend on it.
        self._programs = runner_of(config, driver, self._reach, self.period_s)
        self._instrument = GuardedInstrument(self._limits, driver, parts_of(self, config, driver))
        # Compile before the first command; in the retracted state a step changes nothing.
        asked = safety.SafetyInputs(0.0, math.inf, safety.ACTION_HOLD, False, False, 0.0)
        safety.safety_step(self._limits, self._memory.guard, asked, self.period_s)
        self._memory.away = driver.report is not None
        begun_m = self._memory.guard.base_m
        if self._memory.away:
            # A real instrument stays where its driver has made it safe.
            begun_m = min(begun_m, driver.safe_position_m)
        self._memory.found_m = driver.exchange(begun_m).base_m
        if (report := driver.report) is not None:
            self.has_device(driver.latency_s, driver.calibration_identity)
            self.process_report(report)
        if caution := DRIVERS.caution(config.driver):
            self.event("node", "warning", caution)
        self._memory.stepped_ns = self.clock.monotonic_ns()
        self._memory.due_ns = self._memory.stepped_ns + self._period_ns
        is_model = config.driver == "simulated" and config.environment == "tip_sample" and config.map_span is None
        if is_model and (doubts := config.doubts()):
            self.event("fault", "warning", doubts)

    @property
    def is_latched(self) -> bool:
        return self._memory.guard.mode == safety.MODE_ESTOP

    def capture(self) -> AfmNodeState | None:
        if not self._config.simulated:
            return None
        if self._other_spring:
            raise ValueError("the stiffness of the sample was changed by a command: a re-run must begin before that")
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
            self.freshness.arrived(message.hand_t_ns, received.received_ns)
            self._memory.disarmed = self._is_disarmed(message)
            if message.hand_armed is True and not self._memory.disarmed:
                self._memory.followed, self._memory.followed_received_ns = message, received.received_ns
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
        self._step(now_ns, self._command_age_s())
        self._memory.due_ns = now_ns + self._period_ns

    def on_control(self, control: SessionControl) -> str:
        self._order = control
        try:
            return self._carry_out(control)
        finally:
            self._order = None

    def _carry_out(self, control: SessionControl) -> str:
        if control.command == "estop":
            self._step(self.clock.monotonic_ns(), self._command_age_s(), estop=True)
            return "emergency stop latched: the tip retracts and stays until armed"
        if control.command == "stop":
            return self._withdraw()
        if control.command == "set":
            self._memory.interrupted = self._memory.guard.goes
            return self._set(control)
        if control.command == "arm":
            return self._arm(self._way(control.parameters) if self._memory.words else _TO_HAND)
        return super().on_control(control)

    def _way(self, parameters: Mapping[str, Scalar]) -> Way:
        """Return the motion that an `arm` with these parameters requests; raise RefusedError if they are invalid."""
        limits = self._limits
        if unknown := sorted(set(parameters) - set(WORDS)):
            raise RefusedError(f"not armed: unknown key {', '.join(unknown)}; arm takes {', '.join(WORDS)}")
        place, place_m, speed = (parameters.get(key) for key in WORDS)
        if place is not None and (place != "hand" or place_m is not None):
            raise RefusedError(f"not armed: place = {place}: must be hand, or absent where place_m is given")
        if place_m is not None and not (_is_number(place_m) and limits.base_min_m <= place_m <= limits.base_max_m):
            bounds = f"{limits.base_min_m:g} to {limits.base_max_m:g} m"
            raise RefusedError(f"not armed: place_m = {place_m}: must lie within {bounds}, towards the sample > 0")
        if speed is not None and not (_is_number(speed) and 0.0 < speed <= limits.base_speed_m_per_s):
            most = f"at most {limits.base_speed_m_per_s:g} m/s (safety.base_speed_m_per_s)"
            raise RefusedError(f"not armed: speed_m_per_s = {speed}: must be above 0 and {most}")
        if place_m is None and place is None:
            if speed is not None:
                raise RefusedError("not armed: speed_m_per_s needs place_m, the place to go to")
            return _STAYS
        if place_m is None:
            return _TO_HAND if speed is None else Way(True, math.inf, float(speed))
        return Way(True, float(place_m), self._return_speed() if speed is None else float(speed))

    def _return_speed(self) -> float:
        return min(_RETURN_M_PER_S, self._limits.base_speed_m_per_s)

    def _arm(self, way: Way) -> str:
        """Arm the tip, and start the program with which the scenario begins: both, or neither if one is refused.

        An `arm` without motion leaves the tip at its place, and starts no program. Return the result as a sentence.
        """
        if self._programs.name:
            raise RefusedError(f"not armed: a {self._programs.name} is running; abort it first")
        begin, text, pointer = self._config.begin if way.goes else None, "", self._memory.pointer
        if begin is not None and self._memory.guard.mode not in (safety.MODE_FOLLOW, safety.MODE_HOLD):
            try:
                pointer, sentences = self._led(begin)
                # The guard decides below whether the tip is armed, and no program steps before that.
                text = "; ".join([*sentences, self._request(begin, safety.MODE_RETRACTED)])
            except RefusedError as error:
                raise RefusedError(f"not armed: {error}") from error
        done = self._step(self.clock.monotonic_ns(), self._command_age_s(), arm=way)
        self._memory.places = True
        if done.arm_refusal == safety.ARM_NOT_REFUSED:
            self._memory.pointer = pointer
            self._report_reach()
            return text or f"{_ARMED[done.mode]}{'' if way.goes else self._stays_text(done)}"
        self._programs.end()
        if done.arm_refusal != safety.ARM_REFUSED_ALREADY_ARMED:
            raise RefusedError(f"not armed: {safety.ARM_REFUSAL_NAMES[done.arm_refusal]}")
        if done.mode == safety.MODE_FOLLOW and self._memory.guard.goes and self._memory.guard.offset_m:
            text, facts = self._way_text(done)
            self.event("mode", "info", f"the AFM is in mode follow: armed; {text}", **self._mode_facts(done), **facts)
            return f"armed already: {text}"
        if done.mode == safety.MODE_FOLLOW:
            return "armed already"
        mode, reason = safety.MODE_NAMES[done.mode], safety.REASON_NAMES[done.reason]
        if done.mode == safety.MODE_HOLD:
            return f"armed already, but in mode {mode}: {reason}; without fresh commands the tip retracts"
        raise RefusedError(f"not armed: the AFM is in mode {mode}: {reason}")

    def _withdraw(self) -> str:
        """Retract the tip until armed, as at the end of a session; if a program is running, abort that instead."""
        if self._programs.name:
            return self._programs.abort()
        mode = self._step(self.clock.monotonic_ns(), 0.0, _WITHDRAWAL).mode
        if mode == safety.MODE_ESTOP:
            return "the tip is in emergency stop already"
        return "the tip retracts and stays until armed"

    def _set(self, control: SessionControl) -> str:
        """Start or change a program, move the tip over the sample, or change the simulation.

        A command is carried out as a whole or, after a RefusedError, not at all. Return the result in sentences.
        """
        changes = {key: value for key, value in control.parameters.items() if is_of_simulation(key)}
        request = requested({key: value for key, value in control.parameters.items() if key not in changes}, changes)
        simulated = changed_simulation(self._driver, changes)
        pointer, sentences = self._led(request)
        sentences = [*(sentence for sentence, _ in simulated), *sentences]
        if request.program is not None:
            sentences.append(self._request(request, self._memory.guard.mode))
            self._memory.told_ns = 0
        # Nothing can be refused from here on.
        self._memory.pointer = pointer
        self._other_spring |= STIFFNESS in changes
        for _, change in simulated:
            change()
        return "; ".join(sentences)

    def _led(self, request: InstrumentRequest) -> tuple[Place, list[str]]:
        """Return the place over the sample that a request asks for, and a sentence about it if the place is new."""
        before = self._memory.pointer
        place = pointed(self._config, self._driver, request.lateral, before)
        says = f"the tip goes to x = {in_nm(place.x_m)}, y = {in_nm(place.y_m)} while it follows"
        return place, [] if place is before else [says]

    def _request(self, request: InstrumentRequest, mode: int) -> str:
        # Pause and abort concern the running program, and name none.
        program = "" if request.program in CHANGES else request.program or ""
        if text := refusal(self._config.driver, program):
            raise RefusedError(f"program: {text}")
        return self._programs.request(request, mode, self._memory.place, device_lost=self.is_lost)

    def _report_reach(self) -> None:
        """Report the position of the sample, and warn if the base cannot reach it, so that a hand cannot touch it."""
        if text := sample_text(self._config, self._driver, self._reach):
            self.event("mode", "info", text)
        if self._reach is not None and (fault := self._reach.hand_fault(self._memory.pointer)):
            self.event("fault", "warning", f"a hand cannot touch the sample here: {fault}")

    def make_safe(self) -> None:
        """Retract the tip, report an error if the device does not confirm that, and close the device."""
        why = "it was not confirmed"
        try:
            confirmed = self._driver.retract()
        except Exception as error:  # noqa: BLE001
            # The driver of a package may raise anything, and the event and the end of the connection must follow.
            confirmed, why = False, cause(error)
        if not confirmed:
            text = f"no retraction of the tip ({why}): only the instrument's own watchdog can retract it now"
            self.event("fault", "error", text)
        with contextlib.suppress(Exception):
            self._driver.close()

    def _judge_stall(self, now_ns: int) -> None:
        """After a stall of this process, let the guard judge that time as silence, before waiting messages count."""
        if stalled_s := self.begin_turn(now_ns):
            self._step(now_ns, max(self._command_age_s(), stalled_s))

    def _is_disarmed(self, command: AfmCommand) -> bool:
        """Return whether the hand was disarmed while the tip holds; arming it later must not move the tip."""
        memory = self._memory
        if not memory.words or memory.guard.mode not in (safety.MODE_FOLLOW, safety.MODE_HOLD):
            return False
        return memory.disarmed or (memory.guard.mode == safety.MODE_HOLD and command.hand_armed is not True)

    def _command_age_s(self) -> float:
        memory = self._memory
        if memory.disarmed and memory.command is not None and memory.command.hand_armed is True:
            # A hand that was stopped and armed again is not coupled to the tip.
            return math.inf
        return self.freshness.command_age_s(memory.followed, memory.followed_received_ns, self.clock.now_ns())

    def _step(
        self,
        now_ns: int,
        age_s: float,
        wanted: AfmCommand | None = None,
        *,
        arm: Way | None = None,
        estop: bool = False,
    ) -> safety.SafetyOutputs:
        """Step at now_ns [ns] with a command of this age [s], by default the one in force; publish the state."""
        memory, is_lost = self._memory, self.is_lost
        elapsed_s = min(max(now_ns - memory.stepped_ns, 1) * 1e-9, self._longest_step_s)
        memory.stepped_ns = now_ns
        if self._programs.name and arm is None:
            step = self._instrument.step_program(memory, self._programs, elapsed_s, estop, is_lost)
            if line := step.wanted.line:
                lines = self._programs.report().lines
                self.publish("afm/scanline", **line_fields(line, lines, self._config.friction))
            self._publish_state(step)
            self._report_program()
            return step.allowed
        command = wanted or memory.followed or _NO_COMMAND
        base_m, action = to_paper_axis(command.base_position_m), _ACTION_CODES[command.mode]
        place, (x_m, y_m, _) = memory.pointer, command.base_position_m
        if command.lateral_m:
            # A hand that moves the tip across controls the stage, and the tip stays where the hand leaves it.
            place = memory.pointer = Place(*command.lateral_m)
        elif x_m or y_m:
            place = Place(place.x_m + x_m, place.y_m + y_m)
        by_hand = (True, *(arm or _STAYS), memory.interrupted, command.hand_force_n or 0.0)
        asked = memory.asks(base_m, action, age_s, arm is not None, estop, is_lost, by_hand=by_hand)
        memory.interrupted = False
        self._way_back = {}
        step = self._instrument.step(memory, asked, Wanted((), base_m, place), elapsed_s)
        if step.allowed.offset_m:
            self._add_offset(step, base_m)
        self._publish_state(step)
        return step.allowed

    def device_health(self) -> Mapping[str, Any]:
        """Return the fields of node/health on the device, and the actual force limit of the guard [N]."""
        return {**super().device_health(), "force_limit_n": self._limits.force_limit_n}

    def _add_offset(self, step: Step, reference_m: float) -> None:
        """Add to afm/state the offset between hand and base, and the return that an `arm` would permit."""
        memory, allowed = self._memory, step.allowed
        step.added_fields["offset_m"] = allowed.offset_m
        place_m = min(reference_m, safety.nearest_m(memory.guard.surface_m))
        if memory.words and step.follows and not memory.guard.goes and place_m > allowed.base_m + _LEAST_WAY_M:
            speed = self._return_speed()
            time_s = safety.way_s(self._limits, allowed.base_m, place_m, memory.guard.surface_m, speed)
            self._way_back = {"return_place_m": place_m, "return_speed_m_per_s": speed, "return_s": time_s}
            step.added_fields.update(self._way_back)

    def _publish_state(self, step: Step) -> None:
        """Publish the state after a step, and report changes of mode and place."""
        command = self._memory.command or _NO_COMMAND
        numbers = {"command_seq": command.seq, "hand_seq": command.hand_seq, "hand_t_ns": command.hand_t_ns}
        self._memory.placed = step.follows if self._programs.name else safety.is_placed(step.allowed)
        self.publish("afm/state", **numbers, **step.fields(self._memory))
        self._instrument.parts.report(step, self._memory)
        self._report_changes(step)
        if step.allowed.ended > safety.ENDED_THERE:
            self._report_ended(step.allowed)
        self._report_place(step.allowed.base_m)
        self.steps += 1

    def _report_program(self) -> None:
        """Publish the progress of the program ten times a second, and its end."""
        programs, memory = self._programs, self._memory
        if text := programs.take_notice():
            self.event("mode", "warning", text)
        if not programs.is_over and memory.stepped_ns - memory.told_ns < _PROGRAM_PERIOD_NS:
            return
        memory.told_ns = memory.stepped_ns
        report = programs.report()
        self.publish("afm/program", **report.fields())
        if programs.is_over:
            level = "info" if programs.state == "finished" else "warning"
            self.event("mode", level, report.text, program=report.program, program_state=report.state)
            if programs.leaves_tip:
                memory.pointer = memory.place
            programs.end()

    def _report_changes(self, step: Step) -> None:
        allowed = step.allowed
        if (allowed.mode, allowed.reason) == self._reported:
            return
        self._reported = (allowed.mode, allowed.reason)
        self.state = "running" if allowed.mode in (safety.MODE_FOLLOW, safety.MODE_HOLD) else "safe"
        level = "warning" if allowed.reason in _ALARMING else "info"
        mode, reason = safety.MODE_NAMES[allowed.mode], safety.REASON_NAMES[allowed.reason]
        facts: dict[str, Any] = {}
        text = f"the AFM is in mode {mode}: {reason}"
        if safety.is_wished(allowed.mode, allowed.reason):
            text += ", and waits for a fresh command of an armed hand"
        elif (allowed.mode, allowed.reason) == (safety.MODE_FOLLOW, safety.REASON_ARMED) and self._memory.followed:
            way, facts = self._way_text(allowed)
            text += f"; {way}"
        cause, values = self._cause_of(step)
        text += f"; {cause}" if cause else ""
        self.event("mode", level, text, **{**self._mode_facts(allowed), **values, **facts})

    def _cause_of(self, step: Step) -> tuple[str, dict[str, Any]]:
        """Return who made the guard act, and the value that did, as a clause and as facts for the event."""
        reason = step.allowed.reason
        if reason in _ASKED and self._order is not None:
            clause, facts = author_of(self._order)
            # An arming is no act of the guard, and its sentence says where the tip goes.
            return "" if reason == safety.REASON_ARMED else clause, facts
        if reason in _ASKED and not self._programs.name and self._memory.followed is not None:
            return "", {"author": self._memory.followed.src}
        cause, values = cause_of(reason, step.asked, self._limits)
        return cause, {"author": self.context.key, **values}

    @staticmethod
    def _mode_facts(allowed: safety.SafetyOutputs) -> dict[str, Any]:
        mode, reason = safety.MODE_NAMES[allowed.mode], safety.REASON_NAMES[allowed.reason]
        return {"mode": mode, "reason": reason, "base_position_m": allowed.base_m}

    def _way_text(self, allowed: safety.SafetyOutputs) -> tuple[str, dict[str, Any]]:
        """Return a sentence on target, speed and duration of the base's motion, and the facts for the event."""
        guard = self._memory.guard
        followed = self._memory.followed or _NO_COMMAND
        if not guard.goes and allowed.offset_m:
            return self._stays_text(allowed).removeprefix("; "), {"placing_s": 0.0}
        wanted_m = to_paper_axis(followed.base_position_m)
        is_stated = guard.goes and math.isfinite(guard.place_m)
        place_m = guard.place_m if is_stated else min(wanted_m, safety.nearest_m(guard.surface_m))
        speed = min(guard.speed_m_per_s, self._limits.base_speed_m_per_s)
        time_s = safety.way_s(self._limits, allowed.base_m, place_m, guard.surface_m, speed)
        text = (
            f"its base goes from {in_nm(allowed.base_m)} to {in_nm(place_m)} at {1e9 * speed:.4g} nm/s, for"
            f" {time_s:.2g} s"
        )
        if is_stated:
            text += "; any command, and a hand that moves or presses, ends it"
        elif wanted_m > place_m and math.isfinite(guard.surface_m):
            text += "; the hand is beyond, where the sample is: lift it, and let hand and tip meet again"
        elif wanted_m > place_m:
            text += (
                f"; the hand is beyond, and the base goes on from there at {1e9 * safety.LET_IN_M_PER_S:g} nm/s, and"
                " back in front of the sample once the tip has felt it"
            )
        return text, {"placing_s": time_s}

    def _stays_text(self, allowed: safety.SafetyOutputs) -> str:
        return f"; its base stays at {in_nm(allowed.base_m)}, and a hand moves it from there"

    def _report_ended(self, allowed: safety.SafetyOutputs) -> None:
        """Report that the base stops before its target; an arming that waits for the target is then over."""
        why = safety.ENDINGS[allowed.ended]
        text = f"the way of the base ended, because {why}: it stays at {in_nm(allowed.base_m)}"
        self.event("mode", "info", text, ended=why, **self._mode_facts(allowed))
        self._memory.places = False

    def _report_place(self, base_m: float) -> None:
        """Report once after each arming that the tip is placed; stop waiting if the tip is no longer armed."""
        memory = self._memory
        mode, reason = memory.guard.mode, memory.guard.reason
        if memory.places and memory.placed:
            text = f"the tip is placed: its base is at {in_nm(base_m)}"
            facts: dict[str, Any] = {
                "mode": safety.MODE_NAMES[mode],
                "reason": safety.REASON_NAMES[reason],
                "base_position_m": base_m,
                **self._way_back,
            }
            self.event("mode", "info", text, placed=True, **facts)
        memory.places = memory.places and safety.is_armed(mode, reason) and not memory.placed


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
