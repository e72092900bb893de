"""The lateral force as it is measured: gain error, crosstalk and range."""

from typing import Any

import pytest

from telenano.afm.part import Part, part_start, part_step, register_part
from telenano.devices.afm.instrument import driver_of
from telenano.extend.samples import AfmSample, PlantInputs
from telenano.sections.afm_parts import TorsionConfig
from telenano.sections.afm_section import AfmConfig
from telenano.settings.config import validate
from telenano.wire.errors import ConfigError

ACROSS_N, DEFLECTION_M = (3e-9, -4e-9), 2e-8


class Bent(tuple[()]):
    """Parameters of a part that always measures the same."""


def bent(params: Any, state: Any, inputs: PlantInputs, dt: float) -> tuple[Any, AfmSample]:
    return state, AfmSample(inputs.base_m, DEFLECTION_M, 2e-8, 0.0, 0.0, True, True, False, *ACROSS_N)


register_part(Bent, Part(lambda params, inputs: (), bent))


def read(**keys: Any) -> tuple[float, float]:
    part = TorsionConfig(**keys).around(Bent(), 0.5)
    inputs = PlantInputs(0.0)
    _, sample = part_step(part, part_start(part, inputs), inputs, 1e-3)
    assert (sample.force_n, sample.deflection_m) == (2e-8, DEFLECTION_M)
    return sample.lateral_x_n, sample.lateral_y_n


def test_the_channel_reads_gain_error_crosstalk_and_no_more_than_its_range() -> None:
    assert read() == ACROSS_N
    assert read(gain_error=0.25) == pytest.approx((3.75e-9, -5e-9), rel=1e-12, abs=0.0)
    # k zeta = 10 nN
    assert read(crosstalk_x=0.1, crosstalk_y=-0.2) == pytest.approx((4e-9, -6e-9), rel=1e-12, abs=0.0)
    assert read(gain_error=-0.5, crosstalk_x=0.1) == pytest.approx((2e-9, -2e-9), rel=1e-12, abs=0.0)
    assert read(factor_n_per_v=1e-10, range_v=35.0) == pytest.approx((3e-9, -3.5e-9), rel=1e-12, abs=0.0)


def test_a_channel_that_cannot_read_the_limit_of_the_guard_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"torsion\.factor_n_per_v times torsion\.range_v = 1e-06 N must be above"):
        validate(AfmConfig, {"torsion": {"factor_n_per_v": 1e-7}}, "a test", "afm_node")
    with pytest.raises(ConfigError, match="gain_error"):
        validate(AfmConfig, {"torsion": {"gain_error": -1.0}}, "a test", "afm_node")
    with pytest.raises(ConfigError, match="torsion is for driver simulated and environment tip_sample"):
        validate(AfmConfig, {"environment": "spring", "torsion": {"gain_error": 0.1}}, "a test", "afm_node")


def test_an_ideal_channel_is_no_part_of_the_instrument() -> None:
    assert type(driver_of(AfmConfig())._params.plant).__name__ == "Plant"  # type: ignore[attr-defined]
