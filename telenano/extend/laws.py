"""What a teleoperation law is: a two-port with a master half and a slave half, each a pair of pure steps.

At each tick of the hand the master half first *sends* (the signal that follows from its state and the hand's sample),
and then, when the answer comes or the tick is over, *receives* (integrates, and sets the reference of the device). The
slave half receives first and sends when the instrument has answered. So nothing waits for a timer: with no delay the
force that answers a sample acts within the same tick, which is what the equations of the paper assume.

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
    """A sample of the operator's device: x_m [m], its velocity [m/s], F_m [N]; `following`: it obeys commands."""

    position_m: float
    velocity_m_per_s: float
    force_n: float
    following: bool


class TipMeasurement(NamedTuple):
    """What the AFM measured: base x_s applied [m], F_s [N], h [m] where known; `following`: it obeys commands.

    `outstanding_m`: how far commands that it had not carried out by then will still move the base [m].
    """

    base_position_m: float
    force_n: float
    separation_m: float
    separation_valid: bool
    in_contact: bool
    following: bool
    outstanding_m: float


class PortSignal(NamedTuple):
    """The signal from one half of a law to the other, at the slave's scale; `PortSignal()` is that before any came.

    The receiver fills in the last two. `silence_s` is the time since the newest signal arrived (large when none ever
    did); a law decides for itself what is too long. `round_trip_s`, at the master only, is the age of the hand's sample
    that the signal answers, on the hand's clock and at the time of use: what a predictor has to bridge. It is a whole
    number of periods, 0.0 where the answer belongs to the present tick, and grows with every tick without a new signal.
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
    """Return a signal from what a law says by name; what it does not say is zero or false.

    The defaults are those of a step and not of the tuple, because numba does not fill in defaults of a tuple.
    """
    return PortSignal(
        position_m, velocity_m_per_s, force_n, wave_sqrt_w, energy_j, separation_m, separation_valid, in_contact,
        active, silence_s, round_trip_s,
    )  # fmt: skip


@compiled
def tip_signal(
    tip: TipMeasurement, position_m: float, force_n: float, wave_sqrt_w: float = 0.0, energy_j: float = 0.0
) -> PortSignal:
    """Return the signal of a slave half: the state of its tip, and what its law sends with it."""
    return PortSignal(
        position_m, 0.0, force_n, wave_sqrt_w, energy_j, tip.separation_m, tip.separation_valid, tip.in_contact,
        tip.following, 0.0, 0.0,
    )  # fmt: skip


class MasterReference(NamedTuple):
    """What the operator's device is to do: follow position_m, or, where `active` is false, be off.

    `force_n` is the force of the environment at the hand's scale, for devices that render it and for the record.
    """

    position_m: float
    velocity_m_per_s: float
    force_n: float
    active: bool


class SlaveReference(NamedTuple):
    """What the AFM is to do: base reference x_sr [m]; where `active` is false it stays where it is.

    Until the tip follows (`TipMeasurement.following`), a half gives the hand's own reference as an active one: by it
    the rig places the tip, also before the hand is coupled.
    """

    position_m: float
    active: bool


class EnergyAccount(NamedTuple):
    """What a half of a law knows about energy, at the hand's scale [J].

    remaining_j: received and not yet given out or sent on; dissipated_j: taken out on purpose by the controller;
    granted_j: what the law lets itself have at the start, and by which its two ports may fall below passivity.
    """

    remaining_j: float
    dissipated_j: float
    granted_j: float


# time without a message after which a half starts again, instead of bridging it by many steps [periods]
LONGEST_BRIDGED_PERIODS = 50


def longest_pause_periods(silence_limit_s: float, period_s: float) -> int:
    """Return the longest pause of signals, in periods, after which a slave half does not start again."""
    return max(LONGEST_BRIDGED_PERIODS, round(silence_limit_s / period_s))


NO_SIGNAL = PortSignal()
# before the instrument has said anything
NO_TIP = TipMeasurement(
    base_position_m=0.0,
    force_n=0.0,
    separation_m=0.0,
    separation_valid=False,
    in_contact=False,
    following=False,
    outstanding_m=0.0,
)

# Params and states are NamedTuples of the law's own, so the table of laws cannot name them: each law's module does.
Steps = Callable[..., Any]


@compiled
def no_energy_account(params: Any, state: Any) -> EnergyAccount:
    """Return the account of a law that keeps none."""
    return EnergyAccount(0.0, 0.0, 0.0)


@compiled
def kept(old: Any, new: Any, state: Any) -> Any:
    """Return a slave state as it is: what it holds is in metres and newtons of the tip, or nothing."""
    return state


@compiled
def measured_tip(params: Any, state: Any, tip: TipMeasurement, dt: float) -> tuple[Any, PortSignal]:
    """Send the measured state of the tip back."""
    return state, tip_signal(tip, tip.base_position_m, tip.force_n)


def the_hands_force(params: Any, force_n: float) -> float:
    """Return the force of the hand [N]: what a law rests at that loses none of it."""
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

    - `master_energy_account(params, state) -> EnergyAccount` and `slave_energy_account`: what the half knows of energy
    - `rest_force(params, force) -> float`: alpha_f F_s [N] at which the law rests in contact under a constant force F_m
      of the hand [N]; a law that leaves it out is not judged by it
    - `sample_drift(params, state) -> (speed, error)`: how fast the sample recedes, by the master half, and the standard
      error of that [m/s]; the half warns of one that hand and tip cannot stay together on

    The slave half steps on each signal, and, where `local_loop` is set, also each time that the instrument has stepped
    by itself, with the newest signal and the time since; what `slave_send` returns then is not sent. So its local loop
    continues with the measured force while nothing arrives. dt of both is whole periods, as `paced` counts them, so
    that the half's time is the hand's: at least one on a signal, none between signals for a half that is not behind. A
    half that only follows a reference steps by one period a call, whatever dt is. With a local loop `slave_send`
    accounts for steps that the instrument has carried out, so its dt is the sum of theirs. Where a signal comes before
    the instrument has answered the one before, that one is answered with dt = 0 and the state dropped.

    `uses_waves` and `uses_energy`: which optional parts of the wire message the law fills.

    `link_loop`: whether a force or motion of the tip acts on the hand as it comes back, so that the loop through line
    and instrument has a gain, and a slow instrument makes it swing. A law whose hand meets a model of the contact, or
    whose hand moves no tip, has none; a loop at the instrument alone is `local_loop`, and its settings state the
    stiffness that it tolerates. `passive`: whether the law states that its two ports together give out no more than its
    accounts say that it was granted, over any line; `passive_within_j`: by how much more at the most [J], for the steps
    that it has not accounted for yet. `must_know`: the settings of its section that have to be those of
    the instrument or the sample, because the law computes with them and cannot measure them.

    `fixed_in_contact`: the settings, besides both scales, that a rig refuses to change while the tip touches, because
    the force or the energy in store is stated in them and would jump. All others change live, without a step of the
    force of more than 5 % (`telenano law check`).
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
        """Return why a change of the settings has to wait until the tip is off the sample; empty where it has not."""
        keys = [key for key in self.all_fixed_in_contact() if getattr(before, key) != getattr(after, key)]
        if not keys:
            return ""
        return (
            f"{self.name}.{' and '.join(keys)} cannot be changed while the tip touches: force and stored energy at"
            " the hand are stated in it and would jump; take the tip off the sample first"
        )

    def all_fixed_in_contact(self) -> tuple[str, ...]:
        """Return the settings that stay while the tip touches: both scales, and what the law names."""
        return (*_SCALES, *self.fixed_in_contact)

    @classmethod
    def of(cls, module: str, config: type[BaseModel], *, slave: ModuleType | None = None, **given: Any) -> "Law":
        """Return the law that a module has written down: it has the module's name, and its steps are those of `Law`.

        Args:
            module: The `__name__` of the module, which calls this below its last step.
            config: The model of the law's section.
            slave: The module with the steps of the slave half, if that is another one.
            given: What the law says of itself by the fields of `Law` that have defaults, and steps that the module does
                not write down itself. A law whose module has no `rest_force` loses none of the hand's force;
                `rest_force=None` is one that is not judged by it.

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
    """Return what an installed package calls a law; TypeError or ValueError says what keeps it from being one."""
    if not isinstance(value, Law):
        raise TypeError(f"is a {type(value).__name__}, must be a Law")
    if value.name != name:
        raise ValueError(f"calls itself {value.name}")
    missing = [field for field in _SHARED_FIELDS if field not in value.config.model_fields]
    if missing:
        raise ValueError(f"its settings lack {', '.join(missing)}")
    for field in ("must_know", "fixed_in_contact"):
        if unknown := [key for key in getattr(value, field) if key not in value.config.model_fields]:
            raise ValueError(f"its settings have no {', '.join(unknown)}, which {field} names")
    if not hasattr(value.config, "to_params"):
        raise ValueError("its settings have no to_params(period_s)")
    return value


# Every section of a law has these fields, so code that does not know the law may use them.
_SHARED_FIELDS = ("position_scale", "force_scale", "silence_limit_s")


# the most periods of one step of the slave half: its force is that of the beginning
MOST_PERIODS_A_STEP = 3


@compiled
def paced(behind: int, elapsed: int, silent: int) -> tuple[int, int]:
    """Return how many periods the slave half is behind the hand after its next step, and the periods of that step.

    Its calls come with signals that are late, lost and overtaken, and from an instrument that waits a period and a half
    for the next: they are no clock. So a step is as many periods long as the half is behind, and none long between
    signals if it is not.

    Args:
        behind: How many periods the half is behind the hand before the step; negative is ahead.
        elapsed: The periods of the hand that a signal brings, 0 for a step between signals.
        silent: The whole periods since the last signal.
    """
    behind += elapsed
    periods = min(max(behind + silent, 1 if elapsed > 0 else 0), MOST_PERIODS_A_STEP)
    return behind - periods, periods
