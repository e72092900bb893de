"""Trials of laws on one line, one sample and one instrument, from which a law is recommended.

A trial runs in lockstep on the network and the instrument with several seeds and four hands: one of constant force, and
a soft, an ordinary and a stiff arm whose paths would press with the same force if hand and sample were one. A law is
tried with its defaults, as the benchmark runs it, and in the forms that the benchmark does not run: tuned for the line
by one rule (`tuning`), with the force clamp off and on. A run is good if it is stable by `telenano.analysis.verdict`
and came to rest with the intended force, without striking the sample. Forms that are good in every run are ranked by a
price, the sum of

- the share by which the force at the tip in a hold differs from the intended one, with the worst of the arms,
- the share by which the greatest force at the tip exceeds the hand's,
- the share by which the stiffness that the hand feels in the hold differs from that of the sample, and
- FREE_PRICE for each time that free motion is heavier than the default of 100 N s/m.
"""

import math
import statistics
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from telenano.sections import LAWS
from telenano.settings import Option, profile_named
from telenano.settings import Settings as StrictSettings
from telenano.wire import ConfigError
from telenano_lab.studies.loops.cells import (
    DEFAULT_STIFFNESS,
    Cell,
    CellResult,
    Conditions,
    Environment,
    Hand,
    scales_of,
)
from telenano_lab.studies.loops.sweep import Sweep
from telenano_lab.studies.loops.tuning import Settings, tuned
from telenano_lab.studies.option_values import (
    COMPARED_LAWS,
    LONGEST_MS,
    STIFFEST_N_PER_M,
    Jitter,
    disturbances_of,
    jitters,
    losses,
)
from telenano_lab.studies.repetitions import Statistic, share, statistic

FREE_PRICE = 0.02
# One-sided walls at the tip, by name [N/m].
WALLS_N_PER_M = {"soft": 5.0, "ordinary": 20.0, "stiff": 80.0}
_FREE_N_S_PER_M = 100.0
_LEVELS_N: dict[str, float] = {**dict.fromkeys(DEFAULT_STIFFNESS, 1.0), "tip_sample": 2.0}
# Every law with its defaults (clamp None), and those of the comparisons tuned with the force clamp off and on.
TRIED_LAWS = (*COMPARED_LAWS, *(law for law in LAWS if law not in COMPARED_LAWS))
CANDIDATES: tuple[tuple[str, bool | None], ...] = (
    *((law, None) for law in TRIED_LAWS),
    *((law, clamp) for clamp in (False, True) for law in COMPARED_LAWS),
)


class Question(StrictSettings):
    """The network, the sample and the instrument for which a law is sought."""

    network: Annotated[str | None, Option(("--network",), "NAME")] = Field(
        default=None,
        description="Network from the list of `telenano link profile`, instead of --delay, --jitter and --loss",
    )
    round_trip_ms: Annotated[float, Option(("--delay",), "MS", written="that of --network")] = Field(
        default=math.nan, ge=0.0, le=LONGEST_MS, description="Round trip of the network [ms]"
    )
    jitter: Annotated[Jitter, Option(("--jitter",), "MS", lambda text: jitters(text)[0], written="0")] = Field(
        default=Jitter(), description="Half-width of uniform jitter each way [ms], or n% of the delay"
    )
    loss: Annotated[float, Option(("--loss",), "SHARE", lambda text: losses(text)[0], written="0")] = Field(
        default=0.0, description="Messages lost each way, 0 to 1, or n%"
    )
    environment: Environment = Field(default="wall", description=Conditions.model_fields["environment"].description)
    sample: Literal["soft", "ordinary", "stiff"] = Field(
        default="ordinary", description="soft: 5 N/m, ordinary: 20 N/m, stiff: 80 N/m at the tip"
    )
    stiffness_n_per_m: Annotated[float | None, Option(("--stiffness",), "N/M")] = Field(
        default=None, gt=0.0, le=STIFFEST_N_PER_M, description="Stiffness at the tip [N/m], instead of --sample"
    )
    instrument: Annotated[str, Option(("--instrument",), "NAME")] = Field(
        default="real", description="Named disturbances of the AFM: ideal, real, real_drifting, paper_bridge"
    )
    seeds: int = Field(default=3, ge=1, le=1000, description="Seeds of a random network or instrument")

    @model_validator(mode="before")
    @classmethod
    def _of_network(cls, given: Any) -> Any:
        """Fill in the mean round trip of a named network; ConfigError for neither a network nor a delay, or both."""
        name = given.get("network")
        own = [key for key in ("round_trip_ms", "jitter", "loss") if given.get(key) is not None]
        if name is None and "round_trip_ms" not in own:
            raise ConfigError("--delay or --network is needed: the round trip [ms], or a network")
        if name is None:
            return given
        if own:
            raise ConfigError(
                f"--network {name} has its own delay, jitter and loss; leave --delay, --jitter and --loss"
            )
        return {**given, "network": name.lower(), "round_trip_ms": profile_named(name).round_trip_ms}

    @property
    def tip_n_per_m(self) -> float:
        """K of the sample, or k of the cantilever in the contact [N/m]."""
        return WALLS_N_PER_M[self.sample] if self.stiffness_n_per_m is None else self.stiffness_n_per_m


@dataclass(frozen=True)
class Candidate:
    """A law with its settings and the results of its cells; clamp None is the law with its defaults."""

    law: str
    clamp: bool | None
    settings: Settings
    results: tuple[CellResult, ...]

    @property
    def name(self) -> str:
        return self.law if self.clamp is None else f"{self.law} with the clamp {'on' if self.clamp else 'off'}"

    def as_flags(self) -> str:
        """Return the options with which `telenano up` runs this law with these settings."""
        keys = [("law", self.law), *self.settings]
        values = ((key, str(value).lower() if isinstance(value, bool) else value) for key, value in keys)
        return " ".join(f"--set controller.{key}={value}" for key, value in values)

    @property
    def failed(self) -> list[CellResult]:
        return [result for result in self.results if result.outcome != "stable"]

    @property
    def free_n_s_per_m(self) -> float:
        """The damping of free motion at the hand [N s/m]: B_v over the gain of the hand's force."""
        section = self.results[0].cell.controller().law_config()
        gain = getattr(section, "force_gain", 1.0) or 1.0
        return float(section.damping_n_s_per_m / gain)

    def force_share(self) -> float:
        """Return the force at the tip in a hold over the intended one, of the run in which it is furthest from 1."""
        shares = [(r.tip_n or 0.0) / _LEVELS_N[r.cell.environment] for r in self.results]
        return max(shares, key=lambda share: abs(share - 1.0))

    def peak_share(self) -> float:
        """Return the greatest force at the tip over that of the hand."""
        return max((r.peak_n or 0.0) / _LEVELS_N[r.cell.environment] for r in self.results)

    def felt_share(self) -> float | None:
        """Return the stiffness that the hand feels in a hold over that of the sample, the median of the runs.

        The hand presses with F_m and has moved by F / K beyond the touch, and by its lead over the tip.
        """
        shares = [(r.hand_n or 0.0) / moved for r in self.results if (moved := _moved_n(r)) > 0.0]
        return statistics.median(shares) if shares else None

    def apart_share(self) -> float | None:
        """Return by how much hand and tip are apart in a hold, over the indentation, the median of the runs."""
        pressed = [r for r in self.results if (r.tip_n or 0.0) > 0.0]
        return statistics.median(abs(_moved_n(r) / (r.tip_n or 1.0) - 1.0) for r in pressed) if pressed else None

    def lowest_energy_j(self) -> float:
        return min(result.lowest_energy_j for result in self.results)

    def price(self) -> float:
        """Return the price by which suited laws are ranked; infinite for a law with a run that is not good."""
        if self.failed:
            return math.inf
        free = FREE_PRICE * (self.free_n_s_per_m / _FREE_N_S_PER_M - 1.0)
        felt = abs((self.felt_share() or 0.0) - 1.0)
        return abs(self.force_share() - 1.0) + max(self.peak_share() - 1.0, 0.0) + felt + free

    def over_seeds(self) -> dict[str, Statistic]:
        """Return statistics over the seeds, of each seed the worst of its hands; empty for a single seed."""
        seeds = dict.fromkeys(result.cell.seed for result in self.results)
        if len(seeds) < 2:
            return {}
        parts = [
            Candidate(self.law, self.clamp, self.settings, tuple(r for r in self.results if r.cell.seed == seed))
            for seed in seeds
        ]
        return {
            "stable_share": share(sum(not part.failed for part in parts), len(parts)),
            "force_share": statistic([part.force_share() for part in parts]),
            "peak_share": statistic([part.peak_share() for part in parts]),
            "lowest_energy_j": statistic([part.lowest_energy_j() for part in parts]),
        }

    def over_seeds_as_dict(self) -> dict[str, dict[str, Any]]:
        """Return `over_seeds` for JSON and tables."""
        return {name: over_seeds._asdict() for name, over_seeds in self.over_seeds().items()}

    def as_dict(self) -> dict[str, Any]:
        price = self.price()
        return {
            "law": self.law,
            "clamp": self.clamp,
            "settings": dict(self.settings),
            "suited": not self.failed,
            "price": price if math.isfinite(price) else None,
            "stable_runs": len(self.results) - len(self.failed),
            "runs": len(self.results),
            "force_share": self.force_share(),
            "peak_share": self.peak_share(),
            "felt_share": self.felt_share(),
            "apart_share": self.apart_share(),
            "free_n_s_per_m": self.free_n_s_per_m,
            "lowest_energy_j": self.lowest_energy_j(),
            "over_seeds": self.over_seeds_as_dict(),
            "reason": self.failed[0].reason if self.failed else "",
        }


def _moved_n(result: CellResult) -> float:
    """Return K times the way of the hand beyond the touch in a hold, at the scale of the hand [N]."""
    scales = scales_of(result.cell.controller())
    stiffness = result.cell.stiffness_n_per_m * scales.force_scale * scales.position_scale
    return (result.tip_n or 0.0) + stiffness * (result.apart_m or 0.0)


def cells_of(question: Question, law: str, clamp: bool | None) -> list[Cell]:
    """Return the cells of a candidate: every hand with every seed.

    Args:
        question: The network, the sample and the instrument.
        law: The law.
        clamp: Whether the force clamp is on, with the law tuned for the network; None for the law with its defaults.
    """
    jitter_ms = question.jitter.at_ms(question.round_trip_ms)
    longest_s = 1e-3 * (question.round_trip_ms + 2.0 * jitter_ms)
    settings: Settings = ()
    if clamp is not None:
        settings = (*tuned(law, question.tip_n_per_m, longest_s), ("clamp.enabled", clamp))
    disturbances = disturbances_of(question.instrument)
    random = jitter_ms > 0.0 or question.loss > 0.0 or question.network is not None or bool(disturbances)
    return [
        Cell(
            law=law,
            environment=question.environment,
            hand=hand,
            round_trip_ms=question.round_trip_ms,
            stiffness_n_per_m=question.tip_n_per_m,
            jitter_ms=jitter_ms,
            loss=question.loss,
            seed=seed,
            network=question.network,
            settings=settings,
            disturbances=disturbances,
        )
        for hand in get_args(Hand)
        for seed in range(question.seeds if random else 1)
    ]


def try_all(question: Question, sweep: Sweep) -> list[Candidate]:
    """Try every candidate, in the order of CANDIDATES, except those that equal their law with its defaults."""
    prepared = [(law, clamp, cells_of(question, law, clamp)) for law, clamp in CANDIDATES]
    prepared = [one for one in prepared if one[1] is None or not _is_as_it_comes(one[2][0])]
    results = iter(sweep.run([cell for *_, cells in prepared for cell in cells]))
    return [
        Candidate(law, clamp, cells[0].settings, tuple(next(results) for _ in cells)) for law, clamp, cells in prepared
    ]


def _is_as_it_comes(cell: Cell) -> bool:
    """Return whether the settings of a cell leave its law as it is by default."""
    changed, plain = cell.controller(), cell.model_copy(update={"settings": ()}).controller()
    return (changed.params(), changed.clamp_params()) == (plain.params(), plain.clamp_params())
