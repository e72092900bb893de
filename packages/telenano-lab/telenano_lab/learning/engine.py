"""Episodes in which a tip pushes a particle, many at once; all random values of an episode are drawn before it begins.

A row is an episode. Its physics is one `push_step` per millisecond, its control a step of 20 ms. An agent observes what
an instrument measures: the place of the tip, its deflection and lateral force with noise, and the believed place of the
particle. That place comes from an image, with an error, until the tip feels the particle: then it lies in the direction
of the force that the tip exerts, d away. The true place of the particle does not enter the observations.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import always_compiled
from telenano_lab.assembly import (
    KINDS,
    Spring,
    TipShape,
    X,
    Y,
    hold_of,
    packed,
    push_step,
    tip_shape,
    touch_distance_m,
)

Array = npt.NDArray[np.float64]

# Time step of the simulation.
PHYSICS_S = 1e-3
# The period at which an agent acts.
CONTROL_S = 20e-3
# An action of 1 moves the tip laterally at this speed.
SPEED_M_PER_S = 2e-6
TIP_RADIUS_M = 10e-9
# Height of the tip in a push.
LOW_M = 5e-9
# The tip is lifted and lowered at this speed.
_LIFT_M_PER_S = 20e-6
# Normal and lateral stiffness of the cantilever.
_K_N_PER_M = 1.0
_K_LATERAL_N_PER_M = 100.0
_REST_S = 10e-3
# A particle has arrived within this share of its diameter from its goal.
ARRIVED_SHARE = 0.1
# The tip counts as at rest up to this share of its greatest speed.
AT_REST = 0.05
# A lateral force above this share of the usual friction is a contact.
_CONTACT_SHARE = 0.15

KIND = KINDS["latex_250"]
_USUAL_CONE = math.radians(15.0)
# Units of an agent: d of the usual particle and tip, and the usual kinetic friction.
D_M = touch_distance_m(tip_shape(TIP_RADIUS_M, _USUAL_CONE), KIND.radius_m, LOW_M)
F_N = hold_of(KIND, 0.5, "slide", TIP_RADIUS_M, _USUAL_CONE, 0.0).kinetic_n
HIGH_M = 2.0 * 1.05 * KIND.radius_m + 100e-9
TOLERANCE_M = ARRIVED_SHARE * 2.0 * KIND.radius_m

# Columns of `given`, the values drawn for an episode: goal [m], drift of the sample [m/s], known radius and cone [m,
# rad], noise of the lateral force [N] and of the deflection [m].
GOAL_X, GOAL_Y, DRIFT_X, DRIFT_Y, KNOWN_M, KNOWN_SIN, KNOWN_COS, KNOWN_TAN, FORCE_NOISE, HEIGHT_NOISE = range(10)
_GIVEN = 10
# Columns of `state`: the tip [m], time [s], contact, felt force [N] and deflection [m], believed place and its standard
# error [m], losses, largest force [N], whether the tip stands, and the true distance from the goal [m].
TIP_X, TIP_Y, TIP_Z, TIME, CONTACT, FELT_X, FELT_Y, BENT = range(8)
BELIEVED_X, BELIEVED_Y, ERROR, LOSSES, PEAK, STANDS, TRUE_ERROR = range(8, 15)
_STATE = 15
# An agent observes this many values, the achieved goal, and the desired one.
OBSERVED = 10
AGENT_VALUES = 14
_NOISES = 3


class Drawn(NamedTuple):
    """The random values of an episode: rows of `given` and `state`, particle (fixed, moving), tip and spring, noise."""

    given: Array
    state: Array
    fixed: Array
    moving: Array
    model: Array
    noise: Array


def drawn(random: np.random.Generator, steps: int) -> Drawn:
    """Draw an episode of at most this number of steps: radius, friction, cone, drift, errors, goal and noise."""
    cone = math.radians(random.uniform(10.0, 20.0))
    shear_pa = KIND.shear_pa * math.exp(0.3 * random.standard_normal())
    kind = KIND._replace(radius_m=KIND.radius_m * random.uniform(0.95, 1.05), shear_pa=shear_pa)
    hold = hold_of(kind, random.uniform(0.3, 0.6), "slide", TIP_RADIUS_M, cone, 0.0)
    heading, way_m = random.uniform(-math.pi, math.pi), random.uniform(3.0, 6.0) * D_M
    drift_m_per_s, drifts = random.uniform(0.0, 0.1e-9), random.uniform(-math.pi, math.pi)
    error_m, beside = random.uniform(2e-9, 20e-9), random.standard_normal(2)
    bearing = random.uniform(-math.pi, math.pi)
    tip = tip_shape(TIP_RADIUS_M, cone + math.radians(2.0) * random.standard_normal())
    constants, state = np.zeros(_GIVEN), np.zeros(_STATE)
    constants[[GOAL_X, GOAL_Y]] = way_m * math.cos(heading), way_m * math.sin(heading)
    constants[[DRIFT_X, DRIFT_Y]] = drift_m_per_s * math.cos(drifts), drift_m_per_s * math.sin(drifts)
    constants[KNOWN_M] = kind.radius_m * (1.0 + 0.01 * random.standard_normal())
    constants[[KNOWN_SIN, KNOWN_COS, KNOWN_TAN]] = tip.sin_cone, tip.cos_cone, tip.tan_cone
    constants[[FORCE_NOISE, HEIGHT_NOISE]] = random.uniform(0.1e-9, 0.5e-9), 0.2e-9
    state[[BELIEVED_X, BELIEVED_Y]] = error_m * beside
    state[[ERROR, TIP_Z, STANDS]] = error_m, HIGH_M, 1.0
    state[[TIP_X, TIP_Y]] = 3.0 * D_M * math.cos(bearing), 3.0 * D_M * math.sin(bearing)
    model = packed(tip_shape(TIP_RADIUS_M, cone), Spring(_K_N_PER_M, _K_LATERAL_N_PER_M, 0.0, False, _REST_S))
    fixed = np.array([[kind.radius_m, *hold]])
    return Drawn(constants, state, fixed, np.array([[0.0, 0.0, 1.0]]), model, random.standard_normal((steps, _NOISES)))


@always_compiled
def advance(
    drawn: Array,
    state: Array,
    fixed: Array,
    moving: Array,
    model: Array,
    noise: Array,
    taken: npt.NDArray[np.int64],
    action: Array,
) -> None:
    """Take a control step in each row, and write the results into `state` and `moving`.

    Args:
        drawn: Values drawn for the episodes, shape (n, 10).
        state: State of the episodes, shape (n, 15), written.
        fixed: Constants of the particles, shape (n, 1, 4).
        moving: State of the particles, shape (n, 1, 3), written.
        model: Tip and spring, shape (n, 9).
        noise: Standard normal numbers, shape (n, steps, 3): for the lateral force in x and y, and for the deflection.
        taken: Number of earlier steps of each episode, shape (n,).
        action: Speed in x and y, and lift, each -1 to 1, shape (n, 3).
    """
    ticks = round(CONTROL_S / PHYSICS_S)
    for i in range(drawn.shape[0]):
        g, s, m, draws = drawn[i], state[i], model[i], noise[i, taken[i]]
        tip, spring = TipShape(m[0], m[1], m[2], m[3]), Spring(m[4], m[5], m[6], m[7] != 0.0, m[8])
        speed_x = SPEED_M_PER_S * min(max(action[i, 0], -1.0), 1.0)
        speed_y = SPEED_M_PER_S * min(max(action[i, 1], -1.0), 1.0)
        high = action[i, 2] > 0.0
        force_x, force_y, lift = 0.0, 0.0, 0.0
        pushed = moving[i]
        for _ in range(ticks):
            to_go = (HIGH_M if high else LOW_M) - s[TIP_Z]
            s[TIP_Z] += min(max(to_go, -_LIFT_M_PER_S * PHYSICS_S), _LIFT_M_PER_S * PHYSICS_S)
            x0, y0 = s[TIP_X] - g[DRIFT_X] * s[TIME], s[TIP_Y] - g[DRIFT_Y] * s[TIME]
            s[TIME] += PHYSICS_S
            s[TIP_X] += speed_x * PHYSICS_S
            s[TIP_Y] += speed_y * PHYSICS_S
            way = (x0, y0, s[TIP_X] - g[DRIFT_X] * s[TIME], s[TIP_Y] - g[DRIFT_Y] * s[TIME])
            pushed, met = push_step(tip, spring, fixed[i], pushed, way, (s[TIP_Z], s[TIP_Z]), PHYSICS_S)
            force_x += met.push_x_n / ticks
            force_y += met.push_y_n / ticks
            lift += met.lift_n / ticks
            s[PEAK] = max(s[PEAK], math.sqrt(met.push_x_n * met.push_x_n + met.push_y_n * met.push_y_n))
        moving[i] = pushed
        s[FELT_X], s[FELT_Y] = force_x + g[FORCE_NOISE] * draws[0], force_y + g[FORCE_NOISE] * draws[1]
        s[BENT] = lift / spring.normal_n_per_m + g[HEIGHT_NOISE] * draws[2]
        fastest = AT_REST * SPEED_M_PER_S
        s[STANDS] = 1.0 if high or speed_x * speed_x + speed_y * speed_y <= fastest * fastest else 0.0
        _believe(g, s, high)


@always_compiled
def _believe(g: Array, s: Array, high: bool) -> None:
    """Update the believed place: a felt particle lies in the direction of the force that the tip exerts, d away."""
    size = math.sqrt(s[FELT_X] * s[FELT_X] + s[FELT_Y] * s[FELT_Y])
    if size <= max(_CONTACT_SHARE * F_N, 4.0 * g[FORCE_NOISE]):
        if s[CONTACT] > 0.0 and not high:
            s[LOSSES] += 1.0
        s[CONTACT] = 0.0
        return
    s[CONTACT] = 1.0
    tip = TipShape(TIP_RADIUS_M, g[KNOWN_SIN], g[KNOWN_COS], g[KNOWN_TAN])
    reach = touch_distance_m(tip, g[KNOWN_M], s[TIP_Z] + max(s[BENT], 0.0))
    s[BELIEVED_X] = s[TIP_X] - reach * s[FELT_X] / size
    s[BELIEVED_Y] = s[TIP_Y] - reach * s[FELT_Y] / size
    aside, known_m = reach * g[FORCE_NOISE] / size, 0.05 * reach
    s[ERROR] = math.sqrt(aside * aside + known_m * known_m)


@always_compiled
def tell(drawn: Array, state: Array, moving: Array, observations: npt.NDArray[np.float32], truth: bool) -> None:
    """Write the observations of the agent, shape (n, 14), in units of d and of the usual friction.

    With `truth` the true place of the particle replaces the believed one. The true distance from the goal goes into
    `state`, for the evaluation.
    """
    for i in range(drawn.shape[0]):
        g, s, row = drawn[i], state[i], observations[i]
        true_x, true_y = moving[i, 0, X], moving[i, 0, Y]
        x, y = true_x - g[GOAL_X], true_y - g[GOAL_Y]
        s[TRUE_ERROR] = math.sqrt(x * x + y * y)
        if not truth:
            true_x, true_y = s[BELIEVED_X], s[BELIEVED_Y]
        row[0], row[1], row[2] = s[TIP_X] / D_M, s[TIP_Y] / D_M, s[TIP_Z] / D_M
        row[3], row[4], row[5] = _K_N_PER_M * s[BENT] / F_N, s[FELT_X] / F_N, s[FELT_Y] / F_N
        row[6], row[9] = s[TIME] / 10.0, 0.0 if truth else s[ERROR] / D_M
        row[7] = row[10] = true_x / D_M
        row[8] = row[11] = true_y / D_M
        row[12], row[13] = g[GOAL_X] / D_M, g[GOAL_Y] / D_M


class Episodes:
    """Rows of episodes that run side by side, each with a random generator of its own.

    Args:
        count: The number of rows.
        longest_s: The longest episode, in simulated time [s].
        truth: Whether an agent observes the true place of the particle.
    """

    def __init__(self, count: int, longest_s: float, *, truth: bool = False) -> None:
        self._truth, self._observations = truth, np.zeros((count, AGENT_VALUES), np.float32)
        self.steps = max(round(longest_s / CONTROL_S), 1)
        self.given, self.state = np.zeros((count, _GIVEN)), np.zeros((count, _STATE))
        self.fixed, self.moving = np.zeros((count, 1, 4)), np.zeros((count, 1, 3))
        self.model, self.noise = np.zeros((count, 9)), np.zeros((count, self.steps, _NOISES))
        self.taken = np.zeros(count, np.int64)

    def begin(self, row: int, random: np.random.Generator) -> None:
        """Draw an episode for a row and begin it."""
        parts = (self.given, self.state, self.fixed, self.moving, self.model, self.noise)
        for part, values in zip(parts, drawn(random, self.steps), strict=True):
            part[row] = values
        self.taken[row] = 0

    def step(self, action: Array) -> None:
        """Take a control step in each row; action has the shape (n, 3)."""
        advance(self.given, self.state, self.fixed, self.moving, self.model, self.noise, self.taken, action)
        self.taken += 1

    def observations(self) -> npt.NDArray[np.float32]:
        """Return the observations of the agent, a row for each episode, shape (n, 14)."""
        tell(self.given, self.state, self.moving, self._observations, self._truth)
        return self._observations.copy()
