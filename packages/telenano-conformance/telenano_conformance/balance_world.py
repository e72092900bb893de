"""The world at the two ports of a law in virtual time: a hand, a sample and a line, as an order has them."""

import math
from collections import deque
from random import Random
from typing import Any

from telenano_conformance.balance_draws import HandDraw, LineDraw, SampleDraw

# A hand is stepped this often in a period of the law, because a stiff grip on a light hand is quicker than that.
_SUBSTEPS = 4
# Dents of a sample with hysteresis heal with this time constant [s].
_HEALS_S = 0.5


def quantised(value: float, quantum: float) -> float:
    """Return a value as a sensor with steps of a quantum reports it; 0 is a sensor without steps."""
    return round(value / quantum) * quantum if quantum else value


class HandModel:
    """The hand of an order; its force is held over each period, so that its work is the force times the way."""

    def __init__(self, draw: HandDraw, rng: Random, position_m: float) -> None:
        self._draw, self._rng = draw, rng
        self._arm_m, self._arm_m_per_s, self._wander = position_m, 0.0, 0.0
        self._seized = False

    def force_n(self, time_s: float, grip: float, position_m: float, velocity_m_per_s: float, period_s: float) -> float:
        """Return the force on the device over the next period [N], positive towards the sample.

        Args:
            time_s: The time of the order [s].
            grip: The share of its force with which the hand holds the device; 0 where it has let go.
            position_m: Where the device is [m].
            velocity_m_per_s: The velocity of the device over the last period [m/s].
            period_s: The period [s].
        """
        d = self._draw
        if grip <= 0.0:
            self._seized = False
            return 0.0
        if not self._seized:
            self._arm_m, self._arm_m_per_s, self._seized = position_m, 0.0, True
        wave = 0.0
        if d.swing_n:
            if d.shape == "wander":
                share = min(2.0 * math.pi * d.rate_hz * period_s, 1.0)
                self._wander += -share * self._wander + math.sqrt(2.0 * share) * self._rng.gauss(0.0, 0.7)
                wave = self._wander
            else:
                wave = math.sin(2.0 * math.pi * d.rate_hz * time_s)
                wave = math.copysign(1.0, wave) if d.shape == "square" else wave
        active_n = d.push_n + d.swing_n * wave - d.against_n_s_per_m * velocity_m_per_s
        force_n = active_n
        if not d.bare:
            grip_n = d.stiffness_n_per_m * (self._arm_m - position_m)
            grip_n += d.damping_n_s_per_m * (self._arm_m_per_s - velocity_m_per_s)
            force_n = grip_n
            step_s, device_m = period_s / _SUBSTEPS, position_m
            for _ in range(_SUBSTEPS):
                pulled_n = d.stiffness_n_per_m * (self._arm_m - device_m)
                pulled_n += d.damping_n_s_per_m * (self._arm_m_per_s - velocity_m_per_s)
                net_n = active_n - pulled_n - d.arm_n_s_per_m * self._arm_m_per_s
                self._arm_m_per_s += net_n * step_s / d.mass_kg
                self._arm_m += self._arm_m_per_s * step_s
                device_m += velocity_m_per_s * step_s
        return grip * min(max(force_n, -d.most_n), d.most_n)


class SampleModel:
    """The sample of an order: the force on the tip from the place of the base and the time.

    Args:
        draw: The sample.
        softer: By which its stiffness and its damping are multiplied, for a law that states a stiffest sample.
    """

    def __init__(self, draw: SampleDraw, softer: float) -> None:
        self._draw = draw
        self._stiffness, self._viscous = softer * draw.stiffness_n_per_m, softer * draw.viscous_n_s_per_m
        self._depth_m, self._dent_m, self._holds = -1.0, 0.0, False

    def depth_m(self, base_m: float, time_s: float) -> float:
        """Return how far the tip is in the surface [m], negative above it."""
        return base_m - self._draw.place_m - self._draw.drift_m_per_s * time_s

    def force_n(self, base_m: float, time_s: float, period_s: float) -> float:
        """Return the force on the tip [N], repulsive positive, a period after the last call."""
        d, depth = self._draw, self.depth_m(base_m, time_s)
        sinks = (depth - self._depth_m) / period_s if self._depth_m >= 0.0 else 0.0
        self._depth_m = depth
        self._holds = bool(d.adhesion_n) and (depth >= 0.0 or (self._holds and depth > -d.adhesion_m))
        if depth < 0.0:
            self._dent_m -= self._dent_m * min(period_s / _HEALS_S, 1.0)
            return max(self._stiffness * depth, -d.adhesion_n) if self._holds else 0.0
        if not d.hysteresis:
            return max(self._stiffness * depth + self._viscous * sinks, 0.0)
        stiffer = 1.0 + d.hysteresis
        healed = self._dent_m * (1.0 - min(period_s / _HEALS_S, 1.0))
        self._dent_m = max(healed, depth * d.hysteresis / stiffer)
        return max(self._stiffness * stiffer * (depth - self._dent_m), 0.0)


def stiffest_n_per_m(draw: SampleDraw, period_s: float) -> float:
    """Return the greatest change of force over a change of place that a sample answers a step of a period with."""
    return draw.stiffness_n_per_m * (1.0 + draw.hysteresis) + draw.viscous_n_s_per_m / period_s


class Line:
    """One way of a line: what was put in comes out after its delay, unless it was lost or put into a silence."""

    def __init__(self, delay_periods: int, lost: float, rng: Random) -> None:
        self._delay, self._lost, self._rng = delay_periods, lost, rng
        self._under_way: deque[tuple[int, Any]] = deque()

    def put(self, tick: int, message: Any, *, silent: bool) -> None:
        """Take a message at a tick; in a silence it is lost."""
        lost = self._lost > 0.0 and self._rng.random() < self._lost
        if not silent and not lost:
            self._under_way.append((tick + self._delay, message))

    def take(self, tick: int) -> Any:
        """Return the newest message that has come by a tick, or None."""
        newest = None
        while self._under_way and self._under_way[0][0] <= tick:
            newest = self._under_way.popleft()[1]
        return newest


def lines_of(draw: LineDraw, period_s: float, rng: Random) -> tuple[Line, Line]:
    """Return the line forward and the line backward."""
    forward, backward = round(draw.forward_s / period_s), round(draw.backward_s / period_s)
    return Line(forward, draw.lost, rng), Line(backward, draw.lost, rng)
