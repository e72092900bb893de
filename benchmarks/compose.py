"""What containers cost: the age of the loop under compose, as a ratio to the rig on the bare machine.

    python benchmarks/compose.py [--rounds N] [--first N] [--json]

The benchmark runs the session of Fig. 12 in turn on the bare machine as it is, on the bare machine without real-time
scheduling, and under `compose.yaml` with the present images (`make images`), and takes the medians over the rounds. The
engine reports in `node/health` whether it grants real-time scheduling; if it does not, the second row is the fair
baseline.

With `--first` it runs N sessions as a newcomer does, `docker compose up` with page and report from nothing, and counts
the verdicts and the missed deadlines.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from telenano.signals import children

ROOT = Path(__file__).resolve().parents[1]
PROJECT = f"telenano-bench-{os.getpid()}"
NODES = ("haptic_node", "controller_master", "delay_node", "controller_slave", "afm_node", "recorder")
ORDINARY = ("--set", "realtime.scheduler=normal", "--set", "realtime.memory_lock=off")
SESSION = ("--scenario", "fig12", "--json")


def compose_command() -> list[str]:
    """Return the command of compose v2 if it is installed, else docker-compose."""
    has_v2 = children.run(["docker", "compose", "version"], capture_output=True).returncode == 0
    command = ["docker", "compose"] if has_v2 else ["docker-compose"]
    return [*command, "-p", PROJECT, "-f", "compose.yaml"]


def said(*command: str) -> str:
    """Run a command in the project and return its output."""
    done = children.run(
        command, cwd=ROOT, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )  # fmt: skip
    return done.stdout.strip()


def bare(*options: str) -> dict[str, Any]:
    """Return the summary of a session on the bare machine."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "telenano", "up", *SESSION, "--out", folder, "--overwrite", *options]
        done = children.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return dict(json.loads(done.stdout))


def composed() -> dict[str, Any]:
    """Return the summary of a session in containers, which are made for it and removed afterwards."""
    compose = compose_command()

    try:
        said(*compose, "up", "-d", *NODES)
        return dict(json.loads(said(*compose, "run", "--rm", "-T", "session", "telenano", "up", "--attach", *SESSION)))
    finally:
        said(*compose, "down", "-v")


def first() -> dict[str, Any]:
    """Return the summary of `docker compose up` from nothing, with the page and the report."""
    compose, out = compose_command(), ROOT / "out"
    before = set(out.glob("*/summary.json"))

    try:
        said(*compose, "up", "-d")
        said("docker", "wait", said(*compose, "ps", "-q", "session"))
    finally:
        said(*compose, "down", "-v")
    (made,) = set(out.glob("*/summary.json")) - before
    found: dict[str, Any] = json.loads(made.read_text("utf-8"))
    shutil.rmtree(made.parent)
    return found


def report_first(sessions: int, *, as_json: bool) -> None:
    """Run first sessions; print their verdicts, late deadlines, rate and age."""
    summaries = [first() for _ in range(sessions)]
    verdicts = Counter(summary["verdict"] for summary in summaries)
    late = [summary["overruns"] for summary in summaries]
    ages_ms = [summary["loop_age_ms"]["p99"] for summary in summaries]
    rate_hz = statistics.median(summary["rate_hz"]["haptic/state"] for summary in summaries)
    report = {
        "verdicts": dict(verdicts), "late_deadlines": {"median": statistics.median(late), "most": max(late)},
        "loop_age_p99_ms": statistics.median(ages_ms), "rate_hz": rate_hz,
    }  # fmt: skip
    if as_json:
        print(json.dumps(report))
        return
    print(f"{sessions} first sessions: {', '.join(f'{count} {verdict}' for verdict, count in verdicts.items())}")
    print(f"late deadlines: {statistics.median(late):g} in the middle session, {max(late)} in the worst")
    print(f"loop: {rate_hz:.0f} Hz, {statistics.median(ages_ms):.2f} ms old at 99 %")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="sessions of each way")
    parser.add_argument("--first", type=int, default=0, metavar="N", help="count how N first sessions end, and no more")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args()
    if given.smoke:
        given.rounds = 1
    if shutil.which("docker") is None:
        sys.exit("docker is not installed, so there is nothing to compare with")
    if given.first:
        report_first(given.first, as_json=given.json)
        return
    ways = {"bare": bare, "bare_normal": lambda: bare(*ORDINARY), "compose": composed}
    found: dict[str, list[dict[str, Any]]] = {way: [] for way in ways}
    for _ in range(given.rounds):
        for way, session in ways.items():
            found[way].append(session())
    report: dict[str, Any] = {}
    for way, summaries in found.items():
        report[way] = {key: statistics.median(s["loop_age_ms"][key] for s in summaries) for key in ("p50", "p99")}
        report[way] |= {
            key: statistics.median(s[key] or 0.0 for s in summaries) for key in ("hold_ratio", "contact_x_cm")
        }
    for base in ("bare", "bare_normal"):
        report[f"compose_to_{base}"] = {key: report["compose"][key] / report[base][key] for key in ("p50", "p99")}
    if given.json:
        print(json.dumps(report))
        return
    for key, value in report.items():
        print(f"{key:22}" + "  ".join(f"{name} {figure:.3f}" for name, figure in value.items()))


if __name__ == "__main__":
    main()
