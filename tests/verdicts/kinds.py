"""Kinds of courses: each is one function that makes a motion, and knows what it does because it made it so.

    recorded = kind_course("stick_slip", 7)
    recorded.time_s, recorded.tip_force_n, recorded.truth

A kind is given a random generator and the times of a hold, and returns the motion in units of the hand's force with its
truth. `kind_course` puts it between a free tip before the press and one after it, under the noise of a read-out, under
a hand that may tremble; nothing here knows the judge. `CLASSES` says what is asked of the kinds.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from courses import Course, Floats, _narrow_band, _octaves
from plans import Truth

Generator = np.random.Generator


class Made(NamedTuple):
    """What a kind has made: the motion of the loop at the tip in units of the hand's force, and its truth.

    hand: what the hand does beside its plan, of which the tip feels what is in the motion already; measured: whether
    the hand's own sensor shows that; noise: the noise of the read-out, where the kind is about that; dropped: the
    samples that are lost, as a mask; trip_s: the round trip of the line [s].
    """

    motion: Floats
    truth: Truth
    hand: Floats | None = None
    measured: bool = True
    noise: tuple[str, float] | None = None
    dropped: np.ndarray | None = None
    trip_s: float = 0.02


def _log(dice: Generator, least: float, most: float) -> float:
    """Return a number that is drawn evenly in its logarithm."""
    return float(least * (most / least) ** dice.random())


def _swing(dice: Generator, since: Floats, turns: float) -> Floats:
    """Return a cosine that turns so often over the hold, with a phase by chance."""
    return np.cos(2.0 * math.pi * (turns * since / since[-1] + dice.random()))


def _flow(step: Callable[[Floats], Floats], start: Floats, pace: float, count: int) -> Floats:
    """Return a course of a flow by Runge and Kutta's fourth order, shape (count, dimensions)."""
    rows, now = [], start
    for _ in range(count):
        one = step(now)
        two = step(now + 0.5 * pace * one)
        three = step(now + 0.5 * pace * two)
        now = now + pace / 6.0 * (one + 2.0 * two + 2.0 * three + step(now + pace * three))
        rows.append(now)
    return np.array(rows)


def _chaos(
    dice: Generator, since: Floats, step: Callable[[Floats], Floats], start: Floats, pace: float, turn: float
) -> Made:
    """Return a flow that turns 15 to 80 times in the hold, of 0.15 to 0.6 from peak to peak."""
    turns = _log(dice, 15.0, 80.0)
    count = int(turns * turn / pace) + 2
    own = _flow(step, start + 0.1 * dice.standard_normal(len(start)), pace, count + 1000)[1000:, 0]
    motion = np.interp(since / since[-1] * (turns * turn / pace), np.arange(count), own[:count])
    return _moving(_log(dice, 0.15, 0.6) * (motion - motion.mean()) / float(np.ptp(motion)))


def _moving(motion: Floats) -> Made:
    """Return a motion that goes on, made larger where it goes less far than a tenth in an eighth of the hold."""
    least = min(float(np.ptp(part)) for part in np.array_split(motion, 8))
    return Made(motion * max(1.0, min(0.1 / max(least, 1e-9), 5.0)), "goes_on")


# --- motions that never end and are not regular ----------------------------------------------------------------------


def stick_slip(dice: Generator, since: Floats) -> Made:
    """Load rises until it slips; times and sizes of the slips scatter by 5 to 50 %."""
    slips, scatter, slip = _log(dice, 15.0, 100.0), dice.uniform(0.05, 0.5), dice.uniform(0.02, 0.15)
    size = _log(dice, 0.15, 0.6)
    count = int(4.0 * slips) + 16
    lengths = np.maximum(1.0 + scatter * dice.standard_normal(count), 0.2) * since[-1] / slips
    sizes = size * np.clip(1.0 + scatter * dice.standard_normal(count), 0.3, 2.0)
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    now = np.searchsorted(begins, since, side="right") - 1
    part = (since - begins[now]) / lengths[now]
    load = np.where(part < 1.0 - slip, part / (1.0 - slip), (1.0 - part) / slip)
    return Made(sizes[now] * (load - 0.5), "goes_on")


def lorenz(dice: Generator, since: Floats) -> Made:
    def step(v: Floats) -> Floats:
        return np.array([10.0 * (v[1] - v[0]), v[0] * (28.0 - v[2]) - v[1], v[0] * v[1] - 8.0 / 3.0 * v[2]])

    return _chaos(dice, since, step, np.array([1.0, 1.0, 25.0]), 0.01, 0.75)


def roessler(dice: Generator, since: Floats) -> Made:
    def step(v: Floats) -> Floats:
        return np.array([-v[1] - v[2], v[0] + 0.2 * v[1], 0.2 + v[2] * (v[0] - 5.7)])

    return _chaos(dice, since, step, np.array([1.0, 1.0, 0.0]), 0.1, 5.9)


def duffing(dice: Generator, since: Floats) -> Made:
    """A ball in two wells that are shaken: x'' + 0.3 x' - x + x³ = 0.5 cos 1.2 t."""

    def step(v: Floats) -> Floats:
        return np.array([v[1], -0.3 * v[1] + v[0] - v[0] ** 3 + 0.5 * math.cos(1.2 * v[2]), 1.0])

    return _chaos(dice, since, step, np.array([1.0, 0.0, 0.0]), 0.1, 2.0 * math.pi / 1.2)


def bursts(dice: Generator, since: Floats) -> Made:
    """A swing that comes and goes: eight or more bursts, of a fifth to a half of the time."""
    many, share, size = dice.integers(8, 20), dice.uniform(0.2, 0.5), _log(dice, 0.15, 0.6)
    pauses = dice.uniform(0.6, 1.4, many + 1)
    begins = np.concatenate([[0.0], np.cumsum(pauses)])[:-1] / pauses.sum() * since[-1]
    length = share * since[-1] / many
    on = np.zeros_like(since)
    for begin in begins:
        on += np.clip((since - begin) / (0.1 * length), 0.0, 1.0) * np.clip(
            (begin + length - since) / (0.1 * length), 0.0, 1.0
        )
    turns = many / share * dice.uniform(2.0, 8.0)
    return Made(0.5 * size * np.minimum(on, 1.0) * _swing(dice, since, turns), "goes_on")


def telegraph(dice: Generator, since: Floats) -> Made:
    """The force has two values and changes between them by chance, 20 to 120 times."""
    changes, size = int(_log(dice, 20.0, 120.0)), _log(dice, 0.12, 0.5)
    at_s = np.sort(dice.uniform(0.0, since[-1], changes))
    return Made(size * (np.searchsorted(at_s, since) % 2 - 0.5), "goes_on")


def bouncing(dice: Generator, since: Floats) -> Made:
    """A tip that hops on a surface with flights and blows that scatter; its mean force is that of the hand."""
    hops, scatter, touch = int(_log(dice, 15.0, 80.0)), dice.uniform(0.1, 0.5), dice.uniform(0.3, 0.7)
    lengths = np.maximum(1.0 + scatter * dice.standard_normal(4 * hops + 16), 0.3) * since[-1] / hops
    begins = np.concatenate([[0.0], np.cumsum(lengths)])
    now = np.searchsorted(begins, since, side="right") - 1
    part = (since - begins[now]) / lengths[now] / touch
    peaks = np.clip(1.0 + scatter * dice.standard_normal(lengths.size), 0.3, 2.0) * _log(dice, 0.3, 1.0)
    return Made(np.where(part < 1.0, peaks[now] * np.sin(math.pi * np.minimum(part, 1.0)), 0.0) - 0.5, "goes_on")


def kicks(dice: Generator, since: Floats) -> Made:
    """Each lost message kicks the loop, and each kick dies out: 15 to 100 of them, and they never end."""
    many, turns = int(_log(dice, 15.0, 100.0)), _log(dice, 20.0, 150.0)
    at_s, size = np.sort(dice.uniform(0.0, since[-1], many)), _log(dice, 0.1, 0.3)
    decay_s = since[-1] / many * dice.uniform(0.4, 2.0)
    motion = np.zeros_like(since)
    for at in at_s:
        late = np.maximum(since - at, 0.0)
        own = size * dice.exponential() * (1.0 if dice.random() < 0.5 else -1.0)
        motion += np.where(
            since >= at, own * np.exp(-late / decay_s) * np.cos(2.0 * math.pi * turns * late / since[-1]), 0.0
        )
    return _moving(motion)


# --- regular motions that go on --------------------------------------------------------------------------------------


def period_doubling(dice: Generator, since: Floats) -> Made:
    turns, size = _log(dice, 12.0, 100.0), _log(dice, 0.12, 1.0)
    own = _swing(dice, since, turns) + dice.uniform(0.2, 0.9) * _swing(dice, since, 0.5 * turns)
    return Made(size * own / float(np.ptp(own)), "goes_on")


def beating(dice: Generator, since: Floats) -> Made:
    turns, beats, size = _log(dice, 20.0, 120.0), dice.uniform(3.0, 12.0), _log(dice, 0.15, 1.0)
    own = _swing(dice, since, turns) + dice.uniform(0.2, 0.8) * _swing(dice, since, turns + beats)
    return Made(size * own / float(np.ptp(own)), "goes_on")


def chirp(dice: Generator, since: Floats) -> Made:
    """A swing whose frequency goes up or down by 30 %."""
    turns, change = _log(dice, 12.0, 100.0), dice.uniform(-0.3, 0.3)
    phase = turns * (since + 0.5 * change * since * since / since[-1]) / since[-1]
    return Made(0.5 * _log(dice, 0.12, 1.0) * np.cos(2.0 * math.pi * (phase + dice.random())), "goes_on")


def grown(dice: Generator, since: Floats) -> Made:
    """A swing that grows and comes to its limit within a half of the hold."""
    first, last, at = _log(dice, 0.01, 0.5), _log(dice, 0.15, 1.5), dice.uniform(0.05, 0.5)
    # It is within 2 % of its limit by then.
    rate = 0.5 * math.log((first**-2 - 1.0) / 0.04) / (at * since[-1])
    size = 0.5 * last / np.sqrt(1.0 + (first**-2 - 1.0) * np.exp(-2.0 * rate * since))
    return Made(size * _swing(dice, since, _log(dice, 15.0, 150.0)), "goes_on")


# --- motions that grow until their end -------------------------------------------------------------------------------


def late_onset(dice: Generator, since: Floats) -> Made:
    """Nothing moves until a time, from which on a swing grows by e³ or more, for six turns or more."""
    begins, change = dice.uniform(0.2, 0.75), dice.uniform(3.0, 7.0)
    turns = max(_log(dice, 15.0, 150.0), 6.0 / (1.0 - begins))
    part = (since / since[-1] - begins) / (1.0 - begins)
    size = np.where(part >= 0.0, 0.5 * _log(dice, 0.2, 2.0) * np.exp(change * (np.minimum(part, 1.0) - 1.0)), 0.0)
    return Made(size * _swing(dice, since, turns), "grows")


def stairs(dice: Generator, since: Floats) -> Made:
    """A swing that grows by steps of 40 to 100 %, five to eight of them, the last in the last sixth."""
    many = int(dice.integers(5, 9))
    at = np.sort(np.concatenate([dice.uniform(0.1, 0.85, many - 1), [dice.uniform(0.85, 0.92)]])) * since[-1]
    factors = np.concatenate([[1.0], np.cumprod(dice.uniform(1.4, 2.0, many))])
    size = factors[np.searchsorted(at, since)] / factors[-1]
    return Made(0.5 * _log(dice, 0.3, 2.0) * size * _swing(dice, since, _log(dice, 25.0, 150.0)), "grows")


def delay_grows(dice: Generator, since: Floats) -> Made:
    """A swing that dies out until the delay steps up, and grows from then on at a frequency that is a little lower."""
    at, change, turns = dice.uniform(0.1, 0.6), dice.uniform(1.0, 6.0), _log(dice, 20.0, 150.0)
    part = since / since[-1] - at
    size = np.exp(np.where(part < 0.0, -dice.uniform(0.5, 3.0) * part / at, change * part / (1.0 - at)))
    turned = turns * (part - 0.2 * np.maximum(part, 0.0)) + dice.random()
    return Made(0.5 * _log(dice, 0.2, 2.0) * size / size[-1] * np.cos(2.0 * math.pi * turned), "grows")


# --- what comes to rest, or rests ------------------------------------------------------------------------------------


def recovery(dice: Generator, since: Floats) -> Made:
    """A delay that recovers: a swing grows for a while, and dies out from then on."""
    at, change, turns = dice.uniform(0.1, 0.5), dice.uniform(3.0, 12.0), _log(dice, 12.0, 150.0)
    part = since / since[-1] - at
    size = np.exp(np.where(part < 0.0, dice.uniform(1.0, 4.0) * part / at, -change * part / (1.0 - at)))
    return Made(0.5 * _log(dice, 0.2, 2.0) * size * _swing(dice, since, turns), "settles")


def beats_that_die(dice: Generator, since: Floats) -> Made:
    turns, beats, change = _log(dice, 20.0, 120.0), dice.uniform(1.0, 8.0), dice.uniform(2.5, 8.0)
    own = _swing(dice, since, turns) + dice.uniform(0.2, 0.9) * _swing(dice, since, turns + beats)
    return Made(0.5 * _log(dice, 0.2, 1.0) * np.exp(-change * since / since[-1]) * own, "settles")


def kicked(dice: Generator, since: Floats) -> Made:
    """One to three kicks in the first two thirds, each of which dies out within a tenth of the hold."""
    motion, turns = np.zeros_like(since), _log(dice, 20.0, 150.0)
    for at in dice.uniform(0.0, 0.65, int(dice.integers(1, 4))) * since[-1]:
        late = np.maximum(since - at, 0.0) / since[-1]
        own = _log(dice, 0.1, 1.0) * np.exp(-late / 0.025) * np.cos(2.0 * math.pi * turns * late)
        motion += np.where(since >= at, own, 0.0)
    return Made(motion, "settles")


def one_sided(dice: Generator, since: Floats) -> Made:
    """A way from one force to another, of an overdamped loop whose slowest pole is seen for two to eight times."""
    change, way = dice.uniform(2.0, 8.0), _log(dice, 0.1, 3.0) * (1.0 if dice.random() < 0.5 else -1.0)
    slow = np.exp(-change * since / since[-1])
    fast = np.exp(-change * dice.uniform(2.0, 10.0) * since / since[-1])
    return Made(-way * (slow + dice.uniform(-0.8, 0.5) * (fast - slow)), "settles", trip_s=float(since[-1] / 12.0))


def begun_way(dice: Generator, since: Floats) -> Made:
    """A hold that has seen one to three round trips of a way to a new force, which begins late and bends both ways."""
    trips, way = dice.uniform(1.0, 3.0), _log(dice, 0.3, 3.0) * (1.0 if dice.random() < 0.5 else -1.0)
    part = np.clip(since / since[-1] * dice.uniform(0.6, 1.5) - dice.uniform(0.0, 0.4), 0.0, 1.0)
    return Made(way * part * part * (3.0 - 2.0 * part), "settles", trip_s=float(since[-1] / trips))


def _tremor(dice: Generator, since: Floats, size: Floats | float, frequency_hz: float) -> Floats:
    return np.asarray(size * _narrow_band(dice, since, frequency_hz, 0.5))


def trembling_hand(dice: Generator, since: Floats) -> Made:
    """A tip that follows a hand which trembles at 8 to 12 Hz and wanders, as the hand's sensor shows."""
    own = _tremor(dice, since, _log(dice, 0.005, 0.06), dice.uniform(8.0, 12.0))
    own = own + _log(dice, 0.005, 0.03) * _octaves(dice, since, 0.1)
    trip_s = float(_log(dice, 0.005, 0.2))
    felt = dice.uniform(0.5, 1.2) * np.interp(since - 0.5 * trip_s, since, own)
    return Made(felt, "settles", own, trip_s=trip_s)


def tired_hand(dice: Generator, since: Floats) -> Made:
    """A hand whose tremor grows two to four times, to 0.15 from peak to peak; its sensor shows it."""
    size = 0.05 * _log(dice, 2.0, 4.0) ** (since / since[-1] - 1.0)
    own, trip_s = _tremor(dice, since, size, dice.uniform(8.0, 12.0)), float(_log(dice, 0.005, 0.2))
    felt = dice.uniform(0.5, 1.2) * np.interp(since - 0.5 * trip_s, since, own)
    return Made(felt, "settles", own, trip_s=trip_s)


def unmeasured_tremor(dice: Generator, since: Floats) -> Made:
    """A tremor that no sensor of the hand shows, and that grows three times to less than a twentieth."""
    own = _tremor(dice, since, 1.0, dice.uniform(8.0, 12.0))
    own = own * 3.0 ** (since / since[-1] - 1.0)
    return Made(dice.uniform(0.3, 0.85) * 0.05 * own / float(np.ptp(own)), "settles", own, measured=False)


def pink_rest(dice: Generator, since: Floats) -> Made:
    """Nothing moves under a read-out whose noise has the same power in each octave."""
    return Made(np.zeros_like(since), "settles", noise=("pink", _log(dice, 0.005, 0.06)))


def coarse_read_out(dice: Generator, since: Floats) -> Made:
    """A landing that comes to rest under a read-out with steps of 1 to 4.5 % of the hand's force."""
    landing = _log(dice, 0.2, 1.0) * np.exp(-dice.uniform(8.0, 30.0) * since / since[-1])
    return Made(
        landing * _swing(dice, since, _log(dice, 5.0, 60.0)), "settles", noise=("quantised", _log(dice, 0.01, 0.045))
    )


def dropped_rest(dice: Generator, since: Floats) -> Made:
    """A landing that comes to rest, in a recording that has lost stretches of 10 to 40 ms."""
    landing = _log(dice, 0.2, 1.0) * np.exp(-dice.uniform(8.0, 30.0) * since / since[-1])
    lost = np.zeros(since.size, dtype=np.bool_)
    for at in dice.uniform(0.0, 0.95 * since[-1], int(since[-1])):
        lost |= (since > at) & (since < at + dice.uniform(0.01, 0.04))
    return Made(landing * _swing(dice, since, _log(dice, 10.0, 60.0)), "settles", dropped=lost)


CLASSES: dict[str, dict[str, Callable[[Generator, Floats], Made]]] = {
    "irregular": {
        own.__name__: own for own in (stick_slip, lorenz, roessler, duffing, bursts, telegraph, bouncing, kicks)
    },
    "cycle": {own.__name__: own for own in (period_doubling, beating, chirp, grown)},
    "growth": {own.__name__: own for own in (late_onset, stairs, delay_grows)},
    "dying": {own.__name__: own for own in (recovery, beats_that_die, kicked)},
    "way": {own.__name__: own for own in (one_sided, begun_way)},
    "rest": {own.__name__: own for own in (pink_rest, coarse_read_out, dropped_rest)},
    "hand": {own.__name__: own for own in (trembling_hand, tired_hand, unmeasured_tremor)},
}
KINDS = {name: make for own in CLASSES.values() for name, make in own.items()}
CLASS_OF = {name: one for one, own in CLASSES.items() for name in own}


def kind_course(kind: str, seed: int) -> Course:
    """Return the course of a kind and a seed.

    The hand rests for 1 to 2 s with the tip in air, presses with 0.3 to 5 N for 0.8 to 9 s, lets go, and the tip is in
    air for another second. The read-out has no noise, white noise, 1/f noise, or steps.
    """
    dice = np.random.Generator(np.random.PCG64([list(KINDS).index(kind), seed]))
    rate_hz = float(dice.choice([250.0, 500.0, 1000.0]))
    hand_n, start_s, length_s = _log(dice, 0.3, 5.0), dice.uniform(1.0, 2.0), _log(dice, 0.8, 9.0)
    # A motion of twenty turns has room in a hold that is long enough for it.
    length_s = max(length_s, 2.0) if CLASS_OF[kind] in ("irregular", "growth") else length_s
    end_s = start_s + length_s
    time_s = (np.arange(int((end_s + 1.1) * rate_hz)) + 0.5) / rate_hz
    first, last = np.searchsorted(time_s, [start_s, end_s]).tolist()
    made = KINDS[kind](dice, time_s[first:last] - time_s[first])
    pressed = np.interp(time_s, [start_s - 0.05, start_s, end_s, end_s + 0.05], [0.0, 1.0, 1.0, 0.0])
    tip, hand = 0.95 * pressed, pressed.copy()
    tip[first:last] += made.motion
    contact = (time_s >= start_s) & (time_s < end_s)
    if kind == "bouncing":
        contact[first:last] = made.motion > -0.5
        tip[first:last] = made.motion + 0.5
    if made.hand is not None and made.measured:
        hand[first:last] += made.hand
    noise, noise_n = made.noise or (str(dice.choice(["none", "white", "pink", "quantised"])), 0.0)
    noise_n = noise_n or {"none": 0.0, "white": _log(dice, 1e-4, 0.04), "pink": _log(dice, 1e-4, 0.02)}.get(noise, 0.02)
    tip = np.where(contact | (pressed > 0.0), tip, 0.0)
    if noise == "white":
        tip += noise_n * dice.standard_normal(tip.size)
    elif noise == "pink":
        tip += noise_n * _octaves(dice, time_s, 2.0 / rate_hz)
    elif noise == "quantised":
        tip = np.round(tip / noise_n) * noise_n
    there = np.ones(tip.size, dtype=np.bool_)
    if made.dropped is not None:
        there[first:last] = ~made.dropped
    quiet = np.zeros(int(there.sum()), dtype=np.bool_)
    return Course(
        time_s=time_s[there],
        hand_force_n=hand_n * hand[there],
        tip_force_n=hand_n * tip[there],
        in_contact=contact[there],
        following=~quiet,
        held=quiet,
        round_trip_s=made.trip_s,
        random_link=False,
        planned=((start_s, end_s, hand_n),),
        rest_force_n=0.95 * hand_n if dice.random() < 0.5 else None,
        interruptions=(),
        overruns=(),
        guard=None,
        truth=made.truth,
        rate_per_s=0.0,
        frequency_hz=0.0,
        tags=frozenset({kind, CLASS_OF[kind], noise}),
        cell=f"{CLASS_OF[kind]}/{kind}",
        seed=seed,
    )
