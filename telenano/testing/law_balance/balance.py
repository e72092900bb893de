"""The energy balance of a law at its two physical ports, over random orders of adverse events.

The bench calls the pure steps of a law like the two nodes, in virtual time, and counts the work at both ports like
`law/status` (telenano/laws/energy.py), at the hand's scale: at the master the measured force of the device times its
displacement, at the slave alpha_f / alpha_p times the mean force times the measured displacement of the base. With the
energy that has entered at both ports, E_net, and the energy that the law states as granted,

    margin = E_net + granted >= 0    at all times, for any motion of hand, sample and line.

This is the change of the stored energy plus the dissipated energy, neither of which is negative for a law that began at
rest. A margin below zero is energy that was neither put in nor stated by the law. It is counted through every
transition: while no law is in force, or a device obeys no command, the ports move without work, and the grant of a
restarting law adds to its earlier grants. Each half states the grant of both ports, so the greater of the two
statements counts.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any, NamedTuple

from pydantic import ValidationError

from telenano.extend.laws import (
    NO_TIP,
    EnergyAccount,
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    TipMeasurement,
    longest_pause_periods,
)
from telenano.numerics import compiled_form
from telenano.testing.law_balance.balance_draws import ALL_KINDS, RETUNES, SILENCES, Event, Order, drawn
from telenano.testing.law_balance.balance_loop import (
    RETRACTED_M,
    UNHEARD,
    LoopConditions,
    Now,
    World,
    empty_books,
    known_as,
    stretch,
)
from telenano.testing.law_balance.balance_world import (
    Arm,
    Contact,
    hand_of,
    lines_of,
    pressed,
    quantised,
    sample_of,
    stiffest_n_per_m,
    within,
)
from telenano.wire import RefusedError

# The silence limit of a law whose settings have none [s].
SILENCE_LIMIT_S = 0.2
# Greatest stiffness of drawn samples, as a share of the law's stated limit: over a line that loses signals, a loop
# against the measured force tolerates 7/16 of it.
_STIFFEST_SHARE = 0.4
_ARMED_S = 0.1
# Number of periods whose run as plain Python takes as long as compiling a law.
_PLAIN_PERIODS = 400_000


class Loss(NamedTuple):
    """Energy that was generated after a transition: its name, time of the least margin [s], and total energy [J]."""

    transition: str
    at_s: float
    made_j: float


@dataclass
class Balance:
    """The result of an order for a law; energies at the hand's scale [J].

    tolerance_j: energy that the law may generate, by its own statement, beyond its grants; margin_j, at_s: the least
    margin, and its time [s]; granted_j: energy stated as granted at the end; reference_j: the least margin with the
    master's port counted at the law's reference instead of the device; books_j: the least margin minus the energies
    that the law states as dissipated and as remaining: below zero it states more than there is; unstated_j: the
    greatest energy that came out between two moments beyond that which came in, was granted, or was stated at the first
    moment, with the hand at rest, as remaining in the halves and in transit (0 or negative): it is negative for a law
    that stores energy without stating it, or generates energy while a session dissipates more elsewhere; entered_j:
    E_net at the end; begun_s: time at which the margin fell below the tolerance, None if it did not; losses: energies
    by which the margin fell to a new least below zero, by the preceding transition; happened: the transitions in order;
    refused: number of changes of parameters that were refused, by the law, by its ranges, or because the sample would
    be stiffer than it states; contact_share: share of the periods in which the tip touched the sample.
    """

    order: Order
    tolerance_j: float
    margin_j: float = 0.0
    at_s: float = 0.0
    granted_j: float = 0.0
    reference_j: float = 0.0
    books_j: float = 0.0
    unstated_j: float = 0.0
    entered_j: float = 0.0
    begun_s: float | None = None
    losses: list[Loss] = field(default_factory=list)
    happened: list[tuple[float, str]] = field(default_factory=list)
    refused: int = 0
    contact_share: float = 0.0

    @property
    def is_kept(self) -> bool:
        """Whether the law generated no energy beyond the tolerance."""
        return self.begun_s is None

    def sentence(self) -> str:
        """Return a sentence: how much energy was generated, when, and after which transitions."""
        if self.is_kept:
            return f"{self.order.name}: kept, least margin {1e3 * self.margin_j:.3g} mJ at {self.at_s:.3f} s"
        before = [f"{what} at {when:.3f} s" for when, what in self.happened if when <= (self.begun_s or 0.0)][-4:]
        worst = sorted(self.losses, key=lambda loss: -loss.made_j)[:3]
        made = ", ".join(f"{1e3 * loss.made_j:.3g} mJ behind {loss.transition!r}" for loss in worst)
        return (
            f"{self.order.name}: {-1e3 * self.margin_j:.4g} mJ more came out by {self.at_s:.3f} s than went in and was"
            f" granted ({1e3 * self.granted_j:.3g} mJ); first at {self.begun_s:.3f} s, after"
            f" {', '.join(before) or 'nothing but the start'}; {made}"
        )


def states_passivity(law: Law) -> bool:
    """Return whether a law claims passivity: that its ports give out no more than came in and was granted."""
    return law.passive


def silence_limit_s(config: Any) -> float:
    """Return the silence after which a law releases the hand [s], from its settings; 0.2 if they have none."""
    return float(getattr(config, "silence_limit_s", SILENCE_LIMIT_S))


def tolerance_j(law: Law, order: Order, config: Any, stiffest_n_per_m: float) -> float:
    """Return the energy that a law may generate in an order beyond its grants [J], computed before the order is run.

    It is the law's own statement plus the effect of a base that moves in steps of a quantum q: it may go q/2 further
    than was paid for, against the greatest force F of the hand, and the sample then takes F q/2 + K q^2/2 before the
    law has measured that.
    """
    step_m = order.base_quantum_m / config.position_scale
    stiffest = stiffest_n_per_m * config.force_scale * config.position_scale
    step_j = 0.5 * order.hand.most_n * step_m + 0.5 * stiffest * step_m * step_m
    return float(law.passive_within_j + step_j)


def balance(law: Law, order: Order, settings: Mapping[str, Any] | None = None, *, fast: bool = False) -> Balance:
    """Run an order against a law.

    Args:
        law: The law.
        order: An order from `drawn`.
        settings: The settings of the law's section; others have their defaults.
        fast: Whether to run compiled, which pays for many orders; the first one then waits for the compiler.

    Raises:
        ValidationError: A setting is unknown or out of its range.
    """
    return _Run(law, order, law.config.model_validate(dict(settings or {})), fast=fast).result()


def worst_balances(
    law: Law,
    kinds: Iterable[str] = ALL_KINDS,
    *,
    seed: int = 1,
    cases: int = 8,
    longest_s: float = 240.0,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, list[Balance]]:
    """Return the results of a law in the draws of each kind of transition, the worst first.

    Args:
        law: The law.
        kinds: Kinds of `ALL_KINDS`.
        seed: The seed of the draws.
        cases: The number of draws of each kind.
        longest_s: The longest order [s].
        settings: The settings of the law's section.
    """
    limit_s = silence_limit_s(law.config.model_validate(dict(settings or {})))
    worst = {}
    for kind in kinds:
        orders = [drawn(seed, case, kind, limit_s, longest_s) for case in range(cases)]
        fast = sum(order.duration_s / order.period_s for order in orders) > _PLAIN_PERIODS
        done = [balance(law, order, settings, fast=fast) for order in orders]
        worst[kind] = sorted(done, key=lambda one: one.margin_j)
    return worst


class _Run:
    """One run of an order; scaled quantities are at the hand's scale unless their name says tip or base."""

    def __init__(self, law: Law, order: Order, config: Any, *, fast: bool) -> None:
        self.law, self.order, self.period_s, self.fast = law, order, order.period_s, fast
        self.config, self.slave_config = config, config
        self.ticks = round(order.duration_s / self.period_s)
        self.master_params = self.slave_params = config.to_params(self.period_s)
        known_as(type(self.master_params), law)
        softer = 1.0
        self.stiffest = stiffest_n_per_m(order.sample, self.period_s)
        limit = self._stiffness_limit(config)
        if limit is not None:
            softer = min(1.0, _STIFFEST_SHARE * limit / self.stiffest)
            self.stiffest *= softer
        forward, backward = lines_of(order, self.ticks)
        self.world = World(
            period_s=self.period_s,
            hand=hand_of(order.hand, self.ticks, Random(order.seed)),
            sample=sample_of(order.sample, softer, self.ticks, self.period_s),
            forward=forward,
            backward=backward,
            hand_least_m=order.hand_travel_m[0],
            hand_most_m=order.hand_travel_m[1],
            base_least_m=order.base_travel_m[0],
            base_most_m=order.base_travel_m[1],
            hand_quantum_n=order.hand_quantum_n,
            hand_quantum_m=order.hand_quantum_m,
            tip_quantum_n=order.tip_quantum_n,
            base_quantum_m=order.base_quantum_m,
            carried=1.0 - math.exp(-2.0 * math.pi * order.servo_hz * self.period_s) if order.servo_hz else 1.0,
        )
        hand = HandSample(0.0, 0.0, 0.0, False)
        self.now = Now(
            *(0.0, 0.0, 0.0, RETRACTED_M, 0.0),
            arm=Arm(0.0, 0.0, 0.0, False),
            contact=Contact(-1.0, 0.0, False),
            hand=hand,
            tip=NO_TIP,
            reference=MasterReference(0.0, 0.0, 0.0, False),
            master_switching=False,
            slave_switching=False,
            heard_tick=UNHEARD,
            heard_hand_tick=UNHEARD,
            heard=PortSignal(),
            slave_tick=UNHEARD,
            hand_tick=UNHEARD,
            slave_heard=PortSignal(),
            behind=0,
            last_sample_tick=-1,
            forward_at=0,
            forward_newest=-1,
            backward_at=0,
            backward_newest=-1,
        )
        self.running: list[Event] = []
        self.retracted, self.reign, self.off_until = True, 0, 0
        self._measured(0, following=False)
        self.master = law.master_start(self.master_params, hand)
        self.slave = law.slave_start(self.slave_params, self.now.tip)
        self.books = empty_books()
        self.retunes: list[tuple[int, Any]] = []
        self.result_ = Balance(order, tolerance_j(law, order, config, self.stiffest))

    def _stiffness_limit(self, config: Any) -> float | None:
        if not hasattr(config, "stiffness_limit_n_per_m"):
            return None
        return float(config.stiffness_limit_n_per_m(self.period_s))

    def result(self) -> Balance:
        """Run the order to its end."""
        order, result, label, first, begun = self.order, self.result_, "the start", 0, 0
        starts = sorted(order.events, key=lambda event: event.start_s)
        while first < self.ticks:
            now_s = first * self.period_s
            if first == round(_ARMED_S / self.period_s):
                self._arm()
            for event in [one for one in self.running if self._tick_of(one.ends_s) <= first]:
                self.running.remove(event)
                label = f"the end of {event.kind}"
                result.happened.append((now_s, label))
                self._end(event, first)
            while begun < len(starts) and self._tick_of(starts[begun].start_s) <= first:
                event = starts[begun]
                begun += 1
                label = event.kind
                result.happened.append((now_s, label))
                if self._begin(event, first):
                    self.running.append(event)
            for event in self.running:
                # A device that is off is moved halfway through, so that the law sees it off at its new place.
                if event.kind == "resume" and self._tick_of(0.5 * (event.start_s + event.ends_s)) == first:
                    self._shift_device(event.shift_m)
            while self.retunes and self.retunes[0][0] <= first:
                self._retune_slave(self.retunes.pop(0)[1])
            last = self._next(first, starts[begun:])
            self._stretch(first, last, label)
            first = last
        books = self.books
        result.entered_j = books.hand_j + books.tip_j
        result.margin_j, result.at_s, result.granted_j = books.least, books.at_s, books.granted_j
        result.begun_s = None if books.begun_s < 0.0 else books.begun_s
        result.reference_j, result.books_j = books.least_reference_j, books.books_j
        result.unstated_j = books.unstated_j
        result.contact_share = books.touched / max(self.ticks, 1)
        return result

    def _tick_of(self, time_s: float) -> int:
        """Return the first period that begins no earlier than a time [s]."""
        return math.ceil(time_s / self.period_s - 1e-9)

    def _next(self, first: int, coming: Sequence[Event]) -> int:
        """Return the period after `first` in which the next event begins, changes or ends."""
        moments = [self.ticks, round(_ARMED_S / self.period_s), *(tick for tick, _ in self.retunes)]
        moments += [self._tick_of(event.start_s) for event in coming[:1]]
        moments += [self._tick_of(event.ends_s) for event in self.running]
        halves = (event for event in self.running if event.kind == "resume")
        moments += [self._tick_of(0.5 * (event.start_s + event.ends_s)) for event in halves]
        return min(moment for moment in moments if moment > first)

    def _stretch(self, first: int, last: int, label: str) -> None:
        """Run the periods up to the next event, and attribute energy generated in them to the previous event."""
        kinds = {event.kind for event in self.running}
        let_go = next((event for event in self.running if event.kind == "let go"), None)
        hand_lost = next((event for event in self.running if event.kind == "hand lost"), None)
        limit_s = silence_limit_s(self.slave_config)
        held = LoopConditions(
            off=bool(kinds & {"off", "resume", "hand lost", "switch"}),
            away="switch" in kinds,
            retracted=self.retracted,
            lost="instrument lost" in kinds,
            stalls="instrument stalls" in kinds,
            silent_forward=bool(kinds & {"silence forward", "silence both"}),
            silent_backward=bool(kinds & {"silence backward", "silence both"}),
            hand_lost_since=-1 if hand_lost is None else self._tick_of(hand_lost.start_s),
            off_until=self.off_until,
            let_go_s=-1.0 if let_go is None else float(let_go.start_s),
            slow_s=0.0 if let_go is None else float(let_go.slow_s),
            reign=self.reign,
            local_loop=self.law.local_loop,
            longest=longest_pause_periods(limit_s, self.period_s),
            silence_limit_s=limit_s,
            position_scale=self.slave_config.position_scale,
            force_scale=self.slave_config.force_scale,
        )
        before = self.books.least
        given = (self.master_params, self.slave_params, self.master, self.slave, self.world, held, self.now, self.books)
        run = compiled_form(stretch) if self.fast else stretch
        self.master, self.slave, self.now, self.books = run(*given, first, last, self.result_.tolerance_j)
        if self.books.least < before:
            made_j, losses = before - self.books.least, self.result_.losses
            made_j += sum(loss.made_j for loss in losses if loss.transition == label)
            self.result_.losses = [loss for loss in losses if loss.transition != label]
            self.result_.losses.append(Loss(label, self.books.at_s, made_j))

    # -- transitions --------------------------------------------------------------------------------------------------

    def _begin(self, event: Event, tick: int) -> bool:
        """Begin an event; return whether it has an end."""
        if event.kind in RETUNES:
            self._retune(event, tick)
            return False
        if event.kind == "arm":
            self.retracted = True
        elif event.kind == "switch":
            self.reign += 1
            self.now = self.now._replace(reference=self.now.reference._replace(active=False))
        elif event.kind == "instrument lost":
            self.now = self.now._replace(tip=self.now.tip._replace(following=False))
        return True

    def _end(self, event: Event, tick: int) -> None:
        self._shift_device(event.shift_m if event.kind in ("arm", "switch", "hand lost") else 0.0)
        if event.kind == "arm":
            self._arm()
        elif event.kind == "switch":
            self._shift_base(event.tip_shift_m)
            self._resume(tick)
        elif event.kind == "hand lost":
            # A device that was moved has been restarted, and is off at first; one that only stalled is in its place.
            self.off_until = tick + 3 if event.shift_m else tick
        elif event.kind == "instrument lost":
            self._shift_base(event.tip_shift_m)
            self.now = self.now._replace(asked_m=self.now.base_m)
            self._measured(tick, following=True)
            self._restart(of_master=False)
            self.slave = self.law.slave_start(self.slave_params, self.now.tip)

    def _shift_device(self, way_m: float) -> None:
        x_m = within(self.now.x_m + way_m, *self.order.hand_travel_m)
        self.now = self.now._replace(x_m=x_m)

    def _shift_base(self, way_m: float) -> None:
        self.now = self.now._replace(base_m=within(self.now.base_m + way_m, *self.order.base_travel_m))

    def _arm(self) -> None:
        """Move the base to its reference, as an instrument does when it is armed."""
        self.retracted = False
        asked_m = quantised(self.now.asked_m, self.order.base_quantum_m)
        self.now = self.now._replace(base_m=within(asked_m, *self.order.base_travel_m))

    def _measured(self, tick: int, *, following: bool) -> None:
        """Update the measurement at the tip, between two periods."""
        contact, force_n = pressed(self.world.sample, self.now.contact, self.now.base_m, tick, self.period_s)
        force_n = quantised(force_n, self.order.tip_quantum_n)
        touches = contact.depth_m >= 0.0 or force_n != 0.0
        tip = TipMeasurement(self.now.base_m, force_n, -contact.depth_m, True, touches, following, 0.0)
        self.now = self.now._replace(contact=contact, tip=tip)

    def _restart(self, *, of_master: bool) -> None:
        """Book grants and dissipation of the slave half, or of both, before a restart; remaining energy is lost."""
        books = self.books
        if of_master:
            now, none = books.master_now, EnergyAccount(0.0, 0.0, 0.0)
            books = books._replace(
                master_before_j=books.master_before_j + now.granted_j,
                dissipated_before_j=books.dissipated_before_j + now.dissipated_j,
                master_now=none,
            )
        now = books.slave_now
        self.books = books._replace(
            slave_before_j=books.slave_before_j + now.granted_j,
            dissipated_before_j=books.dissipated_before_j + now.dissipated_j,
            slave_now=EnergyAccount(0.0, 0.0, 0.0),
        )

    def _resume(self, tick: int) -> None:
        """Restart the law at the positions of device and base, as after a change to another law and back."""
        self.now = self.now._replace(asked_m=self.now.base_m)
        is_lost = any(event.kind == "instrument lost" for event in self.running)
        self._measured(tick, following=not self.retracted and not is_lost)
        self._restart(of_master=True)
        reference = MasterReference(self.now.x_m, 0.0, 0.0, True)
        hand = HandSample(reference.position_m, 0.0, self.now.hand.force_n, self.now.hand.following)
        self.master = self.law.master_resume(self.master_params, hand, self.now.base_m)
        self.slave = self.law.slave_start(self.slave_params, self.now.tip)
        self.now = self.now._replace(
            reference=reference,
            master_switching=True,
            slave_switching=True,
            heard_tick=UNHEARD,
            heard=PortSignal(),
            slave_tick=UNHEARD,
            slave_heard=PortSignal(),
        )

    def _is_away(self) -> bool:
        return any(event.kind == "switch" for event in self.running)

    def _retune(self, event: Event, tick: int) -> None:
        """Change one parameter at the master, and schedule the change at the slave after the delay of the line."""
        properties = self.config.model_json_schema()["properties"]
        keys = sorted(key for key, schema in properties.items() if schema.get("type") in ("number", "integer"))
        key = keys[int(event.pick * len(keys))]
        schema, old = properties[key], getattr(self.config, key)
        value = min(max(old * event.factor, schema.get("minimum", -math.inf)), schema.get("maximum", math.inf))
        value = round(value) if schema["type"] == "integer" else value
        text = f"retune of {key} from {old:.4g} to {value:.4g}"
        self.result_.happened[-1] = (self.result_.happened[-1][0], text)
        try:
            config = type(self.config).model_validate({**self.config.model_dump(), key: value})
            params = config.to_params(self.period_s)
            limit = self._stiffness_limit(config)
            # The law makes no claim for a sample that is stiffer than its new limit.
            if limit is not None and self.stiffest > 1.2 * _STIFFEST_SHARE * limit:
                raise RefusedError(f"{key}: the sample would be stiffer than the law states")
            if self.now.tip.in_contact and (reason := self.law.changed_in_contact(self.config, config)):
                raise RefusedError(reason)
            if not self._is_away():
                self.master = self.law.retune(self.master_params, params, self.master)
        except (RefusedError, ValidationError):
            self.result_.refused += 1
            return
        self.config, self.master_params = config, params
        self.retunes.append((tick + round(self.order.line.forward_s / self.period_s), config))

    def _retune_slave(self, config: Any) -> None:
        params = config.to_params(self.period_s)
        if not self._is_away():
            self.slave = self.law.slave_retune(self.slave_params, params, self.slave)
        self.slave_config, self.slave_params = config, params


__all__ = ["SILENCES", "Balance", "Loss", "balance", "drawn", "silence_limit_s", "states_passivity", "worst_balances"]
