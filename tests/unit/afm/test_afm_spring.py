"""The linear environment: its force, its driver, and that it stands behind the same guard as the sample."""

import math

import pytest

from telenano.afm.sim import SimulatedInstrument
from telenano.afm.spring import spring_force, spring_params
from telenano.afm.step import AfmInputs, initial_afm_state, step
from telenano.sections.afm_parts import SafetyConfig, SpringConfig
from telenano.sections.afm_section import AfmConfig

CONFIG = AfmConfig(environment="spring", spring=SpringConfig(stiffness_n_per_m=38.0, rest_position_m=1e-9))
PARAMS = CONFIG.to_spring_params()


def test_force_is_linear_both_ways_and_one_sided_where_asked() -> None:
    for x in (-5e-9, 0.0, 1e-9, 4e-9):
        assert spring_force(PARAMS.plant, x) == 38.0 * (x - 1e-9)
    one_sided = spring_params(38.0, 1e-9, False)
    assert spring_force(one_sided, -5e-9) == 0.0
    assert spring_force(one_sided, 4e-9) == 38.0 * (4e-9 - 1e-9)


@pytest.mark.parametrize("stiffness", [0.0, -1.0, math.inf, math.nan])
def test_stiffness_that_is_none_is_named(stiffness: float) -> None:
    with pytest.raises(ValueError, match=r"stiffness of the environment K = .* N/m must be finite and > 0"):
        spring_params(stiffness, 0.0, True)


def test_driver_gives_what_the_compiled_step_gives() -> None:
    device = SimulatedInstrument(PARAMS)
    device.open()
    state = initial_afm_state(PARAMS)
    for n in range(200):
        asked = AfmInputs(2e-9 * math.sin(0.1 * n), 0.0, 0, n == 0, False)
        state, (out, _) = step(PARAMS, state, asked, 1e-3)
        sample = device.exchange(out.base_m)
        assert (sample.force_n, sample.distance_m, sample.in_contact) == (out.force_n, out.distance_m, out.in_contact)


def test_driver_says_what_is_wrong() -> None:
    device = SimulatedInstrument(PARAMS)
    with pytest.raises(RuntimeError, match="not open"):
        device.exchange(0.0)
    device.open()
    with pytest.raises(RuntimeError, match="already open"):
        device.open()
    with pytest.raises(ValueError, match="must be finite"):
        device.exchange(math.nan)
    device.close()
    device.close()
    assert device.safe_position_m == PARAMS.safety.retract_position_m


def test_guard_in_front_of_it_is_the_same() -> None:
    limits = AfmConfig().to_params().safety
    # at 100 nm it would pull with 3.8 uN
    assert PARAMS.safety == limits._replace(retract_position_m=1e-9)
    for other in (
        AfmConfig(environment="spring", spring=SpringConfig(bilateral=False)),
        AfmConfig(environment="spring", spring=SpringConfig(rest_position_m=1e-5)),
        AfmConfig(environment="spring", safety=SafetyConfig(retract_position_m=-100e-9)),
        AfmConfig(spring=SpringConfig(rest_position_m=1e-9)),
    ):
        assert other.safety.retract_position_m == -100e-9


def test_a_configuration_read_again_from_what_it_wrote_begins_in_the_same_place() -> None:
    assert AfmConfig.model_validate(CONFIG.model_dump()) == CONFIG
    assert AfmConfig.model_validate(CONFIG.model_dump(exclude_unset=True)) == CONFIG
