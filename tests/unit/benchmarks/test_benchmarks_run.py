"""Benchmarks that still run: each explains itself, and those with a shortest run give figures that can be right."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "benchmarks"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py") if "__main__" in path.read_text())
# What the figures of the shortest run are within on any machine, by path, where `*` stands for each key or row. They
# are wide: a script that measures nothing, or the wrong thing, misses them.
BOUNDS: dict[str, dict[str, tuple[float, float]]] = {
    "compose.py": {"bare.hold_ratio": (0.9, 1.1), "compose.hold_ratio": (0.9, 1.1), "compose_to_bare.p50": (0.1, 50.0)},
    "dynamic_node.py": {"rounds.*.*.p50": (0.05, 500.0), "exchange_ms.*.*": (1e-4, 10.0)},
    "empty_loop.py": {"available": (0.2, 1.0), "stalls": (0, 1000)},
    "growth.py": {
        "axes.*.rows.*.p50_ms": (0.05, 500.0), "axes.*.rows.*.hand_hz": (50.0, 1100.0),
        "axes.*.rows.*.rig_percent": (5.0, 400.0), "axes.*.rows.*.rig_mb": (100.0, 1e4),
    },
    "haptic_devices.py": {"cases.*.p50_ms": (0.05, 500.0), "cases.*.p50_ratio": (0.2, 20.0)},
    "judging.py": {"*.holds": (2, 2), "*.s_per_s": (1e-5, 0.5), "*.most_mb": (0.01, 50.0)},
    "late_cycles.py": {
        "rows.*.cycles": (1000, 10_000), "rows.*.median_ms": (0.0, 500.0), "rows.*.late_in_million": (0.0, 1e6),
        "rows.*.runs_in_million.high": (100.0, 1e6), "rows.5.burner_percent": (0.5, 110.0),
    },
    "link.py": {
        "messages_per_s": (6000, 6000), "lost": (0, 0), "ratio": (0.5, 100.0), "delay_error_ms.p50": (-1.0, 100.0)
    },
    "link_udp.py": {"median.*.lost": (0.0, 0.5), "median.*.p50_ms": (1e-3, 100.0), "ratio.p50": (0.2, 1e3)},
    "lockstep.py": {"rows.*.ratio": (20.0, 1e5), "rows.*.ns_per_tick": (10.0, 1e5)},
    "loop.py": {
        "age_ms.*.p50": (0.01, 100.0), "ratio.zeromq.p50": (1.0, 50.0), "parts_us.*.decode": (0.5, 1000.0),
        "processor_percent.haptic_node@master": (1.0, 100.0), "start_s.*": (0.2, 60.0),
    },
    "mean_intervals.py": {"white.*.known": (0.5, 1.0), "white.*.covered": (0.7, 1.0)},
    "observers.py": {
        "median.*.p50_ms": (0.05, 500.0), "median.*.hand_hz": (100.0, 1100.0), "median.shared.received_hz": (10.0, 2e4),
    },
    "particles.py": {"ratio.*": (0.3, 30.0), "times_real_time.*": (1.0, 1e6)},
    "peers.py": {"age_ms.*.p50": (0.01, 100.0), "rig_ratio.ZeroMQ.p50": (1.0, 50.0)},
    "replay.py": {
        "timing.messages": (1000, 1e6), "timing.interval_error_p50_s": (0.0, 0.05),
        "plain_timer.interval_error_p50_s": (0.0, 0.05),
        "rate_0.ratio_to_bare": (0.05, 5.0), "rate_0.ratio_to_bare_apart": (0.05, 5.0),
        "verify.ratio": (0.03, 1.5), "recording.ratio": (0.1, 5.0),
    },
    "side_by_side.py": {"cases.*.median.p50_ms": (0.05, 500.0), "cases.*.median.hand_hz": (100.0, 1100.0)},
    "soak.py": {"least_rate_share": (0.2, 1.05), "rate_to_machine": (0.2, 2.0)},
    "tables.py": {},
    "turns.py": {"parts.*.us": (0.5, 1e4), "parts.*.ratio": (0.2, 5.0)},
    "virtual.py": {"*.times": (0.05, 100.0), "*.best_us_per_ms": (10.0, 2e4)},
    "wide_area.py": {"delay_ms": (10.0, 10.0), "link.0": (5.0, 500.0), "bare.0": (5.0, 500.0)},
}  # fmt: skip
# this needs what a machine may lack, and says so
NEED = {"compose.py": "docker"}
# in one process, because most of the time goes into what they all import
ASK = """
import runpy, sys
sys.path.insert(0, sys.argv[1])
for name in sys.argv[2:]:
    sys.argv[:] = [name, "--help"]
    try:
        runpy.run_path(f"{sys.path[0]}/{name}", run_name="__main__")
    except SystemExit as end:
        assert not end.code, name
    else:
        raise AssertionError(f"{name} does not know --help")
"""


@pytest.mark.check("takes 1.5 s")
def test_every_script_explains_itself() -> None:
    done = subprocess.run([sys.executable, "-c", ASK, str(FOLDER), *SCRIPTS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("usage: ") == len(SCRIPTS) >= 16


def test_each_script_has_a_shortest_run_and_figures() -> None:
    assert sorted(BOUNDS) == SCRIPTS
    for name in SCRIPTS:
        text = (FOLDER / name).read_text()
        assert '"--smoke"' in text, name
        assert '"--json"' in text, name


@pytest.mark.endurance
@pytest.mark.parametrize("name", [name for name in SCRIPTS if name != "tables.py"])
def test_the_shortest_run_gives_figures_that_can_be_right(name: str) -> None:
    command = [sys.executable, str(FOLDER / name), "--smoke", "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode and name in NEED and NEED[name] in done.stderr:
        pytest.skip(done.stderr.splitlines()[-1])
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert any(figure > 0.0 for figure in _numbers(found))
    for path, (low, high) in BOUNDS[name].items():
        figures = _at(found, path.split("."))
        assert figures, path
        assert all(low <= figure <= high for figure in figures), (path, figures)


def _at(value: Any, path: list[str]) -> list[float]:
    """Return the figures at a path of keys."""
    if not path:
        return [float(value)]
    if path[0] == "*":
        inner = value.values() if isinstance(value, dict) else value
        return [figure for part in inner for figure in _at(part, path[1:])]
    return _at(value[int(path[0])] if isinstance(value, list) else value[path[0]], path[1:])


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [number for part in value.values() for number in _numbers(part)]
    if isinstance(value, list):
        return [number for part in value for number in _numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []
