"""The age of the zero-delay loop, as a ratio to the same hops without the project's work in the same run.

    python benchmarks/loop.py [--rounds N] [--duration S] [--processes node|site|paired] [--json]
    python benchmarks/loop.py --processes paired [--rate HZ] [--page] [--burner]

For the floors (`chains.py`), five processes pass bytes of the sizes of our messages along the eight hops of the loop
(hand, master half, link, slave half, AFM, slave half, link, master half, hand), paced at 1 kHz, and do nothing else.
They use connected Unix-domain sockets, `plain` like any program and `placed` under the scheduling that the rig's nodes
ask for; and, placed, `zeromq`, with a subscriber that drains everything in the place of the recorder. For the rig,
`telenano up fig12`, the benchmark reports the age of the loop from its recording, the processor time and memory of each
process from the kernel, and the time to the first tick of the hand. A last run of each round with `hop_trace` in its
nodes measures each part of a hop. All take turns, and the medians of the rounds are compared.

`--processes site` runs the rig with `realtime.processes: site`, the nodes of each site in one process, beside the same
recorder and launcher. `--processes paired` compares both ways, with no floors: each round has a rig of either kind, and
one more of either in the opposite order (A B B A); the ratio is that of the pairs. `--rate` is the rate of the loop,
and the rates reached at hand and tip are reported; `--page` keeps an observer's page open, whose server counts to the
processor time; `--burner` runs a process beside the rig that burns a core (`burner.py`). Late cycles are those of the
hand that ended more than 1 ms after the median of their run (`cycles.py`).
"""

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from burner import burning
from chains import ages_ms, measure_sockets, measure_zeromq
from cycles import LATE_MS, Cycle, Late, cycles_of, later_than, responses_ms, runs_in_million
from hop_trace import PARTS
from soak import open_page

from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.recording.reader import Recording
from telenano.runtime.loop.realtime import shallow_idle
from telenano.signals import children
from telenano.wire import decode
from telenano.wire.messages import HapticState

FLOORS = {
    "plain": ("sockets, plain", lambda ticks: measure_sockets(ticks, placed=False)),
    "placed": ("sockets, placed", lambda ticks: measure_sockets(ticks, placed=True)),
    "zeromq": ("ZeroMQ, placed", lambda ticks: measure_zeromq(ticks, placed=True)),
}
TRACED_NODE = Path(__file__).parent / "traced_node"
# How the nodes of a rig are put into processes, the values of `realtime.processes`.
PROCESSES = ("node", "site")
FIGURES = ("p50", "p99", "max")
# These topics are published once each millisecond.
PACED = ("haptic/state", "afm/state")


class RigRun(NamedTuple):
    """The results of one run of the rig.

    `age_ms`: age of the loop [ms]. `processor_percent`: share of one core [%], `memory_mb`: memory [MB], by process.
    `start_s`: time from the command to the first sample of the hand, and to the first tick of its programme [s].
    `parts_us`: parts of a hop [us] by process, empty in a run without trace. `late_share`: share of late messages for
    the topics in PACED. `cycles`: those of the hand in the session. `age_parts_ms`: contributions to the median age.
    `turns_us`: time of a turn in a traced process of a site, by node and cause. `rate_hz`: the rates reached at hand
    and tip.
    """

    age_ms: dict[str, float]
    processor_percent: dict[str, float]
    memory_mb: dict[str, float]
    start_s: dict[str, float]
    parts_us: dict[str, dict[str, float]]
    late_share: dict[str, float]
    cycles: list[Cycle]
    age_parts_ms: dict[str, float]
    turns_us: dict[str, float]
    rate_hz: dict[str, float]


class Load(NamedTuple):
    """The rate of a rig [Hz], and what runs beside it: a page, and a process that burns a core."""

    rate_hz: float = 1000.0
    page: bool = False
    burner: bool = False

    @property
    def period_ns(self) -> int:
        """The period of the loop [ns]."""
        return round(1e9 / self.rate_hz)


USUAL = Load()


def measure_rig(
    duration_s: float,
    *,
    trace: bool,
    words: Sequence[str] = ("--scenario", "fig12"),
    processes: str = "node",
    load: Load = USUAL,
) -> RigRun:
    """Run a rig with these words once; with `trace` the time of each part of a hop is in its logs.

    `processes`: "node" for one process per node, "site" for one per site. Raises SystemExit if the rig fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        environment = {**os.environ, "TELENANO_RUNTIME_DIR": folder}
        command = [sys.executable, "-m", "telenano", "up", *words, "--json", "--set", f"realtime.processes={processes}"]
        command += ["--duration", str(duration_s), "--out", str(out)]
        if load.rate_hz != USUAL.rate_hz:
            command += ["--set", f"realtime.rate_hz={load.rate_hz:g}"]
        if trace:
            before = environment.get("PYTHONPATH", "")
            environment["PYTHONPATH"] = os.pathsep.join([str(TRACED_NODE), *([before] if before else [])])
        begin_ns = time.time_ns()
        with contextlib.ExitStack() as beside:
            beside.enter_context(burning(load.burner))
            rig = beside.enter_context(children.start(command, env=environment, stdout=subprocess.PIPE, text=True))
            watch = ProcessWatch(rig.pid)
            beside.callback(watch.end)
            if load.page:
                beside.enter_context(open_page(lambda number: watch.add(number, "page"), environment))
            printed = rig.communicate()[0]
        # With more load than the machine can bear, a recording that lacks something is a result.
        if rig.returncode not in (0, *([EXIT_INCOMPLETE] if load != USUAL else [])):
            raise SystemExit(f"the rig ended with exit code {rig.returncode}")
        recording = Recording(out / "session.mcap")
        start_s = _start_s(recording, begin_ns)
        late = {topic: _late_share(recording, topic, load.period_ns) for topic in PACED}
        share, memory = watch.while_running(duration_s)
        summary, cycles = json.loads(printed), cycles_of(out, load.period_ns)
        rate_hz = {topic: summary["rate_hz"][topic] for topic in PACED}
        parts_ms = {name: parts[0] for name, parts in summary.get("loop_age_parts_ms", {}).items()}
        turns = _logged(out / "logs", "turns")
        turns_us = {turn: us for rows in turns.values() for turn, (count, us) in rows.items() if count > 100}
        traced = _logged(out / "logs", "parts")
        return RigRun(summary["loop_age_ms"], share, memory, start_s, traced, late, cycles, parts_ms, turns_us, rate_hz)


class ProcessWatch:
    """Records processor time [s] and resident memory [MB] of processes and their descendants, from the kernel.

    The processes of a rig each have their own name; those of another group share the name of the group, and their
    numbers are summed.

    Parameters: launcher, the process of the rig; groups, the name of the group of other processes.
    """

    def __init__(self, launcher: int, groups: Mapping[int, str] | None = None) -> None:
        self._groups = {launcher: "", **(groups or {})}
        self._samples: list[tuple[float, dict[str, tuple[float, float]]]] = []
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def add(self, process_id: int, name: str) -> None:
        """Sample this process and its descendants from now on, under one name."""
        self._groups = {**self._groups, process_id: name}

    def end(self) -> None:
        self._ended.set()
        self._thread.join()

    def while_running(self, duration_s: float) -> tuple[dict[str, float], dict[str, float]]:
        """Return the share of a processor [%] and the memory [MB] of each process, while all of them ran."""
        most = max(len(found) for _, found in self._samples)
        whole = [sample for sample in self._samples if len(sample[1]) == most]
        end_s = whole[-1][0]
        # The start of the rig does not count, nor the first second of its session.
        begin = next(place for place, sample in enumerate(whole) if end_s - sample[0] <= duration_s - 1.0)
        return _used(whole[begin:])

    def within(self, begin_s: float, end_s: float) -> tuple[dict[str, float], dict[str, float]]:
        """Return the same for a time on the monotonic clock [s], from the last sample before it to the first after."""
        begin = max((place for place, sample in enumerate(self._samples) if sample[0] <= begin_s), default=0)
        after = (place for place, sample in enumerate(self._samples) if sample[0] >= end_s)
        return _used(self._samples[begin : next(after, len(self._samples)) + 1])

    def _run(self) -> None:
        while not self._ended.wait(0.25):
            found: dict[str, tuple[float, float]] = {}
            for name, (used_s, memory_mb) in self._found():
                before_s, before_mb = found.get(name, (0.0, 0.0))
                found[name] = before_s + used_s, before_mb + memory_mb
            self._samples.append((time.monotonic(), found))

    def _found(self) -> Iterator[tuple[str, tuple[float, float]]]:
        """Yield the name of each process with its processor time [s] and memory [MB]."""
        looks: dict[int, list[str]] = {}
        for folder in Path("/proc").glob("[0-9]*"):
            # A process may end meanwhile.
            with contextlib.suppress(OSError):
                looks[int(folder.name)] = (folder / "stat").read_text().rpartition(")")[2].split()
        for number, after_name in looks.items():
            root = number
            while root not in self._groups and root in looks:
                root = int(looks[root][1])
            if root not in self._groups:
                continue
            with contextlib.suppress(OSError, IndexError):
                used_s = (int(after_name[11]) + int(after_name[12])) / os.sysconf("SC_CLK_TCK")
                pages = int(Path(f"/proc/{number}/statm").read_text().split()[1])
                memory_mb = pages * os.sysconf("SC_PAGE_SIZE") * 1e-6
                yield self._groups[root] or _name_of(Path(f"/proc/{number}")), (used_s, memory_mb)


def _name_of(folder: Path) -> str:
    """Return the name of a process of a rig; OSError or IndexError if the process has ended."""
    words = (folder / "cmdline").read_text().split("\0")
    name = next((word.removeprefix("services.") for word in words if word.startswith("services.")), "")
    site = words[words.index("--site") + 1] if "--site" in words else "master"
    return f"{name or 'launcher'}@{site}"


def _used(samples: Sequence[tuple[float, dict[str, tuple[float, float]]]]) -> tuple[dict[str, float], dict[str, float]]:
    (begin_s, first), (end_s, last) = samples[0], samples[-1]
    share = {name: 100.0 * (last[name][0] - first[name][0]) / (end_s - begin_s) for name in last if name in first}
    return share, {name: memory for name, (_, memory) in last.items()}


def _start_s(recording: Recording, begin_ns: int) -> dict[str, float]:
    found: dict[str, float] = {}
    for message in recording.messages(["haptic/state"]):
        state = cast(HapticState, decode("haptic/state", message.payload))
        found.setdefault("first sample of the hand", (state.t_ns - begin_ns) * 1e-9 - 1e-3 * state.seq)
        if state.session_s >= 0.0:
            found["first tick of its programme"] = (state.t_ns - begin_ns) * 1e-9
            return found
    return found


def _late_share(recording: Recording, topic: str, period_ns: int) -> float:
    """Return the share of the messages of a topic that were sent more than 1.5 periods after the previous one."""
    sent_ns = [message.publish_ns for message in recording.messages([topic])]
    return sum(b - a > 1.5 * period_ns for a, b in pairwise(sent_ns)) / max(len(sent_ns) - 1, 1)


def _logged(logs: Path, key: str) -> dict[str, Any]:
    """Return the values that the log entries have under a key, by node."""
    entries = [json.loads(line) for log in sorted(logs.glob("*.log")) for line in log.read_text().splitlines()]
    return {entry["node"]: entry[key] for entry in entries if key in entry}


def _medians(found: Iterable[Mapping[str, float]]) -> dict[str, float]:
    rows = list(found)
    keys = dict.fromkeys(key for row in rows for key in row)
    return {key: statistics.median(row[key] for row in rows if key in row) for key in keys}


def measure(rounds: int, duration_s: float, processes: str = "node") -> dict[str, Any]:
    """Return all results of the rig with these `processes`, as medians of the rounds."""
    ages: dict[str, list[dict[str, float]]] = {name: [] for name in (*FLOORS, "rig")}
    runs, traced = [], []
    for _ in range(rounds):
        for name, (_, floor) in FLOORS.items():
            with shallow_idle():
                found = ages_ms(floor(round(duration_s * 1000)))
            ages[name].append({"p50": statistics.median(found), "p99": found[int(0.99 * len(found))], "max": found[-1]})
        runs.append(measure_rig(duration_s, trace=False, processes=processes))
        ages["rig"].append(runs[-1].age_ms)
        traced.append(measure_rig(duration_s, trace=True, processes=processes))
    age_ms = {name: _medians(turns) for name, turns in ages.items()}
    ratio = {floor: {key: age_ms["rig"][key] / age_ms[floor][key] for key in FIGURES} for floor in FLOORS}
    nodes = sorted({node for run in traced for node in run.parts_us})
    return {
        "age_ms": age_ms,
        "ratio": ratio,
        "processor_percent": _medians(run.processor_percent for run in runs),
        "memory_mb": _medians(run.memory_mb for run in runs),
        "start_s": _medians(run.start_s for run in runs),
        "parts_us": {node: _medians(run.parts_us[node] for run in traced if node in run.parts_us) for node in nodes},
        "turns_us": _medians(run.turns_us for run in traced),
    }


def _late_in_million(runs: Sequence[RigRun], period_ns: int) -> dict[str, float]:
    """Return the late cycles of the hand in a million, and the interval (95 %) of the number of their runs."""
    late = Late((), 0)
    for run in runs:
        found_ms = responses_ms(run.cycles, period_ns)
        if found_ms.size:
            late += later_than(found_ms, float(np.median(found_ms)) + LATE_MS)
    runs_found = runs_in_million(late)
    return {"cycles": late.in_million, "runs": runs_found.rate, "low": runs_found.low, "high": runs_found.high}


def compare(rounds: int, duration_s: float, load: Load = USUAL) -> dict[str, Any]:
    """Return the results of both ways, and the ratios of their pairs, site to node, A B B A in each round."""
    runs: dict[str, list[RigRun]] = {name: [] for name in PROCESSES}
    traced: dict[str, list[RigRun]] = {name: [] for name in PROCESSES}
    loads = []
    for _ in range(rounds):
        for name in (*PROCESSES, *reversed(PROCESSES)):
            loads.append(os.getloadavg()[0])
            runs[name].append(measure_rig(duration_s, trace=False, processes=name, load=load))
        for name in PROCESSES:
            traced[name].append(measure_rig(duration_s, trace=True, processes=name, load=load))
    totals = {name: [sum(run.processor_percent.values()) for run in found] for name, found in runs.items()}
    pairs = list(zip(runs["site"], runs["node"], strict=True))
    ratios: dict[str, list[float]] = {
        key: [site.age_ms[key] / node.age_ms[key] for site, node in pairs] for key in FIGURES
    }
    ratios["processor"] = [site / node for site, node in zip(totals["site"], totals["node"], strict=True)]
    return {
        "age_ms": {name: _medians(run.age_ms for run in found) for name, found in runs.items()},
        "ratio": {key: statistics.median(values) for key, values in ratios.items()},
        "ratios": ratios,
        "processor_percent": {name: _medians(run.processor_percent for run in found) for name, found in runs.items()},
        "processor_together_percent": {name: statistics.median(values) for name, values in totals.items()},
        "memory_mb": {name: _medians(run.memory_mb for run in found) for name, found in runs.items()},
        "late_share": {name: _medians(run.late_share for run in found) for name, found in runs.items()},
        "rate_hz": {name: _medians(run.rate_hz for run in found) for name, found in runs.items()},
        "late_in_million": {name: _late_in_million(found, load.period_ns) for name, found in runs.items()},
        "age_parts_ms": {name: _medians(run.age_parts_ms for run in found) for name, found in runs.items()},
        "turns_us": {
            "node": _medians({node: sum(us.values()) for node, us in run.parts_us.items()} for run in traced["node"]),
            "site": _medians(run.turns_us for run in traced["site"]),
        },
        "load": loads,
    }


def print_pairs(found: Mapping[str, Any]) -> None:
    """Print the results of `compare`."""
    print(f"{'':28}" + "".join(f"{key:>11}" for key in (*FIGURES, "processor")))
    for name, ages in found["age_ms"].items():
        together = found["processor_together_percent"][name]
        print(
            f"{'a process a ' + name + ', ms, %':28}"
            + "".join(f"{ages[key]:11.3f}" for key in FIGURES)
            + f"{together:11.1f}"
        )
    print(f"{'site / node':28}" + "".join(f"{found['ratio'][key]:11.2f}" for key in (*FIGURES, "processor")))
    for key, values in found["ratios"].items():
        print(f"  {key} of the pairs: {', '.join(f'{value:.2f}' for value in values)}")
    print(f"load before each run: {', '.join(f'{load:.1f}' for load in found['load'])}")
    for title, key in (
        ("processor, %", "processor_percent"),
        ("part of the median age, ms", "age_parts_ms"),
        ("turn, us", "turns_us"),
        ("late share", "late_share"),
        ("rate reached, Hz", "rate_hz"),
        ("late cycles of the hand in a million", "late_in_million"),
    ):
        print(f"\n{title}")
        for name, rows in found[key].items():
            for row, value in rows.items():
                print(f"  a process a {name:6}{row:52}{value:10.3f}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=3, help="turns of floors and rig")
    parser.add_argument("--duration", type=float, default=5.0, help="length of each turn [s]")
    parser.add_argument("--smoke", action="store_true", help="the shortest run, to see that it works")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    about = "whether each node of the rig has a process, or each site, or both ways in turns"
    parser.add_argument("--processes", choices=(*PROCESSES, "paired"), default="node", help=about)
    parser.add_argument("--rate", type=float, default=USUAL.rate_hz, help="rate of the loop [Hz], with paired")
    parser.add_argument("--page", action="store_true", help="keep a page of an observer open, with paired")
    parser.add_argument("--burner", action="store_true", help="burn a core beside the rig, with paired")
    given = parser.parse_args()
    load = Load(given.rate, given.page, given.burner)
    if load != USUAL and given.processes != "paired":
        parser.error("--rate, --page and --burner are for --processes paired: the floors have none of them")
    if given.smoke:
        # The server of a page needs its time to start.
        given.rounds, given.duration = 1, 6.0 if load.page else 1.5
    if given.processes == "paired":
        found = compare(given.rounds, given.duration, load)
    else:
        found = measure(given.rounds, given.duration, given.processes)
    if given.json:
        print(json.dumps(found))
        return
    if given.processes == "paired":
        print_pairs(found)
        return
    print(f"{'':28}" + "".join(f"{key:>9}" for key in FIGURES))
    for name, label in (*((name, label) for name, (label, _) in FLOORS.items()), ("rig", "rig")):
        print(f"{label + ', ms':28}" + "".join(f"{found['age_ms'][name][key]:9.3f}" for key in FIGURES))
    for name, (label, _) in FLOORS.items():
        print(f"{'rig / ' + label:28}" + "".join(f"{found['ratio'][name][key]:9.2f}" for key in FIGURES))
    print(f"\n{'median of a hop, us':28}" + "".join(f"{part:>9}" for part in PARTS))
    for node, parts in found["parts_us"].items():
        print(f"{node:28}" + "".join(f"{parts.get(part, 0.0):9.1f}" for part in PARTS))
    for turn, us in found["turns_us"].items():
        print(f"{turn + ', us':60}{us:9.1f}")
    print(f"\n{'':28}{'processor, %':>14}{'memory, MB':>12}")
    for node, share in sorted(found["processor_percent"].items()):
        print(f"{node:28}{share:14.1f}{found['memory_mb'][node]:12.1f}")
    print(f"{'together':28}{sum(found['processor_percent'].values()):14.1f}")
    for what, start_s in found["start_s"].items():
        print(f"start to {what}: {start_s:.2f} s")


if __name__ == "__main__":
    main()
