"""Tactile feedback: the path, its speed limit, and a hand that is moved like the surface."""

from typing import Any

import numpy as np
import pytest
from test_afm_programs import Imager

from telenano.extend.laws import HandSample, TipMeasurement
from telenano.laws.tactile import impedance_scaled
from telenano.sections.controller_section import KNOWN_LAWS, ControllerConfig
from telenano.wire.errors import RefusedError

SECTION = {
    "cantilever": {"stiffness_n_per_m": 1.0},
    "sample": {"name": "grating", "size_m": 60e-9, "period_m": 60e-9, "height_m": 4e-9, "pixels": 64},
    "safety": {"retract_position_m": -20e-9},
}
# from the groove at the left edge onto the ridge in the middle
LINE = {"program": "tactile", "tactile.x0_m": -25e-9, "tactile.x1_m": 0.0, "tactile.approach_m_per_s": 1e-6}


@pytest.fixture
def afm(bench_of: Any) -> Imager:
    return Imager(bench_of("afm_node@slave"), SECTION)


def felt(states: list[Any], **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """Give where the hand is taken [m] and the force shown [N], for states of the instrument, without a link."""
    config = ControllerConfig.model_validate(
        {"law": "tactile", "tactile": {"cantilever_stiffness_n_per_m": 1.0, **settings}}
    )
    law, params = KNOWN_LAWS["tactile"], config.params()
    hand = HandSample(3e-3, 0.0, 0.0, True)
    master, slave = law.master_start(params, hand), None
    found = []
    for state in states:
        tip = TipMeasurement(
            0.0 - state.base_position_m[2], state.tip_force_n[2], 0.0, False, state.in_contact, True, 0.0
        )
        slave = law.slave_start(params, tip) if slave is None else slave
        _, signal = law.slave_send(params, slave, tip, 1e-3)
        master, reference = law.master_receive(params, master, hand, signal._replace(silence_s=0.0), 1e-3)
        assert reference.active
        found.append((reference.position_m, reference.force_n))
    positions, forces = np.array(found).T
    return positions, forces


@pytest.mark.parametrize("hold", ["height", "force"])
def test_the_hand_is_moved_like_the_surface_at_a_millimetre_a_nanometre(afm: Imager, hold: str) -> None:
    afm.set(**LINE, **{"tactile.hold": hold})
    afm.run()
    assert afm.outcome() == ("finished", "the tactile path is finished: the tip retracts")
    states = [s for s in afm.bench.take("afm/state") if s.mode == "follow"]
    positions, forces = felt(states)
    # before the first touch the approach moves nobody
    touched = next(i for i, state in enumerate(states) if state.in_contact)
    assert touched > 20
    assert set(positions[:touched]) == {3e-3}
    surface = afm.config.to_surface()
    assert surface is not None
    moving = [i for i, s in enumerate(states) if i > touched and s.in_contact and s.base_position_m[0] > -25e-9]
    xs = np.array([states[i].base_position_m[0] for i in moving])
    columns = np.minimum(((xs + 30e-9) / surface.step_x_m).astype(int), 63)
    heights = surface.height_m[32, columns] - surface.height_m[32, columns[0]]
    away = -(positions[moving] - positions[moving[0]])
    # a ridge of 4 nm is 4 mm; the indentation takes some of it, and a pixel of the flank is steep
    assert np.median(np.abs(away - 1e6 * heights)) < 0.15e-3
    assert away.max() == pytest.approx(4e-3, rel=0.06)
    # 25 nm at 30 nm/s
    assert len(moving) == pytest.approx(25 / 30e-3, rel=0.02)
    assert forces[moving[0]] == pytest.approx(1e8 * states[moving[0]].tip_force_n[2], rel=1e-9)


def test_a_speed_beyond_what_the_hand_can_feel_is_limited_with_an_event(afm: Imager) -> None:
    text = afm.set(**LINE, **{"tactile.speed_m_per_s": 100e-9, "tactile.feature_m": 2e-9})
    assert "its speed is limited from 1e-07 to 6e-08 m/s: features of 2e-09 m at 30 Hz (Eq. 14)" in text
    afm.run()
    events = [event.text for event in afm.bench.take("session/event")]
    assert any(event.startswith("its speed is limited from 1e-07 to 6e-08 m/s") for event in events)
    places = [s.base_position_m[0] for s in afm.bench.take("afm/state") if s.in_contact]
    assert max(np.diff(places)) <= 60e-12 * 1.001
    with pytest.raises(RefusedError, match=r"reaches 0\.001 m, and lateral\.reach_m is 5e-05 m"):
        afm.set(**{**LINE, "tactile.x1_m": 1e-3})


def test_a_gain_with_which_the_force_would_swing_is_refused_and_the_tip_stays_retracted(afm: Imager) -> None:
    fault = (
        r"tactile: tactile\.gain_per_s = 5000 1/s makes the feedback unstable in contact mode at 1000 Hz: it must be"
    )
    with pytest.raises(RefusedError, match=rf"{fault} below 2000 1/s"):
        afm.set(**LINE, **{"tactile.hold": "force", "tactile.gain_per_s": 5000.0})
    assert not afm.node._programs.name
    # where the base stands there is no feedback
    afm.set(**LINE, **{"tactile.gain_per_s": 5000.0})
    afm.set(program="abort")
    afm.run()
    # beyond the 900/s at which gains were cut once: the force settles within a few steps and stays
    afm.set(**LINE, **{"tactile.hold": "force", "tactile.gain_per_s": 1500.0})
    afm.bench.take("afm/state")
    afm.run()
    forces = np.array([state.tip_force_n[2] for state in afm.bench.take("afm/state") if state.in_contact])
    flat = forces[50:250]
    assert np.abs(flat - 5e-9).max() < 0.2e-9


def test_a_pointer_leads_the_tip_and_is_told_when_it_is_ahead(afm: Imager) -> None:
    afm.set(**LINE, **{"tactile.drive": "pointer"})
    afm.set(**{"lateral.x_m": -25e-9})
    afm.run(until=lambda: reported(afm) and "felt" in afm.outcome()[1])
    afm.set(**{"lateral.x_m": -22e-9})
    afm.run(until=lambda: afm.node._memory.place.x_m == -22e-9)
    limited = [e.text for e in afm.bench.take("session/event") if "ahead of the tip" in e.text]
    assert limited == ["the pointer is ahead of the tip, which goes at 3e-08 m/s: no faster motion is felt (Eq. 14)"]
    afm.set(program="abort")
    afm.run()
    assert afm.mode == "retracted"


def reported(afm: Imager) -> bool:
    return any(topic == "afm/program" for topic, _ in afm.bench.sent)


def test_what_begins_when_the_instrument_is_armed(bench_of: Any) -> None:
    begin = {"program": "tactile", "tactile": {"x0_m": -25e-9, "x1_m": -24e-9, "approach_m_per_s": 1e-6}}
    afm = Imager(bench_of("afm_node@slave"), {**SECTION, "begin": begin})
    fields = {"mode": "position", "base_position_m": (0.0, 0.0, 0.0), "hand_seq": 1, "hand_armed": True}
    afm.node.on_message(
        afm.bench.received("afm/command", "controller@slave", **fields, hand_t_ns=afm.bench.clock.now_ns())
    )
    arm = afm.bench.make(
        "session/control", "console@master", id="b", command="arm", target="*", parameters={"place": "hand"}
    )
    assert "the tip touches the sample" in afm.node.on_control(arm)
    afm.run()
    assert afm.outcome()[0] == "finished"


def test_impedance_scaling_gives_each_term_its_own_power(afm: Imager) -> None:
    # Eq. 13: mass with the fourth power of the scale, damping and stiffness with the second
    assert impedance_scaled(1e4, 1e-12, 1e-6, 1.0) == pytest.approx((1e4, 1e2, 1e8), rel=1e-12)
    still = [state_of(2e-9)] * 5
    scaled = {"scaling": "impedance", "impedance_scale": 1e4}
    _, forces = felt(still, **scaled)
    # a deflection that rests: alpha^2 k zeta
    assert forces[-1] == pytest.approx(1e8 * 1.0 * 2e-9, rel=1e-12)
    rising = [state_of(2e-9 + 1e-12 * i) for i in range(6)]
    _, forces = felt(rising, **scaled, cantilever_damping_n_s_per_m=1e-3)
    # a steady motion of 1 nm/s adds alpha^2 b zeta'
    assert forces[-1] == pytest.approx(1e8 * 2.005e-9 + 1e8 * 1e-3 * 1e-9, rel=1e-9)
    speeding = [state_of(2e-9 + 0.5 * 1e-9 * (1e-3 * i) ** 2) for i in range(6)]
    _, forces = felt(speeding, **scaled, cantilever_mass_kg=1e-6)
    spring = 1e8 * speeding[-1].tip_force_n[2]
    # 1 nm/s^2: alpha^4 m zeta''
    assert forces[-1] - spring == pytest.approx(1e16 * 1e-6 * 1e-9, rel=1e-4)


class _State:
    in_contact, base_position_m = True, (0.0, 0.0, 0.0)

    def __init__(self, force_n: float) -> None:
        self.tip_force_n = (0.0, 0.0, force_n)


def state_of(force_n: float) -> Any:
    return _State(force_n)
