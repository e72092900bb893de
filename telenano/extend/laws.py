"""The interface of a teleoperation law: a two-port with a master half and a slave half, each a pair of pure steps.

At each tick of the hand the master half first *sends* (the signal that follows from its state and the hand's sample),
and then, when the answer comes or the tick is over, *receives* (integrates, and sets the reference of the device). The
slave half receives first, and sends when the instrument has answered. Thus nothing waits for a timer: without delay the
force that answers a sample acts within the same tick, as the equations of the paper assume.

All quantities are scalars along the paper's axis, towards the sample: x_m, F_m (force of the operator), x_s, F_s (force
on the tip, repulsive positive, that is, along -x).
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any, NamedTuple

from pydantic import BaseModel

from telenano.numerics.compiler import compiled


class HandSample(NamedTuple):
    """A sample of the operator's device: x_m [m], its velocity [m/s], F_m [N]; `following`: it follows commands."""

    position_m: float
    velocity_m_per_s: float
    force_n: float
    following: bool


class TipMeasurement(NamedTuple):
    """A measurement of the AFM: base x_s applied [m], F_s [N], h [m] if known; `following`: it follows commands.

    `outstanding_m`: distance that pending commands will still move the base [m].
    """

    base_position_m: float
    force_n: float
    separation_m: float
    separation_valid: bool
    in_contact: bool
    following: bool
    outstanding_m: float


class PortSignal(NamedTuple):
    """The signal from one half of a law to the other, at the slave's scale; `PortSignal()` stands for none so far.

    The receiver fills in the last two fields. `silence_s` is the time since the newest signal arrived (large if none
    ever did); each law defines how long is too long. `round_trip_s`, at the master only, is the age of the hand's
    sample that the signal answers, by the hand's clock and at the time of use, which a predictor must bridge. It is a
    whole number of periods, 0.0 if the answer belongs to the present tick, and grows with each tick without a signal.
    """

    position_m: float = 0.0
    velocity_m_per_s: float = 0.0
    force_n: float = 0.0
    wave_sqrt_w: float = 0.0
    energy_j: float = 0.0
    separation_m: float = 0.0
    separation_valid: bool = False
    in_contact: bool = False
    active: bool = False
    silence_s: float = 1e9
    round_trip_s: float = 0.0


@compiled
def port_signal(
    position_m: float,
    velocity_m_per_s: float = 0.0,
    force_n: float = 0.0,
    wave_sqrt_w: float = 0.0,
    energy_j: float = 0.0,
    separation_m: float = 0.0,
    separation_valid: bool = False,
    in_contact: bool = False,
    active: bool = False,
    silence_s: float = 0.0,
    round_trip_s: float = 0.0,
) -> PortSignal:
    """Return a signal with the fields that a law passes by keyword; the others are zero or False.

    This step has defaults because numba does not fill in those of a tuple.
    """
    return PortSignal(
        position_m, velocity_m_per_s, force_n, wave_sqrt_w, energy_j, separation_m, separation_valid, in_contact,
        active, silence_s, round_trip_s,
    )  # fmt: skip


@compiled
def tip_signal(
    tip: TipMeasurement, position_m: float, force_n: float, wave_sqrt_w: float = 0.0, energy_j: float = 0.0
) -> PortSignal:
    """Return the signal of a slave half: the state of its tip, and the quantities of its law."""
    return PortSignal(
        position_m, 0.0, force_n, wave_sqrt_w, energy_j, tip.separation_m, tip.separation_valid, tip.in_contact,
        tip.following, 0.0, 0.0,
    )  # fmt: skip


class MasterReference(NamedTuple):
    """Reference of the operator's device: follow `position_m`, or, if `active` is False, be off.

    `force_n` is the force of the environment at the hand's scale, for devices that render it and for the recording.
    """

    position_m: float
    velocity_m_per_s: float
    force_n: float
    active: bool


class SlaveReference(NamedTuple):
    """Reference of the AFM: base x_sr [m]; if `active` is False the base stays where it is.

    Until the tip follows (`TipMeasurement.following`), a half returns the hand's own reference as an active one: the
    rig uses it to place the tip, even before the hand is coupled.
    """

    position_m: float
    active: bool


class EnergyAccount(NamedTuple):
    """Energy account of one half of a law, at the hand's scale [J].

    remaining_j: received and not yet given out or sent on; dissipated_j: dissipated on purpose by the controller;
    granted_j: initial credit of the law, by which the energy balance of its two ports may fall below zero.
    """

    remaining_j: float
    dissipated_j: float
    granted_j: float


# Time without a message after which a half restarts instead of bridging it by many steps [periods].
LONGEST_BRIDGED_PERIODS = 50


def longest_pause_periods(silence_limit_s: float, period_s: float) -> int:
    """Return the longest pause of signals, in periods, after which a slave half still continues without a restart."""
    return max(LONGEST_BRIDGED_PERIODS, round(silence_limit_s / period_s))


NO_SIGNAL = PortSignal()
# Stands for the measurement before the first one of the instrument.
NO_TIP = TipMeasurement(
    base_position_m=0.0,
    force_n=0.0,
    separation_m=0.0,
    separation_valid=False,
    in_contact=False,
    following=False,
    outstanding_m=0.0,
)

# Params and states are NamedTuples of each law, so the table of laws cannot declare them; each law's module does.
Steps = Callable[..., Any]


@compiled
def no_energy_account(params: Any, state: Any) -> EnergyAccount:
    """Return the account of a law without energy accounting: zeros."""
    return EnergyAccount(0.0, 0.0, 0.0)


@compiled
def kept(old: Any, new: Any, state: Any) -> Any:
    """Return a slave state unchanged, because it has only metres and newtons of the tip, or nothing."""
    return state


@compiled
def measured_tip(params: Any, state: Any, tip: TipMeasurement, dt: float) -> tuple[Any, PortSignal]:
    """Send the measured state of the tip back."""
    return state, tip_signal(tip, tip.base_position_m, tip.force_n)


def the_hands_force(params: Any, force_n: float) -> float:
    """Return the force of the hand [N], the rest force of a law that loses none of it."""
    return force_n


@dataclass(frozen=True)
class Law:
    """A law of the table: its configuration and its compiled steps.

    - `master_start(params, hand) -> state` and `slave_start(params, tip) -> state`: at rest where the device is
    - `master_resume(params, hand, tip_reference_m) -> state`: in motion as `hand` is, so that the first reference
      sent to the tip is tip_reference_m [m]; for taking over from another law
    - `master_send(params, state, hand, dt) -> (state, PortSignal)`
    - `master_receive(params, state, hand, signal, dt) -> (state, MasterReference)`
    - `slave_receive(params, state, signal, tip, dt) -> (state, SlaveReference)`
    - `slave_send(params, state, tip, dt) -> (state, PortSignal)`; without one the measured state of the tip is sent
    - `retune(old, new, state) -> state`: carries a master state over a change of parameters without a jump, and
      `slave_retune` a slave state; a law without one has a slave state that holds nothing of its parameters

    - `master_energy_account(params, state) -> EnergyAccount` and `slave_energy_account`: energy account of the half
    - `rest_force(params, force) -> float`: alpha_f F_s [N] at which the law rests in contact under a constant force F_m
      of the hand [N]; a law without this function is not judged by it
    - `sample_drift(params, state) -> (speed, error)`: estimate by the master half of the speed at which the sample
      recedes, and its standard error [m/s]; the half warns of a drift with which hand and tip cannot stay together

    The slave half steps on each signal. With `local_loop` it also steps each time that the instrument has stepped by
    itself, with the newest signal and the time since; the result of `slave_send` is then not sent. Thus its local loop
    continues with the measured force while nothing arrives. dt of both is a whole number of periods, as `paced` counts
    them, so that the half keeps the hand's time: at least one on a signal, and none between signals for a half that is
    not behind. A half that only follows a reference steps by one period per call, whatever dt is. With a local loop
    `slave_send` accounts for the steps that the instrument has carried out, so its dt is the sum of theirs. If a signal
    comes before the instrument has answered the previous one, that one is answered with dt = 0 and the state dropped.

    `uses_waves` and `uses_energy`: whether the law fills these optional parts of the wire message.

    `link_loop`: whether a returning force or motion of the tip acts on the hand, so that the loop through line and
    instrument has a gain, and a slow instrument can make it oscillate. A law in which the hand meets a model of the
    contact, or moves no tip, has no such loop; a loop at the instrument alone is `local_loop`, and its settings state
    the stiffness that it tolerates. `passive`: whether the law claims that its two ports together give out no more
    energy than its accounts grant, over any line; `passive_within_j`: greatest excess over that [J], for steps not yet
    accounted for. `must_know`: the settings of its section that must equal the values of the instrument or the sample,
    because the law computes with them and cannot measure them.

    `fixed_in_contact`: the settings, besides both scales, that a rig refuses to change while the tip touches, because
    the force or the stored energy is expressed in them and would jump. All others can change live, without a step of
    the force of more than 5 % (`telenano law check`).
    """

    name: str
    config: type[BaseModel]
    master_start: Steps
    master_resume: Steps
    master_send: Steps
    master_receive: Steps
    slave_start: Steps
    slave_receive: Steps
    retune: Steps
    slave_send: Steps = measured_tip
    master_energy_account: Steps = no_energy_account
    slave_energy_account: Steps = no_energy_account
    rest_force: Steps | None = None
    sample_drift: Steps | None = None
    uses_waves: bool = False
    uses_energy: bool = False
    local_loop: bool = False
    link_loop: bool = True
    passive: bool = False
    passive_within_j: float = 1e-5
    must_know: tuple[str, ...] = ()
    fixed_in_contact: tuple[str, ...] = ()
    slave_retune: Steps = kept

    def changed_in_contact(self, before: BaseModel, after: BaseModel) -> str:
        """Return a sentence if a change of the settings must wait until the tip is off the sample, else empty."""
        keys = [key for key in self.all_fixed_in_contact() if getattr(before, key) != getattr(after, key)]
        if not keys:
            return ""
        return (
            f"{self.name}.{' and '.join(keys)} cannot be changed while the tip touches: force and stored energy at"
            " the hand are stated in it and would jump; take the tip off the sample first"
        )

    def all_fixed_in_contact(self) -> tuple[str, ...]:
        """Return the settings that are fixed while the tip touches: both scales, and those that the law names."""
        return (*_SCALES, *self.fixed_in_contact)

    @classmethod
    def of(cls, module: str, config: type[BaseModel], *, slave: ModuleType | None = None, **given: Any) -> "Law":
        """Build the law of a module from its name and from its functions with the names of the steps of `Law`.

        Args:
            module: The `__name__` of the module, which calls this below its last step.
            config: The model of the law's section.
            slave: The module with the steps of the slave half, if that is another one.
            given: Fields of `Law` that have defaults, and steps that the module does not define. A law whose module has
                no `rest_force` loses none of the hand's force; with `rest_force=None` it is not judged by it.

        Raises:
            AttributeError: A step is missing; the message names it.
        """
        own = sys.modules[module]
        values: dict[str, Any] = {"rest_force": the_hands_force}
        values |= {step: getattr(own, step) for step in _MASTER_STEPS}
        values |= {step: getattr(slave or own, step) for step in _SLAVE_STEPS}
        values |= {step: getattr(own, step) for step in _OPTIONAL if hasattr(own, step)}
        values |= {step: getattr(slave or own, step) for step in _OPTIONAL_OF_SLAVE if hasattr(slave or own, step)}
        values |= given
        return cls(name=module.rpartition(".")[2], config=config, **values)


_MASTER_STEPS = ("master_start", "master_resume", "master_send", "master_receive", "retune")
_SLAVE_STEPS = ("slave_start", "slave_receive")
_OPTIONAL_OF_SLAVE = ("slave_send", "slave_retune")
_OPTIONAL = ("master_energy_account", "slave_energy_account", "rest_force", "sample_drift")
_SCALES = ("position_scale", "force_scale")


def checked_law(name: str, value: Any) -> Law:
    """Return the law of an installed package after checking it; raise TypeError or ValueError if it is invalid."""
    if not isinstance(value, Law):
        raise TypeError(f"is a {type(value).__name__}, must be a Law")
    if value.name != name:
        raise ValueError(f"is registered under another name than its own, {value.name}")
    missing = [field for field in _SHARED_FIELDS if field not in value.config.model_fields]
    if missing:
        raise ValueError(f"its settings lack {', '.join(missing)}")
    for field in ("must_know", "fixed_in_contact"):
        if unknown := [key for key in getattr(value, field) if key not in value.config.model_fields]:
            raise ValueError(f"its settings have no {', '.join(unknown)}, which {field} names")
    if not hasattr(value.config, "to_params"):
        raise ValueError("its settings have no to_params(period_s)")
    return value


# Every section of a law has these fields, which code for any law uses.
_SHARED_FIELDS = ("position_scale", "force_scale", "silence_limit_s")


# Longest step of the slave half in periods; it is short because the force of a step is that of its beginning.
MOST_PERIODS_A_STEP = 3


@compiled
def paced(behind: int, elapsed: int, silent: int) -> tuple[int, int]:
    """Return the periods by which the slave half lags the hand after its next step, and the length of that step.

    The calls of the slave half are no clock: signals are late, lost or overtaken, and the instrument waits a period and
    a half for the next one. So a step is as many periods long as the half lags, and has length 0 between signals if it
    does not lag.

    Args:
        behind: Periods by which the half lags the hand before the step; negative if it is ahead.
        elapsed: Periods of the hand that a signal brings, 0 for a step between signals.
        silent: Whole periods since the last signal.
    """
    behind += elapsed
    periods = min(max(behind + silent, 1 if elapsed > 0 else 0), MOST_PERIODS_A_STEP)
    return behind - periods, periods
