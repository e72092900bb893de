"""Contact point, modulus and adhesion of made curves lie within the stated errors; what is refused says why."""

import itertools
import math
from collections import Counter
from collections.abc import Iterable

import numpy as np
import pytest
from telenano_lab.doubles.made_curves import NOISES, MadeCurve, curve_under, drawn_conditions, drawn_curve
from telenano_lab.microscopy.contact_models import JKR, Contact, forces
from telenano_lab.microscopy.curve_fit import ContactShape, CurveFit, MeasuredWays, fit_curve

from telenano.wire import ConfigError

MODELS = ("hertz", "sneddon", "dmt", "jkr")
QUANTITIES = (("contact_m", "contact_error_m"), ("modulus_pa", "modulus_error_pa"), ("adhesion_n", "adhesion_error_n"))
# The share of curves that may be refused: the drawn conditions have levers that are too soft for their samples.
MOST_REFUSED = 0.35


def shape_of(made: MadeCurve, *, told: bool = True) -> ContactShape:
    thickness_m = made.truth.thickness_m if told else 0.0
    return ContactShape(made.model, made.radius_m, made.half_angle_rad, made.poisson, thickness_m)


def ways_of(made: MadeCurve) -> MeasuredWays:
    return MeasuredWays(made.approach_m, made.approach_n, made.retract_m, made.retract_n, made.stiffness_n_per_m)


def fitted(made: MadeCurve, *, told: bool = True) -> CurveFit:
    ways = ways_of(made)
    return fit_curve(ways, shape_of(made, told=told))


def covered(curves: Iterable[MadeCurve]) -> tuple[int, Counter[str]]:
    """Return how many curves were fitted, and of how many each quantity is within 1.96 errors."""
    count, held = 0, Counter[str]()
    for made in curves:
        found = fitted(made)
        if found.refused:
            continue
        count += 1
        for name, error in QUANTITIES:
            held[name] += abs(getattr(found, name) - getattr(made.truth, name)) <= 1.96 * getattr(found, error)
    return count, held


def least_of(count: int, share: float) -> int:
    """Return the count that a share of count falls below once in a thousand."""
    mean, spread = share * count, math.sqrt(count * share * (1.0 - share))
    return math.floor(mean - 3.1 * spread)


@pytest.mark.check("fits 70 curves")
def test_each_quantity_is_within_its_error_in_95_of_100() -> None:
    curves = [drawn_curve(model, 2000 + seed) for model in MODELS for seed in range(12)]
    curves += [drawn_curve(model, 2000 + seed, is_layer=True) for model in ("hertz", "dmt") for seed in range(10)]
    count, held = covered(curves)
    assert count >= (1.0 - MOST_REFUSED) * len(curves)
    for name, _ in QUANTITIES:
        assert held[name] >= least_of(count, 0.95), (name, held[name], count)


@pytest.mark.endurance
@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("model", MODELS)
def test_each_quantity_is_within_its_error_in_noise_of_each_kind(model: str, noise: str) -> None:
    curves = [drawn_curve(model, 5000 + seed, noise=noise) for seed in range(200)]
    count, held = covered(curves)
    assert count >= (1.0 - MOST_REFUSED) * len(curves)
    # A record of one curve does not tell how far a random walk goes while it is measured.
    share = 0.9 if noise in ("walk", "flicker") else 0.95
    for name, _ in QUANTITIES:
        assert held[name] >= least_of(count, share), (name, held[name], count)


@pytest.mark.check("compiles the steps")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/microscopy/")
def test_the_error_is_no_more_than_what_the_noise_asks_for() -> None:
    # an interval that is wide enough for anything covers as well
    made = [drawn_curve("hertz", 3000 + seed, noise="white") for seed in range(6)]
    shares = [abs(found.modulus_error_pa / found.modulus_pa) for each in made if not (found := fitted(each)).refused]
    assert len(shares) >= 4
    assert np.median(shares) < 0.05


@pytest.mark.check("fits 30 curves")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/microscopy/")
def test_a_thin_layer_that_is_not_told_is_refused_or_the_error_says_so() -> None:
    silent, refused = 0, 0
    made = [drawn_curve("hertz", 4000 + seed, is_layer=True, noise="white") for seed in range(30)]
    for each in made:
        found = fitted(each, told=False)
        refused += bool(found.refused)
        # a modulus that is wrong by half and more is never given without a word
        silent += not found.refused and abs(found.modulus_pa - each.truth.modulus_pa) > max(
            3.0 * found.modulus_error_pa, 0.5 * each.truth.modulus_pa
        )
    assert refused > 10
    assert silent <= 2


def still(made: MadeCurve, **changed: object) -> CurveFit:
    ways = ways_of(made)
    return fit_curve(ways._replace(**changed), shape_of(made))


def test_what_is_no_contact_is_refused_with_what_was_seen() -> None:
    made = drawn_curve("hertz", 3, noise="white")
    flat = np.random.default_rng(0).normal(0.0, 1e-11, len(made.approach_n))
    assert "does not touch" in still(made, approach_n=flat).refused
    clipped = np.minimum(made.approach_n, np.sort(made.approach_n)[-len(made.approach_n) // 5])
    assert "detector is at its end" in still(made, approach_n=clipped).refused
    assert "valid points" in still(made, approach_m=made.approach_m[:20], approach_n=made.approach_n[:20]).refused
    empty = np.zeros(0)
    without = still(made, retract_m=empty, retract_n=empty)
    assert not without.refused
    assert math.isnan(without.adhesion_n)


def test_an_approach_that_is_pulled_in_is_no_hertz_and_a_contact_without_pull_no_jkr() -> None:
    pulled = drawn_curve("dmt", 2, noise="white")
    ways = MeasuredWays(
        pulled.approach_m, pulled.approach_n, pulled.retract_m, pulled.retract_n, pulled.stiffness_n_per_m
    )
    assert "take dmt or jkr" in fit_curve(ways, shape_of(pulled)._replace(model="hertz")).refused
    free = next(made for seed in range(50) if (made := drawn_curve("hertz", seed)).truth.adhesion_n == 0.0)
    ways = ways_of(free)
    assert "no pull-off" in fit_curve(ways, shape_of(free)._replace(model="jkr")).refused


def test_a_shape_that_lacks_something_is_refused_by_its_name() -> None:
    made = drawn_curve("hertz", 0)
    ways = ways_of(made)
    wrong = {
        "radius_m": ContactShape("hertz"),
        "half_angle_rad": ContactShape("sneddon", 1e-6),
        "model": ContactShape("sphere", 1e-6),
        "poisson": ContactShape("hertz", 1e-6, poisson=0.7),
        "thickness_m": ContactShape("jkr", 1e-6, thickness_m=1e-6),
    }
    for name, shape in wrong.items():
        with pytest.raises(ConfigError, match=name):
            fit_curve(ways, shape)
    with pytest.raises(ConfigError, match="stiffness_n_per_m"):
        fit_curve(ways._replace(stiffness_n_per_m=0.0), shape_of(made))


@pytest.mark.check("computes a curve in Python")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/microscopy/")
def test_jkr_ends_where_no_spring_holds_it_and_pulls_most_with_its_pull_off() -> None:
    contact = Contact(JKR, 1e-6, 0.0, 1e6, 1e6, 1e-8, 0.0)
    base = np.linspace(2e-7, -2e-7, 20_000)
    force, depth = np.empty(len(base)), np.empty(len(base))
    forces(contact, 0.0, base, force, depth)
    assert force[depth > depth.min()].min() == pytest.approx(-1e-8, rel=1e-4, abs=0)
    # a stiff spring follows the contact to where its depth is least: there a^3 = P R / (12 E*), and the depth -3 a^2/R
    least_m = -3.0 / 1e-6 * (1e-8 * 1e-6 / (12.0 * 1e6)) ** (2.0 / 3.0)
    assert depth.min() == pytest.approx(least_m, rel=1e-4, abs=0)


@pytest.mark.check("compiles the steps")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/microscopy/")
@pytest.mark.check("fits 48 curves")
@pytest.mark.parametrize("tilt", [-0.4, -0.1, 0.1, 0.4])
def test_a_zero_line_that_tilts_is_no_adhesion(tilt: float) -> None:
    """The tilt is up to 0.4 of the load over the way, of either sign; half of the curves have no adhesion in truth."""
    within, without = 0, []
    curves = []
    for seed in range(12):
        random = np.random.default_rng([seed, round(1000.0 * (tilt + 1.0))])
        under = drawn_conditions("hertz", random, noise="white")._replace(tilt_share=tilt)
        curves.append(curve_under(under, random, is_layer=False))
    fits = [(made, found) for made in curves if not (found := fitted(made)).refused]
    for made, found in fits:
        apart = abs(found.adhesion_n - made.truth.adhesion_n) / found.adhesion_error_n
        within += apart < 3.0
        without += [found.adhesion_n] if made.truth.adhesion_n == 0.0 else []
    assert len(fits) >= 8
    assert within == len(fits)
    assert without
    assert not any(without)


@pytest.mark.check("fits 200 curves")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/microscopy/")
def test_each_quantity_is_within_its_error_over_tilts_and_models_and_no_tilt_hides_a_pull_off() -> None:
    errors: dict[str, list[float]] = {name: [] for name, _ in QUANTITIES}
    hidden, curves = 0, 0
    for model, tilt, seed in itertools.product(MODELS, (-0.4, -0.1, 0.0, 0.1, 0.4), range(7000, 7010)):
        random = np.random.default_rng([seed, round(1000.0 * (tilt + 1.0))])
        made = curve_under(
            drawn_conditions(model, random, noise="white")._replace(tilt_share=tilt), random, is_layer=False
        )
        found = fitted(made)
        hidden, curves = hidden + ("has no pull-off" in found.refused), curves + 1
        if found.refused:
            continue
        for name, error in QUANTITIES:
            true, seen = getattr(made.truth, name), getattr(found, name)
            if true or seen:
                errors[name].append((seen - true) / getattr(found, error))
    assert hidden <= 0.02 * curves
    for name, apart in errors.items():
        assert np.count_nonzero(np.abs(apart) < 1.96) >= least_of(len(apart), 0.95), name
        # An error that is far too wide covers as well.
        assert np.sqrt(np.mean(np.square(apart))) > 0.6, name


def test_a_contact_of_a_hundredth_of_the_way_is_fitted_near_the_sample() -> None:
    random = np.random.default_rng(3)
    under = drawn_conditions("hertz", random, noise="white")._replace(
        points=4000, free_share=0.985, noise_share=0.004, tilt_share=0.02
    )
    made = curve_under(under, random, is_layer=False)
    found = fitted(made)
    assert found.refused == ""
    assert abs(found.modulus_pa - made.truth.modulus_pa) < 4.0 * found.modulus_error_pa
    assert abs(found.contact_m - made.truth.contact_m) < 4.0 * found.contact_error_m


def test_a_stiff_lever_that_comes_off_without_a_jump_has_its_greatest_pull() -> None:
    random, height = np.random.default_rng(5), np.linspace(-30e-9, 40e-9, 400)
    pushed = np.clip(-height, 0.0, None)
    approach = 1e-8 * (pushed / 30e-9) ** 1.5 + random.normal(0.0, 5e-11, 400)
    pulled = 1e-8 * np.clip(-height / 30e-9, 0.0, None) ** 1.5 - 4e-9 * np.exp(-((height - 3e-9) ** 2) / (4e-9) ** 2)
    found = fit_curve(
        MeasuredWays(height, approach, height, pulled + random.normal(0.0, 5e-11, 400), 1e4),
        ContactShape("hertz", 1e-7),
    )
    assert not found.refused
    assert found.adhesion_n == pytest.approx(4e-9, rel=0.03, abs=0)
