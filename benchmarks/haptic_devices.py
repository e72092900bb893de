"""Age of the loop with each haptic device behind its real wire, beside the simulated master, in sessions by turns.

`python benchmarks/haptic_devices.py --rounds 3` runs Fig. 12 with the simulated master, the emulated Inverse3 (whose
service is its own process), and the doubles of libdhd (1 and 4 kHz) and libHD (1 kHz), each once a round. Each result
is the median of the rounds, with its ratio to the simulated master of the same round.
"""

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from side_by_side import figures

from telenano.signals import children

sys.path.append(str(Path(__file__).resolve().parents[1] / "packages" / "telenano-devices" / "tests"))

BASELINE = "simulated"
CASES = {"simulated": 1000, "haply": 1000, "dhd": 1000, "dhd at 4 kHz": 4000, "hd": 1000}
AGES = ("p50_ms", "p99_ms")


def settings_of(case: str, service: str) -> list[str]:
    """Return the options of `telenano up` for a case."""
    if case == BASELINE:
        return []
    from telenano_devices.doubles.libraries import build

    kind = case.partition(" ")[0]
    wire = f"haply.service={service}" if kind == "haply" else f"{kind}.library={build(kind)}"
    keys = [f"device={kind}", f"{kind}.rate_hz={CASES[case]}", wire]
    return [word for key in keys for word in ("--set", f"haptic_node.{key}")]


def session(case: str, folder: Path, duration_s: float) -> dict[str, Any]:
    """Run one session of Fig. 12 and return the quantities to compare."""
    telenano = [sys.executable, "-m", "telenano"]
    emulator = None
    service = ""
    if case == "haply":
        command = [*telenano, "device", "simulate", "haply", "--port", "0"]
        emulator = children.start(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert emulator.stdout is not None
        service = re.findall(r"ws://\S+:\d+", emulator.stdout.readline())[0]
    command = [*telenano, "up", "--scenario", "fig12", "--json", "--overwrite", "--headless", "--out", str(folder)]
    command += ["--duration", str(duration_s), *settings_of(case, service)]
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(folder.parent / "run")}
    try:
        done = children.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    finally:
        if emulator is not None:
            with emulator:
                emulator.terminate()
    summary = json.loads(done.stdout)
    return {**figures(summary, folder), "hold_ratio": summary.get("hold_ratio")}


def main() -> None:
    """Run the sessions by turns and print each, then the medians of each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--duration", type=float, default=6.0, help="length of a session [s]")
    parser.add_argument("--cases", default=",".join(CASES), help=f"of {', '.join(CASES)}; the first is always run")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object of the medians alone")
    given = parser.parse_args()
    if given.smoke:
        given.rounds, given.duration, given.cases = 1, 2.0, "haply"
    cases = list(dict.fromkeys([BASELINE, *given.cases.split(",")]))
    if unknown := set(cases) - set(CASES):
        parser.error(f"there is no case {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    found: dict[str, list[dict[str, Any]]] = {case: [] for case in cases}
    with tempfile.TemporaryDirectory(prefix="tnd-") as base:
        for number in range(given.rounds):
            # Each round begins with another case, so that none always has the same place in it.
            for case in cases[number % len(cases) :] + cases[: number % len(cases)]:
                row = session(case, Path(base) / "session", given.duration)
                found[case].append(row)
                if not given.json:
                    print(json.dumps({"case": case, **row}), flush=True)
    medians = {}
    for case, rows in found.items():
        names = [name for name in rows[0] if name != "verdict" and rows[0][name] is not None]
        medians[case] = {name: statistics.median(row[name] for row in rows) for name in names}
        for age in AGES:
            ratios = [row[age] / own[age] for row, own in zip(rows, found[BASELINE], strict=True)]
            medians[case][f"{age.partition('_')[0]}_ratio"] = round(statistics.median(ratios), 2)
    for record in [{"cases": medians}] if given.json else [{"case": case, **row} for case, row in medians.items()]:
        print(json.dumps(record))


if __name__ == "__main__":
    main()
