"""Change one thing of a measured line at a time, and see in lockstep which of them the verdicts come from.

    python -m telenano_lab.studies.loops.line_variants NETWORK [--law LAW,...] [--seeds N] [--period S] [--hold S]

Three groups of variants of a network of telenano/settings/networks that `telenano link fit` has made:

- its parts: a constant delay; the usual delays, each message by itself or with their memory; a constant delay with the
  stalls, whose messages are held or lost; all of it.
- how a round trip is shared: half of everything each way; all that varies and all stalls in one way, the other with
  the least delay alone, as `link fit` does; each stall in both ways at a time.
- what lies between two messages of the log, which are `--period` apart: the delay of the log's messages stays the same,
  and between them it continues as a process whose correlation falls exponentially, as that of the model does; or it is
  linear, or keeps its value; or a part of it flickers from message to message.

Each line is judged over the contact of Fig. 12 with a hand of constant force. The draws of a seed are shared by all
variants of a group in which they can be.
"""

import argparse
import functools
import json
import math
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import special

from telenano.link import Outages, stream
from telenano.lockstep import Schedule
from telenano.settings import LinkSettings, profile_named
from telenano.wire import ConfigError
from telenano_lab.studies.loops.cells import Cell, CellResult, rig_of, run_cell, settle_s, settle_ticks
from telenano_lab.studies.loops.network import CONTACT_N_PER_M

_TICK_S = 1e-3
Way = dict[str, Any]


class Variant(NamedTuple):
    """A variant: its group, its name, and the settings of both directions, with the delay over time [s] in a file."""

    group: str
    name: str
    forward: Way
    backward: Way


def half_of(link: dict[str, Way]) -> Way:
    """Return the settings of one direction with half of the variation and half as many stalls as the round trips have.

    Args:
        link: The settings of both directions: alike, or all variation forward and a constant delay backward.
    """
    way, back = link["forward"], link.get("backward", {})
    if back.keys() - {"delay_s"}:
        return way
    pairs = (pair.split(":") for pair in way["jitter"]["quantiles"].split(","))
    halves = ",".join(f"{share}:{0.5 * (float(value) + back.get('delay_s', 0.0)):.6g}" for share, value in pairs)
    half: Way = {**way, "jitter": {**way["jitter"], "quantiles": halves}}
    if "outage" in way:
        half["outage"] = {**way["outage"], "mean_up_s": 2.0 * way["outage"]["mean_up_s"]}
    if "gilbert_elliott" in way:
        half["gilbert_elliott"] = {**way["gilbert_elliott"], "p": 0.5 * way["gilbert_elliott"]["p"]}
    return half


def variants(way: Way, period_s: float, seed: int, length_s: float, folder: Path) -> Iterator[Variant]:
    """Yield the variants of a line whose two directions are alike; traces are written into the folder.

    Args:
        way: The settings of one direction, with jitter.quantiles and perhaps outage and losses.
        period_s: The time between two messages of the underlying log [s].
        seed: The seed of the draws.
        length_s: The time for which the line is used [s].
        folder: The folder for the traces.
    """
    shares, usual_s = np.array([pair.split(":") for pair in way["jitter"]["quantiles"].split(",")], dtype=float).T
    rest: Way = {key: way[key] for key in ("queue", "outage", "gilbert_elliott", "order") if key in way}
    stalls: Way = {key: way[key] for key in ("queue", "outage") if key in way}
    constant: Way = {"delay_s": float(np.interp(0.5, shares, usual_s))}
    drawn: Way = {"jitter": {key: value for key, value in way["jitter"].items() if "correlation" not in key}}
    lost = {**constant, "outage": {**way.get("outage", {}), "mode": "drop"}}
    parts: dict[str, Way] = {
        "constant delay": constant,
        "usual delays, each by itself": drawn,
        "usual delays with memory": {"jitter": way["jitter"], "order": "link"},
        "constant delay, stalls that hold": {**constant, **stalls},
        "constant delay, stalls that lose": lost,
        "all of it": way,
    }
    for name, part in parts.items():
        yield Variant("parts", name, part, part)

    whole_s = usual_s + (usual_s - usual_s[0])
    text = ",".join(f"{share:g}:{value:.6g}" for share, value in zip(shares, whole_s, strict=True))
    least: Way = {"delay_s": float(usual_s[0])}
    every: Way = {**way, "jitter": {**way["jitter"], "quantiles": text}}
    both = way
    if "outage" in way:
        outage = way["outage"]
        every = {**every, "outage": {**outage, "mean_up_s": 0.5 * outage["mean_up_s"]}}
        both = {**way, "outage": {"schedule": stalls_of_both(outage, seed, length_s), "mode": "hold"}}
    yield Variant("sharing", "half of it each way", way, way)
    yield Variant("sharing", "all of it forward", every, least)
    yield Variant("sharing", "all of it backward", least, every)
    yield Variant("sharing", "half of the delay each way, stalls both ways at a time", both, both)

    courses = [
        between(_time_of_neighbours_s(way["jitter"], period_s), period_s, seed * 2 + n, length_s) for n in range(2)
    ]
    for name in courses[0]:
        ways = []
        for number, course in enumerate(courses):
            delays_s = np.interp(special.ndtr(course[name]), shares, usual_s)
            file = folder / f"{name.replace(' ', '_')}_{number}.txt"
            rows = (f"{_TICK_S * n:.3f} {value:.7f}\n" for n, value in enumerate(delays_s.tolist()))
            file.write_text("".join(rows), encoding="utf-8")
            ways.append({**rest, "delay_trace": {"file": file.name}})
        yield Variant("between messages of the log", name, *ways)


def _time_of_neighbours_s(jitter: Way, period_s: float) -> float:
    """Return the correlation time [s] of one process whose neighbours correlate as those of the line do."""
    share = jitter.get("second_correlation_share", 0.0)
    rho = (1.0 - share) * math.exp(-period_s / jitter["correlation_time_s"])
    if share:
        rho += share * math.exp(-period_s / jitter["second_correlation_time_s"])
    return -period_s / math.log(rho)


def stalls_of_both(outage: Way, seed: int, length_s: float) -> list[list[float]]:
    """Return stalls of both directions together, (begin, length) [s], as the link's model of outages draws them."""
    forward = {"outage": {**outage, "mean_up_s": 0.5 * outage["mean_up_s"]}}
    settings = LinkSettings.of({"forward": forward}).forward.outage
    model = Outages(settings, 0, stream(seed, "both ways", "outage"))
    stalls, end_ns = [], 0
    while end_ns < 1e9 * length_s:
        # The model draws until it has an outage that ends later than this time.
        model.end_ns(end_ns)
        begin_ns, end_ns = model.state.random[-1]
        stalls.append([1e-9 * begin_ns, 1e-9 * (end_ns - begin_ns)])
    return stalls


def between(time_s: float, period_s: float, seed: int, length_s: float) -> dict[str, np.ndarray[Any, Any]]:
    """Return the normal scores of each tick, by the way in which they continue between the messages of a log.

    All have the same correlation at the lag of a period. The exponential, linear and kept ones also have the same
    values at the messages; in the one with a part that flickers, the rest has twice the correlation time.
    """
    ticks = round(length_s / _TICK_S) + 1
    step = max(1, round(period_s / _TICK_S))
    draw = np.random.default_rng(seed)
    fresh, flicker = draw.standard_normal((2, ticks))

    def process(tau_s: float) -> np.ndarray[Any, Any]:
        rho, scores = math.exp(-_TICK_S / tau_s), np.empty(ticks)
        scores[0] = fresh[0]
        for n in range(1, ticks):
            scores[n] = rho * scores[n - 1] + math.sqrt(1.0 - rho * rho) * fresh[n]
        return scores

    exponential = process(time_s)
    at = np.arange(0, ticks, step)
    steady = math.exp(-0.5 * period_s / time_s)
    return {
        "exponential": exponential,
        "linear": np.interp(np.arange(ticks), at, exponential[at]),
        "kept": exponential[np.arange(ticks) // step * step],
        "a part flickers": math.sqrt(steady) * process(2.0 * time_s) + math.sqrt(1.0 - steady) * flicker,
    }


def main() -> None:
    """Run the variants and print a line for each and each law."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("network")
    parser.add_argument("--law", default="virtual_impedance,wave,passivity")
    parser.add_argument("--seeds", type=_count, default=8)
    parser.add_argument("--period", type=float, default=0.2, help="time between two messages of the log [s]")
    parser.add_argument("--hold", type=float, default=4.0, help="length of the hold that is judged [s]")
    parser.add_argument("--out", type=Path, default=Path("out/variants"))
    chosen = parser.parse_args()
    try:
        _run(chosen)
    except ConfigError as error:
        parser.error(str(error))


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of seeds; give 1 or more")
    return int(text)


def _run(chosen: argparse.Namespace) -> None:
    chosen.out.mkdir(parents=True, exist_ok=True)
    results_of: dict[tuple[str, str, str], list[CellResult]] = {}
    for seed in range(chosen.seeds):
        for key, result in _results(chosen.network, chosen.law.split(","), seed, chosen.period, chosen.hold):
            results_of.setdefault(key, []).append(result)
        rows = [_row(*key, results) for key, results in results_of.items()]
        (chosen.out / "variants.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    for row in rows:
        sys.stdout.write(json.dumps(row) + "\n")


def _results(
    name: str, laws: list[str], seed: int, period_s: float, hold_s: float
) -> Iterator[tuple[tuple[str, str, str], CellResult]]:
    """Run all variants with the draws of a seed; yield group, variant and law with the result."""
    profile = profile_named(name)
    jitter = profile.link.get("forward", {}).get("jitter", {})
    if not {"quantiles", "correlation_time_s"} <= jitter.keys():
        raise ConfigError(
            f"the network {name} has no quantiles and correlation time, as `telenano link fit` makes them"
        )
    cells = [
        Cell(
            law=law, environment="tip_sample", stiffness_n_per_m=CONTACT_N_PER_M, network=name, seed=seed,
            round_trip_ms=profile.round_trip_ms,
        )
        for law in laws
    ]  # fmt: skip
    end_s = cells[0].hold_s()[0] + hold_s
    cells = [cell.model_copy(update={"session_s": end_s}) for cell in cells]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        for one in variants(half_of(profile.link), period_s, seed, settle_s(cells[0]) + end_s + 1.0, folder):
            settings = LinkSettings.of({"seed": seed, "forward": one.forward, "backward": one.backward})
            schedule: Schedule | None = None
            for cell in cells:
                rig = rig_of(cell, cell.hand_points())
                settle = settle_ticks(cell, rig.period_s)
                if schedule is None:
                    schedule = Schedule.of(settings, settle + round(end_s / rig.period_s), rig.period_s, folder)
                yield (
                    (one.group, one.name, cell.law),
                    run_cell(cell, functools.partial(rig.run, schedule, settle)),
                )


def _row(group: str, variant: str, law: str, results: list[CellResult]) -> dict[str, Any]:
    peaks_n = [result.peak_n for result in results if result.peak_n is not None]
    motions_n = [result.peak_to_peak_n for result in results if result.verdict != "guarded"]
    return {
        "group": group,
        "variant": variant,
        "law": law,
        "verdicts": dict(Counter(result.verdict for result in results)),
        "median_peak_to_peak_n": round(float(np.median(motions_n)), 4) if motions_n else None,
        "median_peak_n": round(float(np.median(peaks_n)), 3) if peaks_n else None,
    }


if __name__ == "__main__":
    main()
