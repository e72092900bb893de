"""The body that the tip touches: its motion, its energy, and what the laws make of it."""

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from telenano_lab.studies.loops import body as model
from telenano_lab.studies.loops.body import BodyParams, body_params
from telenano_lab.studies.loops.cells import Cell, run_cell

from telenano.extend.instruments import SafetyParams
from telenano.sections import AfmConfig

DT = 1e-3
pushed: Any = model.pushed
SAFETY = SafetyParams(**AfmConfig().safety.model_dump())


def body(mass_kg: float = 0.01, damping: float = 0.02, rest_m: float = 0.0) -> BodyParams:
    return body_params(20.0, damping, mass_kg, 40.0, rest_m)


def path_of(params: BodyParams, base_m: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return y and F at each step of a motion of the base that begins at rest."""
    y, v = 0.0, 0.0
    rows = [(y, params.cantilever_n_per_m * max(base_m[0] - params.rest_distance_m, 0.0))]
    for before, after in itertools.pairwise(base_m):
        y, v = pushed(params, (before, after), y, v, DT)
        rows.append((y, params.cantilever_n_per_m * max(after - params.rest_distance_m - y, 0.0)))
    ys, forces = np.array(rows).T
    return ys, forces


def test_motion_is_that_of_its_equation() -> None:
    params = body()
    time = np.arange(1001) * DT
    base = 5e-9 * (1.0 - np.cos(2.0 * math.pi * 2.0 * time)) + 2e-9

    def slope(t: float, state: Any) -> list[float]:
        x = 5e-9 * (1.0 - math.cos(2.0 * math.pi * 2.0 * t)) + 2e-9
        force = 40.0 * max(x - state[0], 0.0)
        return [state[1], (force - 0.02 * state[1] - 20.0 * state[0]) / 0.01]

    exact = solve_ivp(slope, (0.0, 1.0), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-20).y[0]
    found, _ = path_of(params, base)
    assert np.abs(found - exact).max() < 5e-3 * np.abs(exact).max()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("lift_m", [0.0, 3e-9], ids=["in contact", "bouncing"])
def test_body_is_passive_at_its_period(seed: int, lift_m: float) -> None:
    generator = np.random.default_rng(seed)
    params = body(damping=0.0)
    steps = np.convolve(generator.normal(size=2020), np.ones(20) / 20.0, "valid")
    base = 20e-9 + np.cumsum(steps) * 2e-10 if lift_m == 0.0 else lift_m * np.cumsum(steps) * 0.1
    base = np.concatenate([np.linspace(0.0, base[0], 50)[:-1], base])
    y, v, given, size = 0.0, 0.0, 0.0, 0.0
    for before, after in itertools.pairwise(base):
        z0 = before - y
        y, v = pushed(params, (before, after), y, v, DT)
        z1 = after - y
        rise = z1 - z0
        mean = 20.0 * (max(z1, 0.0) ** 2 - max(z0, 0.0) ** 2) / rise if rise else 0.0
        given += mean * (after - before)
        stored = 0.5 * 0.01 * v * v + 10.0 * y * y + 20.0 * max(z1, 0.0) ** 2
        size = max(size, stored)
        assert given == pytest.approx(stored, rel=0.0, abs=1e-9 * size + 1e-30)


def test_body_that_the_period_cannot_show_is_refused() -> None:
    with pytest.raises(ValueError, match=r"1e-06 kg: on 60 N/m it must be at least 6\.75e-05 kg"):
        body(mass_kg=1e-6)


def cell(law: str, delay_ms: float, mass_kg: float) -> Cell:
    return Cell(
        law=law,
        environment="body",
        round_trip_ms=delay_ms,
        stiffness_n_per_m=20.0,
        mass_kg=mass_kg,
        damping_n_s_per_m=0.02,
        session_s=2.2,
    )


@pytest.mark.usefixtures("plain_loop")
def test_hand_presses_on_a_light_body_as_on_a_wall() -> None:
    light = run_cell(cell("position_force", 20.0, 1e-4))
    assert light.verdict == "stable"
    assert light.tip_n == pytest.approx(1.0, rel=1e-3, abs=0.0)


@pytest.mark.usefixtures("plain_loop")
def test_smith_predicts_no_mass() -> None:
    assert run_cell(cell("smith", 50.0, 0.01)).verdict != "stable"
