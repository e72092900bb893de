"""Bursts: signals that a link lets out together, in lockstep, are borne by every slave half that closes a loop."""

import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telenano_lab.studies.loops.cells import (
    Cell,
    CellResult,
    course_of,
    energies_of,
    judged,
    rig_of,
    scales_of,
    settle_s,
    settle_ticks,
)
from telenano_laws.model_mediated import ModelMediatedConfig

from telenano.extend.virtual_mass import FOLLOWED_M
from telenano.lockstep import Schedule, schedule_from
from telenano.settings import LinkSettings

PERIOD_NS = 1_000_000
# a tenth of a microjoule is what the servo of the device makes of a ripple
LEAST_J = -1e-6


def held(law: str, stiffness: float, direction: dict[str, Any], hand: str = "force") -> CellResult:
    """Return what becomes of a hand of 1 N over a round trip of 20 ms with such a link forward."""
    cell = Cell(
        law=law, environment="spring", hand=hand, round_trip_ms=20.0, stiffness_n_per_m=stiffness, jitter_ms=1e-3
    )
    link = LinkSettings.of({"seed": 1, "forward": {"delay_s": 0.01, **direction}, "backward": {"delay_s": 0.01}})
    return judged(cell, course_of(cell, cell.hand_points(), cell.hold_s()[1], measured=(link, Path())))


# finding A: -44.3 mJ and 32.7 N at 80 N/m over slots of 30 ms, -10.2 mJ at 150 N/m over 60 ms
@pytest.mark.check("a grid of slots and laws")
@pytest.mark.drawn(0.6, "telenano/laws/", "telenano/link/")
@pytest.mark.parametrize("law", ["wave", "passivity"])
@pytest.mark.parametrize(("stiffness", "slot_s"), [(40.0, 0.06), (80.0, 0.03), (80.0, 0.06), (150.0, 0.06)])
def test_slots_make_no_energy_and_press_no_harder_than_the_hand(law: str, stiffness: float, slot_s: float) -> None:
    result = held(law, stiffness, {"slots": {"min_interval_s": slot_s}})
    # slots beyond the deadline of 50 ms interrupt the loop for as long as the session lasts
    assert result.verdict in (("stable", "cannot_say") if slot_s > 0.05 else ("stable",))
    assert result.lowest_energy_j > LEAST_J
    assert result.peak_n is not None
    assert result.peak_n < 1.1


def bursts(ticks: int, pause_ms: int, apart_ns: int) -> Schedule:
    """Return a link that is silent for a pause, then lets all that waited out one after another, again and again."""
    sent = np.arange(ticks, dtype=np.int64)
    opens = (sent // pause_ms + 1) * pause_ms * PERIOD_NS
    forward = opens + (sent % pause_ms) * apart_ns + 10 * PERIOD_NS
    backward = forward + 10 * PERIOD_NS
    return schedule_from(forward, sent, backward, np.arange(ticks, dtype=np.int64), ticks, PERIOD_NS)


# These are nine tenths of what each law states to bear over such a line [N/m].
AT_LIMIT = {"wave": 175.0, "passivity": 315.0, "model_mediated": 157.0}


@pytest.mark.check("a grid of bursts and laws")
@pytest.mark.drawn(0.25)
@pytest.mark.parametrize("law", ["wave", "passivity", "model_mediated"])
@pytest.mark.parametrize("apart_us", [20, 100, 300])
@pytest.mark.parametrize("stiffness", [20.0, 80.0, 150.0, None])
@pytest.mark.parametrize(
    "pause_ms", [30, *(pytest.param(pause_ms, marks=pytest.mark.endurance) for pause_ms in (40, 60, 90)), 120]
)
def test_messages_of_a_burst_that_come_one_by_one_make_no_energy(
    law: str, apart_us: int, stiffness: float | None, pause_ms: int
) -> None:
    # `model_mediated` lets the hand go in a pause of more than 50 ms, while the tip is still pressed
    least_j = {"wave": -8e-6, "passivity": LEAST_J, "model_mediated": -2e-4}
    if stiffness is None or stiffness > 100.0:
        least_j = {"wave": -1.8e-5, "passivity": LEAST_J, "model_mediated": -2e-4}
    stiffness = stiffness or AT_LIMIT[law]
    # as a node gets them that waits for them: at 80 N/m, 20 us apart, wave made -21 mJ and passivity -11 mJ, and
    # model_mediated -60 mJ after pauses of 240 ms
    cell = Cell(law=law, environment="spring", round_trip_ms=80.0, stiffness_n_per_m=stiffness)
    rig = rig_of(cell, cell.hand_points(), settle_s(cell) + cell.hold_s()[1])
    # after a pause of the guard the base lags by what counts as followed, which it makes up for at once
    lag_n = scales_of(cell.controller()).force_scale * stiffness * FOLLOWED_M if pause_ms > 50 else 0.0
    # when the session begins within a pause decides how much is made
    for begin_ms in (0, pause_ms // 3, 2 * pause_ms // 3):
        settle = settle_ticks(cell, rig.period_s) + begin_ms
        ticks = settle + round(cell.hold_s()[1] / rig.period_s)
        result = judged(cell, rig.run(bursts(ticks, pause_ms, 1000 * apart_us), settle))
        assert result.lowest_energy_j > least_j[law]
        assert result.peak_n is not None
        assert result.peak_n < 1.02 + lag_n


def hand_at_hz(law: str, frequency_hz: float) -> float:
    """Return the least energy in two-port and device [J]: hand of 0.5 + 0.5 N sin, spring of 20 N/m, no delay."""
    cell = Cell(law=law, environment="spring", round_trip_ms=0.0, stiffness_n_per_m=20.0)
    each = max(4, round(500.0 / frequency_hz))
    sine = [
        (1.5 + n / (each * frequency_hz), 0.5 + 0.5 * math.sin(2.0 * math.pi * n / each))
        for n in range(1, round(4.0 * frequency_hz) * each + 1)
    ]
    points = [(0.0, 0.0), (0.5, 0.5), (1.5, 0.5), *sine]
    course = course_of(cell, points, 5.5)
    return float(energies_of(course, scales_of(cell.controller())).stored_j.min())


@pytest.mark.parametrize("law", ["wave", "passivity", "model_mediated"])
def test_a_hand_below_26_hz_gets_no_energy_from_the_device_and_one_above_does(law: str) -> None:
    for frequency_hz in (8.0, 20.0, 25.0):
        assert hand_at_hz(law, frequency_hz) > LEAST_J
    # the lag of the servo, and none of the law: it is in the document with these figures; wave spends no more than the
    # hand has worked at its device, and makes none
    for frequency_hz in (40.0, 60.0):
        found_j = hand_at_hz(law, frequency_hz)
        assert found_j > LEAST_J if law == "wave" else -1e-3 < found_j < -1e-4


def swung(seed: int) -> tuple[float, float]:
    """Return the least energy [J] of a drawn arm on what holds the tip, and the most that the tip took unpaid [J]."""
    draw = random.Random(f"{seed} pulls")
    cell = Cell(
        law="model_mediated",
        environment="spring",
        hand=draw.choice(("soft", "ordinary", "stiff")),
        round_trip_ms=draw.uniform(0.0, 200.0),
        stiffness_n_per_m=math.exp(draw.uniform(math.log(20.0), math.log(157.0))),
        loss=draw.uniform(0.05, 0.4),
        seed=seed,
    )
    size_n, rate_hz = math.exp(draw.uniform(math.log(0.3), math.log(4.0))), math.exp(draw.uniform(-2.3, 0.7))
    mean_n = draw.uniform(-1.0, 1.0) * size_n
    sine = [
        (0.5 + n / (32.0 * rate_hz), mean_n * min(n / 32.0, 1.0) + size_n * math.sin(math.pi * n / 16.0))
        for n in range(1, round(200.0 * rate_hz))
    ]
    course = course_of(cell, [(0.0, 0.0), (0.5, 0.0), *sine], 7.0)
    energies = energies_of(course, scales_of(cell.controller()))
    # the hand's work as the law counts it: the force of a sample acted over the way to it
    worked_j = np.cumsum(course.hand_force_n[1:] * np.diff(course.hand_position_m))
    unpaid = energies.tip_j[1:] - np.maximum.accumulate(np.maximum(worked_j, 0.0))
    return float(energies.stored_j.min()), float(unpaid.max())


@pytest.mark.check("arms over lossy lines")
def test_an_arm_that_pulls_on_what_holds_the_tip_gets_no_more_than_is_stated() -> None:
    """Before the tip paid for what it pulls, 12 of 24 arms made more than 0.4 mJ and one 823 mJ."""
    found = [swung(seed) for seed in range(12)]
    start_j = ModelMediatedConfig().start_energy_j
    assert max(unpaid for _, unpaid in found) < start_j + 1e-6
    # The hand takes back more than E_0 out of the model in some draws, while the tip is still pressed.
    assert min(least for least, _ in found) > -1e-3
