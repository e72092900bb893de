"""Base class of both halves of a law as nodes: the law in force, its parameters, and changes of both at run time."""

from abc import abstractmethod
from typing import Any, ClassVar

import msgspec

from telenano.extend.laws import (
    NO_SIGNAL,
    NO_TIP,
    EnergyAccount,
    HandSample,
    Law,
    PortSignal,
    SlaveReference,
    port_signal,
)
from telenano.laws import energy
from telenano.laws.clamp import clamped
from telenano.laws.deadband import DeadbandState, deadband, initial_deadband_state
from telenano.laws.integration import NewestSignal, TimingParams, silence_ns
from telenano.laws.lateral import NO_ENERGY, EnergyTank
from telenano.numerics.frames import to_paper_axis, to_site_frame
from telenano.runtime.loop.commands import DEFAULT_VALIDITY_S
from telenano.runtime.loop.node import Node, NodeContext
from telenano.sections.controller_section import KNOWN_LAWS, PACKAGE_LAWS, ControllerConfig, changed_config
from telenano.timing.freshness import FreshnessState
from telenano.wire.errors import ConfigError, RefusedError, described
from telenano.wire.messages import SessionControl, TeleopBackward, TeleopForward
from telenano.wire.node_state import FindInput, Part, part
from telenano.wire.received import Received

STATUS_PERIOD_S = 0.01
ROUND_TRIP_UNKNOWN = (0.0, False)
ZERO_XY = (0.0, 0.0)


class HalfState(msgspec.Struct, array_like=True, kw_only=True):
    """The part of the state that both halves have.

    config: the settings in force, None if unchanged since the start; signal: newest signal of the other half;
    lateral_m: position or reference of the device across the sample, at the scale of the tip [m]; far_lateral: last
    lateral value of the other half, at the slave's half the position that the hand wants for the tip [m], at the
    master's the force on the tip [N]; far_place: position of the stage, at the master's half [m]; hand_stamp: number
    and time stamp [ns] of the newest sample of the hand; reported_j: energy at the port at the last report [J];
    newest: number of the newest signal of the other half, and time stamp [ns] of the hand's sample that it answers;
    told: whether a command has chosen the law since the start.
    `capture` writes law (None before the first sample), steps and freshness.
    """

    config: ControllerConfig | None = None
    law: Part | None = None
    signal: PortSignal = NO_SIGNAL
    lateral_m: tuple[float, float] = ZERO_XY
    far_lateral: tuple[float, float] = ZERO_XY
    far_place: tuple[float, float] = ZERO_XY
    switching: bool = False
    port: energy.Port
    hand_stamp: tuple[int, int] = (0, 0)
    reported_j: float = 0.0
    band: DeadbandState
    steps: int
    freshness: FreshnessState
    newest: tuple[int, int] = (-1, 0)
    told: bool = False


class ControllerHalf(Node):
    """Base class of both halves: the law, its parameters, and changes of both at run time.

    A change of law reaches the halves at different times, and each of them then stops: the reference of the hand
    coasts to rest, that of the base stays, and both send inactive signals of the new law and ignore those of any other.
    The master continues from the hand's reference at the first signal of the slave in the new law, with the base
    position that the slave reports as the tip's reference. The slave continues at the first active signal of the
    master.

    Messages past their deadline are rejected (`Freshness`), and a half that stalled continues with the next fresh
    signal. If the process of the other half has restarted, its first signal counts as inactive. That interrupts the
    law, so that its counters of the other half start again from the present values of that half. A half whose law no
    command has chosen since its start takes over the law in which the other one signals: at its first signal, and with
    the settings of its start once it has heard no signal of its own law for longer than a command is valid, because
    none is on its way then.
    """

    # The whole state of the half, of type `state_kind`, and the part of it that both halves have.
    memory: Any
    half: HalfState
    commands: ClassVar[tuple[str, ...]] = ("set",)
    journalled = True
    # 2: the law takes the force that the limits of the hand let through.
    state_version = 2

    def __init__(self, context: NodeContext, config: ControllerConfig) -> None:
        super().__init__(context)
        self.config = config
        self.law: Law = KNOWN_LAWS[config.law]
        self.params: Any = config.params()
        self.law_state: Any = None
        self.half = HalfState(
            port=energy.opened(0.0, 0.0),
            band=initial_deadband_state(NO_SIGNAL),
            steps=0,
            freshness=self.freshness.capture(),
        )
        self.lateral = config.lateral_params()
        self.hand_limits = config.hand_params()
        self.timing_params = self.timing_of(config)
        self._status_ticks = max(1, round(STATUS_PERIOD_S / config.period_s))
        self._band = config.deadband.to_params()
        self._failing: dict[str, str] = {}
        # Fields of law/status at their tick, kept until they are sent.
        self._status: dict[str, Any] = {}
        for law in KNOWN_LAWS.values():  # compile now, because a change of law must not wait for it
            self._warm_up(law)

    def _warm_up(self, law: Law) -> None:
        """Run each step of a law once, so that it is compiled.

        The failure of a law of another package is recorded; ConfigError if that law is in force.
        """
        changed = self.config.model_copy(update={"law": law.name})
        try:
            _call_every_step(law, changed.params(), changed)
        # The code of a package may raise anything; it must not end a session that uses another law.
        except Exception as error:
            if law.name not in PACKAGE_LAWS.found:
                raise
            self._failing[law.name] = f"law {law.name}: fails in its first step: {described(error)}"
            if law.name == self.config.law:
                raise ConfigError(self._failing[law.name]) from error

    def deadline_ns(self) -> int:
        return self.freshness.deadline_ns()

    def on_deadline(self, now_ns: int) -> None:
        """Detect a stall of this process; all other actions of a controller follow from messages."""
        if self.begin_turn(now_ns):
            self.forget()

    def rejects(self, received: Received) -> bool:
        """Return whether a message is too old to act on; after a stall of this process, forget the earlier signals."""
        if self.begin_turn(received.received_ns - self.clock.epoch_offset_ns):
            self.forget()
        if (reason := self.freshness.rejection(received)) is None:
            return False
        if reason:
            self.event("fault", "warning", reason, topic=received.topic, source=received.message.src)
        self.stale += 1
        return True

    @abstractmethod
    def timing_of(self, config: ControllerConfig) -> TimingParams:
        """Return the timing constants of this half."""

    @property
    def heard(self) -> NewestSignal:
        """Arrival of the newest signal of the other half, and the stamp of the hand's sample that it answers [ns]."""
        heard: NewestSignal = self.memory.timing.heard
        return heard

    def forget(self) -> None:
        """Forget the signal of the other half, and wait for the next one."""
        self.half.signal = NO_SIGNAL
        self.state = "safe"

    def make_safe(self) -> None:
        """Do nothing: the silence of a controller makes the devices safe."""

    def on_control(self, control: SessionControl) -> str:
        """Change the law or its parameters: dotted keys below `controller`, such as virtual_impedance.force_gain."""
        if control.command != "set":
            return super().on_control(control)
        changed = changed_config(self.config, control.parameters)
        if changed.law in self._failing:
            raise RefusedError(self._failing[changed.law])
        if text := changed.refused_laws.get(changed.law):
            raise RefusedError(text)
        if changed.lateral.mode == "direct" and self.config.lateral.mode != "direct":
            raise RefusedError("lateral.mode cannot be set back to direct: the tip would jump to the place of the hand")
        switched = changed.law != self.config.law
        before = self.config.law_config()
        if not switched and self.touches and (text := self.law.changed_in_contact(before, changed.law_config())):
            raise RefusedError(text)
        if not switched and self.law_state is not None:
            self.law_state = self.retuned(self.params, changed.params())
        self._adopt(changed)
        self.half.told |= "law" in control.parameters
        if switched:
            self._switch()
        return "set " + ", ".join(f"{key} = {value}" for key, value in control.parameters.items())

    def _adopt(self, config: ControllerConfig) -> None:
        self.config = self.half.config = config
        self.params, self.timing_params = config.params(), self.timing_of(config)
        self.law = KNOWN_LAWS[config.law]
        self._band = config.deadband.to_params()
        self.lateral = config.lateral_params()
        self.hand_limits = config.hand_params()

    def _switch(self) -> None:
        half = self.half
        half.signal = NO_SIGNAL
        half.band = initial_deadband_state(NO_SIGNAL)
        half.port = energy.opened(half.port.position_m, half.port.force_n)
        half.reported_j = 0.0
        # Before the first tick no law has run yet, so there is no state to take over.
        half.switching = self.law_state is not None

    @property
    @abstractmethod
    def touches(self) -> bool:
        """Whether the tip is in contact, by the newest message that this half has."""

    @abstractmethod
    def retuned(self, old: Any, new: Any) -> Any:
        """Return the state of this half after a change of parameters, such that its device does not jump."""

    @abstractmethod
    def started(self) -> Any:
        """Return the initial state of this half of the law."""

    def capture(self) -> Any:
        self.half.law = None if self.law_state is None else part(self.law_state)
        self.half.steps, self.half.freshness = self.steps, self.freshness.capture()
        return self.memory

    def restore(self, state: Any, find: FindInput) -> None:
        self.memory = state
        self.half = half = state.half
        if half.config is not None:
            self._adopt(half.config)
        self.law_state = None if half.law is None else half.law.like(self.started())
        self.steps = half.steps
        self.freshness.restore(half.freshness)

    @abstractmethod
    def energy_account(self) -> EnergyAccount:
        """Return the energy account of this half of the law."""

    def lateral_account(self) -> EnergyTank:
        """Return the energy at the lateral port; zero for a half without one."""
        return NO_ENERGY

    def _is_passive_across(self, across: EnergyTank) -> bool:
        """Return whether the lateral port has given out no more energy than was granted."""
        return across.entered_j + self.lateral.feel.granted_j >= -energy.TOLERANCE_J

    def receive_signal(self, message: TeleopForward | TeleopBackward) -> bool:
        """Store a signal of the other half; return False for one of another law, which counts as silence."""
        half = self.half
        if message.law != self.law.name and not self._joins(message.law):
            return False
        is_new_process = self._is_of_new_process(message)
        # F_s is the reaction along +z, and F_m the push along -z.
        force_n, separation_m, separation_valid, in_contact = to_paper_axis(message.force_n), 0.0, False, False
        # `type` replaces `isinstance`, which message classes implement in Python, so that it takes longer than the rest
        # of this method.
        if type(message) is TeleopBackward:
            force_n, separation_m = message.force_n[2], message.separation_m
            # At the master's half: the lateral force on the tip [N], and the position of the stage [m].
            half.far_lateral, half.far_place = message.force_n[:2], message.position_m[:2]
            separation_valid, in_contact = message.separation_valid, message.in_contact
        else:
            # At the slave's half: the position over the sample that the hand wants for the tip [m].
            half.far_lateral = message.position_m[:2]
        half.signal = port_signal(
            position_m=to_paper_axis(message.position_m),
            velocity_m_per_s=to_paper_axis(message.velocity_m_per_s),
            force_n=force_n,
            wave_sqrt_w=to_paper_axis(message.wave_sqrt_w) if message.wave_sqrt_w is not None else 0.0,
            energy_j=message.energy_j if message.energy_j is not None else 0.0,
            separation_m=separation_m,
            separation_valid=separation_valid,
            # Inactive but in contact: the law then assumes an interruption, and no tip that has to be armed.
            in_contact=in_contact or is_new_process,
            active=message.active and not is_new_process,
        )
        return True

    def _joins(self, law: str) -> bool:
        """Take over the law of the other half if this one does not know better; return whether it is in force now.

        A process that is started again has the law of its scenario, and does not know of a change in the session. The
        command for that may still be on its way to the other half, which then leaves the law of the scenario later.
        """
        half = self.half
        is_possible = law in KNOWN_LAWS and law not in self._failing and law not in self.config.refused_laws
        is_alone = half.config is None and self._silence_s() > DEFAULT_VALIDITY_S
        if half.told or not is_possible or not (half.newest[0] < 0 or is_alone):
            return False
        text = f"law {law} is in force, as at the other site; this half was started with {self.law.name}"
        self.event("mode", "warning", f"{text}, and has the other settings of its start")
        self._adopt(self.config.model_copy(update={"law": law}))
        self._switch()
        return True

    def _is_of_new_process(self, message: TeleopForward | TeleopBackward) -> bool:
        """Return whether the other half has restarted: a lower number than before, but a newer sample of the hand."""
        number, stamp_ns = self.half.newest
        if message.hand_t_ns >= stamp_ns:
            self.half.newest = message.seq, message.hand_t_ns
        return message.seq < number and message.hand_t_ns > stamp_ns

    def latest_signal(self) -> PortSignal:
        """Return the newest signal with the silence since its arrival and the round trip filled in."""
        if self.heard.received_ns < 0:
            return NO_SIGNAL
        # The last two fields depend on the present time; `_replace` would take five times as long.
        return PortSignal(*self.half.signal[:-2], self._silence_s(), self.round_trip_s()[0])

    def round_trip_s(self) -> tuple[float, bool]:
        """Return the age [s] of the hand's sample that the newest answer is about, and whether it is known."""
        return ROUND_TRIP_UNKNOWN

    def signal_fields(self, signal: PortSignal) -> dict[str, object]:
        """Return the fields of a teleop message that both directions have, without the force."""
        half = self.half
        return {
            "law": self.law.name,
            "active": signal.active,
            "position_m": (*half.lateral_m, 0.0 - signal.position_m),
            "velocity_m_per_s": to_site_frame(signal.velocity_m_per_s),
            "wave_sqrt_w": to_site_frame(signal.wave_sqrt_w) if self.law.uses_waves else None,
            "energy_j": signal.energy_j if self.law.uses_energy else None,
            "hand_seq": half.hand_stamp[0],
            "hand_t_ns": half.hand_stamp[1],
        }

    def passes_deadband(self, signal: PortSignal, dt: float) -> bool:
        """Return whether the dead band passes a signal, dt [s] after the last one; all pass while the law changes."""
        half = self.half
        half.band, send = deadband(self._band, half.band, signal, dt)
        return send or half.switching

    def report_status(self, other_energy_j: float | None) -> None:
        """Queue law/status every 10 ms; other_energy_j: energy that entered the other port [J], None if unknown."""
        half = self.half
        if self.steps % self._status_ticks or self.law_state is None:
            return
        account: EnergyAccount = self.energy_account()
        if self.lateral.depth.enabled:
            account = account._replace(granted_j=account.granted_j + 0.5 * self.lateral.feel.granted_j)
        has_other_energy = other_energy_j is not None
        across = self.lateral_account()
        port_j = half.port.energy_j + across.entered_j
        net_j = port_j + (other_energy_j or 0.0)
        round_trip_s, measured = self.round_trip_s()
        entered_j, half.reported_j = port_j - half.reported_j, port_j
        offered = half.band.offered
        self._status = {
            "law": self.law.name,
            "switching": half.switching,
            "port_energy_j": port_j,
            "port_power_w": entered_j / (self._status_ticks * self.config.period_s),
            "net_valid": has_other_energy,
            "net_energy_j": net_j if has_other_energy else 0.0,
            "left_j": account.remaining_j,
            "dissipated_j": account.dissipated_j + across.spilled_j,
            # Judge both ports separately, so that energy entering at the lateral port does not hide a fault of the law.
            "passive": bool(energy.is_passive(net_j - across.entered_j, has_other_energy, account))
            and self._is_passive_across(across),
            "saved_percent": 100.0 * (offered - half.band.sent) / offered if offered else 0.0,
            "heard": self.heard.received_ns >= 0,
            "silence_s": self._silence_s() if self.heard.received_ns >= 0 else 0.0,
            "round_trip_valid": measured,
            "round_trip_s": round_trip_s,
        }
        self.defer(self._publish_status)

    def _publish_status(self) -> None:
        self.publish("law/status", **self._status)

    def _silence_s(self) -> float:
        return silence_ns(self.heard, self.clock.now_ns()) * 1e-9


def _call_every_step(law: Law, params: Any, config: ControllerConfig) -> None:
    """Call every step of a law, so that none has to be compiled or specialised at the first tick."""
    period_s = config.period_s
    hand, tip = HandSample(0.0, 0.0, 0.0, False), NO_TIP
    state = law.master_resume(params, hand, 0.0)
    state, signal = law.master_send(params, law.master_start(params, hand), hand, period_s)
    state, _ = law.master_receive(params, state, hand, signal, period_s)
    law.master_energy_account(params, state)
    slave, _ = law.slave_receive(params, law.slave_start(params, tip), signal, tip, period_s)
    slave, _ = law.slave_send(params, slave, tip, period_s)
    energy.is_passive(0.0, False, law.slave_energy_account(params, slave))
    law.retune(params, params, state)
    law.slave_retune(params, params, slave)
    deadband(config.deadband.to_params(), initial_deadband_state(signal), signal, period_s)
    clamped(config.clamp_params(), SlaveReference(0.0, True), signal, tip)
    port = energy.moved_to(energy.opened(0.0, 0.0), 0.0, 0.0)
    energy.with_inflow(port, 0.0, 0.0)
    energy.with_outflow(port, 0.0, 0.0)
