"""Stability maps: the delay that each law tolerates, on a grid and to a fraction of a sample, beside the theory."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import Field

from telenano.settings import Option
from telenano.wire import ConfigError
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.cells import DEFAULT_STIFFNESS, Cell, CellResult, Conditions
from telenano_lab.studies.loops.linear_cells import linear_loop, not_linear
from telenano_lab.studies.loops.sweep import Sweep
from telenano_lab.studies.loops.theory import loop_model
from telenano_lab.studies.option_values import Jitter
from telenano_lab.studies.repetitions import Statistic, held_of, statistic


class Axes(Conditions):
    """The grid of a study."""

    laws: Annotated[tuple[str, ...], Option(("--law",), "LAW[,LAW]|all", option_values.laws)] = Field(
        description="Laws to study"
    )
    delays_ms: Annotated[
        tuple[float, ...], Option(("--delay",), "LIST|RANGE", option_values.delays, written="0:200:5")
    ] = Field(default=option_values.delays("0:200:5"), description="Round trips of the link [ms], half of it each way")
    stiffnesses_n_per_m: Annotated[
        tuple[float, ...], Option(("--stiffness",), "LIST|RANGE", option_values.stiffnesses)
    ] = Field(
        default=(),
        description="K of the spring, or k of the cantilever [N/m]; default: 10,20,38 for spring, 40 for tip_sample",
    )
    gains: Annotated[tuple[float | None, ...], Option(("--gain",), "LIST|RANGE", option_values.gains)] = Field(
        default=(None,), description="Force gain K_f, for a law that has one"
    )
    jitters: Annotated[tuple[Jitter, ...], Option(("--jitter",), "LIST", option_values.jitters, written="0")] = Field(
        default=(Jitter(),), description="Half-width of uniform jitter each way [ms], or n% of the delay"
    )
    losses: Annotated[tuple[float, ...], Option(("--loss",), "LIST", option_values.losses, written="0")] = Field(
        default=(0.0,), description="Share of messages lost each way, 0 to 1, or n%"
    )
    seeds: int = Field(
        default=1,
        ge=1,
        le=10_000,
        description="Number of seeds of all random parts, from --seed on: mean and interval over them",
    )

    def lines(self) -> list["Line"]:
        """Return a line for every combination of all values except the delay."""
        springs = self.stiffnesses_n_per_m or DEFAULT_STIFFNESS[self.environment]
        combinations = itertools.product(self.laws, springs, self.gains, self.jitters, self.losses)
        return [Line(self, *values) for values in combinations]

    def check(self) -> list[str]:
        """Return the doubts about the cells, each text once; raise ConfigError for an option that cannot be run."""
        for field, option in (("mass_kg", "--mass"), ("damping_n_s_per_m", "--body-damping")):
            if field in self.model_fields_set and self.environment != "body":
                raise ConfigError(f"{option}: {self.environment} has none; give --environment body")
        is_random = any(jitter != Jitter() for jitter in self.jitters) or any(self.losses) or bool(self.disturbances)
        for field in ("seed", "seeds"):
            if field in self.model_fields_set and not is_random:
                needed = "--jitter, --loss or a disturbance"
                raise ConfigError(f"--{field}: nothing is random without {needed}; give one as well")
        doubts: list[str] = []
        for line in self.lines():
            cell = line.cell(max(self.delays_ms))
            doubts.append(cell.stiffness_doubts())
            cell.hold_s()
            cell.disturbed_instrument(0.0)
        return [text for text in dict.fromkeys(doubts) if text]


@dataclass(frozen=True)
class Line:
    """One law under one set of conditions: the cells of the map along the delay."""

    axes: Axes
    law: str
    stiffness_n_per_m: float
    gain: float | None
    jitter: Jitter
    loss: float

    def cell(self, round_trip_ms: float) -> Cell:
        return Cell(
            **{name: getattr(self.axes, name) for name in Conditions.model_fields},
            law=self.law,
            round_trip_ms=round_trip_ms,
            stiffness_n_per_m=self.stiffness_n_per_m,
            gain=self.gain,
            jitter_ms=self.jitter.at_ms(round_trip_ms),
            loss=self.loss,
        )

    @property
    def is_random(self) -> bool:
        """Whether another seed gives another map."""
        return bool(self.jitter.value or self.loss or self.axes.disturbances)

    @property
    def label(self) -> str:
        parts = [f"{'K' if self.axes.environment == 'spring' else 'k'} = {self.stiffness_n_per_m:g} N/m"]
        parts += [f"K_f = {self.gain:g}"] if self.gain is not None else []
        parts += [f"jitter {self.jitter}"] if self.jitter.value else []
        parts += [f"loss {100.0 * self.loss:g}%"] if self.loss else []
        disturbed = dict.fromkeys(key.partition(".")[0] for key, _ in self.axes.disturbances if key != "seed")
        parts += [f"with {', '.join(disturbed)}"] if disturbed else []
        return ", ".join(parts)


@dataclass(frozen=True)
class LineResult:
    """A line of the map and the delay at which it becomes unstable.

    critical_delay_ms: the round trip of the loop that is neutral, with half a period of hold and the stated latency of
    the devices; compare it with T_c of the theory. critical_link_ms: the part that the link may add. Both are None if
    no cell up to the longest delay is unstable. theory_ms, theory_link_ms: T_c and T_d, None if the law has no such
    loop, or if no delay makes it neutral (`theory_unlimited`). With several seeds, `cells` have the first verdict that
    is not stable at each delay, `stable_shares` the share of stable seeds, and the critical delays are the means over
    the seeds that have one, with the statistic of that of the link in `seeds`.
    """

    line: Line
    cells: tuple[CellResult, ...]
    critical_delay_ms: float | None
    critical_link_ms: float | None
    theory_ms: float | None
    theory_link_ms: float | None
    theory_unlimited: bool = False
    seeds: Statistic | None = None
    stable_shares: tuple[float, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        line = self.line
        return {
            "law": line.law,
            "environment": line.axes.environment,
            "hand": line.axes.hand,
            "stiffness_n_per_m": line.stiffness_n_per_m,
            "gain": line.gain,
            "jitter": str(line.jitter),
            "loss": line.loss,
            "device_latency_ms": line.axes.device_latency_ms,
            **({"disturbances": dict(line.axes.disturbances)} if line.axes.disturbances else {}),
            "critical_delay_ms": self.critical_delay_ms,
            "critical_link_delay_ms": self.critical_link_ms,
            "theory_delay_ms": self.theory_ms,
            "theory_link_delay_ms": self.theory_link_ms,
            "theory_unlimited": self.theory_unlimited,
            "longest_delay_ms": max(line.axes.delays_ms),
            "verdicts": {f"{cell.cell.round_trip_ms:g}": cell.verdict for cell in self.cells},
            **({"over_seeds": self._over_seeds()} if self.stable_shares else {}),
        }

    def _over_seeds(self) -> dict[str, Any]:
        shares = {f"{c.cell.round_trip_ms:g}": share for c, share in zip(self.cells, self.stable_shares, strict=True)}
        return {
            "seeds": self.line.axes.seeds,
            "critical_link_delay_ms": self.seeds._asdict() if self.seeds else None,
            "stable_shares": shares,
        }


def run_stability(axes: Axes, sweep: Sweep) -> list[LineResult]:
    """Run the grid, then refine the critical delay of each line; for each seed, if anything is random."""
    seeded = [axes.model_copy(update={"seed": axes.seed + number}).lines() for number in range(axes.seeds)]
    runs = [draws if draws[0].is_random else draws[:1] for draws in zip(*seeded, strict=True)]
    results = iter(_run([line for draws in runs for line in draws], sweep))
    return [_over_seeds([next(results) for _ in draws]) for draws in runs]


def _run(lines: Sequence[Line], sweep: Sweep) -> list[LineResult]:
    delays = sorted(set(lines[0].axes.delays_ms))
    grid = [line.cell(delay) for line in lines for delay in delays]
    results = sweep.run(grid)
    rows = [tuple(results[i : i + len(delays)]) for i in range(0, len(results), len(delays))]
    edges = find_edges(lines, rows, sweep)
    return [line_result(line, row, edge) for line, row, edge in zip(lines, rows, edges, strict=True)]


def _over_seeds(draws: Sequence[LineResult]) -> LineResult:
    """Return the common result of the draws of a line."""
    first = draws[0]
    if len(draws) == 1:
        return first
    columns = list(zip(*(draw.cells for draw in draws), strict=True))
    edges = [draw.critical_link_ms for draw in draws if draw.critical_link_ms is not None]
    whole = [draw.critical_delay_ms for draw in draws if draw.critical_delay_ms is not None]
    return replace(
        first,
        cells=tuple(next((cell for cell in cells if cell.verdict != "stable"), cells[0]) for cells in columns),
        critical_delay_ms=statistic(whole).mean if whole else None,
        critical_link_ms=statistic(edges).mean if edges else None,
        seeds=statistic(edges) if edges else None,
        stable_shares=tuple(held_of(cell.verdict for cell in cells).share for cells in columns),
    )


@dataclass(frozen=True)
class Edge:
    """Delays in samples: `low` is stable (-1: no stable one is known), `high` is not."""

    low: int
    high: int

    @property
    def middle(self) -> int | None:
        """The next delay to compute; None if there is none between."""
        return (self.low + self.high) // 2 if self.high - self.low > 1 else None


def find_edges(lines: Sequence[Line], rows: Sequence[tuple[CellResult, ...]], sweep: Sweep) -> list[float | None]:
    """Return for each line the round trip of the link [ms] at which the loop is neutral; None if no cell is unstable.

    A constant delay acts in whole samples, so the search goes over samples. Between the last stable and the first
    unstable number the growth rate is taken as linear in the delay, and its zero is the edge.
    """
    edges = {i: edge for i, row in enumerate(rows) if (edge := _bracket(lines[i], row)) is not None}
    while middles := {i: edge.middle for i, edge in edges.items() if edge.middle is not None}:
        results = sweep.run([lines[i].cell(_ms(lines[i], samples)) for i, samples in middles.items()])
        for (i, samples), result in zip(middles.items(), results, strict=True):
            stable = result.verdict == "stable"
            edges[i] = Edge(samples, edges[i].high) if stable else Edge(edges[i].low, samples)
    ends = [lines[i].cell(_ms(lines[i], max(0, k))) for i, edge in edges.items() for k in (edge.low, edge.high)]
    growths = [result.growth_per_s for result in sweep.run(ends)]
    growths_at = {i: growths[2 * n : 2 * n + 2] for n, i in enumerate(edges)}
    return [_ms(line, 1) * neutral(edges[i], *growths_at[i]) if i in edges else None for i, line in enumerate(lines)]


def neutral(edge: Edge, low_growth_per_s: float | None, high_growth_per_s: float | None) -> float:
    """Return the number of samples, with its fraction, at which the growth rate passes zero.

    It may lie up to one interval beyond either end: near neutral a small motion counts as stable while it still grows a
    little, and an end that counts as a limit cycle may still die out very slowly.
    """
    if edge.low < 0:
        return 0.0
    low, high = low_growth_per_s, high_growth_per_s
    if low is None or high is None or not low < high:
        return 0.5 * (edge.low + edge.high)
    share = min(max(-low / (high - low), -1.0), 2.0)
    return edge.low + share * (edge.high - edge.low)


def _bracket(line: Line, row: Sequence[CellResult]) -> Edge | None:
    samples = [int(cell.cell.round_trip_ms / _ms(line, 1) + 1e-9) for cell in row]
    unstable = [i for i, cell in enumerate(row) if cell.verdict != "stable"]
    if not unstable:
        return None
    first = unstable[0]
    return Edge(samples[first - 1] if first else -1, samples[first])


def _ms(line: Line, samples: int) -> float:
    return samples * line.cell(0.0).controller().period_s * 1e3


def line_result(line: Line, cells: tuple[CellResult, ...], link_ms: float | None) -> LineResult:
    """Return a line with its cells and its edge, which was found at link_ms [ms], beside the theory."""
    theory_s, theory_link_s = theory_of(line)
    # The gain of the loop never reaches 1, so that no delay makes it neutral.
    unlimited = theory_s is not None and math.isinf(theory_s)
    inside_ms = 0.5 * _ms(line, 1) + line.axes.device_latency_ms
    return LineResult(
        line,
        cells,
        link_ms + inside_ms if link_ms is not None else None,
        link_ms,
        theory_s * 1e3 if theory_s is not None and math.isfinite(theory_s) else None,
        theory_link_s * 1e3 if theory_link_s is not None and math.isfinite(theory_link_s) else None,
        unlimited,
    )


def theory_of(line: Line) -> tuple[float | None, float | None]:
    """Return T_c and T_d [s] of a line; None unless law and environment form a linear loop with a constant delay."""
    cell = line.cell(0.0)
    if loop_model(line.law, cell.controller().law_config(), line.stiffness_n_per_m) is None:
        return None, None
    if line.jitter.value or line.loss or not_linear(cell):
        return None, None
    loop = linear_loop(cell)
    # Without a delay of the link, the round trip of the loop is that of the devices.
    return loop.critical_delay_s, max(0.0, loop.critical_link_delay_s - loop.round_trip_s)
