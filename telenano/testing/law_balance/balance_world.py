"""The world at the two ports of a law in virtual time: hand, sample and line of an order.

Quantities that do not depend on the law are computed before the run, for every period: the position of the surface, the
arrivals of messages, and the noise that drives a wandering hand.
"""

import math
from random import Random
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import compiled
from telenano.testing.law_balance.balance_draws import HandDraw, LineDraw, Order, SampleDraw

# Steps of the hand in a period of the law, because a stiff grip on a light hand is faster than a period.
_SUBSTEPS = 4
# Time constant with which dents of a sample with hysteresis heal [s].
_HEALS_S = 0.5
_SHAPES = ("sine", "square", "wander")

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]


@compiled
def quantised(value: float, quantum: float) -> float:
    """Return a value rounded to multiples of a sensor's resolution; unchanged for a resolution of 0."""
    return math.floor(value / quantum + 0.5) * quantum if quantum > 0.0 else value


@compiled
def within(value: float, least: float, most: float) -> float:
    """Return a value limited to a range."""
    return min(max(value, least), most)


class Hand(NamedTuple):
    """The hand of a `HandDraw`; shape: index in sine, square, wander; noise: a random number for each period."""

    mass_kg: float
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    arm_n_s_per_m: float
    bare: bool
    push_n: float
    swing_n: float
    rate_hz: float
    shape: int
    against_n_s_per_m: float
    most_n: float
    noise: Floats


class Arm(NamedTuple):
    """The mass of a hand: position [m], velocity [m/s], value of a wandering wave, and whether it holds the device."""

    position_m: float
    velocity_m_per_s: float
    wander: float
    seized: bool


def hand_of(draw: HandDraw, ticks: int, rng: Random) -> Hand:
    """Return the hand of an order, with noise for `ticks` periods if it wanders."""
    wanders = bool(draw.swing_n) and draw.shape == "wander"
    noise = np.array([rng.gauss(0.0, 0.7) for _ in range(ticks if wanders else 1)])
    return Hand(
        mass_kg=draw.mass_kg,
        stiffness_n_per_m=draw.stiffness_n_per_m,
        damping_n_s_per_m=draw.damping_n_s_per_m,
        arm_n_s_per_m=draw.arm_n_s_per_m,
        bare=draw.bare,
        push_n=draw.push_n,
        swing_n=float(draw.swing_n),
        rate_hz=draw.rate_hz,
        shape=_SHAPES.index(draw.shape),
        against_n_s_per_m=float(draw.against_n_s_per_m),
        most_n=draw.most_n,
        noise=noise,
    )


@compiled
def pushed(
    hand: Hand, arm: Arm, tick: int, grip: float, position_m: float, velocity_m_per_s: float, period_s: float
) -> tuple[Arm, float]:
    """Return the arm a period later, and the force on the device during the period [N], positive towards the sample.

    Args:
        hand: The hand.
        arm: The state of its mass.
        tick: The number of the period.
        grip: The share of its force that acts on the device; 0 if it has let go.
        position_m: The position of the device [m].
        velocity_m_per_s: The velocity of the device over the last period [m/s].
        period_s: The period [s].
    """
    if grip <= 0.0:
        return Arm(arm.position_m, arm.velocity_m_per_s, arm.wander, False), 0.0
    arm_m, arm_m_per_s, wander = arm.position_m, arm.velocity_m_per_s, arm.wander
    if not arm.seized:
        arm_m, arm_m_per_s = position_m, 0.0
    wave = 0.0
    if hand.swing_n != 0.0:
        if hand.shape == 2:
            share = min(2.0 * math.pi * hand.rate_hz * period_s, 1.0)
            wander += -share * wander + math.sqrt(2.0 * share) * float(hand.noise[tick])
            wave = wander
        else:
            wave = math.sin(2.0 * math.pi * hand.rate_hz * (tick * period_s))
            if hand.shape == 1:
                wave = math.copysign(1.0, wave)
    active_n = hand.push_n + hand.swing_n * wave - hand.against_n_s_per_m * velocity_m_per_s
    force_n = active_n
    if not hand.bare:
        force_n = hand.stiffness_n_per_m * (arm_m - position_m)
        force_n += hand.damping_n_s_per_m * (arm_m_per_s - velocity_m_per_s)
        step_s, device_m = period_s / _SUBSTEPS, position_m
        for _ in range(_SUBSTEPS):
            pulled_n = hand.stiffness_n_per_m * (arm_m - device_m)
            pulled_n += hand.damping_n_s_per_m * (arm_m_per_s - velocity_m_per_s)
            arm_m_per_s += (active_n - pulled_n - hand.arm_n_s_per_m * arm_m_per_s) * step_s / hand.mass_kg
            arm_m += arm_m_per_s * step_s
            device_m += velocity_m_per_s * step_s
    return Arm(arm_m, arm_m_per_s, wander, True), grip * within(force_n, -hand.most_n, hand.most_n)


class Sample(NamedTuple):
    """The sample of a `SampleDraw`; surface_m: surface position in each period [m], with drift, jumps and creep."""

    stiffness_n_per_m: float
    viscous_n_s_per_m: float
    hysteresis: float
    adhesion_n: float
    adhesion_m: float
    surface_m: Floats


class Contact(NamedTuple):
    """Last depth of the tip [m], the dent that it has left [m], and whether adhesion holds it."""

    depth_m: float
    dent_m: float
    holds: bool


def sample_of(draw: SampleDraw, softer: float, ticks: int, period_s: float) -> Sample:
    """Return the sample of an order.

    Args:
        draw: The sample.
        softer: The factor on its stiffness and damping, for a law that states a stiffest sample.
        ticks: The number of periods of the order.
        period_s: The period [s].
    """
    time_s = np.arange(ticks) * period_s
    surface = np.asarray(draw.place_m + draw.drift_m_per_s * time_s, dtype=np.float64)
    if draw.jump_m:
        surface += draw.jump_m * (np.floor_divide(time_s, draw.jump_every_s) % 2)
    if draw.creep_m:
        surface += np.array([draw.creep_m * math.log(1.0 + at_s) for at_s in time_s.tolist()])
    return Sample(
        stiffness_n_per_m=softer * draw.stiffness_n_per_m,
        viscous_n_s_per_m=softer * draw.viscous_n_s_per_m,
        hysteresis=float(draw.hysteresis),
        adhesion_n=float(draw.adhesion_n),
        adhesion_m=draw.adhesion_m,
        surface_m=surface,
    )


@compiled
def pressed(sample: Sample, contact: Contact, base_m: float, tick: int, period_s: float) -> tuple[Contact, float]:
    """Return the contact and the force on the tip [N], positive if repulsive, a period after the last call."""
    depth, dent = base_m - float(sample.surface_m[tick]), contact.dent_m
    sinks = (depth - contact.depth_m) / period_s if contact.depth_m >= 0.0 else 0.0
    holds = sample.adhesion_n > 0.0 and (depth >= 0.0 or (contact.holds and depth > -sample.adhesion_m))
    if depth < 0.0:
        dent -= dent * min(period_s / _HEALS_S, 1.0)
        force_n = max(sample.stiffness_n_per_m * depth, -sample.adhesion_n) if holds else 0.0
        return Contact(depth, dent, holds), force_n
    if sample.hysteresis == 0.0:
        force_n = sample.stiffness_n_per_m * depth + sample.viscous_n_s_per_m * sinks
        return Contact(depth, dent, holds), max(force_n, 0.0)
    stiffer = 1.0 + sample.hysteresis
    dent = max(dent * (1.0 - min(period_s / _HEALS_S, 1.0)), depth * sample.hysteresis / stiffer)
    return Contact(depth, dent, holds), max(sample.stiffness_n_per_m * stiffer * (depth - dent), 0.0)


def stiffest_n_per_m(draw: SampleDraw, period_s: float) -> float:
    """Return the greatest ratio of the changes of force and position in a step of a period, damping included [N/m]."""
    return draw.stiffness_n_per_m * (1.0 + draw.hysteresis) + draw.viscous_n_s_per_m / period_s


class Line(NamedTuple):
    """One direction of a line: the arrivals in their order, and the messages sent in each period.

    when, number: the periods in which a message arrives and in which it was sent; sent: the messages by period, shape
    (ticks, 9); reign: number of the law's reign in which it was sent, -1 if nothing was; hand_tick: the period of the
    hand's sample that it descends from.
    """

    when: Whole
    number: Whole
    sent: Floats
    reign: Whole
    hand_tick: Whole


def lines_of(order: Order, ticks: int) -> tuple[Line, Line]:
    """Return the forward and the backward direction of the line of an order."""
    ways = ((order.line.forward_s, "forward"), (order.line.backward_s, "backward"))
    return tuple(_line(order, delay_s, ticks, Random(f"{order.seed} {way}")) for delay_s, way in ways)  # type: ignore[return-value]


def _line(order: Order, delay_s: float, ticks: int, rng: Random) -> Line:
    delays, lost = _delays_s(order.line, delay_s, ticks, order.period_s, rng), _lost(order.line, ticks, rng)
    arrive = np.arange(ticks) + np.maximum(np.rint(delays / order.period_s).astype(np.int64), 0)
    if order.line.shape == "slots":
        slot = max(1, round(order.line.every_s / order.period_s))
        arrive = -(-arrive // slot) * slot
    number = np.flatnonzero(~lost)
    number = number[np.argsort(arrive[number], kind="stable")]
    return Line(
        arrive[number],
        number,
        np.zeros((ticks, 9)),
        np.full(ticks, -1, dtype=np.int64),
        np.zeros(ticks, dtype=np.int64),
    )


def _delays_s(draw: LineDraw, delay_s: float, ticks: int, period_s: float, rng: Random) -> Floats:
    """Return the delay of each period's message [s]; if it falls faster than time passes, messages overtake."""
    time_s = np.arange(ticks) * period_s
    if draw.shape in ("constant", "slots"):
        return np.full(ticks, delay_s)
    if draw.shape == "random":
        return delay_s + np.array([rng.uniform(0.0, draw.spread_s) for _ in range(ticks)])
    phase = rng.random() * draw.every_s
    if draw.shape == "sawtooth":
        return np.asarray(delay_s + draw.spread_s * (1.0 - ((time_s + phase) % draw.every_s) / draw.every_s))
    steps = [rng.uniform(0.0, draw.spread_s) for _ in range(int((ticks * period_s + phase) / draw.every_s) + 1)]
    return delay_s + np.array(steps)[((time_s + phase) / draw.every_s).astype(np.int64)]


def _lost(draw: LineDraw, ticks: int, rng: Random) -> npt.NDArray[np.bool_]:
    """Return whether each message is lost, shape (ticks,): independently, or in bursts of a mean length."""
    if draw.lost <= 0.0:
        return np.zeros(ticks, dtype=bool)
    if draw.burst <= 1.0:
        return np.array([rng.random() < draw.lost for _ in range(ticks)])
    lost, is_lost = np.zeros(ticks, dtype=bool), False
    begins = draw.lost / ((1.0 - draw.lost) * draw.burst)
    for tick in range(ticks):
        is_lost = rng.random() >= 1.0 / draw.burst if is_lost else rng.random() < begins
        lost[tick] = is_lost
    return lost
