"""The dynamic cantilever on the bus: missed deadlines and age of the loop, against the quasi-static one.

    python benchmarks/dynamic_node.py [--rounds N] [--duration S] [--steps N ...] [--json]

Both are `telenano up fig12` with its cantilever of 40 N/m and 150 kHz pressed into contact. They take turns:
quasi-static, then dynamic with each number of steps a period, in the opposite order in every second round. For the
instrument a missed deadline is a step that comes 2 ms or more after the one before it according to `afm/state`, while
the tip follows the hand. For all other nodes it is what they report (a period late or more) between their first and
last report in that time. Beside each session an empty loop of the highest priority runs on each processor: if one of
them was held up during a late step as well, the step is counted as the machine's. The age of the loop is that of the
recording. Differences are taken within a round, with Wilcoxon's signed-rank test of whether the dynamic cantilever has
more.

Before that the benchmark measures, without a rig, the time that this machine needs for a millisecond of the cantilever,
in contact and tapping, and the part of it for which a command waits.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, cast

from empty_loop import EmptyLoops

from telenano.afm.sim import simulated_afm
from telenano.devices.afm.instrument import dynamic_afm
from telenano.recording.reader import Recording
from telenano.sections.afm_section import AfmConfig
from telenano.signals import children
from telenano.wire import decode
from telenano.wire.messages import AfmState, NodeHealth

LATE_STEP_S = 2e-3
# An empty loop cannot resolve less, because it is itself late by some tens of microseconds.
WITNESS_PERIOD_NS, WITNESS_LATE_NS = 1_000_000, 300_000
OWN, MACHINE, OTHERS = "missed by the instrument", "besides by the machine", "missed by others"
CONTACT_M = 12e-9  # base position for a force of some 20 nN
GAP_M = 15e-9  # gap to a tip that vibrates by 20 nm


def exchange_s(steps: int | None, *, tapping: bool, count: int = 400) -> tuple[float, float]:
    """Return the median times for 1 ms of the cantilever [s]: the whole, and the part for which a command waits.

    Steps None means the quasi-static cantilever, for which a command waits for the whole.
    """
    section: dict[str, Any] = {} if steps is None else {"model": "dynamic", "cantilever": {"steps_per_period": steps}}
    config = AfmConfig.model_validate(section)
    driver: Any = simulated_afm(config.to_params()) if steps is None else dynamic_afm(config)
    driver.open()
    base_m = config.rest_distance_m - GAP_M if tapping else CONTACT_M
    if tapping:
        driver.vibrate(20e-9)
    whole, waited = [], []
    for turn in range(count):
        begun = time.perf_counter()
        if steps is not None:
            while driver.settle():
                pass
            driver.elapse(1e-3)
        asked = time.perf_counter()
        driver.exchange(base_m + 1e-11 * (turn % 2))
        ended = time.perf_counter()
        whole.append(ended - begun)
        waited.append(ended - asked)
    return statistics.median(whole[count // 4 :]), statistics.median(waited[count // 4 :])


def measure_rig(duration_s: float, steps: int | None) -> dict[str, float]:
    """Return age of the loop [ms] and missed deadlines of a session.

    Raises SystemExit if the rig fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": os.environ.get("TELENANO_RUNTIME_DIR", folder)}
        command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--headless", "--no-view"]
        command += ["--duration", str(duration_s), "--out", str(out)]
        if steps is not None:
            command += ["--set", "afm_node.model=dynamic", "--set", f"afm_node.cantilever.steps_per_period={steps}"]
        with EmptyLoops(WITNESS_PERIOD_NS, WITNESS_LATE_NS) as witness:
            done = children.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 3):
            raise SystemExit(f"the rig ended with exit code {done.returncode}: {done.stderr or done.stdout}")
        age: dict[str, float] = json.loads(done.stdout)["loop_age_ms"]
        recording = Recording(out / "session.mcap")
        following: list[tuple[int, float]] = []
        reports: dict[str, list[tuple[int, int]]] = {}
        for message in recording.messages(["node/health", "afm/state"]):
            if message.channel.via == "link":
                continue
            if message.topic == "afm/state":
                state = cast(AfmState, decode("afm/state", message.payload))
                if state.mode == "follow":
                    following.append((message.publish_ns, state.step_s))
            else:
                health = cast(NodeHealth, decode("node/health", message.payload))
                reports.setdefault(health.src, []).append((message.publish_ns, health.overruns))
        begin_ns, end_ns = following[0][0], following[-1][0]
        late = [(ended_ns - round(step_s * 1e9), ended_ns) for ended_ns, step_s in following if step_s >= LATE_STEP_S]
        held_up = [any(stall.last_ns > a and stall.first_ns < b for stall in witness.stalls) for a, b in late]
        missed = 0
        for rows in reports.values():
            counts = [count for time_ns, count in rows if begin_ns <= time_ns <= end_ns]
            missed += counts[-1] - counts[0] if counts else 0
        return {**age, "steps": len(following), OWN: len(late) - sum(held_up), MACHINE: sum(held_up), OTHERS: missed}


def measure(rounds: int, duration_s: float, steps: list[int]) -> dict[str, Any]:
    """Return all results: the rounds by number of steps (0: quasi-static), and the exchanges [ms]."""
    exchanges = {str(n): {} for n in (0, *steps)}
    for n in (0, *steps):
        for name in ("contact", "tapping") if n else ("contact",):
            whole, waited = exchange_s(n or None, tapping=name == "tapping")
            exchanges[str(n)].update({name: 1e3 * whole, f"{name}, a command waits": 1e3 * waited})
    runs: dict[str, list[dict[str, float]]] = {str(n): [] for n in (0, *steps)}
    for turn in range(rounds):
        for n in (0, *steps)[:: -1 if turn % 2 else 1]:
            runs[str(n)].append(measure_rig(duration_s, n or None))
            # Thus a measurement that is ended early still has its sessions on stderr.
            print(json.dumps({"steps a period": n, **runs[str(n)][-1]}), file=sys.stderr, flush=True)
    return {"exchange_ms": exchanges, "rounds": runs}


def more_of(key: str, runs: list[dict[str, float]], base: list[dict[str, float]]) -> str:
    """Return the differences of the rounds in words, with the probability of at least as many more by chance."""
    from scipy.stats import wilcoxon

    differences = [run[key] - other[key] for run, other in zip(runs, base, strict=True)]
    chance = float(wilcoxon(differences, alternative="greater").pvalue) if any(differences) else 1.0
    more, fewer = (sum(sign * value > 0 for value in differences) for sign in (1, -1))
    median = statistics.median(differences)
    return f"{key}: median {median:+.3g}, more in {more} and fewer in {fewer} of {len(runs)} rounds, p = {chance:.2f}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="turns of each model")
    parser.add_argument("--duration", type=float, default=5.0, help="length of a session [s]")
    parser.add_argument("--steps", type=int, nargs="+", default=[96], help="steps a period of the dynamic model")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.rounds, given.duration = 1, 1.5
    found = measure(given.rounds, given.duration, given.steps)
    if given.json:
        print(json.dumps(found))
        return
    for n, times in found["exchange_ms"].items():
        label = "quasi-static" if n == "0" else f"dynamic, {n} steps"
        print(f"{label:20} a millisecond takes", ", ".join(f"{value:.3f} ms ({name})" for name, value in times.items()))
    base = found["rounds"]["0"]
    keys = list(base[0])
    print(f"\n{'median of the rounds':20}" + "".join(f"{key:>26}" for key in keys))
    for n, runs in found["rounds"].items():
        label = "quasi-static" if n == "0" else f"dynamic, {n} steps"
        print(f"{label:20}" + "".join(f"{statistics.median(run[key] for run in runs):26.3f}" for key in keys))
        if n != "0":
            ratios = (
                statistics.median(run[key] for run in runs) / max(statistics.median(run[key] for run in base), 1e-9)
                for key in ("p50", "p99")
            )
            print(f"{'':20} age: p50 x {next(ratios):.2f}, p99 x {next(ratios):.2f}")
            for key in ("p50", "p99", OWN, MACHINE, OTHERS):
                print(f"{'':20} {more_of(key, runs, base)}")
            print(f"{'':20} {OWN}: {[run[OWN] for run in runs]}, quasi-static {[run[OWN] for run in base]}")


if __name__ == "__main__":
    main()
