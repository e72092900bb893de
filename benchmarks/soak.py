"""Ten minutes of the whole rig at 1 kHz: memory must not grow, nothing be lost, the rate hold.

    python benchmarks/soak.py [--duration S] [--out DIR] [--json]

Runs `telenano up` with a hand that presses, holds and lets go every ten seconds, and judges the session by its own
recording. Loops that do nothing but keep deadlines (`empty_loop.py`) run beside it: what they lose is the machine's,
and the rig's rate is judged against theirs. A recorder that had to wait for a processor keeps the memory of what queued
up meanwhile, so its growth counts from its longest wait on. Exit code 1 when a bound is missed.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from empty_loop import EmptyLoops

from presets import SCENARIO_DIRECTORY
from proto import TOPICS
from recording.reader import Recording
from services.signals import children
from telenano.cli.exit_codes import EXIT_INCOMPLETE

# caches, free lists and the recorder's buffers find their size in the first part of a run
SETTLED_S = 60.0
MOST_GROWTH_BYTES_PER_MIN = 250_000
# the recorder keeps the index of its chunks, which the file ends with: 2 kB five times a second
MOST_RECORDER_GROWTH_BYTES_PER_MIN = 1_000_000
LEAST_RATE_SHARE = 0.999
CYCLE = ((0.0, 0.0), (1.0, 1.0), (4.0, 1.0), (5.0, 2.0), (7.0, 2.0), (8.0, 0.0), (10.0, 0.0))


def scenario(duration_s: float) -> dict[str, Any]:
    """Give the scenario: the hand's cycle again and again."""
    document: dict[str, Any] = yaml.safe_load((SCENARIO_DIRECTORY / "fig12.yaml").read_text())
    cycles = range(int(duration_s // CYCLE[-1][0]) + 1)
    times = {round(CYCLE[-1][0] * n + at_s, 3): force_n for n in cycles for at_s, force_n in CYCLE}
    points = [{"time_s": at_s, "force_n": force_n} for at_s, force_n in times.items()]
    document |= {"name": "soak", "description": "endurance of the rig", "duration_s": duration_s}
    document["haptic_node"]["operator"] = {"kind": "force_profile", "points": points}
    return document


def growth_per_min(recording: Recording, settled_s: float) -> tuple[dict[str, float | None], float]:
    """Give how fast the memory of each node grew [bytes/min] from `settled_s` on: the slope of a straight line.

    None where too little is left of a recorder after it was furthest behind, which is given as well [s].
    """
    samples: dict[str, list[tuple[int, int]]] = {}
    behind: dict[str, tuple[int, int]] = {}
    for message in recording.messages(["node/health"]):
        samples.setdefault(message.src, []).append((message.publish_ns, message.fields()["memory_bytes"]))
        if message.src.startswith("recorder"):
            lag_ns = message.log_ns - message.publish_ns
            behind[message.src] = max(behind.get(message.src, (0, 0)), (lag_ns, message.log_ns))
    grown: dict[str, float | None] = {}
    for node, pairs in samples.items():
        t_s, size = (np.array(pairs, dtype=float) * (1e-9, 1.0)).T
        late = (t_s - t_s[0] >= settled_s) & (t_s > behind.get(node, (0, 0))[1] * 1e-9)
        grown[node] = float(60.0 * np.polyfit(t_s[late] - t_s[0], size[late], 1)[0]) if late.sum() > 10 else None
    return grown, max(lag_ns for lag_ns, _ in behind.values()) * 1e-9


def judge(folder: Path, settled_s: float, machine: EmptyLoops) -> dict[str, Any]:
    """Give the figures of a session and whether they are within the bounds."""
    summary = json.loads((folder / "summary.json").read_text())
    recording = Recording(folder / "session.mcap")
    grown, behind_s = growth_per_min(recording, settled_s)
    machine_share = machine.share(*recording.span_ns)
    rows = {name: TOPICS.get(name.partition("@")[0]) for name in summary["seq_gaps"]}
    lossless = {n: summary["seq_gaps"][n] for n, row in rows.items() if row and row.delivery == "lossless"}
    fast = {n: share for n, share in summary["completeness"].items() if (row := rows.get(n)) and row.rate_hz == 1000.0}
    slowest = min(fast, key=lambda name: fast[name])
    within = {
        "memory": all(
            rate < (MOST_RECORDER_GROWTH_BYTES_PER_MIN if node.startswith("recorder") else MOST_GROWTH_BYTES_PER_MIN)
            for node, rate in grown.items()
            if rate is not None
        ),
        "gaps": not any(lossless.values()),
        "rate": fast[slowest] >= LEAST_RATE_SHARE * machine_share,
    }
    return {
        "duration_s": summary["duration_s"],
        "stable": summary["stable"],
        "memory_growth_mb_per_min": {
            node: None if rate is None else round(rate * 1e-6, 3) for node, rate in sorted(grown.items())
        },
        "recorder_behind_s": behind_s,
        "lossless_gaps": lossless,
        "least_rate_share": fast[slowest],
        "slowest": slowest,
        "machine_rate_share": machine_share,
        "rate_to_machine": fast[slowest] / machine_share,
        "loop_age_ms": summary["loop_age_ms"],
        "overruns": summary["overruns"],
        "within": within,
        "passed": all(within.values()),
    }


def run(duration_s: float, out: Path, settled_s: float) -> dict[str, Any]:
    """Run the rig and judge it, also where its recording lacks something; CalledProcessError when it failed."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "soak.yaml"
    file.write_text(yaml.safe_dump(scenario(duration_s)))
    command = [sys.executable, "-m", "telenano", "up", "--scenario", str(file), "--json"]
    with EmptyLoops() as machine:
        done = children.run([*command, "--out", str(out), "--overwrite"], stdout=subprocess.DEVNULL)
    if done.returncode != EXIT_INCOMPLETE:
        done.check_returncode()
    return judge(out, settled_s, machine)


def main() -> int:
    """Run, print, and return an exit code: whether the bounds were kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=600.0, help="length of the session [s]")
    parser.add_argument("--out", type=Path, help="folder of the recording; default: one that is removed again")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.duration = 3.0
    with tempfile.TemporaryDirectory() as name:
        figures = run(given.duration, given.out or Path(name), min(SETTLED_S, given.duration / 4))
    if given.json:
        print(json.dumps(figures))
    else:
        for key, value in figures.items():
            print(f"{key:20}{value}")
    return 0 if figures["passed"] or given.smoke else 1


if __name__ == "__main__":
    sys.exit(main())
