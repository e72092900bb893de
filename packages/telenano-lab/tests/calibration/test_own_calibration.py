"""Calibrations from measurements of one's own: a synthetic lever is found again, within the errors that are stated."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import constants, linalg
from telenano_lab.calibration.own_calibration import (
    AIR_DENSITY_KG_PER_M3,
    AIR_VISCOSITY_PA_S,
    BY_ANGLE,
    Thermal,
    curve_of,
    hydrodynamic,
    sader_n_per_m,
    sensitivity_of_curve,
    spectrum_of,
    stiffness_of_record,
    stiffness_of_spectrum,
)
from telenano_lab.calibration.resonance import density, fit_spectrum, periodogram

from telenano.testing import invoke
from telenano.wire import ConfigError, NoEstimateError

K, F0, Q, RATE, M_PER_V, KELVIN = 2.7, 70e3, 180.0, 1e6, 60e-9, 295.0
KNOWN = Thermal(M_PER_V, KELVIN)


def spectrum(seed: int, averages: int = 50, lines: int = 4000) -> tuple[Any, Any]:
    """Return a thermal spectrum [V^2/Hz] of the lever, averaged, above a floor of 50 fm/sqrt(Hz)."""
    frequency = np.linspace(0.0, 0.5 * RATE, lines + 1)[1:]
    mean_square = BY_ANGLE * constants.k * KELVIN / K
    mean = density(frequency, RATE, mean_square, F0, Q) + (50e-15) ** 2
    random = np.random.default_rng(seed)
    return frequency, mean * random.gamma(averages, 1.0 / averages, lines) / M_PER_V**2


def covered(seeds: int, averages: int, lines: int = 4000) -> tuple[float, float]:
    """Return the share of seeds whose interval of 95 % has the true stiffness in it, and the mean of what was found."""
    known = KNOWN._replace(averages=averages)
    found = [stiffness_of_spectrum(*spectrum(seed, averages, lines), known) for seed in range(seeds)]
    inside = [abs(one.stiffness_n_per_m - K) < 1.96 * one.standard_error_n_per_m for one in found]
    return sum(inside) / seeds, float(np.mean([one.stiffness_n_per_m for one in found])) / K


def test_the_stiffness_of_a_spectrum_is_found_within_its_error() -> None:
    found = stiffness_of_spectrum(*spectrum(1), KNOWN._replace(averages=50, width_m=30e-6, length_m=225e-6))
    assert abs(found.stiffness_n_per_m - K) < 4.0 * found.standard_error_n_per_m
    assert found.standard_error_n_per_m < 0.05 * K
    assert found.resonance_hz == pytest.approx(F0, rel=1e-3)
    assert found.quality == pytest.approx(Q, rel=0.1)
    assert math.sqrt(found.floor_m2_per_hz) == pytest.approx(50e-15, rel=0.05)
    assert found.sader_n_per_m == pytest.approx(sader_n_per_m(30e-6, 225e-6, found.resonance_hz, found.quality))
    share, mean = covered(20, 50)
    assert share >= 0.8
    assert mean == pytest.approx(1.0, abs=0.02)
    # also of one periodogram, whose low points would count for more by their own scatter than its high ones
    share, mean = covered(20, 1, 80_000)
    assert share >= 0.8
    assert mean == pytest.approx(1.0, abs=0.05)


def lever_of(k_n_per_m: float) -> tuple[float, float]:
    """Return width and length [m] of the lever that has this stiffness by Sader's method, with F0 and Q in air."""
    width = 30e-6
    return width, k_n_per_m / sader_n_per_m(width, 1.0, F0, Q)


def test_both_methods_agree_within_their_errors_and_a_wrong_sensitivity_is_told() -> None:
    width, length = lever_of(K)
    known = KNOWN._replace(averages=50, width_m=width, length_m=length)
    found = [stiffness_of_spectrum(*spectrum(seed), known) for seed in range(6)]
    apart = [abs(math.log(one.sader_over_thermal or 0.0)) / (one.sader_over_thermal_error or 0.0) for one in found]
    # the ratio moves from spectrum to spectrum as its error says
    assert 0.5 < float(np.sqrt(np.mean(np.square(apart)))) < 1.5
    agree = "they agree within their errors (not counting that of the sensitivity and of the size: not given)"
    assert sum(agree in (one.agreement or "") for one in found) >= 5
    wrong = known._replace(sensitivity_m_per_v=1.2 * M_PER_V)
    told = stiffness_of_spectrum(*spectrum(0), wrong)
    # the way counts twice, and the stiffness that is too small makes the ratio too great
    assert told.sader_over_thermal == pytest.approx(1.44 * (found[0].sader_over_thermal or 0.0), rel=1e-6)
    assert re.search(r"gives 1\.\d+ ± 0\.\d+ times .*: they differ by \d+\.\d standard errors", told.agreement or "")
    # who knows that much of the sensitivity and the size has no reason to doubt
    unsure = stiffness_of_spectrum(
        *spectrum(0), wrong._replace(sensitivity_error_m_per_v=0.2 * M_PER_V, size_error_m=1e-6)
    )
    assert (unsure.agreement or "").endswith("they agree within their errors")
    assert unsure.standard_error_n_per_m > 0.3 * unsure.stiffness_n_per_m


def segment_lines(window: np.ndarray, q: float, floor: float) -> tuple[Any, Any, Any]:
    """Return the lines of segments with a window, and their mean density, summed over the covariance of its samples."""
    count = len(window)
    omega, dt = 2.0 * math.pi * F0, 1.0 / RATE
    gamma = omega / (2.0 * q)
    swing = math.sqrt(omega**2 - gamma**2)
    t = dt * np.arange(count)
    covariance = np.exp(-gamma * t) * (np.cos(swing * t) + gamma / swing * np.sin(swing * t))
    own = np.array([float(np.sum(window[: count - n] * window[n:])) for n in range(count)])
    frequency = RATE / count * np.arange(1, count // 2 + 1)
    turns = np.cos(2.0 * math.pi * np.outer(frequency, t))
    weighted = own / own[0] * covariance
    mean_square = BY_ANGLE * constants.k * KELVIN / K
    return frequency, 2.0 * dt * mean_square * (2.0 * turns @ weighted - 1.0) + floor, mean_square


@pytest.mark.parametrize("lines", [1.6, 0.7, 0.35])
@pytest.mark.parametrize(
    "window", [np.ones, lambda count: 0.5 - 0.5 * np.cos(2.0 * math.pi * np.arange(count) / count)]
)
def test_a_peak_of_few_lines_gives_the_stiffness_of_its_window(window: Any, lines: float) -> None:
    count = 1024
    quality = F0 * count / RATE / lines
    frequency, mean, mean_square = segment_lines(window(count), quality, 1e-30)
    # over all lines the window leaves the area as it is
    assert RATE / count * float(mean[:-1].sum()) == pytest.approx(mean_square, rel=1e-2)
    found = stiffness_of_spectrum(frequency, mean / M_PER_V**2, KNOWN._replace(averages=50))
    assert found.stiffness_n_per_m == pytest.approx(K, rel=2e-3)
    assert found.quality == pytest.approx(quality, rel=1e-2)
    # the stiffness of noisy ones is right on average
    ks = []
    for seed in range(12):
        noise = np.random.default_rng(seed).gamma(50, 1.0 / 50, len(mean))
        ks.append(
            stiffness_of_spectrum(frequency, mean * noise / M_PER_V**2, KNOWN._replace(averages=50)).stiffness_n_per_m
        )
    assert float(np.mean(ks)) == pytest.approx(K, rel=0.12)


@pytest.mark.check("fits spectra with a tone")
@pytest.mark.drawn(0.35)
@pytest.mark.parametrize("lines", [128, 512])
@pytest.mark.parametrize("times_of_floor", [1e3, 1e4, 1e6])
def test_a_tone_is_no_resonance(times_of_floor: float, lines: int) -> None:
    """Which of three reasons stands against it, rounding decides, and so the processor."""
    frequency = 0.5 * RATE / lines * np.arange(1, lines + 1)
    for place in range(16 * lines // 128, 19 * lines // 128):
        mean = np.where(np.arange(lines) == place, times_of_floor * 1e-27, 1e-27)
        with pytest.raises(NoEstimateError, match=r"no resonance|the fit of Q ends at the end|which is no estimate"):
            stiffness_of_spectrum(frequency, mean / M_PER_V**2, KNOWN)


@pytest.mark.endurance
def test_of_1000_spectra_93_to_97_in_a_hundred_cover_the_stiffness() -> None:
    share, mean = covered(1000, 50)
    assert 0.93 <= share <= 0.97
    assert mean == pytest.approx(1.0, abs=0.005)


def test_a_record_gives_what_its_spectrum_gives() -> None:
    random, count = np.random.default_rng(3), 1 << 17
    # a spring in white noise, its place and speed stepped exactly (x in its own rms, speed in that of its own)
    omega, gamma = 2.0 * math.pi * F0, math.pi * F0 / Q
    step = linalg.expm(np.array([[0.0, omega], [-omega, -2.0 * gamma]]) / RATE)
    root = np.linalg.cholesky(np.eye(2) - step @ step.T)
    pushes = random.standard_normal((count, 2)) @ root.T
    (a, b), (c, d) = step.tolist()
    x, v, course = 0.0, 0.0, np.empty(count)
    for i, (of_place, of_speed) in enumerate(pushes.tolist()):
        x, v = a * x + b * v + of_place, c * x + d * v + of_speed
        course[i] = x
    course *= math.sqrt(BY_ANGLE * constants.k * KELVIN / K / np.mean(course**2))
    found = stiffness_of_record(course / M_PER_V, KNOWN._replace(rate_hz=RATE))
    assert found.stiffness_n_per_m == pytest.approx(K, rel=0.05)
    assert found.resonance_hz == pytest.approx(F0, rel=2e-3)
    with pytest.raises(ConfigError, match="--rate: a record needs the rate"):
        stiffness_of_record(course, KNOWN)


def test_the_hydrodynamic_function_has_its_limits() -> None:
    # in a thin fluid the beam drags along what a plate does, and nothing is lost; both grow as the fluid thickens
    assert hydrodynamic(1e4).real == pytest.approx(1.0, abs=0.05)
    assert hydrodynamic(1e4).imag < 0.05
    for part in ("real", "imag"):
        values = [getattr(hydrodynamic(10.0**power), part) for power in range(-4, 5)]
        assert values == sorted(values, reverse=True)
    with pytest.raises(ConfigError, match="Reynolds number of 100000 is outside"):
        hydrodynamic(1e5)
    # four times as wide a lever at the same k, f0 and length has another Q: the formula is that of the paper
    omega, width, length = 2.0 * math.pi * F0, 30e-6, 225e-6
    reynolds = AIR_DENSITY_KG_PER_M3 * omega * width**2 / (4.0 * AIR_VISCOSITY_PA_S)
    expected = 0.1906 * AIR_DENSITY_KG_PER_M3 * width**2 * length * Q * hydrodynamic(reynolds).imag * omega**2
    assert sader_n_per_m(width, length, F0, Q) == pytest.approx(expected, rel=1e-12)


def curve(seed: int, sign: float = 1.0) -> tuple[Any, Any]:
    """Return way [m] and voltage of a lever of 60 nm/V that meets a hard sample after 200 nm, with noise of 5 mV."""
    way = np.linspace(0.0, 400e-9, 400)
    volts = sign * np.maximum(way - 200e-9, 0.0) / M_PER_V
    return way, volts + 0.005 * np.random.default_rng(seed).standard_normal(400) + 0.3


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sensitivity_of_a_curve_is_found_and_its_interval_covers_it(sign: float) -> None:
    found = [sensitivity_of_curve(*curve(seed, sign)) for seed in range(1000)]
    inside = [abs(one.m_per_v - M_PER_V) < 1.96 * one.standard_error_m_per_v for one in found]
    assert 0.93 <= sum(inside) / 1000 <= 0.97
    assert np.mean([one.m_per_v for one in found]) == pytest.approx(M_PER_V, rel=1e-3)


def test_what_is_no_curve_and_no_spectrum_is_refused(tmp_path: Path) -> None:
    way = np.linspace(0.0, 1e-7, 200)
    noise = np.random.default_rng(0).standard_normal(200)
    with pytest.raises(ConfigError, match=r"not a curve on a hard sample|points lie between"):
        sensitivity_of_curve(way, noise)
    with pytest.raises(ConfigError, match=r"points lie between 0\.3 and 0\.95"):
        sensitivity_of_curve(way, np.zeros(200))
    with pytest.raises(ConfigError, match="frequencies that rise"):
        stiffness_of_spectrum(np.array([1.0, 0.5, 2.0]), np.ones(3), KNOWN)
    frequency, power = spectrum(1)
    for metre in (M_PER_V, 1e12 * M_PER_V):  # densities in m^2/Hz and in pm^2/Hz
        with pytest.raises(
            ConfigError, match=r"no cantilever has a stiffness of .* N/m: check the unit of the density"
        ):
            stiffness_of_spectrum(frequency, power * metre**2, KNOWN._replace(averages=50))
    file = tmp_path / "s.txt"
    file.write_text("Hz;V2/Hz\n" + "".join(f"{n};1e-9\n" for n in range(20)) + "20;loud\n")
    with pytest.raises(ConfigError, match=r"s\.txt, line 22: 'loud' is not a number"):
        spectrum_of(file)
    file.write_text("1;2\n")
    with pytest.raises(ConfigError, match="has 1 lines of 2 columns, 16 or more"):
        curve_of(file)


def test_the_commands_read_files_of_ones_own(tmp_path: Path) -> None:
    frequency, power = spectrum(1)
    np.savetxt(tmp_path / "thermal.txt", np.column_stack([frequency, power]), header="Hz V^2/Hz")
    np.savetxt(tmp_path / "curve.csv", np.column_stack([1e9 * curve(1)[0], curve(1)[1]]), delimiter=",")
    found = invoke(["calibrate", "sensitivity", "--curve", str(tmp_path / "curve.csv"), "--json"])
    sensitivity = json.loads(found.stdout)
    assert sensitivity["sensitivity_nm_per_v"] == pytest.approx(60.0, rel=2e-3)
    own = ["calibrate", "stiffness", "--spectrum", str(tmp_path / "thermal.txt"), "--temperature", "295", "--json"]
    found = invoke([*own, "--sensitivity", "60", "--averages", "50", "--size", "30e3", "225e3"])
    assert json.loads(found.stdout)["stiffness_n_per_m"] == pytest.approx(K, rel=0.06)
    refused = invoke(own)
    assert refused.exit_code == 2
    assert "--sensitivity: a measurement in volts needs" in json.loads(refused.stdout)["error"]


UNITS = {
    "V^2/Hz": 1.0, "V²/Hz": 1.0, "V**2/Hz": 1.0, "mV^2/Hz": 1e6, "V/sqrt(Hz)": 0.5, "V/√Hz": 0.5, "V/Hz^0.5": 0.5,
    "V/rtHz": 0.5, "m^2/Hz": M_PER_V**2, "pm^2/Hz": 1e24 * M_PER_V**2, "V/Hz": None, "V": None, "": None,
}  # fmt: skip


@pytest.mark.parametrize("where", ["head", "option"])
@pytest.mark.parametrize("unit", UNITS)
def test_a_spectrum_is_read_in_its_unit_or_asked_for_it(unit: str, where: str, tmp_path: Path) -> None:
    frequency, power = spectrum(1)
    factor = UNITS[unit]
    density = np.sqrt(power) if factor == 0.5 else power * (factor or 1.0)
    path = tmp_path / "thermal.txt"
    np.savetxt(path, np.column_stack([frequency, density]), header=f"Hz {unit}" if where == "head" else "f PSD")
    words = ["calibrate", "stiffness", "--spectrum", str(path), "--temperature", "295", "--averages", "50", "--json"]
    words += [] if unit.endswith("m^2/Hz") else ["--sensitivity", "60"]
    found = invoke([*words, *(["--unit", unit] if where == "option" else [])])
    if factor is None:
        assert found.exit_code == 2 and "--unit" in json.loads(found.stdout)["error"]
        assert "V^2/Hz, V/sqrt(Hz), m^2/Hz, m/sqrt(Hz)" in json.loads(found.stdout)["error"]
    else:
        assert json.loads(found.stdout)["stiffness_n_per_m"] == pytest.approx(K, rel=0.06)


def test_a_stiffness_far_from_what_the_size_allows_is_said_to_be() -> None:
    width, length = lever_of(K)
    known = KNOWN._replace(averages=50, width_m=width, length_m=length, sensitivity_m_per_v=10.0 * M_PER_V)
    found = stiffness_of_spectrum(*spectrum(0), known)
    assert "a lever of this size cannot have it: the unit of the density" in (found.agreement or "")


def test_a_resonance_that_is_not_in_the_record_is_refused_with_the_bound() -> None:
    walk = np.cumsum(np.random.default_rng(0).standard_normal(20_000))
    with pytest.raises(ValueError, match=r"the fit of (the resonance|Q) ends at the end of its range"):
        fit_spectrum(*periodogram(walk, 8e3), 8e3, [(float(np.var(walk)), 1e3, 20.0)])


def test_a_lever_without_a_peak_is_found_or_refused_with_what_would_tell(tmp_path: Path) -> None:
    """In water at Q = 0.7 the density has no maximum: a bump of its scatter is no resonance."""
    k, f0, m_per_v = 0.05, 4e3, 50e-9
    frequency = 20.0 * np.arange(1.0, 2500.0)
    x = frequency / f0
    square = BY_ANGLE * constants.k * 300.0 / k
    mean = 2.0 * square / (math.pi * f0 * 0.7 * ((1.0 - x**2) ** 2 + (x / 0.7) ** 2)) + 1e-27
    for seed in range(5):
        noisy = mean * np.random.default_rng(seed).gamma(50, 1.0 / 50, len(x)) / m_per_v**2
        found = stiffness_of_spectrum(frequency, noisy, Thermal(m_per_v, 300.0, averages=50))
        assert found.stiffness_n_per_m == pytest.approx(k, abs=4.0 * found.standard_error_n_per_m)
        assert found.standard_error_n_per_m < 0.05 * k
    path = tmp_path / "flank.txt"
    flank = slice(0, 30)
    rows = zip(frequency[flank].tolist(), (noisy[flank]).tolist(), strict=True)
    path.write_text("frequency [Hz]\tdensity [V^2/Hz]\n" + "".join(f"{f}\t{v:.6e}\n" for f, v in rows))
    options = ["--spectrum", str(path), "--sensitivity", "50", "--averages", "50"]
    refused = invoke(["calibrate", "stiffness", *options])
    assert refused.exit_code == 3
    assert "What helps" in refused.stderr


def test_lines_that_begin_above_a_first_mode_say_that_it_may_be_the_second() -> None:
    frequency, power = spectrum(0)
    above = frequency > 0.4 * F0
    found = stiffness_of_spectrum(frequency[above], power[above], KNOWN._replace(averages=50))
    assert any("may be the second mode" in one for one in found.remarks)


def test_the_density_as_sampled_has_the_whole_mean_square_at_any_rate() -> None:
    for rate_hz, quality in ((8e3, 20.0), (3e3, 5.0), (2.5e3, 1.0), (64e3, 100.0)):
        # over a whole turn of the sampling
        lines = (np.arange(200_000) + 0.5) / 200_000 * 0.5 * rate_hz
        found = density(lines, rate_hz, 2.0, 1e3, quality)
        assert found.mean() * 0.5 * rate_hz == pytest.approx(2.0, rel=1e-4)
        assert (found > 0.0).all()


LEVERS = {"stiff": (2.0, 70e3, 150.0), "soft": (0.02, 20e3, 40.0), "fast": (30.0, 900e3, 300.0)}


def written(path: Path, head: str, unit_hz: float, unit_density: float, lever: str = "stiff", mark: str = "\t") -> None:
    """Write a spectrum of a lever, by the textbook's density, in these units; root densities have unit_density < 0."""
    k, f0, q = LEVERS[lever]
    frequency = f0 / q / 20.0 * np.arange(1, 12_000)
    x = frequency / f0
    square = BY_ANGLE * constants.k * 300.0 / k
    mean = 2.0 * square / (math.pi * f0 * q * ((1.0 - x**2) ** 2 + (x / q) ** 2)) / 50e-9**2
    density = mean * np.random.default_rng(1).gamma(50, 1.0 / 50, len(mean))
    density = np.sqrt(density) / -unit_density if unit_density < 0.0 else density / unit_density
    lines = "".join(f"{f / unit_hz:.9f}{mark}{v:.9e}\n" for f, v in zip(frequency, density, strict=True))
    path.write_text(f"{head}\n{lines.replace('.', ',') if mark == ';' else lines}", encoding="utf-8")


HEADS = {
    "kHz": ("frequency [kHz]\tdensity [V^2/Hz]", 1e3, 1.0),
    "MHz": ("f (MHz)\tPSD (mV²/Hz)", 1e6, 1e-6),
    "mHz": ("f / mHz\tPSD / V/√Hz", 1e-3, -1.0),
    "two lines": ("Frequency\tNoise\nkHz\tuV/sqrt(Hz)", 1e3, -1e-6),
    "micro": ("Frequency (kHz)\tASD (\u03bcV/√Hz)", 1e3, -1e-6),
    "micro sign": ("Frequency (kHz)\tASD (\u00b5V per sqrt(Hz))", 1e3, -1e-6),
    "comment": ("# taken in air, frequency in kHz, density in V^2/Hz", 1e3, 1.0),
}


@pytest.mark.parametrize("lever", LEVERS)
@pytest.mark.parametrize("head", HEADS)
def test_the_head_gives_the_unit_of_each_column_of_a_spectrum(head: str, lever: str, tmp_path: Path) -> None:
    written(tmp_path / "s.txt", *HEADS[head], lever)
    words = ["--sensitivity", "50", "--averages", "50", "--json"]
    found = invoke(["calibrate", "stiffness", "--spectrum", str(tmp_path / "s.txt"), *words])
    k, f0, _ = LEVERS[lever]
    assert json.loads(found.stdout)["stiffness_n_per_m"] == pytest.approx(k, rel=0.08)
    assert json.loads(found.stdout)["resonance_hz"] == pytest.approx(f0, rel=0.01)


def test_a_decimal_comma_gives_what_a_point_gives(tmp_path: Path) -> None:
    answers = []
    for mark in ("\t", ";"):
        written(tmp_path / "s.txt", f"f [kHz]{mark}PSD [V^2/Hz]", 1e3, 1.0, mark=mark)
        words = ["calibrate", "stiffness", "--spectrum", str(tmp_path / "s.txt"), "--sensitivity", "50", "--json"]
        answers.append(json.loads(invoke(words).stdout)["stiffness_n_per_m"])
    assert answers[0] == answers[1]


@pytest.mark.parametrize(
    ("head", "asked"),
    [
        ("frequency [furlong]\tdensity [V^2/Hz]", "line 1: the unit 'furlong' of 'frequency [furlong]'"),
        ("frequency [mhz]\tdensity [V^2/Hz]", "line 1: the unit 'mhz'"),
        ("frequency [s]\tdensity [V^2/Hz]", "of another kind than Hz"),
        ("frequency [Hz]\tdensity [dB]", "line 1: the unit 'dB' of 'density [dB]' is that of no density"),
        ("frequency\tdensity [V^2/Hz]", "is the frequency in kHz? Give --frequency-unit kHz"),
        ("frequency [Hz]\tdensity [V^2/Hz]", "is the frequency in kHz?"),
    ],
)
def test_a_unit_that_is_not_known_or_not_likely_is_asked_for(head: str, asked: str, tmp_path: Path) -> None:
    for lever in LEVERS:
        if "Hz?" in asked and LEVERS[lever][1] > 5e5:
            continue
        written(tmp_path / "s.txt", head, 1e3, 1.0, lever)
        words = ["calibrate", "stiffness", "--spectrum", str(tmp_path / "s.txt"), "--sensitivity", "50", "--json"]
        found = invoke(words)
        assert found.exit_code == 2
        assert asked in json.loads(found.stdout)["error"]
        if "kHz" in asked:
            found = invoke([*words, "--frequency-unit", "kHz"])
            assert json.loads(found.stdout)["stiffness_n_per_m"] == pytest.approx(LEVERS[lever][0], rel=0.08)


WAYS = {
    "z [µm]\tdeflection [mV]": (1e-6, 1e-3),
    "z [m]\tdeflection [V]": (1.0, 1.0),
    "Z rel (m)\tDeflection (V)": (1.0, 1.0),
    "piezo / nm\tVertical Deflection / V": (1e-9, 1.0),
    "deflection [µV]\theight [Å]": (1e-10, 1e-6),
    "way\tvolts": (1e-9, 1.0),
}


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("head", WAYS)
def test_the_head_gives_the_unit_of_way_and_deflection(head: str, comma: bool, tmp_path: Path) -> None:
    way, volts = curve(3)
    unit_m, unit_v = WAYS[head]
    columns = [way / unit_m, volts / unit_v]
    text = "".join(f"{a:.9e}\t{b:.9e}\n" for a, b in zip(*columns[:: -1 if head.startswith("d") else 1], strict=True))
    (tmp_path / "c.txt").write_text(f"{head}\n{text.replace('.', ',') if comma else text}", encoding="utf-8")
    found = invoke(["calibrate", "sensitivity", "--curve", str(tmp_path / "c.txt"), "--json"])
    assert json.loads(found.stdout)["sensitivity_nm_per_v"] == pytest.approx(60.0, rel=5e-3)


@pytest.mark.parametrize("unit", ["m", "um", "mm"])
def test_a_way_without_a_unit_that_none_has_in_nanometres_is_asked_for(unit: str, tmp_path: Path) -> None:
    way, volts = curve(3)
    scale = {"m": 1.0, "um": 1e-6, "mm": 1e-3}[unit]
    np.savetxt(tmp_path / "c.txt", np.column_stack([way / scale, volts]))
    words = ["calibrate", "sensitivity", "--curve", str(tmp_path / "c.txt"), "--json"]
    found = invoke(words)
    assert found.exit_code == 2 and "Give --way-unit" in json.loads(found.stdout)["error"]
    found = invoke([*words, "--way-unit", unit])
    assert json.loads(found.stdout)["sensitivity_nm_per_v"] == pytest.approx(60.0, rel=5e-3)


def test_a_bent_line_of_contact_is_no_hard_sample() -> None:
    way = np.linspace(0.0, 400e-9, 400)
    for power in (1.5, 2.0):
        volts = 5.0 * np.maximum(way / 200e-9 - 1.0, 0.0) ** power
        with pytest.raises(ConfigError, match="the line of contact is bent"):
            sensitivity_of_curve(way, volts + 0.005 * np.random.default_rng(2).standard_normal(400))


def test_columns_are_chosen_by_number_or_title(tmp_path: Path) -> None:
    path = tmp_path / "hard.txt"
    way = np.linspace(0.0, 400.0, 300)
    volts = np.maximum(way - 100.0, 0.0) / 50.0
    rows = "".join(f"{n};{1.5 * n};{b:.6f};{a:.6f}\n" for n, (a, b) in enumerate(zip(way, volts, strict=True)))
    for head, columns in (("", ("4", "3")), ("a;b;c;d\n", ("d", "c"))):
        path.write_text(head + rows, encoding="utf-8")
        done = invoke(["calibrate", "sensitivity", "--curve", str(path), "--columns", *columns, "--json"])
        assert done.exit_code == 0, done.output
        assert json.loads(done.stdout)["sensitivity_nm_per_v"] == pytest.approx(50.0, rel=1e-3)
    done = invoke(["calibrate", "sensitivity", "--curve", str(path), "--columns", "4", "9"])
    assert "has no column '9'; it has 4, a, b, c, d" in " ".join(done.output.split())


def test_a_record_in_another_unit_is_refused_with_the_option_of_its_command(tmp_path: Path) -> None:
    path = tmp_path / "record.txt"
    path.write_text("deflection [furlong]\n" + "1.0\n2.0\n" * 200, encoding="utf-8")
    words = ["calibrate", "stiffness", "--record", str(path), "--rate", "1e6", "--sensitivity", "50"]
    assert "--unit gives another" in " ".join(invoke(words).output.split())
