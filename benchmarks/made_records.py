"""Make records with a true mean of 0, for a table of the coverage of an interval of a mean.

The makers know nothing of any estimator: they shape noise in the frequency domain over 20 s or more, or filter it, and
cut out a window at a random place, so that the window misses the slow parts of the longer record.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy import signal

Records = npt.NDArray[np.float64]
Maker = Callable[[np.random.Generator, int, int], Records]
# The sampling rate of a hand [Hz], and the length of the record from which a window is cut [s].
RATE_HZ, WHOLE_S = 1000.0, 20.0


def white(random: np.random.Generator, count: int, samples: int) -> Records:
    """Return records of white noise, shape (count, samples)."""
    return random.normal(size=(count, samples))


def power_law(exponent: float) -> Maker:
    """Return a maker of noise with a spectrum of 1/f^exponent, down to one cycle in the whole record."""

    def made(random: np.random.Generator, count: int, samples: int) -> Records:
        whole = max(round(WHOLE_S * RATE_HZ), 2 * samples)
        frequency = np.fft.rfftfreq(whole, 1.0 / RATE_HZ)
        size = np.zeros(frequency.size)
        size[1:] = frequency[1:] ** (-0.5 * exponent)
        rows = np.empty((count, samples))
        for row in rows:
            phase = random.normal(size=frequency.size) + 1j * random.normal(size=frequency.size)
            noise = np.fft.irfft(size * phase, whole)
            first = random.integers(0, whole - samples + 1)
            row[:] = noise[first : first + samples] / noise.std()
        return rows

    return made


def hand(corner_hz: float = 2.0, order: int = 1) -> Maker:
    """Return a maker of the force of a hand: noise through a Butterworth low-pass."""

    def made(random: np.random.Generator, count: int, samples: int) -> Records:
        b, a = signal.butter(order, 2.0 * corner_hz / RATE_HZ)
        before = round(10.0 / corner_hz * RATE_HZ)
        rows = signal.lfilter(b, a, random.normal(size=(count, samples + before)), axis=1)[:, before:]
        return np.asarray(rows / rows.std())

    return made


def tremor(middle_hz: float = 9.0, width_hz: float = 1.0, beside: float = 0.3) -> Maker:
    """Return a maker of a tremor: band-passed noise, plus white noise of `beside` times its deviation."""

    def made(random: np.random.Generator, count: int, samples: int) -> Records:
        edges = np.array([middle_hz - 0.5 * width_hz, middle_hz + 0.5 * width_hz]) * 2.0 / RATE_HZ
        b, a = signal.butter(1, edges, "bandpass")
        before = round(5.0 * RATE_HZ)
        rows = signal.lfilter(b, a, random.normal(size=(count, samples + before)), axis=1)[:, before:]
        return np.asarray(rows / rows.std() + beside * random.normal(size=rows.shape))

    return made


def wave(frequency_hz: float, overtones: tuple[float, ...] = (), beside: float = 0.5) -> Maker:
    """Return a maker of a wave such as breathing or pulse plus white noise; records differ in period by a tenth."""

    def made(random: np.random.Generator, count: int, samples: int) -> Records:
        turn = frequency_hz * np.exp(0.1 * random.normal(size=(count, 1))) * np.arange(samples) / RATE_HZ
        phase = 2.0 * np.pi * (turn + random.random((count, 1)))
        rows = np.cos(phase) + beside * random.normal(size=(count, samples))
        for order, size in enumerate(overtones, start=2):
            rows = rows + size * np.cos(order * phase + 0.5 * order)
        return np.asarray(rows)

    return made


def scaled(maker: Maker, size: float) -> Maker:
    """Return a maker of the same records multiplied by `size`."""

    def made(random: np.random.Generator, count: int, samples: int) -> Records:
        return size * maker(random, count, samples)

    return made


def together(*makers: Maker) -> Maker:
    """Return a maker of the sums of records of several makers."""

    def made(random: np.random.Generator, count: int, samples: int) -> Records:
        return np.sum([own(random, count, samples) for own in makers], axis=0)

    return made


RECORDS: dict[str, Maker] = {
    "white": white,
    "1/f": power_law(1.0),
    "1/f^1.5": power_law(1.5),
    "1/f^2": power_law(2.0),
    "hand, 2 Hz": hand(),
    "hand, 2 Hz, 2nd order": hand(order=2),
    "tremor, 9 Hz": tremor(),
    "pulse, 1.2 Hz": wave(1.2, (0.5, 0.25), 1.0),
    "breathing, 0.25 Hz": wave(0.25),
    "drift, 0.05 Hz, and tremor": together(wave(0.05, beside=0.0), tremor(beside=0.3)),
    "breathing and tremor": together(wave(0.25, beside=0.0), tremor(beside=0.3)),
    "hand, 3 Hz": hand(3.0),
    "tremor and 1/f": together(tremor(beside=0.3), scaled(power_law(1.0), 0.5)),
}
# The records of a hand that holds a force; the interval of their mean should cover in 92 to 98 % of the sessions.
HANDS = (
    *("white", "tremor, 9 Hz", "tremor and 1/f", "hand, 3 Hz"),
    *("pulse, 1.2 Hz", "breathing, 0.25 Hz", "breathing and tremor", "drift, 0.05 Hz, and tremor"),
)
