"""What `theory` gives a control engineer: python-control's own margins, poles and fractions agree with it."""

import math

import control
import numpy as np
import pytest
from telenano_lab.studies.loops.cells import Cell, run_cell
from telenano_lab.studies.loops.linear_loop import LinearLoop, theory
from telenano_lab.studies.loops.stability import Axes, Line, theory_of
from telenano_lab.studies.loops.theory import Arm, Device, arm_response, loop_model
from telenano_lab.studies.option_values import Jitter

from telenano.sections import ARMS, HapticConfig
from telenano.wire import ConfigError

OMEGA = np.geomspace(0.5, 100.0, 60)


def line(law: str, stiffness: float, hand: str = "force", latency_ms: float = 0.0) -> Line:
    axes = Axes.model_validate({"laws": (law,), "environment": "spring", "hand": hand, "device_latency_ms": latency_ms})
    return Line(axes, law, stiffness, None, Jitter(), 0.0)


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force"])
@pytest.mark.parametrize("stiffness", [5.0, 20.0, 38.0])
def test_margins_of_the_transfer_functions_are_those_of_study_stability(law: str, stiffness: float) -> None:
    critical_s, critical_link_s = theory_of(line(law, stiffness))
    loop = theory(law=law, stiffness_n_per_m=stiffness)
    _, phase_deg, _, crossover = control.margin(loop.transfer_function(pade_order=0))
    assert math.radians(phase_deg) / crossover == pytest.approx(critical_s, rel=1e-5, abs=0)
    assert loop.critical_delay_s == pytest.approx(critical_s, rel=1e-12, abs=0)
    # the sampled loop with the delay in it is stable to the last whole sample below, and not from the next one on
    assert critical_link_s is not None
    below_ms = 1e3 * math.floor(critical_link_s * 1e3) * 1e-3
    for round_trip_ms, is_stable in ((below_ms, True), (below_ms + 1.0, False)):
        sampled = theory(law=law, stiffness_n_per_m=stiffness, round_trip_ms=round_trip_ms).sampled()
        poles = control.feedback(sampled).poles()
        assert bool(np.abs(poles).max() < 1.0) is is_stable


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force"])
def test_an_arm_is_in_the_transfer_function_as_in_the_study(law: str) -> None:
    for hand in ("soft", "ordinary", "stiff"):
        critical_s, link_s = theory_of(line(law, 20.0, hand, latency_ms=15.0))
        loop = theory(law=law, stiffness_n_per_m=20.0, hand=hand)
        _, phase_deg, _, crossover = control.margin(loop.transfer_function(pade_order=0))
        assert math.radians(phase_deg) / crossover == pytest.approx(critical_s, rel=1e-4, abs=0)
        assert link_s == pytest.approx(critical_s - 0.0005 - 0.015, rel=1e-9, abs=0)
        undelayed = loop.response(OMEGA) * np.exp(1j * OMEGA * loop.delay_s)
        model = loop_model(law, loop.parameters, 20.0)
        assert model is not None
        device = Device(*HapticConfig().device.to_params().closed_loop_coefficients())
        other = arm_response(model, getattr(loop.parameters, "force_gain", 1.0), Arm(*ARMS[hand]), device)
        assert np.allclose(undelayed, [other(w) for w in OMEGA], rtol=1e-12, atol=0)


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force", "wave"])
def test_the_response_is_that_of_the_two_port_between_spring_and_hand(law: str) -> None:
    loop = theory(law=law, stiffness_n_per_m=20.0, round_trip_ms=60.0)
    # the two-port has no hold: its delay is that of the link
    hybrid, spring = loop.two_port(OMEGA), 1e8 * 1.5e-6 * 20.0
    h11, h12, h21, h22 = (hybrid[:, i, j] for i in (0, 1) for j in (0, 1))
    expected = spring / (1j * OMEGA) * (h22 - h12 * h21 / h11)
    without_hold = LinearLoop(law, loop.parameters, 20.0, loop.round_trip_s - 0.5e-3, 1e-3)
    assert np.allclose(without_hold.response(OMEGA), expected, rtol=1e-9, atol=0)


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force", "wave"])
@pytest.mark.parametrize("hand", ["force", "ordinary"])
def test_a_fraction_of_pade_is_the_response_where_its_order_is_enough(law: str, hand: str) -> None:
    loop = theory(law=law, stiffness_n_per_m=20.0, round_trip_ms=40.0, hand=hand)
    found = loop.transfer_function(pade_order=8)(1j * OMEGA)
    assert np.allclose(found, loop.response(OMEGA), rtol=1e-6, atol=0)


@pytest.mark.parametrize("hand", ["force", "ordinary"])
@pytest.mark.parametrize("round_trip_ms", [0.0, 20.0, 100.0])
def test_the_closed_loop_of_waves_has_the_poles_that_are_its_roots(hand: str, round_trip_ms: float) -> None:
    loop = theory(law="wave", stiffness_n_per_m=38.0, round_trip_ms=round_trip_ms, hand=hand)
    poles = control.feedback(loop.transfer_function(pade_order=8), 1).poles()
    slowest = poles[np.argsort(-poles.real)][0]
    assert complex(slowest.real, abs(slowest.imag)) == pytest.approx(loop.roots()[0], rel=1e-4)
    assert poles.real.max() < -1.0


def zeros_inside(loop: LinearLoop, left: float, right: float, top: float) -> int:
    """Return how many zeros 1 + 1/L has in a rectangle around the real axis, by the principle of the argument."""
    corners = [complex(left, -top), complex(right, -top), complex(right, top), complex(left, top)]
    ways = [np.linspace(a, b, 20_000) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
    phase = np.unwrap(np.angle(1.0 + 1.0 / loop.at(np.concatenate(ways))))
    return round(float(phase[-1] - phase[0]) / (2.0 * math.pi))


@pytest.mark.parametrize("law", ["virtual_impedance", "position_force"])
@pytest.mark.parametrize("round_trip_ms", [5.0, 60.0, 200.0])
def test_no_root_is_missed(law: str, round_trip_ms: float) -> None:
    loop = theory(law=law, stiffness_n_per_m=20.0, round_trip_ms=round_trip_ms)
    roots = loop.roots()
    assert np.abs(1.0 + loop.at(roots)).max(initial=0.0) < 1e-8
    found = sum(1 if abs(root.imag) < 1e-6 else 2 for root in roots)
    # L has no zeros, so that 1 + 1/L has no poles
    assert zeros_inside(loop, -100.0, 40.0, 2.0 * math.pi * 16.0) == found


@pytest.mark.check("compiles a study's closed loop on a spring")
@pytest.mark.parametrize(("law", "round_trip_ms"), [("virtual_impedance", 40.0), ("virtual_impedance", 52.0)])
def test_the_first_root_grows_as_the_laws_own_steps_do(law: str, round_trip_ms: float) -> None:
    cell = Cell(law=law, environment="spring", stiffness_n_per_m=20.0, round_trip_ms=round_trip_ms)
    root = theory(law=law, stiffness_n_per_m=20.0, round_trip_ms=round_trip_ms).roots()[0]
    assert run_cell(cell).growth_per_s == pytest.approx(root.real, abs=0.03)


def test_the_roots_of_waves_stay_on_the_left_at_every_delay() -> None:
    for round_trip_ms in (0.0, 20.0, 100.0, 500.0):
        loop = theory(law="wave", stiffness_n_per_m=38.0, round_trip_ms=round_trip_ms)
        assert loop.roots().real.max() < 0.0
        # the loop of a passive line on a spring never passes above the real axis, where -1 could be encircled
        assert np.angle(loop.response(OMEGA)).max() <= 0.0
        assert loop.critical_delay_s == math.inf


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"law": "passivity"}, "passivity has no linear loop; virtual_impedance, position_force, wave have"),
        ({"law": "none"}, "unknown law 'none'"),
        ({"environment": "tip_sample"}, "the environment tip_sample is not linear"),
        ({"settings": {"clamp.enabled": True}}, "the force clamp behind virtual_impedance is not linear"),
        ({"hand": "tail"}, "hand"),
        ({"stiffness_n_per_m": -1.0}, "stiffness_n_per_m"),
    ],
)
def test_what_has_no_linear_loop_is_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        theory(**given)


def test_what_has_no_sampled_form_says_what_has() -> None:
    for given in ({"law": "wave"}, {"hand": "soft"}):
        with pytest.raises(ConfigError, match=r"take transfer_function\(\), or response\(\)"):
            theory(**given).sampled()


def test_a_loop_of_theory_shows_what_it_is() -> None:
    loop = theory(law="virtual_impedance", stiffness_n_per_m=20.0, round_trip_ms=40.0)
    assert repr(theory(law="wave", hand="soft")) == "<LinearLoop wave on 10 N/m, 0.5 ms in all, with an arm>"
    assert repr(loop) == "<LinearLoop virtual_impedance on 20 N/m, 40.5 ms in all>"
