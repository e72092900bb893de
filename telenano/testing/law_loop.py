"""A law in closed loop: both halves, a link of any delay and loss, a hand that presses and an environment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from telenano.extend.laws import NO_SIGNAL, HandSample, TipMeasurement
from telenano.laws.clamp import clamped
from telenano.sections.clamp_section import ClampConfig
from telenano.sections.controller_section import LAWS, ControllerConfig

PERIOD_S = 1e-3
LOST = -1


@dataclass
class LawRun:
    """Results of a run, one value per tick.

    reference_m, shown_n: reference of the hand [m], and force shown to it [N]; base_m, force_n: position of the base
    [m], and force on the tip [N]; entered_j: work of the hand on the law since the start; left_j: work of the law on
    the environment, at the hand's scale [J]; masters, slaves: the states of both halves.
    """

    reference_m: Any
    shown_n: Any
    base_m: Any
    force_n: Any
    entered_j: Any
    left_j: Any
    masters: list[Any]
    slaves: list[Any]


def run_law(
    name: str,
    hand_force: Callable[[int], float],
    environment: Callable[[float], float],
    ticks: int,
    forward: Callable[[int], int] = lambda n: 0,
    backward: Callable[[int], int] = lambda n: 0,
    touches: Callable[[float], bool] = lambda force_n: force_n != 0.0,
    clamp: ClampConfig = ClampConfig(),  # noqa: B008
    **parameters: Any,
) -> LawRun:
    """Run a law; `forward(n)`, `backward(n)`: delay of the signal of tick n in ticks, or LOST.

    `hand_force(n)`: force of the hand [N]; `environment(base_m)`: force on the tip [N]; `touches(force_n)`: whether the
    tip is in contact. A reader uses only signals newer than the one that it has, as on the bus. Without delay the
    answer arrives in the same tick.
    """
    law = LAWS[name]
    config = ControllerConfig.model_validate({"law": name, name: parameters, "clamp": clamp.model_dump()})
    params, behind = config.params(), config.clamp_params()
    scales = getattr(params, "mass", getattr(params, "impedance", params))
    hand = HandSample(0.0, 0.0, 0.0, True)
    tip = TipMeasurement(0.0, environment(0.0), 0.0, False, touches(environment(0.0)), True, 0.0)
    master, slave = law.master_start(params, hand), law.slave_start(params, tip)
    out: list[tuple[int, int, Any]] = []
    back: list[tuple[int, int, Any]] = []
    served, answered, received_at, answer = -1, -1, -1, NO_SIGNAL
    last, last_at = NO_SIGNAL, -1
    rows, masters, slaves, entered, left, x = [], [], [], 0.0, 0.0, 0.0
    for n in range(ticks):
        hand = HandSample(x, 0.0, hand_force(n), True)
        master, signal = law.master_send(params, master, hand, PERIOD_S)
        if forward(n) != LOST:
            out.append((n + forward(n), n, signal))
        due = [(sent, message) for arrives, sent, message in out if arrives <= n and sent > served]
        out = [entry for entry in out if entry[0] > n]
        if due:
            served, last = max(due, key=lambda pair: pair[0])
            last_at = n
        # If no signal comes, the instrument steps by itself, and the slave half with it.
        local = config.local_loop and last_at >= 0 and last.active and n - last_at <= 50
        if due or local:
            silence = (n - last_at) * PERIOD_S
            slave, wanted = law.slave_receive(params, slave, last._replace(silence_s=silence), tip, PERIOD_S)
            wanted = clamped(behind, wanted, last, tip)
            force = environment(wanted.position_m)
            before, tip = tip, TipMeasurement(wanted.position_m, force, 0.0, False, touches(force), True, 0.0)
            way = (tip.base_position_m - before.base_position_m) / scales.position_scale
            left += 0.5 * (before.force_n + tip.force_n) * scales.force_scale * way
            slave, reply = law.slave_send(params, slave, tip, PERIOD_S)
            if due and backward(n) != LOST:
                back.append((n + backward(n), served, reply))
        arrived = [(sent, message) for arrives, sent, message in back if arrives <= n and sent > answered]
        back = [entry for entry in back if entry[0] > n]
        if arrived:
            (answered, answer), received_at = max(arrived, key=lambda pair: pair[0]), n
        silence = (n - received_at) * PERIOD_S if received_at >= 0 else 1e9
        age = (n - answered) * PERIOD_S if received_at >= 0 else 0.0
        signal = answer._replace(silence_s=silence, round_trip_s=age)
        master, reference = law.master_receive(params, master, hand, signal, PERIOD_S)
        entered += hand.force_n * (reference.position_m - x)
        x = reference.position_m
        rows.append((x, reference.force_n, tip.base_position_m, tip.force_n, entered, left))
        masters.append(master)
        slaves.append(slave)
    reference, shown, base, force, work, given = np.array(rows).T
    return LawRun(reference, shown, base, force, work, given, masters, slaves)
