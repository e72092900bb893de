"""Ten minutes of the whole rig at 1 kHz: memory must not grow, nothing be lost, the rate hold.

    python benchmarks/soak.py [--duration S] [--out DIR] [--json]

Runs `telenano up` with a hand that presses, holds and lets go every ten seconds, and judges the session by its own
recording. Exit code 1 when a bound is missed.
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

from proto import TOPICS
from services.launcher.plan import SCENARIO_DIRECTORY
from services.recorder.reader import Recording

# caches, free lists and the recorder's buffers find their size in the first part of a run
SETTLED_S = 60.0
LARGEST_GROWTH_BYTES = 1_000_000
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


def growth_bytes(recording: Recording, settled_s: float) -> dict[str, float]:
    """Give for each node how much its memory grew [bytes] from `settled_s` on, by a straight line through it."""
    samples: dict[str, list[tuple[int, int]]] = {}
    for message in recording.messages(["node/health"]):
        samples.setdefault(message.src, []).append((message.publish_ns, message.fields()["memory_bytes"]))
    grown = {}
    for node, pairs in samples.items():
        t_s, size = (np.array(pairs, dtype=float) * (1e-9, 1.0)).T
        late = t_s - t_s[0] >= settled_s
        if late.sum() > 10:
            slope = np.polyfit(t_s[late] - t_s[0], size[late], 1)[0]
            grown[node] = float(slope * (t_s[late][-1] - t_s[late][0]))
    return grown


def judge(folder: Path, settled_s: float) -> dict[str, Any]:
    """Give the figures of a session and whether they are within the bounds."""
    summary = json.loads((folder / "summary.json").read_text())
    grown = growth_bytes(Recording(folder / "session.mcap"), settled_s)
    lossless = {
        n: c
        for n, c in summary["seq_gaps"].items()
        if (t := TOPICS.get(n.partition("@")[0])) and t.delivery == "lossless"
    }
    fast = {
        name: share
        for name, share in summary["completeness"].items()
        if TOPICS[name.partition("@")[0]].rate_hz == 1000.0
    }
    worst = max(grown, key=lambda node: grown[node])
    slowest = min(fast, key=lambda name: fast[name])
    return {
        "duration_s": summary["duration_s"],
        "stable": summary["stable"],
        "memory_growth_mb": {node: round(size * 1e-6, 3) for node, size in sorted(grown.items())},
        "largest_growth_mb": round(grown[worst] * 1e-6, 3),
        "lossless_gaps": lossless,
        "least_rate_share": fast[slowest],
        "slowest": slowest,
        "loop_age_ms": summary["loop_age_ms"],
        "overruns": summary["overruns"],
        "passed": grown[worst] < LARGEST_GROWTH_BYTES
        and not any(lossless.values())
        and fast[slowest] >= LEAST_RATE_SHARE,
    }


def run(duration_s: float, out: Path, settled_s: float) -> dict[str, Any]:
    """Run the rig and judge it; CalledProcessError when it failed."""
    out.mkdir(parents=True, exist_ok=True)
    file = out / "soak.yaml"
    file.write_text(yaml.safe_dump(scenario(duration_s)))
    command = [sys.executable, "-m", "services.launcher", "up", "--scenario", str(file), "--json"]
    subprocess.run([*command, "--out", str(out), "--overwrite"], check=True, stdout=subprocess.DEVNULL)
    return judge(out, settled_s)


def main() -> int:
    """Run, print, and say by the exit code whether the bounds were kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--duration", type=float, default=600.0, help="length of the session [s]")
    parser.add_argument("--out", type=Path, help="folder of the recording; default: one that is removed again")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        figures = run(given.duration, given.out or Path(name), min(SETTLED_S, given.duration / 4))
    if given.json:
        print(json.dumps(figures))
    else:
        for key, value in figures.items():
            print(f"{key:20}{value}")
    return 0 if figures["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())
