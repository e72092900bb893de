"""Figures of merit: what a law does in a hold over a network, with a constant force and with arms, over several seeds.

Every law is tuned for the network by the rule of `studies.tuning` and run with the force clamp off and on. Of each run:
greatest force at the tip, F_s/F_m and x_m - x_s/alpha_p in the later half of the last hold, work of the hand, least
energy at the device, share of the session in which a guard had taken over; and how far the hand walks in a cycle of
1 +- 0.3 N at 0.5 Hz. Over a random link each figure is the median of the seeds, with the least and the greatest.
"""

import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from studies.advice import Candidate
from studies.cells import Cell, CellResult, Environment, Hand
from studies.stability import Jitter
from studies.sweep import Sweep
from studies.transparency import drift_m
from studies.tuning import tuned


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


class Spread(NamedTuple):
    """Median, least and greatest of the runs that have the figure."""

    median: float
    least: float
    most: float

    def __str__(self) -> str:
        if f"{self.least:.3g}" == f"{self.most:.3g}":
            return f"{self.median:.3g}"
        return f"{self.median:.3g} ({self.least:.3g} to {self.most:.3g})"


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
    """A law with its clamp on or off, over a network, with a hand. figures: by the names of FIGURES."""

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
            for part, value in zip(("median", "least", "most"), spread or (None, None, None), strict=True):
                row[f"{name}_{part}"] = value
        return row


@dataclass(frozen=True)
class Trial:
    """What is tried: laws over networks against one environment, with hands and seeds."""

    laws: tuple[str, ...]
    networks: tuple[Network, ...]
    hands: tuple[Hand, ...]
    environment: Environment
    stiffness_n_per_m: float
    seed: int
    seeds: int

    def cells(self, law: str, clamp: bool, network: Network, hand: Hand) -> list[Cell]:
        jitter_ms = network.jitter.at_ms(network.round_trip_ms)
        longest_s = 1e-3 * (network.round_trip_ms + 2.0 * jitter_ms)
        settings = (*tuned(law, self.stiffness_n_per_m, longest_s), ("clamp.enabled", clamp))
        return [
            Cell(
                law=law,
                environment=self.environment,
                hand=hand,
                round_trip_ms=network.round_trip_ms,
                stiffness_n_per_m=self.stiffness_n_per_m,
                jitter_ms=jitter_ms,
                loss=network.loss,
                seed=seed,
                settings=settings,
            )
            for seed in range(self.seed, self.seed + (self.seeds if network.random else 1))
        ]


def run_merits(trial: Trial, sweep: Sweep) -> list[Merit]:
    """Run every combination, network by network."""
    keys = [
        (law, clamp, network, hand)
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
        # the drift of the first seed: it is the law's, not the link's
        found.append(Merit(*key, runs, figures_of(runs, drift_m(some[0]))))
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
    return Spread(statistics.median(known), min(known), max(known)) if known else None


def ranked(merits: Sequence[Merit], network: Network) -> list[Candidate]:
    """Return the laws over a network as candidates of `studies.advice`, all hands together, the one to take first."""
    runs: dict[tuple[str, bool], list[CellResult]] = {}
    for merit in merits:
        if merit.network == network:
            runs.setdefault((merit.law, merit.clamp), []).extend(merit.results)
    found = [Candidate(*key, results[0].cell.settings, tuple(results)) for key, results in runs.items()]
    return sorted(found, key=lambda candidate: (candidate.price(), len(candidate.failed)))


def in_words(merits: Sequence[Merit]) -> list[str]:
    """Return three sentences: what to take over constant links, over random ones, and what to take nowhere."""
    networks = list(dict.fromkeys(merit.network for merit in merits))
    tables = {network: ranked(merits, network) for network in networks}
    words = []
    for random, name in ((False, "Over a constant link"), (True, "Over a link with jitter and loss")):
        parts = [_choice(network, tables[network]) for network in networks if network.random is random]
        if parts:
            words.append(f"{name} take {'; '.join(parts)}.")
    names = [name_of(candidate) for candidate in tables[networks[0]]]
    never = [
        name for name in names if all(c.failed for network in networks for c in tables[network] if name_of(c) == name)
    ]
    words.append(
        f"On none of these networks held all runs of {', '.join(never)}."
        if never
        else "Every law held with all hands on one of these networks at least."
    )
    return words


def name_of(candidate: Candidate) -> str:
    """Return law and clamp in words."""
    return f"{candidate.law} with the clamp {'on' if candidate.clamp else 'off'}"


def _choice(network: Network, candidates: Sequence[Candidate]) -> str:
    best = candidates[0]
    if best.failed:
        return f"at {network} none (the nearest is {name_of(best)}: {best.failed[0].reason})"
    share = best.force_share()
    return f"at {network} {name_of(best)} ({100.0 * share:.0f} % of the force, peak {best.peak_share():.2f})"
