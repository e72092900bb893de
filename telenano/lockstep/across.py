"""Lateral motion of the hand in lockstep: the steps that the nodes call, between those of the law's loop.

The stylus and the person step with the haptic site. The reference of the tip is sent with the forward signals of the
law, and the position of the stage and the force on the tip return with the answers. So delay, loss and silence of the
link are the same as for the law.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.extend.laws import HandSample
from telenano.hand.lateral_hand import LateralHandParams, LateralHandState, lateral_hand_step
from telenano.laws.lateral import (
    LateralFar,
    LateralHand,
    LateralMasterState,
    LateralParams,
    LateralSlaveState,
    lateral_at_rest,
    lateral_master_step,
    lateral_slave_at_rest,
    lateral_slave_step,
    steering_force_n,
)
from telenano.lockstep.link import Schedule
from telenano.numerics.compiler import inlined
from telenano.sections.controller_section import ControllerConfig
from telenano.sections.lateral_hand_section import LateralHandConfig

Array = npt.NDArray[np.float64]
Pair = tuple[float, float]

# Columns of the rows: position of the stylus [m], force shown to it [N], position of the stage [m], force on the tip
# [N], and energy that has entered laterally and by holding the depth [J]. The columns of a hand that steers follow.
X, Y, SHOWN_X, SHOWN_Y, STAGE_X, STAGE_Y, FORCE_X, FORCE_Y, ENTERED, ENTERED_DEPTH = range(10)
WIDTH = 10


class AcrossPath(NamedTuple):
    """The lateral path: constants, the data on the link, and the results, one row per tick.

    silence_s: time without an answer after which the state of the tip is unknown [s]; forward: references by the number
    of the sample, (window, 2) [m]; backward: position and force by the number of the answer, (window, 4) [m, N]; rows:
    (ticks, WIDTH or more), columns X to ENTERED_DEPTH and those of a hand that steers. The loop writes the columns of
    stage, tip and hand.
    """

    lateral: LateralParams
    hand: LateralHandParams
    silence_s: float
    forward: Array
    backward: Array
    rows: Array


class AcrossState(NamedTuple):
    """The stylus, both halves, the newest answer, and the work of the force that holds the depth [J]."""

    hand: LateralHandState
    master: LateralMasterState
    slave: LateralSlaveState
    far: LateralFar
    depth_j: float


def across_path(
    controller: ControllerConfig, hand: LateralHandConfig, schedule: Schedule, further: int = 0
) -> AcrossPath:
    """Return the empty lateral path of a rig over a link, with room for further columns of a hand that steers."""
    window = schedule.window
    return AcrossPath(
        controller.lateral_params(),
        hand.to_params(),
        controller.law_config().silence_limit_s,
        np.zeros((window, 2)),
        np.zeros((window, 4)),
        np.zeros((schedule.ticks, WIDTH + further)),
    )


@inlined
def across_at_rest() -> AcrossState:
    """Return the state before the first sample."""
    far = LateralFar(0.0, 0.0, 0.0, 0.0, False)
    hand = LateralHandState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    return AcrossState(hand, lateral_at_rest(), lateral_slave_at_rest(), far, 0.0)


@inlined
def across_steered(path: AcrossPath, state: AcrossState, speed_m_per_s: Pair) -> Pair:
    """Return the lateral force of a person who steers the tip at a speed [m/s], (x, y) [N]."""
    held, hand, shown = state.master.held, state.hand, state.master.force_n
    place_m, neutral_m, shown_n = (hand.x_m, hand.y_m), (held.neutral_x_m, held.neutral_y_m), (shown[0], shown[1])
    k = path.hand.stiffness_n_per_m
    return steering_force_n(path.lateral.motion, k, place_m, neutral_m, shown_n, speed_m_per_s)


@inlined
def across_sampled(
    path: AcrossPath,
    state: AcrossState,
    hand: HandSample,
    is_known: bool,
    tick: int,
    session_s: float,
    dt: float,
    own_n: Pair,
) -> AcrossState:
    """Return the state after a sample of the hand, and put its reference on the link.

    Args:
        path: The path.
        state: The state at the previous sample.
        hand: The sample along the axis of the law.
        is_known: Whether the newest answer is still valid.
        tick: The number of the sample.
        session_s: The time of the operator's force profile [s].
        dt: The time between two samples [s].
        own_n: The force of a person who steers, (x, y) [N].
    """
    force, depth_j = state.master.force_n, state.depth_j
    if state.master.held.live:
        depth_j -= force[2] * (hand.position_m - state.master.held.z_m)
    shown = (force[0], force[1]) if hand.following else (0.0, 0.0)
    stylus = lateral_hand_step(path.hand, state.hand, own_n, shown, session_s, dt)
    sample = LateralHand(
        stylus.x_m,
        stylus.y_m,
        hand.position_m,
        stylus.speed_x_m_per_s,
        stylus.speed_y_m_per_s,
        hand.velocity_m_per_s,
        hand.following,
    )
    was = state.far
    far = LateralFar(was.force_x_n, was.force_y_n, was.x_m, was.y_m, is_known)
    master = lateral_master_step(path.lateral, state.master, sample, far, dt)
    path.forward[tick & (path.forward.shape[0] - 1)] = master.travel.x_m, master.travel.y_m
    row = path.rows[tick]
    row[X], row[Y], row[SHOWN_X], row[SHOWN_Y] = stylus.x_m, stylus.y_m, master.force_n[0], master.force_n[1]
    row[ENTERED], row[ENTERED_DEPTH] = master.store.entered_j, depth_j
    return AcrossState(stylus, master, state.slave, far, depth_j)


@inlined
def guided(state: AcrossState, hand: HandSample) -> HandSample:
    """Return a sample of the hand for the law: with the force that holds its depth added."""
    force_n = hand.force_n + state.master.force_n[2]
    return HandSample(hand.position_m, hand.velocity_m_per_s, force_n, hand.following)


@inlined
def across_signalled(
    path: AcrossPath, state: AcrossState, number: int, place_m: tuple[float, float], follows: bool, dt: float
) -> AcrossState:
    """Return the state after the signal of a sample has reached the slave half, dt [s] after the previous one."""
    row = path.forward[number & (path.forward.shape[0] - 1)]
    slave = lateral_slave_step(path.lateral, state.slave, (row[0], row[1]), place_m, follows, dt)
    return AcrossState(state.hand, state.master, slave, state.far, state.depth_j)


@inlined
def across_heard(path: AcrossPath, state: AcrossState, number: int) -> AcrossState:
    """Return the state after an answer has reached the master half."""
    row = path.backward[number & (path.backward.shape[0] - 1)]
    far = LateralFar(row[2], row[3], row[0], row[1], True)
    return AcrossState(state.hand, state.master, state.slave, far, state.depth_j)
