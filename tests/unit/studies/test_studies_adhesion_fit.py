"""Radius and work of adhesion come back from curves that were made with them, within the uncertainty that is stated."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from proto.errors import ConfigError
from services.afm_node.config import AfmConfig
from studies.instrument.adhesion_fit import fit_adhesion
from studies.instrument.curve_models import compare_models
from studies.instrument.force_curve import Curve, force_curve, read_measured

DATA = Path(__file__).parents[4] / "shared" / "data" / "SiN_FD_plot.ibw"
SOFT = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 8.0}})


@pytest.fixture(scope="module")
def curve() -> Curve:
    return force_curve(SOFT, 20e-9, 20e-9)


def test_a_curve_of_the_model_gives_table_2_back(curve):
    found = fit_adhesion(curve, SOFT)
    assert found.radius_m == pytest.approx(10e-9, rel=0.01, abs=0)
    assert found.work_of_adhesion_j_per_m2 == pytest.approx(0.072, rel=0.01, abs=0)
    assert found.transition == pytest.approx(0.82538, rel=0.01, abs=0)
    assert found.residual_n < 0.02e-9


def test_a_stiff_cantilever_gives_it_as_well():
    config = AfmConfig()
    found = fit_adhesion(force_curve(config, 20e-9, 20e-9), config)
    assert (found.radius_m, found.work_of_adhesion_j_per_m2) == pytest.approx((10e-9, 0.072), rel=0.02, abs=0)


def test_with_noise_the_truth_lies_within_three_standard_errors(curve):
    random = np.random.default_rng(3)
    noise = random.normal(0.0, 0.1e-9, len(curve.retract.force_n))
    half = curve.retract
    noisy = replace(half, force_n=half.force_n + noise, deflection_m=half.deflection_m + noise / 8.0)
    found = fit_adhesion(replace(curve, retract=noisy), SOFT)
    assert abs(found.radius_m - 10e-9) < 3.0 * found.radius_error_m
    assert abs(found.work_of_adhesion_j_per_m2 - 0.072) < 3.0 * found.work_of_adhesion_error_j_per_m2
    # 0.1 nN on 20 nN: a few per cent, and not nothing
    assert 1e-4 < found.radius_error_m / found.radius_m < 0.1


def test_a_curve_without_a_pull_off_is_refused(curve):
    half = curve.retract
    pushed = replace(half, force_n=np.abs(half.force_n) + 1e-9)
    with pytest.raises(ConfigError, match="points in contact before a pull-off"):
        fit_adhesion(replace(curve, retract=pushed), SOFT)


def test_both_models_have_the_same_points_of_the_curve():
    (row,) = compare_models((8.0,), points=150)
    # the bounds that docs/instrument.md states
    assert abs(row.pull_off_share) < 0.002
    assert abs(row.snap_in_difference_m) <= row.step_m
    assert abs(row.hysteresis_share) < 0.03


@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_curve_is_fitted_with_uncertainties():
    config = AfmConfig.model_validate({"meniscus": False})
    with pytest.raises(ConfigError, match="no contact of reduced modulus"):
        fit_adhesion(read_measured(DATA), config)
    # half of the way of the base goes into the sample: it is soft
    found = fit_adhesion(read_measured(DATA), config, 1e7)
    assert found.points > 50
    # the fit is as good as 0.1 nN on 23 nN, and tells both within a tenth
    assert found.residual_n < 0.2e-9
    assert found.radius_m == pytest.approx(66e-9, rel=0.2, abs=0)
    assert found.radius_error_m < 0.1 * found.radius_m
    assert found.work_of_adhesion_error_j_per_m2 < 0.15 * found.work_of_adhesion_j_per_m2
