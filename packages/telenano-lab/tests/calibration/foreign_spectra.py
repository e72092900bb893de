"""Thermal spectra as the world's tools write them, and how often `calibrate stiffness` is right about each form.

    python packages/telenano-lab/tests/calibration/foreign_spectra.py [COUNT] [--first SEED] [--form NAME ...]

A record of a lever is drawn by its exact covariance, with white noise of the read-out, and its spectrum is computed by
SciPy with each of its options, then written with the head, the units and the order of lines of a tool. The reader sees
the file and the deflection per volt alone. Of a form whose file determines the stiffness the table has: read, refused,
wrong (more than 5 % and more than 4 of its own errors off) and the share within two errors. A form whose file does not
determine it has to be refused.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import signal

from telenano.analysis import wilson
from telenano.testing import print_table

K_B = 1.380649e-23
KELVIN = 295.0
BY_ANGLE = 0.971 / 1.09**2
Array = np.ndarray


class Made(NamedTuple):
    """The text of a spectrum, the stiffness behind it [N/m] and the deflection per volt [m/V]."""

    text: str
    k: float
    m_per_v: float


class Record(NamedTuple):
    """A record of a free lever [V], its rate [Hz], points of a segment, and its lever."""

    volts: Array
    rate: float
    points: int
    k: float
    m_per_v: float
    f0: float
    q: float


def record_of(draw: np.random.Generator, lines: tuple[float, float] = (4.0, 16.0), segments: int = 0) -> Record:
    """Draw a lever and its record: so many lines across the width of the resonance, and so many segments."""
    f0 = math.exp(draw.uniform(math.log(8e3), math.log(4e5)))
    q = math.exp(draw.uniform(math.log(8.0), math.log(200.0)))
    mass = math.exp(draw.uniform(math.log(2e-12), math.log(3e-11)))
    k = (2.0 * math.pi * f0) ** 2 * mass
    rate = draw.uniform(6.0, 12.0) * f0
    points = int(2 ** round(math.log2(max(draw.uniform(*lines) * q * rate / f0, 64.0))))
    segments = segments or int(draw.integers(12, 60))
    count = points * segments
    square = BY_ANGLE * K_B * KELVIN / k
    t = np.arange(count) / rate
    t = np.minimum(t, count / rate - t)
    gamma = math.pi * f0 / q
    turn = 2.0 * math.pi * f0 * math.sqrt(1.0 - 0.25 / q**2)
    covariance = square * np.exp(-gamma * t) * (np.cos(turn * t) + gamma / turn * np.sin(turn * t))
    power = np.maximum(np.fft.rfft(covariance).real, 0.0)
    # The white noise of the read-out is drawn by its share of the density in the peak.
    peak = 2.0 * square * q / (math.pi * f0)
    power = power + 0.5 * rate * peak * math.exp(draw.uniform(math.log(1e-5), math.log(3e-3)))
    z = draw.standard_normal(count)
    metres = np.fft.irfft(np.fft.rfft(z) * np.sqrt(power), count)
    m_per_v = draw.uniform(20e-9, 150e-9)
    return Record(metres / m_per_v, rate, points, k, m_per_v, f0, q)


def welch(one: Record, **options: Any) -> tuple[Array, Array]:
    options = {"window": "hann", "nperseg": one.points, "detrend": "constant", **options}
    return signal.welch(one.volts, one.rate, **options)


def table(columns: tuple[Array, ...], separator: str = "\t", form: str = "{:.9e}") -> str:
    return "".join(separator.join(form.format(v) for v in row) + "\n" for row in zip(*columns, strict=True))


def bins(window: Any, points: int) -> float:
    """Return the noise bandwidth of a window in lines."""
    values = signal.get_window(window, points)
    return float(points * np.sum(values**2) / np.sum(values) ** 2)


def welch_density(draw: np.random.Generator) -> Made:
    """`scipy.signal.welch` as it stands: one-sided, Hann, half of each segment in the next."""
    one = record_of(draw)
    f, p = welch(one, noverlap=int(draw.choice([0, one.points // 2, 3 * one.points // 4])))
    head = draw.choice(["f [Hz]\tPSD [V**2/Hz]", "frequency (Hz)\tPxx (V^2/Hz)", "# Hz\tV²/Hz"])
    return Made(f"{head}\n{table((f, p))}", one.k, one.m_per_v)


def periodogram(draw: np.random.Generator) -> Made:
    """`scipy.signal.periodogram` of the whole record: a line is one periodogram."""
    one = record_of(draw, (4.0, 10.0), int(draw.integers(2, 6)))
    f, p = signal.periodogram(one.volts, one.rate, detrend="linear")
    return Made(f"Frequency [Hz],PSD [V^2/Hz]\n{table((f, p), ',')}", one.k, one.m_per_v)


WINDOWS = ("hamming", "blackman", "boxcar", "bartlett", "flattop", "blackmanharris", ("kaiser", 8.0), ("tukey", 0.25))


def other_windows(draw: np.random.Generator) -> Made:
    """Another window than Hann's, which the head names."""
    one = record_of(draw)
    window = WINDOWS[draw.integers(len(WINDOWS))]
    f, p = welch(one, window=window)
    name = window if isinstance(window, str) else f"{window[0]} {window[1]}"
    return Made(f"# window: {name}\n# f [Hz]\tPSD [V^2/Hz]\n{table((f, p))}", one.k, one.m_per_v)


def median_average(draw: np.random.Generator) -> Made:
    """`welch(average="median")`."""
    one = record_of(draw)
    f, p = welch(one, average="median")
    return Made(f"# averaging: median\nf [Hz]\tPSD [V^2/Hz]\n{table((f, p))}", one.k, one.m_per_v)


def two_sided_in_order_of_fft(draw: np.random.Generator) -> Made:
    """`welch(return_onesided=False)`: lines 0 and up, then the negative ones, half of the density on each side."""
    one = record_of(draw)
    f, p = welch(one, return_onesided=False)
    head = draw.choice(["f [Hz]\tPSD [V^2/Hz]", "# two-sided\n# f [Hz]\tPSD [V^2/Hz]"])
    return Made(f"{head}\n{table((f, p))}", one.k, one.m_per_v)


def two_sided_shifted(draw: np.random.Generator) -> Made:
    """The same after `fftshift`, or MATLAB's `pwelch(..., 'centered')`: lines from below 0 to above it."""
    one = record_of(draw)
    f, p = welch(one, return_onesided=False)
    head = draw.choice(["f (kHz)\tPSD (V^2/Hz)", "% pwelch, centered\n% f (kHz)\tPSD (V^2/Hz)"])
    return Made(f"{head}\n{table((1e-3 * np.fft.fftshift(f), np.fft.fftshift(p)))}", one.k, one.m_per_v)


def two_sided_mirrored(draw: np.random.Generator) -> Made:
    """MATLAB's `pwelch(..., 'twosided')`: lines from 0 to the rate, the upper half the mirror of the lower."""
    one = record_of(draw)
    f, p = welch(one, return_onesided=False)
    f = np.where(f < 0.0, f + one.rate, f)
    return Made(f"f (Hz),Pxx (V^2/Hz)\n{table((f, p), ',')}", one.k, one.m_per_v)


def half_of_two_sided(draw: np.random.Generator) -> Made:
    """The positive half of a two-sided density, which the head says."""
    one = record_of(draw)
    f, p = welch(one, return_onesided=False)
    words = draw.choice(
        ["# sides: two-sided density, lines above 0 only", "# double-sided PSD", "# SpectrumType: twosided"]
    )
    kept = f >= 0.0
    return Made(f"{words}\nf [Hz]\tPSD [V^2/Hz]\n{table((f[kept], p[kept]))}", one.k, one.m_per_v)


def power_with_bandwidth(draw: np.random.Generator) -> Made:
    """`welch(scaling="spectrum")`: power of a line, and the noise bandwidth in the head."""
    one = record_of(draw)
    window = draw.choice(["hann", "flattop", "boxcar", "blackman"])
    f, p = welch(one, window=window, scaling="spectrum")
    width = bins(window, one.points) * one.rate / one.points
    words = draw.choice([f"# ENBW: {width:.6g} Hz", f"# noise bandwidth = {width:.6g} Hz",
                         f"# RBW (ENBW)\t{width:.6g} Hz", f"# ENBW: {bins(window, one.points):.6g} bins"])  # fmt: skip
    return Made(f"{words}\nf [Hz]\tPower [V^2]\n{table((f, p))}", one.k, one.m_per_v)


def power_with_window(draw: np.random.Generator) -> Made:
    """Power of a line, and the window in the head, whose noise bandwidth is known."""
    one = record_of(draw)
    window = draw.choice(["hann", "flattop", "boxcar", "blackman", "hamming"])
    f, p = welch(one, window=window, scaling="spectrum")
    name = {"hann": "Hanning", "boxcar": "rectangular"}.get(window, window)
    words = draw.choice([f"# window: {name}", f"# Window = {name}", f"# Fenster: {name}"])
    return Made(f"{words}\nf [Hz]\tpower [V^2]\n{table((f, p))}", one.k, one.m_per_v)


def rms_density(draw: np.random.Generator) -> Made:
    """A lock-in's amplitude density, whose unit names the root of the mean square."""
    one = record_of(draw)
    f, p = welch(one)
    unit = draw.choice(["Vrms/√Hz", "V RMS/sqrt(Hz)", "V_rms/rtHz", "V/√Hz", "mVrms/√Hz"])
    scale = 1e3 if unit.startswith("mV") else 1.0
    return Made(f"f [Hz]\tASD [{unit}]\n{table((f, scale * np.sqrt(p)))}", one.k, one.m_per_v)


def peak_density(draw: np.random.Generator) -> Made:
    """An analyser's amplitude density of peaks: √2 times that of the root of the mean square."""
    one = record_of(draw)
    f, p = welch(one)
    if draw.random() < 0.5:
        unit, values = draw.choice(["Vpk/√Hz", "V peak/sqrt(Hz)", "Vp/rtHz"]), np.sqrt(2.0 * p)
    else:
        unit, values = draw.choice(["Vpp/√Hz", "Vpk-pk/sqrt(Hz)"]), np.sqrt(8.0 * p)
    return Made(f"f [Hz]\tASD [{unit}]\n{table((f, values))}", one.k, one.m_per_v)


def amplitude_of_lines(draw: np.random.Generator) -> Made:
    """An FFT analyser's amplitude of a line, rms or peak, with window or bandwidth in the head."""
    one = record_of(draw)
    window = draw.choice(["hann", "flattop", "boxcar"])
    f, p = welch(one, window=window, scaling="spectrum")
    width = bins(window, one.points) * one.rate / one.points
    words = draw.choice([f"# ENBW: {width:.6g} Hz", f"# window: {window}"])
    unit, values = (("Vrms", np.sqrt(p)), ("Vpk", np.sqrt(2.0 * p)), ("V^2 rms", p), ("Vpk^2", 2.0 * p))[
        draw.integers(4)
    ]
    return Made(f"{words}\nf [Hz]\tAmplitude [{unit}]\n{table((f, values))}", one.k, one.m_per_v)


def decibels_of_a_density(draw: np.random.Generator) -> Made:
    """Decibels whose reference stands there."""
    one = record_of(draw)
    f, p = welch(one)
    unit, reference = (
        ("dB re 1 V^2/Hz", 1.0), ("dBV/√Hz", 1.0), ("dBV^2/Hz", 1.0), ("dB(V²/Hz)", 1.0), ("dBmV/√Hz", 1e-6),
        ("dB re 1 V/√Hz", 1.0), ("dBV/rtHz", 1.0), ("dBVrms/√Hz", 1.0), ("dB re 1 uV/√Hz", 1e-12),
        ("dBVpk/√Hz", 0.5),
    )[draw.integers(10)]  # fmt: skip
    return Made(f"f [Hz];level [{unit}]\n{table((f, 10.0 * np.log10(p / reference)), ';')}", one.k, one.m_per_v)


def decibels_of_a_milliwatt(draw: np.random.Generator) -> Made:
    """A spectrum analyser's dBm/Hz, with its impedance in the head."""
    one = record_of(draw)
    f, p = welch(one)
    words = draw.choice(["Impedance;50 Ohm", "# input 50 Ω", "# R = 50 Ohm"])
    return Made(f"{words}\nFrequency [Hz];Level [dBm/Hz]\n{table((f, 10.0 * np.log10(p / 50.0 / 1e-3)), ';')}",
                one.k, one.m_per_v)  # fmt: skip


def of_angular_frequency(draw: np.random.Generator) -> Made:
    """A density over angular frequency."""
    one = record_of(draw)
    f, p = welch(one)
    return Made(
        f"omega [rad/s]\tS [V^2/(rad/s)]\n{table((2.0 * math.pi * f, p / (2.0 * math.pi)))}", one.k, one.m_per_v
    )


def both_densities(draw: np.random.Generator) -> Made:
    """A density and its root side by side."""
    one = record_of(draw)
    f, p = welch(one)
    if draw.random() < 0.5:
        return Made(f"f [Hz],PSD [V^2/Hz],ASD [V/√Hz]\n{table((f, p, np.sqrt(p)), ',')}", one.k, one.m_per_v)
    return Made(f"f [kHz];ASD [mV/√Hz];PSD [V^2/Hz]\n{table((1e-3 * f, 1e3 * np.sqrt(p), p), ';')}", one.k, one.m_per_v)


def averages_in_the_head(draw: np.random.Generator) -> Made:
    """A head that states how many segments were averaged."""
    one = record_of(draw)
    f, p = welch(one, noverlap=0)
    count = len(one.volts) // one.points
    words = draw.choice(
        [f"# averages: {count}", f"Averages\t{count}", f"# number of averages = {count}", f"# Mittelungen: {count}"]
    )
    return Made(f"{words}\nf [Hz]\tPSD [V^2/Hz]\n{table((f, p))}", one.k, one.m_per_v)


def padded(draw: np.random.Generator) -> Made:
    """Segments padded with zeros: more lines than there is information."""
    one = record_of(draw)
    f, p = welch(one, nfft=int(draw.choice([2, 4])) * one.points, window=draw.choice(["hann", "boxcar"]))
    return Made(f"f [Hz]\tPSD [V^2/Hz]\n{table((f, p))}", one.k, one.m_per_v)


def of_metres(draw: np.random.Generator) -> Made:
    """A thermal tune of an AFM in metres: pm/√Hz, fm/√Hz or pm²/Hz over kHz."""
    one = record_of(draw)
    f, p = welch(one)
    metres = p * one.m_per_v**2
    unit, values = (("pm/√Hz", 1e12 * np.sqrt(metres)), ("pm²/Hz", 1e24 * metres), ("fm/rtHz", 1e15 * np.sqrt(metres)),
                    ("m^2/Hz", metres))[draw.integers(4)]  # fmt: skip
    return Made(f"Frequency_kHz\tAmplitude ({unit})\n{table((1e-3 * f, values))}", one.k, one.m_per_v)


def few_lines(draw: np.random.Generator) -> Made:
    """A resonance of fewer than two lines across its width, of Hann's window or none."""
    one = record_of(draw, (0.3, 1.8), int(draw.integers(40, 200)))
    window = draw.choice(["hann", "boxcar"])
    f, p = welch(one, window=window)
    head = draw.choice(["", f"# window: {window}\n"])
    return Made(f"{head}f [Hz]\tPSD [V^2/Hz]\n{table((f, p))}", one.k, one.m_per_v)


def bare_power(draw: np.random.Generator) -> Made:
    """Power of a line, without a window or a bandwidth."""
    one = record_of(draw)
    f, p = welch(one, scaling="spectrum")
    return Made(f"f [Hz]\t{draw.choice(['power [V^2]', 'PSD [V²]', 'S (mV^2)'])}\n{table((f, p))}", one.k, one.m_per_v)


def bare_amplitude(draw: np.random.Generator) -> Made:
    """Amplitude of a line, without a window or a bandwidth."""
    one = record_of(draw)
    f, p = welch(one, scaling="spectrum")
    unit = draw.choice(["V", "Vrms", "mV", "Vpk"])
    return Made(f"f [Hz]\tamplitude [{unit}]\n{table((f, np.sqrt(p)))}", one.k, one.m_per_v)


def bare_decibels(draw: np.random.Generator) -> Made:
    """Decibels of nothing that is named: dB, dB/Hz, dBFS, dBm without an impedance."""
    one = record_of(draw)
    f, p = welch(one)
    unit = draw.choice(["dB", "dB/Hz", "dBFS", "dBFS/Hz", "dBm/Hz", "dBm", "dBc/Hz"])
    name = draw.choice(["Power/frequency", "level", "PSD"])
    return Made(f"Frequency (Hz);{name} ({unit})\n{table((f, 10.0 * np.log10(p)), ';')}", one.k, one.m_per_v)


def normalised_frequency(draw: np.random.Generator) -> Made:
    """MATLAB's `pwelch` without a rate: radians a sample."""
    one = record_of(draw)
    f, p = welch(one)
    unit = draw.choice(["rad/sample", "×π rad/sample", "cycles/sample"])
    return Made(f"Normalized Frequency ({unit})\tPSD (V^2/Hz)\n{table((f / one.rate, p))}", one.k, one.m_per_v)


def about_a_carrier(draw: np.random.Generator) -> Made:
    """A lock-in's or an SDR's spectrum about its carrier: lines on both sides, which are no mirror of each other."""
    one = record_of(draw)
    f, p = welch(one)
    centre = one.f0 * draw.uniform(0.97, 1.03)
    kept = np.abs(f - centre) < 0.4 * one.f0
    return Made(f"offset [Hz]\tPSD [V^2/Hz]\n{table((f[kept] - centre, p[kept]))}", one.k, one.m_per_v)


def of_igor(draw: np.random.Generator) -> Made:
    """Igor's `DSPPeriodogram` without a normalisation: the squared transform over the count of points."""
    one = record_of(draw, (4.0, 10.0), 4)
    power = np.abs(np.fft.rfft(one.volts * np.hanning(len(one.volts)))) ** 2 / len(one.volts)
    f = np.fft.rfftfreq(len(one.volts), 1.0 / one.rate)
    head = draw.choice(["f [Hz]\tW_Periodogram [V^2]", "f [Hz]\tW_Periodogram", "Frequency_Hz\tpower [a.u.]"])
    return Made(f"{head}\n{table((f, power))}", one.k, one.m_per_v)


def two_in_one_file(draw: np.random.Generator) -> Made:
    """Two spectra one after another: another normalisation or another segment, under one head."""
    one = record_of(draw)
    f, p = welch(one)
    other = (f, 0.5 * p) if draw.random() < 0.5 else welch(one, nperseg=one.points // 2, scaling="spectrum")
    gap = draw.choice(["", "\n", "# second\n"])
    return Made(f"f [Hz]\tPSD [V^2/Hz]\n{table((f, p))}{gap}{table(other)}", one.k, one.m_per_v)


def columns_that_differ(draw: np.random.Generator) -> Made:
    """Two columns of a density that are not the same: two channels, or a root of something else."""
    one = record_of(draw)
    f, p = welch(one)
    other = p * draw.uniform(1.5, 4.0) * draw.gamma(20.0, 1.0 / 20.0, len(p))
    if draw.random() < 0.5:
        return Made(f"f [Hz]\tA [V^2/Hz]\tB [V^2/Hz]\n{table((f, p, other))}", one.k, one.m_per_v)
    return Made(f"f [Hz]\tPSD [V^2/Hz]\tASD [V/√Hz]\n{table((f, p, np.sqrt(other)))}", one.k, one.m_per_v)


def contradicted(draw: np.random.Generator) -> Made:
    """A head that says power of a line and a column that says a density."""
    one = record_of(draw)
    f, p = welch(one, scaling="spectrum")
    words = draw.choice(["# scaling: spectrum", "# scaling = 'spectrum'", "# power spectrum, V^2 per bin"])
    return Made(f"{words}\nf [Hz]\tPSD [V^2/Hz]\n{table((f, p))}", one.k, one.m_per_v)


Form = Callable[[np.random.Generator], Made]
DETERMINED: tuple[Form, ...] = (
    welch_density, periodogram, other_windows, median_average, two_sided_in_order_of_fft, two_sided_shifted,
    two_sided_mirrored, half_of_two_sided, power_with_bandwidth, power_with_window, rms_density, peak_density,
    amplitude_of_lines, decibels_of_a_density, decibels_of_a_milliwatt, of_angular_frequency, both_densities,
    averages_in_the_head, padded, of_metres, few_lines,
)  # fmt: skip
UNDETERMINED: tuple[Form, ...] = (
    bare_power, bare_amplitude, bare_decibels, normalised_frequency, about_a_carrier, of_igor, two_in_one_file,
    columns_that_differ, contradicted,
)  # fmt: skip
FORMS = (*DETERMINED, *UNDETERMINED)


class Outcome(NamedTuple):
    """Of one file: the error as a share and in its own standard errors; None where it was refused, with the reason."""

    share: float | None
    errors: float | None
    reason: str = ""

    @property
    def is_wrong(self) -> bool:
        return self.share is not None and abs(self.share) > 0.05 and abs(self.errors or 0.0) > 4.0


def outcome(form: Form, seed: int, folder: Path) -> Outcome:
    """Write a file of a form and return what the reader makes of it."""
    from telenano_lab.calibration.own_calibration import Thermal, spectrum_of, stiffness_of_spectrum

    from telenano.wire import ConfigError

    made = form(np.random.default_rng([FORMS.index(form), seed]))
    path = folder / "spectrum.txt"
    path.write_text(made.text, encoding="utf-8")
    try:
        one = spectrum_of(path)
        sensitivity = 1.0 if one.is_of_metres else made.m_per_v
        known = Thermal(sensitivity, KELVIN, averages=one.averages)
        known = known._replace(window=one.window) if hasattr(one, "window") else known
        found = stiffness_of_spectrum(one.frequency_hz, one.density_per_hz, known)
    except ConfigError as error:
        return Outcome(None, None, str(error))
    off = found.stiffness_n_per_m - made.k
    return Outcome(off / made.k, off / found.standard_error_n_per_m)


def main() -> None:
    """Print the table, and how many files were read wrongly, of those that determine the answer and of the others."""
    Told = tuple[Form, Outcome]

    def is_wrong(told: Told) -> bool:
        # What a file does not determine may not be read at all.
        form, one = told
        return one.is_wrong if form in DETERMINED else one.errors is not None

    def read(found: list[Told]) -> int:
        return sum(one.errors is not None for _, one in found)

    def inside(found: list[Told]) -> int:
        return sum(one.errors is not None and abs(one.errors) < 2.0 for _, one in found)

    made = print_table(
        __doc__,
        FORMS,
        lambda form, seed, folder: (form, outcome(form, seed, folder)),
        {
            "read": read,
            "refused": lambda found: len(found) - read(found),
            "wrong": lambda found: sum(map(is_wrong, found)),
            "within two errors": lambda found: f"{inside(found) / read(found):.1%}" if read(found) else "-",
        },
        reason=lambda told: told[1].reason,
        fault=lambda told: f"{told[1].share:+.1%}, {told[1].errors:+.1f} errors" if is_wrong(told) else "",
        note=lambda form: "" if form in DETERMINED else " (not determined)",
    )
    for determined in (True, False):
        found = [told for ones in made.values() for told in ones if (told[0] in DETERMINED) == determined]
        if found:
            wrong = sum(map(is_wrong, found))
            low, high = wilson(wrong, len(found))
            share = f", {inside(found) / max(read(found), 1):.1%} within two errors" if determined else ""
            sys.stdout.write(
                f"{'determined' if determined else 'not determined'}: {len(found)} files,"
                f" {1.0 - read(found) / len(found):.1%} refused, {wrong} wrong ({low:.2%} to {high:.2%}){share}\n"
            )


if __name__ == "__main__":
    main()
