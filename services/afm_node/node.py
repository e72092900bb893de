"""The AFM process: acts on each command as it comes, on its own clock when none does, and guards the tip."""

import math
from typing import ClassVar

from proto.errors import RefusedError
from proto.messages import AfmCommand, ClockPing, SessionControl
from services.afm_node import safety
from services.afm_node.config import AfmConfig
from services.afm_node.driver import AfmDriver
from services.afm_node.step import LONGEST_STEP_NS, AfmSample, patience_ns
from services.runtime.bus import Received
from services.runtime.frames import across, along
from services.runtime.node import Node, NodeContext
from services.runtime.replay_guard import ReplayGuard

INPUTS = ("afm/command", "clock/ping", "session/control", "node/health")
PERIOD_S = 1e-3
_PERIOD_NS = round(PERIOD_S * 1e9)
_PATIENCE_NS = patience_ns(_PERIOD_NS)
_LONGEST_STEP_S = LONGEST_STEP_NS * 1e-9
_ACTION_CODES = {name: code for code, name in safety.ACTION_NAMES.items()}
_ALARMING = (
    safety.REASON_ESTOP,
    safety.REASON_FORCE_LIMIT,
    safety.REASON_FORCE_INVALID,
    safety.REASON_COMMAND_DEADLINE,
    safety.REASON_HOLD_EXPIRED,
)


class AfmNode(Node):
    """The instrument: afm/command in, afm/state out, one state a command, and a thousand a second without any.

    Every command goes through the guard (`safety_step`) first; what the guard let through and the
    device really did is what is published.
    """

    inputs = INPUTS
    commands: ClassVar[tuple[str, ...]] = ("arm", "estop")
    journalled = True
    period_s = PERIOD_S

    def __init__(self, context: NodeContext, config: AfmConfig, driver: AfmDriver) -> None:
        super().__init__(context)
        self._replay_guard = ReplayGuard(context, allow=config.allow_replay)
        self._driver = driver
        self._limits = config.to_params().safety
        self._guard = safety.initial_safety_state(self._limits)
        self._command: AfmCommand | None = None
        self._command_received_ns = 0
        self._force_n = 0.0
        self._reported = (self._guard.mode, self._guard.reason)
        self.state = "safe"
        driver.open()
        # compile before the first command comes; dt and inputs change nothing in the retracted state
        asked = safety.SafetyInputs(0.0, math.inf, safety.ACTION_HOLD, False, False, 0.0)
        safety.safety_step(self._limits, self._guard, asked, PERIOD_S)
        driver.exchange(self._guard.base_m)
        self._stepped_ns = self.clock.monotonic_ns()
        self._due_ns = self._stepped_ns + _PERIOD_NS
        if config.environment != "spring" and (doubts := config.doubts()):
            self.event("fault", "warning", doubts)

    def admits(self, received: Received) -> bool:
        return self._replay_guard.admits(received)

    def deadline_ns(self) -> int:
        return self._due_ns

    def on_message(self, received: Received) -> None:
        if isinstance(received.message, ClockPing):
            self.publish("clock/pong", ping_t_ns=received.message.t_ns, received_ns=received.received_ns)
        elif isinstance(received.message, AfmCommand):
            self._command = received.message
            self._command_received_ns = received.received_ns
            self._step(self.clock.monotonic_ns())
            self._due_ns = self._stepped_ns + _PATIENCE_NS

    def on_deadline(self, now_ns: int) -> None:
        """Step without a command: the guard judges the silence."""
        self._step(now_ns)
        self._due_ns = now_ns + _PERIOD_NS

    def on_control(self, control: SessionControl) -> str:
        if control.command == "estop":
            self._step(self.clock.monotonic_ns(), estop=True)
            return "emergency stop latched: the tip retracts and stays until armed"
        if control.command == "arm":
            refusal = self._step(self.clock.monotonic_ns(), arm=True).arm_refusal
            if refusal == safety.ARM_REFUSED_ALREADY_ARMED:
                return "armed already"
            if refusal != safety.ARM_NOT_REFUSED:
                raise RefusedError(f"not armed: {safety.ARM_REFUSAL_NAMES[refusal]}")
            return "armed: the tip follows fresh commands"
        return super().on_control(control)

    def make_safe(self) -> None:
        """Retract the tip."""
        self._driver.close()

    def _step(self, now_ns: int, *, arm: bool = False, estop: bool = False) -> safety.SafetyOutputs:
        elapsed_s = min(max(now_ns - self._stepped_ns, 1) * 1e-9, _LONGEST_STEP_S)
        self._stepped_ns = now_ns
        command = self._command
        age_s = math.inf if command is None else (self.clock.now_ns() - self._command_received_ns) * 1e-9
        asked = safety.SafetyInputs(
            reference_m=0.0 if command is None else along(command.base_position_m),
            command_age_s=age_s,
            action=safety.ACTION_HOLD if command is None else _ACTION_CODES[command.mode],
            arm=arm,
            estop=estop,
            force_n=self._force_n,
        )
        self._guard, allowed = safety.safety_step(self._limits, self._guard, asked, elapsed_s)
        sample = self._driver.exchange(allowed.base_m)
        self._force_n = sample.force_n
        self._publish_state(allowed, sample, elapsed_s)
        self._report_changes(allowed)
        self.steps += 1
        return allowed

    def _publish_state(self, allowed: safety.SafetyOutputs, sample: AfmSample, elapsed_s: float) -> None:
        command = self._command
        self.publish(
            "afm/state",
            command_seq=0 if command is None else command.seq,
            base_position_m=across(sample.base_m),
            deflection_m=sample.deflection_m,
            tip_force_n=(0.0, 0.0, sample.force_n),
            separation_m=sample.distance_m,
            separation_valid=sample.distance_valid,
            in_contact=sample.in_contact,
            meniscus=sample.meniscus,
            mode=safety.MODE_NAMES[allowed.mode],
            limited=allowed.limited != 0,
            hand_seq=0 if command is None else command.hand_seq,
            hand_t_ns=0 if command is None else command.hand_t_ns,
            step_s=elapsed_s,
        )

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
