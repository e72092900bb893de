"""Force curves in a program that fits them: the modulus of a contact that is computed from Hertz' equation."""

import json
from pathlib import Path

import numpy as np
import pytest
from foreign_programs import python_program
from planted_errors import each_error, judge, planted
from telenano_lab.microscopy.force_curve import Curve, Half, write_hdf5

pytestmark = pytest.mark.timeout(1800)

MODULUS_PA, POISSON, RADIUS_M, STIFFNESS_N_PER_M = 1e8, 0.3, 50e-9, 1.0

NANITE = """
import json, sys
import nanite
from nanite import model
curve = nanite.load_group(sys.argv[1])[0]
curve.apply_preprocessing(["compute_tip_position", "correct_force_offset", "correct_tip_offset"])
start = model.models_available["hertz_para"].get_parameter_defaults()
start["R"].value, start["nu"].value, start["E"].value = float(sys.argv[2]), float(sys.argv[3]), 1e7
curve.fit_model(model_key="hertz_para", params_initial=start, segment="approach", x_axis="tip position", weight_cp=0)
found = curve.fit_properties["params_fitted"]
print(json.dumps({"modulus": found["E"].value, "stiffness": curve.metadata["spring constant"]}))
"""


def hertz_curve(error: str) -> Curve:
    """Return a curve of a stiff paraboloid on a half-space; an exchanged axis lets the base go the other way."""
    indentation_m = np.concatenate([np.zeros(500), np.linspace(0.0, 10e-9, 500)])
    force_n = 4.0 / 3.0 * MODULUS_PA / (1.0 - POISSON**2) * np.sqrt(RADIUS_M) * indentation_m**1.5
    base_m = np.concatenate([np.linspace(-30e-9, 0.0, 500, endpoint=False), indentation_m[500:]])
    base_m[500:] += force_n[500:] / STIFFNESS_N_PER_M
    written_n = planted("" if error == "axis" else error, force_n)
    there = Half(-base_m if error == "axis" else base_m, written_n / STIFFNESS_N_PER_M, written_n)
    back = Half(*(values[::-1] for values in (there.base_m, there.deflection_m, there.force_n)))
    return Curve(there, back, STIFFNESS_N_PER_M, 0.0, 1e-7, "computed")


@each_error
@pytest.mark.endurance
def test_nanite_finds_the_modulus_of_a_contact(tmp_path: Path, error: str) -> None:
    nanite = python_program("nanite==4.2.3")
    write_hdf5(tmp_path / "curve.h5", hertz_curve(error))
    words = ("-c", NANITE, tmp_path / "curve.h5", str(RADIUS_M), str(POISSON))
    found = json.loads(nanite.having(HOME=tmp_path).run(*words))
    judge(error, {"modulus": MODULUS_PA, "stiffness": STIFFNESS_N_PER_M}, found, rtol=1e-6)
