"""Where the guard lets the base go after an arming: nowhere without a word, and with one as far as its place."""

import math
import random
from itertools import pairwise
from typing import Any

import pytest
from test_afm_safety import DT, FRESH, PARAMS, RETRACTED

from telenano.afm import safety
from telenano.afm.safety import SafetyInputs, SafetyState, safety_step

HAND = FRESH._replace(of_hand=True)
AWAY_M = PARAMS.retract_position_m


def run(state: SafetyState, ticks: int, **changes: Any) -> tuple[SafetyState, list[safety.SafetyOutputs]]:
    outputs = []
    for _ in range(ticks):
        state, output = safety_step(PARAMS, state, HAND._replace(**changes), DT)
        outputs.append(output)
    return state, outputs


def armed(reference_m: float, state: SafetyState = RETRACTED, **word: Any) -> tuple[SafetyState, safety.SafetyOutputs]:
    return safety_step(PARAMS, state, HAND._replace(reference_m=reference_m, arm_requested=True, **word), DT)


@pytest.mark.parametrize("reference_m", [-150e-9, -100e-9, 0.0, 10.5e-9, 150e-9])
def test_without_a_word_the_base_stays_and_the_hand_moves_it_from_there(reference_m: float) -> None:
    state, output = armed(reference_m)
    assert (output.mode, output.offset_m) == (safety.MODE_FOLLOW, reference_m - AWAY_M)
    assert safety.is_placed(output)
    state, outputs = run(state, 500, reference_m=reference_m)
    for output in outputs:
        assert output.base_m == pytest.approx(AWAY_M, rel=1e-12, abs=0.0)
    _, outputs = run(state, 50, reference_m=reference_m + 3e-9)
    assert outputs[-1].base_m == pytest.approx(AWAY_M + 3e-9, rel=1e-12, abs=0.0)


def test_a_base_goes_to_the_hand_no_further_than_its_rest_point_and_from_there_slowly() -> None:
    state, _ = armed(12e-9, goes=True)
    state, outputs = run(state, 60, reference_m=12e-9)
    # 100 nm at 2 um/s
    assert 0.0 <= outputs[-1].base_m < 0.3e-9
    assert outputs[-1].offset_m == pytest.approx(12e-9, rel=0.05, abs=0.0)
    state, outputs = run(state, 100, reference_m=12e-9)
    slow = outputs[-1].base_m - outputs[0].base_m
    assert slow == pytest.approx(99 * DT * safety.LET_IN_M_PER_S, rel=1e-6, abs=0.0)
    # a hand that is not beyond has no offset, and goes nowhere else
    _, output = armed(-3e-9, goes=True)
    assert output.offset_m == 0.0


def test_a_base_that_goes_to_a_place_is_not_placed_before_it_is_there() -> None:
    place_m, speed_m_per_s = -20e-9, 500e-9
    state, output = armed(0.0, goes=True, place_m=place_m, speed_m_per_s=speed_m_per_s)
    _, outputs = run(state, 300)
    seen = [safety.is_placed(each) for each in (output, *outputs)]
    first = seen.index(True)
    assert all(seen[first:])
    assert first == pytest.approx((place_m - AWAY_M) / speed_m_per_s / DT, abs=2.0)
    assert outputs[-1].base_m == pytest.approx(place_m, rel=1e-6, abs=0.0)


@pytest.mark.parametrize("force_n", [1.1e-9, -1.1e-9])
def test_a_way_to_a_stated_place_beyond_the_rest_point_ends_where_the_tip_feels_the_sample(force_n: float) -> None:
    state, _ = armed(12e-9, goes=True, place_m=11e-9)
    state, _ = run(state, 100, reference_m=12e-9)
    state, (output,) = run(state, 1, reference_m=12e-9, force_n=force_n)
    assert (output.ended, state.goes) == (safety.ENDED_BY_CONTACT, False)
    _, outputs = run(state, 200, reference_m=12e-9)
    assert outputs[-1].base_m == pytest.approx(output.base_m, rel=0.0, abs=1e-15)


def test_a_way_to_the_hand_never_ends_in_contact() -> None:
    """A hand that nobody holds may be anywhere, and so may the surface, known or not."""
    draw = random.Random(117)
    for _ in range(300):
        reference_m, surface_m = draw.uniform(-30e-9, 30e-9), draw.uniform(-20e-9, 25e-9)
        n_per_m, pull_n = draw.uniform(0.5, 10.0), draw.choice((0.0, 3e-9))
        is_known, moves_m = draw.random() < 0.5, draw.choice((0.0, 2e-9))
        state = RETRACTED._replace(surface_m=surface_m) if is_known else RETRACTED
        state, output = armed(reference_m, state, goes=True)
        for tick in range(4000):
            into_m = output.base_m - surface_m
            force_n = n_per_m * into_m - pull_n if into_m > 0.0 else 0.0
            at_m = reference_m + moves_m * math.sin(0.01 * tick)
            state, (output,) = run(state, 1, reference_m=at_m, force_n=force_n)
            if not state.goes:
                break
        case = (reference_m, surface_m, n_per_m, pull_n, is_known, moves_m)
        assert not state.goes and output.ended == safety.ENDED_THERE, case
        assert safety.is_placed(output), case
        # It is off the surface: as far as the clearance, but for what it went on before it felt 1 nN.
        assert output.base_m <= surface_m, case
        if is_known:
            assert output.base_m <= surface_m - 0.99 * safety.CLEARANCE_M, case


@pytest.mark.parametrize("speed_m_per_s", [0.5 * safety.LET_IN_M_PER_S, 10.0 * safety.LET_IN_M_PER_S])
def test_the_time_of_a_way_is_that_of_a_base_that_goes_it(speed_m_per_s: float) -> None:
    """Beyond the rest point it is let in slowly, and at its own speed where that is lower."""
    place_m = 3e-9
    state, _ = armed(10e-9, goes=True, place_m=place_m, speed_m_per_s=speed_m_per_s)
    ticks = round(safety.way_s(PARAMS, AWAY_M, place_m, speed_m_per_s=speed_m_per_s) / DT)
    state, outputs = run(state, ticks - 10, reference_m=10e-9)
    assert outputs[-1].base_m < place_m and state.goes
    _, outputs = run(state, 20, reference_m=10e-9)
    assert outputs[-1].base_m == pytest.approx(place_m, rel=1e-6, abs=0.0)


@pytest.mark.parametrize(("waits_s", "goes"), [(4.9, True), (5.1, False)])
def test_a_word_that_waits_for_a_hand_is_void_after_a_while(waits_s: float, goes: bool) -> None:
    state, output = armed(0.0, goes=True, command_age_s=math.inf)
    assert (output.mode, state.goes) == (safety.MODE_RETRACTED, True)
    state, _ = run(state, round(waits_s / DT), command_age_s=math.inf)
    # The hand is armed by somebody else.
    _, outputs = run(state, 200)
    assert outputs[-1].mode == safety.MODE_FOLLOW
    assert (outputs[-1].base_m > -1e-9) == goes
    assert goes or outputs[-1].base_m == pytest.approx(AWAY_M, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("seed", range(10))
def test_noise_is_no_surface(seed: int) -> None:
    """A simulated instrument with its disturbances reads 0.7 nN RMS: a way to the hand ends where the hand is."""
    draw = random.Random(f"noise {seed}")
    free = SafetyState(safety.MODE_FOLLOW, AWAY_M, safety.REASON_ARMED)
    for _ in range(3000):
        free, _ = run(free, 1, reference_m=AWAY_M, force_n=draw.gauss(0.0, 0.7e-9))
    assert free.surface_m == math.inf
    state, output = armed(0.0, goes=True)
    for _ in range(2000):
        state, (output,) = run(state, 1, reference_m=0.0, force_n=draw.gauss(0.0, 0.7e-9))
    assert (state.goes, state.surface_m) == (False, math.inf)
    assert output.base_m == pytest.approx(0.0, abs=1e-12)


def test_a_surface_that_was_met_is_kept_clear_of() -> None:
    met = SafetyState(safety.MODE_FOLLOW, -20e-9, safety.REASON_ARMED)
    met, _ = run(met, 21, reference_m=-20e-9, force_n=1.1e-9)
    assert met.surface_m == -20e-9
    away, _ = run(met, 200, action=safety.ACTION_RETRACT)
    state, _ = armed(0.0, away, goes=True)
    _, outputs = run(state, 60, reference_m=0.0)
    assert outputs[40].base_m == pytest.approx(-20e-9 - safety.CLEARANCE_M, rel=0.02, abs=0.0)


@pytest.mark.parametrize(
    ("change", "ended"),
    [
        ({"interrupted": True}, safety.ENDED_BY_COMMAND),
        ({"arm_requested": True}, safety.ENDED_BY_COMMAND),
        ({"reference_m": 1.6e-9}, safety.ENDED_BY_MOTION),
        ({"reference_m": -1.6e-9}, safety.ENDED_BY_MOTION),
        ({"hand_force_n": 0.51}, safety.ENDED_BY_FORCE),
        ({"hand_force_n": -0.51}, safety.ENDED_BY_FORCE),
        ({"hand_force_n": math.nan}, safety.ENDED_BY_FORCE),
        ({"command_age_s": 0.06}, safety.ENDED_BY_SILENCE),
        ({"reference_m": math.nan}, safety.ENDED_BY_SILENCE),
        ({"reference_m": 1.4e-9, "hand_force_n": 0.49}, safety.NOT_ENDED),
        ({"hand_force_n": safety.PRESSED_N}, safety.NOT_ENDED),
    ],
)
def test_any_input_ends_a_way_to_a_stated_place(change: dict[str, Any], ended: int) -> None:
    state, _ = armed(0.0, goes=True, place_m=-20e-9, speed_m_per_s=50e-9)
    state, outputs = run(state, 100)
    assert outputs[-1].base_m == pytest.approx(AWAY_M + 101 * DT * 50e-9, rel=1e-6, abs=0.0)
    state, (output,) = run(state, 1, **change)
    assert output.ended == ended
    if ended != safety.NOT_ENDED:
        assert not state.goes
        _, outputs = run(state, 300, reference_m=change.get("reference_m", 0.0) if ended != 5 else 0.0)
        # where the hand has moved, that is what moves it
        assert max(later.base_m for later in outputs) <= output.base_m + 1e-15


@pytest.mark.parametrize(
    ("change", "ended"),
    [
        ({}, safety.NOT_ENDED),
        ({"arm_requested": True, "goes": True}, safety.NOT_ENDED),
        ({"arm_requested": True}, safety.ENDED_BY_COMMAND),
        ({"interrupted": True}, safety.ENDED_BY_COMMAND),
    ],
)
def test_a_way_to_the_hand_outlasts_a_hold_but_no_command(change: dict[str, Any], ended: int) -> None:
    assert not RETRACTED.goes
    state, _ = armed(12e-9, goes=True)
    state, _ = run(state, 20, reference_m=12e-9)
    state, (output,) = run(state, 1, reference_m=12e-9, command_age_s=0.06)
    assert (output.mode, state.goes) == (safety.MODE_HOLD, True)
    state, (output,) = run(state, 1, reference_m=12e-9, command_age_s=0.06, **change)
    assert (output.ended, state.goes) == (ended, ended == safety.NOT_ENDED)


def test_a_word_to_a_tip_that_follows_sends_it_to_the_hand_unless_it_is_there() -> None:
    state, _ = armed(0.0)
    state, outputs = run(state, 20)
    assert outputs[-1].base_m == pytest.approx(AWAY_M, rel=1e-12, abs=0.0)
    state, _ = run(state, 1, arm_requested=True, goes=True)
    state, outputs = run(state, 100)
    assert (outputs[-1].base_m, outputs[-1].offset_m, state.goes) == (0.0, 0.0, False)
    state, (output,) = run(state, 1, arm_requested=True, goes=True)
    assert (output.ended, state.goes) == (safety.NOT_ENDED, False)


@pytest.mark.parametrize(("base_m", "is_placed"), [(-2e-12, False), (0.0, True)])
def test_a_base_that_goes_to_the_hand_is_placed_where_its_full_speed_ends(base_m: float, is_placed: bool) -> None:
    """Beyond that it is let in: here by half a picometre a tick, of 12 nm that are left."""
    state = SafetyState(safety.MODE_FOLLOW, base_m, safety.REASON_ARMED, offset_m=12e-9 - base_m, goes=True)
    state = state._replace(place_m=math.inf, speed_m_per_s=0.5e-9)
    state, (output,) = run(state, 1, reference_m=12e-9)
    assert output.base_m == pytest.approx(base_m + DT * 0.5e-9, rel=1e-3, abs=0.0)
    assert (safety.is_placed(output), state.goes) == (is_placed, True)


def test_full_speed_ends_at_the_clearance_and_not_beyond() -> None:
    met = SafetyState(safety.MODE_FOLLOW, -20e-9, safety.REASON_ARMED)
    met, _ = run(met, 21, reference_m=-20e-9, force_n=1.1e-9)
    away, _ = run(met, 200, action=safety.ACTION_RETRACT)
    state, _ = armed(0.0, away)
    state, _ = run(state, 1, arm_requested=True, goes=True, place_m=0.0, speed_m_per_s=700e-9)
    _, outputs = run(state, 200)
    steps = [after.base_m - before.base_m for before, after in pairwise(outputs)]
    clear_m = -20e-9 - safety.CLEARANCE_M
    assert any(each.base_m == pytest.approx(clear_m, rel=1e-9, abs=0.0) for each in outputs)
    for each, step in zip(outputs, steps, strict=False):
        assert each.base_m < clear_m - 1e-15 or step <= 1.01 * DT * safety.LET_IN_M_PER_S


@pytest.mark.parametrize(("place_m", "arrives_m"), [(-60e-9, -60e-9), (1e-6, 5e-9), (-1e-6, -80e-9)])
def test_a_way_ends_at_its_place_or_at_the_end_of_the_range(place_m: float, arrives_m: float) -> None:
    params = PARAMS._replace(base_min_m=-80e-9, base_max_m=5e-9)
    state = SafetyState(safety.MODE_FOLLOW, -20e-9, safety.REASON_ARMED, offset_m=20e-9)
    word = HAND._replace(arm_requested=True, goes=True, place_m=place_m, speed_m_per_s=500e-9)
    state, output = safety_step(params, state, word, DT)
    outputs = [output]
    while state.goes and len(outputs) < 2000:
        state, output = safety_step(params, state, HAND, DT)
        outputs.append(output)
    assert [each.ended for each in outputs] == [safety.NOT_ENDED] * (len(outputs) - 1) + [safety.ENDED_THERE]
    # It ends in the tick in which it arrives.
    assert outputs[-2].offset_m != output.offset_m
    assert output.offset_m == pytest.approx(-arrives_m, rel=1e-9, abs=0.0)
    assert output.base_m == pytest.approx(arrives_m, rel=1e-9, abs=0.0)


def test_no_course_of_inputs_moves_the_base_towards_the_sample_without_a_word() -> None:
    draw = random.Random(91)
    for _ in range(300):
        state, reference = RETRACTED, draw.uniform(-50e-9, 50e-9)
        begun: tuple[float, float] | None = None
        highest = reference
        for _ in range(120):
            reference += draw.choice((0.0, 0.0, draw.uniform(-1e-9, 1e-9)))
            asked = SafetyInputs(
                reference_m=draw.choice((reference, reference, reference, math.nan)),
                command_age_s=draw.choice((0.0, 0.0, 0.0, 0.06, 0.3)),
                action=draw.choice((0, 0, 0, 0, 1, 2)),
                arm_requested=draw.random() < 0.2,
                estop=draw.random() < 0.02,
                force_n=draw.choice((0.0, 0.0, 2e-9, 250e-9, math.nan)) if draw.random() < 0.1 else 0.0,
                device_lost=draw.random() < 0.02,
                of_hand=True,
                interrupted=draw.random() < 0.1,
                hand_force_n=draw.uniform(-1.0, 1.0),
            )
            before, (state, output) = state.base_m, safety_step(PARAMS, state, asked, draw.choice((1e-3, 0.05)))
            assert math.isfinite(output.base_m) and math.isfinite(state.offset_m)
            if output.mode != safety.MODE_FOLLOW and output.mode != safety.MODE_HOLD:
                assert output.base_m <= before
                begun = None
            elif begun is None:
                assert output.base_m <= before + 1e-15
                begun, highest = (output.base_m, reference), reference
            if begun is not None:
                highest = max(highest, reference)
                assert output.base_m <= begun[0] + (highest - begun[1]) + 1e-15
