"""Made logs of lines of twelve kinds, and which of them a fitted model is like.

    python packages/telenano-lab/tests/networks/made_lines.py [SEEDS]

Each kind is drawn as a round trip of a message each 0.1 s for 20 minutes by a generator that knows nothing of the
link's models. What happens at fixed times or over minutes, and losses that come and go over seconds, no model of the
link has: such a line must not be said to agree.
"""

import sys
from collections.abc import Callable

import numpy as np

Made = tuple[np.ndarray, np.ndarray]
COUNT, PERIOD_S = 12_000, 0.1


def _course(draw: np.random.Generator, time_s: float) -> np.ndarray:
    rho = np.exp(-PERIOD_S / time_s)
    fresh = draw.standard_normal(COUNT)
    scores = np.empty(COUNT)
    scores[0] = fresh[0]
    for n in range(1, COUNT):
        scores[n] = rho * scores[n - 1] + np.sqrt(1.0 - rho * rho) * fresh[n]
    return scores


def independent(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Gamma-distributed delays of messages by themselves, one in a hundred lost."""
    delay = 0.02 + draw.gamma(2.0, 0.003, COUNT)
    return np.where(draw.random(COUNT) < 0.01, np.nan, delay)


def lasting(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Log-normal delays that last half a second."""
    return 0.04 * np.exp(0.2 * _course(draw, 0.5))


def bursts(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Losses in runs of three."""
    delay = 0.03 + draw.exponential(0.004, COUNT)
    bad = False
    for n in range(COUNT):
        bad = draw.random() < (2.0 / 3.0 if bad else 0.01)
        delay[n] = np.nan if bad else delay[n]
    return delay


def stalls(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Stalls of 0.8 s at random, each half a minute."""
    arrived = t + 0.05 + draw.gamma(3.0, 0.002, COUNT)
    at = draw.exponential(20.0)
    while at < t[-1]:
        end = at + 0.8 * np.exp(0.2 * draw.standard_normal())
        held = (t >= at) & (t < end)
        arrived[held] = end + 0.05
        at = end + draw.exponential(20.0)
    return np.maximum.accumulate(arrived) - t


def wired(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A wired line: a millisecond and some microseconds."""
    return 0.001 + np.abs(draw.normal(0.0, 2e-5, COUNT)) + draw.exponential(1e-5, COUNT)


def slots(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A mobile line with slots of 8 ms that is asked for again in a tenth of the cases."""
    return 0.03 + 0.008 * draw.random(COUNT) + 0.008 * draw.geometric(0.9, COUNT)


def satellite(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A geostationary satellite whose delay hardly varies."""
    return 0.6 + 0.006 * np.exp(0.5 * _course(draw, 2.0)) + draw.exponential(0.004, COUNT)


def two_states(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A queue that comes and goes in some seconds, at random."""
    full = _course(draw, 3.0) > 1.0
    return 0.02 + np.where(full, draw.gamma(4.0, 0.005, COUNT), draw.gamma(2.0, 0.002, COUNT))


def handovers(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A low satellite: another level each 15 s, and a gap at each change."""
    level = 0.035 + 0.02 * draw.random(200)[(t // 15.0).astype(int)]
    delay = level + draw.gamma(2.0, 0.002, COUNT)
    return np.where((t % 15.0 < 0.3) & (draw.random(COUNT) < 0.7), np.nan, delay)


def fades(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Rain: half a minute in which half of the messages are lost, at random."""
    faded = np.zeros(COUNT, dtype=bool)
    for at in draw.uniform(0.0, t[-1], 9):
        faded |= (t > at) & (t < at + 30.0)
    return np.where(draw.random(COUNT) < np.where(faded, 0.5, 0.002), np.nan, 0.3 + draw.exponential(0.01, COUNT))


def course_of_day(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A load that comes and goes in four minutes, over a base that stays."""
    load = 0.5 - 0.5 * np.cos(2.0 * np.pi * t / 240.0 + draw.uniform(0.0, 6.0))
    return 0.02 + draw.exponential(0.003, COUNT) + 0.02 * load * draw.gamma(2.0, 0.5, COUNT)


def sawtooth(draw: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """A full buffer: the delay rises for 20 s and falls at once."""
    return 0.08 + 0.15 * ((t + draw.uniform(0.0, 20.0)) % 20.0) / 20.0 + draw.exponential(0.003, COUNT)


# Whether the link's models can have what the kind is of; None: nearly.
KINDS: dict[Callable[[np.random.Generator, np.ndarray], np.ndarray], bool | None] = {
    independent: True, lasting: True, bursts: True, stalls: True, wired: True, slots: True, satellite: True,
    two_states: True, handovers: None, fades: False, course_of_day: None, sawtooth: False,
}  # fmt: skip
WORDS = {True: "yes", False: "no", None: "nearly"}


def made(kind: Callable[[np.random.Generator, np.ndarray], np.ndarray], seed: int) -> Made:
    """Return times of sending [s] and round trips [s], nan where lost."""
    t = PERIOD_S * np.arange(COUNT)
    return t, kind(np.random.default_rng([list(KINDS).index(kind), seed]), t)


def main() -> None:
    """Print in which kinds the model agrees, and in what it does not."""
    from telenano_lab.networks.line_fit import accept
    from telenano_lab.networks.line_log import LineLog, Segment

    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    refused = 0
    sys.stdout.write("| kind | a model can have it | not written | in what |\n|---|---|---|---|\n")
    for kind, can in KINDS.items():
        why: dict[str, int] = {}
        count = 0
        for seed in range(seeds):
            table = accept(LineLog((Segment(*made(kind, seed)),), round_trip=True))
            apart = [row.what for row in table if not row.agrees]
            count += bool(apart)
            for what in apart:
                why[what] = why.get(what, 0) + 1
        refused += count
        text = ", ".join(f"{what} ({n})" for what, n in why.items()) or "-"
        sys.stdout.write(f"| {kind.__name__} | {WORDS[can]} | {count} of {seeds} | {text} |\n")
        sys.stdout.flush()
    sys.stdout.write(f"\n{refused} of {seeds * len(KINDS)} are not written.\n")


if __name__ == "__main__":
    main()
