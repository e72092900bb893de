"""Disturbances in lockstep are those of the node, one for one."""

import numpy as np
import pytest

from telenano.afm import safety, simulated_afm
from telenano.afm.disturbed import noisy_params
from telenano.afm.step import AfmInputs, initial_afm_state, step
from telenano.sections import AfmConfig
from telenano.settings.afm_disturbances import DisturbanceConfig

AFM = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 2.0}}).to_params()


ALL = {
    "seed": 8,
    "vibration": {"enabled": True},
    "hysteresis": {"enabled": True, "range_m": 30e-9},
    "creep": {"enabled": True},
    "stage": {"enabled": True, "resonance_hz": 150.0},
    "drift": {"enabled": True, "speed_m_per_s": 2e-9},
    "thermal": {"enabled": True},
    "readout": {"enabled": True},
    "electrostatic": {"enabled": True, "voltage_v": 1.5, "noise_v": 0.3},
}


@pytest.mark.parametrize("name", [*(key for key in ALL if key != "seed"), "all"])
def test_each_disturbs_as_in_the_node(name: str) -> None:
    config = DisturbanceConfig.model_validate(ALL if name == "all" else {"seed": 8, name: ALL[name]})
    node = simulated_afm(AFM, disturbances=config)
    node.open()
    params = AFM._replace(plant=noisy_params(config, AFM.plant, 0.5))
    state = initial_afm_state(params)
    rng = np.random.Generator(np.random.PCG64(1))
    references = np.concatenate([np.linspace(-20e-9, 25e-9, 150), np.linspace(25e-9, -20e-9, 150)])
    forces = []
    # the first one is where both begin at rest
    for reference in (-100e-9, *(references + rng.normal(0.0, 0.2e-9, 300)).tolist()):
        asked = AfmInputs(reference, 0.0, safety.ACTION_POSITION, True, False)
        state, (found, _) = step(params, state, asked, 1e-3)
        node.elapse(1e-3)
        expected = node.exchange(found.base_m)
        # the same parts, bit for bit
        assert found == expected
        forces.append(found.force_n)
    assert max(forces) > 3e-9 > -3e-9 > min(forces)
