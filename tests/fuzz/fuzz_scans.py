"""Small scans of random maps with random and extreme parameters, as a process of its own that checks every index.

Run with NUMBA_BOUNDSCHECK=1: code compiled without it looks up whatever lies in memory. What cannot be imaged must be
a ConfigError of `scan`, and a ValueError of the lines beneath it; anything else ends this process.
"""

import math
import sys
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from telenano_microscopy.imaging import CHANNELS, Feedback, Line, contact_line, tapping_line
from telenano_microscopy.scan import Noise, scan

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from services.afm_node.physics.cantilever import initial_state
from services.afm_node.physics.contact.friction import FrictionState
from services.afm_node.physics.dynamic import NO_NOISE, steady_state
from services.afm_node.physics.sample.surface import Surface, checked, height_at
from services.afm_node.programs.scan import ScanSettings
from services.numerics.compiled import always_compiled

EXAMPLES = int(sys.argv[1])
ANYTHING = st.one_of(
    st.floats(),
    st.sampled_from([0.0, -0.0, 5e-324, 1e-300, 1e300, -1e300, math.inf, -math.inf, math.nan]),
)


def spread(low: float, high: float) -> st.SearchStrategy[float]:
    """Give numbers from low to high, and both, evenly over their orders of magnitude."""
    between = st.floats(math.log(low), math.log(high)).map(lambda x: min(max(math.exp(x), low), high))
    return st.one_of(between, st.sampled_from([low, high]))


def usual(value: Any, whole: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Give the usual value three times as often as all others: so that most examples get far."""
    return st.one_of(st.just(value), st.just(value), st.just(value), whole)


@st.composite
def surfaces(draw: st.DrawFn) -> Surface:
    rows, columns = draw(st.integers(2, 5)), draw(st.integers(2, 5))
    height = draw(st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 5e-5]))
    heights = draw(st.lists(st.floats(-1.0, 1.0), min_size=rows * columns, max_size=rows * columns))
    sides = draw(usual(1e-7, spread(1e-9, 1e-3))), draw(usual(1e-7, spread(1e-9, 1e-3)))
    return checked(np.array(heights).reshape(rows, columns) * height, *sides)


SECTIONS = st.fixed_dictionaries(
    {},
    optional={
        "cantilever": st.fixed_dictionaries(
            {},
            optional={
                "stiffness_n_per_m": spread(1e-3, 1e4),
                # each scan has 30 ms to arrive
                "resonance_hz": spread(1e3, 1e6),
                "quality": spread(0.51, 1e7),
                "steps_per_period": st.sampled_from([16, 24, 96, 256]),
            },
        ),
        "tip_sample": st.fixed_dictionaries(
            {},
            optional={
                "tip_radius_m": spread(1e-10, 1e-3),
                "hamaker_j": spread(1e-30, 1e-17),
                "sigma_m": spread(1e-11, 1e-8),
                "work_of_adhesion_j_per_m2": spread(1e-6, 10.0),
                "sample_modulus_pa": spread(1e2, 1e13),
                "liquid_energy_j_per_m2": st.sampled_from([0.0, 0.073, 1.0]),
                "meniscus_radius_m": spread(1e-11, 1e-6),
                "liquid_viscosity_pa_s": st.sampled_from([0.0, 1e-3, 1e6]),
                "sample_viscosity_pa_s": st.sampled_from([0.0, 1.0, 1e9]),
            },
        ),
        "friction": st.fixed_dictionaries({"coefficient": st.sampled_from([0.0, 0.3])}),
        "rest_distance_m": spread(1e-9, 1e-5),
    },
)
REQUESTS = st.fixed_dictionaries(
    {"mode": st.sampled_from(["contact", "tapping"]), "pixels": st.integers(1, 4), "lines": st.integers(1, 2)},
    optional={
        # a second is 14 million steps
        "dwell_s": usual(2e-5, st.sampled_from([5e-324, 1e-6, 2e-4, 0.0, -1.0, 10.1, 1e300, math.inf, math.nan])),
        "amplitude_m": usual(20e-9, st.one_of(spread(1e-10, 1e-3), ANYTHING)),
        "setpoint_share": usual(0.8, ANYTHING),
        "setpoint_n": usual(5e-9, st.one_of(spread(1e-15, 1e-3), ANYTHING)),
        "gain_per_s": usual(5000.0, st.one_of(spread(1.0, 1e5), ANYTHING)),
        "proportional": usual(0.5, st.one_of(spread(1e-3, 30.0), ANYTHING)),
        "temperature_k": usual(300.0, ANYTHING),
    },
)
WHOLE = settings(deadline=None, derandomize=True, suppress_health_check=list(HealthCheck), max_examples=EXAMPLES)
counts = {"imaged": 0, "refused": 0, "lines": 0}


@WHOLE
@given(surfaces(), REQUESTS, SECTIONS)
def scans(surface: Surface, request: dict[str, Any], section: dict[str, Any]) -> None:
    try:
        config = AfmConfig.model_validate(section)
    except (ValidationError, ConfigError):
        return
    try:
        noise = Noise(request.pop("temperature_k", 0.0))
        found = scan(surface, ScanSettings.in_simulated_time(**request), config, noise=noise)
    except ConfigError:
        counts["refused"] += 1
        return
    counts["imaged"] += 1
    assert np.isfinite(found.trace).all(), "an image is of numbers"
    assert np.isfinite(found.retrace).all(), "an image is of numbers"


@WHOLE
@given(surfaces(), ANYTHING, ANYTHING)
def places(surface: Surface, x_m: float, y_m: float) -> None:
    thin = Surface(surface.height_m[:1, :1], surface.step_x_m, surface.step_y_m)
    for seen in (surface, thin):
        try:
            found = height_at(*seen, x_m, y_m)
        except ValueError:
            continue
        assert all(map(math.isfinite, found)), "a map is of numbers"


TAPPING, CONTACT = AfmConfig().to_dynamic(), AfmConfig().to_params().plant


@WHOLE
@given(
    surfaces(),
    st.lists(usual(0.0, ANYTHING), min_size=14, max_size=14),
    usual(3, st.integers(-1, 5)),
    usual(CHANNELS, st.integers(0, CHANNELS)),
)
def lines(surface: Surface, x: list[float], pixels: int, channels: int) -> None:
    feedback = Feedback(*x[:6])
    line = Line(*x[6:10], pixels, 2)
    out = np.zeros((3, channels))
    state = steady_state(TAPPING, x[10], x[11])
    for tap in (True, False):
        try:
            if tap:
                tapping_line(TAPPING, state, x[12], x[13], feedback, line, *surface, x[11], NO_NOISE, 0, out)
            else:
                start = initial_state(CONTACT, 0.0)
                friction = AfmConfig().to_friction_params()
                held = FrictionState(x[10], x[11])
                contact_line(
                    CONTACT, start, x[10], x[12], x[13], feedback, line, *surface, 5e-5, friction, held, 0, out
                )  # fmt: skip
            counts["lines"] += 1
        except (ValueError, ZeroDivisionError):
            continue


@always_compiled
def beyond(values: np.ndarray, i: int) -> float:
    return float(values[i])


try:
    beyond(np.zeros(2), 7)
except IndexError:
    pass
else:
    sys.exit("indices are not checked: set NUMBA_BOUNDSCHECK=1")
for property_of in (places, lines, scans):
    property_of()
sys.stdout.write(f"{counts}\n")
if min(counts.values()) < EXAMPLES // 10:
    sys.exit("too few examples got far enough to look anything up")
