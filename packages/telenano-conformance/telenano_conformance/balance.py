"""The balance of energy of a law at its two physical ports, over orders that an adversary draws.

The bench calls the pure steps of a law as the two nodes do, in virtual time, and counts the work at both ports as
`law/status` counts it (telenano/laws/energy.py), at the hand's scale: at the master the force that the device
measured over the way that the device went, at the slave alpha_f / alpha_p times the mean force over the way of the base
that the instrument measured. With the energy that has come in at both, E_net, and what the law states as granted,

    margin = E_net + granted >= 0    at all times, whatever hand, sample and line do.

That is the change of what is stored, plus what was dissipated, and neither is negative for a law that began at rest.
A margin below zero is energy that was not put in and that the law does not state. It is counted through every
transition: while no law is in force, or a device obeys no command, the ports are moved without work, and what a law
grants itself when it begins again adds to what it granted before. Each half states what it grants to both ports, so the
greater of the two statements counts.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from random import Random
from typing import Any, NamedTuple

from pydantic import ValidationError

from telenano.extend.laws import (
    EnergyAccount,
    HandSample,
    Law,
    MasterReference,
    PortSignal,
    TipMeasurement,
    longest_pause_periods,
    paced,
)
from telenano.wire import RefusedError
from telenano_conformance.balance_draws import BEGINS_S, KINDS, MIXED, SILENCES, Event, Order, drawn
from telenano_conformance.balance_world import HandModel, SampleModel, lines_of, quantised, stiffest_n_per_m

# 10 uJ: a thousandth of what a hand of 1 N does over a centimetre, and far above the rounding of the sums.
TOLERANCE_J = 1e-5
# The silence limit of a law whose settings have none [s].
SILENCE_LIMIT_S = 0.2
# The share of the stiffest sample that a law states, up to which samples are drawn: over a line that loses signals a
# loop against the measured force tolerates 7/16 of it.
_STIFFEST_SHARE = 0.4
_ARMED_S = 0.1
_RETRACTED_M = -2e-7
# A hand whose device is lost is silent for this time before the master half continues with an inactive one [s].
_LOST_S = 1.0
_LONGEST_BRIDGED_PERIODS = 50
_UNHEARD = -(10**9)
# A virtual mass of a law that moves no faster has no energy worth naming [m/s].
_AT_REST_M_PER_S = 1e-3


class Loss(NamedTuple):
    """Energy that was made behind a transition: which, when it was the worst [s], and how much in all there [J]."""

    transition: str
    at_s: float
    made_j: float


@dataclass
class Balance:
    """What an order did to a law.

    margin_j, at_s: the least margin, and when [J, s]; granted_j: what the law stated as granted in the end;
    reference_j: the least margin where the master's port is counted at the reference of the law instead of the device;
    books_j: the least of the margin less what the law states as dissipated and as left to give out: below zero it
    states more than there is; unstated_j: the most that came out between two moments beyond what came in, was granted,
    and was stated at the first of them, where the hand stood, as left at the halves and in transit between them (0 or
    negative): a law that stores energy of which it states nothing has it here, and one that makes energy while a
    session dissipates more elsewhere as well; entered_j: E_net in the end; begun_s: when the margin fell below the
    tolerance, None where it did not; losses: where the margin fell to a new least below zero, by the transition before
    it; happened: the transitions in order; refused: changes of parameters that were refused, by the law, by its ranges,
    or because the sample would be stiffer than it states; contact_share: of the periods, in which the tip touched.
    """

    order: Order
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
        """Whether the law made no energy beyond the tolerance."""
        return self.begun_s is None

    def sentence(self) -> str:
        """Say what happened: how much energy was made, when, and behind which transitions."""
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
    """Return whether a law states that its two ports give out no more than it says that it was granted."""
    return law.passive


def silence_limit_s(config: Any) -> float:
    """Return the silence after which a law lets go [s], from its settings; 0.2 where they state none."""
    return float(getattr(config, "silence_limit_s", SILENCE_LIMIT_S))


def balance(law: Law, order: Order, settings: Mapping[str, Any] | None = None) -> Balance:
    """Run an order against a law.

    Args:
        law: The law.
        order: What happens, from `drawn`.
        settings: The settings of the law's section; those not given have their defaults.

    Raises:
        ValidationError: A setting is unknown or out of its range.
    """
    return _Run(law, order, law.config.model_validate(dict(settings or {}))).result()


def worst_balances(
    law: Law,
    kinds: Iterable[str] = (*KINDS, MIXED),
    *,
    seed: int = 1,
    cases: int = 8,
    longest_s: float = 240.0,
    settings: Mapping[str, Any] | None = None,
) -> dict[str, list[Balance]]:
    """Return what a law did in the draws of each kind of transition, the worst first.

    Args:
        law: The law.
        kinds: Kinds of `KINDS`, or `MIXED`.
        seed: The seed of the draws.
        cases: How many draws there are of each kind.
        longest_s: The longest order [s].
        settings: The settings of the law's section.
    """
    limit_s = silence_limit_s(law.config.model_validate(dict(settings or {})))
    worst = {}
    for kind in kinds:
        done = [balance(law, drawn(seed, case, kind, limit_s, longest_s), settings) for case in range(cases)]
        worst[kind] = sorted(done, key=lambda one: one.margin_j)
    return worst


class _Granted:
    """What a half has granted over all the times that it was started."""

    def __init__(self) -> None:
        self.before, self.now = EnergyAccount(0.0, 0.0, 0.0), EnergyAccount(0.0, 0.0, 0.0)

    def restart(self) -> None:
        b, n = self.before, self.now
        # what was left to give out when the half ended is lost
        self.before = EnergyAccount(0.0, b.dissipated_j + n.dissipated_j, b.granted_j + n.granted_j)
        self.now = EnergyAccount(0.0, 0.0, 0.0)


class _Run:
    """One run of an order; what is scaled belongs to the hand's scale unless its name says tip or base."""

    def __init__(self, law: Law, order: Order, config: Any) -> None:
        self.law, self.order, self.period_s = law, order, order.period_s
        self.config = config
        rng = Random(order.seed)
        self.master_params = self.slave_params = config.to_params(self.period_s)
        self.slave_config = config
        self.hand_model = HandModel(order.hand, rng, 0.0)
        softer = 1.0
        self.stiffest = stiffest_n_per_m(order.sample, self.period_s)
        limit = self._stiffness_limit(config)
        if limit is not None:
            softer = min(1.0, _STIFFEST_SHARE * limit / self.stiffest)
            self.stiffest *= softer
        self.sample = SampleModel(order.sample, softer)
        self.forward, self.backward = lines_of(order.line, self.period_s, rng)
        self.x_m = self.velocity = 0.0
        self.base_m, self.asked_m = _RETRACTED_M, 0.0
        self.retracted, self.is_lost = True, False
        self.hand_lost_since: int | None = None
        self.off_until_tick = 0
        self.hand = HandSample(0.0, 0.0, 0.0, False)
        self.tip = self._measured(0.0, following=False)
        self.master = law.master_start(self.master_params, self.hand)
        self.slave = law.slave_start(self.slave_params, self.tip)
        self.reference = MasterReference(0.0, 0.0, 0.0, False)
        self.force_n = 0.0
        # the line
        self.reign, self.away = 0, False
        self.master_switching = self.slave_switching = False
        self.heard_tick, self.heard = _UNHEARD, PortSignal()
        self.slave_tick, self.slave_heard, self.hand_tick, self.behind = _UNHEARD, PortSignal(), _UNHEARD, 0
        self.last_sample_tick = -1
        self.retunes: list[tuple[int, Any]] = []
        # the books
        self.master_books, self.slave_books = _Granted(), _Granted()
        self.hand_j = self.tip_j = self.reference_j = 0.0
        self.least = 0.0
        # the energy counters of the signals, sent and heard: forward, backward
        self.sent_j, self.heard_j = [0.0, 0.0], [0.0, 0.0]
        self.least_stored = math.inf
        self.touched = 0
        self.result_ = Balance(order)

    def _stiffness_limit(self, config: Any) -> float | None:
        if not hasattr(config, "stiffness_limit_n_per_m"):
            return None
        return float(config.stiffness_limit_n_per_m(self.period_s))

    def result(self) -> Balance:
        """Run the order to its end."""
        order, result = self.order, self.result_
        starts = sorted(order.events, key=lambda event: event.start_s)
        ticks, running = round(order.duration_s / self.period_s), list[Event]()
        label, begun = "the start", 0
        for tick in range(ticks):
            now_s = tick * self.period_s
            if tick == round(_ARMED_S / self.period_s):
                self._arm()
            for event in [one for one in running if one.ends_s <= now_s]:
                running.remove(event)
                label = f"the end of {event.kind}"
                result.happened.append((now_s, label))
                self._end(event, tick)
            while begun < len(starts) and starts[begun].start_s <= now_s:
                event = starts[begun]
                begun += 1
                label = event.kind
                result.happened.append((now_s, label))
                if self._begin(event, tick):
                    running.append(event)
            for event in running:
                # a device that is off is moved halfway through, so that the law sees it off at its new place
                if event.kind == "resume" and 0.0 <= now_s - 0.5 * (event.start_s + event.ends_s) < self.period_s:
                    self._shift_device(event.shift_m)
            self._tick(tick, now_s, running)
            self._judge(now_s, label)
        result.entered_j = self.hand_j + self.tip_j
        result.contact_share = self.touched / max(ticks, 1)
        return result

    # -- transitions --------------------------------------------------------------------------------------------------

    def _begin(self, event: Event, tick: int) -> bool:
        """Begin an event; return whether it has an end."""
        if event.kind == "retune":
            self._retune(event, tick)
            return False
        if event.kind == "arm":
            self.retracted = True
        elif event.kind == "switch":
            self.away, self.reign = True, self.reign + 1
            self.reference = self.reference._replace(active=False)
        elif event.kind == "hand lost":
            self.hand_lost_since = tick
        elif event.kind == "instrument lost":
            self.is_lost = True
            self.tip = self.tip._replace(following=False)
        return True

    def _end(self, event: Event, tick: int) -> None:
        self._shift_device(event.shift_m if event.kind in ("arm", "switch", "hand lost") else 0.0)
        if event.kind == "arm":
            self._arm()
        elif event.kind == "switch":
            self._shift_base(event.tip_shift_m)
            self._resume(tick)
        elif event.kind == "hand lost":
            self.hand_lost_since = None
            # one that was moved was begun again, and is off at first; one that was held up is where it was
            self.off_until_tick = tick + 3 if event.shift_m else tick
        elif event.kind == "instrument lost":
            self.is_lost = False
            self._shift_base(event.tip_shift_m)
            self.asked_m = self.base_m
            self.tip = self._measured(tick * self.period_s, following=True)
            self.slave_books.restart()
            self.slave = self.law.slave_start(self.slave_params, self.tip)

    def _shift_device(self, way_m: float) -> None:
        least, most = self.order.hand_travel_m
        self.x_m = min(max(self.x_m + way_m, least), most)

    def _shift_base(self, way_m: float) -> None:
        least, most = self.order.base_travel_m
        self.base_m = min(max(self.base_m + way_m, least), most)

    def _arm(self) -> None:
        """Bring the base to where it was asked to be, as the instrument does that is armed."""
        self.retracted = False
        self._go_to(self.asked_m)

    def _resume(self, tick: int) -> None:
        """Take the law up again from the places of device and base, as after a change from another law and back."""
        self.away = False
        self.asked_m = self.base_m
        following = not self.retracted and not self.is_lost
        self.tip = self._measured(tick * self.period_s, following=following)
        self.master_books.restart()
        self.slave_books.restart()
        self.reference = MasterReference(self.x_m, 0.0, 0.0, True)
        self.master = self._resumed(self.base_m)
        self.slave = self.law.slave_start(self.slave_params, self.tip)
        self.master_switching = self.slave_switching = True
        self.heard_tick, self.heard = _UNHEARD, PortSignal()
        self.slave_tick, self.slave_heard = _UNHEARD, PortSignal()

    def _resumed(self, tip_m: float) -> Any:
        hand = HandSample(self.reference.position_m, 0.0, self.hand.force_n, self.hand.following)
        return self.law.master_resume(self.master_params, hand, tip_m)

    def _retune(self, event: Event, tick: int) -> None:
        """Change one parameter at the master, and at the slave when the line has brought it there."""
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
            # a sample that the law states to be too stiff for it then is no case of its claim
            if limit is not None and self.stiffest > 1.2 * _STIFFEST_SHARE * limit:
                raise RefusedError(f"{key}: the sample would be stiffer than the law states")
            if self.tip.in_contact and (reason := self.law.changed_in_contact(self.config, config)):
                raise RefusedError(reason)
            if not self.away:
                self.master = self.law.retune(self.master_params, params, self.master)
        except (RefusedError, ValidationError):
            self.result_.refused += 1
            return
        self.config, self.master_params = config, params
        self.retunes.append((tick + round(self.order.line.forward_s / self.period_s), config))

    def _retune_slave(self, tick: int) -> None:
        while self.retunes and self.retunes[0][0] <= tick:
            config = self.retunes.pop(0)[1]
            params = config.to_params(self.period_s)
            if not self.away:
                self.slave = self.law.slave_retune(self.slave_params, params, self.slave)
            self.slave_config, self.slave_params = config, params

    # -- a tick -------------------------------------------------------------------------------------------------------

    def _tick(self, tick: int, now_s: float, running: list[Event]) -> None:
        kinds = {event.kind for event in running}
        self._retune_slave(tick)
        is_off = bool(kinds & {"off", "resume", "hand lost"}) or self.away or tick < self.off_until_tick
        self._move_hand(now_s, running, device_obeys=not is_off)
        forward_silent = bool(kinds & {"silence forward", "silence both"})
        backward_silent = bool(kinds & {"silence backward", "silence both"})
        if self.away:
            self._idle_slave(now_s)
            return
        master_runs = self.hand_lost_since is None or (tick - self.hand_lost_since) * self.period_s >= _LOST_S
        dt = self.period_s
        if master_runs:
            pause = tick - self.last_sample_tick
            dt = self.period_s * (1 if pause > _LONGEST_BRIDGED_PERIODS else pause)
            self.last_sample_tick = tick
            hand = self.hand._replace(following=False) if self.master_switching else self.hand
            self.master, signal = self.law.master_send(self.master_params, self.master, hand, dt)
            self.sent_j[0] = signal.energy_j
            self.forward.put(tick, (self.reign, tick, signal), silent=forward_silent)
        self._run_slave(tick, now_s, backward_silent)
        arrived = self.backward.take(tick)
        if arrived is not None and arrived[0] == self.reign:
            self.heard_tick, self.heard = tick, arrived[2]
            self.heard_hand_tick, self.heard_j[1] = arrived[1], arrived[2].energy_j
            if self.master_switching:
                self.master_switching = False
                self.master = self._resumed(self.heard.position_m if self.heard.active else self.base_m)
        if master_runs:
            self._run_master(tick, dt)

    def _move_hand(self, now_s: float, running: list[Event], *, device_obeys: bool) -> None:
        """Let the device go to its reference, under the force that the hand has held since the last tick."""
        order, before, was = self.order, self.x_m, self.hand
        least, most = order.hand_travel_m
        following = device_obeys and self.reference.active
        # a device that is off stands, and one that was moved by something else has done so already
        start_m = self.x_m
        if following:
            self.x_m = min(max(quantised(self.reference.position_m, order.hand_quantum_m), least), most)
        self.velocity = (self.x_m - start_m) / self.period_s
        measured_n = quantised(self.force_n, order.hand_quantum_n)
        self.hand = HandSample(self.x_m, self.velocity, measured_n, following)
        if following and was.following and not self.master_switching:
            self.hand_j += measured_n * (self.x_m - before)
        grip = 1.0
        for event in running:
            if event.kind == "let go":
                since_s = now_s - event.start_s
                grip = 0.0 if since_s >= event.slow_s else 1.0 - since_s / event.slow_s
        if now_s < 0.5 * BEGINS_S:
            grip = 0.0
        self.force_n = self.hand_model.force_n(now_s, grip, self.x_m, self.velocity, self.period_s)

    def _run_master(self, tick: int, dt: float) -> None:
        if self.master_switching:
            return
        before = self.reference
        silent = 0 if self.heard_tick == tick else tick + 1 - self.heard_tick
        signal = PortSignal()
        if self.heard_tick != _UNHEARD:
            trip_s = max(0, tick - self.heard_hand_tick) * self.period_s
            signal = self.heard._replace(silence_s=silent * self.period_s, round_trip_s=trip_s)
        self.master, self.reference = self.law.master_receive(self.master_params, self.master, self.hand, signal, dt)
        if before.active and self.reference.active:
            self.reference_j += self.hand.force_n * (self.reference.position_m - before.position_m)

    def _run_slave(self, tick: int, now_s: float, silent: bool) -> None:
        arrived = self.forward.take(tick)
        if arrived is not None and arrived[0] != self.reign:
            arrived = None
        if arrived is None:
            self._continue(tick, now_s)
            return
        _, hand_tick, signal = arrived
        self.heard_j[0] = signal.energy_j
        self.slave_switching = self.slave_switching and not signal.active
        elapsed = hand_tick - self.hand_tick
        longest = longest_pause_periods(silence_limit_s(self.slave_config), self.period_s)
        self.hand_tick, self.slave_tick, self.slave_heard = hand_tick, tick, signal
        if elapsed > longest:
            elapsed, self.behind = 1, 0
            if not self.slave_switching:
                self.slave = self.law.slave_receive(
                    self.slave_params, self.slave, PortSignal(), self.tip, self.period_s
                )[0]
        if self.is_lost:
            # the instrument says nothing, so the half answers with what it knew, as one that does not follow
            self.slave, answer = self.law.slave_send(self.slave_params, self.slave, self.tip, self.period_s)
        else:
            answer = self._step_slave(signal, elapsed, 0, now_s)
        self.sent_j[1] = answer.energy_j
        self.backward.put(tick, (self.reign, hand_tick, answer), silent=silent)

    def _continue(self, tick: int, now_s: float) -> None:
        """Continue without a signal: a half with a loop of its own steps with the instrument, the others stand."""
        silent = tick - self.slave_tick
        counts = silent * self.period_s <= silence_limit_s(self.slave_config)
        follows = self.slave_heard.active and self.tip.following and not self.slave_switching and not self.is_lost
        if self.law.local_loop and counts and follows:
            signal = self.slave_heard._replace(silence_s=silent * self.period_s)
            self._step_slave(signal, 0, silent, now_s)
        else:
            self._idle_slave(now_s)

    def _step_slave(self, signal: PortSignal, elapsed: int, silent: int, now_s: float) -> PortSignal:
        """Step the half and the instrument, which carries a command out at once; return the answer."""
        self.behind, periods = paced(self.behind, elapsed, silent)
        dt = periods * self.period_s
        if self.slave_switching:
            self.slave = self.law.slave_start(self.slave_params, self.tip)
        else:
            self.slave, wanted = self.law.slave_receive(self.slave_params, self.slave, signal, self.tip, dt)
            if wanted.active:
                self.asked_m = wanted.position_m
        self._go_to(self.asked_m)
        self._measure(now_s)
        answer: PortSignal
        self.slave, answer = self.law.slave_send(self.slave_params, self.slave, self.tip, dt)
        return answer

    def _go_to(self, place_m: float) -> None:
        least, most = self.order.base_travel_m
        if self.retracted:
            self.base_m = _RETRACTED_M
        else:
            self.base_m = min(max(quantised(place_m, self.order.base_quantum_m), least), most)

    def _idle_slave(self, now_s: float) -> None:
        """Let the instrument measure where it stands."""
        if self.is_lost:
            self.sample.force_n(self.base_m, now_s, self.period_s)
        else:
            self._go_to(self.base_m if not self.retracted else self.asked_m)
            self._measure(now_s)

    def _measured(self, now_s: float, *, following: bool) -> TipMeasurement:
        depth_m = self.sample.depth_m(self.base_m, now_s)
        force_n = quantised(self.sample.force_n(self.base_m, now_s, self.period_s), self.order.tip_quantum_n)
        return TipMeasurement(self.base_m, force_n, -depth_m, True, depth_m >= 0.0 or force_n != 0.0, following, 0.0)

    def _measure(self, now_s: float) -> None:
        was = self.tip
        self.tip = self._measured(now_s, following=not self.retracted)
        if was.following and self.tip.following and not self.away:
            config = self.slave_config
            way_m = (self.tip.base_position_m - was.base_position_m) / config.position_scale
            self.tip_j -= config.force_scale * 0.5 * (self.tip.force_n + was.force_n) * way_m
        self.touched += self.tip.in_contact

    # -- the books ----------------------------------------------------------------------------------------------------

    def _judge(self, now_s: float, label: str) -> None:
        law, m, s, result = self.law, self.master_books, self.slave_books, self.result_
        if not self.away:
            m.now = law.master_energy_account(self.master_params, self.master)
            s.now = law.slave_energy_account(self.slave_params, self.slave)
        granted = max(m.before.granted_j + m.now.granted_j, s.before.granted_j + s.now.granted_j)
        result.granted_j = granted
        margin = self.hand_j + self.tip_j + granted
        stated = m.now.remaining_j + s.now.remaining_j + m.now.dissipated_j + s.now.dissipated_j
        stated += m.before.dissipated_j + s.before.dissipated_j
        result.books_j = min(result.books_j, margin - stated)
        result.reference_j = min(result.reference_j, self.reference_j + self.tip_j + granted)
        if not math.isfinite(margin):
            margin = -math.inf
        if self.away:
            self.least_stored, self.sent_j, self.heard_j = math.inf, [0.0, 0.0], [0.0, 0.0]
        else:
            if abs(self.velocity) < _AT_REST_M_PER_S:
                on_its_way = sum(max(sent - heard, 0.0) for sent, heard in zip(self.sent_j, self.heard_j, strict=True))
                stored = max(m.now.remaining_j, 0.0) + max(s.now.remaining_j, 0.0) + on_its_way
                self.least_stored = min(self.least_stored, stored - margin)
            result.unstated_j = min(result.unstated_j, margin + self.least_stored)
        if margin >= self.least:
            return
        made, self.least = self.least - margin, margin
        result.margin_j, result.at_s = margin, now_s
        if margin < -TOLERANCE_J and result.begun_s is None:
            result.begun_s = now_s
        for place, loss in enumerate(result.losses):
            if loss.transition == label:
                result.losses[place] = Loss(label, now_s, loss.made_j + made)
                return
        result.losses.append(Loss(label, now_s, made))


__all__ = ["SILENCES", "Balance", "Loss", "balance", "drawn", "silence_limit_s", "states_passivity", "worst_balances"]
