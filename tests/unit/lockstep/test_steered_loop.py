"""The hand across the sample in the closed loop: what it wants and sees goes over the link, there and back."""

import math

import numpy as np
import pytest
import yaml
from telenano_lab.assembly import push_hand
from telenano_lab.assembly.particles.adhered_sphere import KINDS
from telenano_lab.assembly.particles.tip_shape import tip_shape, touch_distance_m
from telenano_lab.studies.loops import push_study
from telenano_lab.studies.loops.push_study import Trial

from telenano import SimulatedSession
from telenano.hand.lateral_hand import LateralHandState, lateral_hand_step
from telenano.lockstep import across, lockstep
from telenano.sections.lateral_hand_section import LateralHandConfig
from telenano.sections.lateral_section import LateralConfig
from telenano.settings import find_scenario
from telenano.wire import ConfigError

TIP = tip_shape(10e-9, math.radians(15.0))


KIND = KINDS["latex_250"]


D_M = touch_distance_m(TIP, KIND.radius_m, 0.0)


def test_the_loop_carries_rates_to_the_tip_and_answers_back(monkeypatch: pytest.MonkeyPatch, plain_loop: None) -> None:
    """Over 40 ms there and 40 ms back the tip begins to move after the first, and is seen after both."""
    monkeypatch.setattr(push_study, "_TOUCHED_S", 0.1)
    courses: list[tuple[float, float]] = []
    session: list[int] = []

    def moves(hand: push_hand.Hand, tick: int) -> tuple[float, float]:
        if tick == 0:
            session.append(len(courses))
        courses.append((float(hand.seen[0]), float(hand.seen[1])))
        return (1e-6, -5e-7) if tick >= 0 else (0.0, 0.0)

    monkeypatch.setattr(lockstep, "hand_moves", moves)
    push_study.run(Trial(law="position_force", round_trip_ms=80.0, seed=1), 0.1)
    seen = np.array(courses)
    first = int(np.flatnonzero(seen[:, 0])[0])
    assert first - session[0] == pytest.approx(80, abs=2)
    steps = np.diff(seen[first:], axis=0)
    assert steps[:, 0] == pytest.approx(1e-9, rel=1e-3) and steps[:, 1] == pytest.approx(-5e-10, rel=1e-3)


def test_a_person_who_steers_brings_the_stylus_to_where_the_tip_has_the_speed_whatever_it_shows() -> None:
    motion, stylus = LateralConfig(mode="rate").to_params().motion, LateralHandConfig().to_params()
    neutral, speed, state = (1e-3, -2e-3), (1.2e-7, -0.9e-7), LateralHandState(x_m=1e-3, y_m=-2e-3)
    for n in range(3000):
        shown = (1.5 * math.sin(0.002 * n), -1.0)
        place = (state.x_m, state.y_m)
        own = across.steering_force_n(motion, stylus.stiffness_n_per_m, place, neutral, shown, speed)
        state = lateral_hand_step(stylus, state, own, shown, 0.0, 1e-3)
    out_x, out_y = state.x_m - neutral[0], state.y_m - neutral[1]
    out = math.hypot(out_x, out_y)
    assert motion.gain * (out - motion.dead_zone_m) == pytest.approx(math.hypot(*speed), rel=1e-3)
    assert (out_x / out, out_y / out) == pytest.approx((0.8, -0.6), rel=1e-3)
    # where the tip is to stand, the stylus is where it took hold
    still = across.steering_force_n(motion, 200.0, neutral, neutral, (0.3, 0.0), (0.0, 0.0))
    assert still == (-0.3, 0.0)


def test_a_hand_that_steers_by_the_stylus_moves_the_tip_and_sees_it_later(
    monkeypatch: pytest.MonkeyPatch, plain_loop: None
) -> None:
    """In lockstep the wanted speed becomes that of the tip, after the arm and the link."""
    seen: list[float] = []

    def moves(hand: push_hand.Hand, tick: int) -> tuple[float, float]:
        seen.append(float(hand.seen[0]))
        return (2e-7, 0.0) if tick >= 0 else (0.0, 0.0)

    monkeypatch.setattr(lockstep, "hand_moves", moves)
    document = yaml.safe_load(find_scenario("assembly").read_text("utf-8"))
    document["haptic_node"]["operator"] = {"kind": "force_profile", "points": [{"time_s": 0.0, "force_n": 0.0}]}
    document["afm_node"]["sample"]["particles"] = {"places": [[7e-7, 0.0]]}
    document |= {"duration_s": 1.0, "delay_node": {way: {"delay_s": 0.02} for way in ("forward", "backward")}}
    push = push_hand.Push((0.0, 0.0), (7e-7, 0.0), D_M, 2e-8, 3e-7, 0.2, 0.0, 3e-8)

    def hand(period_s: float) -> push_hand.Hand:
        return push_hand.new_hand(push, np.random.Generator(np.random.PCG64(1)), 0, period_s)

    found = SimulatedSession.of(document, "a test", hand)
    tip_m = found["tip_x_m"]
    assert np.diff(tip_m)[-100:] == pytest.approx(2e-10, rel=0.02)
    # of 200 nm some are lost while the arm brings the stylus there
    assert 0.8e-7 < tip_m[-1] < 1.8e-7
    assert found["particle_x_m"][-1] == 7e-7 and found["particle_y_m"][-1] == 0.0
    # what it sees at the end is where the tip was 20 ms before, and one tick
    assert seen[-1] == pytest.approx(tip_m[-1] - 21 * 2e-10, abs=3e-10)
    document["controller"]["lateral"] = {"mode": "position"}
    with pytest.raises(ConfigError, match="a hand that steers the tip needs mode rate"):
        SimulatedSession.of(document, "a test", hand)
