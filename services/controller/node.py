"""The controller processes: each runs one half of a law on the arrival of messages."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal, cast

from proto.messages import AfmState, HapticState, Scalar, SessionControl, TeleopBackward, TeleopForward, Vector3
from services.controller.config import LAWS, ControllerConfig
from services.controller.law import NO_SIGNAL, HandSample, Law, PortSignal, TipSample
from services.runtime.bus import Received
from services.runtime.config import merge, nested, validate
from services.runtime.errors import ConfigError, RefusedError
from services.runtime.node import Node, NodeContext

MASTER_INPUTS = ("haptic/state", "teleop/backward", "session/control")
SLAVE_INPUTS = ("teleop/forward", "afm/state", "session/control")
# time without a message after which a first or resumed one starts anew instead of being bridged by many steps
_LONGEST_BRIDGED_PERIODS = 50


def along(vector: Vector3) -> float:
    """Give the paper's coordinate (towards the sample) of a vector in a site's frame (z away from it)."""
    return 0.0 - vector[2]


def across(value: float) -> Vector3:
    """Give the vector in a site's frame of a coordinate along the paper's axis; 0.0 stays +0.0."""
    return (0.0, 0.0, 0.0 - value)


def warm_up(law: Law, params: object, period_s: float) -> None:
    """Compile the steps of a law before the first tick needs them."""
    hand, tip = HandSample(0.0, 0.0, 0.0, False), TipSample(0.0, 0.0, 0.0, False, False, False)
    state, signal = law.master_send(params, law.master_start(params, hand), hand, period_s)
    law.master_receive(params, state, hand, signal, period_s)
    state, _ = law.slave_receive(params, law.slave_start(params, tip), signal, tip, period_s)
    law.slave_send(params, state, tip, period_s)
    law.retune(params, params, law.master_start(params, hand))


class HalfLaw(Node):
    """What both halves share: the law, its parameters and how they change at run time."""

    commands: ClassVar[tuple[str, ...]] = ("set",)

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context)
        self.config = config
        self.law: Law = LAWS[config.law]
        self.params: Any = config.params()
        self.law_state: Any = None
        self.signal: PortSignal = NO_SIGNAL
        self._signal_ns: int | None = None
        self._hand = (0, 0)
        self._period_ns = round(config.period_s * 1e9)
        warm_up(self.law, self.params, config.period_s)

    def on_deadline(self, now_ns: int) -> None:
        """Do nothing: a controller acts on messages only."""

    def make_safe(self) -> None:
        """Do nothing: a controller holds no actuator, and its silence makes the devices safe."""

    def on_control(self, control: SessionControl) -> str:
        """Change parameters of the law: dotted keys below `controller`, such as virtual_impedance.force_gain."""
        if control.command != "set":
            return super().on_control(control)
        changed = self._changed_config(control.parameters)
        params = changed.params()
        if self.law_state is not None:
            self.law_state = self.retuned(self.params, params)
        self.config, self.params = changed, params
        return "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())

    def retuned(self, old: Any, new: Any) -> Any:
        """Carry the state of this half over a change of parameters."""
        return self.law_state

    def hear(self, message: TeleopForward | TeleopBackward, received_ns: int) -> None:
        """Take a signal of the other half; one of another law is not understood and counts as silence."""
        if message.law != self.law.name:
            return
        backward = isinstance(message, TeleopBackward)
        self._signal_ns = received_ns
        self.signal = PortSignal(
            position_m=along(message.position_m),
            velocity_m_per_s=along(message.velocity_m_per_s),
            # F_s is the reaction along +z, F_m the push along -z
            force_n=message.force_n[2] if backward else along(message.force_n),
            wave_sqrt_w=along(message.wave_sqrt_w) if message.wave_sqrt_w is not None else 0.0,
            energy_j=message.energy_j if message.energy_j is not None else 0.0,
            separation_m=message.separation_m if isinstance(message, TeleopBackward) else 0.0,
            separation_valid=message.separation_valid if isinstance(message, TeleopBackward) else False,
            in_contact=message.in_contact if isinstance(message, TeleopBackward) else False,
            active=message.active,
            silence_s=0.0,
        )

    def heard(self) -> PortSignal:
        """Give the newest signal with the time of silence since."""
        if self._signal_ns is None:
            return NO_SIGNAL
        silence = (self.clock.now_ns() - self._signal_ns) * 1e-9
        return self.signal._replace(silence_s=max(0.0, silence))

    def elapsed_s(self, hand_t_ns: int, previous_ns: int) -> float | None:
        """Give the whole periods between two hand samples [s]; None when the sequence starts anew.

        The hand's grid is absolute, so its stamps differ from whole periods by its lateness only; rounding keeps the
        law on that grid and makes a re-run from a recording exact.
        """
        periods = round((hand_t_ns - previous_ns) / self._period_ns)
        if previous_ns == 0 or not 0 < periods <= _LONGEST_BRIDGED_PERIODS:
            return None
        return periods * self.config.period_s

    def wire(self, signal: PortSignal) -> dict[str, object]:
        """Give the part of a teleop message that both directions share, without the force."""
        return {
            "law": self.law.name,
            "active": signal.active,
            "position_m": across(signal.position_m),
            "velocity_m_per_s": across(signal.velocity_m_per_s),
            "wave_sqrt_w": across(signal.wave_sqrt_w) if self.law.uses_waves else None,
            "energy_j": signal.energy_j if self.law.uses_energy else None,
            "hand_seq": self._hand[0],
            "hand_t_ns": self._hand[1],
        }

    def _changed_config(self, parameters: Mapping[str, Scalar]) -> ControllerConfig:
        if not parameters:
            raise RefusedError("set needs parameters, such as virtual_impedance.force_gain=10")
        frozen = {"law", "period_s"} & set(parameters)
        if frozen:
            raise RefusedError(f"{', '.join(sorted(frozen))} cannot be changed while the rig runs")
        try:
            document = merge(self.config.model_dump(), nested(parameters, "session/control"))
            return validate(ControllerConfig, document, "session/control", "controller")
        except ConfigError as error:
            raise RefusedError(str(error)) from error


class MasterController(HalfLaw):
    """The half at the operator's site: haptic/state in, teleop/forward out; teleop/backward in, haptic/command out.

    One command a tick of the hand: when the answer to the tick comes, or else at the next tick.
    """

    inputs = MASTER_INPUTS

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.hand = HandSample(0.0, 0.0, 0.0, False)
        self._dt_s = config.period_s
        self._command_due = False
        self._answered = (0, 0)

    def on_message(self, received: Received) -> None:
        """Act on the hand's sample or on the slave's answer."""
        message = received.message
        if isinstance(message, HapticState):
            self._on_hand(message)
        elif isinstance(message, TeleopBackward):
            self.hear(message, received.received_ns)
            self._answered = (message.hand_seq, message.hand_t_ns)
            if self._command_due:
                self._command()

    def retuned(self, old: Any, new: Any) -> Any:
        """Carry the state over without a jump at the tip."""
        return self.law.retune(old, new, self.law_state)

    def _on_hand(self, message: HapticState) -> None:
        if self._command_due:
            self._command()
        elapsed = self.elapsed_s(message.t_ns, self._hand[1])
        self._hand = (message.seq, message.t_ns)
        self.hand = HandSample(
            along(message.position_m),
            along(message.velocity_m_per_s),
            along(message.operator_force_n),
            message.mode != "off",
        )
        if self.law_state is None or elapsed is None:
            self.law_state = self.law.master_start(self.params, self.hand)
        self._dt_s = elapsed if elapsed is not None else self.config.period_s
        self.law_state, signal = self.law.master_send(self.params, self.law_state, self.hand, self._dt_s)
        self.publish("teleop/forward", **self.wire(signal), force_n=across(signal.force_n))
        self.steps += 1
        self._command_due = True

    def _command(self) -> None:
        self._command_due = False
        self.law_state, reference = self.law.master_receive(
            self.params, self.law_state, self.hand, self.heard(), self._dt_s
        )
        self.state = "running" if reference.active else "safe"
        self.publish(
            "haptic/command",
            mode="position" if reference.active else "off",
            position_m=across(reference.position_m),
            velocity_m_per_s=across(reference.velocity_m_per_s),
            force_n=(0.0, 0.0, reference.force_n),
            hand_seq=self._answered[0],
            hand_t_ns=self._answered[1],
        )


class SlaveController(HalfLaw):
    """The half at the instrument's site: teleop/forward in, afm/command out; afm/state in, teleop/backward out."""

    inputs = SLAVE_INPUTS

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.tip = TipSample(0.0, 0.0, 0.0, False, False, False)
        self._dt_s = config.period_s
        self._awaited: int | None = None

    def on_message(self, received: Received) -> None:
        """Act on the master's signal or on the instrument's answer."""
        message = received.message
        if isinstance(message, TeleopForward):
            self._on_forward(message, received.received_ns)
        elif isinstance(message, AfmState):
            self._on_instrument(message)

    def _on_forward(self, message: TeleopForward, received_ns: int) -> None:
        if self._awaited is not None:
            # the instrument has not answered the last tick: its newest sample has to do
            self._answer()
        elapsed = self.elapsed_s(message.hand_t_ns, self._hand[1])
        self._hand = (message.hand_seq, message.hand_t_ns)
        self.hear(message, received_ns)
        if self.law_state is None or elapsed is None:
            self.law_state = self.law.slave_start(self.params, self.tip)
        self._dt_s = elapsed if elapsed is not None else self.config.period_s
        self.law_state, reference = self.law.slave_receive(
            self.params, self.law_state, self.heard(), self.tip, self._dt_s
        )
        mode: Literal["position", "hold"] = "position" if reference.active else "hold"
        command = self.publish(
            "afm/command",
            mode=mode,
            base_position_m=across(reference.position_m),
            hand_seq=self._hand[0],
            hand_t_ns=self._hand[1],
        )
        self.steps += 1
        self._awaited = command.seq

    def _on_instrument(self, message: AfmState) -> None:
        self.tip = TipSample(
            along(message.base_position_m),
            message.tip_force_n[2],
            message.separation_m,
            message.separation_valid,
            message.in_contact,
            message.mode in ("follow", "hold"),
        )
        self.state = "running" if self.tip.following else "safe"
        if self._awaited is not None and message.command_seq == self._awaited and message.hand_t_ns > 0:
            self._answer()

    def _answer(self) -> None:
        self._awaited = None
        self.law_state, signal = self.law.slave_send(self.params, self.law_state, self.tip, self._dt_s)
        self.publish(
            "teleop/backward",
            **self.wire(signal),
            force_n=(0.0, 0.0, signal.force_n),
            separation_m=signal.separation_m,
            separation_valid=signal.separation_valid,
            in_contact=signal.in_contact,
        )


def half_of_site(context: NodeContext, config: ControllerConfig) -> HalfLaw:
    """Give the half of the law that belongs to the node's site."""
    half = MasterController if context.key.endswith("@master") else SlaveController
    return cast(HalfLaw, half(context, config))
