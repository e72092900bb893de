"""Quasi-static cantilever: k (h + x_s - L) = F(h), with branch tracking, and its read-out (Eq. 3 and 4).

For a given branch of the force every distance h is the equilibrium of exactly one base position,

    X(h) = L - h + F(h) / k,

and the net force on the tip is k (X(h) - x_s). An equilibrium is stable where X falls with h. The net force moves the
tip to the next h with X(h) = x_s; a tip that leaves the interval of a branch passes to the next branch (contact made or
lost, meniscus formed or broken). This is continuation along the stable branch while there is one, and a jump at a fold
where there is not. The outcome of a monotonic motion of the base does not depend on the size of its steps.

The extrema of X are found once, when parameters change (`build_branches`). Between them X is monotonic, so a step is a
walk over a few intervals and one bracketed Newton solution: no start value can miss a root, and iterations are bounded.

Where the printed force jumps so that the tip is pushed back from both sides, the tip rests at the jump; its force there
is that of the spring.
"""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.afm.contact.electrostatic import (
    MOST_TURNS,
    SETTLED_M,
    electrostatic_force_n,
    electrostatic_strength_n_m2,
)
from telenano.afm.contact.tip_sample import TipSample, branch_force
from telenano.afm.part import Part, register_part
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics.compiler import compiled

_TOLERANCE_M = 1e-17
_MOST_ITERATIONS = 200
# The tip returns to a branch only to rest at the switch, so four branches never need more passages.
_MOST_PASSAGES = 16
_FAR_M = 1e-4  # beyond, no force has a gradient near any cantilever's stiffness
_SCAN_POINTS = 4000


class Plant(NamedTuple):
    """Cantilever over a sample; made by `build_plant`.

    `branches` (4, n + 1, 4), first index b = 2 contact + meniscus. Row 0: number of intervals of monotonic X, branch
    behind the lower end, branch behind the upper end. Rows 1 and on, by rising h, the intervals: lower h [m], upper h
    [m], X at the lower end [m], X at the upper end [m].
    """

    tip: TipSample
    stiffness_n_per_m: float  # k
    rest_distance_m: float  # L
    volts_per_m: float  # V0 Gc Sc / 4
    lowest_force_n: float  # a bound from below on F over all branches
    branches: npt.NDArray[np.float64]

    def at_rest(self, base_m: float) -> "PlantState":
        """Return the equilibrium at a base position [m] of a tip that came from far away."""
        return initial_state(self, base_m)

    def settled(self, state: "PlantState", base_m: float) -> "PlantState":
        """Return the stable equilibrium that the tip reaches from a state when the base goes to base_m [m]."""
        return equilibrium(self, state, base_m)


class _Spring(NamedTuple):
    """Numbers of one equilibrium: k [N/m], L [m], x_s [m], lower bound of F [N]; without arrays it is cheap to pass."""

    k: float
    L: float
    base_m: float
    lowest_force_n: float


class PlantState(NamedTuple):
    """Distance of the tip from the sample, and the branch of the force that holds for it."""

    distance_m: float  # h
    contact: bool
    meniscus: bool


def volts_per_m(bridge_supply_v: float, amplifier_gain: float, sensitivity_per_m: float) -> float:
    """Read-out gain V0 Gc Sc / 4 [V/m] (Eq. 3).

    Args:
        bridge_supply_v: The supply voltage of the bridge, V0 [V].
        amplifier_gain: The gain of the amplifier, Gc.
        sensitivity_per_m: The sensitivity of the cantilever, Sc [1/m].

    >>> round(volts_per_m(2.5, 1e4, 1e3) * 1e-9 * 1e3, 9)  # mV per nm, with Sc = 1e-6 per nm
    6.25
    """
    return 0.25 * bridge_supply_v * amplifier_gain * sensitivity_per_m


@compiled
def deflection_m(plant: Plant, distance_m: float, base_m: float) -> float:
    """Deflection zeta = h + x_s - L [m], positive away from the sample (Eq. 4)."""
    return distance_m + base_m - plant.rest_distance_m


@compiled
def equilibrium(plant: Plant, state: PlantState, base_m: float) -> PlantState:
    """Stable equilibrium that the tip reaches from `state` when the base goes to x_s = base_m [m].

    Follows the branch, jumps at folds and passes between branches as the module describes.

    Raises:
        ValueError: Base or distance is not finite.
    """
    h = state.distance_m
    if not (math.isfinite(base_m) and math.isfinite(h)):
        raise ValueError("base position and tip distance in m must be finite")
    # The fields are read once: each access to the tuple counts a reference to its arrays.
    tip, branches = plant.tip, plant.branches
    spring = _Spring(plant.stiffness_n_per_m, plant.rest_distance_m, base_m, plant.lowest_force_n)
    b = 2 * int(state.contact) + int(state.meniscus)
    arrived = 0
    for _ in range(_MOST_PASSAGES):
        n = int(branches[b, 0, 0])
        # A first state, or one from before a change of parameters, may lie outside its branch: find the right one.
        if n == 0 or h > branches[b, n, 1]:
            b = int(branches[b, 0, 2])
            continue
        if h < branches[b, 1, 0]:
            b = int(branches[b, 0, 1])
            continue
        before = h
        if _excess(tip, spring, b, h)[0] > 0.0:
            direction = 1
            h, has_converged = _ascend(tip, spring, branches, b, h)
        else:
            direction = -1
            h, has_converged = _descend(tip, spring, branches, b, h)
        if has_converged:
            break
        if arrived == -direction and h == before:
            # The tip was pushed back at once through the end it entered by: it rests at the switch, as a contact.
            if direction < 0:
                b = int(branches[b, 0, 1])
            break
        b = int(branches[b, 0, 1 if direction < 0 else 2])
        arrived = direction
    return PlantState(h, b >= 2, b % 2 == 1)


@compiled
def step(plant: Plant, state: PlantState, inputs: PlantInputs, dt: float) -> tuple[PlantState, AfmSample]:
    """Move the base, find the equilibrium and read it out: one step of the quasi-static cantilever.

    The force of the sample is that of the cantilever, k zeta, which in equilibrium is F(h). A rising surface acts on
    the tip like a base that comes nearer, and the electrostatic force F_el of a voltage like a base that is nearer by
    -F_el / k. Position and F_el are iterated. F_el grows as the tip comes nearer, so the iteration is monotonic:
    to the next equilibrium or, where there is none, to pull-in.
    """
    k, pull_m, strength = plant.stiffness_n_per_m, 0.0, 0.0
    if inputs.voltage_v != 0.0:
        strength = electrostatic_strength_n_m2(inputs.voltage_v, plant.tip.radius_m)
    tip, zeta = state, 0.0
    for _ in range(MOST_TURNS):
        before_m = tip.distance_m
        if strength > 0.0:
            pull_m = electrostatic_force_n(strength, plant.tip.radius_m, plant.tip.contact_distance_m, before_m) / k
        nearer_m = inputs.base_m - pull_m + inputs.height_m
        tip = equilibrium(plant, tip, nearer_m)
        zeta = deflection_m(plant, tip.distance_m, nearer_m) + pull_m
        if strength == 0.0 or abs(tip.distance_m - before_m) < SETTLED_M:
            break
    return tip, AfmSample(
        base_m=inputs.base_m,
        deflection_m=zeta,
        force_n=k * zeta,
        bridge_voltage_v=plant.volts_per_m * zeta,
        distance_m=tip.distance_m,
        distance_valid=True,
        in_contact=tip.contact,
        meniscus=tip.meniscus,
        lateral_x_n=0.0,
        lateral_y_n=0.0,
    )


@compiled
def _excess(tip: TipSample, spring: _Spring, b: int, h: float) -> tuple[float, float]:
    """X(h) - x_s [m] on branch b, and its slope in h."""
    force, gradient = branch_force(tip, h, b >= 2, b % 2 == 1)
    return spring.L - h + force / spring.k - spring.base_m, gradient / spring.k - 1.0


@compiled
def _descend(
    tip: TipSample, spring: _Spring, branches: npt.NDArray[np.float64], b: int, h: float
) -> tuple[float, bool]:
    """Return the next h below with X(h) >= x_s on branch b, and True; or the lower end of the branch, and False."""
    i = _interval(branches, b, h)
    while True:
        low, x_low = float(branches[b, i, 0]), float(branches[b, i, 2])
        if x_low >= spring.base_m:
            # The lowest interval is unbounded: there only F / k can hold the tip away from L - x_s.
            bound = spring.L - spring.base_m + spring.lowest_force_n / spring.k
            return _root(tip, spring, b, min(max(low, bound), h), h, h), True
        h = low
        if i == 1:
            return h, False
        i -= 1
        if branches[b, i, 3] >= spring.base_m:
            return h, True


@compiled
def _ascend(tip: TipSample, spring: _Spring, branches: npt.NDArray[np.float64], b: int, h: float) -> tuple[float, bool]:
    """Return the next h above with X(h) <= x_s on branch b, and True; or the upper end of the branch, and False."""
    i = _interval(branches, b, h)
    while True:
        high, x_high = float(branches[b, i, 1]), float(branches[b, i, 3])
        if x_high <= spring.base_m:
            if high == math.inf:
                # The force attracts on this interval, so the tip stays below L - x_s.
                high = max(spring.L - spring.base_m, h)
            return _root(tip, spring, b, h, high, h), True
        h = high
        if i == int(branches[b, 0, 0]):
            return h, False
        i += 1
        if branches[b, i, 2] <= spring.base_m:
            return h, True


@compiled
def _interval(branches: npt.NDArray[np.float64], b: int, h: float) -> int:
    """Index of the interval of branch b that holds h; an inner end belongs to the interval above it."""
    i = int(branches[b, 0, 0])
    while i > 1 and h < branches[b, i, 0]:
        i -= 1
    return i


@compiled
def _root(tip: TipSample, spring: _Spring, b: int, low: float, high: float, start: float) -> float:
    """Solve X(h) = x_s where X falls from `low` (X >= x_s) to `high` (X <= x_s): Newton, kept in the bracket."""
    h = start
    for _ in range(_MOST_ITERATIONS):
        excess, slope = _excess(tip, spring, b, h)
        if excess > 0.0:
            low = h
        else:
            high = h
        new = h - excess / min(slope, -1e-150)
        if abs(new - h) <= _TOLERANCE_M:
            return min(max(new, low), high)
        if not low < new < high:
            new = 0.5 * (low + high)
            if high - low <= _TOLERANCE_M:
                return new
        h = new
    return h


def initial_state(plant: Plant, base_m: float) -> PlantState:
    """Equilibrium at the base position x_s [m] of a tip that came from far away."""
    far = max(plant.rest_distance_m - base_m, plant.tip.meniscus_break_m, plant.tip.contact_end_m) + _FAR_M
    return equilibrium(plant, PlantState(far, False, False), base_m)


def _start(plant: Plant, inputs: PlantInputs) -> PlantState:
    return initial_state(plant, inputs.base_m + inputs.height_m)


register_part(Plant, Part(_start, step))


def build_plant(tip: TipSample, stiffness_n_per_m: float, rest_distance_m: float, volts_per_m: float) -> Plant:
    """Build the cantilever over a sample, with the monotonic intervals of X on every branch.

    Args:
        tip: The force between tip and sample.
        stiffness_n_per_m: The stiffness of the cantilever, k [N/m], > 0.
        rest_distance_m: The distance at rest, L [m], > 0.
        volts_per_m: The gain of the read-out, Eq. 3 [V/m].

    Raises:
        ValueError: k, L or the gain is not finite, or k or L is not positive; the message names value and unit.
    """
    k, L = stiffness_n_per_m, rest_distance_m
    for name, value, unit in (("cantilever stiffness k", k, "N/m"), ("rest distance L", L, "m")):
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{name} = {value} {unit} must be finite and > 0 {unit}")
    if not math.isfinite(volts_per_m):
        raise ValueError(f"read-out gain = {volts_per_m} V/m must be finite")
    intervals = [_intervals(tip, k, L, b) for b in range(4)]
    branches = np.zeros((4, 1 + max(len(rows) for rows in intervals), 4))
    for b, rows in enumerate(intervals):
        branches[b, 0, :3] = (len(rows), *_passages(tip, b))
        branches[b, 1 : 1 + len(rows)] = np.reshape(rows, (-1, 4))
    lowest = (
        -tip.capillary_force_n - tip.hamaker_j * tip.radius_m / tip.sigma_m**2 - 2.0 * tip.table.contact.force_unit_n
    )
    return Plant(tip, k, L, volts_per_m, lowest, branches)


def _limits(tip: TipSample, b: int) -> tuple[float, float]:
    """Return the interval of h [m] on which branch b exists; lower above upper where the branch does not exist."""
    contact, meniscus = b >= 2, b % 2 == 1
    if meniscus and not tip.has_meniscus:
        return math.inf, -math.inf
    if tip.as_printed:
        # In the printed Eq. 6 the retract law holds from the first contact to the break, and contact has no meniscus.
        if contact:
            return -math.inf, tip.contact_end_m
        return tip.contact_onset_m, tip.meniscus_break_m if meniscus else math.inf
    low = -math.inf if contact else tip.contact_onset_m
    high = tip.contact_end_m if contact else math.inf
    if tip.has_meniscus and not meniscus:
        low = max(low, tip.meniscus_width_m)
    return low, min(high, tip.meniscus_break_m) if meniscus else high


def _passages(tip: TipSample, b: int) -> tuple[int, int]:
    """Return the branches that the tip enters at the lower and at the upper end of branch b."""
    contact, meniscus = b // 2, b % 2
    if tip.as_printed:
        below = 2 + int(tip.has_meniscus)
        above = meniscus if contact else 0
        return below, above
    forms = tip.has_meniscus and not meniscus and (contact == 1 or tip.meniscus_width_m > tip.contact_onset_m)
    below = 2 * contact + 1 if forms else 2 + meniscus
    breaks = meniscus and (not contact or tip.meniscus_break_m < tip.contact_end_m or not tip.has_meniscus)
    above = 2 * contact if breaks else meniscus
    return below, above


def _intervals(tip: TipSample, k: float, L: float, b: int) -> list[tuple[float, float, float, float]]:
    low, high = _limits(tip, b)
    if not low < high:
        return []
    contact, meniscus = b >= 2, b % 2 == 1

    def base(h: float) -> float:
        return L - h + branch_force(tip, h, contact, meniscus)[0] / k

    def rises(h: float) -> bool:
        return branch_force(tip, h, contact, meniscus)[1] > k

    grid = _grid(tip, low, high, contact)
    inside = [0.5 * (a + c) for a, c in pairwise(grid)]
    ends = [low]
    for (a, c), edge in zip(pairwise(inside), grid[1:-1], strict=True):
        if edge in _corners(tip, contact):
            ends.append(edge)
        elif rises(a) != rises(c):
            ends.append(_turn(rises, a, c))
    ends.append(high)
    # A jump of the printed force belongs to the interval above it, so the one below ends just before.
    return [
        (
            a,
            c,
            math.inf if a == -math.inf else base(a),
            -math.inf if c == math.inf else base(math.nextafter(c, a)),
        )
        for a, c in pairwise(ends)
    ]


def _corners(tip: TipSample, contact: bool) -> tuple[float, ...]:
    """Distances at which the force or its gradient jumps inside a branch."""
    return (tip.contact_distance_m,) if contact else (tip.meniscus_width_m,)


def _grid(tip: TipSample, low: float, high: float, contact: bool) -> list[float]:
    """Return the distances [m] between which extrema are sought: fine where the force bends, corners included."""
    if contact:
        # Equal steps of sqrt(delta - delta_start), fine towards the end of the contact, and the cohesive branch.
        table = tip.table
        u = np.linspace(0.0, math.sqrt(table.end_m - table.start_m), _SCAN_POINTS)
        cohesive = np.linspace(table.cohesive_end_m, table.start_m, _SCAN_POINTS // 10)
        points = tip.contact_distance_m - np.concatenate([table.start_m + u * u, cohesive])
    else:
        points = np.geomspace(low, _FAR_M, _SCAN_POINTS)
    corners = [h for h in _corners(tip, contact) if low < h < high]
    inner = np.unique(np.concatenate([points, corners]))
    finite_low = max(low, float(inner[0]))
    finite_high = min(high, float(inner[-1]))
    return [finite_low, *inner[(inner > finite_low) & (inner < finite_high)].tolist(), finite_high]


def _turn(rises: Callable[[float], bool], low: float, high: float) -> float:
    """Bisect for the extremum of X between two distances at which it goes in opposite directions."""
    rises_low = rises(low)
    while True:
        mid = 0.5 * (low + high)
        if mid <= low or mid >= high:
            return mid
        if rises(mid) == rises_low:
            low = mid
        else:
            high = mid
