"""The half of a law at the instrument's site, as a node that runs when messages arrive.

A signal comes from `services/delay_node/node.py`, and its command goes to `services/afm_node/node.py`. The measurement
that the instrument returns goes back to the delay node.
"""

import math
from typing import Any, Literal, NamedTuple, cast

import msgspec

from services.controller.half import ZERO_XY, ControllerHalf, HalfState
from telenano.extend.laws import NO_SIGNAL, NO_TIP, EnergyAccount, PortSignal, SlaveReference, TipMeasurement
from telenano.extend.virtual_mass import bounded
from telenano.laws import energy, integration
from telenano.laws.clamp import clamped
from telenano.laws.integration import SlaveDecision, SlaveTiming, TimingParams
from telenano.laws.lateral import DIRECT, LateralSlaveState, hand_moves, lateral_slave_at_rest, lateral_slave_step
from telenano.numerics.frames import to_paper_axis
from telenano.runtime.loop.node import NodeContext
from telenano.sections.controller_section import ControllerConfig
from telenano.timing.freshness import DEADLINES_S
from telenano.wire.instrument import AfmProgram
from telenano.wire.messages import AfmState, LinkDelay, TeleopForward
from telenano.wire.ranges import FORCE
from telenano.wire.received import Received

# Silence after which a program of the instrument counts as over [ns]; it reports ten times a second.
_PROGRAM_SILENCE_NS = 500_000_000
_NO_COMMAND = -2
# Number of commands before the newest whose references are kept; an instrument further behind counts as at the oldest.
_MOST_OUTSTANDING = 7


class SetOff(NamedTuple):
    """Offset of the base from its commanded position, away from the sample [m], as the instrument reports it.

    surface_m: unused; it is kept because recordings contain it.
    """

    offset_m: float = 0.0
    surface_m: float = math.inf


class SlaveState(msgspec.Struct, array_like=True, kw_only=True):
    """The state of the slave half.

    tip, reference: newest measurement and newest reference; hand_armed: whether the hand was armed in the sample that
    the newest signal follows from; asked_m: references of the newest commands, the newest first [m]; carried_out_m:
    reference that the instrument had carried out at its newest measurement [m]; lateral_n: force on the tip in x and y
    [N]; instrument_ns: time of the newest measurement [ns]; occupied_until_ns: time until which a program of the
    instrument is assumed to image or measure by itself [ns]; entry: offset between hand and tip.
    """

    half: HalfState
    timing: SlaveTiming
    tip: TipMeasurement = NO_TIP
    reference: SlaveReference = SlaveReference(0.0, True)
    hand_armed: bool = False
    asked_m: tuple[float, ...] = (0.0,)
    carried_out_m: float = 0.0
    lateral_n: tuple[float, float] = ZERO_XY
    instrument_ns: int = 0
    instrument_lost: bool = False
    occupied_until_ns: int = 0
    across: LateralSlaveState
    entry: SetOff


class SlaveController(ControllerHalf):
    """The half at the instrument's site: teleop/forward in, afm/command out; afm/state in, teleop/backward out.

    Independent of the law, a command requests the instrument to follow only if the hand was armed in the sample that
    led to it, and states whether it was. The guard of the instrument checks that again (`telenano.afm.safety`).
    """

    inputs = ("teleop/forward", "afm/state", "afm/program", "link/delay", "session/control")
    state_kind = SlaveState
    memory: SlaveState
    # After this input the tick continues in the link, which may share the processor.
    idle_after = "afm/state"

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context, config)
        self.memory = SlaveState(
            half=self.half, timing=integration.slave_begin(), across=lateral_slave_at_rest(), entry=SetOff()
        )
        self._clamp = config.clamp_params()

    def started(self) -> Any:
        return self.law.slave_start(self.params, self.memory.tip)

    def on_message(self, received: Received) -> None:
        if self.rejects(received):
            return
        message = received.message
        if type(message) is TeleopForward:
            self._on_forward(message, received.received_ns)
        elif type(message) is AfmState:
            self.memory.instrument_ns = self.freshness.stamp_ns(message.t_ns, received.received_ns)
            self._on_instrument(message, received.received_ns)
        elif type(message) is AfmProgram:
            occupied = message.program != "tactile" and message.state in ("running", "paused")
            self.memory.occupied_until_ns = received.received_ns + _PROGRAM_SILENCE_NS if occupied else 0
        elif type(message) is LinkDelay:
            self.freshness.record(message)

    def timing_of(self, config: ControllerConfig) -> TimingParams:
        return config.slave_timing()

    def forget(self) -> None:
        memory = self.memory
        super().forget()
        memory.timing = integration.slave_stalled(memory.timing)
        if memory.tip.following:
            self._lose_instrument()

    def energy_account(self) -> EnergyAccount:
        return cast(EnergyAccount, self.law.slave_energy_account(self.params, self.law_state))

    @property
    def touches(self) -> bool:
        return self.memory.tip.following and self.memory.tip.in_contact

    def retuned(self, old: Any, new: Any) -> Any:
        return self.law.slave_retune(old, new, self.law_state)

    def _adopt(self, config: ControllerConfig) -> None:
        super()._adopt(config)
        self._clamp = config.clamp_params()

    def _switch(self) -> None:
        super()._switch()
        self.memory.timing = integration.slave_silenced(self.memory.timing)
        if self.half.switching:
            self.law_state = self._begun_together()

    def _standing(self) -> Any:
        """Return the initial state of the half at the last reference of the base."""
        return self.law.slave_start(
            self.params, self.memory.tip._replace(base_position_m=self.memory.reference.position_m)
        )

    def _begun_together(self) -> Any:
        """Return the initial state at the last reference of the base if the hand's half begins at the same time.

        The state has received a first signal of that half with empty counters, so both halves of a law may begin with
        the force found at the tip. A half that begins alone, after a restart or the loss of its instrument, may not.
        """
        beginning = NO_SIGNAL._replace(position_m=self.memory.reference.position_m, silence_s=0.0)
        return self.law.slave_receive(self.params, self._standing(), beginning, self.memory.tip, self.config.period_s)[
            0
        ]

    def _interrupted(self) -> Any:
        """Return the state after an interruption, ready for the next signal.

        Its counters continue, because a master that did not notice the interruption would take lower counters for old
        signals.
        """
        return self.law.slave_receive(self.params, self.law_state, NO_SIGNAL, self.memory.tip, self.config.period_s)[0]

    def _on_forward(self, message: TeleopForward, received_ns: int) -> None:
        memory, half = self.memory, self.half
        if memory.timing.commands.waiting:
            # The instrument has not answered the last tick, so its newest measurement is used while it is fresh.
            self._doubt_instrument()
        early = self.law.local_loop and not memory.instrument_lost and not half.switching
        memory.timing, settled = integration.slave_unanswered(memory.timing, early)
        self._settle(settled)
        half.hand_stamp = (message.hand_seq, message.hand_t_ns)
        memory.hand_armed = message.hand_armed is True
        understood = self.receive_signal(message)
        half.switching = half.switching and not (understood and message.active)
        may_wait = not (memory.instrument_lost or half.switching)
        memory.timing, tick = integration.slave_tick(
            memory.timing,
            self.timing_params,
            received_ns,
            self.clock.now_ns(),
            message.hand_t_ns,
            understood,
            may_wait,
        )
        if self.law_state is None:
            self.law_state = self.law.slave_start(self.params, memory.tip)
        elif tick.begins and not half.switching:
            self.law_state = self._interrupted()
        if self.lateral.motion.mode != DIRECT:
            follows = may_wait and not tick.begins and understood and message.active and memory.tip.following
            elapsed_s = memory.timing.pacing.elapsed * self.config.period_s
            memory.across = lateral_slave_step(
                self.lateral, memory.across, half.far_lateral, half.lateral_m, follows, elapsed_s
            )
        if tick.steps:
            if memory.instrument_lost:
                memory.reference = SlaveReference(memory.reference.position_m, False)
            elif not half.switching:
                self._receive(self.latest_signal(), memory.timing.pacing.elapsed)
            self._publish_command(answers=True)
        self.steps += 1
        self.report_status(None)

    def _receive(self, signal: PortSignal, elapsed: int) -> None:
        """Step the half by the periods that it lags the hand; elapsed: periods brought by a signal, 0 without one."""
        memory = self.memory
        memory.timing = integration.slave_stepped(memory.timing, self.timing_params, self.clock.now_ns(), elapsed)
        dt_s = memory.timing.pacing.step * self.config.period_s
        tip = TipMeasurement(*memory.tip[:-1], memory.asked_m[0] - memory.carried_out_m)
        self.law_state, wanted = self.law.slave_receive(self.params, self.law_state, signal, tip, dt_s)
        memory.reference = clamped(self._clamp, wanted, signal, tip)

    def _publish_command(self, *, answers: bool) -> None:
        memory, half = self.memory, self.half
        follows = memory.reference.active and memory.hand_armed
        mode: Literal["position", "hold"] = "position" if follows else "hold"
        is_direct = self.lateral.motion.mode == DIRECT
        moves = not is_direct and hand_moves(memory.across)
        across = {"lateral_m": (memory.across.x_m, memory.across.y_m)} if moves else {}
        command = self.publish(
            "afm/command",
            mode=mode,
            base_position_m=(
                *(half.far_lateral if is_direct else ZERO_XY),
                0.0 - memory.reference.position_m,
            ),
            hand_seq=half.hand_stamp[0],
            hand_t_ns=half.hand_stamp[1],
            hand_armed=memory.hand_armed,
            hand_force_n=bounded(self.config.law_config().force_scale * half.signal.force_n, FORCE.high),
            **across,
        )
        memory.timing = integration.slave_commanded(memory.timing, command.seq, answers)
        memory.asked_m = (memory.reference.position_m, *memory.asked_m[:_MOST_OUTSTANDING])

    def _doubt_instrument(self) -> None:
        """Treat the instrument as lost if its newest measurement is past the deadline of afm/state."""
        silence_s = (self.clock.now_ns() - self.memory.instrument_ns) * 1e-9
        if self.memory.tip.following and silence_s > DEADLINES_S["afm/state"]:
            self._lose_instrument()
            text = f"no data from the AFM for {silence_s * 1e3:.0f} ms: the motor of the hand is switched off"
            self.event("fault", "warning", text, silence_s=silence_s)

    def _lose_instrument(self) -> None:
        """Treat the tip as not following, and hold the last reference of the base until the next measurement."""
        memory = self.memory
        memory.tip = memory.tip._replace(following=False)
        self.state = "safe"
        memory.instrument_lost = True

    def _on_instrument(self, message: AfmState, now_ns: int) -> None:
        memory, half = self.memory, self.half
        half.lateral_m, memory.lateral_n = message.base_position_m[:2], message.tip_force_n[:2]
        followed = memory.tip.following
        memory.entry = SetOff(message.offset_m or 0.0)
        memory.tip = TipMeasurement(
            # For the law the base is where it would be without the offset, as if the sample were deeper by the offset.
            base_position_m=to_paper_axis(message.base_position_m) + memory.entry.offset_m,
            force_n=message.tip_force_n[2],
            separation_m=message.separation_m,
            separation_valid=message.separation_valid,
            in_contact=message.in_contact,
            following=message.mode in ("follow", "hold")
            and not (memory.occupied_until_ns and self.clock.now_ns() < memory.occupied_until_ns),
            outstanding_m=0.0,
        )
        if memory.tip.following and not followed and memory.entry.offset_m:
            self._report_offset(memory.entry.offset_m)
        self.state = "running" if memory.tip.following else "safe"
        if memory.instrument_lost:
            memory.instrument_lost = False
            memory.reference = SlaveReference(memory.tip.base_position_m, True)
            self.law_state = self._standing()
        self._count_port_energy()
        follows = self.law_state is not None and half.signal.active and memory.tip.following
        # Before its first command the instrument reports the number of the first one.
        number = message.command_seq if message.hand_t_ns > 0 else _NO_COMMAND
        later = max(memory.timing.commands.newest - number, 0)
        memory.carried_out_m = memory.asked_m[min(later, len(memory.asked_m) - 1)]
        memory.timing, settled = integration.slave_measured(
            memory.timing, self.timing_params, now_ns, number, half.switching, follows
        )
        self._settle(settled)

    def _report_offset(self, offset_m: float) -> None:
        """Report that hand and tip begin with an offset, because arming moved neither of them."""
        apart_m = offset_m / self.config.law_config().position_scale
        text = (
            f"the hand is set off by {1e3 * apart_m:.3g} mm: the tip is {1e9 * offset_m:.3g} nm further away from the"
            " sample than the place of the hand, and the hand moves it from there"
        )
        self.event("mode", "info", text, offset_m=offset_m, apart_m=apart_m)

    def _count_port_energy(self) -> None:
        memory = self.memory
        section = self.config.law_config()
        count = energy.with_outflow if memory.tip.following else energy.moved_to
        self.half.port = count(
            self.half.port,
            memory.tip.base_position_m / section.position_scale,
            section.force_scale * memory.tip.force_n,
        )

    def _settle(self, settled: SlaveDecision) -> None:
        """Carry out the decision that follows from a state of the instrument, or from its absence at a signal."""
        if settled.sends:
            if self.half.switching:
                self.law_state = self._begun_together()
            dt_s = settled.periods * self.config.period_s
            state, signal = self.law.slave_send(self.params, self.law_state, self.memory.tip, dt_s)
            if settled.accounts:
                self.law_state = state
            if settled.answers:
                self._publish_answer(signal)
        if settled.continues:
            self._receive(self.latest_signal(), 0)
            self._publish_command(answers=False)

    def _publish_answer(self, signal: PortSignal) -> None:
        if not self.passes_deadband(signal, self.memory.timing.pacing.elapsed * self.config.period_s):
            return
        self.publish(
            "teleop/backward",
            **self.signal_fields(signal),
            force_n=(*self.memory.lateral_n, signal.force_n),
            separation_m=signal.separation_m,
            separation_valid=signal.separation_valid,
            in_contact=signal.in_contact,
        )
