"""Particles under the instrument: what it measures of them, in which state it goes on, and what is refused."""

import math
from copy import copy
from typing import Any

import numpy as np
import pytest
from telenano_lab.assembly.particles.tip_shape import ride_height_m, tip_shape

from telenano.devices import driver_of
from telenano.sections import AfmConfig
from telenano.settings import validate
from telenano.wire import ConfigError

DEEP = {"base_min_m": -1e-6, "retract_position_m": -7e-7, "base_max_m": 2e-7}
TWO = {"places": [[0.0, 0.0], [2e-6, 0.0]]}


def config(particles: dict[str, Any], **others: Any) -> AfmConfig:
    section = {
        "sample": {"name": "flat", "size_m": 8e-6, "pixels": 16, "particles": particles},
        "cantilever": {"stiffness_n_per_m": 1.0},
        "meniscus": False,
        "safety": DEEP,
        **others,
    }
    return validate(AfmConfig, section, "a test", "afm_node")


def opened(settings: AfmConfig) -> Any:
    device = driver_of(settings)
    device.open()
    return device


def swept(device: Any, base_m: float, x0: float, x1: float, y: float = 0.0) -> np.ndarray:
    """Return deflection, force and lateral forces along a line, a point each 2 nm."""
    seen = []
    for x in np.linspace(x0, x1, round(abs(x1 - x0) / 2e-9) + 1).tolist():
        device.move_to(x, y)
        device.elapse(1e-3)
        sample = device.exchange(base_m)
        seen.append((sample.deflection_m, sample.force_n, sample.lateral_x_n, sample.lateral_y_n))
    return np.array(seen)


def places(device: Any) -> np.ndarray:
    return device.state.part.moving[:, :2]


def test_a_light_tip_rides_over_a_particle_and_shows_its_height() -> None:
    device = opened(config(TWO, cantilever={"stiffness_n_per_m": 0.01}))
    # 2.5 nN at half of the height, less than what the particle holds, by a cantilever as soft as that
    seen = swept(device, 10e-9 + 1e-9, -500e-9, 500e-9)
    assert places(device)[0].tolist() == [0.0, 0.0]
    shape = tip_shape(10e-9, math.radians(15))
    top = ride_height_m(shape, 250e-9, 0.0)
    assert seen[:, 0].max() == pytest.approx(top + 1e-9, rel=5e-3)
    # it leans back before the top and forward behind it
    assert seen[:, 2].min() < -1e-9 and seen[:, 2].max() > 1e-9


def test_a_heavy_tip_pushes_it_and_feels_its_kinetic_friction() -> None:
    device = opened(config(TWO))
    seen = swept(device, 10e-9 + 20e-9, -600e-9, 0.0)
    assert places(device)[0, 0] == pytest.approx(333.48e-9 - 0.1075e-9, rel=1e-4)
    assert seen[-1, 2] * 1e9 == pytest.approx(-10.7526, rel=1e-4)
    # the substrate gives up what the particle carries
    free = opened(config({"count": 0}))
    alone = swept(free, 10e-9 + 20e-9, -10e-9, 0.0)
    assert seen[-1, 1] == pytest.approx(alone[-1, 1], rel=2e-2)
    assert places(device)[1].tolist() == [2e-6, 0.0]


def test_a_tip_that_is_driven_leaves_particles_where_they_are() -> None:
    device = opened(config(TWO, model="dynamic"))
    device.vibrate(20e-9)
    for x in np.linspace(-400e-9, 0.0, 40).tolist():
        device.move_to(x, 0.0)
        device.elapse(1e-3)
        device.exchange(10e-9)
    assert places(device).tolist() == [[0.0, 0.0], [2e-6, 0.0]]


def test_the_state_goes_on_from_where_it_was_kept() -> None:
    device, other = opened(config(TWO)), opened(config(TWO))
    swept(device, 30e-9, -600e-9, -200e-9, 40e-9)
    other.state = copy(device.state)
    first = swept(device, 30e-9, -200e-9, 100e-9, 40e-9)
    again = swept(other, 30e-9, -200e-9, 100e-9, 40e-9)
    assert first.tobytes() == again.tobytes()
    assert places(device).tobytes() == places(other).tobytes()


@pytest.mark.parametrize(
    ("particles", "others", "words"),
    [
        ({"places": [[0.0, 0.0], [4e-7, 0.0]]}, {}, "numbers 0 and 1 overlap"),
        ({"places": [[5e-6, 0.0]]}, {}, "number 0 at 5e-06, 0 m"),
        ({"radius_m": 0.0}, {}, "radius_m"),
        (
            {"count": 50, "radius_m": 8e-7},
            {"safety": {**DEEP, "base_min_m": -5e-6, "retract_position_m": -4e-6}},
            "find no room",
        ),
        ({"places": [[0.0, 0.0]], "count": 3}, {}, "either places or count"),
        ({}, {"safety": {}}, "must be -5.9e-07 m or less"),
        ({}, {"environment": "spring"}, "environment tip_sample"),
    ],
)
def test_particles_that_cannot_be_are_refused_in_one_sentence(
    particles: dict[str, Any], others: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError) as refused:
        opened(config(particles, **others))
    assert words in str(refused.value)


def test_drawn_places_are_those_of_the_seed_and_leave_room_for_the_tip() -> None:
    first, again, other = (opened(config({"count": 8, "seed": seed})) for seed in (4, 4, 5))
    assert places(first).tobytes() == places(again).tobytes() != places(other).tobytes()
    at = places(first)
    apart = np.hypot(*(at[:, None, :] - at[None, :, :]).transpose(2, 0, 1))
    np.fill_diagonal(apart, 1.0)
    assert apart.min() >= 4 * 250e-9 and np.abs(at).max() <= 3e-6
