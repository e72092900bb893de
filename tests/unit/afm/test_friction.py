"""Lateral forces against the closed form of a tip that is pulled over a slope, and the friction loop of an image."""

import math
from typing import Any

import numpy as np
import pytest
from test_afm_programs import SOFT, Imager, parameters

from telenano.afm.contact.friction import FrictionParams, FrictionState, adhesion_n, friction_step
from telenano.afm.sample.surface import checked
from telenano.afm.sim import simulated_afm
from telenano.sections.afm_section import AfmConfig

MU, LATERAL_N_PER_M = 0.3, 100.0
PARAMS = FrictionParams(MU, 12.5e-9, LATERAL_N_PER_M, 10e-6)
LOAD_N = 5e-9


def pulled(slope: float, sense: float) -> float:
    """Give the horizontal force on a tip that is pulled for long along x: it gave way long ago."""
    state, force = FrictionState(0.0, 0.0), 0.0
    for _ in range(100):
        state, force, other = friction_step(PARAMS, state, sense * 1e-10, 0.0, LOAD_N, slope, 0.0, True)
        assert other == 0.0
    return force


@pytest.mark.parametrize("degrees", [-40.0, -15.0, 0.0, 15.0, 40.0])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_tip_that_slides_on_a_slope_needs_the_force_of_the_closed_form(degrees: float, sense: float) -> None:
    angle = math.radians(degrees) * sense
    # Ogletree, Carpick, Salmeron 1996, for motion up the slope; down it is up a slope of the other sign
    needed = (LOAD_N * math.sin(angle) + MU * (LOAD_N * math.cos(angle) + PARAMS.adhesion_n)) / (
        math.cos(angle) - MU * math.sin(angle)
    )
    assert pulled(math.tan(math.radians(degrees)), sense) == pytest.approx(-sense * needed, rel=1e-9, abs=0.0)


def test_a_friction_loop_is_a_parallelogram_of_the_lateral_stiffness() -> None:
    there = np.concatenate([np.full(100, 1e-11), np.full(100, -1e-11), np.full(100, 1e-11)])
    state, forces = FrictionState(0.0, 0.0), []
    for way in there:
        state, force, _ = friction_step(PARAMS, state, float(way), 0.0, LOAD_N, 0.0, 0.0, True)
        forces.append(force)
    half_width = MU * (LOAD_N + PARAMS.adhesion_n)
    assert forces[99] == pytest.approx(-half_width, rel=1e-12, abs=0.0)
    assert forces[199] == pytest.approx(half_width, rel=1e-12, abs=0.0)
    # right after the reversal it is the spring alone
    assert np.diff(forces[99:104]) == pytest.approx(np.full(4, LATERAL_N_PER_M * 1e-11), rel=1e-9, abs=0.0)
    work = -float(np.sum(np.asarray(forces[100:]) * there[100:]))
    # what a whole loop takes: twice the width along the way, less the slanted ends
    assert work == pytest.approx(2.0 * half_width * (1e-9 - 2.0 * half_width / LATERAL_N_PER_M), rel=0.02, abs=0.0)


def test_friction_needs_contact_and_adhesion_is_the_pull_off_of_the_curve() -> None:
    assert friction_step(PARAMS, FrictionState(1e-9, 0.0), 1e-9, 0.0, 0.0, 0.5, 0.0, False) == ((0.0, 0.0), 0.0, 0.0)
    params = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 1.0}}).to_params()
    # with a spring softer than the contact the deepest pull is met by the curve
    afm = simulated_afm(params)
    afm.open()
    afm.exchange(12e-9)
    least = min(afm.exchange(12e-9 - i * 1e-11).force_n for i in range(2000))
    assert adhesion_n(params.plant.tip) == pytest.approx(-least, rel=2e-3, abs=0.0)


def test_an_instrument_on_a_ramp_reads_the_closed_form_both_ways() -> None:
    ramp = checked(np.tile(0.25 * np.linspace(0.0, 100e-9, 101), (3, 1)), 101e-9, 3e-9)
    config = AfmConfig.model_validate({**SOFT, "friction": {"coefficient": MU}, "sample": {"name": "flat"}})
    friction = config.to_friction_params()
    afm = simulated_afm(config.to_params(), ramp, friction)
    afm.open()
    assert afm.exchange(0.0).in_contact
    for sense in (1.0, -1.0):
        for step in range(40):
            x = sense * (step - 20) * 0.5e-9
            # the base goes with the surface, so that the load stays
            afm.move_to(x, 0.0)
            load = afm.exchange(-0.25 * x).force_n
        angle = math.atan(0.25) * sense
        needed = (load * math.sin(angle) + MU * (load * math.cos(angle) + friction.adhesion_n)) / (
            math.cos(angle) - MU * math.sin(angle)
        )
        assert afm.lateral_force_n[0] == pytest.approx(-sense * needed, rel=1e-6, abs=0.0)


def test_the_friction_loop_on_the_grating_has_the_sign_and_size_of_the_closed_form(bench_of: Any) -> None:
    afm = Imager(bench_of("afm_node@slave"), {**SOFT, "friction": {"coefficient": MU}})
    afm.set(**parameters(scan__dwell_s=12e-3, scan__gain_per_s=800.0, scan__lines=1))
    afm.run()
    lines = afm.bench.take("afm/scanline")
    trace, retrace = (line.lateral_force_n.to_numpy() for line in lines)
    # torsion is the force over 100 N/m and 10 um
    assert lines[0].torsion_rad.to_numpy() == pytest.approx(trace / 1e-3, rel=1e-12, abs=0.0)
    surface = afm.config.to_surface()
    assert surface is not None
    columns = ((np.arange(24) + 0.5) * 5e-9 / surface.step_x_m).astype(int)
    heights = surface.height_m[0]
    # pixels in the middle of grooves and ridges: level all around
    level = np.array([np.ptp(heights[max(c - 4, 0) : c + 5]) == 0.0 for c in columns])
    assert 6 <= level.sum() <= 18
    expected = MU * (5e-9 + afm.config.to_friction_params().adhesion_n)
    inner = level & (np.arange(24) > 1) & (np.arange(24) < 22)
    assert trace[inner] == pytest.approx(np.full(inner.sum(), -expected), rel=0.03, abs=0.0)
    assert retrace[inner] == pytest.approx(np.full(inner.sum(), expected), rel=0.03, abs=0.0)
    # to the right the first flank of the grating rises: it holds the tip back, and pushes it on the way back
    assert trace.min() < -1.3 * expected
    rises = int(np.argmin(trace))
    assert heights[columns[rises + 2]] > heights[columns[rises - 2]]
