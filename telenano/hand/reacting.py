"""A simulated hand that moves and waits: it presses, waits until the arm stands still and the answer is in, corrects.

A move changes the force of the hand by a share of the error between the force aimed at and the hand's own force, at a
limited rate and with a scatter. Then the hand waits until the arm has stood still for a reaction time plus the answer
time of the remote side, which the hand has learnt. People whose remote tool answers late do the same: W. R. Ferrell,
IEEE Trans. Human Factors in Electronics 6, 24-32 (1965).

Without scatter the error after n moves is (1 - gain)^n of the first, so that the hand makes
n = ceil(ln(tolerance / target) / ln(1 - gain)) moves, each of which but the first costs the answer time once:

    T(d) = T(0) + (n - 1) d,   d the answer time, the round trip of the link,

not counting the effect of the delay on the settling of the law itself.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.extend.operators import OperatorInputs, OperatorOutputs
from telenano.hand.operator import interpolate
from telenano.numerics.compiler import compiled


class ReactingParams(NamedTuple):
    """Constants of the hand.

    times_s [s], values [N]: corners of the force that it aims at. reaction_time_s, answer_s: their sum is the wait
    after a move, which counts while the arm is slower than still_m_per_s. gain: share of the error that a move
    corrects; noise: scatter of that share, whose draws are `errors`, of unit variance, shape (n,). tolerance_n: error
    that it leaves uncorrected. rate_n_per_s: rate at which its force changes.
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
    """Force now and after the move [N], time for which the arm has stood still since [s], and number of moves made."""

    force_n: float
    goal_n: float
    waited_s: float
    moves: int


def at_rest(params: ReactingParams, position_m: float) -> ReactingState:
    """Return the state of the hand before its first move, which does not depend on the arm."""
    return ReactingState(0.0, 0.0, 0.0, 0)


@compiled
def step(
    params: ReactingParams, state: ReactingState, inputs: OperatorInputs, dt: float
) -> tuple[ReactingState, OperatorOutputs]:
    """Return the force of the hand at the end of a period dt [s], > 0; zero before the session starts."""
    if inputs.session_time_s < 0.0:
        return ReactingState(0.0, 0.0, 0.0, 0), OperatorOutputs(0.0, False)
    most = params.rate_n_per_s * dt
    force = state.force_n + min(max(state.goal_n - state.force_n, -most), most)
    goal_n, waited_s, moves = state.goal_n, state.waited_s + dt, state.moves
    way = abs(inputs.end_position_m - inputs.start_position_m)
    if force != goal_n or way > params.still_m_per_s * dt:
        waited_s = 0.0
    # Before its first move the hand waits for no answer.
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
