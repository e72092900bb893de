"""Each estimator of the page fit.md refuses, or says, what does not fit: one table of what each of them is given."""

import importlib
import math
import re
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

from telenano.sections.afm_section import AfmConfig
from telenano.wire.errors import TelenanoError

PAGE = Path(__file__).resolve().parents[2] / "packages" / "telenano-devices" / "docs" / "fit.md"


def _function(name: str) -> Callable[..., object]:
    module, _, attribute = name.partition(":")
    return attrgetter(attribute)(importlib.import_module(module))  # type: ignore[no-any-return]


def _thermal(width_m: float) -> object:
    own = importlib.import_module("telenano_lab.calibration.own_calibration")
    frequency = 20.0 * np.arange(1, 12_000)
    x = frequency / 70e3
    mean = 1e-30 + 2.0 * 1.7e-21 / (math.pi * 70e3 * 150.0 * ((1.0 - x**2) ** 2 + (x / 150.0) ** 2))
    density = mean * np.random.default_rng(1).gamma(100, 0.01, len(mean))
    known = own.Thermal(1.0, 300.0, 1.0, width_m, 225e-6, averages=100.0)
    return own.stiffness_of_spectrum(frequency, density, known)


def sader() -> None:
    raise TelenanoError(str(_thermal(width_m=300e-6).agreement))  # type: ignore[attr-defined]


def sensitivity() -> None:
    way = np.linspace(0.0, 400e-9, 400)
    _function("telenano_lab.calibration.own_calibration:sensitivity_of_curve")(way, (way / 1e-7) ** 2)


def line() -> None:
    counts = [0.0, 1.0, 2.5, 3.0]
    _function("telenano_devices.line_fit:fit_line")("load cell", counts, [1e-3] * 4, [0.0, 1.0, 2.0, 3.0])


def adhesion() -> None:
    force_curve = _function("telenano_lab.microscopy.force_curve:force_curve")
    config = AfmConfig.model_validate({"cantilever": {"stiffness_n_per_m": 8.0}})
    curve = force_curve(config, 20e-9, 20e-9)
    half = curve.retract  # type: ignore[attr-defined]
    pushed = replace(half, force_n=np.abs(half.force_n) + 1e-9)
    _function("telenano_lab.microscopy.adhesion_fit:fit_adhesion")(replace(curve, retract=pushed), config)  # type: ignore[type-var]


def curve() -> None:
    made = importlib.import_module("telenano_lab.doubles.made_curves").drawn_curve("dmt", 2, noise="white")
    fits = importlib.import_module("telenano_lab.microscopy.curve_fit")
    ways = fits.MeasuredWays(
        made.approach_m, made.approach_n, made.retract_m, made.retract_n, made.stiffness_n_per_m
    )  # fmt: skip
    shape = fits.ContactShape("hertz", made.radius_m, poisson=made.poisson)
    raise TelenanoError(_function("telenano_lab.microscopy.curve_fit:fit_curve")(ways, shape).refused)  # type: ignore[attr-defined]


def felt() -> None:
    fits = importlib.import_module("telenano.analysis.felt_stiffness")
    time_s = np.arange(0.0, 10.0, 0.05)
    draw = np.random.default_rng(1)
    tip = np.stack([time_s, 1e-9 * np.sin(time_s), 2e-8 * np.sin(time_s)])
    # The hand swings, and its force swings at another frequency.
    hand = np.stack(
        [time_s, 1e-3 * np.sin(3.0 * time_s), np.cos(5.0 * time_s) + 0.1 * draw.standard_normal(len(time_s))]
    )
    raise TelenanoError(
        str(_function("telenano.analysis.felt_stiffness:felt_over")(hand, tip, 100.0, fits.SampleFacts()))
    )


def psychometric() -> None:
    model = importlib.import_module("telenano_lab.experiments.psychophysics.function").Psychometric()
    found = _function("telenano_lab.experiments.psychophysics.fit:fit")([(float(n), True) for n in range(20)], model)
    raise TelenanoError(f"threshold {found.threshold}, low {found.low}, high {found.high}")  # type: ignore[attr-defined]


def phase() -> None:
    draw = np.random.default_rng(1)
    amplitude = 0.5 + 0.01 * draw.random(4000)
    _function("telenano_lab.afm_files.amplitude_phase:amplitude_phase")(amplitude, 120.0 + draw.standard_normal(4000))


def particle() -> None:
    find = importlib.import_module("telenano_lab.assembly.find")
    shape = importlib.import_module("telenano_lab.assembly.particles.tip_shape")
    step_m = 62.5e-9
    x, y = np.meshgrid(step_m * np.arange(-24, 24), step_m * np.arange(-24, 24))
    # a block with a flat top and upright sides
    block = np.where((np.abs(x) < 8e-7) & (np.abs(y) < 3e-7), 400e-9, 0.0)
    noise = np.random.default_rng(1).normal(0.0, 1e-9, block.shape)
    found = find.find_particles(block + noise, step_m, step_m, shape.tip_shape(10e-9, 0.26))
    raise TelenanoError(f"clusters {[one.is_cluster for one in found]}")


def delay() -> None:
    log = importlib.import_module("telenano_lab.networks.line_log")
    draw = np.random.default_rng(1)
    t = 0.1 * np.arange(6000)
    # half of the messages are lost for half a minute, now and then
    faded = (t % 150.0 > 60.0) & (t % 150.0 < 90.0)
    delay_s = np.where(faded & (draw.random(6000) < 0.5), np.nan, 0.03 + draw.gamma(2.0, 0.002, 6000))
    table = _function("telenano_lab.networks.line_fit:accept")(log.LineLog((log.Segment(t, delay_s),), round_trip=True))
    raise TelenanoError(f"apart in {[row.what for row in table if not row.agrees]}")  # type: ignore[attr-defined]


def clocks() -> None:
    draw = np.random.default_rng(1)
    bound = [(n * 10**9, int(draw.exponential(1e6))) for n in range(1, 60)]
    below = [(n * 10**9, -int(draw.exponential(1e6))) for n in range(1, 60)]
    raise TelenanoError(f"drift {_function('telenano.timing.clock_fit:ClockLine.through')(bound, below).drift}")  # type: ignore[attr-defined]


# what is refused or said of what does not fit, by the name in the table of the page
ESTIMATORS: dict[str, tuple[Callable[[], None], str]] = {
    "stiffness by Sader's method": (sader, "a lever of this size cannot have it"),
    "sensitivity by a curve": (sensitivity, "the line of contact is bent"),
    "handle and stage": (line, "of the span off the line"),
    "radius and work of adhesion": (adhesion, "points in contact before a pull-off"),
    "contact point, modulus, adhesion": (curve, "the approach is pulled in"),
    "psychometric function": (psychometric, "threshold None, low None, high None"),
    "loss of a tapping contact by phase and amplitude": (phase, "1 spans of"),
    "place and radius of a particle in an image": (particle, "clusters .*True"),
    "stiffness that the hand feels": (felt, "moved otherwise than its force says"),
    "delay of a line": (delay, "apart in .*10-s windows"),
    "clocks of two sites": (clocks, r"drift 0\.0"),
}


def listed() -> dict[str, str]:
    part = PAGE.read_text(encoding="utf-8").partition("## When an estimate is refused")[2].partition("\n## ")[0]
    return {row[0]: row[1] for row in re.findall(r"^\| ([^|]+) \| `([^`]+)` \|", part, re.MULTILINE)}


# What fits or solves a set of equations, wherever a module calls it.
_FITS = re.compile(
    r"\b(?:curve_fit|least_squares|lstsq|polyfit|polynomial\.fit|minimize(?:_scalar)?|linregress|theilslopes|siegelslopes|"
    r"nnls|odr|differential_evolution|brentq|root_scalar|fsolve|regressed|linalg\.solve|linalg\.pinv|lsq_linear|chdtri)\(",
    re.IGNORECASE,
)
# Modules with such a call that is part of an estimate of the table: its name there.
_PARTS = {
    "packages/telenano-lab/telenano_lab/calibration/resonance.py": "stiffness by thermal noise",
    "packages/telenano-devices/telenano_devices/line_fit.py": "handle and stage",
    "packages/telenano-lab/telenano_lab/networks/line_fit.py": "delay of a line",
}
# Modules with such a call that estimates nothing from a measurement, with the reason.
_NO_ESTIMATE = {
    "packages/telenano-lab/telenano_lab/experiments/effect_sizes.py": "the bound of an interval, of a known law",
    "packages/telenano-lab/telenano_lab/studies/loops/theory.py": "the crossing of a gain that a formula gives",
    "packages/telenano-lab/telenano_lab/studies/loops/tuning.py": "the damping that meets a wanted margin",
}


def test_each_module_that_fits_is_in_the_table_or_says_why_not() -> None:
    root = Path(__file__).resolve().parents[2]
    folders = ("services", "telenano", "packages/*/telenano_*")
    found = {
        str(path.relative_to(root))
        for folder in folders
        for whole in root.glob(folder)
        for path in whole.rglob("*.py")
        if _FITS.search(path.read_text(encoding="utf-8"))
    }
    modules = {name.partition(":")[0].replace(".", "/") + ".py" for name in listed().values()}
    of_table = {path for path in found if any(path.endswith(module) for module in modules)}
    assert set(_PARTS.values()) <= set(listed())
    assert found - of_table - set(_PARTS) - set(_NO_ESTIMATE) == set()
    # neither list keeps a module that fits nothing any more
    assert set(_PARTS) | set(_NO_ESTIMATE) <= found


def test_the_page_lists_each_estimator_and_each_is_there() -> None:
    assert set(listed()) == {"stiffness by thermal noise", *ESTIMATORS}
    for name in listed().values():
        assert callable(_function(name)), name


@pytest.mark.check("fits by the estimators of the packages")
@pytest.mark.parametrize("name", ESTIMATORS)
def test_what_does_not_fit_is_refused_or_said(name: str) -> None:
    run, reason = ESTIMATORS[name]
    with pytest.raises(TelenanoError, match=reason):
        run()


@pytest.mark.check("takes 0.6 s")
@pytest.mark.parametrize("seed", range(3))
def test_a_spectrum_that_is_no_resonance_is_refused_and_a_tone_is_left_out(seed: int) -> None:
    own = importlib.import_module("telenano_lab.calibration.own_calibration")
    draw = np.random.default_rng(seed)
    frequency = 20.0 * np.arange(1, 12_000)
    known = own.Thermal(1.0, 300.0, 1.0, averages=100.0)
    # a peak with the flanks of no spring
    flanks = 1e-28 / (1.0 + np.abs(frequency / 70e3 - 1.0) / 0.003) ** 1.2
    with pytest.raises(TelenanoError):
        own.stiffness_of_spectrum(frequency, (flanks + 1e-31) * draw.gamma(100, 0.01, len(frequency)), known)
    x = frequency / 70e3
    mean = 2.0 * 1.7e-21 / (math.pi * 70e3 * 150.0 * ((1.0 - x**2) ** 2 + (x / 150.0) ** 2)) + 1e-30
    density = mean * draw.gamma(100, 0.01, len(frequency))
    density[int(draw.integers(2700, 4500))] += 0.3 * 1.7e-21 / 20.0
    found = own.stiffness_of_spectrum(frequency, density, known)
    assert found.lines_left_out >= 1
    assert found.stiffness_n_per_m == pytest.approx(1.380649e-23 * 300.0 / 1.7e-21, rel=0.06)
