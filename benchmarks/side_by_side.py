"""Rigs side by side on one machine, and one rig at other rates: age of the loop, rates and processor time of each.

`python benchmarks/side_by_side.py --rigs 1,2,3 --rates 100,1000,2000` runs sessions in turn, each case once a round. A
case is compared with one rig at 1 kHz of the same round.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from telenano.recording.reader import Recording
from telenano.signals import children
from telenano.wire.nodes import counts_for_process

BASELINE = (1, 1000.0)
# The nodes that are in the loop, or carry its messages.
LOOP = ("haptic_node", "controller", "delay_node", "afm_node")


def start(folder: Path, rate_hz: float, duration_s: float, environment: dict[str, str]) -> subprocess.Popen[str]:
    """Start a session in the background."""
    command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--overwrite"]
    command += ["--out", str(folder), "--duration", str(duration_s), "--set", f"realtime.rate_hz={rate_hz}"]
    pipe = subprocess.PIPE
    return children.start(command, env=environment, stdout=pipe, stderr=subprocess.DEVNULL, text=True)


def figures(summary: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the quantities of a session that are compared."""
    shares: dict[str, list[float]] = {}
    for message in Recording(folder / "session.mcap").messages(["node/health"]):
        fields = message.fields()
        counts = counts_for_process(message.src, fields.get("shares_with"))
        if message.src.partition("@")[0] in LOOP and fields["state"] == "running" and counts:
            shares.setdefault(message.src, []).append(fields["cpu_percent"])
    age, rates = summary["loop_age_ms"], summary["rate_hz"]
    return {
        "p50_ms": age["p50"],
        "p99_ms": age["p99"],
        "hand_hz": rates["haptic/state"],
        "tip_hz": rates["afm/state"],
        "overruns": summary["overruns"],
        "loop_cpu_percent": round(sum(map(statistics.mean, shares.values()))),
        "verdict": summary["verdict"],
    }


def main() -> None:
    """Run the sessions in turn and print each rig, then the medians of each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", default="1,2", help="numbers of rigs at once, at 1 kHz")
    parser.add_argument("--rates", default="", help="rates [Hz] of one rig by itself")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--duration", type=float, default=8.0, help="length of a session [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object of the medians alone")
    given = parser.parse_args()
    if given.smoke:
        given.rigs, given.rounds, given.duration = "1", 1, 2.0
    cases = [(int(number), 1000.0) for number in given.rigs.split(",") if number]
    cases += [(1, float(rate)) for rate in given.rates.split(",") if rate]
    cases = list(dict.fromkeys([BASELINE, *cases]))
    found: dict[tuple[int, float], list[dict[str, Any]]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory(prefix="tns-") as base:
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": f"{base}/run"}
        for _ in range(given.rounds):
            for case in cases:
                folders = [Path(base) / str(number) for number in range(case[0])]
                rigs = [start(folder, case[1], given.duration, environment) for folder in folders]
                summaries = [json.loads(rig.communicate()[0]) for rig in rigs]
                rows = [figures(*row) for row in zip(summaries, folders, strict=True)]
                found[case] += rows
                if not given.json:
                    print(json.dumps({"rigs": case[0], "rate_hz": case[1], "found": rows}), flush=True)
    cases_found = []
    for case, rows in found.items():
        numbers = [name for name in rows[0] if name != "verdict"]
        medians = {name: statistics.median(row[name] for row in rows) for name in numbers}
        baseline = statistics.median(row["p99_ms"] for row in found[BASELINE])
        medians["p99_ratio"] = round(medians["p99_ms"] / baseline, 2)
        verdicts = sorted({row["verdict"] for row in rows})
        cases_found.append({"rigs": case[0], "rate_hz": case[1], "median": medians, "verdicts": verdicts})
    for row in [{"cases": cases_found}] if given.json else cases_found:
        print(json.dumps(row))


if __name__ == "__main__":
    main()
