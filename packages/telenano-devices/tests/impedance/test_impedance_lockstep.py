"""The second hold of Fig. 12 by all laws through a virtual coupling, in lockstep, beside the paper's master."""

import numpy as np
import pytest
from telenano_devices.impedance.coupled import coupled_plant_step

from telenano import simulate
from telenano.extend.hands import DriveCommand, SpatialCommand
from telenano.hand import initial_plant
from telenano.numerics import compiled_form
from telenano.sections import HapticConfig

DEVICE = {"haptic_node.driver": "simulated_impedance", "haptic_node.coupling.rest_s": 0.05}
# F_m over alpha_f F_s at rest
RATIOS = {
    "virtual_impedance": 1.05,
    "smith": 1.05,
    "position_force": 1.0,
    "passivity": 1.0,
    "wave": 1.0,
    "model_mediated": 1.0,
}


@pytest.mark.endurance
@pytest.mark.parametrize("law", RATIOS)
def test_hold_has_the_ratio_of_the_law_and_the_hand_is_f_over_k_further(law: str) -> None:
    params = HapticConfig.model_validate({"driver": "simulated_impedance"}).to_simulated_params()
    stiffness = params.settings.stiffness_n_per_m[2]
    coupled, paper = (simulate("fig12", law=law, settings=given) for given in (DEVICE, {}))
    at = int(np.searchsorted(coupled["time_s"], 4.4))
    force_n = coupled["operator_force_n"][at]
    assert force_n == pytest.approx(2.0, rel=1e-6, abs=0.0)
    assert force_n / (1e8 * coupled["tip_force_n"][at]) == pytest.approx(RATIOS[law], rel=0.005, abs=0.0)
    assert coupled["reference_m"][at] == pytest.approx(paper["reference_m"][at], rel=0.01, abs=0.0)
    beyond_m = coupled["hand_position_m"][at] - coupled["reference_m"][at]
    assert beyond_m == pytest.approx(force_n / stiffness, rel=1e-3, abs=0.0)


@pytest.mark.endurance
def test_compiled_device_gives_the_same_bits_as_the_plain_one() -> None:
    document = (
        '{"driver": "simulated_impedance", "operator": {"kind": "force_profile"}, "impedance": {"model": "omega"}}'
    )
    params = HapticConfig.model_validate_json(document).to_simulated_params()
    compiled, state, other = compiled_form(coupled_plant_step), *(initial_plant(params, 0.0) for _ in range(2))
    for tick in range(2000):
        command = DriveCommand(int(tick > 300), 1e-6 * tick, 0.0, SpatialCommand((0.0, 1e-3), (0.1, 0.0), tick == 900))
        state, reading = compiled(params, state, command, 1e-3 * tick, 1e-3)
        other, expected = coupled_plant_step(params, other, command, 1e-3 * tick, 1e-3)
        assert reading == expected, tick
    assert reading.spatial is not None and reading.spatial.gate == 0 and abs(reading.motor_force_n) > 0.1
