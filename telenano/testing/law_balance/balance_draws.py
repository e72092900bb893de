"""What an adversary does to a law at its two ports: orders of events drawn from a seed, by somebody who knows no law.

An order is a world (hand, sample, line, ends of travel, sensors) and events with their times. Whatever its hand does,
a passive law gives out no more than came in and what it states as granted, so a draw needs no judgement of what is
fair. The share of each case is in this file, so that a table over draws can be made again from the seed.

Every kind of transition is drawn by itself, so that what is lost there is not covered by what other parts of a
session dissipate, and in a mixture of all kinds. Events come back with a period in most draws: energy that is made at
one of them is then a slope over minutes, while what a passive law has stored is a constant.
"""

import math
from dataclasses import dataclass, field, replace
from random import Random

# what an order does again and again, apart from what the hand and the sample do anyway
KINDS = (
    "hold",
    "let go",
    "off",
    "resume",
    "arm",
    "retune",
    "switch",
    "silence forward",
    "silence backward",
    "silence both",
    "end of travel: hand",
    "end of travel: base",
    "hand lost",
    "instrument lost",
    "quantised force",
)
MIXED = "mixed"
# These are a line, a sample, an instrument and an arm that are worse than those of the orders above.
ADVERSE = (
    "line that steps",
    "line that overtakes",
    "line in bursts",
    "line that loses",
    "sample that jumps",
    "sample that creeps",
    "instrument stalls",
    "slow servo",
    "resonant arm",
    "retune in contact",
)
EVERYTHING = "everything"
ALL_KINDS = (*KINDS, MIXED, *ADVERSE, EVERYTHING)
RETUNES = ("retune", "retune in contact")
# the kinds that are a property of the world, and have no events of their own
_WITH_EVENTS = ("instrument stalls", "retune in contact")
_OF_THE_WORLD = ("hold", "end of travel: hand", "end of travel: base", "quantised force")
# the kinds that have events
_TRANSITIONS = tuple(name for name in KINDS if name not in _OF_THE_WORLD)
SILENCES = ("silence forward", "silence backward", "silence both")

# The length of a silence is drawn between these multiples of the limit that a law states for silences.
_LEAST_SILENCE = 0.1
_MOST_SILENCE = 3.0
# The stiffness of a hand is drawn between these.
_LEAST_HAND_N_PER_M = 100.0
_MOST_HAND_N_PER_M = 3000.0
# The stiffness of a sample is drawn between these.
_LEAST_SAMPLE_N_PER_M = 0.02
_MOST_SAMPLE_N_PER_M = 30.0
# A delay is drawn up to this.
_MOST_DELAY_S = 0.2
# A drift of the sample is drawn up to this, either way.
_MOST_DRIFT_M_PER_S = 0.5e-9
# An instrument that stands for longer is lost: the slave half is without its state for longer than the deadline [s].
_LONGEST_STALL_S = 0.05
# before this time the instrument is armed, and the line has brought a first answer [s]
BEGINS_S = 1.0
_DURATIONS_S = (20.0, 60.0, 120.0, 240.0)
_PERIODS_S = (5e-4, 1e-3, 2e-3)


@dataclass(frozen=True)
class HandDraw:
    """A hand: a mass that an active force moves, and a grip of spring and damper that pushes and pulls the device.

    mass_kg; stiffness_n_per_m and damping_n_s_per_m of the grip; arm_n_s_per_m, the damper of the arm; bare: the force
    acts on the device without mass and grip. The active force is push_n + swing_n times a wave of `shape` (sine, square
    or wander) with rate_hz, and against_n_s_per_m times the velocity of the device: positive takes work, negative
    gives it. most_n: the most that the hand exerts [N].
    """

    mass_kg: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    arm_n_s_per_m: float
    bare: bool
    push_n: float
    swing_n: float
    rate_hz: float
    shape: str
    against_n_s_per_m: float
    most_n: float = 10.0


@dataclass(frozen=True)
class SampleDraw:
    """A sample: surface at place_m that drifts, a spring that only pushes, and what takes work.

    viscous_n_s_per_m acts in contact and only pushes; hysteresis: the share by which unloading is stiffer than
    loading; adhesion_n holds the tip back until it has left the surface by adhesion_m. Drift is positive away from the
    tip: the sample recedes. The surface jumps away by jump_m and back, every jump_every_s; it creeps away by creep_m
    ln(1 + t / 1 s).
    """

    stiffness_n_per_m: float
    place_m: float
    drift_m_per_s: float
    viscous_n_s_per_m: float
    hysteresis: float
    adhesion_n: float
    adhesion_m: float
    jump_m: float = 0.0
    jump_every_s: float = 1.0
    creep_m: float = 0.0


@dataclass(frozen=True)
class LineDraw:
    """A line: the least delay each way [s], and the share of messages that it loses, in bursts of a mean length.

    shape: how the delay changes: constant; in steps, to up to spread_s more, every every_s; as a sawtooth that falls
    from spread_s to none in every_s, which overtakes where it is steep; random, by up to spread_s from message to
    message, which overtakes all the time; slots, at whose ends, every every_s, all messages come at once.
    """

    forward_s: float
    backward_s: float
    lost: float
    shape: str = "constant"
    spread_s: float = 0.0
    every_s: float = 1.0
    burst: float = 1.0


@dataclass(frozen=True)
class Event:
    """What happens from start_s on for lasts_s [s].

    Args:
        kind: One of `KINDS` that has events.
        start_s: When it begins, since the start of the order [s].
        lasts_s: How long it lasts [s]; 0 for what has no duration, such as a change of a parameter.
        pick: A number in [0, 1) by which one of several is chosen: the parameter that is changed.
        factor: By how much a parameter is multiplied.
        shift_m: By how much the device is moved meanwhile by something else than the law [m].
        tip_shift_m: The same for the base [m].
        slow_s: The time over which a hand lets go [s].
    """

    kind: str
    start_s: float
    lasts_s: float
    pick: float = 0.0
    factor: float = 1.0
    shift_m: float = 0.0
    tip_shift_m: float = 0.0
    slow_s: float = 0.0

    @property
    def ends_s(self) -> float:
        return self.start_s + self.lasts_s


@dataclass(frozen=True)
class Order:
    """One draw: a world and what happens in it.

    hand_travel_m and base_travel_m: the ends of travel, least and most [m]; hand_quantum_n and tip_quantum_n, the steps
    of the measured forces [N], 0 for none; hand_quantum_m and base_quantum_m, those of the positions [m]; servo_hz: the
    bandwidth of the instrument's servo, 0 for one that carries a command out within a period.
    """

    name: str
    kind: str
    seed: int
    period_s: float
    duration_s: float
    hand: HandDraw
    sample: SampleDraw
    line: LineDraw
    hand_travel_m: tuple[float, float]
    base_travel_m: tuple[float, float]
    hand_quantum_n: float = 0.0
    tip_quantum_n: float = 0.0
    hand_quantum_m: float = 0.0
    base_quantum_m: float = 0.0
    servo_hz: float = 0.0
    events: tuple[Event, ...] = field(default=())


def drawn(seed: int, case: int, kind: str, silence_limit_s: float = 0.2, longest_s: float = 240.0) -> Order:
    """Return the order of a number.

    Args:
        seed: The seed of all draws.
        case: The number of the draw.
        kind: One of `ALL_KINDS`.
        silence_limit_s: The silence after which the law says that it lets go [s].
        longest_s: The longest order [s].

    Raises:
        ValueError: No such kind.
    """
    if kind not in ALL_KINDS:
        raise ValueError(f"{kind} is no kind of order: known are {', '.join(ALL_KINDS)}")
    name = f"{seed} {kind} {case}"
    rng = Random(name)
    # The events have numbers of their own, so that a shorter order is the beginning of the longer one.
    event_rng = Random(f"{name} events")
    duration_s = min(rng.choices(_DURATIONS_S, (2, 4, 2, 2))[0], longest_s)
    is_mixed = kind in (MIXED, EVERYTHING)
    ends_hand = kind == "end of travel: hand" or (is_mixed and rng.random() < 0.4)
    ends_base = kind == "end of travel: base" or (is_mixed and rng.random() < 0.3)
    quantised = kind == "quantised force" or (is_mixed and rng.random() < 0.4)
    events: tuple[Event, ...] = ()
    if kind in ADVERSE and kind not in _WITH_EVENTS:
        # every second one has a transition besides, in which a half may lose hold of the other one
        if rng.random() < 0.5:
            events = _events(event_rng, event_rng.choice(_TRANSITIONS), duration_s, silence_limit_s)
    elif kind not in _OF_THE_WORLD:
        events = _events(event_rng, kind, duration_s, silence_limit_s)
    elif kind.startswith("end of travel") and rng.random() < 0.5:
        # an end of travel matters most where a half loses hold of the other one meanwhile
        events = _events(event_rng, event_rng.choice(SILENCES), duration_s, silence_limit_s)
    reach_m = _log(rng, 3e-4, 8e-3) if ends_hand else 1.0
    sample = _sample(rng)
    order = Order(
        name=name,
        kind=kind,
        seed=rng.getrandbits(48),
        period_s=rng.choices(_PERIODS_S, (1, 8, 3))[0],
        duration_s=duration_s,
        hand=_hand(rng),
        sample=sample,
        line=_line(rng),
        hand_travel_m=(-reach_m * rng.uniform(0.2, 1.0), reach_m),
        base_travel_m=_base_travel(rng, sample.place_m) if ends_base else (-1e-4, 1e-4),
        hand_quantum_n=_log(rng, 2e-3, 0.1) if quantised else 0.0,
        tip_quantum_n=_log(rng, 2e-11, 2e-9) if quantised else 0.0,
        hand_quantum_m=rng.choice((0.0, 1e-6, 1e-5)) if quantised else 0.0,
        base_quantum_m=rng.choice((0.0, 1e-11, 1e-10)) if quantised else 0.0,
        events=events,
    )
    return order if kind in KINDS or kind == MIXED else _worse(order, Random(f"{name} world"))


def _worse(order: Order, rng: Random) -> Order:
    """Return an order with what is worse in its kind; one of everything has each by chance."""

    def has(kind: str) -> bool:
        return order.kind == kind or (order.kind == EVERYTHING and rng.random() < 0.4)

    line, sample, hand, servo_hz = order.line, order.sample, order.hand, order.servo_hz
    reach_m = order.hand_travel_m
    if has("line that steps"):
        line = replace(line, shape="steps", spread_s=_log(rng, 5e-3, _MOST_DELAY_S), every_s=_log(rng, 0.05, 5.0))
    if has("line that overtakes"):
        shape, spread_s = rng.choice(("sawtooth", "random")), _log(rng, 2e-3, 0.1)
        line = replace(line, shape=shape, spread_s=spread_s, every_s=_log(rng, 2e-3, 1.0))
    if has("line in bursts"):
        line = replace(line, shape="slots", every_s=_log(rng, 3e-3, 0.15))
    if has("line that loses"):
        line = replace(line, lost=rng.uniform(0.02, 0.4), burst=rng.choice((1.0, _log(rng, 2.0, 100.0))))
    if has("sample that jumps"):
        sample = replace(sample, jump_m=_side(rng) * _log(rng, 1e-10, 5e-9), jump_every_s=_log(rng, 0.02, 5.0))
    if has("sample that creeps"):
        sample = replace(sample, creep_m=_side(rng) * _log(rng, 1e-10, 1e-8))
    if has("slow servo"):
        servo_hz = _log(rng, 15.0, 200.0)
    if has("resonant arm"):
        swings = rng.random() < 0.7
        mass, stiffness = _log(rng, 0.05, 3.0), _log(rng, _LEAST_HAND_N_PER_M, _MOST_HAND_N_PER_M)
        own_hz = math.sqrt(stiffness / mass) / (2.0 * math.pi)
        hand = replace(
            hand,
            mass_kg=mass,
            stiffness_n_per_m=stiffness,
            damping_n_s_per_m=2.0 * _log(rng, 1e-3, 0.05) * math.sqrt(mass * stiffness),
            arm_n_s_per_m=_log(rng, 0.05, 1.0),
            bare=False,
            swing_n=_log(rng, 0.1, 2.0) if swings else 0.0,
            rate_hz=own_hz * rng.uniform(0.7, 1.3),
            shape=rng.choice(("sine", "square")),
        )
    if order.kind == "retune in contact":
        hand = replace(hand, push_n=abs(hand.push_n))
        sample = replace(sample, place_m=min(sample.place_m, 0.0))
    if order.kind in ADVERSE and rng.random() < 0.3:
        # a device that is at the end of its travel makes each of them worse
        most_m = _log(rng, 3e-4, 8e-3)
        reach_m = (-most_m * rng.uniform(0.2, 1.0), most_m)
    return replace(order, line=line, sample=sample, hand=hand, servo_hz=servo_hz, hand_travel_m=reach_m)


def _side(rng: Random) -> float:
    return rng.choice((-1.0, 1.0))


def _base_travel(rng: Random, place_m: float) -> tuple[float, float]:
    """Return ends of travel of the base on both sides of the place of the surface and of the start [m]."""
    return min(place_m, 0.0) - _log(rng, 2e-10, 1e-8), max(place_m, 0.0) + _log(rng, 2e-9, 4e-8)


def _log(rng: Random, least: float, most: float) -> float:
    return math.exp(rng.uniform(math.log(least), math.log(most)))


def _hand(rng: Random) -> HandDraw:
    mass = _log(rng, 0.2, 3.0)
    stiffness = _log(rng, _LEAST_HAND_N_PER_M, _MOST_HAND_N_PER_M)
    # A hand that moves dissipates much in any law, which would cover what is lost at a transition.
    still = rng.random() < 0.65
    return HandDraw(
        mass_kg=mass,
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=2.0 * rng.uniform(0.05, 0.7) * math.sqrt(mass * stiffness),
        arm_n_s_per_m=_log(rng, 1.0, 30.0),
        bare=rng.random() < 0.35,
        push_n=rng.choice((-1.0, 1.0, 1.0, 1.0, 1.0)) * _log(rng, 0.2, 4.0),
        swing_n=0.0 if still else _log(rng, 0.1, 4.0),
        rate_hz=_log(rng, 0.03, 8.0),
        shape=rng.choice(("sine", "sine", "square", "wander")),
        against_n_s_per_m=rng.choice((0.0, 0.0, 0.0, _log(rng, 1.0, 60.0), -_log(rng, 1.0, 30.0))),
    )


def _sample(rng: Random) -> SampleDraw:
    stiffness = _log(rng, _LEAST_SAMPLE_N_PER_M, _MOST_SAMPLE_N_PER_M)
    takes = rng.choice(("nothing", "nothing", "viscous", "hysteresis", "adhesion"))
    return SampleDraw(
        stiffness_n_per_m=stiffness,
        place_m=rng.choice((0.0, rng.uniform(-3e-9, 1e-9), rng.uniform(0.0, 2e-8))),
        drift_m_per_s=rng.choice((0.0, 5e-11, -5e-11, _MOST_DRIFT_M_PER_S, rng.uniform(-1, 1) * _MOST_DRIFT_M_PER_S)),
        # at a force of 10 nN the tip then sinks with 0.1 to 100 nm/s through the damper alone
        viscous_n_s_per_m=_log(rng, 1e-3, 1e-1) * stiffness if takes == "viscous" else 0.0,
        hysteresis=rng.uniform(0.1, 1.0) if takes == "hysteresis" else 0.0,
        adhesion_n=_log(rng, 1e-10, 1e-8) if takes == "adhesion" else 0.0,
        adhesion_m=_log(rng, 1e-10, 5e-9),
    )


def _line(rng: Random) -> LineDraw:
    def delay_s() -> float:
        return rng.choice((0.0, _log(rng, 1e-3, _MOST_DELAY_S), rng.uniform(0.0, _MOST_DELAY_S)))

    forward_s = delay_s()
    backward_s = forward_s if rng.random() < 0.5 else delay_s()
    return LineDraw(forward_s, backward_s, rng.choice((0.0, 0.0, 0.0, rng.uniform(0.0, 0.3))))


def _events(rng: Random, kind: str, duration_s: float, silence_limit_s: float) -> tuple[Event, ...]:
    """Return the events of an order: one, or one every period, or at random times, one after the other."""
    if kind == MIXED:
        chosen = rng.sample(_TRANSITIONS, rng.randint(2, 5))
    elif kind == EVERYTHING:
        chosen = rng.sample((*_TRANSITIONS, "instrument stalls", "retune in contact"), rng.randint(2, 5))
    else:
        chosen = [kind]
    pattern = rng.choices(("single", "periodic", "random"), (1, 6, 3))[0]
    first_s = BEGINS_S + rng.uniform(0.5, 4.0)
    if pattern == "single":
        return (_event(rng, rng.choice(chosen), first_s, silence_limit_s),)
    events: list[Event] = []
    # a pause between two events is from a little more than the round trip of a short line to several seconds
    pause_s, now_s = _log(rng, 0.05, 4.0), first_s
    model = {name: _event(rng, name, 0.0, silence_limit_s) for name in chosen}
    while now_s < duration_s - 0.5:
        name = rng.choice(chosen)
        event = model[name] if pattern == "periodic" else _event(rng, name, 0.0, silence_limit_s)
        if pattern == "periodic" and kind != MIXED:
            # what was changed is changed back the next time, so that the course is one that can continue for ever
            back = len(events) % 2 == 1
            shift_m, tip_m, factor = event.shift_m, event.tip_shift_m, event.factor
            event = _at(event, 0.0, -shift_m, -tip_m, 1.0 / factor) if back else event
        events.append(_at(event, now_s, event.shift_m, event.tip_shift_m, event.factor))
        now_s += event.lasts_s + event.slow_s + (pause_s if pattern == "periodic" else _log(rng, 0.05, 4.0))
    return tuple(events)


def _at(event: Event, start_s: float, shift_m: float, tip_shift_m: float, factor: float) -> Event:
    return Event(event.kind, start_s, event.lasts_s, event.pick, factor, shift_m, tip_shift_m, event.slow_s)


def _event(rng: Random, kind: str, start_s: float, silence_limit_s: float) -> Event:
    shift_m = rng.choice((0.0, 1.0, -1.0)) * _log(rng, 1e-4, 5e-3)
    tip_shift_m = rng.choice((0.0, 1.0, -1.0)) * _log(rng, 1e-10, 1e-8)
    if kind in SILENCES:
        return Event(kind, start_s, silence_limit_s * rng.uniform(_LEAST_SILENCE, _MOST_SILENCE))
    if kind == "let go":
        return Event(kind, start_s, _log(rng, 0.02, 3.0), slow_s=rng.choice((0.0, rng.uniform(0.0, 0.3))))
    if kind == "off":
        return Event(kind, start_s, silence_limit_s * _log(rng, 0.005, 5.0))
    if kind == "resume":
        return Event(kind, start_s, silence_limit_s * _log(rng, 0.05, 5.0), shift_m=shift_m)
    if kind == "arm":
        return Event(kind, start_s, _log(rng, 0.05, 2.0), shift_m=rng.choice((0.0, shift_m)))
    if kind in RETUNES:
        return Event(
            kind, start_s, 0.0, pick=rng.random(), factor=math.exp(rng.choice((-1, 1)) * rng.uniform(0.05, 1.2))
        )
    if kind == "switch":
        return Event(kind, start_s, _log(rng, 0.02, 1.5), shift_m=shift_m, tip_shift_m=tip_shift_m)
    if kind == "instrument stalls":
        return Event(kind, start_s, _log(rng, 2e-3, _LONGEST_STALL_S))
    if kind == "hand lost":
        return Event(kind, start_s, _log(rng, 0.02, 2.5), shift_m=shift_m)
    return Event(kind, start_s, _log(rng, 0.02, 2.0), tip_shift_m=tip_shift_m)
