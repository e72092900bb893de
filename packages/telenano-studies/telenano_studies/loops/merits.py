"""Figures of merit: what a law does in a hold over a network, with a constant force and with arms, over several seeds.

Every law is tuned for the network by the rule of `tuning` and run with the force clamp off and on. Of each run:
greatest force at the tip, F_s/F_m and x_m - x_s/alpha_p in the later half of the last hold, work of the hand, least
energy at the device, share of the session in which a guard had taken over; and how far a hand of constant force walks
in a cycle of 1 +- 0.3 N at 0.5 Hz. Over a random link each figure has its mean over the seeds with standard deviation
and interval, and its median with the least and the greatest, which the figures show.
"""

import math
import statistics
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from analysis.statistics import Statistic, statistic
from telenano_studies.loops.advice import WALLS_N_PER_M, Candidate, Question, cells_of
from telenano_studies.loops.cells import DEFAULT_STIFFNESS, Cell, CellResult, Environment, Hand
from telenano_studies.loops.sweep import Sweep
from telenano_studies.loops.transparency import drift_m
from telenano_studies.option_values import Jitter


class Network(NamedTuple):
    """Round trip [ms], half-width of the jitter each way, share of the messages lost each way."""

    round_trip_ms: float
    jitter: Jitter = Jitter()
    loss: float = 0.0

    @property
    def random(self) -> bool:
        return self.jitter.value > 0.0 or self.loss > 0.0

    def __str__(self) -> str:
        words = f"{self.round_trip_ms:g} ms"
        words += f", jitter {self.jitter}" if self.jitter.value else ""
        return words + (f", loss {100.0 * self.loss:g} %" if self.loss else "")


class Sample(NamedTuple):
    """What the tip touches, and its K or k [N/m]."""

    environment: Environment
    stiffness_n_per_m: float

    def __str__(self) -> str:
        return "contact" if self.environment == "contact" else f"{self.environment} of {self.stiffness_n_per_m:g} N/m"


SAMPLES = {
    "contact": Sample("contact", DEFAULT_STIFFNESS["contact"][0]),
    **{name: Sample("wall", stiffness) for name, stiffness in WALLS_N_PER_M.items()},
}


class Spread(NamedTuple):
    """Median, least and greatest of the runs that have the figure, and their mean with deviation and interval."""

    median: float
    least: float
    most: float
    over: Statistic

    def __str__(self) -> str:
        same = f"{self.least:.3g}" == f"{self.most:.3g}"
        return f"{self.median:.3g}" if same else str(self.over)


_PARTS = ("median", "least", "most", "n", "mean", "deviation", "low", "high")
# name of the figure, its title with unit
FIGURES: dict[str, str] = {
    "peak_n": "greatest force [N]",
    "force_ratio": "F_s/F_m",
    "apart_mm": "x_m - x_s/alpha_p [mm]",
    "drift_mm": "drift [mm/cycle]",
    "work_mj": "work of the hand [mJ]",
    "lowest_energy_mj": "least energy [mJ]",
    "guarded_percent": "guarded [%]",
}


@dataclass(frozen=True)
class Merit:
    """A law with its clamp on or off, on a sample, over a network, with a hand. figures: by the names of FIGURES."""

    sample: Sample
    law: str
    clamp: bool
    network: Network
    hand: Hand
    results: tuple[CellResult, ...]
    figures: dict[str, Spread | None]

    @property
    def stable(self) -> int:
        return sum(result.verdict == "stable" for result in self.results)

    @property
    def verdict(self) -> str:
        """Return stable, or the verdict of the first run that is not."""
        return next((result.verdict for result in self.results if result.verdict != "stable"), "stable")

    def as_dict(self) -> dict[str, Any]:
        """Return one flat row."""
        row: dict[str, Any] = {
            "sample": str(self.sample),
            "law": self.law,
            "clamp": self.clamp,
            "round_trip_ms": self.network.round_trip_ms,
            "jitter": str(self.network.jitter),
            "loss": self.network.loss,
            "hand": self.hand,
            "runs": len(self.results),
            "stable_runs": self.stable,
            "verdict": self.verdict,
        }
        for name in FIGURES:
            spread = self.figures[name]
            found = {} if spread is None else {**spread._asdict(), **spread.over._asdict()}
            row |= {f"{name}_{part}": found.get(part) for part in _PARTS}
        return row


@dataclass(frozen=True)
class Trial:
    """What is tried: laws over networks on samples, with hands and seeds."""

    laws: tuple[str, ...]
    networks: tuple[Network, ...]
    hands: tuple[Hand, ...]
    samples: tuple[Sample, ...]
    seed: int
    seeds: int

    def cells(self, sample: Sample, law: str, clamp: bool, network: Network, hand: Hand) -> list[Cell]:
        """Return the cells that `telenano study advise` runs for this sample, law, network and hand."""
        question = Question(**network._asdict(), **sample._asdict(), seeds=self.seeds, seed=self.seed, hands=(hand,))
        return cells_of(question, law, clamp)


def run_merits(trial: Trial, sweep: Sweep) -> list[Merit]:
    """Run every combination, sample by sample and network by network."""
    keys = [
        (sample, law, clamp, network, hand)
        for sample in trial.samples
        for network in trial.networks
        for law in trial.laws
        for clamp in (False, True)
        for hand in trial.hands
    ]
    cells = [trial.cells(*key) for key in keys]
    results = iter(sweep.run([cell for some in cells for cell in some]))
    found = []
    for key, some in zip(keys, cells, strict=True):
        runs = tuple(next(results) for _ in some)
        # The drift is that of the first seed, because it depends on the law and not on the link; an arm holds the hand
        # where it is.
        drift = drift_m(some[0]) if some[0].hand == "force" else None
        found.append(Merit(*key, runs, figures_of(runs, drift)))
    return found


def figures_of(results: Sequence[CellResult], drift: float | None) -> dict[str, Spread | None]:
    """Return the spread of each figure over the runs; None where no run has it."""
    values: dict[str, list[float | None]] = {
        "peak_n": [result.peak_n for result in results],
        "force_ratio": [_ratio(result) for result in results],
        "apart_mm": [_times(1e3, result.apart_m) for result in results],
        "drift_mm": [_times(1e3, drift)],
        "work_mj": [_times(1e3, result.hand_work_j) for result in results],
        "lowest_energy_mj": [1e3 * result.lowest_energy_j for result in results],
        "guarded_percent": [_times(100.0, result.guarded_share) for result in results],
    }
    return {name: _spread(given) for name, given in values.items()}


def _ratio(result: CellResult) -> float | None:
    return result.tip_n / result.hand_n if result.tip_n is not None and result.hand_n else None


def _times(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value


def _spread(values: Sequence[float | None]) -> Spread | None:
    known = [value for value in values if value is not None and math.isfinite(value)]
    return Spread(statistics.median(known), min(known), max(known), statistic(known)) if known else None


def ranked(merits: Sequence[Merit], sample: Sample, network: Network) -> list[Candidate]:
    """Return the laws over a network as candidates of `advice`, all hands together, the one to take first."""
    runs: dict[tuple[str, bool], list[CellResult]] = {}
    for merit in merits:
        if merit.sample == sample and merit.network == network:
            runs.setdefault((merit.law, merit.clamp), []).extend(merit.results)
    found = [Candidate(*key, results[0].cell.settings, tuple(results)) for key, results in runs.items()]
    return sorted(found, key=lambda candidate: (candidate.price(), len(candidate.failed)))


Place = tuple[Sample, Network]


def tables_of(merits: Sequence[Merit]) -> dict[Place, list[Candidate]]:
    """Return what `ranked` does for every sample and network."""
    places = dict.fromkeys((merit.sample, merit.network) for merit in merits)
    return {place: ranked(merits, *place) for place in places}


def in_words(merits: Sequence[Merit]) -> list[str]:
    """Return three sentences: what to take over constant links, over random ones, and what holds most and least."""
    tables = tables_of(merits)
    words = []
    for random, name in ((False, "Over a constant link"), (True, "Over a link with loss or jitter")):
        places = [place for place in tables if place[1].random is random]
        if places:
            words.append(f"{name} take {_choices(tables, places)}.")
    return [*words, _extremes(tables)]


def _extremes(tables: dict[Place, list[Candidate]]) -> str:
    """Return which laws held all their runs in most of the places, and which in fewest."""
    held = Counter({candidate.name: 0 for candidate in next(iter(tables.values()))})
    held.update(candidate.name for found in tables.values() for candidate in found if not candidate.failed)
    most, fewest = max(held.values()), min(held.values())
    if most == fewest:
        return f"Each law held all of its runs on {most} of these {len(tables)}."
    named = {number: ", ".join(name for name, times in held.items() if times == number) for number in (most, fewest)}
    return f"Of these {len(tables)}, {named[most]} held all runs on {most}; on fewest, {fewest}, did {named[fewest]}."


def _choices(tables: dict[Place, list[Candidate]], places: Sequence[Place]) -> str:
    """Return the laws to take, each with the networks and samples where it is the one."""
    best: dict[str, list[Place]] = {}
    for place in places:
        first = tables[place][0]
        best.setdefault("no law" if first.failed else first.name, []).append(place)
    most_first = sorted(best.items(), key=lambda item: -len(item[1]))
    return "; ".join(f"{name} ({_where(some, places)})" for name, some in most_first)


def _where(places: Sequence[Place], among: Sequence[Place]) -> str:
    """Return samples, each with its networks, or with "all" for all that there are among some places."""
    parts = []
    for sample in dict.fromkeys(sample for sample, _ in places):
        networks, known = ([network for other, network in some if other == sample] for some in (places, among))
        several = len(known) > 1 and networks == known
        parts.append(f"{sample}: {'all' if several else ' / '.join(map(str, networks))}")
    return "; ".join(parts)
