"""Spectra in the normalisations of the world's tools: what a file determines is found, what it leaves open refused."""

from pathlib import Path

import numpy as np
import pytest
from foreign_spectra import DETERMINED, UNDETERMINED, Form, Outcome, outcome
from telenano_lab.calibration.own_calibration import spectrum_of
from telenano_lab.calibration.spectrum_forms import Form as Meaning
from telenano_lab.calibration.spectrum_forms import NoReference, form_of, power_of

from telenano.testing import invoke
from telenano.wire import ConfigError

FEW = 3


def outcomes(form: Form, seeds: range, folder: Path) -> list[Outcome]:
    return [outcome(form, seed, folder) for seed in seeds]


@pytest.mark.check("fits 63 spectra")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/calibration/")
@pytest.mark.parametrize("form", DETERMINED, ids=lambda form: form.__name__)
def test_what_a_file_determines_is_not_accepted_wrongly(form: Form, tmp_path: Path) -> None:
    found = outcomes(form, range(FEW), tmp_path)
    assert not any(one.is_wrong for one in found)
    assert sum(one.share is None for one in found) <= 1


@pytest.mark.check("reads 27 spectra")
@pytest.mark.parametrize("form", UNDETERMINED, ids=lambda form: form.__name__)
def test_what_a_file_leaves_open_is_refused_with_what_to_do(form: Form, tmp_path: Path) -> None:
    for one in outcomes(form, range(FEW), tmp_path):
        assert one.share is None
        assert "--" in one.reason or "give" in one.reason.lower() or "Export" in one.reason


@pytest.mark.endurance
@pytest.mark.parametrize("form", DETERMINED, ids=lambda form: form.__name__)
def test_of_200_spectra_of_a_form_none_is_taken_for_another_and_few_are_refused(form: Form, tmp_path: Path) -> None:
    found = outcomes(form, range(1000, 1200), tmp_path)
    taken = [one for one in found if one.errors is not None]
    # A normalisation that is taken for another is a factor of the root of two at least.
    assert not any(one.is_wrong and abs(one.share or 0.0) > 0.25 for one in found)
    # Beyond four of its errors is one in two hundred at most, by the noise.
    assert sum(one.is_wrong for one in found) <= 1
    assert len(taken) >= 0.85 * len(found)
    # 93 to 97 %, and three times what chance makes of so few
    assert sum(abs(one.errors or 0.0) < 2.0 for one in taken) >= 0.89 * len(taken)


@pytest.mark.endurance
@pytest.mark.parametrize("form", UNDETERMINED, ids=lambda form: form.__name__)
def test_of_200_spectra_of_an_open_form_none_is_taken(form: Form, tmp_path: Path) -> None:
    assert all(one.share is None for one in outcomes(form, range(1000, 1200), tmp_path))


# a unit, a value in it, and the power of 1 Hz or of a line in V^2 or m^2 that it is
POWERS = [
    ("V^2/Hz", 2.0, 2.0), ("mV^2/Hz", 2.0, 2e-6), ("V/√Hz", 3.0, 9.0), ("Vrms/sqrt(Hz)", 3.0, 9.0),
    ("Vpk/√Hz", 2.0, 2.0), ("V peak/rtHz", 2.0, 2.0), ("Vpp/√Hz", 4.0, 2.0), ("pm/√Hz", 2.0, 4e-24),
    ("V^2", 5.0, 5.0), ("Vrms", 3.0, 9.0), ("Vpk^2", 4.0, 2.0), ("V^2 rms", 4.0, 4.0), ("dBV/√Hz", -20.0, 0.01),
    ("dB re 1 V^2/Hz", -20.0, 0.01), ("dB(V²/Hz)", 10.0, 10.0), ("dBmV/√Hz", 60.0, 1.0),
    ("dB re 1 uV/√Hz", 120.0, 1.0), ("dBVpk/√Hz", 0.0, 0.5), ("dBV", -10.0, 0.1),
]  # fmt: skip


@pytest.mark.parametrize(("word", "value", "power"), POWERS)
def test_a_unit_says_which_power_a_value_is(word: str, value: float, power: float) -> None:
    form = form_of(word)
    assert isinstance(form, Meaning)
    assert float(power_of(np.array([value]), form, "t")[0]) == pytest.approx(power, rel=1e-9)
    assert form.per_line == ("Hz" not in word)


@pytest.mark.parametrize("word", ["dB", "dB/Hz", "dBFS", "dBFS/Hz", "dBc/Hz", "dBm/Hz", "dBm", "dB re FS"])
def test_decibels_without_a_reference_say_none(word: str) -> None:
    assert isinstance(form_of(word), NoReference)


@pytest.mark.parametrize("word", ["", "a.u.", "V/Hz", "counts", "N", "rad/s"])
def test_a_unit_of_something_else_is_that_of_no_spectrum(word: str) -> None:
    assert form_of(word) is None


def test_a_milliwatt_is_in_a_resistance() -> None:
    form = form_of("dBm/Hz", "input 50 Ohm")
    assert isinstance(form, Meaning)
    assert float(power_of(np.array([0.0]), form, "t")[0]) == pytest.approx(0.05)


def made(folder: Path, head: str, values: float = 1e-9) -> Path:
    path = folder / "s.txt"
    rows = "".join(f"{10.0 * n}\t{values * (1.0 + 0.1 * (n % 7))}\n" for n in range(1, 64))
    path.write_text(f"{head}\n{rows}", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("head", "factor"),
    [
        ("f [Hz]\tPSD [V^2/Hz]", 1.0),
        ("# double-sided spectrum\nf [Hz]\tPSD [V^2/Hz]", 2.0),
        # tape is no spectrum
        ("# mica on double-sided tape\nf [Hz]\tPSD [V^2/Hz]", 1.0),
        ("# Windows 10, two-sided tape\nf [Hz]\tPSD [V^2/Hz]", 1.0),
        ("# ENBW = 4 Hz\nf [Hz]\tPower [V^2]", 0.25),
        ("# window: Hanning\nf [Hz]\tPower [V^2]", 1.0 / 15.0),
        ("f [Hz]\tPeak noise [V^2/Hz]", 0.5),
    ],
)
def test_the_head_says_sides_bandwidth_and_peaks(head: str, factor: float, tmp_path: Path) -> None:
    found = spectrum_of(made(tmp_path, head))
    assert found.density_per_hz[6] == pytest.approx(factor * 1e-9, rel=1e-6)
    assert any("--sides" in remark for remark in found.remarks)


def test_a_person_says_what_a_file_does_not(tmp_path: Path) -> None:
    path = made(tmp_path, "f [Hz]\tPower [V^2]")
    with pytest.raises(ConfigError, match="give --noise-bandwidth"):
        spectrum_of(path)
    assert spectrum_of(path, noise_bandwidth_hz=5.0).density_per_hz[6] == pytest.approx(2e-10)
    doubled = spectrum_of(path, noise_bandwidth_hz=5.0, sides=2)
    assert doubled.density_per_hz[6] == pytest.approx(4e-10)
    answer = invoke(["calibrate", "stiffness", "--spectrum", str(path), "--sensitivity", "50", "--json"])
    assert answer.exit_code == 2 and "--noise-bandwidth" in answer.output


def test_what_a_file_or_a_record_has_no_use_for_is_refused_by_its_option(tmp_path: Path) -> None:
    density = made(tmp_path, "f [Hz]\tPSD [V^2/Hz]")
    with pytest.raises(ConfigError, match="--noise-bandwidth: is of a file with the power of lines"):
        spectrum_of(density, noise_bandwidth_hz=5.0)
    record = ["calibrate", "stiffness", "--record", str(density), "--rate", "1e6", "--sensitivity", "50"]
    for words in (["--sides", "two"], ["--noise-bandwidth", "5"], ["--frequency-unit", "kHz"], ["--columns", "1", "2"]):
        answer = invoke([*record, *words])
        assert answer.exit_code == 2 and f"{words[0]}: not with --record" in answer.output
