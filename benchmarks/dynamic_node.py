"""The dynamic cantilever on the bus: missed deadlines and age of the loop, against the quasi-static one.

    python benchmarks/dynamic_node.py [--rounds N] [--duration S] [--steps N ...] [--json]

Both are `telenano up --scenario fig12` with its cantilever of 40 N/m and 150 kHz pressed into contact, taken in turns:
quasi-static, then dynamic with each number of steps a period. Of the instrument a missed deadline is a step that comes
2 ms or more after the one before it, as `afm/state` has it; of all other nodes it is what they report (a period late or
more), the first half second left out. The age of the loop is that of the recording. Before that, without a rig: how
long this machine takes for a millisecond of the cantilever, in contact and tapping, and how much of it a command waits
for.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, cast

from proto import decode
from proto.messages import AfmState, NodeHealth
from recording.reader import Recording
from services.afm_node.__main__ import dynamic_afm
from services.afm_node.config import AfmConfig
from services.afm_node.sim import SimulatedAfm

CONTACT_M = 12e-9  # base of some 20 nN
GAP_M = 15e-9  # from a tip that vibrates by 20 nm


def exchange_s(steps: int | None, *, tapping: bool, count: int = 400) -> tuple[float, float]:
    """Return median times of 1 ms of the cantilever [s]: all of it, and what a command waits for.

    Steps None is the quasi-static one, which has no other part.
    """
    section: dict[str, Any] = {} if steps is None else {"model": "dynamic", "cantilever": {"steps_per_period": steps}}
    config = AfmConfig.model_validate(section)
    driver: Any = SimulatedAfm(config.to_params()) if steps is None else dynamic_afm(config)
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
    """Return age of the loop [ms] and missed deadlines of a session."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": os.environ.get("TELENANO_RUNTIME_DIR", folder)}
        command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--headless", "--no-view"]
        command += ["--duration", str(duration_s), "--out", str(out)]
        if steps is not None:
            command += ["--set", "afm_node.model=dynamic", "--set", f"afm_node.cantilever.steps_per_period={steps}"]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 3):
            raise SystemExit(f"the rig ended with exit code {done.returncode}: {done.stderr or done.stdout}")
        age: dict[str, float] = json.loads(done.stdout)["loop_age_ms"]
        recording = Recording(out / "session.mcap")
        begin_ns = recording.span_ns[0] + 500_000_000
        overruns: dict[str, list[int]] = {}
        late = 0
        for message in recording.messages(["node/health", "afm/state"]):
            if message.publish_ns < begin_ns or message.channel.via == "link":
                continue
            if message.topic == "afm/state":
                late += cast(AfmState, decode("afm/state", message.payload)).step_s >= 2e-3
            else:
                health = cast(NodeHealth, decode("node/health", message.payload))
                overruns.setdefault(health.src, []).append(health.overruns)
        missed = sum(counts[-1] - counts[0] for counts in overruns.values())
        return {**age, "missed by the instrument": late, "missed by others": missed}


def measure(rounds: int, duration_s: float, steps: list[int]) -> dict[str, Any]:
    """Return all figures: by number of steps (0: quasi-static) those of each round, and the exchanges [ms]."""
    exchanges = {str(n): {} for n in (0, *steps)}
    for n in (0, *steps):
        for name in ("contact", "tapping") if n else ("contact",):
            whole, waited = exchange_s(n or None, tapping=name == "tapping")
            exchanges[str(n)].update({name: 1e3 * whole, f"{name}, a command waits": 1e3 * waited})
    runs: dict[str, list[dict[str, float]]] = {str(n): [] for n in (0, *steps)}
    for _ in range(rounds):
        for n in (0, *steps):
            runs[str(n)].append(measure_rig(duration_s, n or None))
    return {"exchange_ms": exchanges, "rounds": runs}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="turns of each model")
    parser.add_argument("--duration", type=float, default=5.0, help="length of a session [s]")
    parser.add_argument("--steps", type=int, nargs="+", default=[96], help="steps a period of the dynamic model")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
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
            added = statistics.median(run["p50"] for run in runs) - statistics.median(run["p50"] for run in base)
            print(f"{'':20} age: p50 x {next(ratios):.2f}, p99 x {next(ratios):.2f}; p50 {added:+.3f} ms")


if __name__ == "__main__":
    main()
