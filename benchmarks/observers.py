"""What observers that read everything cost a running rig: none, connected to its nodes, and through its shared reader.

`python benchmarks/observers.py --observers 20 --rounds 3` runs sessions of the three kinds in turn, and prints the age
of the loop and the rate of the hand of each, and the ratio to the sessions without observers.
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
from typing import Any

from services.signals import children

KINDS = ("none", "direct", "shared")
# The sessions begin some seconds after the processes; the observers connect when the rig runs.
START_S, MARGIN_S = 4.0, 2.0
# They have imported all that they need when the rig starts: that takes more processor time than to listen.
OBSERVER = """
import sys
from presets import DEFAULT_SITE_FILE
from services.runtime.wiring.observer import Observer
from services.runtime.wiring.main import load_site
print("ready", flush=True)
sys.stdin.readline()
observer, count = Observer(load_site(DEFAULT_SITE_FILE), shared=sys.argv[1] == "shared"), 0
for _ in observer.listen(float(sys.argv[2])):
    count += 1
print(count)
"""


def session(kind: str, observers: int, duration_s: float, folder: Path) -> dict[str, Any]:
    """Run a session with its observers, and return what its summary says of the loop."""
    environment = {**os.environ, "TELENANO_RUNTIME_DIR": str(folder / "run")}
    command = [sys.executable, "-m", "telenano", "up", "--scenario", "fig12", "--json", "--out", str(folder / kind)]
    command += ["--overwrite", "--duration", str(duration_s)]
    listening_s = duration_s - MARGIN_S
    # They are as important as those of a person: ordinary processes.
    reader = [sys.executable, "-c", OBSERVER, kind, str(listening_s)]
    pipe = subprocess.PIPE
    count = observers if kind != "none" else 0
    readers = [children.start(reader, env=environment, stdin=pipe, stdout=pipe, text=True) for _ in range(count)]
    for each in readers:
        assert each.stdout is not None
        each.stdout.readline()
    rig = children.start(command, env=environment, stdout=pipe, text=True)
    time.sleep(START_S)
    for each in readers:
        assert each.stdin is not None
        each.stdin.write("go\n")
        each.stdin.flush()
    received = [int(each.communicate()[0] or 0) for each in readers]
    out, _ = rig.communicate()
    summary = json.loads(out)
    return {
        "kind": kind,
        "p50_ms": summary["loop_age_ms"]["p50"],
        "p99_ms": summary["loop_age_ms"]["p99"],
        "max_ms": summary["loop_age_ms"]["max"],
        "hand_hz": summary["rate_hz"]["haptic/state"],
        "tip_hz": summary["rate_hz"]["afm/state"],
        "received_hz": round(statistics.mean(received) / listening_s) if received else 0,
    }


def main() -> None:
    """Run the sessions in turn and print them, then the medians."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--observers", type=int, default=20, help="processes that read every topic")
    parser.add_argument("--rounds", type=int, default=3, help="sessions of each kind, in turn")
    parser.add_argument("--duration", type=float, default=10.0, help="length of a session [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object of the medians alone")
    given = parser.parse_args()
    if given.smoke:
        given.observers, given.rounds, given.duration = 2, 1, MARGIN_S + 1.0
    rows = []
    with tempfile.TemporaryDirectory(prefix="tno-") as folder:
        for _ in range(given.rounds):
            for kind in KINDS:
                rows.append(session(kind, given.observers, given.duration, Path(folder)))
                if not given.json:
                    print(json.dumps(rows[-1]), flush=True)
    found = {}
    for kind in KINDS:
        own = [row for row in rows if row["kind"] == kind]
        found[kind] = {name: statistics.median(row[name] for row in own) for name in own[0] if name != "kind"}
    for kind in KINDS[1:]:
        for name in ("p50_ms", "p99_ms"):
            found[kind][f"{name}_ratio"] = round(found[kind][name] / found["none"][name], 2)
    print(json.dumps({"observers": given.observers, "rounds": given.rounds, "median": found}))


if __name__ == "__main__":
    main()
