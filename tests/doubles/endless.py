"""A law in closed loop for an hour: an arm or a force that presses a spring over a link, with a periodic swing.

The device is ideal: the hand is at the law's reference. Readers use the newest signal of a tick, as on the bus.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.extend.laws import NO_SIGNAL, HandSample, PortSignal, TipMeasurement
from telenano.numerics.compiler import compiled, compiled_form
from telenano.sections.controller_section import LAWS, ControllerConfig

PERIOD_S = 1e-3
CYCLE_S = 2.0
# A block has ten cycles and a hold.
BLOCK_S, SWING_S = 25.0, 20.0
POSITION_SCALE, FORCE_SCALE = 1.5e-6, 1e8
# A sample so soft that 1 N would move the hand further than this is pressed with less force [m].
_FARTHEST_M = 8e-3
Array = npt.NDArray[Any]


class Block(NamedTuple):
    """Results of ten cycles and a hold: half the swing of the force in the tenth cycle and the mean force in the hold,
    as shares of the intended force, and the mean positions of the hand in the tenth cycle and in the hold [m]."""

    swing: float
    hold: float
    cycle_m: float
    hold_m: float


class Endless(NamedTuple):
    """The first and last block, the least energy in the two-port [J], and the greatest share of the intended force.

    master, slave: the states of the halves at the end.
    """

    first: Block
    last: Block
    lowest_j: float
    greatest: float
    master: Any
    slave: Any


@compiled
def _received(signal: PortSignal, silence_s: float, round_trip_s: float) -> PortSignal:
    return PortSignal(
        signal.position_m, signal.velocity_m_per_s, signal.force_n, signal.wave_sqrt_w, signal.energy_j,
        signal.separation_m, signal.separation_valid, signal.in_contact, signal.active, silence_s, round_trip_s,
    )  # fmt: skip


@functools.cache
def _loop(name: str) -> Callable[..., Any]:
    """Return the compiled loop of a law; rows: F_m [N], x_m [m], alpha_f F_s [N], energy in the two-port [J]."""
    law = LAWS[name]
    master_start, master_send, master_receive = law.master_start, law.master_send, law.master_receive
    slave_start, slave_receive, slave_send = law.slave_start, law.slave_receive, law.slave_send

    @compiled
    def run(
        params: Any, path: Array, arm: Any, stiffness: float, ways: Any, window: int, silent: int, rows: Array
    ) -> Any:
        k, b = arm
        forward, backward = ways
        ticks = len(path)
        tip = TipMeasurement(0.0, 0.0, 0.0, False, False, True, 0.0)
        hand = HandSample(0.0, 0.0, 0.0, True)
        master, slave = master_start(params, hand), slave_start(params, tip)
        arrived, returned = np.full(ticks + window, -1, np.int64), np.full(ticks + window, -1, np.int64)
        sent, answers = [NO_SIGNAL for _ in range(window)], [NO_SIGNAL for _ in range(window)]
        behind = np.full(window, 0, np.int64)
        last, last_at, served, answer, answer_at, answered = NO_SIGNAL, -1, -1, NO_SIGNAL, -1, -1
        x, v, energy = 0.0, 0.0, 0.0
        for n in range(ticks):
            before = path[max(n - 1, 0)]
            force = path[n] if k == 0.0 else k * (path[n] - x) + b * ((path[n] - before) / PERIOD_S - v)
            hand = HandSample(x, v, force, True)
            master, signal = master_send(params, master, hand, PERIOD_S)
            sent[n % window] = signal
            if forward[n] >= 0:
                arrived[n + forward[n]] = max(n, arrived[n + forward[n]])
            fresh = arrived[n] > served
            if fresh:
                served, last_at = arrived[n], n
                last = sent[served % window]
            if fresh or (last_at >= 0 and last.active and n - last_at <= silent):
                received = _received(last, (n - last_at) * PERIOD_S, 0.0)
                slave, wanted = slave_receive(params, slave, received, tip, PERIOD_S)
                way = (wanted.position_m - tip.base_position_m) / POSITION_SCALE
                pushed = stiffness * wanted.position_m if wanted.position_m > 0.0 else 0.0
                energy -= 0.5 * FORCE_SCALE * (pushed + tip.force_n) * way
                tip = TipMeasurement(wanted.position_m, pushed, 0.0, False, pushed > 0.0, True, 0.0)
                slave, reply = slave_send(params, slave, tip, PERIOD_S)
                if fresh:
                    answers[n % window], behind[n % window] = reply, served
                    if backward[n] >= 0:
                        returned[n + backward[n]] = max(n, returned[n + backward[n]])
            if returned[n] > answered:
                answered, answer_at = returned[n], n
                answer = answers[answered % window]
            silence = (n - answer_at) * PERIOD_S if answer_at >= 0 else 1e9
            age = (n - behind[answered % window]) * PERIOD_S if answer_at >= 0 else 0.0
            master, reference = master_receive(params, master, hand, _received(answer, silence, age), PERIOD_S)
            v = (reference.position_m - x) / PERIOD_S
            energy += force * (reference.position_m - x)
            x = reference.position_m
            rows[n, 0], rows[n, 1], rows[n, 2], rows[n, 3] = force, x, FORCE_SCALE * tip.force_n, energy
        return master, slave

    return compiled_form(run)


def _one_way(ticks: int, delay: int, jitter: int, loss: float, source: np.random.Generator) -> Array:
    ways = np.rint(delay + jitter * source.uniform(-1.0, 1.0, ticks)).astype(np.int64)
    ways = np.maximum(ways, 0)
    ways[source.random(ticks) < loss] = -1
    return ways


def endless(
    name: str,
    stiffness: float,
    round_trip_ms: int,
    *,
    arm: float = 0.0,
    seconds: float = 3600.0,
    jitter_ms: int = 0,
    loss: float = 0.0,
    seed: int = 0,
    **settings: float,
) -> Endless:
    """Run a law on a spring [N/m] with an arm [N/m], 0 for a hand of constant force, over a link; see `Endless`."""
    params = ControllerConfig.model_validate({"law": name, name: settings}).params()
    felt = stiffness * POSITION_SCALE * FORCE_SCALE
    intended = min(1.0, felt * _FARTHEST_M)
    time = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    at = time % BLOCK_S
    swing = np.where(at < SWING_S, np.sin(2.0 * np.pi * at / CYCLE_S), 0.0)
    path = intended * (1.0 + 0.3 * swing) * np.minimum(1.0, time / 0.5)
    if arm:
        path = path * (1.0 / felt + 1.0 / arm)
    source = np.random.default_rng(seed)
    ways = tuple(
        _one_way(len(path), delay, jitter_ms, loss, source)
        for delay in (round_trip_ms // 2, round_trip_ms - round_trip_ms // 2)
    )
    rows = np.empty((len(path), 4))
    silent = round(params.mass.silence_limit_s / PERIOD_S)
    window = 1 << (round_trip_ms + 4 * jitter_ms + 200).bit_length()
    damping = 0.0 if arm == 0.0 else 5.0 if arm < 500.0 else 20.0
    master, slave = _loop(name)(params, path, (float(arm), damping), stiffness, ways, window, silent, rows)
    last = int(seconds / BLOCK_S) - 1
    blocks = [_block(rows[round(n * BLOCK_S / PERIOD_S) :], intended) for n in (0, last)]
    return Endless(*blocks, float(rows[:, 3].min()), float(rows[:, 2].max()) / intended, master, slave)


def _block(rows: Array, intended: float) -> Block:
    cycle = rows[round((SWING_S - CYCLE_S) / PERIOD_S) : round(SWING_S / PERIOD_S)]
    hold = rows[round((BLOCK_S - CYCLE_S) / PERIOD_S) : round(BLOCK_S / PERIOD_S)]
    return Block(
        swing=0.5 * float(np.ptp(cycle[:, 2])) / intended,
        hold=float(hold[:, 2].mean()) / intended,
        cycle_m=float(cycle[:, 1].mean()),
        hold_m=float(hold[:, 1].mean()),
    )
