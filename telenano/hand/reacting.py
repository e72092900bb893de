"""A hand that moves and waits: it presses, waits until the arm stands and the answer has come, and corrects.

A move changes its force by a share of the error between the force that it aims at and the one that it feels, at a
limited rate and with a scatter. Then it waits: until the arm has stood still for a reaction time and for as long as
the remote side takes to answer, which it has learnt. So do people whose remote tool answers late: W. R. Ferrell,
IEEE Trans. Human Factors in Electronics 6, 24-32 (1965).

Without scatter the error after n moves is (1 - gain)^n of the first, so that it makes
n = ceil(ln(tolerance / target) / ln(1 - gain)) moves, and each but the first costs the answer once:

    T(d) = T(0) + (n - 1) d,   d the time of the answer, the round trip of the link,

besides what the delay changes in the settling of the law itself.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.hand.operator import OperatorInputs, OperatorOutputs, interpolate
from telenano.numerics.compiler import compiled


class ReactingParams(NamedTuple):
    """Constants of the hand.

    times_s, values: corners of the force that it aims at [N]. reaction_time_s, answer_s: what it waits for after a
    move, while the arm is slower than still_m_per_s. gain: share of the error that a move corrects; noise: scatter of
    that share, whose draws are `errors`, of unit variance, shape (n,). tolerance_n: error that it leaves. rate_n_per_s:
    how fast its force changes.
    """

    times_s: NDArray[np.float64]
    values: NDArray[np.float64]
    reaction_time_s: float
    answer_s: float
    still_m_per_s: float
    gain: float
    noise: float
    errors: NDArray[np.float64]
    tolerance_n: float
    rate_n_per_s: float
    max_force_n: float


class ReactingState(NamedTuple):
    """Its force now and after its move [N], how long the arm has stood since [s], and how many moves it has made."""

    force_n: float
    goal_n: float
    waited_s: float
    moves: int


def at_rest(params: ReactingParams, position_m: float) -> ReactingState:
    """Return the hand before its first move, wherever the arm is."""
    return ReactingState(0.0, 0.0, 0.0, 0)


@compiled
def step(
    params: ReactingParams, state: ReactingState, inputs: OperatorInputs, dt: float
) -> tuple[ReactingState, OperatorOutputs]:
    """Return the force of the hand at the end of a period dt [s], > 0; before the session starts there is none."""
    if inputs.session_time_s < 0.0:
        return ReactingState(0.0, 0.0, 0.0, 0), OperatorOutputs(0.0, False)
    most = params.rate_n_per_s * dt
    force = state.force_n + min(max(state.goal_n - state.force_n, -most), most)
    goal_n, waited_s, moves = state.goal_n, state.waited_s + dt, state.moves
    way = abs(inputs.end_position_m - inputs.start_position_m)
    if force != goal_n or way > params.still_m_per_s * dt:
        waited_s = 0.0
    # nothing answers to a hand that has not moved yet
    wait_s = params.reaction_time_s + (params.answer_s if moves > 0 else 0.0)
    if waited_s >= wait_s:
        error = interpolate(params.times_s, params.values, inputs.session_time_s, params.values[0]) - force
        if abs(error) > params.tolerance_n:
            goal_n += params.gain * (1.0 + params.noise * params.errors[moves % len(params.errors)]) * error
            moves += 1
        waited_s = 0.0
    limited = abs(force) > params.max_force_n
    felt = math.copysign(params.max_force_n, force) if limited else force
    return ReactingState(force, goal_n, waited_s, moves), OperatorOutputs(felt, limited)
