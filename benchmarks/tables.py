"""Make the tables of docs/performance.md and performance-measured.md from one run of the benchmarks: `make bench`.

    python benchmarks/tables.py [--only loop,lockstep] [--smoke] [--json]

The scripts run one after the other, a quarter of an hour in all, on a machine that has to be quiet. Each table replaces
the text between its marks in the page that has them; a script that fails leaves its table unchanged, and its name is
printed.
"""

import argparse
import json
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import growth
import late_cycles

from telenano.signals import children

FOLDER = Path(__file__).resolve().parent
PAGES = tuple(FOLDER.parent / "docs" / name for name in ("performance.md", "performance-measured.md"))
Figures = Mapping[str, Any]


class Table(NamedTuple):
    """A table of a page: the script, its arguments, and the function that makes lines from its results."""

    script: str
    arguments: tuple[str, ...]
    lines: Callable[[Figures], list[str]]


def table(head: str, rows: list[str]) -> list[str]:
    """Return the lines of a Markdown table."""
    return [head, "|---" * (head.count("|") - 1) + "|", *rows]


def loop_lines(found: Figures) -> list[str]:
    """Return the age of the loop and its floors, processor time, start, and the parts of a hop."""
    names = {"plain": "sockets, plain", "placed": "sockets, placed", "zeromq": "ZeroMQ, placed", "rig": "the whole rig"}
    rows = []
    for name, label in names.items():
        age, ratio = found["age_ms"][name], found["ratio"].get(name, {"p50": 1.0, "p99": 1.0})
        rows.append(f"| {label} | {age['p50']:.2f} | {age['p99']:.2f} | {ratio['p50']:.1f} | {ratio['p99']:.1f} |")
    lines = table("| age of the loop | p50 [ms] | p99 [ms] | rig / it, p50 | p99 |", rows)
    share = found["processor_percent"]
    used = ", ".join(f"{node.partition('@')[0]} {value:.0f}" for node, value in sorted(share.items()))
    lines += ["", f"Processor time [% of one]: {sum(share.values()):.0f} in all ({used})."]
    return [*lines, *(f"From the command to the {what}: {took:.2f} s." for what, took in found["start_s"].items())]


def parts_lines(found: Figures) -> list[str]:
    """Return the parts of a hop."""
    parts = list(dict.fromkeys(part for row in found["parts_us"].values() for part in row))
    rows = [
        f"| {node} | " + " | ".join(f"{row[part]:.0f}" if part in row else "" for part in parts) + " |"
        for node, row in found["parts_us"].items()
    ]
    return table("| median of a hop [us] | " + " | ".join(parts) + " |", rows)


def peers_lines(found: Figures) -> list[str]:
    """Return the age of the loop over each transport."""
    rows = []
    for name, age in found["age_ms"].items():
        ratio = found["rig_ratio"][name]
        label = "the whole rig" if name == "rig" else name
        rows.append(f"| {label} | {age['p50']:.2f} | {age['p99']:.2f} | {ratio['p50']:.1f} | {ratio['p99']:.1f} |")
    missing = [f"Not installed: {', '.join(found['missing'])}."] if found["missing"] else []
    return [*table("| eight hops over | p50 [ms] | p99 [ms] | rig / it, p50 | p99 |", rows), *missing]


def lockstep_lines(found: Figures) -> list[str]:
    """Return the simulated seconds a second, one row for each law."""
    environments = list(dict.fromkeys(row["environment"] for row in found["rows"]))
    speed = {(row["law"], row["environment"]): row["ratio"] for row in found["rows"]}
    laws = dict.fromkeys(row["law"] for row in found["rows"])
    rows = [f"| {law} | " + " | ".join(f"{speed[law, place]:.0f}" for place in environments) + " |" for law in laws]
    return table("| times real time | " + " | ".join(environments) + " |", rows)


def late_lines(found: Figures) -> list[str]:
    """Return the late cycles of each loop."""
    return table(late_cycles.HEAD, ["| " + " | ".join(late_cycles.cells(row)) + " |" for row in found["rows"]])


def growth_lines(found: Figures) -> list[str]:
    """Return a table for each quantity that grows, with the sentences on the point at which the rig fails."""
    lines: list[str] = []
    for axis, figures in found["axes"].items():
        columns = growth.columns_of(figures["rows"])
        head = " | ".join(("", growth.AXES[axis].several, *columns, "")).strip(" ")
        rows = ["| " + " | ".join(growth.cells(row, columns)) + " |" for row in figures["rows"]]
        lines += [f"{growth.AXES[axis].title.capitalize()}:", "", *table(head, rows), "", *figures["stops"], ""]
    return lines[:-1]


_LOOP = ("--rounds", "1", "--duration", "4")
TABLES = {
    "loop": Table("loop.py", _LOOP, loop_lines),
    "parts": Table("loop.py", _LOOP, parts_lines),
    "peers": Table("peers.py", _LOOP, peers_lines),
    "late": Table("late_cycles.py", ("--quick",), late_lines),
    "growth": Table("growth.py", ("--quick",), growth_lines),
    "lockstep": Table("lockstep.py", ("--session-s", "10", "--repeats", "9"), lockstep_lines),
}


def machine() -> str:
    """Return a sentence that names the machine and the commit of the measurements."""
    lines = _text("/proc/cpuinfo").splitlines()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    model = next(named, platform.machine())
    commit = children.run(["git", "rev-parse", "--short", "HEAD"], cwd=FOLDER, capture_output=True, text=True)
    return (
        f"Measured on {datetime.now(UTC):%Y-%m-%d} at {commit.stdout.strip() or 'an unknown commit'}: {model},"
        f" {len(os.sched_getaffinity(0))} processors, Linux {platform.release()}, Python {platform.python_version()};"
        f" load {os.getloadavg()[0]:.1f} before it."
    )


def _text(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError:
        return ""


def figures_of(script: str, arguments: tuple[str, ...]) -> Figures | str:
    """Return the results that a script prints as JSON, or the reason why it has none."""
    command = [sys.executable, str(FOLDER / script), *arguments, "--json"]
    # The scripts import each other.
    environment = {**os.environ, "PYTHONPATH": str(FOLDER)}
    done = children.run(command, capture_output=True, text=True, cwd=tempfile.gettempdir(), env=environment)
    if done.returncode:
        return done.stderr.strip().rpartition("\n")[2] or f"exit code {done.returncode}"
    found: Figures = json.loads(done.stdout.splitlines()[-1])
    return found


def replaced(text: str, name: str, lines: list[str]) -> str:
    """Return a page with new lines between its marks of this name; unchanged if it has no such marks."""
    begin, end = f"<!-- {name} begins -->", f"<!-- {name} ends -->"
    before, found, rest = text.partition(begin)
    if not found or end not in rest:
        return text
    return before + "\n".join([begin, "", *lines, "", end]) + rest.partition(end)[2]


def main() -> int:
    """Run the scripts, and replace the tables in the pages."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", default=",".join(TABLES), help="tables to make, of " + ",".join(TABLES))
    parser.add_argument("--smoke", action="store_true", help="the shortest run of each; no page is changed")
    parser.add_argument("--json", action="store_true", help="print one JSON object of all figures")
    given = parser.parse_args()
    wanted = {name: TABLES[name] for name in given.only.split(",")}
    where, found = machine(), dict[tuple[str, tuple[str, ...]], Figures | str]()
    for name, chosen in wanted.items():
        arguments = ("--smoke",) if given.smoke else chosen.arguments
        key, begun = (chosen.script, arguments), time.monotonic()
        if key not in found:
            found[key] = figures_of(*key)
            print(f"{name}: {chosen.script} took {time.monotonic() - begun:.0f} s", file=sys.stderr)
        figures = found[key]
        if isinstance(figures, str):
            print(f"{chosen.script} failed: {figures}", file=sys.stderr)
        elif not given.smoke:
            command = f"`python benchmarks/{' '.join((chosen.script, *arguments))}`"
            for page in PAGES:
                page.write_text(replaced(page.read_text(), name, [where, command, "", *chosen.lines(figures)]))
    if given.json:
        print(json.dumps({script: figures for (script, _), figures in found.items()}))
    return int(any(isinstance(figures, str) for figures in found.values()))


if __name__ == "__main__":
    sys.exit(main())
