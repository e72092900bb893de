"""What particles take of the instrument's step, and how fast the environment to learn in runs.

    python benchmarks/particles.py [--steps 4000] [--rounds 9] [--rigs 6] [--json]

The step is one of the simulated instrument as the node calls it: without particles, with 50 that it does not touch, and
with 50 of which it pushes one. Rounds alternate, and the shortest counts. The environment is compared with real time,
by itself and as 64 rows of one step. With --rigs, whole rigs without particles and with 50 of them take turns, for the
age of the loop and the share of late messages.
"""

import argparse
import json
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import gymnasium
import numpy as np
from loop import PACED, RigRun, measure_rig
from telenano_lab.learning import PUSH
from telenano_lab.learning.engine import CONTROL_S
from telenano_lab.learning.push_env import PushVectorEnv

from telenano.devices.afm.instrument import driver_of
from telenano.sections.afm_section import AfmConfig
from telenano.settings.config import validate

ROWS = 64
_PRESSED_M = 30e-9


def instrument(count: int) -> Any:
    """Return a simulated instrument over `count` particles; one of them lies at (-1 um, 0)."""
    places = [[-1e-6, 0.0], *([-9e-6 + 2e-6 * (i % 10), 2e-6 + 1.5e-6 * (i // 10)] for i in range(count - 1))]
    particles = {"particles": {"places": places}} if count else {}
    section = {
        "sample": {"name": "flat", "size_m": 24e-6, "pixels": 16, **particles},
        "cantilever": {"stiffness_n_per_m": 1.0},
        "meniscus": False,
        "safety": {"base_min_m": -1e-6, "retract_position_m": -7e-7},
    }
    device = driver_of(validate(AfmConfig, section, "a benchmark", "afm_node"))
    device.open()
    return device


def sweep(device: Any, steps: int, y_m: float) -> None:
    """Drive the tip along a line on the substrate, 2 nm a step."""
    for i in range(steps):
        device.move_to(-2e-6 + 2e-9 * i, y_m)
        device.elapse(1e-3)
        device.exchange(_PRESSED_M)


def best_s(runs: dict[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Return the shortest processor time of each run [s]; they take turns, and the first round does not count."""
    found = dict.fromkeys(runs, float("inf"))
    for number in range(rounds + 1):
        for name, run in runs.items():
            begin = time.thread_time()
            run()
            took = time.thread_time() - begin
            found[name] = min(found[name], took) if number else found[name]
    return found


def step_us(steps: int, rounds: int) -> dict[str, float]:
    """Return the time of a step [us] without particles, with 50, and pushing one of 50."""
    runs: dict[str, Callable[[], object]] = {
        "none": lambda: sweep(instrument(0), steps, 0.5e-6),
        "50 of them": lambda: sweep(instrument(50), steps, 0.5e-6),
        "pushing one of 50": lambda: sweep(instrument(50), steps, 0.0),
    }
    made = best_s({name: lambda n=n: instrument(n) for name, n in zip(runs, (0, 50, 50), strict=True)}, 3)  # type: ignore[misc]
    return {name: 1e6 * (took - made[name]) / steps for name, took in best_s(runs, rounds).items()}


def times_real_time(steps: int, rounds: int) -> dict[str, float]:
    """Return the simulated seconds a second of the environment by itself, and of its 64 rows."""
    one, many = gymnasium.make(PUSH, longest_s=3600.0), PushVectorEnv(ROWS, longest_s=60.0)
    one.reset(seed=1)
    many.reset(seed=1)
    # The action moves the tip across the particle and back, down on the substrate.
    action = np.array([0.6, 0.0, -1.0], np.float32)
    batch = np.tile(action, (ROWS, 1))

    def single() -> None:
        for i in range(steps):
            if one.step(action if i % 100 < 50 else -action)[2]:
                one.reset(seed=1)

    def rows() -> None:
        for i in range(max(steps // ROWS, 1)):
            many.step(batch if i % 100 < 50 else -batch)

    took = best_s({"one": single, f"{ROWS} rows": rows}, rounds)
    simulated_s = {"one": steps * CONTROL_S, f"{ROWS} rows": max(steps // ROWS, 1) * ROWS * CONTROL_S}
    return {name: simulated_s[name] / took[name] for name in took}


def rig_turns(turns: int, duration_s: float) -> dict[str, Any]:
    """Return medians of the age of the loop [ms] and of the share of late messages, without particles and with 50."""
    flat = ["--scenario", "assembly", "--set", "afm_node.sample.size_m=24e-6", "--no-view", "--set"]
    rigs = {
        "none": [*flat, "afm_node.sample.particles=null"],
        "50 of them": [*flat, "afm_node.sample.particles.count=50"],
    }
    runs: dict[str, list[RigRun]] = {name: [] for name in rigs}
    for number in range(turns):
        for name in sorted(rigs, reverse=bool(number % 2)):
            runs[name].append(measure_rig(duration_s, trace=False, words=rigs[name]))
    age = {
        name: {key: median(run.age_ms[key] for run in done) for key in ("p50", "p99")} for name, done in runs.items()
    }
    late = {name: {key: median(run.late_share[key] for run in done) for key in PACED} for name, done in runs.items()}
    ratio = {key: age["50 of them"][key] / age["none"][key] for key in ("p50", "p99")}
    by_turn = [b.age_ms["p50"] / a.age_ms["p50"] for a, b in zip(*runs.values(), strict=True)]
    return {"age_ms": age, "age_ratio": ratio, "age_ratio_by_turn": sorted(by_turn), "late_share": late}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=4000, help="steps of a round")
    parser.add_argument("--rounds", type=int, default=9, help="rounds, of which the shortest counts")
    parser.add_argument("--rigs", type=int, default=0, metavar="TURNS", help="turns of whole rigs, half a minute each")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    steps, rounds = (400, 1) if given.smoke else (given.steps, given.rounds)
    step = step_us(steps, rounds)
    found = {
        "step_us": step,
        "ratio": {name: took / step["none"] for name, took in step.items()},
        "more_us": {name: took - step["none"] for name, took in step.items()},
        "times_real_time": times_real_time(steps, rounds),
    }
    if given.rigs:
        found["rig"] = rig_turns(given.rigs, duration_s=10.0)
    if given.json:
        print(json.dumps(found))
        return
    for name, took in step.items():
        print(f"{name:20s} {took:7.1f} us a step, {took - step['none']:6.1f} more, ratio {found['ratio'][name]:.2f}")
    for name, ratio in found["times_real_time"].items():
        print(f"environment, {name:9s} {ratio:7.0f} x real time")
    if given.rigs:
        print(json.dumps(found["rig"], indent=2))


if __name__ == "__main__":
    main()
