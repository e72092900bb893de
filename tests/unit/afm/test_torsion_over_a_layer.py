"""The torsion channel over a layer of a package gives the same bits compiled as plain."""

from typing import Any

import numpy as np
import pytest

from telenano.afm import part_step
from telenano.afm.sim import SimulatedInstrument
from telenano.afm.torsion import TorsionParams, _step
from telenano.devices import driver_of
from telenano.extend.samples import PlantInputs
from telenano.numerics import compiled_form
from telenano.sections import AfmConfig
from telenano.settings import validate

pytestmark = [
    pytest.mark.check("compiles a layer, takes 13 s"),
    pytest.mark.drawn(
        0.0, "telenano/afm/", "telenano/numerics/", "packages/telenano-lab/telenano_lab/assembly/particles/"
    ),
]

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


def opened(settings: AfmConfig) -> SimulatedInstrument:
    device = driver_of(settings)
    assert isinstance(device, SimulatedInstrument)
    device.open()
    return device


def test_layer_and_torsion_channel_give_the_same_bits_compiled_as_plain() -> None:
    torsion = {"gain_error": 0.3, "crosstalk_x": 0.17, "crosstalk_y": -0.2, "factor_n_per_v": 1e-8, "range_v": 0.9}
    settings = config(TWO, torsion=torsion, safety={**DEEP, "lateral_limit_n": 8e-9})
    params = opened(settings)._params.plant
    assert isinstance(params, TorsionParams)
    plain, fast = opened(settings).state.part, opened(settings).state.part
    compiled, most = compiled_form(_step), 0.0
    for x in np.linspace(-600e-9, 200e-9, 200).tolist():
        inputs = PlantInputs(30e-9, x, 25e-9, 0.0, 0.0, 0.0, 0.0, 0)
        plain, one = part_step(params, plain, inputs, 1e-3)
        fast, two = compiled(params, fast, inputs, 1e-3)
        assert tuple(one) == tuple(two)
        assert plain.moving.tobytes() == fast.moving.tobytes()
        most = max(most, abs(one.lateral_x_n))
    # the channel was at the end of its range as well
    assert most == params.most_n
